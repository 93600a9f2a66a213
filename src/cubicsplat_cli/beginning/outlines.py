"""The shapes of any SVG as cubics: primitives by way of path data, lines, quadratics and arcs as cubics."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.svg.arcs import arc_of
from cubicsplat_cli.svg.pathparse import Piece, subpaths

SHAPES = ("path", "rect", "circle", "ellipse", "line", "polyline", "polygon")
Length = Callable[[str], float]  # an attribute in user units, 0 where there is none


@dataclass(frozen=True, eq=False)
class Line:
    """A subpath. cubics: (M, 4, 2), each of which starts where the one before ends. closed: whether it says so."""

    cubics: np.ndarray
    closed: bool

    def mapped(self, matrix: np.ndarray) -> Line:
        """Through an affine map (3, 3)."""
        return Line(self.cubics @ matrix[:2, :2].T + matrix[:2, 2], self.closed)


def path_data(name: str, length: Length, attributes: dict[str, str]) -> str:
    """A shape as path data; empty where it has no extent."""
    if name == "path":
        return attributes.get("d", "")
    if name == "line":
        return f"M{length('x1')!r} {length('y1')!r}L{length('x2')!r} {length('y2')!r}"
    if name in ("polyline", "polygon"):
        points = attributes.get("points", "").strip()
        return f"M{points}{'Z' if name == 'polygon' else ''}" if points else ""
    if name == "rect":
        return _rectangle(length, attributes)
    rx, ry = (length("r"), length("r")) if name == "circle" else (length("rx"), length("ry"))
    if min(rx, ry) <= 0.0:
        return ""
    x, y, arc = length("cx"), length("cy"), f"A{rx!r} {ry!r} 0 0 1 "
    return f"M{x + rx!r} {y!r}{arc}{x - rx!r} {y!r}{arc}{x + rx!r} {y!r}Z"


def _rectangle(length: Length, attributes: dict[str, str]) -> str:
    x, y, width, height = (length(name) for name in ("x", "y", "width", "height"))
    if min(width, height) <= 0.0:
        return ""
    rx = length("rx" if "rx" in attributes else "ry")
    ry = length("ry" if "ry" in attributes else "rx")
    rx, ry = min(rx, width / 2.0), min(ry, height / 2.0)
    right, bottom = x + width, y + height
    if min(rx, ry) <= 0.0:
        return f"M{x!r} {y!r}H{right!r}V{bottom!r}H{x!r}Z"
    arc = f"A{rx!r} {ry!r} 0 0 1 "
    return (
        f"M{x + rx!r} {y!r}H{right - rx!r}{arc}{right!r} {y + ry!r}V{bottom - ry!r}{arc}{right - rx!r} {bottom!r}"
        f"H{x + rx!r}{arc}{x!r} {bottom - ry!r}V{y + ry!r}{arc}{x + rx!r} {y!r}Z"
    )


def lines_of(d: str) -> list[Line]:
    """The subpaths that have a length. Raises InputError for path data that cannot be read."""
    found = []
    for pieces in subpaths(d):
        cubics = [cubic for piece in pieces for cubic in _cubics(piece) if np.ptp(cubic, axis=0).any()]
        if cubics:
            found.append(Line(np.stack(cubics), pieces[-1].command == "Z"))
    return found


def closed(line: Line) -> np.ndarray:
    """The cubics of a subpath, the line back to its start included where it is not there."""
    start, end = line.cubics[0, 0], line.cubics[-1, 3]
    return line.cubics if np.array_equal(start, end) else np.concatenate([line.cubics, straight(end, start)[None]])


def straight(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """A line as a cubic (4, 2)."""
    return start + (end - start) * np.array([0.0, 1.0, 2.0, 3.0])[:, None] / 3.0


def _cubics(piece: Piece) -> list[np.ndarray]:
    start, end = np.array(piece.start), np.array(piece.end)
    if len(piece.handles) == 2:
        return [np.array([start, *piece.handles, end])]
    if len(piece.handles) == 1:
        middle = np.array(piece.handles[0])
        return [np.stack([start, (start + 2.0 * middle) / 3.0, (end + 2.0 * middle) / 3.0, end])]
    if piece.command == "A" and min(piece.numbers[:2]) > 0.0 and piece.start != piece.end:
        return _arc(piece, start, end)
    return [straight(start, end)]


def _arc(piece: Piece, start: np.ndarray, end: np.ndarray) -> list[np.ndarray]:
    """An elliptical arc in quarters or less."""
    arc = arc_of(piece, start, end)
    count = max(1, math.ceil(abs(arc.span) / (math.pi / 2.0) - 1e-9))
    step = arc.span / count
    handle = 4.0 / 3.0 * math.tan(step / 4.0)
    cubics = []
    for index in range(count):
        a, b = arc.first + index * step, arc.first + (index + 1) * step
        p, q = np.array([math.cos(a), math.sin(a)]), np.array([math.cos(b), math.sin(b)])
        ahead, back = np.array([-p[1], p[0]]) * handle, np.array([-q[1], q[0]]) * handle
        cubics.append(arc.placed(np.stack([p, p + ahead, q - back, q])))
    cubics[0][0], cubics[-1][3] = start, end
    return cubics
