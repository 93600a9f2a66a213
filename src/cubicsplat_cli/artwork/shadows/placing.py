"""A shadow put into a drawing: above all that it shades, below what casts it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from cubicsplat_cli.artwork.geometry.coverage import coverage, edges_of
from cubicsplat_cli.artwork.shadows.blurred import Silhouette, moved
from cubicsplat_cli.artwork.shadows.casters import SQUARE
from cubicsplat_cli.artwork.shadows.found import Shadow
from cubicsplat_cli.artwork.shadows.lifting import Lifted
from cubicsplat_cli.artwork.shadows.slices import Cast, sliced
from cubicsplat_cli.artwork.shapes import Drawing, Shape

LEAST_SEEN = 8  # px of a shape in the shade, for the shadow to lie above it
SHADE = 1.0 / 255.0


def with_shadow(drawing: Drawing, lifted: Lifted) -> Drawing | None:
    """The drawing of a picture without its shadow, with it; None where it cannot be drawn in gradients, or would shade
    what it does not."""
    if lifted.shadow is None or lifted.shaded is None:
        return drawing
    shapes = shadow_shapes(lifted.shadow, lifted.shaded)
    if shapes is None:
        return None
    place = _place(drawing, lifted.shadow.everywhere() > SHADE, lifted.shaded)
    if place is None:
        return None
    whole = lifted.meant(drawing)
    return replace(whole, shapes=(*whole.shapes[:place], *shapes, *whole.shapes[place:]))


def shadow_shapes(shadow: Shadow, shaded: np.ndarray) -> list[Shape] | None:
    """The shapes of a shadow, back to front, those of each thing that casts it together; None where there are none.

    shaded: (H, W) bool the pixels that show it.
    """
    shown = shaded[shadow.window]
    rows, columns = shadow.window
    weights = np.array([layer.alpha for layer in shadow.layers])
    sigma = float(weights @ [layer.sigma for layer in shadow.layers] / weights.sum())
    strongest = shadow.layers[int(weights.argmax())]
    out: list[Shape] = []
    for caster in shadow.casters:
        down, across = _reached(caster, shadow)
        silhouette = Silhouette(caster[down, across])
        own = moved(silhouette.coverage(strongest.grown), strongest)
        share = silhouette.shaded(shadow.layers)
        corner = (columns.start + across.start, rows.start + down.start)
        shapes = sliced(Cast(share, shown[down, across], shadow.shaded.colour[:3], own, sigma, corner))
        if shapes is None:
            return None
        out += shapes
    return out


def _reached(caster: np.ndarray, shadow: Shadow) -> tuple[slice, slice]:
    """The part of the window that the shadow of one thing, (h, w) bool, reaches."""
    out = []
    for axis, moves in ((0, [layer.dy for layer in shadow.layers]), (1, [layer.dx for layer in shadow.layers])):
        reach = max(4.0 * layer.sigma + max(layer.grown, 0.0) for layer in shadow.layers)
        at = np.flatnonzero(caster.any(axis=1 - axis))
        first, last = int(at[0] - reach + min([*moves, 0.0])), int(at[-1] + 2 + reach + max([*moves, 0.0]))
        out.append(slice(max(first, 0), min(last, caster.shape[axis])))
    return out[0], out[1]


def _place(drawing: Drawing, dark: np.ndarray, shaded: np.ndarray) -> int | None:
    """How many shapes lie below the shadow; None where one that is not shaded does."""
    owner = _owners(drawing)
    inner = ndimage.binary_erosion(shaded, SQUARE) & dark
    outer = ndimage.binary_erosion(~shaded, SQUARE, border_value=1) & dark
    count = len(drawing.shapes)
    below = np.bincount(owner[inner & (owner >= 0)], minlength=count)
    above = np.bincount(owner[outer & (owner >= 0)], minlength=count)
    lies_below = (below >= LEAST_SEEN) & (below > above)
    place = int(np.flatnonzero(lies_below).max()) + 1 if lies_below.any() else 0
    wrong = above[:place] >= LEAST_SEEN
    return None if (wrong & ~lies_below[:place]).any() else place


def _owners(drawing: Drawing) -> np.ndarray:
    """(H, W) int the number of the uppermost shape that covers half of a pixel, -1 for none."""
    out = np.full((drawing.height, drawing.width), -1)
    for number, shape in enumerate(drawing.shapes):
        rings = shape.oriented()
        edges = edges_of(np.concatenate([r.cubics for r in rings]), np.concatenate([r.lines for r in rings]))
        out[coverage(edges, 0, 0, *out.shape) >= 0.5] = number
    return out
