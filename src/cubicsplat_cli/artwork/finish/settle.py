"""The settling of a drawing: all free parameters optimised against the pixels, through their exact coverage.

The picture of a stack of shapes is composed pixel by pixel from exact coverages, as the engines and SVG viewers do. Its
derivative by every parameter is as exact, so damped Gauss-Newton needs few steps where gradient descent takes hundreds.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.finish.parameters import LEAST, SMOOTH_SPECK, CopyParameters, Parameters, RingParameters
from cubicsplat_cli.artwork.finish.state import ROUNDING, State
from cubicsplat_cli.artwork.geometry.outlines import polygon_lengths
from cubicsplat_cli.artwork.shapes import PRICE
from cubicsplat_cli.progress import work

ROUNDS = 14
PASSES = 3  # of moves, of merges and of further shapes, at most
TRIAL_ROUNDS, AFTER_REFUSALS = 6, 2  # of what is tried in a settled drawing, and of what is left where some is refused
# Pixels are known to this fraction of full scale; parameters that no pixel sees stay to within FREE px.
PIXEL_SIGMA, FREE = 0.02, 0.5
# Relative gain of a round below which it is finished, and of an outline's step below which that rests.
ENOUGH, RESTS = 4e-3, 5e-4
# Damping of outlines at the start, beyond which a step has just failed, and from which none will help.
START, RELAXED, HOPELESS = 1e-3, 5e-3, 1e3
TAKEN_BACK = 3  # times that outlines are taken back after a step, for a misfit that has grown
LONGEST = 1.5  # px that a control point moves at most in a step
NOTICED = 0.5 / 255.0  # change of the picture, at a pixel of an outline that rests, from which it is looked at again


def settle(state: State, rounds: int = ROUNDS, *, trim: bool = True, changed: np.ndarray | None = None) -> State:
    """The nearest state to the picture that has the same pieces; trim: less those that become too short to matter.

    Outlines whose steps gain hardly anything rest, until the picture beneath them changes. changed: (outlines,) bool,
    those that do not rest at first; by default all.
    """
    damping = np.full(len(state.outlines), START)
    awake = np.ones(len(state.outlines), dtype=bool) if changed is None else changed
    for _ in range(rounds):
        work().at()
        following, awake = _improved(state, damping, awake)
        gain = state.stack.cost - following.stack.cost
        state = trimmed(following, awake) if trim else following
        retried = awake & (damping > RELAXED) & (damping < HOPELESS)
        if not awake.any() or (gain < ENOUGH * state.stack.cost and not retried.any()):
            break
    return state


def _improved(state: State, damping: np.ndarray, awake: np.ndarray) -> tuple[State, np.ndarray]:
    """The state after a step of some outlines (outlines,) bool, without those that fit their own pixels worse by it,
    and which are to move next; `damping` is brought up to date in place.

    What one outline spoils is held against its neighbours too, so the worst ones are taken back first. Copies are
    judged together with their model.
    """
    # Of each outline the number of the one whose variables move it: its model's, or its own.
    families = np.array([o.source if isinstance(o, CopyParameters) else k for k, o in enumerate(state.outlines)])
    following = _stepped(state, families, damping, awake)
    moving = np.isin(np.arange(len(damping)), [*following])
    if not following:
        return state, moving
    trial = state.with_outlines(following)
    # A ring that crosses itself where it is hidden must not be turned over by what it encloses there.
    refused = (trial.clockwise != state.clockwise)[families]
    trial = trial.taken_back(state, refused & moving)
    for left in reversed(range(TAKEN_BACK + 1)):
        loss = np.bincount(families, state.growth(trial, moving, state.spread, leaks=True), len(families))[families]
        loss = np.where(refused | ~moving, 0.0, loss)
        if left == 0 or not (loss > LEAST).any():
            break
        worse = loss > (LEAST if left == 1 else 0.2 * loss.max())
        trial, refused = trial.taken_back(state, worse), refused | worse
    changed = np.where(refused, np.minimum(damping * 10.0, 10.0 * HOPELESS), np.maximum(damping / 5.0, 1e-6))
    damping[moving] = changed[moving]
    if trial.stack.cost >= state.stack.cost:
        damping[moving] *= 10.0
        return state, moving
    noticed = trial.stack.changed(state.stack, families[trial.owners], len(families), NOTICED)[families]
    return trial, moving | noticed


def judged(state: State, trial: State, detail: float) -> State:
    """Return a trial, a state in which some outlines have changed and all are settled, without the changes that turn an
    outline over or make the whole description longer, half of chi^2 over the pixels that outlines cross plus a price
    for every parameter; and without what has followed them.
    """
    pairs = [*zip(state.outlines, trial.outlines, strict=True)]
    changed = np.array([own is not other for own, other in pairs])
    refused = changed & (trial.clockwise != state.clockwise)
    gains = state.gains(trial, changed)
    for k in np.flatnonzero(changed).tolist():
        own, other = (parameters.outline() for parameters in pairs[k])
        refused[k] |= gains[k] * detail < PRICE * (other.parameters - own.parameters)
    return settle(trial.taken_back(state, refused), AFTER_REFUSALS, changed=refused) if refused.any() else trial


def trimmed(state: State, moved: np.ndarray) -> State:
    """The state without pieces that have become too short to matter. moved: (outlines,) bool, those that may have."""
    # One look at the lengths of all, since hardly any ring has a short piece.
    least = np.minimum.reduceat(polygon_lengths(state.drawn.cubics), state.pieces[:-1])
    short = [(k, state.outlines[k]) for k in np.flatnonzero(moved & (least < SMOOTH_SPECK)).tolist()]
    rings = [(k, o) for k, o in short if isinstance(o, RingParameters)]
    return state.with_outlines({k: fewer for k, o in rings if (fewer := o.trimmed()) is not o})


def _stepped(state: State, families: np.ndarray, damping: np.ndarray, awake: np.ndarray) -> dict[int, Parameters]:
    """The outlines that have moved, by number, after a step of some (outlines,) bool and of their copies."""
    outlines = state.outlines
    awake = (np.bincount(families, awake, len(outlines)) > 0.0)[families]
    jacobians = {k: own for k in np.flatnonzero(awake).tolist() if (own := outlines[k].jacobian).count}
    if not jacobians:
        return {}
    free, starts = np.array([*jacobians]), np.zeros(len(outlines), int)
    models = free[families[free] == free]
    sizes = np.array([jacobians[k].count for k in models.tolist()])
    starts[models] = np.cumsum(sizes) - sizes
    moved = state.pieces[free], np.diff(state.pieces)[free], starts[families[free]], [*jacobians.values()]
    found = state.stack.step(*moved, np.repeat(damping[models], sizes), (PIXEL_SIGMA / FREE) ** 2, ROUNDING)
    moves = np.zeros(len(outlines))
    np.maximum.at(moves, families[free], found.moves)
    gained = np.add.reduceat(-found.values * found.gradient, starts[models])
    moving = gained > RESTS * np.bincount(families[free], found.misfits, len(outlines))[models]
    steps = found.values * np.repeat(LONGEST / np.maximum(moves[models], LONGEST), sizes)
    parts = zip(models.tolist(), np.split(steps, starts[models[1:]]), moving.tolist(), strict=True)
    following = {k: outlines[k].moved(step) for k, step, moves in parts if moves}
    copies = {k: copy for k in jacobians if isinstance(copy := outlines[k], CopyParameters)}
    return following | {k: c.following(following[c.source]) for k, c in copies.items() if c.source in following}
