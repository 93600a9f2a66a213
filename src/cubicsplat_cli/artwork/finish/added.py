"""Shapes added to a finished drawing where its picture asks for them.

Each is kept only where the description of the picture becomes shorter by it: half of chi^2 over the pixels that it
changes, against a price for every parameter, before and after it is optimised against the pixels.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.finish.proposals import MARGIN, Area, Canvas, Placed, TargetPicture, areas, proposals
from cubicsplat_cli.artwork.finish.settle import PASSES, ROUNDS, settle
from cubicsplat_cli.artwork.finish.simpler import tolerant, without_shapes
from cubicsplat_cli.artwork.finish.state import UNSEEN, WHITE, Layer, State, layers_of, premultiplied, still_layer
from cubicsplat_cli.artwork.input.chroma import LUMA_CHROMA
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.palette import UNLIKE
from cubicsplat_cli.artwork.shapes import FILL_PARAMETERS, PRICE, SHAPE_PARAMETERS, Drawing, Shape
from cubicsplat_cli.progress import log, work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.stack import Goal
from cubicsplat_cli.record import record

CROWDED = 2000  # one pass where there are more shapes, of which each takes five seconds and more
MOST_TRIED = 4000  # areas
SEEN = 60  # px of an area that is worth a note
LEFT = 0.5  # share of the squared error that shapes may leave which explain it in no fewer areas than before


def with_added(
    drawing: Drawing, goal: Goal, condition: Condition, detail: float, min_area: float = 0.0, most: int | None = None
) -> Drawing:
    """The drawing with shapes where it does not explain its goal, a picture in some condition, and without those that
    explain less than they cost.

    detail as in ArtworkSettings. min_area: px^2 that a shape has at least; most: shapes of the drawing, None for any.
    """
    if not drawing.shapes:
        return drawing
    picture = TargetPicture.of(goal.target @ _back(goal), condition, min_area)
    trials = _Trials(drawing, goal, picture, detail)
    for _ in range(PASSES if len(drawing.shapes) <= CROWDED else 1):
        added = trials.best()
        if added is trials.drawing or (most is not None and len(added.shapes) > most):
            break
        after = _Trials(added, goal, picture, detail, trials)
        if len(after.found) >= len(trials.found) and after.error > LEFT * trials.error:
            break  # such as the colour fringes of text for an LCD: shapes do not explain what is there
        trials = after
    left = [area.size for area in trials.found if area.size >= SEEN]
    if left:
        log.warning("areas that differ visibly from the picture: %d, of %d px in all", len(left), sum(left))
    # Without anti-aliasing, a dot of one pixel may be meant.
    if condition.aliased:
        return trials.drawing
    # Since neighbours have moved, and noise makes specks, not every shape pays for itself.
    state = trials.before if condition.clean else State(trials.still, tolerant(goal))
    kept = without_shapes(state, detail, {})
    if len(kept.layers) == len(trials.still):
        return trials.drawing
    return replace(trials.drawing, shapes=tuple(layer.shape for layer in kept.layers))


@record
class _Change:
    """Effect of a new shape. fall: of half of the misfit; floor: what a pixel of it has by chance; price: nats."""

    fall: float
    floor: float
    price: float


@record
class _Explanation:
    """New shapes that explain an area, and what each changes. fall: of half of the misfit of the area."""

    shapes: list[tuple[Placed, _Change]]
    fall: float


class _Trials:
    """New shapes tried in a drawing, whose own stay as they are. previous: in one with most of its shapes, or None."""

    def __init__(
        self, drawing: Drawing, goal: Goal, picture: TargetPicture, detail: float, previous: _Trials | None = None
    ) -> None:
        self.drawing, self.goal, self.picture, self.detail = drawing, goal, picture, detail
        known = {id(layer.shape): layer for layer in previous.still} if previous is not None else {}
        self.still: list[Layer] = [known.get(id(shape)) or still_layer(shape, goal) for shape in drawing.shapes]
        self.before: State = State(self.still, goal, previous.before if previous is not None else None)
        self.size = self.before.image.shape[:2]
        self.fills = {shape.fill for shape in drawing.shapes}
        self.painted = self.before.image @ _back(goal)
        self.found = areas(picture, self.painted)
        self.error = sum(area.weight for area in self.found)

    def best(self) -> Drawing:
        """The drawing with those that shorten the description; the same without any."""
        found = self.found
        if len(found) > MOST_TRIED:
            log.warning("%d areas differ from the picture: only the %d largest are tried", len(found), MOST_TRIED)
            found = found[:MOST_TRIED]
        ways = self._explanations(found)
        new = self._in_few_fills([each for some in ways for each in self._shortest(some)])
        if new:
            new = [each for each, change in self._tried(new, 0)[0] if self._net(change, change.floor) > 0.0]
        if not new:
            return self.drawing
        # Each new one lies right above the one that it lies on.
        every = [*enumerate(self.drawing.shapes), *((each.beneath, each.shape) for each in new)]
        return replace(self.drawing, shapes=tuple(shape for _, shape in sorted(every, key=lambda pair: pair[0])))

    def _in_few_fills(self, new: list[Placed]) -> list[Placed]:
        """New shapes of areas, the worst first, in the order in which they are drawn. A fill that is not unlike one of
        the drawing, or of an earlier one, is that: a JPEG shows one fill of thin lines in many ways.
        """
        fills, out = [shape.fill for shape in self.drawing.shapes if shape.gradient is None], list[Placed]()
        for each in new:
            off = np.abs((np.array(fills, dtype=float).reshape(-1, 4) - each.shape.fill) @ LUMA_CHROMA).max(axis=1)
            if off.min(initial=UNLIKE) < UNLIKE:
                fill, (height, width) = fills[int(off.argmin())], self.size
                each = replace(each, shape=each.shape.filled(fill, width, height))
            else:
                fills.append(each.shape.fill)
            out.append(each)
        return sorted(out, key=lambda each: each.beneath)

    def _explanations(self, found: list[Area]) -> list[list[_Explanation]]:
        """The ways to explain each area, the first ones of all areas tried together, and so on."""
        canvas = Canvas(self.drawing, self.before.stack, self.painted)
        proposed: list[list[list[Placed]]] = []
        for area in found:
            work().at()
            proposed.append(list(proposals(area, self.picture, canvas, self.detail)))
        out: list[list[_Explanation]] = [[] for _ in found]
        for number in range(max(map(len, proposed), default=0)):
            some = [(k, each) for k, ways in enumerate(proposed) if number < len(ways) for each in ways[number]]
            some.sort(key=lambda pair: pair[1].beneath)
            if not some:
                continue
            tried, falls = self._tried([each for _, each in some], ROUNDS)
            shapes: dict[int, list[tuple[Placed, _Change]]] = defaultdict(list)
            for (k, _), each in zip(some, tried, strict=True):
                shapes[k].append(each)
            for k, own in shapes.items():
                around = ndimage.binary_dilation(found[k].mask, ndimage.SQUARE, MARGIN)
                out[k].append(_Explanation(own, float(falls[found[k].window][around].sum())))
        return out

    def _tried(self, new: list[Placed], rounds: int) -> tuple[list[tuple[Placed, _Change]], np.ndarray]:
        """New shapes after so many rounds and what each changes, and by how much half of the misfit falls, (H, W)."""
        shapes = tuple(each.shape for each in new)
        if rounds:
            layers = layers_of(replace(self.drawing, shapes=shapes), self.goal)
        else:
            layers = [still_layer(shape, self.goal) for shape in shapes]
        over = self.before.stack, np.array([each.beneath for each in new], np.int32)
        after = settle(State(layers, self.goal, over=over), rounds)
        new = [replace(placed, shape=layer.drawn()) for placed, layer in zip(new, after.layers, strict=True)]
        falls = 0.5 * (self.before.misfit - after.misfit).reshape(self.size)
        return [(each, self._change(each.shape, falls)) for each in new], falls

    def _change(self, shape: Shape, falls: np.ndarray) -> _Change:
        window, own = _changed(shape, self.goal.reach, self.size)
        price = PRICE * (SHAPE_PARAMETERS + sum(outline.parameters for outline in shape.outlines))
        if not own.any():
            return _Change(0.0, UNSEEN, price)
        errors = self.picture.condition.noise + self.picture.ringing[window][own][:, 0]
        slope = (premultiplied(shape.fill) @ self.goal.space - self.before.image[window][own]) * WHITE
        floor = self.goal.share_error**2 * float((slope**2).sum(axis=1).mean()) + float(((errors / 255.0) ** 2).mean())
        return _Change(float(falls[window][own].sum()), max(floor, UNSEEN), price)

    def _net(self, change: _Change, floor: float) -> float:
        """Nats by which a shape shortens the description, where a pixel has so much misfit by chance."""
        return self.detail * change.fall / floor - change.price

    def _shortest(self, ways: list[_Explanation]) -> list[Placed]:
        """The shapes of the way that shortens the description most, less those that do not; none where none does."""
        good = [(way, floor) for way in ways if self._gain(way, floor := _floor(way))[0] > 0.0]
        if not good:
            return []
        # With the same misfit by chance for all, as the fainter of two fills has less of it.
        common = max(floor for _, floor in good)
        return self._gain(*max(good, key=lambda each: self._gain(each[0], common)[0]))[1]

    def _gain(self, way: _Explanation, floor: float) -> tuple[float, list[Placed]]:
        """Nats by which a way shortens the description, and its shapes that do."""
        good = [(each, change) for each, change in way.shapes if self._net(change, floor) > 0.0]
        new = {each.shape.fill for each, _ in good} - self.fills
        price = sum(change.price for _, change in good) + PRICE * FILL_PARAMETERS * len(new)
        # What two of its shapes change is theirs once.
        fall = min(way.fall, sum(change.fall for _, change in good))
        return (self.detail * fall / floor - price if good else 0.0), [each for each, _ in good]


def _back(goal: Goal) -> np.ndarray:
    """(4, 4) what brings a goal's coordinates to levels of RGBA."""
    return np.asarray(255.0 * np.linalg.inv(goal.space))


def _floor(way: _Explanation) -> float:
    """The misfit by chance of a pixel of new shapes: their mean, by what they explain."""
    falls = [max(change.fall, UNSEEN) for _, change in way.shapes]
    return float(np.average([change.floor for _, change in way.shapes], weights=falls))


def _changed(shape: Shape, reach: int, size: tuple[int, ...]) -> tuple[tuple[slice, slice], np.ndarray]:
    """The window of a canvas (rows, columns) that a shape blurred to `reach` px changes, and its pixels (h, w) bool."""
    window, share = shape.covered(size, reach)
    return window, ndimage.binary_dilation(share > 0.0, ndimage.SQUARE, reach) if reach else share > 0.0
