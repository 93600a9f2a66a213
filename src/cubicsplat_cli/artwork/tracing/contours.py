"""Positions of the border between two fills within the pixels that it crosses.

The blends on an edge say how much of each pixel either fill covers. Summed along a column across a border that runs
rather level (or along a row across a steep one) the shares give the border's mean height over that column exactly,
whatever its slope, because a pixel's share is an area. That is taken as a point at the column's middle.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.regions.cracks import CrackLoop
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.artwork.regions.thin import thin_edges
from cubicsplat_cli.records import dataclass

# So many pixels to either side of a crack may belong to the border's blend.
WALK = 3
# Shares this near to 0 or 1 end the walk.
PURE_SHARE = 0.02
# Residuals, in levels, of a blend that only its two fills explain.
CLEAN_RESIDUAL = 10.0
# Standard errors in px: of drawing programs with 4x4 samples a pixel; beside a third fill; without a clean walk.
FLOOR, NEAR_THIRD, GUESS = 0.04, 0.3, 0.5
THIN = 0.1  # of an edge of a line without a pure pixel
ROUNDING = 0.8  # levels by which a clean picture's pixels are off
# Of what ends with the canvas; and levels by which a pixel there must differ from its fill for an edge to be sought.
RIM_SIGMA, RIM_LEVELS = 0.02, 4.0
# Px; the first row of a picture that is not clean is one fill or the other. Times that, where what touches the border,
# and does not cross it, still is not far away; 4 for circles.
RIM, TANGENT = 1.0, 6.0


@dataclass(frozen=True)
class EdgePositions:
    """Sub-pixel positions across every crack of a picture.

    rows: (H + 1, W) y of the border across the horizontal crack above pixel (y, x); columns: (H, W + 1) x of the border
    across the vertical crack left of it; row_sigma, column_sigma: their standard errors in px. rim: px within the
    canvas's border in which an edge may run and not show.
    """

    rows: np.ndarray
    row_sigma: np.ndarray
    columns: np.ndarray
    column_sigma: np.ndarray
    rim: float = 0.0


def edge_positions(levels: np.ndarray, regions: Regions, error: float = ROUNDING) -> EdgePositions:
    """Positions for all cracks between different regions of a picture (H, W, 4) in levels, known to an error."""
    rows, row_sigma = _level(levels, regions, error)
    turned = Regions(regions.labels.T, regions.fills, regions.fill_of)
    columns, column_sigma = _level(levels.transpose(1, 0, 2), turned, error)
    return EdgePositions(rows, row_sigma, columns.T, column_sigma.T, RIM if error > ROUNDING else 0.0)


def _level(levels: np.ndarray, regions: Regions, error: float) -> tuple[np.ndarray, np.ndarray]:
    height, width = regions.labels.shape
    at = np.broadcast_to(np.arange(height + 1, dtype=float)[:, None], (height + 1, width)).copy()
    sigma = np.full((height + 1, width), 0.02)
    y, x = np.nonzero(regions.labels[1:] != regions.labels[:-1])
    if len(y):
        at[y + 1, x], sigma[y + 1, x] = _heights(levels, regions, y + 1, x, error)
    depth, sigma[0] = _rim(levels, regions)
    at[0] = depth
    depth, sigma[-1] = _rim(levels[::-1], Regions(regions.labels[::-1], regions.fills, regions.fill_of))
    at[-1] = height - depth
    return at, sigma


def _rim(levels: np.ndarray, regions: Regions) -> tuple[np.ndarray, np.ndarray]:
    """Depths below the canvas's upper border, px, at which the topmost regions begin, (W,), and the standard errors.

    An edge may run within the first row: what is beyond it, nothing or another fill, shows in its pixels only.
    """
    labels = regions.labels
    own = labels[0]
    base = regions.fills[own]
    depth, sigma = np.zeros(len(own)), np.full(len(own), RIM_SIGMA)
    mixed = np.abs(levels[0] - base).max(axis=1) > RIM_LEVELS
    if not mixed.any():
        return depth, sigma
    beside = (own != np.roll(own, 1)) | (own != np.roll(own, -1))
    x = np.flatnonzero(mixed)
    span, rest = _beyond(levels[0, x], base[x], regions)
    walked, ended = np.zeros(len(x)), np.zeros(len(x), dtype=bool)
    for row in range(min(WALK, len(labels))):
        here = (labels[row, x] == own[x]) & ~ended
        share, _ = _share(levels[row, x], base[x], span)
        walked += np.where(here, share, 0.0)
        ended |= here & (share <= PURE_SHARE)
    clean = ended & (rest <= CLEAN_RESIDUAL) & ~beside[x]
    depth[x] = np.where(clean, walked, 0.0)
    contrast = np.sqrt((span * span).sum(axis=1))
    sigma[x] = np.where(clean, np.hypot(FLOOR, ROUNDING / np.maximum(contrast, 1.0)), NEAR_THIRD)
    return depth, sigma


def _beyond(values: np.ndarray, base: np.ndarray, regions: Regions) -> tuple[np.ndarray, np.ndarray]:
    """From their own fills (n, 4) to what values (n, 4) blend with, (n, 4), and the residuals (n,): nothing, or the
    fill that explains clearly more.
    """
    span = -base
    rest = _share(values, base, span)[1]
    for fill in np.unique(regions.fills, axis=0):
        other = fill - base
        residual = _share(values, base, other)[1]
        better = residual + RIM_LEVELS < rest
        span[better], rest[better] = other[better], residual[better]
    return span, rest


def _heights(
    levels: np.ndarray, regions: Regions, y: np.ndarray, x: np.ndarray, error: float
) -> tuple[np.ndarray, np.ndarray]:
    above, below = regions.labels[y - 1, x], regions.labels[y, x]
    base = regions.fills[below]
    span = regions.fills[above] - base
    contrast = np.sqrt((span * span).sum(axis=1))
    shift = np.zeros(len(y))
    clean = np.ones(len(y), dtype=bool)
    edge, by_line = np.zeros(len(y)), np.zeros(len(y), dtype=bool)
    third = np.zeros(len(y), dtype=bool)
    for sign in (-1, 1):
        own = above if sign < 0 else below
        walked, ended = np.zeros(len(y)), np.zeros(len(y), dtype=bool)
        for step in range(WALK):
            row = y - 1 - step if sign < 0 else y + step
            inside = (row >= 0) & (row < levels.shape[0])
            row = np.clip(row, 0, levels.shape[0] - 1)
            here = inside & (regions.labels[row, x] == own) & ~ended
            share, residual = _share(levels[row, x], base, span)
            missing = 1.0 - share if sign < 0 else share
            walked += np.where(here, missing, 0.0)
            third |= here & ((residual > CLEAN_RESIDUAL) | _third_beside(regions.labels, row, x, above, below))
            # Walking off the canvas or into another region without having met the pure fill is no clean end.
            ended |= (here & (missing <= PURE_SHARE)) | (~inside & (step > 0))
        clean &= ended
        line = np.flatnonzero(~ended & (regions.labels[np.clip(y + sign * WALK, 0, levels.shape[0] - 1), x] != own))
        edge[line], by_line[line] = thin_edges(levels, regions, y[line], x[line], sign)
        shift += -walked if sign < 0 else walked
    sigma = np.hypot(FLOOR, error / np.maximum(contrast, 1.0))
    sigma = np.where(third, NEAR_THIRD, sigma)
    sigma = np.where(clean, sigma, GUESS)
    return np.where(by_line, edge, y + shift), np.where(by_line, THIN, sigma)


def _share(values: np.ndarray, base: np.ndarray, span: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The share (n,) of the upper fill in a blend, and what it leaves unexplained in levels."""
    length = np.maximum((span * span).sum(axis=1), 1e-9)
    share = np.clip(((values - base) * span).sum(axis=1) / length, 0.0, 1.0)
    return share, np.abs(values - base - share[:, None] * span).max(axis=1)


def _third_beside(
    labels: np.ndarray, row: np.ndarray, x: np.ndarray, above: np.ndarray, below: np.ndarray
) -> np.ndarray:
    out = np.zeros(len(row), dtype=bool)
    for side in (-1, 1):
        other = labels[row, np.clip(x + side, 0, labels.shape[1] - 1)]
        out |= (other != above) & (other != below)
    return out


def loop_points(loop: CrackLoop, found: EdgePositions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sub-pixel points along a loop: (m, 2) px, their standard errors (m,), and the index (m,) of each one's crack.

    Where the border runs rather level its points come from the horizontal cracks, else from the vertical ones, so that
    there is one point a column or a row.
    """
    level = loop.direction % 2 == 0
    step = np.where(level, 1.0, 0.0)
    mostly_level = _smoothed(step, 4) >= 0.5
    keep = level == mostly_level
    if keep.sum() < 4:
        keep = np.ones(len(level), dtype=bool)
    index = np.nonzero(keep)[0]
    points = loop.middles[index].astype(float)
    sigma = np.empty(len(index))
    flat = level[index]
    x, y, direction = loop.x[index], loop.y[index], loop.direction[index]
    column = np.where(direction == 2, x - 1, x)
    row = np.where(direction == 3, y - 1, y)
    points[flat, 1] = found.rows[y[flat], column[flat]]
    sigma[flat] = found.row_sigma[y[flat], column[flat]]
    points[~flat, 0] = found.columns[row[~flat], x[~flat]]
    sigma[~flat] = found.column_sigma[row[~flat], x[~flat]]
    if found.rim:
        sigma = np.where(_leaving(loop, found)[index], np.maximum(sigma, 0.5 * found.rim), sigma)
    return points, sigma, index


def _leaving(loop: CrackLoop, found: EdgePositions) -> np.ndarray:
    """(n,) which cracks on the canvas's border lie where the loop seems to leave it like something round, though it may
    never have reached it: a circle of radius r that touches the border is within the rim of it for the root of 2 r rim
    to either side, and after twice that four times as far away.
    """
    height, width = found.rows.shape[0] - 1, found.columns.shape[1] - 1
    x, y = loop.middles.T
    depth = np.minimum(np.minimum(x, width - x), np.minimum(y, height - y))
    on, count = depth == 0.0, len(depth)
    off = np.flatnonzero(~on)
    if not len(off):
        return ~on
    reach = int(np.sqrt(min(np.ptp(loop.x), np.ptp(loop.y)) * found.rim))
    every = np.arange(count)
    place = np.searchsorted(off, every)
    after, before = off[place % len(off)], off[place - 1]
    shallow = depth <= TANGENT * found.rim
    onward = ((after - every) % count <= reach) & shallow[(after + reach) % count]
    back = ((every - before) % count <= reach) & shallow[(before - reach) % count]
    return on & (onward | back)


def _smoothed(values: np.ndarray, reach: int) -> np.ndarray:
    """The mean over `reach` neighbours to either side of a closed loop."""
    reach = min(reach, (len(values) - 1) // 2)
    padded = np.concatenate([values[len(values) - reach :], values, values[:reach]])
    sums = np.concatenate([[0.0], np.cumsum(padded)])
    return (sums[2 * reach + 1 :] - sums[: -(2 * reach + 1)]) / (2 * reach + 1)
