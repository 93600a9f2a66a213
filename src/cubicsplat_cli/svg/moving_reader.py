"""Reads the animated SVGs that `write_clip` makes back into whole numbers; refuses any other with one line."""

from __future__ import annotations

import re
from decimal import Decimal
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.scene.moving import OPACITY_DECIMALS
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.moving import COLOUR, OFFSET, OPACITY, SHAPE, WIDTH, GridClip, GridGroup, GridTrack
from cubicsplat_cli.svg.paths import subpaths
from cubicsplat_cli.svg.values import NUMBERS, hex_colour

_SVG = "{http://www.w3.org/2000/svg}"
_KEY_DECIMALS = 12  # evenly spaced knots are written without times, and lie where they do
_SCALE = re.compile(r"scale\(\.(0{0,5})1\)")


def read_clip(text: str) -> GridClip:
    """The clip of a file that `write_clip` wrote. Raises InputError for anything else."""
    try:
        return _clip(ElementTree.fromstring(text.encode()))
    except (ElementTree.ParseError, ValueError, KeyError, IndexError, ArithmeticError, TypeError) as error:
        raise InputError(f"this SVG is no clip that cubicsplat wrote, or was edited: {error}") from error


def _clip(root: ElementTree.Element) -> GridClip:
    groups = root.findall(f"{_SVG}g")
    scale = _SCALE.fullmatch(groups[0].get("transform", ""))
    precision = 0 if scale is None else len(scale[1]) + 1
    mode = Mode.OPEN if groups[0].get("fill") == "none" else Mode.CLOSED
    animated = [*root.iter(f"{_SVG}animate"), *root.iter(f"{_SVG}animateTransform")]
    durations = {Decimal(each.attrib["dur"].removesuffix("s")) for each in animated}
    if len(durations) > 1:
        raise ValueError("its animations last different times")
    duration = float(durations.pop()) if durations else 1.0  # where nothing changes, it does not matter
    background = root.find(f"{_SVG}rect")
    colour = None if background is None else hex_colour(background.attrib["fill"])
    clip = GridClip(
        mode, int(root.attrib["width"]), int(root.attrib["height"]), precision, colour, duration, _KEY_DECIMALS, []
    )
    for group in groups:
        begin, end = _times(group, clip)
        curves = [_curve(path, clip) for path in group.findall(f"{_SVG}path")]
        clip.groups.append(GridGroup(begin, end, curves[::-1]))
    return clip


def _times(group: ElementTree.Element, clip: GridClip) -> tuple[float, float]:
    """Start and end of the display of a group, in seconds."""
    display = group.find(f"{_SVG}animate")
    if display is None:
        return 0.0, clip.duration
    keys = [float(key) * clip.duration for key in display.attrib["keyTimes"].split(";")]
    shown = display.attrib["values"].split(";").index("inline")
    return keys[shown], keys[shown + 1] if shown + 1 < len(keys) else clip.duration


def _curve(path: ElementTree.Element, clip: GridClip) -> dict[str, GridTrack]:
    moving = {each.attrib["attributeName"]: each for each in path}
    paint = "fill" if clip.mode is Mode.CLOSED else "stroke"
    width_decimals = clip.width_decimals - clip.precision

    def track(name: str, usual: str, read: object) -> GridTrack:
        element = moving.get(name)
        texts = [path.get(name, usual)] if element is None else element.attrib["values"].split(";")
        values = np.array([read(text) for text in texts], dtype=np.int64)  # type: ignore[operator]
        keys = [0] if element is None else _keys(element, len(texts), clip)
        return GridTrack(np.array(keys, np.int64), values)

    return {
        SHAPE: track("d", "", lambda text: _points(text, clip.mode)),
        OFFSET: track("transform", "0 0", lambda text: [int(value) for value in NUMBERS.findall(text)]),
        COLOUR: track(paint, "", hex_colour),
        OPACITY: track(f"{paint}-opacity", "1", lambda text: [_whole(text, OPACITY_DECIMALS)]),
        WIDTH: track("stroke-width", "0", lambda text: [_whole(text, width_decimals)]),
    }


def _keys(element: ElementTree.Element, count: int, clip: GridClip) -> list[int]:
    if "keyTimes" not in element.attrib:
        return np.rint(np.linspace(0, 10**clip.key_decimals, count)).astype(int).tolist()
    return [_whole(key, clip.key_decimals) for key in element.attrib["keyTimes"].split(";")]


def _whole(text: str, decimals: int) -> int:
    return int(Decimal(text).scaleb(decimals).to_integral_value())


def _points(d: str, mode: Mode) -> list[int]:
    """The control points of a path of one ring of cubics."""
    (ring,) = subpaths(d)
    pieces = [piece for piece in ring if piece.command == "C"]
    points = [pieces[0].start, *(point for piece in pieces for point in (*piece.handles, piece.end))]
    return [int(value) for point in (points[:-1] if mode is Mode.CLOSED else points) for value in point]
