"""The whole finish of a drawing: its pieces settled against the pixels, pieces added where those ask, settled again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from cubicsplat_cli.artwork.finish.merges import with_merges
from cubicsplat_cli.artwork.finish.moves import shorter, with_moves
from cubicsplat_cli.artwork.finish.parameters import Constraints, Parameters, parametrised
from cubicsplat_cli.artwork.finish.settle import AFTER_REFUSALS, ROUNDS, TRIAL_ROUNDS, settle
from cubicsplat_cli.artwork.finish.state import State, begin, drawn
from cubicsplat_cli.artwork.geometry.outlines import Ring
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.progress import log, nothing, work
from cubicsplat_cli.raster.stack import Goal

PASSES = 3  # of moves, and of merges, at most
# Pieces beyond which there are fewer rounds; merges only after the moves, and one pass of each; neither of the two,
# which take some ms a piece; fewer rounds still; and nothing is fitted, for its memory.
CROWDED, FULL, CHANGED, MANY, MOST = 400, 4000, 16_000, 40_000, 100_000
FEWEST_ROUNDS = 3


def polish(
    drawing: Drawing,
    goal: Goal,
    detail: float = 1.0,
    state: State | None = None,
    on_settled: Callable[[Drawing], None] = nothing,
) -> Drawing:
    """The drawing fitted to its goal; detail as in ArtworkSettings. state: the drawing against its goal, if known.
    on_settled: given the drawing once its own pieces are; what it raises ends the work.
    """
    pieces = drawing.segments
    if pieces > CHANGED:
        left = "fitted to the pixels" if pieces > MOST else "merged, cut and rounded as the pixels ask"
        log.warning("outlines of %d pieces are many: they are not %s; --min-area leaves fewer", pieces, left)
    if not 0 < pieces <= MOST:
        return drawing
    constraints = Constraints(drawing.width, drawing.height)
    at = work().at

    merged = partial(with_merges, constraints=constraints, detail=detail)

    def moved(state: State) -> State:
        return _tried(state, with_moves(state, constraints, detail), detail)

    at("fitting to the pixels", 0.5)
    state = state or begin(drawing, goal)
    with work().stoppable():
        state = settle(state, ROUNDS if pieces <= CROWDED else _trial_rounds(pieces))
        on_settled(drawn(drawing, state))
        at("merging pieces", 0.6)
        # What was traced in edges made sharp again has many pieces too many.
        if pieces <= FULL:
            state = _repeated(merged, state, PASSES if goal.reach else 1)
        at("fitting to the pixels", 0.7)
        state = _repeated(moved, state, PASSES if pieces <= FULL else 1 if pieces <= CHANGED else 0)
        state = _tried(state, _otherwise(drawing, constraints), detail)
        if pieces <= MANY:
            state = settle(state, TRIAL_ROUNDS)
        # What moves and better neighbours have made even.
        if pieces <= CHANGED:
            state = _repeated(merged, state, PASSES if pieces <= FULL else 1)
    return drawn(drawing, state)


def _trial_rounds(pieces: int) -> int:
    return TRIAL_ROUNDS if pieces <= MANY else FEWEST_ROUNDS


def _repeated(change: Callable[[State], State], state: State, passes: int) -> State:
    """The state after some passes, until one changes nothing."""
    for _ in range(passes):
        before, state = state, change(state)
        if state is before:
            break
    return state


def _otherwise(drawing: Drawing, constraints: Constraints) -> dict[int, Parameters]:
    """The closer rings of a drawing's outlines, by the number of the outline."""
    rings = [outline.otherwise if isinstance(outline, Ring) else None for s in drawing.shapes for outline in s.outlines]
    return {k: parametrised(ring, constraints) for k, ring in enumerate(rings) if ring is not None}


def _tried(state: State, others: Mapping[int, Parameters], detail: float) -> State:
    """The state with those of other outlines, by number, that pay once they are settled."""
    if not others:
        return state
    changed = np.isin(np.arange(len(state.outlines)), [*others])
    trial = settle(state.with_outlines(others), _trial_rounds(int(state.pieces[-1])), changed=changed)
    refused = shorter(state, trial, changed, detail)
    if refused.any():
        trial = settle(trial.taken_back(state, refused), AFTER_REFUSALS, changed=refused)
    return trial if not refused[changed].all() else state
