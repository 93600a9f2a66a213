"""Places of new restricted shapes: of many that are tried, those that take away most of the error.

A patch of similar error, as free curves begin at, says nothing about how well a shape of a kind covers it.
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.raster.cpu import native
from cubicsplat_cli.scene.shapes import TEMPLATES, polygon_points

TRIES, MOVES = 200, 100  # of each shape; five times as many make fits no better (docs/lab/photos.md)
LEAST, MOST = 1.0 / 16.0, 4.0  # half-axes of what is tried, in length units
FINENESS = 16.0  # px: a length unit in the copy of the picture on which shapes are tried
ROUND = 16  # corners of an ellipse there


def place_shapes(
    kind: str, segments: int, target: np.ndarray, image: np.ndarray, weights: np.ndarray | None,
    centres: np.ndarray, unit: float, opacity: float, generator: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Shapes of a kind to go in front of a picture (H, W, 3) that is to become the target, by the pixels' weights
    (H, W): control points (n, K, 2) px and colours (n, 3). centres: (n, `TRIES`, 2) px, where each of them is tried.
    unit: the length unit, px.
    """
    count, scale = len(centres), max(1, min(int(unit / FINENESS), *target.shape[:2]))
    goal, canvas = _smaller(target, scale), _smaller(image, scale)
    importance = None if weights is None else _smaller(weights[..., None], scale)
    ring = TEMPLATES[kind][:, 1:] if kind in TEMPLATES else polygon_points(_circle(segments)[None])[0]
    outline = np.ascontiguousarray(_circle(ROUND) if kind == "ellipse" else ring[::3], np.float32)
    sizes = math.log(unit / scale) + generator.uniform(math.log(LEAST), math.log(MOST), (count, TRIES, 2))
    angles = generator.uniform(0.0, 2.0 * math.pi, (count, TRIES, 2))
    moves = generator.standard_normal((count, MOVES, 6)).astype(np.float32)
    if kind in TEMPLATES:  # the outline stays in line with the axes
        angles[..., 1], moves[..., 5] = 0.0, 0.0
    tries = np.concatenate((centres / scale, angles[..., :1], sizes, angles[..., 1:]), axis=-1).astype(np.float32)
    found = np.empty((count, 9), np.float32)
    native(
        "placing", "cs_place", goal, importance, canvas, *goal.shape[:2], outline, len(outline), float(opacity), tries,
        TRIES, moves, MOVES, count, found, result=None,
    )  # fmt: skip
    found = found[::-1]  # from front to back
    axes = scale * np.exp(found[:, None, 3:5])
    points = found[:, None, :2] * scale + (ring @ _turned(found[:, 5]) * axes) @ _turned(found[:, 2])
    return points.astype(np.float32), found[:, 6:]


def _circle(corners: int) -> np.ndarray:
    """(n, 2): evenly on the unit circle."""
    angles = np.arange(corners) * (2.0 * math.pi / corners)
    return np.stack((np.cos(angles), np.sin(angles)), axis=1)


def _turned(angles: np.ndarray) -> np.ndarray:
    """(n, 2, 2): what turns rows of coordinates by these angles (n,)."""
    c, s = np.cos(angles), np.sin(angles)
    return np.stack((c, s, -s, c), axis=1).reshape(-1, 2, 2)


def _smaller(picture: np.ndarray, scale: int) -> np.ndarray:
    """A copy (h, w, C) of the means of blocks of so many pixels a side of (H, W, C), without the rest beyond them."""
    h, w = picture.shape[0] // scale, picture.shape[1] // scale
    blocks = picture[: h * scale, : w * scale].reshape(h, scale, w, scale, -1)
    return np.ascontiguousarray(blocks.mean((1, 3)), np.float32)
