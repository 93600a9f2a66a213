"""Regularities of a finished drawing: coordinates on the artist's grid, ellipses that are circles, rings that are their
own mirror images, and copies.

Each is taken where the outlines as they were fitted say so within their errors, tied, settled against the pixels once
more, and kept only where the description of the picture becomes shorter by it: half of chi^2 may grow by less than the
price of the variables that are saved.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.finish.merges import Visibility
from cubicsplat_cli.artwork.finish.parameters import (
    LEAST,
    MEAN_ERROR,
    NO_PINS,
    Constraints,
    CopyParameters,
    Parameters,
    PrimitiveParameters,
    parametrised,
)
from cubicsplat_cli.artwork.finish.settle import AFTER_REFUSALS, TRIAL_ROUNDS, settle
from cubicsplat_cli.artwork.finish.state import State, begin, drawn, layer_of
from cubicsplat_cli.artwork.geometry.fitting import SYSTEMATIC
from cubicsplat_cli.artwork.geometry.outlines import FINE, Circle, Ellipse, Ring, level_box
from cubicsplat_cli.artwork.geometry.steps import suggested_precision
from cubicsplat_cli.artwork.limits import few_enough
from cubicsplat_cli.artwork.regularities.alike import FARTHEST, Track, found_copies
from cubicsplat_cli.artwork.regularities.grid import on_grid
from cubicsplat_cli.artwork.regularities.mirrored import as_mirrored, axes_of
from cubicsplat_cli.artwork.shapes import PRICE, Drawing
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.stack import Goal


def regularised(drawing: Drawing, goal: Goal, detail: float = 1.0, grid: int = 0) -> Drawing:
    """The drawing with its regularities, fitted to its goal, unless it is too large; detail as in ArtworkSettings.

    grid: the picture was drawn with grid x grid samples a pixel, or (0) with true areas.
    """
    if not drawing.shapes or not few_enough(drawing):
        return drawing
    work().at("regularising", 0.8)
    state = begin(drawing, goal)
    done, pins = on_grid(drawing, state, 1.0 / grid if grid else 0.0)
    if pins != NO_PINS:
        state = settle(begin(done, replace(goal, grid=grid), pins), TRIAL_ROUNDS)
    constraints = Constraints(drawing.width, drawing.height, pins)
    state = with_circles(state, constraints, detail)
    state = with_symmetries(state, constraints, detail)
    state = with_copies(state, constraints, detail)
    return drawn(done, state)


def with_circles(state: State, constraints: Constraints, detail: float) -> State:
    """The state with the ellipses that hardly are none made circles; the same without any."""
    tied: dict[int, Parameters] = {}
    for k, parameters in enumerate(state.outlines):
        one = parameters.outline()
        if isinstance(one, Ellipse) and abs(one.rx - one.ry) <= 2.0 * FARTHEST:
            tied[k] = parametrised(Circle(one.cx, one.cy, 0.5 * (one.rx + one.ry)), constraints)
    return _tied(state, tied, detail)


def with_symmetries(state: State, constraints: Constraints, detail: float) -> State:
    """Return the state with the rings that are their own mirror images made and kept such; the same without any."""
    rings = {
        k: ring
        for k, o in enumerate(state.outlines)
        if isinstance(ring := o.outline(), Ring) and not level_box(ring, LEAST)
    }
    tracks = {k: Track.of(ring, Visibility.of(state, k)) for k, ring in rings.items()}
    axes = axes_of(tracks, (constraints.width, constraints.height))
    mirrored = {k: as_mirrored(rings[k], axis, constraints) for k, axis in axes.items()}
    return _tied(state, {k: parameters for k, parameters in mirrored.items() if parameters is not None}, detail)


def with_copies(state: State, constraints: Constraints, detail: float) -> State:
    """The state with the outlines that are like another one, moved or mirrored, made and kept such."""
    outlines, size = state.outlines, (constraints.width, constraints.height)
    tracks = {}
    for k, parameters in enumerate(outlines):
        if not parameters.jacobian.count:
            continue
        track = Track.of(parameters.outline().ring(FINE), Visibility.of(state, k))
        inside = (track.extent[0] > MEAN_ERROR).all() and (track.extent[1] < np.array(size) - MEAN_ERROR).all()
        # What is held on the border would not stay there; primitives are held by their numbers alone.
        if inside or isinstance(parameters, PrimitiveParameters):
            tracks[k] = track
    order = sorted(tracks, key=lambda k: (outlines[k].jacobian.count, k))
    copies = found_copies({k: tracks[k] for k in order}, 10.0 ** -suggested_precision(*size), size)
    tied = {k: CopyParameters(outlines[model], transform, model) for k, (model, transform) in copies.items()}
    return _tied(state, tied, detail)


def _tied(state: State, tied: Mapping[int, Parameters], detail: float) -> State:
    """The state with some outlines tied, less those that cost more than they save: of a model and its copies, where
    these do together, first the copies that do, and then all that are left."""
    if not tied:
        return state
    # The others rest where they are settled already, until the picture beneath them changes.
    trial = settle(_with(state, tied), TRIAL_ROUNDS, trim=False, changed=np.isin(range(len(state.outlines)), [*tied]))
    # What has been a copy before stays one of whatever its model becomes.
    new = [isinstance(tied.get(k), CopyParameters) and _variables(old) > 0 for k, old in enumerate(state.outlines)]
    copies = np.array(new)
    for able in (copies, np.ones_like(copies)):
        families, saved = _saved(state, trial, tied, detail)
        refused = able & (np.bincount(families, saved, len(saved))[families] < 0.0)
        if able is copies:
            refused &= saved < 0.0
        if refused.any():
            back = _with(trial, {k: state.outlines[k] for k in np.flatnonzero(refused).tolist()})
            trial = settle(back, AFTER_REFUSALS, trim=False, changed=refused)
            tied = {k: parameters for k, parameters in tied.items() if not refused[k]}
    return trial


def _saved(state: State, trial: State, tied: Mapping[int, Parameters], detail: float) -> tuple[np.ndarray, np.ndarray]:
    """Return for each outline the number of the model that it follows, or its own, and the nats that its ties save.

    Outlines are off by SYSTEMATIC px besides by chance, alike along their length; what a tie moves them so far is free.
    """
    outlines = state.outlines
    families, saved = np.arange(len(outlines)), np.zeros(len(outlines))
    for k, parameters in tied.items():
        saved[k] = PRICE * (_variables(outlines[k]) - _variables(parameters))
        if isinstance(parameters, CopyParameters):
            families[k] = parameters.source
    wanted = np.zeros(len(outlines), dtype=bool)
    wanted[[*tied, *families[list(tied)].tolist()]] = True
    gained = state.gains(trial, wanted)
    for k in np.flatnonzero(wanted).tolist():
        crossed = int(state.marks[k + 1] - state.marks[k])
        known = 1.0 - state.goal.error**2 / state.floors[k]
        allowed = 0.5 * crossed * known * (SYSTEMATIC / state.goal.share_error) ** 2
        saved[k] += (gained[k] + allowed) * detail
    return families, saved


def _variables(parameters: Parameters) -> int:
    """The number of an outline's own variables."""
    return 0 if isinstance(parameters, CopyParameters) else parameters.jacobian.count


def _with(state: State, tied: Mapping[int, Parameters]) -> State:
    """The state with other freedoms for the outlines of some numbers."""
    layers = state.layers_with(tied)
    for n in {state.places[k][0] for k in tied}:
        layers[n] = layer_of(layers[n].shape, state.goal, layers[n].outlines)
    return state.with_layers(layers)
