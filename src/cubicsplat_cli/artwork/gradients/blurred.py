"""Gradients of pictures that are only blurred: found away from edges, and followed up to them.

They are sought as in clean pictures, or in windows that a plane explains, as with noise, where these show clearly more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.gradients.areas import gradient_areas
from cubicsplat_cli.artwork.gradients.flattening import Flattened, without_areas
from cubicsplat_cli.artwork.gradients.noisy import GROWN, beside, is_step, off_extended, plane_areas
from cubicsplat_cli.artwork.gradients.parts import PLUS, SQUARE, smooth_parts
from cubicsplat_cli.artwork.gradients.shade import ShadedArea
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.raster import ndimage

# Levels by which a pixel that a gradient is followed to may be off it, px that it is followed for, and the share of an
# even part beside it that it must explain for that to be its own.
NEAR, FARTHEST, MOSTLY = 2.0, 40, 0.9
EDGE = 6.0  # standard deviations of a blur, which an edge is wide
MORE = 1.5  # times the pixels that windows must show gradients in
LEAST_EVEN = 40  # px of what is even: less is the rest of a gradient in a tip


def without_blurred_gradients(levels: np.ndarray, blur: float) -> Flattened:
    """A picture (H, W, 4), premultiplied levels, without its gradients. blur: px, standard deviation."""
    parts, count = smooth_parts(levels)
    if not count:
        return Flattened(levels, np.zeros((0, 4)), ())
    # The rims of what is smooth are the last of blurred edges.
    rim = max(1, round(blur))
    inner = ndimage.binary_erosion(np.pad(parts > 0, rim, mode="edge"), SQUARE, iterations=rim)[rim:-rim, rim:-rim]
    found = [
        area for area in gradient_areas(levels, *ndimage.label(inner, PLUS)) if not is_step(area.shade, EDGE * blur)
    ]
    planes = plane_areas(levels, Condition(blur=blur))
    if sum(area.patch.size for area in planes) > MORE * sum(area.patch.size for area in found):
        areas = [_followed(levels, parts, area, GROWN) for area in planes]
    else:
        areas = [area if area.ground is not None else _followed(levels, parts, area, 1 + rim) for area in found]
    return without_areas(levels, _rest(parts, areas), areas, blur)


def _followed(levels: np.ndarray, parts: np.ndarray, area: ShadedArea, rim: int) -> ShadedArea:
    """The area with what hangs on it that its gradient explains too: pixels within `rim` px, and tips."""
    wide = area.patch.padded(FARTHEST, levels.shape)
    near = beside(wide, ndimage.binary_dilation(wide.mask, SQUARE, iterations=FARTHEST))
    explained = np.zeros_like(wide.mask)
    explained[near.mask] = off_extended(area.shade, levels, near) <= NEAR
    # A neighbour of about the colour in which the gradient ends is none of it, nor what goes on farther.
    rests, count = ndimage.label((parts[wide.window] > 0) & ~wide.mask, PLUS)
    sizes = np.maximum(np.bincount(rests.ravel(), minlength=count + 1), 1)
    own = np.bincount(rests.ravel(), explained.ravel(), count + 1) >= MOSTLY * sizes
    own[0] = False
    rimmed = ndimage.binary_dilation(wide.mask, SQUARE, iterations=rim)
    mask = wide.mask | (explained & (rimmed | own[rests]))
    return replace(area, patch=replace(wide, mask=ndimage.binary_propagation(wide.mask, PLUS, mask)))


def _rest(parts: np.ndarray, areas: list[ShadedArea]) -> np.ndarray:
    """(H, W) int32 numbers from 1 on of what changes evenly and is in no area, 0 elsewhere."""
    free = parts > 0
    for area in areas:
        free[area.patch.window] &= ~area.patch.mask
    labels, count = ndimage.label(free, PLUS)
    large = np.bincount(labels.ravel(), minlength=count + 1) >= LEAST_EVEN
    large[0] = False
    return np.where(large[labels], labels, 0).astype(np.int32)
