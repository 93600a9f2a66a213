"""Coordinates on a grid, and lines in common directions, as most artists draw them.

The level and upright edges, middles and radii of a drawing are compared with grids of so many cells to the canvas. A
grid that explains them by far better than chance is the artist's, and what lies near its lines, or halfway, is on them.
That matters most where the picture itself knows level edges to a quarter of a pixel only (`sampling`). Sloping lines
are likewise compared with 45 degrees, and with 30 and 60.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.finish.merges import SEEN_SIGMA, Visibility
from cubicsplat_cli.artwork.finish.parameters import ON_BORDER, Pins
from cubicsplat_cli.artwork.finish.state import State
from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Outline, Rectangle, Ring, with_thirds
from cubicsplat_cli.artwork.regularities.alike import CLEAR, SIGMAS
from cubicsplat_cli.artwork.regularities.ties import EXACT, LEAST, TiedRing, null_basis
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.record import record

# Cells that a canvas is commonly divided into.
CELLS = (
    *(2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 15, 16, 18, 20, 24, 25, 28, 30, 32, 36, 40, 45, 48, 50, 56, 60, 64, 72),
    *(80, 90, 96, 100, 108, 112, 120, 128, 144, 150, 160, 180, 192, 200, 240, 256, 288, 300, 320, 360, 384, 400, 512),
)
ON_GRID = 0.8  # share of an artist's coordinates that lie on the grid
SURE = 20.0  # times the error of a coordinate that lines halfway between those of the grid must be apart
EDGE = 0.03  # px, the error of coordinates where edges show their true areas
ROUND = 0.06  # px, that of middles and radii
CORNER = 0.25  # px, that of the radius of a rectangle's corners
SHOWS, FEWEST_SEEN = 0.1, 3  # change of the picture with a pixel's coverage, and pixels, from which an edge is seen
# Degrees of the lines that are sought together; level and upright ones are told where outlines are traced.
FAMILIES = ((45.0, 135.0), (30.0, 60.0, 120.0, 150.0))
SHORTEST = 4.0  # px of a line that tells its direction
SHOWN = 0.8  # share of a line that must show
SYSTEMATIC = 0.01  # px that one end of a line is off in its direction besides what its points tell
POINT = 0.5 * SEEN_SIGMA  # px, the standard error of a point of a straight line
OFTEN = 0.1  # share of a drawing's sloping lines that have the directions of a family, where the artist used it

Slope = tuple[int, float]  # the number of a line of a ring, and its direction, radians


@record
class Mark:
    """A number of a drawing. axis: 0 for x, 1 for y, 2 for a length; value and error in px."""

    axis: int
    value: float
    error: float


def on_grid(drawing: Drawing, state: State, cell: float = 0.0) -> tuple[Drawing, Pins]:
    """The drawing with the coordinates on the artist's grid, and which these are; the same and none without a grid.

    state: the drawing against its picture. cell: px between the places of level edges that the picture can tell apart,
    0 if it tells them exactly.
    """
    edge = 0.5 * cell + EDGE
    size = (float(drawing.width), float(drawing.height))
    outlines = [_on_border(outline, size) for shape in drawing.shapes for outline in shape.outlines]
    seen = _seen_edges(state)
    marks = [mark for k, outline in enumerate(outlines) for mark in _marks(outline, edge, seen[k])]
    marks = [m for m in marks if m.axis == 2 or min(abs(m.value), abs(m.value - size[m.axis])) > m.error]
    grids = _grids(marks, size)
    snap = _Snap(grids, edge)
    snapped = iter([snap.outline(outline) for outline in outlines])
    shapes = tuple(replace(s, outlines=tuple(next(snapped) for _ in s.outlines)) for s in drawing.shapes)
    return replace(drawing, shapes=shapes), Pins(*(tuple(sorted(pins)) for pins in snap.pins))


def _on_border(outline: Outline, size: tuple[float, float]) -> Outline:
    """A level rectangle with the sides on the canvas's border that are nearly there."""
    if not isinstance(outline, Rectangle) or outline.angle != 0.0:
        return outline
    ends = np.array([[outline.x, outline.x + outline.width], [outline.y, outline.y + outline.height]])
    borders = np.array([[0.0, size[0]], [0.0, size[1]]])
    (left, right), (top, bottom) = np.where(np.abs(ends - borders) < ON_BORDER, borders, ends).tolist()
    return Rectangle(left, top, right - left, bottom - top, outline.radius)


def _seen_edges(state: State) -> list[list[np.ndarray]]:
    """Of each outline the x of its upright lines and the y of its level ones that show in the picture."""
    crossings, shown = state.crossings, np.zeros(int(state.pieces[-1]))
    np.add.at(shown, crossings.piece, np.abs(crossings.slope).max(axis=1) > SHOWS)
    found = []
    for outline, first in zip(state.outlines, state.pieces, strict=False):
        good = outline.lines & (shown[first : first + len(outline.lines)] >= FEWEST_SEEN)
        level = np.ptp(outline.cubics, axis=1) < EXACT
        found.append([outline.cubics[good & level[:, axis], 0, axis] for axis in (0, 1)])
    return found


def _marks(outline: Outline, edge: float, seen: list[np.ndarray]) -> Iterator[Mark]:
    """The numbers of an outline that the picture tells; seen: the x and the y of its edges that show."""
    for axis, values in enumerate(seen):
        yield from (Mark(axis, float(value), edge) for value in values)
    if isinstance(outline, Circle | Ellipse):
        yield from (Mark(0, outline.cx, ROUND), Mark(1, outline.cy, ROUND))
    if isinstance(outline, Circle):
        yield Mark(2, outline.r, ROUND)
    elif isinstance(outline, Ellipse) and outline.angle == 0.0:
        yield from (Mark(2, outline.rx, ROUND), Mark(2, outline.ry, ROUND))


def _level(ring: Ring, axis: int) -> list[float]:
    """The coordinates of a ring's lines across an axis: y of the level ones for axis 1, x of the upright for 0."""
    values = ring.anchors[:, axis]
    along = ring.lines & (np.abs(np.roll(values, -1) - values) < EXACT)
    return np.unique(values[along]).tolist()


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
    found: list[tuple[float, float]] = []
    for mark in sorted((m for m in marks if m.axis == axis), key=lambda m: (m.value, m.error)):
        if not found or mark.value - found[-1][0] > mark.error:
            found.append((mark.value, mark.error))
    return np.array(found).reshape(-1, 2)


def _score(distinct: list[np.ndarray], axes: tuple[int, ...], unit: float, cells: int) -> float:
    """By how many nats a grid explains the values better than chance, less what it takes to name the grid."""
    total = -math.log(cells)
    for axis in axes:
        value, error = distinct[axis].T
        if not len(value):
            continue
        chance = np.minimum(2.0 * error / unit, 1.0)
        hit = np.abs(value - unit * np.rint(value / unit)) <= error
        total += float(np.log(np.where(hit, ON_GRID / chance, 0.0) + (1.0 - ON_GRID)).sum())
    return total


class _Snap:
    """Brings outlines onto grids. pins: for x, y and lengths the lines that were hit."""

    def __init__(self, grids: dict[int, float], edge: float) -> None:
        self.grids, self.edge = grids, edge
        self.pins: tuple[set[float], set[float], set[float]] = (set(), set(), set())

    def outline(self, outline: Outline) -> Outline:
        """An outline with what lies near the grids on them."""
        if isinstance(outline, Circle):
            x, y = self._on(0, outline.cx, ROUND), self._on(1, outline.cy, ROUND)
            return Circle(x, y, self._on(2, outline.r, ROUND))
        if isinstance(outline, Ellipse):
            x, y = self._on(0, outline.cx, ROUND), self._on(1, outline.cy, ROUND)
            across, down = (self._on(2, r, ROUND) if outline.angle == 0.0 else r for r in (outline.rx, outline.ry))
            if across == down:
                return Circle(x, y, across)
            return Ellipse(x, y, across, down, outline.angle)
        if isinstance(outline, Rectangle):
            return self._box(outline)
        for axis in (0, 1):
            for value in _level(outline, axis):
                outline = _moved(outline, axis, value, self._on(axis, value, self.edge))
        return outline

    def _box(self, box: Rectangle) -> Rectangle:
        if box.angle != 0.0:
            return box
        left, right = self._on(0, box.x, self.edge), self._on(0, box.x + box.width, self.edge)
        top, bottom = self._on(1, box.y, self.edge), self._on(1, box.y + box.height, self.edge)
        radius = self._on(2, box.radius, CORNER) if box.radius > 0.0 else 0.0
        return Rectangle(left, top, right - left, bottom - top, min(radius, 0.5 * min(right - left, bottom - top)))

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


def _moved(ring: Ring, axis: int, value: float, to: float) -> Ring:
    """The ring with its level lines at one coordinate at another one; the handles at their ends go with them."""
    if to == value:
        return ring
    values = ring.anchors[:, axis]
    along = ring.lines & (np.abs(np.roll(values, -1) - values) < EXACT) & (np.abs(values - value) < EXACT)
    moving = along | np.roll(along, 1)
    anchors, controls = ring.anchors.copy(), ring.controls.copy()
    anchors[moving, axis] += to - value
    controls[moving, 0, axis] += to - value
    controls[np.roll(moving, -1), 1, axis] += to - value
    return with_thirds(Ring(anchors, controls, ring.lines, ring.smooth))


def found_slopes(rings: Mapping[int, tuple[Ring, Visibility]]) -> dict[int, list[Slope]]:
    """The lines of rings by number that are in the directions of a family, where the drawing has clearly more of these
    than chance would put there."""
    lines = [(k, *line) for k, (ring, visibility) in rings.items() for line in _sloping(ring, visibility)]
    found: dict[int, list[Slope]] = {}
    for family in FAMILIES:
        score, hits = 0.0, []
        for k, piece, length, angle in lines:
            allowed = SIGMAS * math.hypot(SYSTEMATIC, POINT * math.sqrt(12.0 / length))
            nearest = min(family, key=lambda degrees: _between(angle, math.radians(degrees)))
            hit = length * math.sin(_between(angle, math.radians(nearest))) <= allowed
            chance = min(len(family) * 2.0 * allowed / (math.pi * length), 1.0)
            score += math.log((OFTEN / chance if hit else 0.0) + 1.0 - OFTEN)
            hits += [(k, (piece, math.radians(nearest)))] if hit else []
        if score > CLEAR:
            for k, slope in hits:
                found.setdefault(k, []).append(slope)
    return found


def _sloping(ring: Ring, visibility: Visibility) -> Iterable[tuple[int, float, float]]:
    """Number, length, px, and direction, radians, of the lines of a ring that show and slope."""
    ways = np.roll(ring.anchors, -1, axis=0) - ring.anchors
    for i in np.flatnonzero(ring.lines & (np.abs(ways) > EXACT).all(axis=1)).tolist():
        length = float(np.hypot(*ways[i]))
        if length >= SHORTEST:
            weights = visibility.weights(i, (np.arange(math.ceil(length)) + 0.5) / math.ceil(length))
            if (weights > 0.5 * visibility.sigma**-2).mean() >= SHOWN:
                yield i, length, math.atan2(ways[i, 1], ways[i, 0])


def _between(one: float, other: float) -> float:
    """The angle between two lines, whichever way these run, 0 to pi / 2."""
    off = (one - other) % math.pi
    return min(off, math.pi - off)


def directed(ring: TiedRing, slopes: Iterable[Slope]) -> TiedRing | None:
    """A ring with some lines brought into their directions and kept there; None where other ties do not let them."""
    p = ring.pieces
    rows = []
    for i, angle in slopes:
        j, across = (i + 1) % len(p.anchors), _across(angle)
        row = np.zeros(p.joints.variables + 1)
        # The last entry stands for all that is fixed.
        for c in (0, 1):
            row[p.tied[j, c]] += across[c]
            row[p.tied[i, c]] -= across[c]
        rows.append(row[:-1])
    matrix = np.array(rows) @ ring.ties.toarray()
    off = _off(p.anchors, slopes)
    step = np.linalg.lstsq(matrix, -off, rcond=None)[0]
    brought = ring.moved(step)
    if np.abs(_off(brought.pieces.anchors, slopes)).max() > LEAST:
        return None
    equations = [{int(k): float(row[k]) for k in np.flatnonzero(row)} for row in matrix]
    return TiedRing(brought.pieces, ring.ties.after(null_basis(ring.ties.shape[1], equations)))


def _across(angle: float) -> tuple[float, float]:
    """(2,) square to a direction, in whole numbers for 45 degrees."""
    x, y = -math.sin(angle), math.cos(angle)
    return (x, y) if abs(abs(x) - abs(y)) > LEAST else (math.copysign(1.0, x), math.copysign(1.0, y))


def _off(anchors: np.ndarray, slopes: Iterable[Slope]) -> np.ndarray:
    """(lines,) by how much, about px, lines between anchors (A, 2) miss their directions."""
    ways = np.roll(anchors, -1, axis=0) - anchors
    return np.array([ways[i] @ _across(angle) for i, angle in slopes])


def has_diagonal(ring: Ring) -> bool:
    """Whether a line of a ring runs at 45 degrees exactly."""
    ways = np.abs(np.roll(ring.anchors, -1, axis=0) - ring.anchors)
    return bool((ring.lines & (np.abs(ways[:, 0] - ways[:, 1]) < LEAST) & (ways[:, 0] > EXACT)).any())
