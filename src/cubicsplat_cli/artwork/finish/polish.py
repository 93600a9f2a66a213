"""The whole finish of a drawing: its pieces settled against the pixels; pieces added where those ask for more than an
outline can do, and a primitive made a ring; runs of pieces merged; settled again.

Every move is tried with a short finish, and kept only where the description of the picture becomes shorter (`judged`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from cubicsplat_cli.artwork.finish.merges import with_merges
from cubicsplat_cli.artwork.finish.parameters import LEAST, Constraints, Parameters, parametrised
from cubicsplat_cli.artwork.finish.settle import PASSES, ROUNDS, TRIAL_ROUNDS, judged, settle
from cubicsplat_cli.artwork.finish.state import State, begin, drawn
from cubicsplat_cli.artwork.geometry.outlines import Outline, Rectangle, Ring, divided, polygon_lengths
from cubicsplat_cli.artwork.shapes import PRICE, Drawing
from cubicsplat_cli.progress import log, nothing, work
from cubicsplat_cli.raster.stack import Goal
from cubicsplat_cli.record import record

# Pieces beyond which there are fewer rounds; merges only after the moves, and one pass of each; neither of the two,
# which take some ms a piece; and nothing is fitted, for its memory.
CROWDED, FULL, CHANGED, MOST = 400, 4000, 16_000, 100_000
# Half of chi^2 beyond what chance gives from which a piece is worth looking at; a pixel counts at most MOST_CHI.
WORTH, MOST_CHI = 3.0 * PRICE, 60.0
NEAR = 2.5  # px: misfit within this of a joint is the joint's
ROUNDED = 2.0  # px before and after a corner between which it is rounded
LEAST_LENGTH = 3.0  # px of a piece that may be cut
# Half of the excess of chi^2 that a primitive's pixels must have on average: twice as much as by chance. Over the many
# pixels of a large circle even what one of its neighbours spoils is worth a ring's parameters.
CLEARLY = 0.5
# The part of its goal's share error below which what outlines leave shows that pixels are better known; and the least
# share error, four levels of 8 bits, since programs draw edges to no more. Pixels tell it that change by SHOWN and more
# with their coverage: of fainter ones rounding hides a hundredth.
KNOWN, EXACT, SHOWN = 0.75, 4.0 / 255.0, 0.1


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
    moved = partial(with_moves, constraints=constraints, detail=detail)
    at("fitting to the pixels", 0.5)
    state = state or begin(drawing, goal)
    with work().stoppable():
        state = settle(state, ROUNDS if pieces <= CROWDED else TRIAL_ROUNDS)
        on_settled(drawn(drawing, state))
        at("merging pieces", 0.6)
        # What was traced in edges made sharp again has many pieces too many.
        if pieces <= FULL:
            state = _repeated(merged, state, PASSES if goal.reach else 1)
        at("fitting to the pixels", 0.7)
        state = _repeated(moved, state, PASSES if pieces <= FULL else 1 if pieces <= CHANGED else 0)
        rings = [o.otherwise if isinstance(o, Ring) else None for shape in drawing.shapes for o in shape.outlines]
        state = _tried(state, {k: parametrised(o, constraints) for k, o in enumerate(rings) if o is not None}, detail)
        # What moves and better neighbours have made even.
        if pieces <= CHANGED:
            state = settle(state, TRIAL_ROUNDS)
            state = _repeated(merged, state, PASSES if pieces <= FULL else 1)
    return drawn(drawing, state)


def polish_closer(drawing: Drawing, goal: Goal, detail: float = 1.0) -> Drawing:
    """The polished drawing, fitted once more where the shares of pixels are plainly better known than its goal takes
    them to be: as well as the outlines explain them. Exact areas leave 0.02 to 0.03 of a share, 4 x 4 samples 0.04.
    """
    if not 0 < drawing.segments <= FULL:
        return drawing
    with work().stoppable():
        state = begin(drawing, goal)
        effects = state.effects
        shown = effects > SHOWN**2
        left = state.misfit[state.stack.crossings.pixel[shown]] / effects[shown]
        known = float(np.sqrt(left.mean())) if len(left) else np.inf
        if known < KNOWN * goal.share_error:
            drawing = polish(drawing, replace(goal, share_error=max(known, EXACT)), detail)
    return drawing


def _repeated(change: Callable[[State], State], state: State, passes: int) -> State:
    """The state after some passes, until one changes nothing."""
    for _ in range(passes):
        before, state = state, change(state)
        if state is before:
            break
    return state


def _tried(state: State, others: Mapping[int, Parameters], detail: float) -> State:
    """Return the state with those of other outlines, by number, that pay once they are settled."""
    if not others:
        return state
    changed = np.isin(np.arange(len(state.outlines)), [*others])
    return judged(state, settle(state.with_outlines(others), TRIAL_ROUNDS, changed=changed), detail)


@record
class Complaints:
    """The misfit of the pixels of all pieces of a drawing, (pieces,) each. chi: half of the excess of chi^2, where
    there is any; t: the parameter in its middle; start, end: its shares near the ends of a piece.
    """

    chi: np.ndarray
    t: np.ndarray
    start: np.ndarray
    end: np.ndarray

    @classmethod
    def of(cls, state: State) -> Complaints:
        """Return the complaints against the pieces of a drawing, numbered through all its outlines."""
        c = state.stack.crossings
        chi = np.minimum(state.misfit[c.pixel] / state.chance, MOST_CHI) - 1.0
        lengths = polygon_lengths(state.drawn.cubics)
        along, weight = c.t * lengths[c.piece], np.maximum(chi, 0.0)
        parts = chi, weight, weight * c.t, weight * (along < NEAR), weight * (along > lengths[c.piece] - NEAR)
        excess, total, *sums = (np.bincount(c.piece, part, len(lengths)) for part in parts)
        return cls(np.maximum(0.5 * excess, 0.0), *(part / np.maximum(total, LEAST) for part in sums))


def with_moves(state: State, constraints: Constraints, detail: float) -> State:
    """Return the state with outlines that have a piece more wherever the pixels ask for one and it pays."""
    complaints, better = Complaints.of(state), dict[int, Parameters]()
    for k, parameters in enumerate(state.outlines):
        first, outline = int(state.pieces[k]), parameters.outline()
        chi = detail * complaints.chi[first : state.pieces[k + 1]]
        edited = outline
        if isinstance(outline, Ring):
            joints: set[int] = set()
            for i in np.flatnonzero(chi > WORTH)[::-1].tolist():
                edited = _moved(edited.ring(), i, complaints, first + i, joints)
        else:
            edited = as_path(outline, float(chi.sum()), int(state.marks[k + 1] - state.marks[k])) or outline
        if edited is not outline:
            better[k] = parametrised(edited, constraints)
    return _tried(state, better, detail)


def as_path(shape: Outline, chi: float, crossed: int) -> Ring | None:
    """The ring to try in a primitive's place; None where all that its pixels hold against it, half of the excess of
    chi^2, is worth less than the ring's further parameters, or is little for the pixels crossed.

    Rectangles that stand level stay: drawing programs with few samples a pixel know their sides to a quarter of one,
    and sides that slant would fit that better than they fit the drawing.
    """
    if isinstance(shape, Rectangle) and shape.angle == 0.0:
        return None
    ring = shape.ring()
    return ring if chi > max(PRICE * (ring.parameters - shape.parameters), CLEARLY * crossed) else None


def _moved(ring: Ring, i: int, complaints: Complaints, number: int, joints: set[int]) -> Ring:
    """Return the ring with the move that a complaint (number) against piece i suggests, of joints not moved yet."""
    start, end = float(complaints.start[number]), float(complaints.end[number])
    length = float(polygon_lengths(ring.cubics[[i]])[0])
    if max(start, end) > 0.5 and length > 2.0 * NEAR:  # a joint has most of the misfit
        anchor = i if start >= end else (i + 1) % ring.pieces
        if anchor in joints or anchor == 0:
            return ring
        joints.add(anchor)
        if not ring.smooth[anchor]:
            return rounded(ring, anchor, ROUNDED)
        return replace(ring, smooth=ring.smooth & (np.arange(ring.pieces) != anchor))
    if length < LEAST_LENGTH:
        return ring
    if ring.lines[i]:  # straight to begin with, it turns at its ends as it likes
        return replace(ring, lines=ring.lines & (np.arange(ring.pieces) != i))
    return divided(ring, i, float(np.clip(complaints.t[number], 0.25, 0.75)))


def rounded(ring: Ring, anchor: int, reach: float) -> Ring:
    """The ring with a corner, not that of anchor 0, replaced by a cubic between points `reach` px before and after it,
    joined smoothly.
    """
    before, after = ring.cubics[anchor - 1 : anchor + 1]
    cut = divided(ring, anchor, _parameter(after, reach))
    cut = divided(cut, anchor - 1, 1.0 - _parameter(before[::-1], reach))
    ends = cut.anchors[[anchor, anchor + 2]]
    cut.controls[anchor] = ends + (ring.anchors[anchor] - ends) * 0.55
    cut.lines[anchor] = False
    cut.smooth[[anchor, anchor + 2]] = True
    return cut.chosen(np.arange(cut.pieces) != anchor + 1)


def _parameter(cubic: np.ndarray, reach: float) -> float:
    """The parameter at which a cubic is about `reach` px from its start, at most two fifths."""
    return min(reach / max(float(polygon_lengths(cubic[None])[0]), 1e-9), 0.4)
