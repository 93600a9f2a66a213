"""Differences between two drawings of equal size, as the eye sees them and as numbers."""

from __future__ import annotations

import math

import numpy as np

WHITE, BLACK = 255.0, 0.0
# What identical pictures count as, so that they have a mean.
MOST_DB = 100.0


def over(pixels: np.ndarray, ground: float) -> np.ndarray:
    """(H, W, 4) uint8 straight RGBA laid over a grey of 0..255: (H, W, 3) uint8."""
    alpha = pixels[..., 3:].astype(np.float32) / np.float32(255)
    return np.rint(pixels[..., :3] * alpha + np.float32(ground) * (1 - alpha)).astype(np.uint8)


def psnr(first: np.ndarray, second: np.ndarray) -> float:
    """PSNR in dB of two straight RGBA pictures, over white or black, whichever is worse; at most 100."""
    worst = 0.0
    for ground in (WHITE, BLACK):
        difference = over(first, ground).astype(np.float32) - over(second, ground)
        worst = max(worst, float(np.mean(np.square(difference), dtype=np.float64)))
    return MOST_DB if worst == 0.0 else min(MOST_DB, 10.0 * math.log10(255.0**2 / worst))


def mean_delta_e(first: np.ndarray, second: np.ndarray) -> float:
    """Mean CIEDE2000 (D65, sRGB) of two straight RGBA pictures, over white or black, whichever is worse."""
    return max(_mean_delta_e(over(first, ground), over(second, ground)) for ground in (WHITE, BLACK))


def _mean_delta_e(first: np.ndarray, second: np.ndarray) -> float:
    """Each pair of colours is converted once: flat pictures have few, and most pixels do not differ."""
    from skimage.color import deltaE_ciede2000, rgb2lab

    differs = (first != second).any(axis=-1)
    pairs, counts = np.unique(_packed(first[differs]) << np.int64(24) | _packed(second[differs]), return_counts=True)
    if not len(pairs):
        return 0.0
    lab = [rgb2lab(_unpacked(colours) / 255.0) for colours in (pairs >> 24, pairs & 0xFFFFFF)]
    return float((deltaE_ciede2000(*lab) * counts).sum() / differs.size)


def _packed(colours: np.ndarray) -> np.ndarray:
    red, green, blue = np.moveaxis(colours.astype(np.int64), -1, 0)
    return red << 16 | green << 8 | blue


def _unpacked(packed: np.ndarray) -> np.ndarray:
    return np.stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255], axis=-1)
