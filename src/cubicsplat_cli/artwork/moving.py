"""Drawings of the frames of a clip as one: what stands still or moves as a whole is one shape in all of them."""

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

# Px by which outlines of one shape may differ in two frames, and by which it has not moved: below what edges show.
SAME_PX = 1.0 / 3.0
SEEN = 0.4  # of a pixel, by which such an edge changes what is covered
STEP = 1.0  # px between points of an outline that are compared
MOST_POINTS = 2000  # of a shape


@record
class MovingDrawing:
    """Shapes back to front, each shown in some of F frames, moved by an offset.

    shown: (F, S) bool. offsets: (F, S, 2) px; they count where a shape is shown.
    """

    drawing: Drawing
    shown: np.ndarray
    offsets: np.ndarray


@record
class _Outline:
    """A shape as it is compared with others. points: (P, 2) px along its outlines. low, size: (2,) px of their box."""

    shape: Shape
    points: np.ndarray
    low: np.ndarray
    size: np.ndarray

    @classmethod
    def of(cls, shape: Shape) -> _Outline:
        paths = shape.outlines if shape.stroke is None else (shape.stroke.path,)
        points = np.concatenate([_along(path) for path in paths])
        points = points[:: max(1, len(points) // MOST_POINTS)]
        return cls(shape, points, points.min(axis=0), np.ptp(points, axis=0))

    def move_to(self, other: _Outline) -> np.ndarray | None:
        """(2,) by how many px this shape moved to become the other; None where that is another shape."""
        if np.abs(self.size - other.size).max() > 2 * SAME_PX or not _painted_alike(self.shape, other.shape):
            return None
        move = other.low + other.size / 2.0 - self.low - self.size / 2.0
        if np.abs(move).max() <= SAME_PX:
            move = np.zeros(2)
        moved = self.points + move
        apart = max(PointTree(a).query(b)[0].max() for a, b in ((other.points, moved), (moved, other.points)))
        return move if apart <= SAME_PX + STEP / 2.0 else None


def _covered(shape: Shape, move: np.ndarray, width: int, height: int) -> np.ndarray:
    """(H, W) float32: how much of each pixel a shape covers where it is moved by (2,) px."""
    scene = scene_of(Drawing(width, height, (replace(shape, fill=(255, 255, 255, 255), gradient=None),)))
    return render_scene(replace(scene, points=scene.points + move.astype(np.float32)))[..., 3]


def _along(path: Path) -> np.ndarray:
    """(P, 2) points along an outline, STEP apart at most."""
    if isinstance(path, Chain):
        return points_at(path.cubics, np.linspace(0.0, 1.0, 16)).reshape(-1, 2)
    return dense(flattened(path.ring(), STEP), STEP)


def _painted_alike(first: Shape, second: Shape) -> bool:
    """Whether two shapes are of one kind and one colour, as far as people see."""
    strokes = [shape.stroke for shape in (first, second)]
    if (strokes[0] is None) != (strokes[1] is None) or type(first.gradient) is not type(second.gradient):
        return False
    if strokes[0] and strokes[1] and abs(strokes[0].width - strokes[1].width) > SAME_PX:
        return False
    colours = [
        np.array([shape.fill] if shape.gradient is None else [stop.colour for stop in shape.gradient.stops])
        for shape in (first, second)
    ]
    if colours[0].shape != colours[1].shape or len(first.outlines) != len(second.outlines):
        return False
    return bool(np.abs(colours[0] - colours[1]).max() <= UNSEEN)


@dataclass(eq=False)
class _Tracker:
    """All shapes so far, back to front, and where each is in every frame."""

    shapes: list[_Outline] = field(default_factory=list)
    # Of each shape the frames in which it is shown, with its offset there.
    moves: list[dict[int, np.ndarray]] = field(default_factory=list)
    order: list[int] = field(default_factory=list)  # of `shapes`, back to front

    def add(self, frame: int, drawing: Drawing) -> None:
        """The next frame's drawing."""
        drawn = [_Outline.of(shape) for shape in drawing.shapes]
        places = {number: place for place, number in enumerate(self.order)}
        found = self._matches(drawn)
        if self.shapes and len(found) < len(drawn):
            found |= self._hidden(drawn, found, drawing)
        found = self._kept(dict(sorted(found.items())), places)
        after = -1
        for index, outline in enumerate(drawn):
            if index in found:
                number, move = found[index]
                after = self.order.index(number)
            else:
                number, move = len(self.shapes), np.zeros(2)
                self.shapes.append(outline)
                self.moves.append({})
                after += 1
                self.order.insert(after, number)
            self.moves[number][frame] = move

    def _hidden(
        self, drawn: list[_Outline], found: dict[int, tuple[int, np.ndarray]], drawing: Drawing
    ) -> dict[int, tuple[int, np.ndarray]]:
        """The same of shapes that are known but for what others hide, where their outlines are guessed anew in each
        frame: those that show nothing else where they were last.
        """
        canvas = drawing.width, drawing.height
        taken, more = {number for number, _ in found.values()}, {}
        shows: np.ndarray = np.ones((drawing.height, drawing.width), np.float32)  # of what is beneath the shapes so far
        for index in range(len(drawn) - 1, -1, -1):
            shape = drawn[index].shape
            own = _covered(shape, np.zeros(2), *canvas)
            for number in range(len(self.shapes) if index not in found else 0):
                if number in taken or not _painted_alike(self.shapes[number].shape, shape):
                    continue
                last = next(reversed(self.moves[number].values()))
                other = _covered(self.shapes[number].shape, last, *canvas)
                if (np.abs(other - own) * shows).max() <= SEEN:
                    taken.add(number)
                    more[index] = number, last
                    own = other
                    break
            shows = shows * (1.0 - own * (shape.fill[3] / 255.0 if shape.gradient is None else 1.0))
        return more

    def _matches(self, drawn: list[_Outline]) -> dict[int, tuple[int, np.ndarray]]:
        """For each shape of a drawing that is known, its number, and how far it is from where it was first."""
        found: dict[int, tuple[int, np.ndarray]] = {}
        taken: set[int] = set()
        for index, outline in enumerate(drawn):
            nearest: tuple[float, int, np.ndarray] | None = None
            for number in range(len(self.shapes)):
                move = None if number in taken else self.shapes[number].move_to(outline)
                if move is None:
                    continue
                # From where it was last.
                last = next(reversed(self.moves[number].values()))
                distance = float(np.abs(move - last).max())
                if nearest is None or distance < nearest[0]:
                    nearest = distance, number, last if distance <= SAME_PX else move
            if nearest is not None:
                taken.add(nearest[1])
                found[index] = nearest[1:]
        return found

    @staticmethod
    def _kept(found: dict[int, tuple[int, np.ndarray]], places: dict[int, int]) -> dict[int, tuple[int, np.ndarray]]:
        """As many of the known shapes as are in the same order as before: a longest increasing subsequence."""
        ends: list[int] = []  # places of the last of the best subsequences by length
        last: list[int] = []  # and its indices
        before: dict[int, int | None] = {}
        for index, (number, _) in found.items():
            length = bisect.bisect_left(ends, places[number])
            before[index] = last[length - 1] if length else None
            ends[length : length + 1] = [places[number]]
            last[length : length + 1] = [index]
        kept: dict[int, tuple[int, np.ndarray]] = {}
        at: int | None = last[-1] if last else None
        while at is not None:
            kept[at] = found[at]
            at = before[at]
        return kept


def moving_drawing(drawings: Iterable[Drawing]) -> MovingDrawing:
    """One drawing of those of consecutive frames, which are taken one at a time; at least one.

    A shape is the same in two frames where its colour is, and its outline but for a translation. Shapes of which some
    lie above each other in another order than before count as new.
    """
    tracker, canvas, frames = _Tracker(), (1, 1), 0
    for drawing in drawings:
        canvas = drawing.width, drawing.height
        tracker.add(frames, drawing)
        frames += 1
    shown = np.zeros((frames, len(tracker.order)), bool)
    offsets = np.zeros((*shown.shape, 2))
    for place, number in enumerate(tracker.order):
        for frame, move in tracker.moves[number].items():
            shown[frame, place], offsets[frame, place] = True, move
    return MovingDrawing(
        Drawing(*canvas, tuple(tracker.shapes[number].shape for number in tracker.order)), shown, offsets
    )
