"""The free parameters of a stroke, centre line and width, and how the outline that it covers moves with them; strokes
fitted to the picture through the exact coverage of what they draw.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.finish.parameters import Constraints, Parameters, Still, parametrised
from cubicsplat_cli.artwork.finish.settle import settle
from cubicsplat_cli.artwork.finish.state import State, layer_of
from cubicsplat_cli.artwork.geometry.outlines import Outline
from cubicsplat_cli.artwork.geometry.stroke import Chain, Stroke, pieces_of
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.artwork.strokes.offset import outlines_of_stroke, plan_of
from cubicsplat_cli.artwork.tracing.variables import Pieces
from cubicsplat_cli.progress import log
from cubicsplat_cli.raster.cubics import tied_coordinates
from cubicsplat_cli.raster.sparse import SparseRows
from cubicsplat_cli.raster.stack import Goal
from cubicsplat_cli.raster.strokes import STEP

LEAST_WIDTH, MOST_WIDER = 0.1, 0.5  # px, of a stroke, and in a step
FIRST_ROUNDS, LAST_ROUNDS = 24, 6
MOST_PIECES = 6000  # of centre lines


class ChainParameters:
    """An open centre line: its anchors, the directions of smooth joints, handle lengths, and handles at corners."""

    def __init__(self, pieces: Pieces) -> None:
        self.pieces = pieces
        self.cubics, self.lines = pieces.cubics, pieces.lines

    @classmethod
    def of(cls, chain: Chain) -> ChainParameters:
        """That of a chain; lines that are exactly level or upright stay so."""
        nothing = np.zeros((1, 2))
        outgoing = np.concatenate([chain.controls[:, 0] - chain.anchors[:-1], nothing])
        incoming = np.concatenate([nothing, chain.controls[:, 1] - chain.anchors[1:]])
        tied = tied_coordinates(chain.anchors, chain.lines)
        level = np.zeros(len(chain.anchors), dtype=bool)
        pieces = Pieces(chain.anchors, incoming, outgoing, chain.lines, chain.smooth, level, tied)
        return cls(pieces.moved(np.zeros(pieces.joints.variables)))

    @property
    def jacobian(self) -> SparseRows:
        """(8 S, variables)."""
        return self.pieces.jacobian

    def moved(self, step: np.ndarray) -> ChainParameters:
        """The line after a step."""
        return ChainParameters(self.pieces.moved(step))

    def chain(self) -> Chain:
        """The line as it stands."""
        p = self.pieces
        return Chain(p.anchors, self.cubics[:, 1:3].copy(), p.lines.copy(), p.smooth.copy())


class StrokeParameters:
    """A stroke, as a parametrisation of the whole outline that it covers (`finish.Parameters`), holes run the other
    way.

    The last variable is its width, unless that is fixed.
    """

    def __init__(self, stroke: Stroke, line: ChainParameters | Parameters, fixed: bool = False) -> None:
        self.line, self.fixed, self._stroke = line, fixed, stroke
        self.plan = plan_of(line.cubics, line.lines, stroke)
        found = self.plan.outline(line.cubics, 0.5 * stroke.width)
        self.cubics, self.lines = found.cubics, found.lines

    @classmethod
    def of(cls, stroke: Stroke, constraints: Constraints, fixed: bool = False) -> StrokeParameters:
        """That of a stroke; fixed: its width stays."""
        path = stroke.path
        line = ChainParameters.of(path) if isinstance(path, Chain) else parametrised(path, constraints)
        return cls(stroke, line, fixed)

    @property
    def stroke(self) -> Stroke:
        """The stroke as it stands."""
        path = self.line.chain() if isinstance(self.line, ChainParameters) else self.line.outline()
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
            stroke = replace(stroke, width=max(stroke.width + wider, LEAST_WIDTH))
        return StrokeParameters(stroke, self.line.moved(own), self.fixed)

    def outline(self) -> Outline:
        """The outer one of its outlines."""
        return outlines_of_stroke(self.stroke)[0]


def fitted_strokes(drawing: Drawing, goal: Goal) -> Drawing:
    """The drawing with its strokes fitted to its goal, all else as it is; strokes that have one width keep one."""
    strokes = [shape.stroke for shape in drawing.shapes if shape.stroke is not None]
    if not strokes:
        return drawing
    pieces = sum(stroke.path.pieces for stroke in strokes)
    if pieces > MOST_PIECES:
        log.warning("strokes of %d pieces are many: they are not fitted to the pixels", pieces)
        return drawing
    state = settle(_state(drawing, goal, fixed=False), FIRST_ROUNDS)
    tied = _with_common_widths(drawing, _strokes(state))
    return _with(tied, _strokes(settle(_state(tied, goal, fixed=True), LAST_ROUNDS)))


def _state(drawing: Drawing, goal: Goal, fixed: bool) -> State:
    """The drawing against its picture; fixed: widths stay."""
    constraints = Constraints(drawing.width, drawing.height)
    layers = []
    for shape in drawing.shapes:
        outlines: list[Parameters] = [Still(outline) for outline in shape.outlines]
        if shape.stroke is not None:
            outlines = [StrokeParameters.of(shape.stroke, constraints, fixed)]
        layers.append(layer_of(shape, goal, outlines))
    return State.of(layers, goal)


def _strokes(state: State) -> list[Stroke]:
    return [o.stroke for layer in state.layers for o in layer.outlines if isinstance(o, StrokeParameters)]


def _with(drawing: Drawing, strokes: list[Stroke]) -> Drawing:
    """The drawing with its strokes replaced by these, in their order."""
    following = iter(strokes)
    shapes = []
    for shape in drawing.shapes:
        if shape.stroke is not None:
            stroke = next(following)
            shape = replace(shape, outlines=outlines_of_stroke(stroke), stroke=stroke)
        shapes.append(shape)
    return replace(drawing, shapes=tuple(shapes))


def _with_common_widths(drawing: Drawing, fitted: list[Stroke]) -> Drawing:
    """The drawing with fitted strokes, those that had one width before of their mean one by length."""
    before = np.array([shape.stroke.width for shape in drawing.shapes if shape.stroke is not None])
    lengths = np.array([np.hypot(*np.diff(pieces_of(stroke.path)[0], axis=1).T).sum() for stroke in fitted])
    widths = np.array([stroke.width for stroke in fitted])
    for width in np.unique(before):
        own = before == width
        widths[own] = np.average(widths[own], weights=lengths[own] + 1e-9)
    return _with(drawing, [replace(stroke, width=float(width)) for stroke, width in zip(fitted, widths, strict=True)])
