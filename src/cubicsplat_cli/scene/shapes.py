"""Closed curves that follow from a few parameters by a smooth map: ellipses, rectangles and polygons.

An ellipse and a rectangle are c + a u + b h n for pairs of numbers (a, b) that are the same for all: c is the centre, u
half of the first axis, n the unit normal of u, and h half of the second axis. Their parameters are (N, 5): c, u and h.
Those of polygons are their vertices (N, 2 n); the handles lie at the thirds of the sides. All lengths are px.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.scene.arrays import Array, contiguous, like, namespace

# Handles of this length make a quarter of a circle, to 0.03 %.
KAPPA = 4.0 / 3.0 * (2.0**0.5 - 1.0)


def _around(quarter: list[tuple[float, float]]) -> np.ndarray:
    """Return (12, 3): 1 and the three control points of a quarter, and these turned by 90, 180 and 270 degrees."""
    x, y = np.array(quarter, np.float32).T
    return np.concatenate([np.stack((np.ones_like(u), u, v), 1) for u, v in ((x, y), (-y, x), (-x, -y), (y, -x))])


# Of each kind that has axes: (1, a, b) of its control points, to be multiplied by frames (N, 3, 2) of c, u and h n.
TEMPLATES = {
    "ellipse": _around([(1.0, 0.0), (1.0, KAPPA), (KAPPA, 1.0)]),
    "rectangle": _around([(1.0, 1.0), (1.0 / 3.0, 1.0), (-1.0 / 3.0, 1.0)]),
}


def shape_points(kind: str, values: Array) -> Array:
    """Return the control points (N, K, 2) of shapes with these parameters."""
    xp = namespace(values)
    if kind not in TEMPLATES:
        return contiguous(polygon_points(xp.reshape(values, (len(values), -1, 2))))
    frames = xp.stack((values[:, :2], values[:, 2:4], values[:, 4:] * normals(values)), axis=1)
    return xp.matmul(like(values, TEMPLATES[kind]), frames)


def shape_gradient(kind: str, values: Array, of_points: Array) -> Array:
    """Return dL/d of the parameters from dL/d of the control points (N, K, 2), by the map's Jacobian."""
    xp = namespace(values)
    if kind not in TEMPLATES:
        sides = xp.reshape(of_points, (len(of_points), -1, 3, 2))
        own = sides[:, :, 0] + (2.0 * sides[:, :, 1] + sides[:, :, 2]) / 3.0
        of_vertices = own + xp.roll((sides[:, :, 1] + 2.0 * sides[:, :, 2]) / 3.0, 1, axis=1)
        return xp.reshape(of_vertices, values.shape)
    of_frames = xp.matmul(xp.matrix_transpose(like(values, TEMPLATES[kind])), of_points)
    normal, across = normals(values), of_frames[:, 2]
    of_h = xp.sum(across * normal, axis=1, keepdims=True)
    # n is u turned by 90 degrees over |u|, so it changes only at right angles to itself.
    turning = values[:, 4:] / lengths(values) * (across - of_h * normal)
    of_first = of_frames[:, 1] + xp.stack((turning[:, 1], -turning[:, 0]), axis=1)
    return xp.concat((of_frames[:, 0], of_first, of_h), axis=1)


def nearest_shape(kind: str, points: Array) -> Array:
    """Return the parameters of curves (N, K, 2), exact for curves of this kind; K = 12 for ellipses and rectangles."""
    xp, anchors = namespace(points), points[:, ::3]
    if kind not in TEMPLATES:
        return xp.reshape(anchors, (len(points), -1))
    template = like(points, TEMPLATES[kind])[::3]
    # Its columns are orthogonal.
    frames = xp.matmul(xp.matrix_transpose(template), anchors) / xp.sum(template * template, axis=0)[:, None]
    values = xp.concat((frames[:, 0], frames[:, 1], frames[:, 2, :1]), axis=1)
    values[:, 4] = xp.sum(normals(values) * frames[:, 2], axis=1)
    return values


def lengths(values: Array) -> Array:
    """Return the lengths (N, 1), above 0, of the first half axes."""
    xp = namespace(values)
    return xp.clip(xp.hypot(values[:, 2:3], values[:, 3:4]), min=1e-6)


def normals(values: Array) -> Array:
    """Return the unit normals (N, 2) of the first axes."""
    return namespace(values).stack((-values[:, 3], values[:, 2]), axis=1) / lengths(values)


def polygon_points(vertices: Array) -> Array:
    """Return the control points (N, 3 n, 2) of polygons with vertices (N, n, 2)."""
    xp = namespace(vertices)
    step = (xp.concat((vertices[:, 1:], vertices[:, :1]), axis=1) - vertices) / 3.0
    return xp.reshape(xp.stack((vertices, vertices + step, vertices + 2.0 * step), axis=2), (len(vertices), -1, 2))
