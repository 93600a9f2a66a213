"""Convert text that was anti-aliased for an LCD's subpixels to text that is anti-aliased for whole pixels.

LCD text has three samples a pixel: red a third of a pixel to the left of green, and blue as far to the right, or the
other way round. Each is the weighted mean of a few subpixels. In that order they are a row of coverages, three times as
fine as the picture. The filter is inverted, and a pixel's coverage is the mean of its three subpixels.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.regions.fills import EVEN, LONG
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import spread
from cubicsplat_cli.record import record

OFFSETS = np.array([-1.0, 0.0, 1.0])  # of a pixel's subpixels, thirds of a pixel
# Filters: the part that those of all programs have in common, and the widest, of five taps, which is that twice.
NARROW = np.ones(3) / 3.0
WIDE = np.convolve(NARROW, NARROW)
DRIFT = 4.0  # levels by which a row of a ground may differ from the next, and its ends from each other
LETTER = (
    20  # px of a small letter, 5 high and 4 wide with its fringes: a few pixels' colours are in that order by chance
)
ALIKE = 0.1  # share by which the contrasts of two parts with one fill may differ


@record
class _Parts:
    """k parts on grounds whose rows hardly change. at: (n,) their pixels, numbered by rows; own: (n,) int, the part of
    each; off: (n, 3) levels by which they differ from the ground; ground: (n, 3) levels. count: k.
    """

    at: np.ndarray
    own: np.ndarray
    off: np.ndarray
    ground: np.ndarray
    count: int

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Return (k,) the sums of values (n,) in each part."""
        return np.bincount(self.own, values, self.count)

    def totals(self, values: np.ndarray) -> np.ndarray:
        """Return (k, 3) the sums of values (n, 3) in each part."""
        return np.stack([self.sums(channel) for channel in values.T], axis=1)


def without_subpixels(levels: np.ndarray) -> np.ndarray:
    """Return a picture (H, W, 4) in levels with its LCD text anti-aliased by whole pixels; the same array without any.

    Only opaque pixels are text. Text for certain is as large as a LETTER and has red and blue offset by 1/6 to 2/3 of a
    pixel (the difference of two pixels is less than the slope between them), which explains half of the squares of its
    colour fringes; for parts with the fill of other text, a quarter suffices.
    """
    colours = levels[..., :3]
    if (colours == colours[..., :1]).all():
        return levels
    parts = _parts(colours, levels[..., 3] == 255.0)
    if parts is None:
        return levels
    totals = parts.totals(parts.off)
    offset, explained = _offset(parts, totals, colours.shape[:2])
    likely = (np.abs(offset) > 1.0 / 6.0) & (np.abs(offset) < 2.0 / 3.0)
    likely &= parts.sums(np.ones(len(parts.at))) >= LETTER
    sure = np.where(likely & (explained > 0.5), offset, 0.0)
    order = np.sign(sure @ (totals**2).sum(axis=1) ** 0.5)
    if order == 0.0:
        return levels
    contrast = totals / np.maximum(np.abs(totals).max(axis=1, keepdims=True), 1e-9)
    chosen = (offset * order > 0.0) & (explained > 0.25) & _in_fills_of(sure * order > 0.0, contrast)
    own = chosen[parts.own]
    text = _Parts(parts.at[own], parts.own[own], parts.off[own], parts.ground[own], parts.count)
    fills = _fills(text, contrast, chosen)
    share = _shares(text, fills, order, colours.shape[:2])
    out = levels.copy()
    values = text.ground + share[:, None] * (fills[text.own] - text.ground)
    out.reshape(-1, 4)[text.at, :3] = np.clip(np.rint(values), 0.0, 255.0)
    return out


def _parts(colours: np.ndarray, opaque: np.ndarray) -> _Parts | None:
    """Return the parts of a picture (H, W, 3) where it is opaque (H, W) bool, with those of their rows that have about
    one colour on both sides, as on buttons that get darker downwards; None if there are none.
    """
    level, upright = spread(colours, 1, 3) == 0.0, spread(colours, 3, 1) == 0.0
    even = level & (spread(colours, 3, 3) <= 2.0 * DRIFT)
    even = ndimage.binary_dilation(even, np.ones((1, 3), dtype=bool)) | ~opaque
    # Frames go on from the text that they are around.
    even |= ndimage.binary_opening(level, np.ones((1, LONG + 1), dtype=bool))
    even |= ndimage.binary_opening(upright, np.ones((LONG + 1, 1), dtype=bool))
    at, values = np.flatnonzero(~even), colours.reshape(-1, 3)
    # Pixels that equal the ground on one side, as between two letters, are ground.
    for side in _beside(even, at):
        even.ravel()[at] |= (side >= 0) & (values[at] == values[side]).all(axis=1)
    labels, count = ndimage.label(~even, ndimage.SQUARE)
    at = np.flatnonzero(labels)
    before, behind = _beside(even, at)
    off = values[behind] - values[before]
    along = (at - before) / np.maximum(behind - before, 1)
    ground = values[before] + along[:, None] * off
    within = (before >= 0) & (np.abs(off) <= DRIFT).all(axis=1)
    at, ground = at[within], ground[within].astype(float)
    return _Parts(at, labels.ravel()[at], values[at] - ground, ground, count + 1) if len(at) else None


def _beside(even: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest even pixels (H, W) bool before and behind pixels in their rows, (n,) each, all numbered by
    rows; the same pixel twice if there is only one, and -1 if there is none.
    """
    numbers = np.arange(even.size).reshape(even.shape)
    before = np.maximum.accumulate(np.where(even, numbers, -1), axis=1).ravel()[at]
    behind = np.minimum.accumulate(np.where(even, numbers, even.size)[:, ::-1], axis=1)[:, ::-1].ravel()[at]
    behind = np.where(behind == even.size, before, behind)
    return np.where(before < 0, behind, before), behind


def _offset(parts: _Parts, totals: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return (k,) px by which blue lies to the right of green in each part, and red to the left of it, 0 if its edges
    have no colours; and (k,) the share of the squares of its colour fringes that the offset explains.

    totals: (k, 3) the sums of the differences from the ground: the contrast of the part's fill times its coverage.
    """
    square = np.maximum((totals**2).sum(axis=1), 1e-9)
    contrast = totals[parts.own]
    share = (parts.off * contrast).sum(axis=1) / square[parts.own]
    fringe = parts.off - share[:, None] * contrast
    rows = np.pad(np.bincount(parts.at, share, size[0] * size[1]).reshape(size), ((0, 0), (1, 1)))
    slope = 0.5 * (rows[:, 2:] - rows[:, :-2]).ravel()[parts.at]
    lean = totals * (OFFSETS - (totals**2 @ OFFSETS / square)[:, None])
    moved = lean[parts.own] * slope[:, None]
    both = parts.sums((fringe * moved).sum(axis=1))
    of_moved, of_fringe = (np.maximum(parts.sums((part**2).sum(axis=1)), 1e-9) for part in (moved, fringe))
    coloured = of_fringe > 3.0 * EVEN**2 * parts.sums(np.ones(len(parts.at)))
    return np.where(coloured, both / of_moved, 0.0), both**2 / (of_moved * of_fringe)


def _in_fills_of(sure: np.ndarray, contrast: np.ndarray) -> np.ndarray:
    """Return (k,) bool: parts with about the contrast (k, 3), at most 1, of a part that is sure (k,) bool."""
    alike, left = sure.copy(), np.flatnonzero(sure)
    while len(left):
        same = np.abs(contrast - contrast[left[0]]).max(axis=1) <= ALIKE
        alike |= same
        left = left[~same[left]]
    return alike


def _fills(text: _Parts, contrast: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return (k, 3) levels of the fill of each part. contrast: (k, 3), at most 1; chosen: (k,) bool, the parts of text.

    It is the strongest sample of all parts that differ from their grounds towards it. But parts that agree on another
    strongest sample (`_of_one_colour`) have that one: samples that a fill covers only in part do not agree.
    """
    own = contrast[text.own]
    strength = np.where(np.abs(own) > 0.3, text.off / np.where(own == 0.0, 1.0, own), 0.0).max(axis=1)
    # The strongest sample of each part, in channels with 0.3 of the contrast or more, and the ground beneath it.
    order = np.argsort(strength, kind="stable")
    strongest, peaks, grounds = np.zeros(len(chosen), dtype=int), np.zeros(len(chosen)), np.zeros(contrast.shape)
    strongest[text.own[order]] = order
    grounds[chosen], peaks[chosen] = text.ground[strongest[chosen]], strength[strongest[chosen]]
    shown = grounds + peaks[:, None] * contrast
    fills, left = np.zeros(contrast.shape), np.flatnonzero(chosen)
    agreed = np.zeros(len(chosen), dtype=bool)
    agreed[left] = _of_one_colour(shown[left])
    while len(left):
        best = left[np.argmax(peaks[left])]
        apart = np.abs(shown[left] - shown[best]).max(axis=1)
        fill = np.median(shown[left[apart <= 1.0]], axis=0)
        towards = fill - grounds[left]
        towards /= np.maximum(np.abs(towards).max(axis=1, keepdims=True), 1e-9)
        same = np.abs(contrast[left] - towards).max(axis=1) <= ALIKE
        same = (apart <= DRIFT) | (same & ~agreed[left])
        fills[left[same]] = np.clip(fill, 0.0, 255.0)
        left = left[~same]
    return fills


def _of_one_colour(shown: np.ndarray) -> np.ndarray:
    """Return (n,) bool: colours (n, 3) in levels that three or more have, to a level, and most of about that colour."""
    colours, index, counts = np.unique(np.rint(shown), axis=0, return_inverse=True, return_counts=True)
    near = [np.abs(colours - colour).max(axis=1) for colour in colours]
    same, about = (np.array([counts[each <= reach].sum() for each in near]) for reach in (1.0, 2.0 * DRIFT))
    return ((same > 2) & (same > 0.5 * about))[index.reshape(-1)]


def _shares(text: _Parts, fills: np.ndarray, order: float, size: tuple[int, int]) -> np.ndarray:
    """Return (n,) the coverage of the text's pixels by its fill. order: of the subpixels, 1 for red first, -1 for blue.

    The wide filter is inverted unless its residual is more than rounding, since a narrower one leaves other fringes.
    """
    canvas, weight = np.zeros((*size, 3)), np.zeros((*size, 3))
    contrast = fills[text.own] - text.ground
    canvas.reshape(-1, 3)[text.at] = text.off / np.where(contrast == 0.0, 1.0, contrast)
    weight.reshape(-1, 3)[text.at] = np.abs(contrast)
    # Two pixels without fill keep the rows of one part apart from the next.
    near = np.zeros(size, dtype=bool)
    near.ravel()[text.at] = True
    near = ndimage.binary_dilation(near, np.ones((1, 5), dtype=bool))
    step = 1 if order > 0.0 else -1
    samples, strength = canvas[near][:, ::step].ravel(), weight[near][:, ::step].ravel()
    coverage = _coverage(samples, strength, WIDE)
    left = strength * (samples - np.convolve(coverage, WIDE, "same"))
    if (left**2).mean() > EVEN**2:
        coverage = _coverage(samples, strength, NARROW)
    share = np.zeros(size)
    share[near] = coverage.reshape(-1, 3).mean(axis=1)
    return share.ravel()[text.at]


def _coverage(samples: np.ndarray, strength: np.ndarray, taps: np.ndarray) -> np.ndarray:
    """Return (n,) coverages of subpixels in [0, 1] that a filter turns into samples (n,), by Landweber's iteration with
    bounds. strength: (n,) levels of contrast in each sample.
    """
    weight = (strength / max(float(strength.max()), 1e-9)) ** 2
    coverage = np.clip(samples, 0.0, 1.0)
    for _ in range(40):
        left = weight * (samples - np.convolve(coverage, taps, "same"))
        coverage = np.clip(coverage + np.convolve(left, taps, "same"), 0.0, 1.0)
    return coverage
