"""The edges of lines so thin that no pixel across them is purely theirs.

Down a column across a line of fill T, with fill B above and C below, lie the edges e1 and e2. Whatever their slopes,
the pixels of the column from row r0 to r1 sum up to B (e1 - r0) + T (e2 - e1) + C (r1 - e2), a linear equation in e1
and e2 for each channel. Where B, T and C lie on one line of colours it tells only one of them; then the line's middle
is taken from the centroid of what differs from its ground.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.regions.regions import Regions

MOST = 4  # px a line may be across, and px beyond it within which its ground must be pure
PURE = 6.0  # levels
# Of the squares of the sines between B - T and C - T above which both edges follow from the sums.
APART = 0.03
FARTHEST = 1.5  # px from the crack that an edge may lie
THINNEST = 0.1  # px


def thin_edges(
    levels: np.ndarray, regions: Regions, y: np.ndarray, x: np.ndarray, sign: int
) -> tuple[np.ndarray, np.ndarray]:
    """The heights (n,) of the border at the cracks above the pixels y, x (n,), and whether they were found (n,) bool.

    levels: (H, W, 4). sign: 1 where the thin line is below the crack, -1 where it is above.
    """
    height = levels.shape[0]
    labels = regions.labels
    first = y if sign > 0 else y - 1
    own = labels[first, x]
    near = y - 1 if sign > 0 else y
    far, found = _beyond(labels, own, first, x, sign)
    start, clean = _pure(levels, regions, near, x, -sign)
    stop, also = _pure(levels, regions, far, x, sign)
    good = found & clean & also
    top = np.where(sign > 0, start, stop)
    bottom = np.where(sign > 0, stop, start)
    above = regions.fills[labels[np.where(sign > 0, near, far), x]].astype(float)
    below = regions.fills[labels[np.where(sign > 0, far, near), x]].astype(float)
    total, moment = np.zeros((len(y), 4)), np.zeros((len(y), 4))
    fill = regions.fills[own].astype(float)
    for step in range(3 * MOST + 2):
        row = top + step
        inside = (row <= bottom)[:, None]
        value = np.where(inside, levels[np.clip(row, 0, height - 1), x], 0.0)
        total += value
        moment += value * (row + 0.5)[:, None]
    upper, lower = _solved(total, moment, top.astype(float), bottom + 1.0, (above, fill, below))
    edge = upper if sign > 0 else lower
    good &= np.isfinite(edge) & (lower - upper > THINNEST) & (np.abs(edge - y) < FARTHEST)
    return np.where(good, edge, y), good


def _beyond(
    labels: np.ndarray, own: np.ndarray, first: np.ndarray, x: np.ndarray, sign: int
) -> tuple[np.ndarray, np.ndarray]:
    """The first row of another region beyond a line, and whether there is one within MOST px."""
    height = labels.shape[0]
    row, found = first.copy(), np.zeros(len(first), dtype=bool)
    for _ in range(MOST):
        following = row + sign
        inside = (following >= 0) & (following < height)
        following = np.clip(following, 0, height - 1)
        row = np.where(found | ~inside, row, following)
        found |= inside & (labels[row, x] != own)
    return row, found


def _pure(
    levels: np.ndarray, regions: Regions, row: np.ndarray, x: np.ndarray, sign: int
) -> tuple[np.ndarray, np.ndarray]:
    """The first row from `row` on that is purely the fill of its region, and whether there is one within MOST px."""
    height = levels.shape[0]
    label = regions.labels[row, x]
    fill = regions.fills[label]
    at, found = row.copy(), np.zeros(len(row), dtype=bool)
    lost = found.copy()
    for step in range(MOST):
        here = np.clip(row + sign * step, 0, height - 1)
        lost |= regions.labels[here, x] != label
        pure = ~found & ~lost & (np.abs(levels[here, x] - fill).max(axis=1) <= PURE)
        at[pure] = here[pure]
        found |= pure
    return at, found


def _solved(
    total: np.ndarray, moment: np.ndarray, r0: np.ndarray, r1: np.ndarray, fills: tuple[np.ndarray, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Both edges (n,) of lines by the sums of their columns (n, 4), and by the moments where those do not tell."""
    above, fill, below = fills
    a, c = above - fill, fill - below
    rest = total + above * r0[:, None] - below * r1[:, None]
    aa, cc, ac = (a * a).sum(1), (c * c).sum(1), (a * c).sum(1)
    ra, rc = (rest * a).sum(1), (rest * c).sum(1)
    det = aa * cc - ac * ac
    sure = det > APART * aa * cc
    safe = np.where(sure, det, 1.0)
    upper, lower = (ra * cc - rc * ac) / safe, (rc * aa - ra * ac) / safe
    # On one line of colours: how much fill, and around which height, above a ground that is the same on both sides.
    alike = ~sure & (np.abs(above - below).max(axis=1) <= PURE)
    base, span = 0.5 * (above + below), fill - 0.5 * (above + below)
    length = np.maximum((span * span).sum(1), 1e-9)
    amount = ((total - base * (r1 - r0)[:, None]) * span).sum(1) / length
    about = ((moment - base * (0.5 * (r1 * r1 - r0 * r0))[:, None]) * span).sum(1) / length
    middle = about / np.where(np.abs(amount) > THINNEST, amount, np.nan)
    upper = np.where(sure, upper, np.where(alike, middle - 0.5 * amount, np.nan))
    lower = np.where(sure, lower, np.where(alike, middle + 0.5 * amount, np.nan))
    return upper, lower
