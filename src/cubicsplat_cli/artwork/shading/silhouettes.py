"""A picture of objects as one of flat fills: each object in a fill that stands for it, edges as sharp as they were."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.regions.regions import FlatPicture
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.paints import blends, nearest_paints

EDGE = 2  # px to both sides of a border that its pixels' blending and smoothing reach
REACH, SLOTS = 4, 3  # px in which the objects of a blend are sought, and how many meet at most
# Times that each channel counts: opacity is as sure within shading as elsewhere.
SURE = np.array([1.0, 1.0, 1.0, 8.0])
CLEAR = 128.0  # levels of opacity, below which an object is the transparent ground


def silhouettes(levels: np.ndarray, labels: np.ndarray) -> FlatPicture:
    """A picture (H, W, 4) of premultiplied levels with its objects, labels (H, W), in fills that stand for them.

    Where objects share a pixel, their shares follow from what each has a few px away.
    """
    count = int(labels.max()) + 1
    alpha = np.bincount(labels.ravel(), levels[..., 3].ravel(), count) / np.bincount(labels.ravel(), minlength=count)
    fills = _fills(alpha >= CLEAR)
    inside = _insides(labels)
    out = fills[labels]
    y, x = np.nonzero(~inside)
    if len(y):
        paint = np.where(inside, labels, -1).astype(np.int32)
        at = y * labels.shape[1] + x
        paints, places = nearest_paints(paint, at, REACH, SLOTS)
        colours = _continued(levels, paint, y, x, places)
        flat, _ = blends(levels[y, x] * SURE, paints, colours * SURE, fills[np.maximum(paints, 0)], True)
        out[y, x] = np.clip(flat, 0.0, 255.0)
    return FlatPicture(out.astype(np.float32), fills, labels)


def _insides(labels: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels that show one object alone; of what is too thin to have such ones, its middle."""
    inside = np.asarray(_alike(labels, 2 * EDGE + 1))
    y, x = np.nonzero(~inside)
    if len(y):
        paint = np.where(inside, labels, -1).astype(np.int32)
        paints, _ = nearest_paints(paint, y * labels.shape[1] + x, REACH, SLOTS)
        thin = (paints != labels[y, x, None]).all(axis=1)
        depth = ndimage.distance_transform_edt(np.pad(_alike(labels, 3), 1))[1:-1, 1:-1]
        middle = depth >= ndimage.maximum_filter(depth, 3)
        inside[y[thin], x[thin]] = middle[y[thin], x[thin]]
    return inside


def _alike(labels: np.ndarray, size: int) -> np.ndarray:
    """(H, W) bool: whether all pixels of a square around one have its label."""
    return np.asarray(ndimage.minimum_filter(labels, size) == ndimage.maximum_filter(labels, size))


def _continued(levels: np.ndarray, paint: np.ndarray, y: np.ndarray, x: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(n, slots, 4) what the objects that have pixels `places` (n, slots) would have at pixels y, x (n,), if they
    changed on as they do just behind these.
    """
    height, width = paint.shape
    row, column = np.divmod(places, width)
    behind = 2 * row - y[:, None], 2 * column - x[:, None]
    far = tuple(np.clip(each, 0, most - 1) for each, most in zip(behind, (height, width), strict=True))
    own = paint[far] == paint[row, column]
    far = np.where(own, far[0], row), np.where(own, far[1], column)
    near = levels[row, column].astype(float)
    out = np.clip(2.0 * near - levels[far], 0.0, 255.0)
    out[..., 3] = near[..., 3]
    return np.asarray(out)


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
