"""The fills of a drawing at their best for its picture, once its gradients are what they are.

Regions are found in a picture where one colour, a placeholder, stands for each gradient. Shapes at the edge of a
gradient may have got some of that colour.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.finish.state import FILL_PARAMETERS
from cubicsplat_cli.artwork.gradients.flattening import Flattened, colours_of
from cubicsplat_cli.artwork.input.palette import UNLIKE
from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.artwork.shapes import PRICE, Drawing
from cubicsplat_cli.raster.engines import render_scene

ROUNDED = 1.0 / 12.0  # levels^2 by which a picture's pixels are off at the least


def recoloured(drawing: Drawing, levels: np.ndarray, flat: Flattened | None) -> Drawing:
    """The drawing with other opaque fills where the description of its picture (H, W, 4), premultiplied levels, becomes
    shorter by them: normal errors of any one size in the pixels of a shape, against the price of a fill. flat: the
    gradients of a damaged picture, whose fills are only freed of what stands for these; None for a clean one.
    """
    if not drawing.gradients:
        return drawing
    height, width = levels.shape[:2]
    off = (levels - 255.0 * render_scene(scene_of(drawing)))[..., :3]
    seen, shapes = np.ones((height, width)), list(drawing.shapes)
    for k, shape in reversed(list(enumerate(shapes))):
        window = shape.window()
        top, left = window[0].start, window[1].start
        own = shape.coverage(top, left, *seen[window].shape)
        share = own * seen[window]
        seen[window] *= 1.0 - own * (shape.fill[3] / 255.0)
        if shape.gradient is not None or shape.fill[3] < 255 or not share.any():
            continue
        y, x = np.nonzero(share)
        weights, before = share[y, x][:, None], off[window][y, x]
        change = (weights * before).sum(axis=0) / (weights * weights).sum()
        if flat is not None:
            change = _leak(change, flat, x + left, y + top)
            if np.abs(change).max() < UNLIKE:
                continue
        fill = np.array(shape.fill[:3], dtype=float)
        best = np.rint(np.clip(fill + change, 0.0, 255.0))
        after = before - weights * (best - fill)
        was, now = (float((each**2).sum()) + ROUNDED * each.size for each in (before, after))
        if 0.5 * before.size * math.log(was / now) > PRICE * FILL_PARAMETERS:
            off[window][y, x] = after
            red, green, blue = best.astype(int).tolist()
            shapes[k] = shape.filled((red, green, blue, 255), width, height)
    return replace(drawing, shapes=tuple(shapes))


def _leak(change: np.ndarray, flat: Flattened, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the part of a change (3,) of a fill that takes out the share of a placeholder, of the one that explains
    most of the change, at columns and rows (n,); 0 if it leaves half of the change."""
    best = np.zeros(3)
    for fill, gradients in zip(flat.fills, flat.gradients, strict=True):
        whole = colours_of(gradients, x, y)[:, :3].mean(axis=0) - fill[:3]
        part = whole * np.clip(change @ whole / max(float(whole @ whole), 1e-9), 0.0, 1.0)
        best = min(best, part, key=lambda each: float(((change - each) ** 2).sum()))
    # Of many placeholders, some one explains a part of any change.
    return best if np.linalg.norm(change - best) < 0.5 * np.linalg.norm(change) else np.zeros(3)
