"""Fit the fills of a JPEG's small parts to its luma, and to its chroma in the size that the file stores it at.

A line of 2 px hardly shows its colour in any pixel, since chroma is stored as the mean of 2 x 2 px and smoothed when it
is enlarged again. But the share of each fill in each pixel tells what the chroma would be, so the fills follow by
linear least squares from all pixels together. A large residual shows that a fill is missing.

Once the fill is known that a pixel has most of, its neighbours tell which other fill it blends with.
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.channels import LUMA, blend_of, largest, summed
from cubicsplat_cli.artwork.regions.fills import APART
from cubicsplat_cli.artwork.regions.hidden_fills import lies_beyond
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.record import record

# (4, 4) matrix that takes rows of RGBA to luma, chroma (as in JFIF) and opacity; and back.
LUMA_CHROMA = np.eye(4)
LUMA_CHROMA[:3, :3] = np.stack([LUMA, *(0.5 * (np.eye(3)[k] - LUMA) / (1.0 - LUMA[k]) for k in (2, 0))], axis=1)
RGB = np.linalg.inv(LUMA_CHROMA)
BESIDE = 0.25  # share of the value beside a pixel's own one when libjpeg enlarges chroma, along each axis
SNAP = 0.08  # shares this near to 0 or 1 are; one of 4 x 4 samples is 0.0625
REWEIGHTED = 4  # rounds of least squares with Cauchy's weights
PRIOR = 2.0  # px; weight of the former value of each fill
Axes = tuple[int, ...]  # along which chroma is stored at half its size: 0 for rows, 1 for columns


def explained(
    seen: np.ndarray, mixture: Mixture, fills: np.ndarray, free: np.ndarray, odd: np.ndarray, sigma: float, halved: Axes
) -> tuple[np.ndarray, float, np.ndarray]:
    """Return the fills (P, 4) that explain a picture best, the cost of their residuals in nats, and the colours (k, 4)
    of pixels with large residuals; all as luma, chroma and opacity in levels.

    seen: (H, W, 4) the picture; fills: (P, 4); free: (P,) bool, those to be fitted; odd: (H, W) bool, pixels that
    count though they may lie away from edges; sigma: levels by which luma is off near edges.
    """
    fills, seen = fills.copy(), seen - _clipping(mixture.painted(fills), halved)
    mixed = ~ndimage.alike(mixture.labels, 5) | free[mixture.labels] | odd
    fills[:, 0], luma_cost = _fit_luma(seen[..., 0], mixture, mixed, fills[:, 0], free, sigma)
    y, x = np.nonzero(_halved(mixed, halved) > 0.0)
    columns = [_again(_halved(mixture.coverage(k), halved), halved)[y, x] for k in range(len(fills))]
    shares, values = np.stack(columns, axis=1).astype(np.float64), _halved(seen, halved)[y, x]
    fills[:, 1:3], rest = _fit_chroma(shares, values[:, 1:3], fills[:, 1:3], free, sigma)
    off = np.hypot(rest[:, 0], rest[:, 1])
    strange = off > max(12.0, 5.0 * float(np.median(off)) if len(off) else 0.0)
    missing = values[strange].astype(np.float64)
    # A missing part fills about 0.7 of such a pixel, so its colour is farther off by 1 / 0.7 - 1, or 0.4, residuals.
    missing[:, 1:3] += 0.4 * rest[strange]
    return fills, luma_cost + float(np.log1p((off / sigma) ** 2).sum()), missing


def smeared(fill: np.ndarray, palette: np.ndarray) -> bool:
    """Return True if a colour (4,) is one of a palette (P, 4) less some chroma of another, as sharpening leaves."""
    seen = palette @ LUMA_CHROMA
    steps = (seen[:, None] - seen) * [0.0, 1.0, 1.0, 0.0]
    steps[largest(np.abs(steps)) <= APART] = 0.0
    return lies_beyond(fill, palette, steps @ RGB, np.linspace(0.1, 1.2, 12), APART)


def _fit_luma(
    luma: np.ndarray, mixture: Mixture, mask: np.ndarray, fills: np.ndarray, free: np.ndarray, sigma: float
) -> tuple[np.ndarray, float]:
    """Return the luma of the fills (P,), fitted to the luma (H, W) of the pixels of a mask (H, W), and the cost of the
    residuals in nats. Each pixel blends two fills, so the normal equations are sums over pairs of fills.
    """
    y, x = np.nonzero(mask)
    own, other, share = (plane[y, x] for plane in (mixture.labels, mixture.other, mixture.share))
    count, out, value = len(fills), fills.copy(), luma[y, x].astype(np.float64)
    parts = (own, 1.0 - share), (other, share)
    rest = value - (1.0 - share) * out[own] - share * out[other]
    for _ in range(REWEIGHTED):
        weight = 1.0 / (1.0 + (rest / sigma) ** 2)
        gram, right = np.zeros((count, count)), np.zeros(count)
        for a, s in parts:
            right += np.bincount(a, weight * s * rest, count)
            for b, t in parts:
                gram += np.bincount(a * count + b, weight * s * t, count * count).reshape(count, count)
        out[free] += np.linalg.solve(gram[np.ix_(free, free)] + PRIOR * np.eye(int(free.sum())), right[free])
        rest = value - (1.0 - share) * out[own] - share * out[other]
    return out, float(np.log1p((rest / sigma) ** 2).sum())


def _fit_chroma(
    shares: np.ndarray, values: np.ndarray, fills: np.ndarray, free: np.ndarray, sigma: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the chroma of the fills (P, 2), whose shares (n, P) make values (n, 2), and the residuals (n, 2)."""
    out = fills.copy()
    rest = values - shares @ out
    for _ in range(REWEIGHTED):
        weighted = shares[:, free] / (1.0 + (rest * rest).sum(axis=1, keepdims=True) / sigma**2)
        gram = weighted.T @ shares[:, free] + PRIOR * np.eye(int(free.sum()))
        out[free] += np.linalg.solve(gram, weighted.T @ rest)
        rest = values - shares @ out
    return out, rest


def _halved(values: np.ndarray, axes: Axes) -> np.ndarray:
    """Return values (H, W, ...) at half their size along some axes, the means of two px, float32."""
    values = values.astype(np.float32)
    for axis in axes:
        lines = np.moveaxis(values, axis, 0)
        even = np.concatenate([lines, lines[-1:]]) if len(lines) % 2 else lines
        values = np.moveaxis(np.float32(0.5) * (even[::2] + even[1::2]), 0, axis)
    return values


def _clipping(painted: np.ndarray, halved: Axes) -> np.ndarray:
    """Return (H, W, 4): the change of a picture (H, W, 4) when its channels are clipped to 0..255 with the chroma that
    is stored, which may be too strong for the luma of a pixel; both as luma, chroma and opacity.
    """
    made = painted.astype(np.float32)
    made[..., 1:3] = _stored(made[..., 1:3], halved)
    return np.asarray(np.clip(made @ RGB, 0.0, 255.0) @ LUMA_CHROMA - made, np.float32)


def _stored(values: np.ndarray, halved: Axes) -> np.ndarray:
    """Return values (H, W, C), stored at half their size along some axes, as they are read, float32."""
    out = _halved(values, halved)
    for axis in halved:
        # Twice as large along the axis, as by libjpeg.
        lines = np.moveaxis(out, axis, 0)
        padded = np.concatenate([lines[:1], lines, lines[-1:]])
        halves = [(1.0 - BESIDE) * lines + BESIDE * beside for beside in (padded[:-2], padded[2:])]
        out = np.moveaxis(np.stack(halves, axis=1).reshape(-1, *lines.shape[1:]), 0, axis)
    return out[: values.shape[0], : values.shape[1]]


def _again(values: np.ndarray, halved: Axes) -> np.ndarray:
    """Return values (H, W, ...), halved along some axes, once they are enlarged and halved again."""
    weights = np.array([0.5 * BESIDE, 1.0 - BESIDE, 0.5 * BESIDE], dtype=np.float32)
    for axis in halved:
        values = ndimage.correlate1d(values, weights, axis=axis, mode="nearest")
    return values


def with_sharp_chroma(seen: np.ndarray, halved: Axes) -> np.ndarray:
    """Return a picture (H, W, 4) as luma, chroma and opacity in levels, with the chroma that was lost when it was
    stored at half its size along some axes: around every pixel, in 9 x 9 px, chroma follows luma as their halved
    versions do.
    """
    luma, chroma = seen[..., :1], seen[..., 1:3]
    smooth = _stored(luma, halved)

    def mean(values: np.ndarray) -> np.ndarray:
        return ndimage.uniform_filter(values, (9, 9, 1), mode="nearest")

    middle = mean(smooth)
    # 16 levels^2: the variance of luma that rounding and ringing make.
    slope = (mean(smooth * chroma) - middle * mean(chroma)) / (mean(smooth * smooth) - middle * middle + 16.0)
    out = seen.copy()
    out[..., 1:3] += slope * (luma - smooth)
    return out


@record
class Mixture:
    """Pixels as blends of two fills. labels, other: (H, W) int32, the fills; share: (H, W), of the second one."""

    labels: np.ndarray
    other: np.ndarray
    share: np.ndarray

    def coverage(self, fill: int) -> np.ndarray:
        """Return (H, W): the share of a fill."""
        return np.where(self.labels == fill, 1.0 - self.share, 0.0) + np.where(self.other == fill, self.share, 0.0)

    def painted(self, palette: np.ndarray) -> np.ndarray:
        """Return the picture (H, W, 4) float32 in fills (P, 4)."""
        out = palette[self.labels].astype(np.float32)
        y, x = np.nonzero(self.share)
        own, other = palette[self.labels[y, x]], palette[self.other[y, x]]
        out[y, x] = own + self.share[y, x, None] * (other - own)
        return out


def mixture_of(
    seen: np.ndarray,
    fills: np.ndarray,
    labels: np.ndarray,
    sigma: float,
    blur: float,
    snap: float = SNAP,
    *,
    sharp: bool = True,
) -> Mixture:
    """Return the picture (H, W, 4) as blends of two fills (P, 4) a pixel: the fill of its label and one beside it.

    labels: (H, W) int. sigma: levels, the error of a pixel; fills less than three times as far apart are not blended.
    blur: standard deviation in px; sharp: True to make blurred edges sharp. snap: shares this near to 0 or 1 become
    that.
    """
    mixture = Mixture(labels, labels.copy(), np.zeros(labels.shape))
    reach = 1 + math.ceil(blur)
    y, x = np.nonzero(~ndimage.alike(labels, 2 * reach + 1))
    own = labels[y, x]
    padded = np.pad(labels, reach, mode="edge")
    best, other, share = np.full(len(y), np.inf), own.copy(), np.zeros(len(y))
    colours, blends = seen[y, x], np.linalg.norm(fills[:, None] - fills, axis=2) > 3.0 * sigma
    for down, right in np.ndindex(2 * reach + 1, 2 * reach + 1):
        beside = padded[y + down, x + right]
        k = np.flatnonzero(blends[own, beside])
        t, rest = blend_of(colours[k], fills[own[k]], fills[beside[k]])
        left = summed(rest * rest) + 1e-3 * ((down - reach) ** 2 + (right - reach) ** 2)
        better = left < best[k]
        k, left, t = k[better], left[better], t[better]
        best[k], other[k], share[k] = left, beside[k], t
    if blur and sharp:
        from scipy.special import ndtri  # takes a while to import, and few pictures are blurred

        width = np.sqrt(blur**2 + 1.0 / 12.0)  # 1/12 px^2: variance of a pixel's box
        share = np.clip(0.5 + width * ndtri(np.clip(share, 1e-3, 1.0 - 1e-3)), 0.0, 1.0)
    mixture.other[y, x] = other
    mixture.share[y, x] = np.where(share < snap, 0.0, np.where(share > 1.0 - snap, 1.0, share))
    return mixture
