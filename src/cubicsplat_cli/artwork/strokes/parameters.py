"""The free parameters of a stroke, centre line and width, and how the outline that it covers moves with them; strokes
fitted to the picture through the exact coverage of what they draw.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from functools import cached_property
from itertools import chain

import numpy as np

from cubicsplat_cli.artwork.finish.parameters import Constraints, Parameters, parametrised
from cubicsplat_cli.artwork.finish.settle import TRIAL_ROUNDS, settle
from cubicsplat_cli.artwork.finish.state import Layer, State, layer_of, still_layer
from cubicsplat_cli.artwork.geometry.fitting import PRECISION
from cubicsplat_cli.artwork.geometry.outlines import Outline, polygon_lengths
from cubicsplat_cli.artwork.geometry.stroke import Chain, Stroke, outlines_of_stroke, pieces_of, pieces_of_chain
from cubicsplat_cli.artwork.limits import MOST_COMPLETED
from cubicsplat_cli.artwork.shapes import PRICE, Drawing, Shape
from cubicsplat_cli.artwork.strokes.find import PEN, by_pens, length_of
from cubicsplat_cli.progress import log
from cubicsplat_cli.raster.cubics import Pieces
from cubicsplat_cli.raster.sparse import SparseRows
from cubicsplat_cli.raster.stack import Goal
from cubicsplat_cli.raster.strokes import STEP
from cubicsplat_cli.scene.paint import Rgba

MOST_WIDER = 0.5  # px, of a stroke in a step


class StrokeParameters:
    """A stroke, as a parametrisation of the whole outline that it covers (`finish.Parameters`), holes the other way.
    The last variable is its width, unless that is fixed.
    """

    def __init__(self, stroke: Stroke, line: Pieces | Parameters, fixed: bool = False) -> None:
        self.line, self.fixed, self._stroke = line, fixed, stroke
        self.plan = stroke.plan(line.cubics, line.lines)
        found = self.plan.outline(line.cubics, 0.5 * stroke.width)
        self.cubics, self.lines = found.cubics, found.lines

    @classmethod
    def of(cls, stroke: Stroke, constraints: Constraints, fixed: bool = False) -> StrokeParameters:
        """Return the parameters of a stroke; fixed: its width stays."""
        path = stroke.path
        line = pieces_of_chain(path) if isinstance(path, Chain) else parametrised(path, constraints)
        return cls(stroke, line, fixed)

    @property
    def stroke(self) -> Stroke:
        """The stroke as it stands."""
        path = Chain.of(self.line) if isinstance(self.line, Pieces) else self.line.outline()
        return replace(self._stroke, path=path)

    @cached_property
    def jacobian(self) -> SparseRows:
        """(8 pieces of the outline, variables): by the control points of the centre line, times how these move."""
        half = 0.5 * self._stroke.width
        centre = self.plan.slopes(self.line.cubics, half, len(self.cubics)).after(self.line.jacobian)
        if self.fixed:
            return centre
        wider = (self.plan.outline(self.line.cubics, half + 0.5 * STEP).cubics - self.cubics).ravel() / STEP
        count, rows = centre.count, np.arange(wider.size)
        columns, values = np.append(centre.columns, np.full(len(rows), count)), np.append(centre.values, wider)
        return SparseRows.of(np.append(centre.rows, rows), columns, values, (len(rows), count + 1))

    def moved(self, step: np.ndarray) -> StrokeParameters:
        """The stroke after a step of its variables."""
        stroke, own = self._stroke, step
        if not self.fixed:
            own = step[:-1]
            wider = float(np.clip(step[-1], -MOST_WIDER, MOST_WIDER))
            stroke = replace(stroke, width=max(stroke.width + wider, PRECISION))
        return StrokeParameters(stroke, self.line.moved(own), self.fixed)

    def outline(self) -> Outline:
        """The outer one of its outlines."""
        return outlines_of_stroke(self.stroke)[0]


def fitted_strokes(drawing: Drawing, goal: Goal) -> Drawing:
    """The drawing with its strokes fitted to its goal, all else as it is; strokes that have one width keep one."""
    state = State(_layers(drawing, drawing.shapes, goal), goal)
    fitted = fitted_state(state, drawing)
    return drawing if fitted is state else replace(drawing, shapes=tuple(map(_drawn, fitted.layers)))


def shorter_strokes(drawing: Drawing, strokes: list[tuple[Shape, ...]], goal: Goal, detail: float) -> Drawing:
    """The drawing with the strokes of those shapes, fitted to its goal, that make the whole description shorter.
    strokes: of each shape, or the shape itself. detail: as in ArtworkSettings.
    """
    tried = np.array([own[0].stroke is not None for own in strokes])
    groups = np.where(tried, np.arange(len(strokes)), -1)
    saved = [length_of(shape) - length_of(*own) for shape, own in zip(drawing.shapes, strokes, strict=True)]
    still = _layers(drawing, drawing.shapes, goal)
    parts = [_layers(drawing, strokes[n], goal) if own else [still[n]] for n, own in enumerate(tried.tolist())]
    before = State(still, goal)
    after = fitted_state(before.with_layers([*chain.from_iterable(parts)]), drawing)
    owners = np.repeat(np.arange(len(parts)), [len(own) for own in parts])
    pays = tried & (np.array(saved) > detail * misfit_growth(before, after, groups, groups[owners]))
    shapes: list[Shape] = []
    for n in range(len(parts)):
        own = [after.layers[k] for k in np.flatnonzero(owners == n)] if pays[n] else [still[n]]
        shapes += map(_drawn, own)
    return replace(drawing, shapes=tuple(shapes))


def with_shared_pens(drawing: Drawing, goal: Goal, detail: float) -> Drawing:
    """The drawing with rings of circles as strokes, and bars that share a pen with others, where the description gets
    shorter: a pen's style and width cost nothing but once. All stay where they are. detail: as in ArtworkSettings.
    """
    shapes, strokes = [*drawing.shapes], by_pens(drawing.shapes)
    if not strokes:
        return drawing
    trials = [shape.stroked(strokes[n][0]) if n in strokes else shape for n, shape in enumerate(shapes)]
    # By their outlines: as a stroke that may move, a ring would be one loop around both of its sides.
    before = State([still_layer(shape, goal) for shape in shapes], goal)
    after = before.with_layers([still_layer(shape, goal) for shape in trials])
    groups = np.array([n if n in strokes else -1 for n in range(len(shapes))])
    # None is to be a stroke since its pixels happen to be nearer.
    lost = np.maximum(detail * misfit_growth(before, after, groups, groups), 0.0)
    gains = {n: length_of(shapes[n]) - length_of(trials[n]) + PEN - float(lost[n]) for n in strokes}
    # Those of a pen that there is not yet must pay for it together.
    together = defaultdict[tuple[Rgba, float], float](float)
    for n, (stroke, shared) in strokes.items():
        together[shapes[n].fill, stroke.width] += math.inf if shared else max(gains[n], 0.0)
    for n, (stroke, _) in strokes.items():
        if gains[n] > 0.0 and together[shapes[n].fill, stroke.width] > PEN:
            shapes[n] = trials[n]
    return replace(drawing, shapes=tuple(shapes))


def misfit_growth(before: State, after: State, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return (L,) by how much the misfit grows where layers change, as numbers of a description.

    here: (L,) the group of each layer before, which is the number of one of them, or -1 if it stays; there: (M,) of
    each layer after."""
    outlines = (np.array([n for n, _ in state.places])[state.owners] for state in (before, after))
    group, other = (groups[own].astype(int) for groups, own in zip((here, there), outlines, strict=True))
    growth = before.stack.growth(after.stack, group, other, len(here), before.spread)
    first = np.cumsum([0, *(len(layer.outlines) for layer in before.layers[:-1])])
    return 0.5 * growth / (PRICE * before.floors[first])


def _layers(drawing: Drawing, shapes: Iterable[Shape], goal: Goal) -> list[Layer]:
    """Layers of a drawing's shapes, of which only strokes are free."""
    constraints = Constraints(drawing.width, drawing.height)
    return [
        layer_of(s, goal, [StrokeParameters.of(s.stroke, constraints)]) if s.stroke else still_layer(s, goal)
        for s in shapes
    ]


def _drawn(layer: Layer) -> Shape:
    """The shape of a layer, as its stroke stands."""
    own = layer.outlines[0]
    return layer.shape.stroked(own.stroke) if isinstance(own, StrokeParameters) else layer.shape


def fitted_state(state: State, drawing: Drawing) -> State:
    """The state with its strokes fitted: first their widths too, then all of those that were alike in their mean one by
    length. Itself where these have very many pieces.
    """
    free = np.array([isinstance(outline, StrokeParameters) for outline in state.outlines])
    before = {k: own.stroke for k, own in enumerate(state.outlines) if isinstance(own, StrokeParameters)}
    pieces = sum(stroke.path.pieces for stroke in before.values())
    if pieces > MOST_COMPLETED:
        log.warning("strokes of %d pieces are many: they are not fitted to the pixels", pieces)
    if not 0 < pieces <= MOST_COMPLETED:
        return state
    state = settle(state, changed=free)
    fitted = [own.stroke for own in state.outlines if isinstance(own, StrokeParameters)]
    lengths = np.array([polygon_lengths(pieces_of(stroke.path)[0]).sum() for stroke in fitted])
    _, alike = np.unique([stroke.width for stroke in before.values()], return_inverse=True)
    totals = np.bincount(alike, lengths + 1e-9)
    widths = np.bincount(alike, (lengths + 1e-9) * [stroke.width for stroke in fitted]) / totals
    constraints = Constraints(drawing.width, drawing.height)
    tied = {
        k: StrokeParameters.of(replace(stroke, width=float(widths[group])), constraints, fixed=True)
        for k, stroke, group in zip(before, fitted, alike.tolist(), strict=True)
    }
    return settle(state.with_outlines(tied), TRIAL_ROUNDS, changed=free)
