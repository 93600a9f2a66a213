"""Shapes added to a finished drawing where its picture asks for them.

Each is kept only where the description of the picture becomes shorter by it: half of chi^2 over the pixels that it
changes, against a price for every parameter, before and after it is optimised against the pixels.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from cubicsplat_cli.artwork.finish.finish import WHITE, Layer, State, begin, layer_of, premultiplied, settle
from cubicsplat_cli.artwork.finish.freedom import Still
from cubicsplat_cli.artwork.finish.moves import PRICE, SHARE_SIGMA, UNSEEN
from cubicsplat_cli.artwork.geometry.coverage import coverage, edges_of
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.restore import LUMA_CHROMA
from cubicsplat_cli.artwork.residual.areas import Sight, areas, ringing
from cubicsplat_cli.artwork.residual.proposals import Canvas, Placed, proposals
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.stack import Goal
from cubicsplat_cli.scene.paint import Ink

SHAPE_PARAMETERS = 3.0  # parameters that a shape is worth besides its outlines'
ROUNDS = 10
PASSES = 2
MOST_TRIED = 400  # areas

INK_PARAMETERS = 3.0  # of a new ink

_log = logging.getLogger("cubicsplat")


@dataclass(frozen=True)
class Change:
    """fall: of half of the misfit, by a shape; floor: what a pixel of it has by chance; price: of the shape, nats."""

    fall: float
    floor: float
    price: float


def with_added(
    drawing: Drawing,
    goal: Goal,
    condition: Condition,
    detail: float = 1.0,
    min_area: float = 0.0,
    most: int | None = None,
) -> Drawing:
    """The drawing with shapes where it does not explain its goal, a picture in some condition; the same where that
    needs none.

    detail as in ArtworkSettings. min_area: px^2 that a shape has at least; most: shapes of the drawing, or None for any
    number.
    """
    sight = Sight.of(condition, min_area)
    for _ in range(PASSES):
        added = _pass(drawing, goal, sight, detail)
        if added is drawing or (most is not None and len(added.shapes) > most):
            break
        drawing = added
    return drawing


def _pass(drawing: Drawing, goal: Goal, sight: Sight, detail: float) -> Drawing:
    if not drawing.shapes:
        return drawing
    still = [_still(shape, goal) for shape in drawing.shapes]
    before = State.of(still, goal)
    back = 255.0 * np.linalg.inv(goal.space)
    picture, painted = goal.target @ back, before.image @ back
    found = areas(picture, painted, sight)
    if not found:
        return drawing
    canvas = Canvas(drawing)
    errors = ((sight.noise + ringing((picture @ LUMA_CHROMA), sight)[..., 0]) / 255.0) ** 2
    ways: list[list[list[Placed]]] = []
    if len(found) > MOST_TRIED:
        _log.warning("%d areas differ from the picture: only the %d largest are tried", len(found), MOST_TRIED)
    for area in found[:MOST_TRIED]:
        work().at()
        ways.append(list(proposals(area, picture, painted, canvas, sight, detail)))
    new = _best(drawing, ways, still, before, goal, detail, errors)
    if not new:
        return drawing
    after = State.of(_stacked(still, [_still(each.shape, goal) for each in new], new), goal)
    changes = [_change(each.shape, before, after, goal, errors) for each in new]
    new = [
        each for each, change in zip(new, changes, strict=True) if detail * change.fall > change.floor * change.price
    ]
    layers = _stacked(still, [_still(each.shape, goal) for each in new], new)
    return replace(drawing, shapes=tuple(layer.shape for layer in layers)) if new else drawing


def _best(
    drawing: Drawing,
    ways: list[list[list[Placed]]],
    still: list[Layer],
    before: State,
    goal: Goal,
    detail: float,
    errors: np.ndarray,
) -> list[Placed]:
    """Of the ways to explain each area the one that shortens the description most, less what does not; from the back
    to the front.
    """
    tried: list[list[tuple[list[Placed], list[Change]]]] = [[] for _ in ways]
    for number in range(max(map(len, ways))):
        work().at()
        some = [(k, placed) for k, each in enumerate(ways) if number < len(each) for placed in each[number]]
        some.sort(key=lambda pair: pair[1].beneath)
        if not some:
            continue
        new = [placed for _, placed in some]
        free = begin(replace(drawing, shapes=tuple(each.shape for each in new)), goal).layers
        after = settle(State.of(_stacked(still, free, new), goal), goal, ROUNDS)
        new = _outlined(new, after)
        changes = [_change(each.shape, before, after, goal, errors) for each in new]
        for k in {k for k, _ in some}:
            own = [i for i, (area, _) in enumerate(some) if area == k]
            tried[k].append(([new[i] for i in own], [changes[i] for i in own]))
    known = {shape.ink for shape in drawing.shapes}
    best = [_shortest(each, known, detail) for each in tried]
    return sorted((placed for some in best for placed in some), key=lambda each: each.beneath)


def _shortest(ways: list[tuple[list[Placed], list[Change]]], known: set[Ink], detail: float) -> list[Placed]:
    """The way that shortens the description most, less the shapes that do not; none where none does.

    known: inks that the drawing has already.
    """
    floor = max((change.floor for _, changes in ways for change in changes), default=0.0)
    most, best = 0.0, list[Placed]()
    for shapes, changes in ways:
        nets = [detail * change.fall / floor - change.price for change in changes]
        good = [each for each, net in zip(shapes, nets, strict=True) if net > 0.0]
        new = {each.shape.ink for each in good} - known
        total = sum(net for net in nets if net > 0.0) - PRICE * INK_PARAMETERS * len(new)
        if total > most:
            most, best = total, good
    return best


def _outlined(new: list[Placed], state: State) -> list[Placed]:
    """The new shapes with the outlines that they have in a state."""
    own = {id(each.shape) for each in new}
    layers = [layer for layer in state.layers if id(layer.shape) in own]
    return [
        replace(each, shape=replace(each.shape, outlines=tuple(o.outline() for o in layer.outlines)))
        for each, layer in zip(new, layers, strict=True)
    ]


def _stacked(still: list[Layer], free: list[Layer], new: list[Placed]) -> list[Layer]:
    """The layers with each new one right above the one that it lies on."""
    out, following = [], 0
    for number in range(-1, len(still)):
        if number >= 0:
            out.append(still[number])
        while following < len(new) and new[following].beneath == number:
            out.append(free[following])
            following += 1
    return out


def _still(shape: Shape, goal: Goal) -> Layer:
    """The layer of a shape that stays as it is."""
    return layer_of(shape, premultiplied(shape.ink) @ goal.space, [Still(outline) for outline in shape.outlines])


def _change(shape: Shape, before: State, after: State, goal: Goal, errors: np.ndarray) -> Change:
    """What a shape changes from one state to the other."""
    price = PRICE * (SHAPE_PARAMETERS + sum(outline.parameters for outline in shape.outlines))
    rings = shape.oriented()
    cubics = np.concatenate([ring.cubics for ring in rings])
    points = cubics.reshape(-1, 2)
    height, width = before.image.shape[:2]
    reach = goal.reach
    x0, y0 = np.maximum(np.floor(points.min(axis=0)).astype(int) - reach, 0).tolist()
    x1, y1 = np.minimum(np.ceil(points.max(axis=0)).astype(int) + reach, [width, height]).tolist()
    if x1 <= x0 or y1 <= y0:
        return Change(0.0, UNSEEN, price)
    edges = edges_of(cubics, np.concatenate([ring.lines for ring in rings]))
    own = coverage(edges, y0, x0, y1 - y0, x1 - x0) > 0.0
    if reach:
        own = ndimage.binary_dilation(own, np.ones((3, 3)), reach)
    window = slice(y0, y1), slice(x0, x1)
    if not own.any():
        return Change(0.0, UNSEEN, price)
    slope = (premultiplied(shape.ink) @ goal.space - before.image[window][own]) * WHITE
    floor = SHARE_SIGMA**2 * float((slope**2).sum(axis=1).mean()) + float(errors[window][own].mean())
    change = before.misfit.reshape(height, width)[window] - after.misfit.reshape(height, width)[window]
    return Change(0.5 * float(change[own].sum()), max(floor, UNSEEN), price)
