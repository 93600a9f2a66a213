"""A picture of objects as one of flat fills: each object in a fill that stands for it, edges as sharp as they were."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.regions.regions import FlatPicture
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.paints import blends, nearest_paints

EDGE = 2  # px to both sides of a border that its pixels' blending and smoothing reach
REACH, SLOTS = 4, 3  # px in which the objects of a blend are sought, and how many meet at most
CLEAR = 128.0  # levels of opacity, below which an object is the transparent ground
_SQUARE = np.ones((3, 3), dtype=bool)


def silhouettes(levels: np.ndarray, labels: np.ndarray) -> FlatPicture:
    """A picture (H, W, 4) of premultiplied levels with its objects, labels (H, W), in fills that stand for them.

    Where objects share a pixel, their shares follow from what each has a few px away.
    """
    count = int(labels.max()) + 1
    alpha = np.bincount(labels.ravel(), levels[..., 3].ravel(), count) / np.bincount(labels.ravel(), minlength=count)
    fills = _fills(alpha >= CLEAR)
    inside = ndimage.minimum_filter(labels, 2 * EDGE + 1) == ndimage.maximum_filter(labels, 2 * EDGE + 1)
    # What is too thin to have an inside is known by its middle.
    whole = np.unique(labels[inside])
    inside |= ~np.isin(labels, whole)
    out = fills[labels]
    y, x = np.nonzero(~inside)
    if len(y):
        paint = np.where(inside, labels, -1).astype(np.int32)
        at = y * labels.shape[1] + x
        paints, places = nearest_paints(paint, at, REACH, SLOTS)
        colours = levels.reshape(-1, 4)[places]
        flat, _ = blends(levels[y, x], paints, colours, fills[np.maximum(paints, 0)], True)
        out[y, x] = np.clip(flat, 0.0, 255.0)
    return FlatPicture(out.astype(np.float32), fills, labels)


def _fills(opaque: np.ndarray) -> np.ndarray:
    """(n, 4) whole levels: different fills of objects (n,), those that are not opaque all clear.

    They lie on a sphere, so that none is a blend of two others, at angles that keep them about equally far apart.
    """
    count, fills = max(int(opaque.sum()), 1), np.zeros((len(opaque), 4))
    number = np.arange(count)
    height = 1.0 - (2.0 * number + 1.0) / count
    turn = math.pi * (3.0 - math.sqrt(5.0)) * number
    radius = np.sqrt(1.0 - height**2)
    sphere = np.stack([height, radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    fills[opaque, :3] = np.rint(127.5 + 127.0 * sphere[: int(opaque.sum())])
    fills[opaque, 3] = 255.0
    return fills
