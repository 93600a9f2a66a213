"""The fills of a JPEG's small parts, by what its luma, and its chroma of half the size, are made of.

A line of 2 px hardly shows its colour in any pixel, since chroma is a mean of 2 x 2 px, and is smoothed when it is made
larger again. But the share that each fill has of each pixel tells what the chroma would be, so fills follow by linear
least squares from all pixels together; and where these leave a residual, a fill is missing.

Which fills a pixel is a blend of follows from its neighbours, once it is known which it has most of.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of, largest, summed
from cubicsplat_cli.artwork.regions.hidden_fills import hidden_fills, lies_beyond
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.record import record

# (4, 4) what rows of RGBA are multiplied by for luma, chroma and opacity; and back.
LUMA_CHROMA = np.array(
    [[0.299, -0.168736, 0.5, 0], [0.587, -0.331264, -0.418688, 0], [0.114, 0.5, -0.081312, 0], [0, 0, 0, 1]]
)
RGB = np.linalg.inv(LUMA_CHROMA)
# What halving leaves of chroma of half the size that libjpeg has made larger, along each axis.
AGAIN = np.array([0.125, 0.75, 0.125], dtype=np.float32)
# What enlarging of chroma of half the size by libjpeg takes of the value beside a pixel's own one, along each axis; px
# of the block over which chroma follows luma, and the variance of luma, in levels^2, that rounding and ringing make.
BESIDE, BLOCK, EVEN = 0.25, 9, 16.0
RESIDUAL, TIMES = 12.0, 5.0  # levels, and times the usual residual near edges, beyond which a fill is missing
# Of a residual, what a pixel's colour lacks of a part's that fills about seven tenths of it, beyond what it has of it.
LACKS = 0.4
UNLIKE, ALIKE, FEWEST = 24.0, 20.0, 8  # levels off all blends, and of one colour; pixels of half the size that show it
LESS = np.linspace(0.1, 1.2, 12)  # times the difference of two fills' chroma
REWEIGHTED, PRIOR = 4, 2.0  # rounds of least squares, and px that each fill counts as before
SNAP = 0.08  # shares this near to 0 or 1 are
LEAST_CONTRAST = 3.0  # times the misfit, for shares of two fills to be told


def explained(
    seen: np.ndarray,
    mixture: Mixture,
    fills: np.ndarray,
    free: np.ndarray,
    sigma: float,
    halved: tuple[int, ...],
) -> tuple[np.ndarray, float, np.ndarray]:
    """The fills (P, 4) that explain a picture best, what all they leave costs, in nats, and the colours (k, 4) that
    pixels of which they leave much would have; all as luma, chroma and opacity in levels.

    seen: (H, W, 4) the picture; fills: (P, 4); free: (P,) bool, those that are to be fitted; sigma: levels by which
    luma is off near edges; halved: as of a condition.
    """
    fills, clipped = fills.copy(), _clipped(mixture.painted(fills), halved)
    small = _halved(seen - clipped, halved)
    mixed = ~ndimage.alike(mixture.labels, 5) | free[mixture.labels]
    fills[:, 0], luma_cost = _luma(seen[..., 0] - clipped[..., 0], mixture, mixed, fills[:, 0], free, sigma)
    y, x = np.nonzero(_halved(mixed[..., None], halved)[..., 0] > 0.0)
    columns = [_again(_halved(mixture.coverage(k)[..., None], halved), halved)[y, x, 0] for k in range(len(fills))]
    shares, values = np.stack(columns, axis=1).astype(np.float64), small[y, x]
    fills[:, 1:3], rest = _fitted(shares, values[:, 1:3], fills[:, 1:3], free, sigma)
    off = np.hypot(rest[:, 0], rest[:, 1])
    usual = float(np.median(off)) if len(off) else 0.0
    strange = off > max(RESIDUAL, TIMES * usual)
    missing = values[strange].astype(np.float64)
    missing[:, 1:3] += LACKS * rest[strange]
    return fills, luma_cost + float(np.log1p((off / sigma) ** 2).sum()), missing


def missing_fills(missing: np.ndarray, palette: np.ndarray) -> np.ndarray:
    """(k, 4) fills in levels that a palette (P, 4) lacks, of colours (n, 4) that are not explained."""
    return hidden_fills(np.clip(missing, 0.0, 255.0), palette, UNLIKE, ALIKE, FEWEST)


def smeared(fill: np.ndarray, palette: np.ndarray) -> bool:
    """True if a colour (4,), in levels, is what one fill of a palette (P, 4) becomes where its chroma is less that of
    another one, as beside that it is in chroma that was made sharp again.
    """
    seen = palette @ LUMA_CHROMA
    steps = (seen[:, None] - seen) * [0.0, 1.0, 1.0, 0.0]
    steps[largest(np.abs(steps)) <= UNLIKE] = 0.0
    return lies_beyond(fill, palette, steps @ RGB, LESS, UNLIKE)


def _luma(
    luma: np.ndarray, mixture: Mixture, where: np.ndarray, fills: np.ndarray, free: np.ndarray, sigma: float
) -> tuple[np.ndarray, float]:
    """The luma of the fills (P,), and the cost of what it leaves of some pixels, where (H, W) bool."""
    y, x = np.nonzero(where)
    own, other, share = (each[y, x] for each in (mixture.labels, mixture.other, mixture.share))
    count, out, value = len(fills), fills.copy(), luma[y, x].astype(np.float64)
    rest = value - (1.0 - share) * out[own] - share * out[other]
    for _ in range(REWEIGHTED):
        weight = 1.0 / (1.0 + (rest / sigma) ** 2)
        gram, right = np.zeros((count, count)), np.zeros(count)
        for a, s in ((own, 1.0 - share), (other, share)):
            right += np.bincount(a, weight * s * rest, count)
            for b, t in ((own, 1.0 - share), (other, share)):
                gram += np.bincount(a * count + b, weight * s * t, count * count).reshape(count, count)
        out[free] += np.linalg.solve(gram[np.ix_(free, free)] + PRIOR * np.eye(int(free.sum())), right[free])
        rest = value - (1.0 - share) * out[own] - share * out[other]
    return out, float(np.log1p((rest / sigma) ** 2).sum())


def _fitted(
    shares: np.ndarray, values: np.ndarray, fills: np.ndarray, free: np.ndarray, sigma: float
) -> tuple[np.ndarray, np.ndarray]:
    """Fills (P, 2) of which shares (n, P) make values (n, 2), with Cauchy's weights, and what they leave of these."""
    out = fills.copy()
    rest = values - shares @ out
    for _ in range(REWEIGHTED):
        weighted = shares[:, free] / (1.0 + (rest * rest).sum(axis=1, keepdims=True) / sigma**2)
        gram = weighted.T @ shares[:, free] + PRIOR * np.eye(int(free.sum()))
        out[free] += np.linalg.solve(gram, weighted.T @ rest)
        rest = values - shares @ out
    return out, rest


def _halved(values: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
    """Values (H, W, C) at half their size along some axes, the means of two px, float32."""
    values = values.astype(np.float32)
    for axis in axes:
        lines = np.moveaxis(values, axis, 0)
        even = np.concatenate([lines, lines[-1:]]) if len(lines) % 2 else lines
        values = np.moveaxis(np.float32(0.5) * (even[::2] + even[1::2]), 0, axis)
    return values


def _clipped(painted: np.ndarray, halved: tuple[int, ...]) -> np.ndarray:
    """(H, W, 4) what becomes of a picture (H, W, 4), both as luma, chroma and opacity, less what it was made of, where
    chroma of half the size goes with luma that is too dark or too light for it: channels end at 0 and 255.
    """
    made = painted.astype(np.float32)
    made[..., 1:3] = _stored(made[..., 1:3], halved)
    return np.asarray(np.clip(made @ RGB, 0.0, 255.0) @ LUMA_CHROMA - made, np.float32)


def _stored(values: np.ndarray, halved: tuple[int, ...]) -> np.ndarray:
    """Values (H, W, C) as they are read, float32, where they were stored at half their size along some axes."""
    out = _halved(values, halved)
    for axis in halved:
        out = _doubled(out, axis)
    return out[: values.shape[0], : values.shape[1]]


def _again(values: np.ndarray, halved: tuple[int, ...]) -> np.ndarray:
    """Values (H, W, C), halved along some axes, as they are once they were made larger and halved again."""
    for axis in halved:
        values = ndimage.correlate1d(values, AGAIN, axis=axis, mode="nearest")
    return values


def _doubled(values: np.ndarray, axis: int) -> np.ndarray:
    """Values (H, W, C) made twice as large along an axis, as libjpeg does."""
    ends = np.concatenate([values.take([0], axis), values, values.take([-1], axis)], axis)
    inner = range(1, values.shape[axis] + 1)
    halves = [(1.0 - BESIDE) * values + BESIDE * ends.take([k + step for k in inner], axis) for step in (-1, 1)]
    size = [2 * n if k == axis else n for k, n in enumerate(values.shape)]
    return np.stack(halves, axis=axis + 1).reshape(size)


def with_sharp_chroma(seen: np.ndarray, halved: tuple[int, ...]) -> np.ndarray:
    """A picture (H, W, 4) as luma, chroma and opacity in levels whose chroma was stored at half its size along some
    axes, with what halving took of it: around every pixel chroma follows luma as it does in what halving left of both.
    """
    luma, chroma = seen[..., :1], seen[..., 1:3]
    smooth = _stored(luma, halved)

    def mean(values: np.ndarray) -> np.ndarray:
        return ndimage.uniform_filter(values, (BLOCK, BLOCK, 1), mode="nearest")

    middle = mean(smooth)
    slope = (mean(smooth * chroma) - middle * mean(chroma)) / (mean(smooth * smooth) - middle * middle + EVEN)
    out = seen.copy()
    out[..., 1:3] += slope * (luma - smooth)
    return out


@record
class Mixture:
    """The blends that pixels are. labels, other: (H, W) int32, two fills; share: (H, W), of the second one."""

    labels: np.ndarray
    other: np.ndarray
    share: np.ndarray

    def coverage(self, fill: int) -> np.ndarray:
        """(H, W) the share of a fill."""
        own = np.where(self.labels == fill, 1.0 - self.share, 0.0)
        return own + np.where(self.other == fill, self.share, 0.0)

    def painted(self, palette: np.ndarray) -> np.ndarray:
        """(H, W, 4) float32 of fills (P, 4)."""
        out = palette[self.labels].astype(np.float32)
        y, x = np.nonzero(self.share)
        own, other = palette[self.labels[y, x]], palette[self.other[y, x]]
        out[y, x] = own + self.share[y, x, None] * (other - own)
        return out


def mixture_of(
    seen: np.ndarray, fills: np.ndarray, labels: np.ndarray, sigma: float, blur: float, snap: float = SNAP
) -> Mixture:
    """Return the picture (H, W, 4) as blends of two fills (P, 4) a pixel: the fill of its label and one beside it.

    labels: (H, W) int. sigma: levels, the error of a pixel. blur: standard deviation in px; blurred edges become sharp.
    snap: shares this near to 0 or 1 become that.
    """
    mixture = Mixture(labels, labels.copy(), np.zeros(labels.shape))
    reach = 1 if not blur else 2
    y, x = np.nonzero(~ndimage.alike(labels, 2 * reach + 1))
    if not len(y):
        return mixture
    own = labels[y, x]
    padded = np.pad(labels, reach, mode="edge")
    best, other, share = np.full(len(y), np.inf), own.copy(), np.zeros(len(y))
    colours = seen[y, x]
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            beside = padded[y + reach + dy, x + reach + dx]
            k = np.flatnonzero(beside != own)
            k = k[np.linalg.norm(fills[beside[k]] - fills[own[k]], axis=1) > LEAST_CONTRAST * sigma]
            t, rest = blend_of(colours[k], fills[own[k]], fills[beside[k]])
            left = summed(rest * rest) + 1e-3 * (dy * dy + dx * dx)
            better = left < best[k]
            k, left, t = k[better], left[better], t[better]
            best[k], other[k], share[k] = left, beside[k], t
    if blur:
        from scipy.special import ndtri  # takes a while to import, and few pictures are blurred

        width = np.sqrt(blur**2 + 1.0 / 12.0)
        share = np.clip(0.5 + width * ndtri(np.clip(share, 1e-3, 1.0 - 1e-3)), 0.0, 1.0)
    mixture.other[y, x] = other
    mixture.share[y, x] = np.where(share < snap, 0.0, np.where(share > 1.0 - snap, 1.0, share))
    return mixture
