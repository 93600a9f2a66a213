"""Outlines of masks along the cracks between pixels, and positions of the border between two fills within these pixels.

A crack is the unit edge between two neighbouring pixels. Loops run with the mask on their right, so that outer loops
are clockwise as seen (y grows downwards) and holes the other way.

The blends on an edge say how much of each pixel either fill covers. Summed along a column across a border that runs
rather level (or along a row across a steep one) the shares give the border's mean height over that column exactly,
whatever its slope, because a pixel's share is an area. That is taken as a point at the column's middle.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of, largest
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.artwork.regions.sampling import FEW_SAMPLES
from cubicsplat_cli.artwork.regions.thin import thin_edges
from cubicsplat_cli.raster.cpu import doubles
from cubicsplat_cli.raster.outlines import Positions

# So many pixels to either side of a crack may belong to the border's blend.
WALK = 3
# Shares this near to 0 or 1 end the walk.
PURE_SHARE = 0.02
# Residuals, in levels, of a blend that only its two fills explain.
CLEAN_RESIDUAL = 10.0
# Standard errors in px: beside a third fill; without a clean walk.
NEAR_THIRD, GUESS = 0.3, 0.5
THIN = 0.1  # of an edge of a line without a pure pixel
ROUNDING = 0.8  # levels by which a clean picture's pixels are off
# Of what ends with the canvas; and levels by which a pixel there must differ from its fill for an edge to be sought.
RIM_SIGMA, RIM_LEVELS = 0.02, 4.0
RIM = 1.0  # px; the first row of a picture that is not clean is one fill or the other


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

    @cached_property
    def native(self) -> Positions:
        """The same for the native library."""
        rows, row_sigma, columns, column_sigma = map(
            doubles, (self.rows, self.row_sigma, self.columns, self.column_sigma)
        )
        return rows, row_sigma, columns, column_sigma, float(self.rim)


def edge_positions(
    levels: np.ndarray, regions: Regions, error: float = ROUNDING, share_error: float = FEW_SAMPLES
) -> EdgePositions:
    """Positions for all cracks between different regions of a picture (H, W, 4) in levels, known to an error.

    share_error: of the shares of pixels that shapes cover.
    """
    rows, row_sigma = _level(levels, regions, error, share_error)
    turned = Regions(regions.labels.T, regions.fills, regions.fill_of)
    columns, column_sigma = _level(levels.transpose(1, 0, 2), turned, error, share_error)
    columns, column_sigma = (np.ascontiguousarray(each.T) for each in (columns, column_sigma))
    return EdgePositions(rows, row_sigma, columns, column_sigma, RIM if error > ROUNDING else 0.0)


def _level(levels: np.ndarray, regions: Regions, error: float, share_error: float) -> tuple[np.ndarray, np.ndarray]:
    height, width = regions.labels.shape
    at = np.broadcast_to(np.arange(height + 1, dtype=float)[:, None], (height + 1, width)).copy()
    sigma = np.full((height + 1, width), 0.02)
    y, x = np.nonzero(regions.labels[1:] != regions.labels[:-1])
    if len(y):
        at[y + 1, x], sigma[y + 1, x] = _heights(levels, regions, y + 1, x, (error, share_error))
    depth, sigma[0] = _rim(levels, regions, share_error)
    at[0] = depth
    depth, sigma[-1] = _rim(levels[::-1], Regions(regions.labels[::-1], regions.fills, regions.fill_of), share_error)
    at[-1] = height - depth
    return at, sigma


def _rim(levels: np.ndarray, regions: Regions, share_error: float) -> tuple[np.ndarray, np.ndarray]:
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
    sigma[x] = np.where(clean, np.hypot(share_error, ROUNDING / np.maximum(contrast, 1.0)), NEAR_THIRD)
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
    levels: np.ndarray, regions: Regions, y: np.ndarray, x: np.ndarray, errors: tuple[float, float]
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
    sigma = np.hypot(errors[1], errors[0] / np.maximum(contrast, 1.0))
    sigma = np.where(third, NEAR_THIRD, sigma)
    sigma = np.where(clean, sigma, GUESS)
    return np.where(by_line, edge, y + shift), np.where(by_line, THIN, sigma)


def _share(values: np.ndarray, base: np.ndarray, span: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The share (n,) of the upper fill in a blend, and what it leaves unexplained in levels."""
    share, rest = blend_of(values, base, base + span)
    return share, largest(np.abs(rest))


def _third_beside(
    labels: np.ndarray, row: np.ndarray, x: np.ndarray, above: np.ndarray, below: np.ndarray
) -> np.ndarray:
    out = np.zeros(len(row), dtype=bool)
    for side in (-1, 1):
        other = labels[row, np.clip(x + side, 0, labels.shape[1] - 1)]
        out |= (other != above) & (other != below)
    return out
