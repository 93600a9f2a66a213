"""Merges of the finish: runs of pieces for which one line or cubic stands as well.

Outlines are traced with a piece too many rather than one too few, and hidden parts of them wander. Once a drawing is
settled against its pixels a run that one piece fits is tried, all such runs together, and each is kept only where the
description of the picture becomes shorter: half of chi^2 over the pixels it crosses, plus a price for every parameter.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.finish.parameters import MEAN_ERROR, Constraints, parametrised
from cubicsplat_cli.artwork.finish.settle import TRIAL_ROUNDS, judged, settle, trimmed
from cubicsplat_cli.artwork.finish.state import UNSEEN, State
from cubicsplat_cli.artwork.geometry.outlines import Ring, bernstein, feet_of, polygon_lengths
from cubicsplat_cli.artwork.regions.sampling import FEW_SAMPLES
from cubicsplat_cli.artwork.shapes import PRICE
from cubicsplat_cli.raster.cubics import found_merges
from cubicsplat_cli.record import record

LONGEST_RUN, LONGEST_HIDDEN = 3, 12  # pieces that are merged at once, where they show and where none does
# Px to which a place is known by a pixel where an outline shows, as coverages are, and how far hidden parts may move.
SEEN_SIGMA, HIDDEN_SIGMA = FEW_SAMPLES, 1.0
HOPEFUL = 0.5  # of the cost before it is settled, that counts against a merge when runs are chosen
MOST_TURN = float(np.cos(np.radians(100.0)))  # cosine of the angle by which a run turns from start to end
FEW = 24  # points of a piece suffice
MOST_TRIALS = 8  # of merges, and of parts of those that are refused together
FEWEST_PIECES = 3  # of a ring that is left


@record
class Merge:
    """A run of pieces of a ring, `count` of them from `first` on, and what is to stand for it: control points (4, 2) of
    a line or a cubic. saved: parameters. net: nats that it is expected to save."""

    first: int
    count: int
    cubic: np.ndarray
    line: bool
    saved: int
    net: float

    def run(self, pieces: int) -> np.ndarray:
        """(count,) the numbers of its pieces in a ring of so many."""
        return np.asarray((self.first + np.arange(self.count)) % pieces)


def with_merges(state: State, constraints: Constraints, detail: float) -> State:
    """The state with runs of pieces merged wherever that makes the description shorter; the same where none do.

    detail as in ArtworkSettings. Where all merges of an outline together make it worse parts of them are tried.
    """
    rings = [o.outline() for o in state.outlines]
    plans = [
        _plan(ring, Visibility.of(state, k), constraints, detail) if isinstance(ring, Ring) else []
        for k, ring in enumerate(rings)
    ]
    left = [[plan] if plan else [] for plan in plans]
    for _ in range(MOST_TRIALS):
        plans = [parts.pop() if parts else [] for parts in left]
        if not any(plans):
            break
        after, paying = _merged(state, plans, constraints, detail)
        refused = np.diff(after.pieces) >= np.diff(state.pieces)
        for parts, plan, again in zip(left, paying, refused.tolist(), strict=True):
            half = len(plan) // 2
            if not again:
                parts.clear()
            elif half:
                parts += [plan[half:], plan[:half]]
            elif plan and not refused.all():  # others, which have changed, may have spoilt it
                parts.append(plan)
        state = after
    return state


def _merged(
    state: State, plans: list[list[Merge]], constraints: Constraints, detail: float
) -> tuple[State, list[list[Merge]]]:
    """The state with some merges, where they pay; and those that pay by themselves, the best first."""
    trial = _with(state, plans, constraints)
    trial = settle(trial, TRIAL_ROUNDS, trim=False, changed=np.array([*map(bool, plans)]))
    paying = _paying(state, trial, plans, detail)
    if not any(paying):
        return state, paying
    differ = np.array([len(fewer) < len(plan) for fewer, plan in zip(paying, plans, strict=True)])
    if differ.any():
        fewer = trial.taken_back(_with(state, paying, constraints), differ)
        trial = settle(fewer, TRIAL_ROUNDS, changed=differ)
    return judged(state, trimmed(trial, np.array([*map(bool, paying)])), detail), paying


def merged(ring: Ring, plan: list[Merge]) -> Ring:
    """The ring with some runs, which do not overlap, replaced."""
    gone = np.zeros(ring.pieces, dtype=bool)
    controls, lines = ring.controls.copy(), ring.lines.copy()
    for merge in plan:
        gone[merge.run(ring.pieces)[1:]] = True
        controls[merge.first], lines[merge.first] = merge.cubic[1:3], merge.line
    return Ring(ring.anchors, controls, lines, ring.smooth).chosen(~gone)


@record
class Visibility:
    """Where an outline shows. piece, t: crossings, in order; seen: (m,) bool; sigma: px, to which they are known."""

    piece: np.ndarray
    t: np.ndarray
    seen: np.ndarray
    sigma: float

    @classmethod
    def of(cls, state: State, number: int) -> Visibility:
        c, own = state.stack.crossings, slice(state.marks[number], state.marks[number + 1])
        piece, t = c.piece[own] - state.pieces[number], c.t[own]
        order = np.lexsort((t, piece))
        seen = state.effects[own] * SEEN_SIGMA**2 > UNSEEN
        return cls(piece[order], t[order], seen[order], state.goal.share_error)

    def weights(self, piece: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Return (n,) 1/px^2 at parameters (n,) of pieces (n,): that of the nearest crossing."""
        if not len(self.piece):
            return np.full(len(t), HIDDEN_SIGMA**-2)
        # Crossings of other pieces are farther away than those of the same one.
        places, at = 2.0 * self.piece + self.t, 2.0 * piece + t
        after = np.minimum(np.searchsorted(places, at), len(places) - 1)
        before = np.maximum(after - 1, 0)
        near = np.where(np.abs(places[before] - at) < np.abs(places[after] - at), before, after)
        return np.where((self.piece[near] == piece) & self.seen[near], self.sigma**-2, HIDDEN_SIGMA**-2)


def samples_along(ring: Ring, visibility: Visibility) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, 2), px, along a ring, of each piece one per px, but at least 4 and at most FEW; their weights (n,),
    1/px^2, the px (n,) that each stands for, and where those of each piece end (pieces,).
    """
    lengths = polygon_lengths(ring.cubics)
    counts = np.clip(np.ceil(lengths), 4, FEW).astype(int)
    piece, u = feet_of(counts)
    points = np.einsum("nk,nkc->nc", bernstein(u), ring.cubics[piece])
    return points, visibility.weights(piece, u), (lengths / counts)[piece], np.cumsum(counts)


def _plan(ring: Ring, visibility: Visibility, constraints: Constraints, detail: float) -> list[Merge]:
    """The merges of a ring that are worth a trial, none of which overlap, from the best on."""
    points, weights, px, ends = samples_along(ring, visibility)
    beyond = ring.anchors - [constraints.width, constraints.height]
    fixed = (np.minimum(np.abs(ring.anchors), np.abs(beyond)) < MEAN_ERROR).any(axis=1)
    shows = np.isin(np.arange(ring.pieces), visibility.piece[visibility.seen])
    pieces, samples = (ring.cubics, ring.lines, ring.smooth, fixed, shows), (points, weights * px, ends)
    bounds = (PRICE / detail, HOPEFUL, MOST_TURN), (LONGEST_RUN, LONGEST_HIDDEN, FEWEST_PIECES)
    numbers, cubics, nets = found_merges(pieces, samples, *bounds)
    found = zip(numbers.tolist(), cubics, nets.tolist(), strict=True)
    merges = [Merge(first, count, cubic, bool(line), saved, net) for (first, count, line, saved), cubic, net in found]
    taken = np.zeros(ring.pieces, dtype=bool)
    chosen: list[Merge] = []
    left = ring.pieces
    for merge in sorted(merges, key=lambda merge: -merge.net):
        run = merge.run(ring.pieces)
        if not taken[run].any() and left - merge.count + 1 >= FEWEST_PIECES:
            taken[run] = True
            left -= merge.count - 1
            chosen.append(merge)
    return chosen


def _with(state: State, plans: list[list[Merge]], constraints: Constraints) -> State:
    rings = {k: ring for k, plan in enumerate(plans) if plan and isinstance(ring := state.outlines[k].outline(), Ring)}
    return state.with_outlines({k: parametrised(merged(ring, plans[k]), constraints) for k, ring in rings.items()})


def _paying(before: State, after: State, plans: list[list[Merge]], detail: float) -> list[list[Merge]]:
    """The merges that save more than the pixels lose that the run crossed, and that what stands for it crosses."""
    own, other = np.full(before.pieces[-1], -1), np.full(after.pieces[-1], -1)
    judged: dict[int, int] = {}  # merges by identity
    for k, plan in enumerate(plans):
        pieces, left = (len(state.outlines[k].lines) for state in (before, after))
        if left != pieces - sum(merge.count - 1 for merge in plan):
            continue  # some piece was trimmed: the outline is judged as a whole
        gone = np.zeros(pieces, dtype=bool)
        for merge in plan:
            gone[merge.run(pieces)[1:]] = True
        for merge in plan:
            number = judged.setdefault(id(merge), len(judged))
            own[merge.run(pieces) + before.pieces[k]] = number
            other[int((~gone[: merge.first]).sum()) + after.pieces[k]] = number
    grown = before.stack.growth(after.stack, own, other, len(judged), before.spread)

    def pays(merge: Merge, k: int) -> bool:
        number = judged.get(id(merge))
        lost = 0.0 if number is None else 0.5 * float(grown[number]) / before.floors[k]
        return lost * detail < PRICE * merge.saved

    return [[merge for merge in plan if pays(merge, k)] for k, plan in enumerate(plans)]
