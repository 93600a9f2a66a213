"""What the pixels of a picture are blends of, once it is known which fill each has most of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.raster import ndimage

SNAP = 0.08  # shares this near to 0 or 1 are
LEAST_CONTRAST = 3.0  # times the misfit, for shares of two fills to be told


@dataclass(frozen=True, eq=False)
class Mixture:
    """What pixels are blends of. labels, other: (H, W) int32 two fills; share: (H, W) of the second one."""

    labels: np.ndarray
    other: np.ndarray
    share: np.ndarray

    def coverage(self, fill: int) -> np.ndarray:
        """(H, W) the share of a fill."""
        own = np.where(self.labels == fill, 1.0 - self.share, 0.0)
        return own + np.where(self.other == fill, self.share, 0.0)


def with_shares(
    seen: np.ndarray,
    fills: np.ndarray,
    labels: np.ndarray,
    sigma: float,
    blur: float,
    palette: np.ndarray,
    snap: float = SNAP,
) -> np.ndarray:
    """(H, W, 4) the picture of the labels, with the shares that edges had; blurred ones as they were before."""
    out = palette[labels].astype(np.float32)
    mixture = mixture_of(seen, fills, labels, sigma, blur, snap)
    y, x = np.nonzero(mixture.share)
    own, other = palette[labels[y, x]], palette[mixture.other[y, x]]
    out[y, x] = own + mixture.share[y, x, None] * (other - own)
    return out


def mixture_of(
    seen: np.ndarray, fills: np.ndarray, labels: np.ndarray, sigma: float, blur: float, snap: float = SNAP
) -> Mixture:
    """What the pixels of a picture (H, W, 4) are blends of: of labels' fills (P, 4), alike, with one beside them."""
    mixture = Mixture(labels, labels.copy(), np.zeros(labels.shape))
    reach = 1 if not blur else 2
    size = 2 * reach + 1
    y, x = np.nonzero(ndimage.maximum_filter(labels, size) != ndimage.minimum_filter(labels, size))
    if not len(y):
        return mixture
    own = labels[y, x]
    padded = np.pad(labels, reach, mode="edge")
    best, other, share = np.full(len(y), np.inf), own.copy(), np.zeros(len(y))
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            beside = padded[y + reach + dy, x + reach + dx]
            base, span = fills[own], fills[beside] - fills[own]
            length = (span * span).sum(axis=1)
            rest = seen[y, x] - base
            t = np.clip((rest * span).sum(axis=1) / np.maximum(length, 1e-9), 0.0, 1.0)
            left = ((rest - t[:, None] * span) ** 2).sum(axis=1) + 1e-3 * (dy * dy + dx * dx)
            better = (beside != own) & (length > (LEAST_CONTRAST * sigma) ** 2) & (left < best)
            best[better], other[better], share[better] = left[better], beside[better], t[better]
    if blur:
        from scipy.special import ndtri  # takes a while to import, and few pictures are blurred

        width = np.sqrt(blur**2 + 1.0 / 12.0)
        share = np.clip(0.5 + width * ndtri(np.clip(share, 1e-3, 1.0 - 1e-3)), 0.0, 1.0)
    mixture.other[y, x] = other
    mixture.share[y, x] = np.where(share < snap, 0.0, np.where(share > 1.0 - snap, 1.0, share))
    return mixture
