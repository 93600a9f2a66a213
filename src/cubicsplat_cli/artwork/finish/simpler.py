"""Ever simpler versions of a finished drawing, for files of few bytes or nodes.

Parameters get dearer from version to version. A shape goes where its picture without it loses less than its parameters
cost, and runs of pieces become one piece by the same measure, as in the finish.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import compress

import numpy as np

from cubicsplat_cli.artwork.finish.merges import with_merges
from cubicsplat_cli.artwork.finish.parameters import Constraints
from cubicsplat_cli.artwork.finish.state import WHITE, State, begin, drawn
from cubicsplat_cli.artwork.shapes import PRICE, SHAPE_PARAMETERS, Drawing
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.stack import Goal

# By how much the price rises from version to version: by STEP, or by less where more than a share of MOST_LOST of the
# pieces would go at once. At DEAREST times its price at first a parameter counts as much as 60,000 px of full contrast.
STEP, LEAST_STEP, MOST_LOST = 1.5, 1.05, 0.15
DEAREST = 1e7
WORTHY = 3.0  # times its price: a shape that explains so much is not looked at again until its price is as high


def simpler(drawing: Drawing, goal: Goal, detail: float = 1.0) -> Iterator[Drawing]:
    """Versions of a drawing that is fitted to its goal, each with fewer shapes or pieces than the one before.

    detail as in ArtworkSettings. It ends where the work is stopped.
    """
    constraints = Constraints(drawing.width, drawing.height)
    state, price, step = begin(drawing, tolerant(goal)), 1.0, STEP
    worth: dict[int, float] = {}
    while price < DEAREST:
        following = state
        with work().stoppable():
            work().at("simplifying", 0.95)
            dearer = detail / (price * step)
            following = _merged(without_shapes(state, dearer, worth), constraints, dearer)
        if work().stopped:
            return
        left, pieces = int(following.pieces[-1]), int(state.pieces[-1])
        if left < (1.0 - MOST_LOST) * pieces and step > LEAST_STEP:
            step **= 0.5
            continue
        price, step = price * step, min(STEP, step**2)
        state, drawing = following, drawn(drawing, following)
        if left < pieces:
            yield drawing


def _merged(state: State, constraints: Constraints, detail: float) -> State:
    """The state with runs of pieces merged. Merges look at the pixels that outlines cross; here outlines may move by
    more than a pixel, so what lies between is looked at too.
    """
    after = with_merges(state, constraints, detail)
    if after is state:
        return state
    boxes, others = (_boxes(each, each.pieces[:-1]) for each in (state, after))
    around = np.concatenate([np.minimum(boxes, others)[:, :2], np.maximum(boxes, others)[:, 2:]], axis=1)
    refused = np.zeros(len(boxes), dtype=bool)
    for number, (old, new) in enumerate(zip(state.outlines, after.outlines, strict=True)):
        saved = PRICE * (old.outline().parameters - new.outline().parameters)
        if saved > 0.0:
            grown = _growth(state, after, around[number])
            refused[number] = 0.5 * detail * grown > saved * state.floors[number]
    return after.taken_back(state, refused)


def tolerant(goal: Goal) -> Goal:
    """The goal with pixels on edges at least as uncertain as shares, so that what is faint counts less."""
    return replace(goal, error=max(goal.error, goal.share_error))


def without_shapes(state: State, detail: float, worth: dict[int, float]) -> State:
    """The state without the shapes that explain less than they cost. Those that do not touch are tried together.

    worth: by the identity of a shape, the price of a parameter up to which it pays; brought up to date.
    """
    layers = state.layers
    firsts = np.cumsum([0, *(len(layer.outlines) for layer in layers)])[:-1]
    boxes = _boxes(state, state.pieces[firsts])
    there = np.ones(len(layers), dtype=bool)
    prices = [PRICE * (SHAPE_PARAMETERS + sum(o.outline().parameters for o in each.outlines)) for each in layers]
    floors = state.floors[firsts]
    in_question = [n for n, each in enumerate(layers) if worth.get(id(each.shape), 0.0) * detail < WORTHY]
    for group in apart(boxes, in_question):
        work().at()
        trial = there.copy()
        trial[group] = False
        if not trial.any():
            continue  # one shape stays
        without = state.with_layers(list(compress(layers, trial)))
        for number in group:
            grown = _growth(state, without, boxes[number])
            price = worth[id(layers[number].shape)] = 0.5 * grown / (prices[number] * floors[number])
            trial[number] = price * detail >= 1.0
        if not trial[group].all():
            there = trial
            state = state.with_layers(list(compress(layers, there)))
    return state


def _growth(before: State, after: State, box: np.ndarray) -> float:
    """By how much the squared errors in a box (4,) grow, which unlike the misfit count a missing shape in full."""
    x0, y0, x1, y1 = box.tolist()
    target = before.goal.target[y0:y1, x0:x1]
    old, new = ((state.image[y0:y1, x0:x1] - target) * WHITE for state in (before, after))
    return float(np.vdot(new, new)) - float(np.vdot(old, old))


def _boxes(state: State, starts: np.ndarray) -> np.ndarray:
    """(n, 4) x0, y0, x1, y1 in px, within which pieces change the picture: those from some (n,) to the next ones."""
    reach, (height, width) = state.goal.reach + 1, state.image.shape[:2]
    low = np.minimum.reduceat(state.drawn.cubics.min(axis=1), starts)
    high = np.maximum.reduceat(state.drawn.cubics.max(axis=1), starts)
    boxes = np.concatenate([np.floor(low) - reach, np.ceil(high) + reach], axis=1)
    return np.clip(boxes, 0, [width, height, width, height]).astype(int)


def apart(boxes: np.ndarray, numbers: Sequence[int]) -> list[list[int]]:
    """Numbers of boxes (n, 4) in groups of boxes of which no two overlap, the last ones first."""
    groups: list[list[int]] = []
    last_first = np.array(numbers[::-1], dtype=int)
    sides, group_of = np.ascontiguousarray(boxes[last_first].T), np.empty(len(last_first), dtype=int)
    for k, number in enumerate(last_first.tolist()):
        (x0, y0, x1, y1), (left, top, right, bottom) = sides[:, :k], sides[:, k]
        overlaps = (x0 < right) & (x1 > left) & (y0 < bottom) & (y1 > top)
        taken = np.zeros(len(groups) + 1, dtype=bool)
        taken[group_of[:k][overlaps]] = True
        group_of[k] = first = int(taken.argmin())
        if first == len(groups):
            groups.append([])
        groups[first].append(number)
    return groups
