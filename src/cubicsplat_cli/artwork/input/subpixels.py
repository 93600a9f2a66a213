"""Text that was smoothed for the subpixels of an LCD, as it is when it is smoothed by whole pixels.

Such text has three samples a pixel: red a third of a pixel to the left of green and blue as far to the right of it, or
the other way round, each the weighted mean of a few subpixels. Read in that order they are one row of coverages, three
times as fine as the picture. The filter is undone, and the mean of three subpixels is what a pixel covers.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import spread
from cubicsplat_cli.record import record

PLACES = np.array([-1.0, 0.0, 1.0])  # of a pixel's subpixels, thirds of a pixel
# What the filters of all programs have in common, and the widest one, five taps. Colour fringes that no other filter
# leaves say which it was.
NARROW, WIDE = np.ones(3) / 3.0, np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 9.0
ROUNDING = 1.0  # levels, the root of the mean square, which 8-bit values are off at most
# Share of the squares of a part's colour fringes that offset channels explain, in text for certain, and in a part that
# has the fill of such text.
EXPLAINED, EXPLAINED_TOO = 0.5, 0.25
# Px by which red and blue seem to be offset, since the difference of two pixels is less than the slope between them.
LEAST_OFFSET, MOST_OFFSET = 1.0 / 6.0, 2.0 / 3.0
DRIFT = 4.0  # levels by which the rows of a ground may differ from each other over three px
ALIKE = 0.1  # share by which the contrast of two parts in one fill may differ
WEAK = 0.3  # share of the strongest channel's contrast, below which one does not tell how strong a fill is
ROUNDS = 40  # of Landweber's iteration


@record
class _Parts:
    """Parts on grounds of which each row has one colour. at: (n,) the pixels of all parts, numbered by rows; own: (n,)
    int, the part of each; off: (n, 3) levels by which they differ from the ground; ground: (n, 3) levels. count: k.
    """

    at: np.ndarray
    own: np.ndarray
    off: np.ndarray
    ground: np.ndarray
    count: int

    def sums(self, values: np.ndarray) -> np.ndarray:
        """(k,) the sums of values (n,) in each part."""
        return np.bincount(self.own, values, self.count)

    def totals(self, values: np.ndarray) -> np.ndarray:
        """(k, 3) the sums of values (n, 3) in each part."""
        return np.stack([self.sums(each) for each in values.T], axis=1)

    def only(self, chosen: np.ndarray) -> _Parts:
        """The parts chosen, (k,) bool; the others lose their pixels."""
        own = chosen[self.own]
        return _Parts(self.at[own], self.own[own], self.off[own], self.ground[own], self.count)


def without_subpixels(levels: np.ndarray) -> np.ndarray:
    """A picture (H, W, 4) in levels with such text smoothed by whole pixels; the same array where it has none."""
    colours = levels[..., :3]
    if (levels[..., 3] < 255.0).any() or (colours == colours[..., :1]).all():
        return levels
    parts = _parts(colours)
    if parts is None:
        return levels
    totals = parts.totals(parts.off)
    offset, explained = _offset(parts, totals, colours.shape[:2])
    likely = (np.abs(offset) > LEAST_OFFSET) & (np.abs(offset) < MOST_OFFSET)
    sure = np.where(likely & (explained > EXPLAINED), offset, 0.0)
    order = np.sign(sure @ (totals**2).sum(axis=1) ** 0.5)
    if order == 0.0:
        return levels
    chosen = (offset * order > 0.0) & (explained > EXPLAINED_TOO) & _in_fills_of(sure * order > 0.0, totals)
    text = parts.only(chosen)
    fills = _fills(text, totals, chosen)
    share = _shares(text, fills, order, colours.shape[:2])
    out = levels.copy()
    values = text.ground + share[:, None] * fills[text.own]
    out.reshape(-1, 4)[text.at, :3] = np.clip(np.rint(values), 0.0, 255.0)
    return out


def _parts(colours: np.ndarray) -> _Parts | None:
    """The parts of a picture (H, W, 3), those of their rows that have one colour on both sides, as on buttons that get
    darker downwards; None where there are none.
    """
    even = (spread(colours, 1, 3) == 0.0) & (spread(colours, 3, 3) <= DRIFT)
    even = ndimage.binary_dilation(even, np.ones((1, 3), dtype=bool))
    at, values = np.flatnonzero(~even), colours.reshape(-1, 3)
    # What looks like the ground on one side, as between two letters, is ground.
    for side in _beside(even, at):
        even.ravel()[at] |= (side >= 0) & (values[at] == values[side]).all(axis=1)
    labels, count = ndimage.label(~even, ndimage.SQUARE)
    at = np.flatnonzero(labels)
    before, behind = _beside(even, at)
    within = (before >= 0) & (values[before] == values[behind]).all(axis=1)
    at, ground = at[within], values[before[within]].astype(float)
    return _Parts(at, labels.ravel()[at], values[at] - ground, ground, count + 1) if len(at) else None


def _beside(even: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nearest even pixels (H, W) bool before and behind pixels in their rows, (n,) each, all numbered by rows; the
    same where there is one only, and -1 where there is none.
    """
    numbers = np.arange(even.size).reshape(even.shape)
    before = np.maximum.accumulate(np.where(even, numbers, -1), axis=1).ravel()[at]
    behind = np.minimum.accumulate(np.where(even, numbers, even.size)[:, ::-1], axis=1)[:, ::-1].ravel()[at]
    behind = np.where(behind == even.size, before, behind)
    return np.where(before < 0, behind, before), behind


def _offset(parts: _Parts, totals: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(k,) px by which blue lies to the right of green in each part, and red to the left of it, 0 where its edges have
    no colours; and (k,) the share of the squares of these that it explains.

    totals: (k, 3) the sums of what they are off, which is the contrast of their fill times what they cover.
    """
    square = np.maximum((totals**2).sum(axis=1), 1e-9)
    contrast = totals[parts.own]
    share = (parts.off * contrast).sum(axis=1) / square[parts.own]
    fringe = parts.off - share[:, None] * contrast
    row = np.zeros((size[0], size[1] + 2))
    inner = parts.at + 2 * (parts.at // size[1]) + 1
    row.ravel()[inner] = share
    slope = 0.5 * (row.ravel()[inner + 1] - row.ravel()[inner - 1])
    lean = totals * (PLACES - (totals**2 @ PLACES / square)[:, None])
    moved = lean[parts.own] * slope[:, None]
    both = parts.sums((fringe * moved).sum(axis=1))
    of_moved, of_fringe = (np.maximum(parts.sums((each**2).sum(axis=1)), 1e-9) for each in (moved, fringe))
    seen = of_fringe > 3.0 * ROUNDING**2 * parts.sums(np.ones(len(parts.at)))
    return np.where(seen, both / of_moved, 0.0), both**2 / (of_moved * of_fringe)


def _in_fills_of(sure: np.ndarray, totals: np.ndarray) -> np.ndarray:
    """(k,) bool: the parts with about the contrast of some of those that are sure (k,) bool. totals: (k, 3)."""
    contrast = totals / np.maximum(np.abs(totals).max(axis=1, keepdims=True), 1e-9)
    alike, left = sure.copy(), np.flatnonzero(sure)
    while len(left):
        same = np.abs(contrast - contrast[left[0]]).max(axis=1) <= ALIKE
        alike |= same
        left = left[~same[left]]
    return alike


def _fills(text: _Parts, totals: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(k, 3) levels by which the fill of each part differs from its ground: the same in parts of about one colour, and
    as strong as the strongest sample of these.
    """
    strongest = np.maximum(np.abs(totals).max(axis=1, keepdims=True), 1e-9)
    contrast = totals / strongest
    own = contrast[text.own]
    peaks = np.zeros(len(totals))
    telling = np.where(np.abs(own) > WEAK, text.off / np.where(own == 0.0, 1.0, own), 0.0)
    np.maximum.at(peaks, text.own, telling.max(axis=1))
    grounds = text.totals(text.ground) / np.maximum(text.sums(np.ones(len(text.at))), 1.0)[:, None]
    fills, left = np.zeros(totals.shape), np.flatnonzero(chosen)
    left = left[np.argsort(-strongest[left, 0], kind="stable")]
    while len(left):
        first = left[0]
        along = (contrast[left] @ contrast[first]) / (contrast[first] @ contrast[first])
        off = np.abs(contrast[left] - along[:, None] * contrast[first]).max(axis=1)
        same = (np.abs(grounds[left] - grounds[first]).max(axis=1) <= DRIFT) & (off <= ALIKE)
        fills[left[same]] = contrast[first] * peaks[left[same]].max()
        left = left[~same]
    return fills


def _shares(text: _Parts, fills: np.ndarray, order: float, size: tuple[int, int]) -> np.ndarray:
    """(n,) what the fill covers of the pixels of the text. order: of their subpixels, 1 for red first, -1 for blue."""
    canvas, weight = np.zeros((*size, 3)), np.zeros((*size, 3))
    contrast = fills[text.own]
    canvas.reshape(-1, 3)[text.at] = text.off / np.where(contrast == 0.0, 1.0, contrast)
    weight.reshape(-1, 3)[text.at] = np.abs(contrast)
    # Two pixels without fill keep the rows of one part apart from the next.
    near = np.zeros(size, dtype=bool)
    near.ravel()[text.at] = True
    near = ndimage.binary_dilation(near, np.ones((1, 5), dtype=bool))
    step = 1 if order > 0.0 else -1
    samples, strength = canvas[near][:, ::step].ravel(), weight[near][:, ::step].ravel()
    covers = _coverage(samples, strength, WIDE)
    left = strength * (samples - np.convolve(covers, WIDE, "same"))
    if (left**2).mean() > ROUNDING**2:
        covers = _coverage(samples, strength, NARROW)
    share = np.zeros(size)
    share[near] = covers.reshape(-1, 3).mean(axis=1)
    return share.ravel()[text.at]


def _coverage(samples: np.ndarray, strength: np.ndarray, taps: np.ndarray) -> np.ndarray:
    """(n,) coverages of subpixels in [0, 1] that a filter makes to samples (n,): Landweber's iteration with bounds.

    strength: (n,) levels of contrast in each sample.
    """
    weight = (strength / max(float(strength.max()), 1e-9)) ** 2
    covers = np.clip(samples, 0.0, 1.0)
    for _ in range(ROUNDS):
        left = weight * (samples - np.convolve(covers, taps, "same"))
        covers = np.clip(covers + np.convolve(left, taps, "same"), 0.0, 1.0)
    return covers
