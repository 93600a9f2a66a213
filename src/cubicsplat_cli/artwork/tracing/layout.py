"""How a loop of boundary points divides into pieces: which corners are real, and the runs between them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.tracing.corners import Corners
from cubicsplat_cli.artwork.tracing.sections import CORNER_ERRORS, LEAST_ERRORS, SURE_WEIGHT, Division, Section, divide
from cubicsplat_cli.artwork.tracing.smoothing import LocalFits, local_fits
from cubicsplat_cli.raster.point_tree import PointTree

# Drawing programs sample edges on a grid of about quarter pixels, so the points of a nearly level or upright stretch
# err together as far as the stretch takes to cross a row of samples; they count as one.
GRID = 0.25  # px
FLATTEST = 0.01
CORNER_REACH = 1.4  # px around a corner in which points are biased; up to twice that they count less
TIP_WIDTH = 0.6  # px between the flanks of a thin tip below which its points are biased
SHARPEST_TIP = 0.12  # sine of half of the angle of a tip, below which its points are not more biased
FEWEST_KNOWN = 4  # points of a run that is more than a straight line
# A corner is doubted, and kept only if it pays, when it turns less, or is nearer to another, than this.
DOUBTFUL_TURN = math.radians(45.0)
DOUBTFUL_SPACING = 6.0  # px
CORNER_PARAMETERS = 2
ROUNDING_TURN = math.radians(80.0)  # of a false corner along a rounding, at most
ROUNDING_STEP = 12.0  # px between false corners along one rounding, at most


@dataclass(frozen=True)
class Layout:
    """A divided loop. corners: those kept. order: the points from the first corner on. divisions: of every run.

    weights: (n,) of the points, in their own order, 0 next to corners.
    """

    corners: Corners
    order: np.ndarray
    divisions: list[Division]
    weights: np.ndarray


def independent(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The weights (n,) 1/px^2 of a loop, less where neighbouring points err together."""
    way = np.roll(points, -3, axis=0) - np.roll(points, 3, axis=0)
    slope = np.abs(way).min(axis=1) / np.maximum(np.abs(way).max(axis=1), 1e-9)
    return weights / (1.0 + GRID / np.maximum(slope, FLATTEST))


def lay_out(points: np.ndarray, weights: np.ndarray, corners: Corners, price: float) -> Layout:
    """The loop divided, without the corners that do not pay. price: of a parameter, in nats."""
    runs = _Runs(points, weights, price)
    corners = _without_doubtful(runs, corners)
    chosen = runs.weights_of(corners)
    if not len(corners.indices):
        order, division = _divided_loop(points, chosen, price)
        return Layout(corners, order, [division], chosen)
    count = len(corners.indices)
    order = np.concatenate([runs.between(corners, k, k + 1) for k in range(count)])
    return Layout(corners, order, [runs.division(corners, k, k + 1) for k in range(count)], chosen)


class _Runs:
    """The runs between pairs of corners of a loop, each divided once."""

    def __init__(self, points: np.ndarray, weights: np.ndarray, price: float) -> None:
        self.points, self.weights, self.price = points, weights, price
        self._tree = PointTree(points)
        self._known: dict[tuple[int, int], Division] = {}

    def weights_of(self, corners: Corners) -> np.ndarray:
        """The weights with the points next to the corners left out."""
        weights = self.weights.copy()
        reaches = _reaches(corners)
        near = self._tree.query_ball_point(corners.positions, 2.0 * reaches) if len(reaches) else []
        for some, at, reach in zip(near, corners.positions, reaches, strict=True):
            weights[some] *= _clear(self.points[some], at, reach)
        return weights

    def _between_two(self, corners: Corners, run: np.ndarray) -> np.ndarray:
        """The weights of the points of a run with those next to its two corners left out."""
        weights = self.weights[run]
        for at, reach in zip(corners.positions, _reaches(corners), strict=True):
            weights *= _clear(self.points[run], at, reach)
        return weights

    def between(self, corners: Corners, i: int, j: int) -> np.ndarray:
        """The points from corner i on to corner j (both modulo their number), in order."""
        count, n = len(corners.indices), len(self.points)
        start, stop = corners.indices[i % count], corners.indices[j % count]
        return (start + np.arange((stop - start - 1) % n + 1)) % n

    def division(self, corners: Corners, i: int, j: int) -> Division:
        """The run from corner i to corner j, divided."""
        count = len(corners.indices)
        pair = np.array([i % count, j % count])
        key = (int(corners.indices[pair[0]]), int(corners.indices[pair[1]]))
        if key not in self._known:
            run = self.between(corners, i, j)
            weights = self._between_two(corners.taken(pair), run)
            self._known[key] = divide(_section(self.points[run], weights, corners.positions[pair]), self.price)
        return self._known[key]

    def loop_cost(self) -> float:
        """Of the whole loop without corners, in nats."""
        return _divided_loop(self.points, self.weights, self.price)[1].cost


def _reaches(corners: Corners) -> np.ndarray:
    """(C,) px around each corner in which points are biased."""
    sine = np.sin(0.5 * (np.pi - np.abs(corners.turns)))
    return np.maximum(TIP_WIDTH / np.maximum(sine, SHARPEST_TIP), CORNER_REACH)


def _clear(points: np.ndarray, corner: np.ndarray, reach: float) -> np.ndarray:
    """(n,) by how much points (n, 2) are clear of a corner: 0 within its reach, px, 1 from twice that on."""
    return np.asarray(np.clip(np.hypot(*(points - corner).T) / reach - 1.0, 0.0, 1.0) ** 2)


def _without_doubtful(runs: _Runs, corners: Corners) -> Corners:
    """The corners less those that cost more than doing without: first groups in a row, then each, faintest first."""
    for group in _groups(corners):
        corners = _if_cheaper(runs, corners, group)
    for index in corners.indices[np.argsort(np.abs(corners.turns), kind="stable")]:
        if _doubtful(corners, int(np.searchsorted(corners.indices, index))):
            corners = _if_cheaper(runs, corners, np.array([index]))
    return corners


def _groups(corners: Corners) -> list[np.ndarray]:
    """The indices of doubtful corners that follow each other closely, two or more, as along a rounding."""
    count = len(corners.indices)
    doubtful = (np.abs(corners.turns) < ROUNDING_TURN) & ~corners.sure
    after = np.roll(np.arange(count), -1)
    step = np.hypot(*(corners.positions[after] - corners.positions).T)
    linked = doubtful & doubtful[after] & (step <= ROUNDING_STEP) & (corners.turns * corners.turns[after] > 0.0)
    if linked.all():
        return [corners.indices] if count > 1 else []
    start = int(np.argmin(linked)) + 1
    order = (start + np.arange(count)) % count
    ends = np.flatnonzero(np.diff(np.concatenate([[0], linked[order], [0]])))
    return [corners.indices[order[a : b + 1]] for a, b in zip(ends[::2], ends[1::2], strict=True)]


def _if_cheaper(runs: _Runs, corners: Corners, group: np.ndarray) -> Corners:
    """The corners without a group of them (indices, in a row), if that is cheaper."""
    count = len(corners.indices)
    first, size = int(np.flatnonzero(corners.indices == group[0])[0]), len(group)
    bonus = CORNER_PARAMETERS * size * runs.price
    if size == count:
        with_them = sum(runs.division(corners, k, k + 1).cost for k in range(count))
        without = runs.loop_cost()
    else:
        with_them = sum(runs.division(corners, k, k + 1).cost for k in range(first - 1, first + size))
        without = runs.division(corners, first - 1, first + size).cost
    return corners.taken(~np.isin(corners.indices, group)) if without <= with_them + bonus else corners


def _doubtful(corners: Corners, k: int) -> bool:
    """Whether a corner turns little or has another near."""
    if corners.sure[k]:
        return False
    gaps = np.hypot(*(corners.positions - corners.positions[k]).T)
    gaps[k] = np.inf
    return bool(abs(corners.turns[k]) < DOUBTFUL_TURN or gaps.min() <= DOUBTFUL_SPACING)


def _section(points: np.ndarray, weights: np.ndarray, ends: np.ndarray) -> Section:
    known = np.flatnonzero(weights > SURE_WEIGHT)
    errors = np.array([CORNER_ERRORS, CORNER_ERRORS])
    if len(known) < FEWEST_KNOWN:
        way = ends[1] - ends[0]
        tangents = np.tile(way / max(float(np.hypot(*way)), 1e-9), (2, 1))
        return Section(
            _straight_fits(ends, tangents[0], len(points)), np.zeros(len(points)), ends, tangents, errors, True
        )
    fits = local_fits(points, weights, closed=False)
    tangents = np.stack([_towards(fits, known[0], ends[0]), _towards(fits, known[-1], ends[1])])
    return Section(fits, weights, ends, tangents, errors, True)


def _straight_fits(ends: np.ndarray, tangent: np.ndarray, count: int) -> LocalFits:
    t = (np.arange(count)[:, None] + 0.5) / count
    positions = ends[0] * (1.0 - t) + ends[1] * t
    nothing = np.zeros(count)
    return LocalFits(positions, np.tile(tangent, (count, 1)), nothing, nothing, np.ones((count, 2)))


def _towards(fits: LocalFits, index: int, end: np.ndarray) -> np.ndarray:
    """The tangent at an end, carried there from a point by the curvature."""
    tangent = fits.tangents[index]
    turn = float(np.clip(fits.curvature[index] * ((end - fits.positions[index]) @ tangent), -0.5, 0.5))
    cos, sin = math.cos(turn), math.sin(turn)
    return np.array([cos * tangent[0] - sin * tangent[1], sin * tangent[0] + cos * tangent[1]])


def _divided_loop(points: np.ndarray, weights: np.ndarray, price: float) -> tuple[np.ndarray, Division]:
    """A loop without corners, divided from two starting points; the cheaper one."""
    fits = local_fits(points, weights, closed=True)
    start = int(np.argmin(np.where(weights > SURE_WEIGHT, fits.positions[:, 0], np.inf)))
    best = _loop_from(fits, weights, start, price)
    breaks = best[1].breaks[1:-1]
    if len(breaks):
        other = int(best[0][breaks[len(breaks) // 2]])
        again = _loop_from(fits, weights, other, price)
        if again[1].cost < best[1].cost:
            best = again
    return best


def _loop_from(fits: LocalFits, weights: np.ndarray, start: int, price: float) -> tuple[np.ndarray, Division]:
    order = (start + np.arange(len(weights))) % len(weights)
    turned = fits.taken(order)
    at, tangent = turned.positions[[0, 0]], turned.tangents[[0, 0]]
    errors = np.maximum(turned.errors[[0, 0]], LEAST_ERRORS)
    return order, divide(Section(turned, weights[order], at, tangent, errors, False), price)
