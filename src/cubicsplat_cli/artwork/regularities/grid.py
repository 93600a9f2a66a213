"""Coordinates on a grid, as most artists draw them.

The level and upright edges, middles and radii of a drawing are compared with grids of so many cells to the canvas. A
grid that explains them by far better than chance is the artist's, and what lies near its lines, or halfway, is on them.
That matters most where the picture itself knows level edges to a quarter of a pixel only (`sampling`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import chain

import numpy as np

from cubicsplat_cli.artwork.finish.parameters import MEAN_ERROR, Pins
from cubicsplat_cli.artwork.finish.polish import SHOWN
from cubicsplat_cli.artwork.finish.state import State
from cubicsplat_cli.artwork.geometry.outlines import EXACT, Circle, Ellipse, Outline, Rectangle, Ring, with_thirds
from cubicsplat_cli.artwork.regularities.alike import FARTHEST
from cubicsplat_cli.artwork.shapes import Drawing

# Cells that a canvas is commonly divided into: once or thrice by 3, 5 or 7, and often by 2.
MOST_CELLS, DIVISIONS = 512, (225, 7)
CELLS = [n for n in range(2, MOST_CELLS + 1) if any(MOST_CELLS * odd % n == 0 for odd in DIVISIONS)]
ON_GRID = 0.8  # share of an artist's coordinates that lie on the grid
SURE = 20.0  # times the error of a coordinate that lines halfway between those of the grid must be apart
CLEAR = 3.0  # nats by which a grid must explain more than chance
FEWEST_SEEN = 3  # pixels that SHOWN of a change with their coverage, from which an edge is seen

Mark = tuple[int, float, float]  # a number of a drawing: axis, 0 for x, 1 for y, 2 for a length; value; error, px


def on_grid(drawing: Drawing, state: State, cell: float = 0.0) -> tuple[Drawing, Pins]:
    """Return the drawing with the coordinates on the artist's grid, and which these are; without one the same and none.

    state: the drawing against its picture. cell: px between places of level edges that this tells apart, 0 for exactly.
    """
    # True areas show an edge to half of what an outline is off in the mean.
    edge, size = 0.5 * (cell + MEAN_ERROR), (float(drawing.width), float(drawing.height))
    marks = [(axis, v, edge) for axis, v in _seen_edges(state) if min(abs(v), abs(v - size[axis])) > edge]
    for outline in chain.from_iterable(shape.outlines for shape in drawing.shapes):
        marks += [(axis, value, MEAN_ERROR) for axis, value in _middle_and_radii(outline)]
    snap = _Snap(_grids(marks, size), edge, size)
    shapes = tuple(replace(s, outlines=tuple(map(snap.outline, s.outlines))) for s in drawing.shapes)
    return replace(drawing, shapes=shapes), Pins(*(tuple(sorted(pins)) for pins in snap.pins))


def _seen_edges(state: State) -> list[tuple[int, float]]:
    """Return axes and values: the x of the upright lines and the y of the level ones that show in the picture."""
    crossings, cubics = state.stack.crossings, state.drawn.cubics
    shown = np.bincount(crossings.piece, np.abs(crossings.slope).max(axis=1) > SHOWN, len(cubics))
    good = state.drawn.lines & (shown >= FEWEST_SEEN)
    level = np.ptp(cubics, axis=1) < EXACT
    return [(axis, value) for axis in (0, 1) for value in cubics[good & level[:, axis], 0, axis].tolist()]


def _middle_and_radii(outline: Outline) -> list[tuple[int, float]]:
    """Return axes and values of a circle, a level ellipse, or another ellipse's middle; nothing of other outlines."""
    if not isinstance(outline, Circle | Ellipse):
        return []
    radii = [outline.r] if isinstance(outline, Circle) else [] if outline.angle else [outline.rx, outline.ry]
    return [(0, outline.cx), (1, outline.cy), *((2, radius) for radius in radii)]


def _grids(marks: list[Mark], size: tuple[float, float]) -> dict[int, float]:
    """The px of a cell for each axis that has a grid: of one that serves both axes, or of one for each."""
    distinct = [_distinct(marks, axis) for axis in (0, 1, 2)]
    longest = max(size)
    shared, cells = max((_score(distinct, (0, 1, 2), longest / n, n), n) for n in CELLS)
    own = [max((_score(distinct, (axis,), size[axis] / n, n), n) for n in CELLS) for axis in (0, 1)]
    if shared > CLEAR and shared >= sum(max(score, 0.0) for score, _ in own):
        return dict.fromkeys((0, 1, 2), longest / cells)
    return {axis: size[axis] / n for axis, (score, n) in enumerate(own) if score > CLEAR}


def _distinct(marks: list[Mark], axis: int) -> np.ndarray:
    """(k, 2) values and errors along an axis, those alike once."""
    distinct: list[tuple[float, float]] = []
    for value, error in sorted((value, error) for one, value, error in marks if one == axis):
        if not distinct or value - distinct[-1][0] > error:
            distinct.append((value, error))
    return np.array(distinct).reshape(-1, 2)


def _score(distinct: list[np.ndarray], axes: tuple[int, ...], unit: float, cells: int) -> float:
    """Return by how many nats a grid explains the values better than chance, less what it takes to name the grid."""
    value, error = np.concatenate([distinct[axis] for axis in axes]).T
    hit = np.abs(value - unit * np.rint(value / unit)) <= error
    chances = np.where(hit, ON_GRID / np.minimum(2.0 * error / unit, 1.0), 0.0)
    return float(np.log(chances + (1.0 - ON_GRID)).sum()) - math.log(cells)


class _Snap:
    """Brings outlines onto grids, px of the cells of an axis, and the border of a canvas of a size. edge: px, the error
    of level edges. pins: for x, y and lengths the lines that were hit.
    """

    def __init__(self, grids: dict[int, float], edge: float, size: tuple[float, float]) -> None:
        self.grids, self.edge, self.size = grids, edge, size
        self.pins: tuple[set[float], set[float], set[float]] = (set(), set(), set())

    def outline(self, outline: Outline) -> Outline:
        """Return an outline with what lies near the grids on them."""
        if isinstance(outline, Ring):
            return self._lines(self._lines(outline, 0), 1)
        if isinstance(outline, Rectangle):
            return self._box(outline) if outline.angle == 0.0 else outline
        x, y, *radii = (self._on(axis, value, MEAN_ERROR) for axis, value in _middle_and_radii(outline))
        if not radii:
            return replace(outline, cx=x, cy=y)
        return Circle(x, y, radii[0]) if radii[0] == radii[-1] else Ellipse(x, y, *radii)

    def _box(self, box: Rectangle) -> Rectangle:
        x, y = (box.x, box.x + box.width), (box.y, box.y + box.height)
        (left, right), (top, bottom) = ([self._side(axis, v) for v in ends] for axis, ends in enumerate((x, y)))
        radius = self._on(2, box.radius, FARTHEST) if box.radius > 0.0 else 0.0
        return Rectangle(left, top, right - left, bottom - top, min(radius, 0.5 * min(right - left, bottom - top)))

    def _side(self, axis: int, value: float) -> float:
        border = min(0.0, self.size[axis], key=lambda border: abs(value - border))
        return self._on(axis, border if abs(value - border) < MEAN_ERROR else value, self.edge)

    def _lines(self, ring: Ring, axis: int) -> Ring:
        """Return a ring with its lines across an axis on the grid; the handles at their ends go with them."""
        values, shift = ring.anchors[:, axis], np.zeros(ring.pieces)
        for i in np.flatnonzero(ring.lines & (np.abs(np.roll(values, -1) - values) < EXACT)).tolist():
            value = float(values[i])
            shift[[i, (i + 1) % ring.pieces]] = self._on(axis, value, self.edge) - value
        if not shift.any():
            return ring
        anchors, controls = ring.anchors.copy(), ring.controls.copy()
        anchors[:, axis] += shift
        controls[:, 0, axis] += shift
        controls[:, 1, axis] += np.roll(shift, -1)
        return with_thirds(Ring(anchors, controls, ring.lines, ring.smooth))

    def _on(self, axis: int, value: float, error: float) -> float:
        """The line of a grid, or halfway between two, within the error of a value; the value where there is none."""
        unit = self.grids.get(axis)
        if unit is None:
            return value
        for step in (unit, 0.5 * unit):
            line = step * round(value / step)
            if abs(value - line) <= error and (step == unit or step > SURE * error):
                self.pins[axis].add(line)
                return line
        return value
