"""Strokes of drawings as SVG's stroke attributes, and read back."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring
from cubicsplat_cli.artwork.geometry.steps import aligned, to_steps
from cubicsplat_cli.artwork.geometry.stroke import BEVEL, BUTT, MITER, ROUND, SQUARE, Chain, Path, Stroke
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.svg.pathdata import format_number
from cubicsplat_cli.svg.pathparse import Piece
from cubicsplat_cli.svg.ringgrid import GridRing, grid_ring
from cubicsplat_cli.svg.ringpath import PathText, add_chain, add_ring

STROKE_PAINT = {"id", "fill", "stroke", "stroke-opacity", "stroke-width", "stroke-linecap", "stroke-linejoin"}
_CAPS, _JOINS = (BUTT, ROUND, SQUARE), (MITER, ROUND, BEVEL)


def pen(stroke: Stroke, precision: int) -> dict[str, str]:
    """The attributes that say how a stroke is drawn, those left out that are as SVG has them anyway."""
    width = max(1, int(to_steps(stroke.width, precision)))
    attributes = {"stroke-width": format_number(width, precision)}
    if stroke.cap != BUTT and not stroke.closed:
        attributes["stroke-linecap"] = stroke.cap
    if stroke.join != MITER:
        attributes["stroke-linejoin"] = stroke.join
    return attributes


def add_stroke(path: PathText, line: Path, precision: int) -> None:
    """Appends the centre line of a stroke."""
    if not isinstance(line, Chain):
        add_ring(path, grid_ring(line.ring(), precision))
        return
    anchors, controls = to_steps(line.anchors, precision), to_steps(line.controls, precision)
    for i in np.flatnonzero(line.smooth[1:-1]) + 1:
        _straighten(anchors, controls, line.lines, int(i))
    add_chain(path, GridRing(anchors, controls, line.lines, line.smooth))


def _straighten(anchors: np.ndarray, controls: np.ndarray, lines: np.ndarray, i: int) -> None:
    """Moves, in place, the shorter handle at a smooth joint by two steps at most towards the other's line."""
    back = (anchors[i - 1] if lines[i - 1] else controls[i - 1, 1]) - anchors[i]
    ahead = (anchors[i + 1] if lines[i] else controls[i, 0]) - anchors[i]
    if back @ ahead >= 0 or (lines[i - 1] and lines[i]):
        return
    if lines[i - 1] or (not lines[i] and (ahead**2).sum() <= (back**2).sum()):
        controls[i, 0] = anchors[i] + aligned(ahead[None], back[None])[0]
    else:
        controls[i - 1, 1] = anchors[i] + aligned(back[None], ahead[None])[0]


def read_pen(
    attributes: Mapping[str, str], number: Callable[[str], float], foreign: Callable[[str], InputError]
) -> Stroke:
    """The stroke that attributes describe, without its path yet; raises what `foreign` makes of others."""
    width = number(attributes.get("stroke-width", "1"))
    if width <= 0.0:
        raise foreign("has a stroke without a width")
    cap, join = attributes.get("stroke-linecap", BUTT), attributes.get("stroke-linejoin", MITER)
    if cap not in _CAPS or join not in _JOINS:
        raise foreign(f"has the stroke-linecap {cap!r} and the stroke-linejoin {join!r}")
    nowhere = Chain(np.zeros((1, 2)), np.zeros((0, 2, 2)), np.zeros(0, dtype=bool), np.zeros(1, dtype=bool))
    return Stroke(nowhere, width, cap, join)


def read_chain(subpath: list[Piece]) -> Chain:
    """The open line of lines and cubics that a subpath is."""
    anchors = np.array([piece.start for piece in subpath] + [subpath[-1].end])
    steps = np.diff(anchors, axis=0)
    controls = anchors[:-1, None] + steps[:, None] * np.array([1.0, 2.0])[None, :, None] / 3.0
    for index, piece in enumerate(subpath):
        if piece.handles:
            controls[index] = piece.handles
    lines = np.array([not piece.handles for piece in subpath])
    return Chain(anchors, controls, lines, np.zeros(len(anchors), dtype=bool))


def joinable(stroke: Stroke) -> bool:
    """Whether several such strokes can be one path; circles, ellipses and rectangles are elements of their own."""
    return isinstance(stroke.path, (Chain, Ring))
