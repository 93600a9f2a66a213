"""Shadows as shapes of a drawing, above all that they shade and below their casters.

The shadow of a box consists of gradients on whole pixels, which abut: four strips, four corners and a middle; that of
an ellipse is one radial gradient. Along a side the shadow changes in one direction. Around a corner it is nearly round,
and the nearest circular or elliptic gradient stands for it. A shadow of any other outline consists of even shapes, each
within the one before and a step darker.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from itertools import pairwise, product

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ellipse, Outline, Rectangle
from cubicsplat_cli.artwork.gradients.parts import LEAST_AREA
from cubicsplat_cli.artwork.gradients.shade import gradient_of
from cubicsplat_cli.artwork.gradients.shades import shade_of
from cubicsplat_cli.artwork.layers.completion import DOT, outlines_of
from cubicsplat_cli.artwork.layers.extents import extents_of
from cubicsplat_cli.artwork.regions.fills import CONTACT, EVEN, SEEN
from cubicsplat_cli.artwork.regions.regions import ShadowSides
from cubicsplat_cli.artwork.regions.sampling import share_positions
from cubicsplat_cli.artwork.shadows.lifting import Lifted, sides_of
from cubicsplat_cli.artwork.shadows.shadow import FAINT, Cast
from cubicsplat_cli.artwork.shadows.soft import SoftArea
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.raster.shades import Pixels
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import mean_fill, painted

NAME = "shadow"
CORNER = 1.75  # sigmas from a side, besides the radius, at which its corner ends
# Levels of each even step, of which half is the largest error of a shadow. Renderers round after each translucent
# shape, so that more of them come no nearer. Steps that are more than APART px apart are visible unless they are small.
STEPS, APART = (2, 6), 2.0


@record
class Cut:
    """Part of a picture that one shadow shades. share: (h, w) 0..1 in a window of the picture; shown: (h, w) bool, the
    pixels that show it; colour: (3,) levels."""

    cast: Cast
    share: np.ndarray
    shown: np.ndarray
    colour: np.ndarray
    window: tuple[slice, slice]

    def places(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x and y (n,), px of the picture, of the middles of some pixels (h, w) bool."""
        rows, columns = np.nonzero(pixels)
        return columns + self.window[1].start + 0.5, rows + self.window[0].start + 0.5


def sliced(cut: Cut) -> list[Shape] | None:
    """Return the shapes of a shadow, which do not overlap; None if they would differ too much from it."""
    x, y = cut.places(255.0 * cut.share > 0.5 * FAINT)
    if len(x) == 0:
        return []
    (x0, x1), (y0, y1) = ((float(at.min()) - 0.5, float(at.max()) + 0.5) for at in (x, y))
    layers = cut.cast.layers
    box = max(layers, key=lambda layer: layer.alpha).of(cut.cast.box)
    if box.round:
        shapes = [_piece(cut, Ellipse(0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (x1 - x0) + 1.0, 0.5 * (y1 - y0) + 1.0))]
    else:
        sigma = sum(layer.alpha * layer.sigma for layer in layers) / sum(layer.alpha for layer in layers)
        rows = pairwise(_cuts(y0, y1, box.top, box.bottom, CORNER * sigma + box.ry))
        columns = pairwise(_cuts(x0, x1, box.left, box.right, CORNER * sigma + box.rx))
        pieces = (Rectangle(left, top, right - left, end - top) for (top, end), (left, right) in product(rows, columns))
        shapes = [_piece(cut, piece) for piece in pieces if piece.width > 0.0 and piece.height > 0.0]
    return shapes if _worst(cut, shapes) <= SEEN else None


def _cuts(first: float, last: float, low: float, high: float, reach: float) -> list[float]:
    """Return the coordinates of the cuts of a shadow from `first` to `last` of a box from `low` to `high`: its ends,
    and the ends of corners, in whole px."""
    middle = 0.5 * (low + high)
    one, other = round(min(low + reach, middle)), round(max(high - reach, middle))
    return [first, *np.clip([one, max(other, one)], first, last).tolist(), last]


def _piece(cut: Cut, outline: Rectangle | Ellipse) -> Shape:
    """Return one piece as a shape."""
    covered = _covered(outline, cut)
    seen = covered & cut.shown
    if seen.sum() < LEAST_AREA:
        seen = covered
    alpha = cut.share[seen]
    if 255.0 * float(np.ptp(alpha)) > FAINT:
        values = np.column_stack([alpha[:, None] * cut.colour, 255.0 * alpha])
        gradient = gradient_of(shade_of(Pixels(*cut.places(seen), values)))
        return Shape(mean_fill(gradient), (outline,), NAME, gradient)
    red, green, blue = (round(float(v)) for v in cut.colour)
    return Shape((red, green, blue, round(255.0 * float(alpha.mean()))), (outline,), NAME)


def _covered(outline: Outline, cut: Cut) -> np.ndarray:
    """Return (h, w) bool: True for pixels of the window whose middles lie in an outline."""
    y, x = (np.arange(side.start, side.stop) + 0.5 for side in cut.window)
    y = y[:, None]
    if isinstance(outline, Rectangle):
        inside_x = (x > outline.x) & (x < outline.x + outline.width)
        return inside_x & (y > outline.y) & (y < outline.y + outline.height)
    assert isinstance(outline, Ellipse)
    return ((x - outline.cx) / outline.rx) ** 2 + ((y - outline.cy) / outline.ry) ** 2 < 1.0


def _worst(cut: Cut, shapes: list[Shape]) -> float:
    """Return the levels by which the worst hundredth of the visible pixels differs."""
    alpha = np.zeros(cut.share.shape)
    for shape in shapes:
        covered = _covered(shape.outlines[0], cut)
        if shape.gradient is None:
            alpha[covered] = shape.fill[3] / 255.0
        else:
            alpha[covered] = painted(shape.gradient, *cut.places(covered))[:, 3]
    off = 255.0 * np.abs(alpha - cut.share)[cut.shown]
    return float(np.percentile(off[255.0 * cut.share[cut.shown] > 0.5 * FAINT], 99)) if len(off) else 0.0


def _contoured(area: SoftArea) -> Iterator[Shape]:
    """Yield a soft area's even shapes, back to front: opaque on an opaque ground, so that rounding loses nothing."""
    share, shown, colour = area.share, area.mask, area.colour[:3]
    ground = area.fill[:3] if area.fill[3] == 255.0 else None
    whole = 255.0 if ground is None else area.scale  # levels of full shade
    levels = whole * share
    slope = np.maximum(np.hypot(*np.gradient(levels)), 1e-3)
    values, slopes = levels[shown], slope[shown]
    dark = 0.0
    while dark < values.max():
        near = np.abs(values - dark - STEPS[0]) < STEPS[0]
        steep = float(np.median(slopes[near])) if near.any() else STEPS[1] / APART  # levels a px
        step = int(np.clip(APART * steep, *STEPS))
        if ground is None:
            alpha, fill = round(255.0 * min(step / (whole - dark), 1.0)), colour
            darker = dark + (whole - dark) * alpha / 255.0
        else:
            alpha, darker = 255, dark + step
            fill = ground + min(darker / whole, 1.0) * (colour - ground)
        red, green, blue = (round(float(v)) for v in fill)
        part = 0.5 + (levels - 0.5 * (dark + darker)) / slope
        cover = part >= 0.5
        if cover.any():
            # An outline may be off by as much as a pixel in even steps is, in the mean, or by rounding.
            error = 255.0 * max(step / math.sqrt(12.0), area.rough * EVEN) / steep
            found = share_positions(np.clip(part, 0.0, 1.0), cover, error)
            for extent in extents_of(cover, np.zeros_like(cover), found):
                if extent.shown.sum() > DOT:  # rounding leaves dots
                    yield Shape((red, green, blue, alpha), outlines_of(extent, cover.shape, 1.0), NAME)
        dark = darker


class Shadows:
    """What was lifted off a picture, as shapes, which are made once for all drawings of the picture without it."""

    def __init__(self, lifted: Lifted) -> None:
        self.lifted = lifted

    @cached_property
    def _casts(self) -> list[tuple[ShadowSides, Cut]]:
        """The shadows of boxes."""
        shadow, shaded = self.lifted.shadow, self.lifted.shaded
        found = list[tuple[ShadowSides, Cut]]()
        if shadow is None or shaded is None:
            return found
        for cast in shadow.casts:
            shown, dark = shaded & ~cast.mask, np.zeros(shaded.shape, dtype=bool)
            window, share = cast.darkening(shown.shape)
            if share.size:
                dark[window] = share > FAINT / 255.0
                cut = Cut(cast, share, shown[window], shadow.shaded.colour[:3], window)
                found.append((sides_of(dark & ~cast.mask, shown), cut))
        return found

    @cached_property
    def _shapes(self) -> list[list[Shape] | None]:
        """The shapes of each soft area, and of the shadow of each box, None if gradients cannot draw it."""
        return [*(list(_contoured(area)) for area in self.lifted.areas), *(sliced(cut) for _, cut in self._casts)]

    def _places(self, drawing: Drawing) -> list[int | None]:
        """Return the number of shapes below each; see `_place`."""
        owners, count = _owners(drawing), len(drawing.shapes)
        return [_place(owners, count, *sides) for sides in [*self.lifted.sides, *(sides for sides, _ in self._casts)]]

    def placed(self, drawing: Drawing) -> tuple[SoftArea, ...]:
        """Return the soft areas that shade nothing but their grounds in the drawing of a picture without them."""
        both = zip(self.lifted.areas, self._places(drawing), strict=False)
        return tuple(area for area, place in both if place is not None)

    def over(self, drawing: Drawing) -> Drawing | None:
        """Return the drawing of a picture without its shadows with these; None if gradients cannot draw them, or if
        they would shade other shapes than in the picture."""
        places = self._places(drawing)
        if None in places or None in self._shapes:
            return None
        both = zip(places, self._shapes, strict=True)
        # With the number of the shape that each lies right below.
        below = [(place or 0, shape) for place, shapes in both for shape in shapes or ()]
        every = sorted([*below, *enumerate(self.lifted.meant(drawing).shapes)], key=lambda pair: pair[0])
        return replace(drawing, shapes=tuple(shape for _, shape in every))


def _place(owner: np.ndarray, count: int, inner: np.ndarray, outer: np.ndarray) -> int | None:
    """Return the number of shapes below a shadow; None if one of these is not shaded. owner: (H, W) as of `_owners`.
    inner, outer: as of `sides_of`."""
    below, above = (np.bincount(owner[side & (owner >= 0)], minlength=count) for side in (inner, outer))
    lies_below = (below >= CONTACT) & (below > above)
    place = int(np.flatnonzero(lies_below).max()) + 1 if lies_below.any() else 0
    return None if ((above >= CONTACT) & ~lies_below)[:place].any() else place


def _owners(drawing: Drawing) -> np.ndarray:
    """Return (H, W) int the number of the uppermost shape that covers half of each pixel, -1 for none."""
    out = np.full((drawing.height, drawing.width), -1)
    for number, shape in enumerate(drawing.shapes):
        window, share = shape.covered(out.shape)
        out[window][share >= 0.5] = number
    return out
