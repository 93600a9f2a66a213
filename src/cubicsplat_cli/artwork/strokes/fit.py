"""Strokes fitted to the picture: centre lines and widths optimised through the exact coverage of what they draw."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.finish.finish import State, layer_of, premultiplied, settle
from cubicsplat_cli.artwork.finish.parameters import Constraints, Parameters, Still
from cubicsplat_cli.artwork.geometry.stroke import Stroke, pieces_of
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.artwork.strokes.offset import outlines_of_stroke
from cubicsplat_cli.artwork.strokes.parameters import StrokeParameters
from cubicsplat_cli.raster.stack import Goal

FIRST_ROUNDS, LAST_ROUNDS = 24, 6
MOST_PIECES = 6000  # of centre lines

_log = logging.getLogger("cubicsplat")


def fitted_strokes(drawing: Drawing, goal: Goal) -> Drawing:
    """The drawing with its strokes fitted to its goal, all else as it is; strokes that have one width keep one."""
    strokes = [shape.stroke for shape in drawing.shapes if shape.stroke is not None]
    if not strokes:
        return drawing
    pieces = sum(stroke.path.pieces for stroke in strokes)
    if pieces > MOST_PIECES:
        _log.warning("strokes of %d pieces are many: they are not fitted to the pixels", pieces)
        return drawing
    state = settle(_state(drawing, goal, fixed=False), goal, FIRST_ROUNDS)
    tied = _with_common_widths(drawing, _strokes(state))
    return _with(tied, _strokes(settle(_state(tied, goal, fixed=True), goal, LAST_ROUNDS)))


def _state(drawing: Drawing, goal: Goal, fixed: bool) -> State:
    """The drawing against its picture; fixed: widths stay."""
    constraints = Constraints(drawing.width, drawing.height)
    layers = []
    for shape in drawing.shapes:
        outlines: list[Parameters] = [Still(outline) for outline in shape.outlines]
        if shape.stroke is not None:
            outlines = [StrokeParameters.of(shape.stroke, constraints, fixed)]
        layers.append(layer_of(shape, premultiplied(shape.fill) @ goal.space, outlines))
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
