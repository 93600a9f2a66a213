"""The whole finish of a drawing: its pieces settled against the pixels, pieces added where those ask, settled again."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.finish import ROUNDS, State, begin, drawn, kept, settle
from cubicsplat_cli.artwork.moves import shorter, with_moves
from cubicsplat_cli.artwork.shapes import Drawing

# Passes of moves, one where there are more than CROWDED pieces (and fewer rounds), none beyond FULL.
PASSES, CROWDED, FULL = 3, 400, 1500
TRIAL_ROUNDS = 6


def polish(drawing: Drawing, target: np.ndarray, detail: float = 1.0) -> Drawing:
    """The drawing fitted to a picture (H, W, 4) premultiplied in [0, 1]; detail as in ArtworkSettings."""
    if not drawing.shapes:
        return drawing
    pieces = drawing.segments
    state = settle(begin(drawing, target), target, ROUNDS if pieces <= CROWDED else TRIAL_ROUNDS)
    for _ in range(PASSES if pieces <= CROWDED else 1 if pieces <= FULL else 0):
        following = _moved(state, target, (drawing.width, drawing.height), detail)
        if following is state:
            break
        state = following
    return drawn(drawing, state)


def _moved(state: State, target: np.ndarray, canvas: tuple[int, int], detail: float) -> State:
    """The state after one pass of moves, the same where none paid."""
    layers, changed = with_moves(state, canvas, detail)
    if not changed.any():
        return state
    trial = settle(State.of(layers, target), target, TRIAL_ROUNDS)
    refused = shorter(state, trial, changed, detail)
    if refused.any():
        trial = State.of(kept(state.layers, trial.layers, refused), target)
        trial = settle(trial, target, 2)
    return trial if not refused[changed].all() else state
