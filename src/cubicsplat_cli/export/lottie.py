"""A clip as Lottie JSON: a shape layer for each group of frames, with linear keyframes."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np

from cubicsplat_cli._version import __version__
from cubicsplat_cli.files.marks import PROGRAM
from cubicsplat_cli.formatting import hex_text
from cubicsplat_cli.settings import Mode, width_decimals
from cubicsplat_cli.svg.moving import COLOUR, OFFSET, OPACITY, SHAPE, WIDTH, GridClip, GridGroup, GridTrack

_FORMAT = "5.7.0"  # of Lottie, which all players of today know
_SHAPES, _SOLID = 4, 1  # kinds of layers
_ROUND = 2  # ends and joins of strokes
_FRAME_DECIMALS, _COLOUR_DECIMALS = 3, 4
_LINEAR = {"o": {"x": [0], "y": [0]}, "i": {"x": [1], "y": [1]}}


def lottie(clip: GridClip, *, fps: float, title: str = "") -> str:
    """Return the JSON text of a clip. fps: frames per second, the unit of its times; keyframes may lie between frames.

    Coordinates are whole numbers on the grid of the clip; the scale of the layers converts them to px.
    """
    layers = [_layer(clip, group, fps, index) for index, group in enumerate(clip.groups)]
    if clip.background is not None:
        solid = {"sw": clip.width, "sh": clip.height, "sc": hex_text(clip.background)}
        layers.append(_placed(_SOLID, len(layers), 0.0, clip.duration * fps, 100) | solid)
    document = {
        "meta": {"program": PROGRAM, "version": __version__}, "v": _FORMAT, "nm": title, "ddd": 0, "assets": [],
        "fr": round(fps, _FRAME_DECIMALS), "ip": 0, "op": _frames(clip.duration * fps), "w": clip.width,
        "h": clip.height, "layers": layers,
    }  # fmt: skip
    return json.dumps(document, separators=(",", ":"), ensure_ascii=False, allow_nan=False) + "\n"


def _frames(value: float) -> int | float:
    """Return the shortest number for a time in frames."""
    rounded = round(value, _FRAME_DECIMALS)
    return int(rounded) if rounded.is_integer() else rounded


def _placed(kind: int, index: int, begin: float, end: float, scale: float) -> dict[str, Any]:
    """Return the members of every layer. begin, end: of its display, in frames. scale: in per cent."""
    still = {"o": 100, "r": 0, "p": [0, 0, 0], "a": [0, 0, 0], "s": [scale, scale, 100]}
    return {
        "ty": kind, "ind": index + 1, "ddd": 0, "sr": 1, "st": 0, "bm": 0, "ip": _frames(begin), "op": _frames(end),
        "ks": {name: {"a": 0, "k": value} for name, value in still.items()},
    }  # fmt: skip


def _layer(clip: GridClip, group: GridGroup, fps: float, index: int) -> dict[str, Any]:
    placed = _placed(_SHAPES, index, group.begin * fps, group.end * fps, 100 / 10**clip.precision)

    def moving(track: GridTrack, value: Callable[[list[int]], Any], *, path: bool = False) -> dict[str, Any]:
        values = [value(row) for row in track.values.tolist()]
        if len(values) == 1:
            return {"a": 0, "k": values[0]}
        times = [_frames((group.begin + key * clip.key_s) * fps) for key in track.keys.tolist()]
        frames = [
            {"t": time, "s": each if isinstance(each, list) and not path else [each], **_LINEAR}
            for time, each in zip(times, values, strict=True)
        ]
        return {"a": 1, "k": [*frames[:-1], {name: frames[-1][name] for name in ("t", "s")}]}

    return placed | {"shapes": [_curve(clip, curve, moving) for curve in group.curves]}


def _curve(clip: GridClip, curve: dict[str, GridTrack], moving: Callable[..., dict[str, Any]]) -> dict[str, Any]:
    closed = clip.mode is Mode.CLOSED
    outline = {"ty": "sh", "ks": moving(curve[SHAPE], lambda row: _bezier(row, closed=closed), path=True)}
    paint: dict[str, Any] = {
        "c": moving(curve[COLOUR], lambda row: [round(value / 255, _COLOUR_DECIMALS) for value in row]),
        "o": moving(curve[OPACITY], lambda row: row[0]),
    }
    if closed:
        paint = {"ty": "fl", **paint, "r": 1}
    else:
        decimals = width_decimals(clip.precision) - clip.precision
        width = moving(curve[WIDTH], lambda row: round(row[0] * 10**-decimals, decimals))
        paint = {"ty": "st", **paint, "w": width, "lc": _ROUND, "lj": _ROUND}
    place = {
        "ty": "tr", "p": moving(curve[OFFSET], lambda row: row),
        **{name: {"a": 0, "k": value} for name, value in (("a", [0, 0]), ("s", [100, 100]), ("r", 0), ("o", 100))},
    }  # fmt: skip
    return {"ty": "gr", "it": [outline, paint, place]}


def _bezier(row: list[int], *, closed: bool) -> dict[str, Any]:
    """Return the vertices, and the handles before and after each, relative to it."""
    points = np.array(row).reshape(-1, 2)
    vertices, cubics = points[::3], len(points) // 3
    none = ((0, len(vertices) - cubics), (0, 0))  # a handle of no length beyond the ends of an open curve
    after = np.pad(points[1::3] - vertices[:cubics], none)
    before = np.pad(points[2::3] - np.roll(vertices, -1, axis=0)[:cubics], none)
    return {"c": closed, "v": vertices.tolist(), "i": np.roll(before, 1, axis=0).tolist(), "o": after.tolist()}
