"""Fills with a stroke around them: boxes and circles of a diagram, stickers, cartoons.

In a picture the stroke is ink of one width around a face, which is a shape on the ink or beneath a hole in it. The
path of the stroke is the face's outline, moved outwards by half of that width, and the face ends there too, beneath the
stroke: in a file both are one element (`shapes.is_framed`). Of the ink remains what no stroke covers, such as lines
between boxes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from cubicsplat_cli.artwork.finish.parameters import Constraints
from cubicsplat_cli.artwork.finish.state import State, layer_of, still_layer
from cubicsplat_cli.artwork.geometry.fitting import PRECISION, fit_outlines
from cubicsplat_cli.artwork.geometry.outlines import (
    Circle,
    Outline,
    Rectangle,
    Ring,
    extent_of,
    flattened,
    following,
    points_at,
    polygon_lengths,
    signed_area,
    turned_to,
    with_thirds,
)
from cubicsplat_cli.artwork.geometry.stroke import EVEN_PX, EVEN_SHARE, MITER, Chain, Stroke, offset_ring
from cubicsplat_cli.artwork.shapes import SHAPE_PARAMETERS, Drawing, Shape
from cubicsplat_cli.artwork.strokes.find import MOST_SLACK, PEN, length_of
from cubicsplat_cli.artwork.strokes.leftover import SEEN, left_of
from cubicsplat_cli.artwork.strokes.parameters import StrokeParameters, fitted_state, misfit_growth
from cubicsplat_cli.raster.stack import Goal
from cubicsplat_cli.raster.strokes import ring_widths
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import is_opaque

MOSTLY = 0.5  # share of a face's outline where the ink around it is as wide as usual, at least
BROAD = 1.0 / 3.0  # of a face's mean width that a stroke is at most; what is broader is a shape of its own
PART = 0.1  # of an ink that is around faces, at least: a page has few that lie so near to each other
ALONG = 17  # points of a cubic by which its box is known
FEWEST = 8  # points of an outline that primitives are fitted to
NEAR_END = 1e-3  # parameter of a cubic near an end where it has a direction
SHARPEST = 0.2  # 1 plus the cosine of the turn at a corner, at least: a mitre of 3.2 times its width
# Standard deviation of a pixel's share on the sides of a stroke: Skia, and what follows it, lays sides of bent strokes
# a quarter of a px off at most (SkPathStroker).
SIDES_ERROR = 0.25 * 12.0**-0.5


@record
class _Frame:
    """A stroke around a face. path, stroke: its own, as it is expected; face: the number of the shape in it."""

    path: Outline
    stroke: Stroke
    face: int


@record
class _Framed:
    """An ink as frames: the number of its shape, the frames, and what is left of it."""

    ink: int
    frames: list[_Frame]
    rest: list[Shape]

    @property
    def numbers(self) -> list[int]:
        """The numbers of the shapes that it replaces."""
        return [self.ink, *(frame.face for frame in self.frames)]

    def made(self, shapes: Sequence[Shape]) -> dict[int, list[Shape]]:
        """Return what stands in place of each of the shapes that it replaces."""
        out: dict[int, list[Shape]] = {n: [] for n in self.numbers}
        out[self.ink] += self.rest
        for frame in self.frames:
            fill = replace(shapes[frame.face], outlines=(frame.path,))
            # What shows in a hole lies beneath the ink.
            out[max(self.ink, frame.face)] += [fill, shapes[self.ink].stroked(frame.stroke)]
        return out

    def saved(self, shapes: Sequence[Shape]) -> float:
        """Return by how many numbers the frames are shorter than the shapes, without what is left of the ink."""
        frames = sum(SHAPE_PARAMETERS + PEN + frame.path.coordinates for frame in self.frames)
        return length_of(*(shapes[n] for n in self.numbers)) - frames


def with_frames(drawing: Drawing, goal: Goal, detail: float, error: float, *, sampled: bool) -> Drawing:
    """Return the drawing with strokes around fills, fitted to its goal, where its description becomes shorter. detail,
    error: as of `as_strokes`; sampled: whether the picture was drawn from few samples a pixel.
    """
    slack, shapes, boxes = min(error, MOST_SLACK), drawing.shapes, _boxes(drawing.shapes)
    proposals, taken = list[_Framed](), set[int]()
    for ink, upon in _inks(shapes, boxes):
        faces = [n for n in upon if n not in taken]
        found = None if ink in taken else _framed(shapes, boxes, ink, faces, detail, slack)
        if found is not None and not taken.intersection(found.numbers) and found.saved(shapes) > 0.0:
            proposals.append(found)
            taken |= {*found.numbers}
    if not proposals:
        return drawing
    if sampled:
        goal = replace(goal, share_error=max(goal.share_error, SIDES_ERROR))
    before = State([still_layer(shape, goal) for shape in shapes], goal)
    while proposals:
        trial = _Trial.of(proposals, shapes)
        after = trial.fitted(before, drawing)
        lost, kept = trial.lost(before, after, detail)
        paying = [own for own in proposals if own.saved(shapes) > lost[own.ink]]
        # What one spoils may be held against its neighbours, or for them.
        if len(paying) == len(proposals):
            return replace(drawing, shapes=tuple(trial.made(after, kept)))
        proposals = paying
    return drawing


def _boxes(shapes: Sequence[Shape]) -> np.ndarray:
    """Return (n, 4) left, top, right and bottom of the outer outline of each shape."""
    rings = [shape.outlines[0].ring().cubics for shape in shapes]
    points = points_at(np.concatenate([*rings, np.zeros((0, 4, 2))]), np.linspace(0.0, 1.0, ALONG)).reshape(-1, 2)
    starts = ALONG * np.cumsum([0, *map(len, rings)])[:-1]
    ends = [end.reduceat(points, starts) for end in (np.minimum, np.maximum)] if rings else np.zeros((2, 0, 2))
    return np.concatenate(ends, axis=1)


def _inks(shapes: Sequence[Shape], boxes: np.ndarray) -> list[tuple[int, list[int]]]:
    """Return the numbers of shapes in an opaque fill, each with those of the shapes of one outline that lie on it; only
    those on which any lie, or which have a hole. boxes: (n, 4) of the shapes."""
    areas = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
    upon: dict[int, list[int]] = {n: [] for n in range(len(shapes))}
    for n, shape in enumerate(shapes):
        if _is_face(shape):
            inside = (boxes[:n, :2] < boxes[n, :2]).all(axis=1) & (boxes[:n, 2:] > boxes[n, 2:]).all(axis=1)
            under = np.flatnonzero(inside)
            if len(under):
                upon[int(under[np.argmin(areas[under])])].append(n)
    inks = [n for n, shape in enumerate(shapes) if is_opaque(shape.fill) and shape.gradient is None]
    return [(n, upon[n]) for n in inks if upon[n] or len(shapes[n].outlines) > 1]


def _is_face(shape: Shape) -> bool:
    """Return whether a shape may have a stroke around it."""
    return len(shape.outlines) == 1 and shape.stroke is None and is_opaque(shape.paint)


def _framed(
    shapes: Sequence[Shape], boxes: np.ndarray, ink: int, upon: list[int], detail: float, slack: float
) -> _Framed | None:
    """Return an ink as frames around faces, those upon it and in its holes; None if it has one width around none.
    boxes: (n, 4) of the shapes."""
    shape = shapes[ink]
    if shape.stroke is not None:
        path = shape.stroke.path
        if isinstance(path, Chain) or shape.stroke.dashes or len(shape.outlines) < 2:
            return None
        face = _beneath(shapes, boxes, ink, shape.outlines[1], path, shape.stroke.width)
        return None if face is None else _Framed(ink, [_Frame(path, shape.stroke, face)], [])
    own = shape.oriented()
    outlines = [*shape.outlines, *(shapes[n].outlines[0] for n in upon)]
    rings = [*own, *(turned_to(shapes[n].outlines[0].ring(), False) for n in upon)]
    off = EVEN_PX + 2.0 * slack
    widths, even = ring_widths([ring.cubics for ring in rings], EVEN_SHARE, off)
    areas = np.array([-signed_area(ring) for ring in rings])
    lengths = np.array([polygon_lengths(ring.cubics).sum() for ring in rings])
    found = (even >= MOSTLY) & (widths > 0.0) & (widths * lengths <= BROAD * 2.0 * areas)
    shown = -areas[: len(own)].sum() - areas[len(own) :].sum()
    if not found.any() or (widths * lengths)[found].sum() < PART * shown:
        return None
    from cubicsplat_cli.artwork.strokes.build import join_of  # few drawings have any
    from cubicsplat_cli.artwork.strokes.skeleton import Sides

    sides, frames = Sides.of(own), list[_Frame]()
    for k in np.flatnonzero(found).tolist():
        width = float(widths[k])
        path = _path_around(outlines[k], shape.outlines[0], width, detail, slack)
        stroke = Stroke(path, width, join=join_of(path, True, width, sides) or MITER)
        if k < len(own):
            face = _beneath(shapes, boxes, ink, outlines[k], path, width)
        else:
            face = upon[k - len(own)]
            face = None if _meets(shapes, boxes, range(ink + 1, face), shape.stroked(stroke)) else face
        if face is not None:
            frames.append(_Frame(path, stroke, face))
    if not frames:
        return None
    wider = (replace(frame.stroke, width=frame.stroke.width + 2.0 * off) for frame in frames)
    reach = 0.5 * min(frame.stroke.width for frame in frames) + off
    rest = left_of(shape, [shape.stroked(stroke).oriented()[0] for stroke in wider], reach)
    return None if rest is None else _Framed(ink, frames, rest)


def _path_around(face: Outline, ink: Outline, width: float, detail: float, slack: float) -> Outline:
    """Return the path of a stroke of a width around a face, by the face's outline and, of a primitive, that of its ink;
    the shortest of several."""
    if not isinstance(face, Ring) and type(face) is type(ink):
        (low, high), (first, last) = extent_of([face.ring()]), extent_of([ink.ring()])
        if (np.abs(np.stack([low - first, last - high]) - width) < EVEN_PX + EVEN_SHARE * width).all():
            return replace(face, **{f.name: 0.5 * (getattr(face, f.name) + getattr(ink, f.name)) for f in fields(face)})
    if isinstance(face, Circle):
        return replace(face, r=face.r + 0.5 * width)
    if isinstance(face, Rectangle):
        radius = face.radius + 0.5 * width if face.radius else 0.0
        x, y = face.x - 0.5 * width, face.y - 0.5 * width
        return replace(face, x=x, y=y, width=face.width + width, height=face.height + width, radius=radius)
    ring = turned_to(face.ring(), True)
    points = flattened(offset_ring(ring, 0.5 * width), 1.0)
    paths: list[Outline] = [_moved(ring, 0.5 * width)]
    if len(np.unique(points, axis=0)) >= FEWEST:
        paths += fit_outlines([points], [np.full(len(points), np.hypot(PRECISION, slack))], detail)
    return min(paths, key=lambda path: path.coordinates)


def _moved(ring: Ring, reach: float) -> Ring:
    """Return a ring, clockwise as seen, moved outwards by about so many px, piece by piece, with mitred corners."""
    cubics = ring.cubics
    first, last = points_at(cubics, np.array([NEAR_END, 1.0 - NEAR_END])).swapaxes(0, 1)
    after, before = _normals(first - cubics[:, 0]), np.roll(_normals(cubics[:, 3] - last), 1, axis=0)
    turns = np.maximum(1.0 + (after * before).sum(axis=1), SHARPEST)
    anchors = ring.anchors + reach * (after + before) / turns[:, None]
    chords, others = cubics[:, 3] - cubics[:, 0], following(anchors) - anchors
    longer = ((chords * others).sum(axis=1) / np.maximum((chords * chords).sum(axis=1), 1e-9))[:, None]
    starts = anchors + longer * (cubics[:, 1] - cubics[:, 0])
    ends = following(anchors) + longer * (cubics[:, 2] - cubics[:, 3])
    return with_thirds(Ring(anchors, np.stack([starts, ends], axis=1), ring.lines, ring.smooth))


def _normals(ways: np.ndarray) -> np.ndarray:
    """Return the unit vectors (n, 2) to the left of ways (n, 2), as seen."""
    return np.stack([ways[:, 1], -ways[:, 0]], axis=1) / np.maximum(np.hypot(*ways.T), 1e-9)[:, None]


def _beneath(
    shapes: Sequence[Shape], boxes: np.ndarray, ink: int, hole: Outline, path: Outline, width: float
) -> int | None:
    """Return the number of the shape beneath an ink that fills a hole in it and ends under a stroke of a path and width
    around that; None if there is none that can be moved up to the stroke. boxes: (n, 4) of the shapes."""
    low, high = extent_of([hole.ring()])
    around = np.flatnonzero((boxes[:ink, :2] <= low).all(axis=1) & (boxes[:ink, 2:] >= high).all(axis=1))
    if not len(around):
        return None
    n = int(around[-1])
    ends = (low - boxes[n, :2] <= width).all() and (boxes[n, 2:] - high <= width).all()
    middle = replace(shapes[ink], outlines=(path,), stroke=None)
    return n if ends and _is_face(shapes[n]) and not _meets(shapes, boxes, range(n + 1, ink), middle) else None


def _meets(shapes: Sequence[Shape], boxes: np.ndarray, others: range, shape: Shape) -> bool:
    """Return whether a shape lies on any of some other shapes, by their numbers. boxes: (n, 4) of the shapes."""
    (left, top, right, bottom), own = boxes[others.start : others.stop].T, _boxes([shape])[0]
    near = (left < own[2]) & (top < own[3]) & (right > own[0]) & (bottom > own[1])
    if not near.any():
        return False
    window = shape.window
    covered = shape.coverage(*window)
    met = (np.minimum(covered, shapes[others[n]].coverage(*window)) for n in np.flatnonzero(near).tolist())
    return any(float(each.sum()) > SEEN for each in met)


@record
class _Trial:
    """A drawing with frames. shapes: its own; owners: (shapes,) the ink of each, -1 of what stays; before: (n,) the ink
    of each shape before; rest: the numbers of what is left of inks."""

    shapes: list[Shape]
    owners: np.ndarray
    before: np.ndarray
    rest: list[int]

    @classmethod
    def of(cls, proposals: list[_Framed], shapes: Sequence[Shape]) -> _Trial:
        """Return the drawing of some shapes with proposals in place."""
        before = np.full(len(shapes), -1)
        for proposal in proposals:
            before[proposal.numbers] = proposal.ink
        made = {n: own for proposal in proposals for n, own in proposal.made(shapes).items()}
        flat = [(n, shape) for n, whole in enumerate(shapes) for shape in made.get(n, [whole])]
        rests = {id(shape) for proposal in proposals for shape in proposal.rest}
        rest = [k for k, (_, shape) in enumerate(flat) if id(shape) in rests]
        return cls([shape for _, shape in flat], before[[n for n, _ in flat]], before, rest)

    def fitted(self, state: State, drawing: Drawing) -> State:
        """Return the state with its new strokes fitted, after that of a drawing without them."""
        goal, constraints = state.goal, Constraints(drawing.width, drawing.height)
        layers = [
            layer_of(shape, goal, [StrokeParameters.of(shape.stroke, constraints)])
            if shape.stroke and ink >= 0
            else still_layer(shape, goal)
            for shape, ink in zip(self.shapes, self.owners.tolist(), strict=True)
        ]
        return fitted_state(state.with_layers(layers), drawing)

    def lost(self, before: State, after: State, detail: float) -> tuple[np.ndarray, set[int]]:
        """Return (n,) what the frames of each ink cost in numbers, by their pixels and what is left of it; and which of
        that the pixels show."""
        lost = detail * misfit_growth(before, after, self.before, self.owners)
        if not self.rest:
            return lost, set()
        numbers = range(len(self.shapes))
        bare = after.with_layers([after.layers[k] for k in numbers if k not in self.rest])
        alone = np.array([k if k in self.rest else -1 for k in numbers])
        without = detail * misfit_growth(after, bare, alone, np.full(len(bare.layers), -1))
        kept = set[int]()
        for k in self.rest:
            price = length_of(self.shapes[k]) - SHAPE_PARAMETERS  # once for all, which are one element
            if price <= without[k]:
                kept.add(k)
            lost[self.owners[k]] += min(price, without[k])
        lost[np.unique(self.owners[[*kept]])] += SHAPE_PARAMETERS
        return lost, kept

    def made(self, after: State, kept: set[int]) -> list[Shape]:
        """Return the shapes as fitted, of what is left of inks those kept."""
        out = list[Shape]()
        for k, shape in enumerate(self.shapes):
            line = after.layers[k].outlines[0]
            if isinstance(line, StrokeParameters):
                stroke = line.stroke
                if not isinstance(stroke.path, Chain):  # which no frame is
                    out[-1] = replace(out[-1], outlines=(stroke.path,))  # of the fill that it follows
                out.append(shape.stroked(stroke))
            elif k not in self.rest or k in kept:
                out.append(shape)
        return out
