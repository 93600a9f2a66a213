"""Colour ramps: the piecewise linear profile of a gradient, and which places along it have a stop.

Along the parameter t of a gradient the colours of its pixels, (n, 4) premultiplied in levels, follow straight lines
between stops. For given places of the stops the best colours are a linear least-squares fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Levels: what rounding to 8 bits and the arithmetic of drawing programs leave.
SIGMA = 0.4
# Neighbouring pixels are off together, so each counts for less; and one that no ramp explains for so much at most.
SHARE, MOST_CHI = 0.2, 36.0
PRICE = 4.0  # nats a parameter
STOP_PARAMETERS = 4  # a place and a colour, most often opaque
MOST_STOPS = 8
BINS = 64
STIFF = 1e-6
EVEN = 1.0  # levels by which neighbouring stops at the ends may differ to be one, since ramps go on as they end


@dataclass(frozen=True)
class Ramp:
    """knots: (K,) ascending t; colours: (K, 4) levels there."""

    knots: np.ndarray
    colours: np.ndarray

    def at(self, t: np.ndarray) -> np.ndarray:
        """(n, 4) the colours at t (n,)."""
        return np.stack([np.interp(t, self.knots, self.colours[:, k]) for k in range(4)], axis=-1)


def alike(first: Ramp, second: Ramp) -> float:
    """How far, in levels, the colours of one ramp are from those of the other, the shorter of both ways."""
    ways = []
    for a, b in ((first, second), (second, first)):
        here, there = (r.at(np.linspace(r.knots[0], r.knots[-1], n)) for r, n in ((a, 9), (b, 65)))
        gaps = np.abs(here[:, None] - there[None]).max(axis=2).min(axis=1)
        ways.append(float(np.median(gaps)))
    return min(ways)


def misfit(residuals: np.ndarray) -> float:
    """Half of chi^2, in nats, of residuals (n, 4) in levels."""
    chi = (residuals * residuals).sum(axis=1) / (SIGMA * SIGMA)
    return 0.5 * SHARE * float(np.minimum(chi, MOST_CHI).sum())


def hats(t: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """(n, K) how much of each knot's colour the ramp has at t."""
    place = np.clip(t, knots[0], knots[-1])
    after = np.clip(np.searchsorted(knots, place, side="right"), 1, len(knots) - 1)
    share = (place - knots[after - 1]) / np.maximum(knots[after] - knots[after - 1], 1e-12)
    out = np.zeros((len(t), len(knots)))
    rows = np.arange(len(t))
    out[rows, after - 1] = 1.0 - share
    out[rows, after] += share
    return out


def fitted(t: np.ndarray, values: np.ndarray, weights: np.ndarray, knots: np.ndarray) -> Ramp:
    """The ramp with these knots nearest to values (n, 4), each pixel with its weight (n,)."""
    return Ramp(knots, best_colours(hats(t, knots), values, weights))


def best_colours(basis: np.ndarray, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(K, 4) the colours of stops with which a basis (n, K) of `hats` comes nearest to values (n, 4)."""
    weighted = (basis * weights[:, None]).T
    # A knot that hardly a pixel is near goes with its neighbours.
    bends = np.diff(np.eye(basis.shape[1]), axis=0)
    gram = weighted @ basis + STIFF * float(weights.sum()) * (bends.T @ bends)
    return np.linalg.solve(gram, weighted @ values)


def ramp_of(t: np.ndarray, values: np.ndarray) -> Ramp:
    """The ramp with the shortest description of values (n, 4) at t (n,): as many stops as the pixels support."""
    middles, means, sizes = _binned(t, values)
    knots = np.array([middles[0], middles[-1]])
    if knots[1] - knots[0] < 1e-9:
        return Ramp(np.array([knots[0], knots[0] + 1.0]), np.repeat(values.mean(axis=0)[None], 2, axis=0))
    best = fitted(middles, means, sizes, knots)
    cost = _cost(best, middles, means, sizes)
    while len(best.knots) < MOST_STOPS:
        trial = _with_a_knot(best, middles, means, sizes)
        following = _cost(trial, middles, means, sizes)
        if following >= cost:
            break
        best, cost = trial, following
    return trimmed(best)


def trimmed(ramp: Ramp) -> Ramp:
    """The ramp without end stops that repeat their neighbours."""
    first, last = 0, len(ramp.knots) - 1
    gaps = np.abs(np.diff(ramp.colours, axis=0)).max(axis=1)
    while last - first > 1 and gaps[first] <= EVEN:
        first += 1
    while last - first > 1 and gaps[last - 1] <= EVEN:
        last -= 1
    return Ramp(ramp.knots[first : last + 1], ramp.colours[first : last + 1])


def _binned(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean t (b,), mean colours (b, 4) and px (b,) of bins of equal length along t; empty ones are left out."""
    low, high = float(t.min()), float(t.max())
    index = np.minimum(((t - low) * (BINS / max(high - low, 1e-12))).astype(int), BINS - 1)
    sizes = np.bincount(index, minlength=BINS).astype(float)
    full = sizes > 0
    middles = np.bincount(index, t, BINS)[full] / sizes[full]
    means = np.stack([np.bincount(index, values[:, k], BINS)[full] / sizes[full] for k in range(4)], axis=1)
    return middles, means, sizes[full]


def scatter(t: np.ndarray, values: np.ndarray) -> float:
    """The mean square, levels^2, by which values (n, 4) differ from those that have about the same t."""
    middles, means, _ = _binned(t, values)
    return float(((Ramp(middles, means).at(t) - values) ** 2).sum(axis=1).mean())


def _cost(ramp: Ramp, t: np.ndarray, means: np.ndarray, sizes: np.ndarray) -> float:
    squares = ((ramp.at(t) - means) ** 2).sum(axis=1)
    return 0.5 * SHARE * float(squares @ sizes) / SIGMA**2 + PRICE * STOP_PARAMETERS * len(ramp.knots)


def _with_a_knot(ramp: Ramp, t: np.ndarray, means: np.ndarray, sizes: np.ndarray) -> Ramp:
    """The best ramp with one knot more, of those with it in every second bin; then each knot at its best place."""
    knots, least = ramp.knots, np.inf
    for place in t[1:-1:2]:
        if np.abs(ramp.knots - place).min() < 1e-9:
            continue
        trial = np.sort(np.append(ramp.knots, place))
        cost = _cost(fitted(t, means, sizes, trial), t, means, sizes)
        if cost < least:
            knots, least = trial, cost
    for _ in range(2):
        for i in range(1, len(knots) - 1):
            near = t[(t > knots[i - 1] + 1e-9) & (t < knots[i + 1] - 1e-9)]
            near = near[np.argsort(np.abs(near - knots[i]), kind="stable")[1:7]]
            for place in near:
                trial = np.concatenate([knots[:i], [place], knots[i + 1 :]])
                cost = _cost(fitted(t, means, sizes, trial), t, means, sizes)
                if cost < least:
                    knots, least = trial, cost
    return fitted(t, means, sizes, knots)
