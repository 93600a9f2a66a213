"""The drawings of a clip's frames as one drawing: a shape that stands still or moves as a whole is one shape in all."""

from __future__ import annotations

import bisect
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import dense, flattened, points_at
from cubicsplat_cli.artwork.geometry.stroke import Chain, Path
from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.artwork.style import UNSEEN
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.raster.point_tree import PointTree
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import colours_in

# Px between the outlines of one shape in two frames, and px of a move that counts as none: less than edges show.
SAME_PX = 1.0 / 3.0
SEEN = 0.4  # share of a pixel by which such an edge changes the coverage, at most
STEP = 1.0  # px between the points of an outline that are compared
MOST_POINTS = 2000  # of a shape
Matches = dict[int, tuple[int, np.ndarray]]  # by the number of a shape in a drawing: its number of all, and its offset


@record
class MovingDrawing:
    """S shapes back to front, each shown (F, S) bool in some of F frames, moved by offsets (F, S, 2) px in those."""

    drawing: Drawing
    shown: np.ndarray
    offsets: np.ndarray


@record
class _Outline:
    """A shape for comparison. points: (P, 2) px along its outlines. low, size: (2,) px of their box."""

    shape: Shape
    points: np.ndarray
    low: np.ndarray
    size: np.ndarray

    @classmethod
    def of(cls, shape: Shape) -> _Outline:
        points = np.concatenate([_along(path) for path in shape.paths])
        points = points[:: max(1, len(points) // MOST_POINTS)]
        return cls(shape, points, points.min(axis=0), np.ptp(points, axis=0))

    def move_to(self, other: _Outline) -> np.ndarray | None:
        """Return the px (2,) by which this shape moved to become the other; None if that is another shape."""
        if np.abs(self.size - other.size).max() > 2 * SAME_PX or not _painted_alike(self.shape, other.shape):
            return None
        move = other.low + other.size / 2.0 - self.low - self.size / 2.0
        if np.abs(move).max() <= SAME_PX:
            move = np.zeros(2)
        moved = self.points + move
        apart = max(PointTree(a).query(b)[0].max() for a, b in ((other.points, moved), (moved, other.points)))
        return move if apart <= SAME_PX + STEP / 2.0 else None


def _covered(shape: Shape, move: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the coverage (H, W) float32 of a shape that is moved by (2,) px."""
    scene = scene_of(Drawing(width, height, (replace(shape, fill=(255, 255, 255, 255), gradient=None),)))
    return render_scene(replace(scene, points=scene.points + move.astype(np.float32)))[..., 3]


def _along(path: Path) -> np.ndarray:
    """Return points (P, 2) along an outline, at most STEP apart."""
    if isinstance(path, Chain):
        return points_at(path.cubics, np.linspace(0.0, 1.0, 16)).reshape(-1, 2)
    return dense(flattened(path.ring(), STEP), STEP)


def _painted_alike(first: Shape, second: Shape) -> bool:
    """True if two shapes are of one kind, and of one colour to the eye."""
    if type(first.stroke) is not type(second.stroke) or type(first.gradient) is not type(second.gradient):
        return False
    if first.stroke and second.stroke and abs(first.stroke.width - second.stroke.width) > SAME_PX:
        return False
    colours = [np.array(colours_in(shape.paint)) for shape in (first, second)]
    if colours[0].shape != colours[1].shape or len(first.outlines) != len(second.outlines):
        return False
    return bool(np.abs(colours[0] - colours[1]).max() <= UNSEEN)


@dataclass(eq=False)
class _Tracker:
    """All shapes so far. moves: the offset of each, by frames that show it. order: numbers from back to front."""

    shapes: list[_Outline] = field(default_factory=list)
    moves: list[dict[int, np.ndarray]] = field(default_factory=list)
    order: list[int] = field(default_factory=list)

    def add(self, frame: int, drawing: Drawing) -> None:
        """Add the drawing of the next frame."""
        drawn = [_Outline.of(shape) for shape in drawing.shapes]
        matches = self._matches(drawn)
        if self.shapes and len(matches) < len(drawn):
            matches |= self._hidden(drawn, matches, drawing)
        matches = self._in_order(dict(sorted(matches.items())))
        after = -1
        for index, outline in enumerate(drawn):
            if index in matches:
                number, move = matches[index]
                after = self.order.index(number)
            else:
                number, move = len(self.shapes), np.zeros(2)
                self.shapes.append(outline)
                self.moves.append({})
                after += 1
                self.order.insert(after, number)
            self.moves[number][frame] = move

    def _last(self, number: int) -> np.ndarray:
        """Return the last offset of a shape."""
        return next(reversed(self.moves[number].values()))

    def _hidden(self, drawn: list[_Outline], matches: Matches, drawing: Drawing) -> Matches:
        """Return further matches: shapes whose visible parts are as before; hidden ones, guessed anew, may differ."""
        canvas = drawing.width, drawing.height
        taken, more = {number for number, _ in matches.values()}, {}
        clear: np.ndarray = np.ones((drawing.height, drawing.width), np.float32)  # share that shows lower shapes
        for index in range(len(drawn) - 1, -1, -1):
            shape = drawn[index].shape
            own = _covered(shape, np.zeros(2), *canvas)
            for number in range(len(self.shapes) if index not in matches else 0):
                if number in taken or not _painted_alike(self.shapes[number].shape, shape):
                    continue
                last = self._last(number)
                other = _covered(self.shapes[number].shape, last, *canvas)
                if (np.abs(other - own) * clear).max() <= SEEN:
                    taken.add(number)
                    more[index] = number, last
                    own = other
                    break
            clear = clear * (1.0 - own * (shape.fill[3] / 255.0 if shape.gradient is None else 1.0))
        return more

    def _matches(self, drawn: list[_Outline]) -> Matches:
        """Match the shapes of a drawing with those so far that have the same outlines, the nearest ones."""
        matches: Matches = {}
        taken: set[int] = set()
        for index, outline in enumerate(drawn):
            moves = {n: shape.move_to(outline) for n, shape in enumerate(self.shapes) if n not in taken}
            known = {n: (move, self._last(n)) for n, move in moves.items() if move is not None}
            apart = {n: float(np.abs(move - last).max()) for n, (move, last) in known.items()}
            if apart:
                number = min(apart, key=apart.__getitem__)
                taken.add(number)
                move, last = known[number]
                matches[index] = number, last if apart[number] <= SAME_PX else move
        return matches

    def _in_order(self, matches: Matches) -> Matches:
        """Return as many matches as are in the same order as before: a longest increasing subsequence."""
        places = {number: place for place, number in enumerate(self.order)}
        runs: list[list[int]] = [[]]  # by length, the subsequence with the lowest end
        ends: list[int] = []
        for index, (number, _) in matches.items():
            length = bisect.bisect_left(ends, places[number])
            ends[length : length + 1] = [places[number]]
            runs[length + 1 : length + 2] = [[*runs[length], index]]
        return {index: matches[index] for index in runs[-1]}


def moving_drawing(drawings: Iterable[Drawing]) -> MovingDrawing:
    """Merge the drawings of consecutive frames, at least one, into one drawing. They are read one at a time.

    A shape is the same in two frames if its colour is, and its outline up to a translation. Of shapes whose order
    changes, some count as new.
    """
    tracker, canvas, frames = _Tracker(), (1, 1), 0
    for frames, drawing in enumerate(drawings, 1):
        canvas = drawing.width, drawing.height
        tracker.add(frames - 1, drawing)
    shown = np.zeros((frames, len(tracker.order)), bool)
    offsets = np.zeros((*shown.shape, 2))
    for place, number in enumerate(tracker.order):
        for frame, move in tracker.moves[number].items():
            shown[frame, place], offsets[frame, place] = True, move
    shapes = tuple(tracker.shapes[number].shape for number in tracker.order)
    return MovingDrawing(Drawing(*canvas, shapes), shown, offsets)
