"""Fills of small pictures with noise: what fills squares of 2 x 2 px, where hardly anything fills more."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of

SMALL = 128  # px of the longer side, up to which details are so small
CALM = 1.5  # times the misfit that a square may deviate
FEWEST, MOST = 3, 24  # squares that show a fill, and fills
# A square lies on a ramp where its colour is a blend of those up to so many px to either side of it: shares, and times
# the misfit that it is off that and these are apart.
REACH, BLENDED, MISFITS, CONTRAST = 2, (0.15, 0.85), 2.0, 6.0


def square_fills(
    levels: np.ndarray, seen: np.ndarray, known: np.ndarray, sigma: float, reach: float, apart: float
) -> np.ndarray:
    """(k, 4) fills in levels that squares of 2 x 2 px show and that are none of those known, the commonest first.

    levels: (H, W, 4) the picture; seen: (H, W, 4) the same in coordinates whose distances tell fills apart; known:
    (P, 4) in these; sigma: levels by which pixels are off there; reach: levels within which colours are one fill;
    apart: levels beyond which they are two.
    """
    if min(levels.shape[:2]) < 4 or max(levels.shape[:2]) > SMALL:
        return np.zeros((0, 4))
    corners = np.stack([seen[y : seen.shape[0] - 1 + y, x : seen.shape[1] - 1 + x] for y in (0, 1) for x in (0, 1)])
    mean = corners.mean(axis=0)
    calm = corners.std(axis=0).max(axis=-1) <= CALM * sigma
    calm &= ~_on_ramps(seen, mean, sigma)
    far = calm & (np.abs(mean[..., None, :] - known).max(axis=-1).min(axis=-1) > apart)
    y, x = np.nonzero(far)
    if not len(y):
        return np.zeros((0, 4))
    from scipy.spatial import cKDTree  # takes a while to import, and few pictures have such squares

    fills: list[np.ndarray] = []
    while len(y) and len(fills) < MOST:
        values = mean[y, x]
        # As many of the squares as there are within reach of each.
        around = cKDTree(values).query_ball_point(values, reach, p=np.inf, return_length=True)
        densest = values[int(around.argmax())]
        if around.max() < FEWEST:
            break
        gap = np.abs(values - densest).max(axis=1)
        own = gap <= reach
        fills.append(np.median([levels[y[own] + dy, x[own] + dx] for dy in (0, 1) for dx in (0, 1)], axis=(0, 1)))
        y, x = y[gap > apart], x[gap > apart]
    return np.array(fills, dtype=float).reshape(-1, 4)


def _on_ramps(seen: np.ndarray, mean: np.ndarray, sigma: float) -> np.ndarray:
    """(H - 1, W - 1) bool: the squares with means (H - 1, W - 1, 4) that blend what lies to either side of them."""
    padded = np.pad(seen, ((REACH, REACH), (REACH, REACH), (0, 0)), mode="edge")
    out = np.zeros(mean.shape[:2], dtype=bool)
    for turned in (False, True):
        around, middle = (padded.swapaxes(0, 1), mean.swapaxes(0, 1)) if turned else (padded, mean)
        height, width = middle.shape[:2]
        # The two pixels beside the square, in the rows or columns that it has.
        pair = 0.5 * (around[REACH : REACH + height] + around[REACH + 1 : REACH + height + 1])
        for off in range(1, REACH + 1):
            before, after = pair[:, REACH - off :][:, :width], pair[:, REACH + 1 + off :][:, :width]
            share, rest = blend_of(middle, before, after)
            ramp = (share > BLENDED[0]) & (share < BLENDED[1]) & (np.linalg.norm(rest, axis=-1) <= MISFITS * sigma)
            ramp &= np.linalg.norm(after - before, axis=-1) > CONTRAST * sigma
            out |= ramp.T if turned else ramp
    return out
