"""Pictures of one colour, which nothing need be fitted to."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Rectangle
from cubicsplat_cli.artwork.shapes import Drawing, Shape, shape_name
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.scene.paint import Rgba

_ROWS = 64
# What a JPEG makes of one colour with a trace of noise: two steps of 8 bits between any two pixels, which nobody sees.
_SPREAD = 2.0 / 255.0 + 1e-6


def only_fill(picture: Picture) -> Rgba | None:
    """The colour of every pixel, (0, 0, 0, 0) where all are transparent; None where there are several.

    Colours that are all but the same count as their mean; opacities must be the same.
    """
    if picture.alpha is not None and _mean(picture.alpha[..., None], 0.0) is None:
        return None
    colour = _mean(picture.rgb, _SPREAD)
    if colour is None:
        return None
    red, green, blue = (round(255 * value) for value in colour)
    return red, green, blue, 255 if picture.alpha is None else round(255 * float(picture.alpha[0, 0]))


def _mean(plane: np.ndarray, spread: float) -> list[float] | None:
    """The mean of each channel of (H, W, C); None where one's values lie further apart than `spread`."""
    least = most = plane[0, 0]
    total = np.zeros(plane.shape[2])
    # Most pictures are known by their first rows.
    for top in range(0, plane.shape[0], _ROWS):
        part = plane[top : top + _ROWS]
        least, most = np.minimum(least, part.min((0, 1))), np.maximum(most, part.max((0, 1)))
        if (most - least > spread).any():
            return None
        total += part.sum((0, 1), dtype=np.float64)
    return [float(value) for value in total / (plane.shape[0] * plane.shape[1])]


def plain_drawing(fill: Rgba, width: int, height: int) -> Drawing:
    """A rectangle of one fill over the whole canvas; nothing where the fill is transparent."""
    outlines = (Rectangle(0.0, 0.0, float(width), float(height)),)
    shape = Shape(fill, outlines, shape_name(fill, outlines, width, height))
    return Drawing(width, height, (shape,) if fill[3] else ())
