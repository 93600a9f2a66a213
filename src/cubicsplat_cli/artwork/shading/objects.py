"""The objects of a shaded picture: areas that strong edges bound, however much changes within them."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.records import dataclass

BLUR = 0.8  # px, before slopes are measured: about what smoothing has blurred an edge by
# Levels per px: steeper than shading is, and what an edge of thirty levels, so smoothed, has.
STEEP = 12.0
LEAST_AREA = 24  # px away from edges, of what is an object of its own
# An edge changes as much within NEAR px to both sides as within FAR, a ramp NEAR / FAR of that. Levels that an edge
# changes by beyond a ramp.
NEAR, FAR, LEAST_STEP = 2.0, 5.0, 16.0
_PLUS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=bool)


@dataclass(frozen=True, eq=False)
class _Slopes:
    """(H, W) the steepest channel's slope in levels per px, and its direction."""

    size: np.ndarray
    across: np.ndarray
    down: np.ndarray


def objects_of(levels: np.ndarray) -> np.ndarray:
    """(H, W) int32 the object of each pixel, numbered from 0 on, of a picture (H, W, 4) of premultiplied levels.

    Thin lines and small spots are part of what they lie on.
    """
    from skimage.segmentation import watershed  # which few pictures need

    slopes = _slopes(levels)
    areas, count = ndimage.label(slopes.size < STEEP, _PLUS)
    kept = np.bincount(areas.ravel(), minlength=count + 1) >= LEAST_AREA
    kept[0] = False
    if not kept.any():
        return np.zeros(levels.shape[:2], np.int32)
    labels = watershed(slopes.size, (np.cumsum(kept) * kept)[areas])
    while len(weak := _weak_borders(levels, labels, slopes)):
        labels = _united(labels, weak)
    _, labels = np.unique(labels, return_inverse=True)
    return np.asarray(labels.reshape(levels.shape[:2]), np.int32)


def _slopes(levels: np.ndarray) -> _Slopes:
    smooth = ndimage.gaussian_filter(levels, (BLUR, BLUR, 0.0), mode="nearest")
    down, across = np.gradient(smooth, axis=(0, 1))
    sizes = np.hypot(across, down)
    steepest = sizes.argmax(axis=2)[..., None]
    size, u, v = (np.take_along_axis(each, steepest, 2)[..., 0] for each in (sizes, across, down))
    scale = np.maximum(size, 1e-6)
    return _Slopes(size, u / scale, v / scale)


def _weak_borders(levels: np.ndarray, labels: np.ndarray, slopes: _Slopes) -> np.ndarray:
    """(n, 2) the pairs of neighbouring labels between which there is a ramp rather than an edge, the weakest first."""
    height, width = labels.shape
    pairs, steps = [], []
    for dy, dx in ((0, 1), (1, 0)):
        first, second = labels[: height - dy, : width - dx], labels[dy:, dx:]
        y, x = np.nonzero(first != second)
        pairs.append(np.sort(np.stack([first[y, x], second[y, x]], axis=1), axis=1))
        steps.append(_steps(levels, slopes, y, x, (y + 0.5 * dy, x + 0.5 * dx)))
    each, step = np.concatenate(pairs), np.concatenate(steps)
    if not len(each):
        return each
    known, which = np.unique(each, axis=0, return_inverse=True)
    order = np.lexsort((step, which := which.reshape(-1)))
    ends = np.searchsorted(which[order], np.arange(len(known) + 1))
    medians = step[order][(ends[:-1] + ends[1:] - 1) // 2]
    weakest = np.argsort(medians, kind="stable")
    return known[weakest[medians[weakest] < LEAST_STEP]]


def _steps(
    levels: np.ndarray, slopes: _Slopes, y: np.ndarray, x: np.ndarray, middle: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """(n,) levels by which the picture changes across borders at pixels y, x, beyond what a ramp would."""
    height, width = levels.shape[:2]
    u, v = slopes.across[y, x], slopes.down[y, x]

    def change(reach: float) -> np.ndarray:
        places = [
            (
                np.clip(np.rint(middle[0] + sign * v), 0, height - 1).astype(int),
                np.clip(np.rint(middle[1] + sign * u), 0, width - 1).astype(int),
            )
            for sign in (reach, -reach)
        ]
        return np.asarray(np.abs(levels[places[0]] - levels[places[1]]).max(axis=1))

    return change(NEAR) - NEAR / FAR * change(FAR)


def _united(labels: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """The labels with each of these pairs made one, but for those of which one was united with another before."""
    becomes, used = np.arange(labels.max() + 1), set()
    for first, second in pairs.tolist():
        if first not in used and second not in used:
            used |= {first, second}
            becomes[second] = first
    return becomes[labels]
