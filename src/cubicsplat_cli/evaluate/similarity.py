"""SSIM of a part of a picture: the sums over its windows, which add up to the figure of the whole.

Wang et al. 2004 ("Image quality assessment: from error visibility to structural similarity"): Gaussian window of sigma
1.5 cut to 11 x 11 taps, population covariance, data range 1; the mean over the windows that lie within the picture, and
over the channels. scikit-image computes the same of whole pictures in float64; the tests hold this against it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

TAPS = 11
REACH = TAPS // 2  # of a window from its middle, px
_SIGMA = 1.5
_C1, _C2 = np.float32(0.01**2), np.float32(0.03**2)
_WEIGHTS = np.exp(-0.5 * (np.arange(-REACH, REACH + 1) / _SIGMA) ** 2)
# Smoothing as a product of matrices: a band of the weights makes so many rows, or columns, of 10 more. Larger bands
# multiply more zeros, and the library would start threads; adding shifted planes takes four times as long.
_BLOCK = 16
_BAND = np.stack([np.roll(np.pad(_WEIGHTS / _WEIGHTS.sum(), (0, _BLOCK - 1)), i) for i in range(_BLOCK)])
_BAND = _BAND.astype(np.float32)


def similarity_sums(reference: np.ndarray, candidates: Sequence[np.ndarray]) -> list[float]:
    """For each candidate the sum of SSIM over the windows of one channel.

    All (H, W) float32 in [0, 1], H and W at least 11; there are (H - 10) * (W - 10) windows. Candidates are compared at
    once because what is smoothed of the reference then serves all of them.
    """
    # Variances are differences of smoothed squares: about the mean little is lost to rounding.
    middle = np.float32(reference.mean())
    count = len(candidates)
    planes = np.empty((1 + 3 * count, *reference.shape), np.float32)
    means, squares, products = planes[: count + 1], planes[count + 1 : 2 * count + 1], planes[2 * count + 1 :]
    for plane, picture in zip(means, (reference, *candidates), strict=True):
        np.subtract(picture, middle, out=plane)
    np.square(means[1:], out=squares)
    squares += np.square(means[0])
    np.multiply(means[0], means[1:], out=products)
    smooth = _smoothed(planes)
    first = smooth[0]
    return [_sum(first, smooth[1 + i], smooth[1 + count + i], smooth[1 + 2 * count + i], middle) for i in range(count)]


def _sum(x: np.ndarray, y: np.ndarray, squares: np.ndarray, product: np.ndarray, middle: np.float32) -> float:
    """The sum of SSIM, from smoothed planes: both pictures less `middle`, the sum of their squares, their product."""
    covariance = product - x * y
    covariance *= 2
    covariance += _C2
    variances = squares - x * x
    variances -= y * y
    variances += _C2
    x, y = x + middle, y + middle
    luminance = x * y
    luminance *= 2
    luminance += _C1
    x *= x
    y *= y
    x += y
    x += _C1
    luminance *= covariance
    x *= variances
    luminance /= x
    return float(luminance.sum(dtype=np.float64))


def _smoothed(planes: np.ndarray) -> np.ndarray:
    """(n, H, W) to (n, H - 10, W - 10): each plane by the window, first down, then across."""
    count, height, width = planes.shape[0], planes.shape[1] - 2 * REACH, planes.shape[2] - 2 * REACH
    down = np.empty((count, height, planes.shape[2]), np.float32)
    for rows, reach, band in _blocks(height):
        np.matmul(band, planes[:, reach], out=down[:, rows])
    across = np.empty((count, height, width), np.float32)
    for columns, reach, band in _blocks(width):
        # A plane at a time: how the library rounds depends on the rows that it is given at once.
        np.matmul(down[:, :, reach], band.T, out=across[:, :, columns])
    return across


def _blocks(size: int) -> Iterator[tuple[slice, slice, np.ndarray]]:
    """Blocks of an axis of `size` places after smoothing: their places, those before smoothing, the weights."""
    for start in range(0, size, _BLOCK):
        end = min(size, start + _BLOCK)
        n = end - start
        yield slice(start, end), slice(start, end + 2 * REACH), _BAND[:n, : n + 2 * REACH]
