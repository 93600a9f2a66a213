"""Lines on paper as they were before they were blurred: the share of each pixel that the ink of a pen covers."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.input.pens import LUMA, Pens
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.point_tree import PointTree

ROUNDS = 20
SNAP = 0.1  # shares this near to 0 or 1 are


def sharpened(levels: np.ndarray, pens: Pens) -> tuple[np.ndarray, np.ndarray]:
    """The ink on white paper, (H, W, 4) in levels, white where there is none, as sharp and even as pens draw it:
    float32, blends of white and one ink where these meet; and the inks (k, 4), white first.
    """
    drawn = np.any(levels[..., :3] < 255.0, axis=-1)
    owner = _owners(drawn, pens)
    # A pale ink shows in those channels that it darkens.
    depths = 255.0 - pens.inks
    weights = depths * LUMA
    weights /= (weights * depths).sum(axis=1, keepdims=True)
    share = ((255.0 - levels[..., :3]) * weights[owner]).sum(axis=-1, dtype=np.float32)
    share = _unblurred(share, pens.blur)
    share = np.where(share < SNAP, 0.0, np.where(share > 1.0 - SNAP, 1.0, share))[..., None]
    out = np.full(levels.shape, 255.0, dtype=np.float32)
    out[..., :3] += share * (pens.inks[owner] - 255.0)
    opaque = np.full((len(pens.inks) + 1, 1), 255.0)
    return out, np.hstack([np.vstack([np.full((1, 3), 255.0), pens.inks]), opaque])


def _owners(drawn: np.ndarray, pens: Pens) -> np.ndarray:
    """(H, W) for each pixel that something is drawn on the ink of the nearest line, for its width; 0 elsewhere."""
    out = np.zeros(drawn.shape, dtype=np.int64)
    y, x = np.nonzero(drawn)
    nearest = np.full(len(y), np.inf)
    for k in range(len(pens.inks)):
        own = pens.owners == k
        reach = 0.5 * float(np.median(pens.widths[own])) + 2.0 * pens.blur
        distance = PointTree(pens.places[own]).query(np.stack([x, y], axis=1))[0] / reach
        better = distance < nearest
        out[y[better], x[better]], nearest[better] = k, distance[better]
    return out


def _unblurred(share: np.ndarray, blur: float) -> np.ndarray:
    """The shares in 0..1 that look like these (H, W) through a Gaussian, by accelerated projected steps (Beck and
    Teboulle 2009), which end before the grain is made much larger.
    """
    found = np.clip(share, 0.0, 1.0)
    ahead, pace = found, 1.0
    for _ in range(ROUNDS):
        missing = share - ndimage.gaussian_filter(ahead, blur, truncate=3.0)
        new = np.clip(ahead + ndimage.gaussian_filter(missing, blur, truncate=3.0), 0.0, 1.0)
        following = 0.5 * (1.0 + (1.0 + 4.0 * pace**2) ** 0.5)
        ahead = new + (pace - 1.0) / following * (new - found)
        found, pace = new, following
    return found
