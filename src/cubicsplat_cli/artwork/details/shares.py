"""Which inks a pixel is a blend of, and how much of it each covers."""

from __future__ import annotations

from itertools import combinations

import numpy as np

# Levels: what a blend of two or of three inks must explain better than one of fewer, and one with an ink that no pixel
# near shows.
SECOND, THIRD, NOT_NEAR = 6.0, 14.0, 8.0
MOST_OF_THREE = 8  # inks near, of which three may blend
SLACK = 0.02  # by which shares may be off 0 and 1


def ink_shares(values: np.ndarray, palette: np.ndarray, near: np.ndarray) -> np.ndarray:
    """(n, P) shares of the inks of a palette (P, 4) in pixels (n, 4), all premultiplied RGBA in levels; sums are 1.

    near: (n, P) bool, which inks show beside the pixel. Of one ink, all pairs and triples of the commonest inks near,
    the blend with the least distance and penalty is taken.
    """
    count, inks = len(values), len(palette)
    far = np.where(near, 0.0, NOT_NEAR)
    gaps = np.abs(values[:, None] - palette[None]).max(axis=2)
    first = gaps.argmin(axis=1)
    best = gaps[np.arange(count), first]
    shares = np.zeros((count, inks))
    shares[np.arange(count), first] = 1.0
    for a, b in combinations(range(inks), 2):
        own = _within(values, palette[[a, b]])
        cost = np.abs(values - own @ palette[[a, b]]).max(axis=1) + SECOND + far[:, a] + far[:, b]
        _take(shares, best, cost, own, [a, b])
    common = np.argsort(-near.sum(axis=0), kind="stable")[:MOST_OF_THREE]
    for some in combinations(sorted(common.tolist()), 3):
        own, inside = _barycentric(values, palette[list(some)])
        cost = np.abs(values - own @ palette[list(some)]).max(axis=1) + THIRD + far[:, list(some)].sum(axis=1)
        _take(shares, best, np.where(inside, cost, np.inf), own, list(some))
    return shares


def _take(shares: np.ndarray, best: np.ndarray, cost: np.ndarray, own: np.ndarray, inks: list[int]) -> None:
    """Puts a blend's shares in place where it costs less than the best so far."""
    better = np.flatnonzero(cost < best)
    best[better] = cost[better]
    shares[better] = 0.0
    shares[better[:, None], inks] = own[better]


def _within(values: np.ndarray, pair: np.ndarray) -> np.ndarray:
    """(n, 2) the shares of two inks (2, 4) that come nearest to values (n, 4)."""
    span = pair[0] - pair[1]
    share = np.clip((values - pair[1]) @ span / max(float(span @ span), 1e-9), 0.0, 1.0)
    return np.stack([share, 1.0 - share], axis=1)


def _barycentric(values: np.ndarray, three: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) the shares of three inks (3, 4) that come nearest to values (n, 4), and where none is negative (n,)."""
    spans = (three[:2] - three[2]).T
    gram = spans.T @ spans
    if np.linalg.det(gram) < 1e-6 * max(float(gram[0, 0] * gram[1, 1]), 1e-9):
        return np.zeros((len(values), 3)), np.zeros(len(values), dtype=bool)
    shares = np.linalg.solve(gram, spans.T @ (values - three[2]).T).T
    shares = np.column_stack([shares, 1.0 - shares.sum(axis=1)])
    inside = np.asarray((shares >= -SLACK).all(axis=1))
    shares = np.clip(shares, 0.0, 1.0)
    return shares / np.maximum(shares.sum(axis=1, keepdims=True), 1e-9), inside
