"""A shadow put into a drawing: above all that it shades, below what casts it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.geometry.coverage import coverage
from cubicsplat_cli.artwork.shadows.blurred import reached, shaded
from cubicsplat_cli.artwork.shadows.casters import SQUARE
from cubicsplat_cli.artwork.shadows.lifting import Lifted
from cubicsplat_cli.artwork.shadows.shadow import Cast
from cubicsplat_cli.artwork.shadows.slices import Cut, sliced
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.raster import ndimage

LEAST_SEEN = 8  # px of a shape in the shade, for the shadow to lie above it
SHADE = 1.0 / 255.0


def with_shadow(drawing: Drawing, lifted: Lifted) -> Drawing | None:
    """The drawing of a picture without its shadows, with them; None where they cannot be drawn in gradients, or would
    shade what they do not."""
    if lifted.shadow is None or lifted.shaded is None:
        return drawing
    owners = _owners(drawing)
    layers: list[tuple[int, list[Shape]]] = []
    for cast in lifted.shadow.casts:
        shown = lifted.shaded & ~cast.caster.mask
        window = reached(cast.caster.box, cast.layers, shown.shape)
        if window[0].stop <= window[0].start or window[1].stop <= window[1].start:
            continue
        share = _share(cast, window)
        shapes = sliced(Cut(cast, share, shown[window], lifted.shadow.shaded.colour[:3], window))
        dark = np.zeros(shown.shape, dtype=bool)
        dark[window] = share > SHADE
        place = _place(owners, len(drawing.shapes), dark & ~cast.caster.mask, shown)
        if shapes is None or place is None:
            return None
        layers.append((place, shapes))
    out: list[Shape] = []
    for k, shape in enumerate([*lifted.meant(drawing).shapes, None]):
        out += [one for place, shapes in layers if place == k for one in shapes]
        out += [shape] if shape is not None else []
    return replace(drawing, shapes=tuple(out))


def _share(cast: Cast, window: tuple[slice, slice]) -> np.ndarray:
    """(h, w) how much a shadow darkens the pixels of a window."""
    rows, columns = window
    x, y = np.arange(columns.start, columns.stop) + 0.5, np.arange(rows.start, rows.stop) + 0.5
    return shaded(cast.caster.box, cast.layers, x, y)


def _place(owner: np.ndarray, count: int, dark: np.ndarray, shaded: np.ndarray) -> int | None:
    """The number of shapes below a shadow; None where one that is not shaded is there.

    owner: (H, W) as of `_owners`. dark: (H, W) bool where the shadow would be seen; shaded: where it is.
    """
    inner = ndimage.binary_erosion(shaded, SQUARE) & dark
    outer = ndimage.binary_erosion(~shaded, SQUARE, border_value=1) & dark
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
        cubics, lines = np.concatenate([r.cubics for r in rings]), np.concatenate([r.lines for r in rings])
        out[coverage(cubics, lines, 0, 0, *out.shape) >= 0.5] = number
    return out
