"""A picture that needs no file: the same on every machine, with the kinds of content that photos have."""

from __future__ import annotations

import numpy as np

# Of the layout of shapes; another value would be another benchmark.
_SEED = 20_26
_SHAPES = 40


def synthetic_picture(width: int, height: int) -> np.ndarray:
    """(H, W, 3) float32 in [0, 1]: a smooth gradient, discs and bars with sharp edges, and a band of fine texture."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    u, v = (x + 0.5) / width, (y + 0.5) / height
    picture = np.stack([0.35 + 0.45 * v, 0.55 - 0.25 * u * v, 0.75 - 0.5 * v + 0.1 * np.sin(5.0 * u)], axis=-1)
    random = np.random.default_rng(_SEED)
    aspect = width / height
    for index in range(_SHAPES):
        cx, cy, size, turn = random.uniform(0, 1, 4) * (1.0, 1.0, 0.14, 2 * np.pi)
        colour = random.uniform(0.05, 0.95, 3)
        dx, dy = (u - cx) * aspect, v - cy
        along, across = dx * np.cos(turn) + dy * np.sin(turn), dy * np.cos(turn) - dx * np.sin(turn)
        if index % 2:
            inside = along**2 + (1.7 * across) ** 2 < (0.02 + size) ** 2
        else:
            inside = (np.abs(along) < 0.03 + 2.0 * size) & (np.abs(across) < 0.006 + 0.15 * size)
        shade = 1.0 + 0.25 * along / (0.02 + size)
        picture = np.where(inside[..., None], colour * np.clip(shade, 0.6, 1.4)[..., None], picture)
    weave = np.sin(2 * np.pi * (31 * u + 7 * v)) * np.sin(2 * np.pi * (23 * v - 11 * u))
    band = np.exp(-(((v - 0.72) / 0.12) ** 2))
    picture = picture + 0.12 * (weave * band)[..., None]
    return np.clip(picture, 0.0, 1.0).astype(np.float32)
