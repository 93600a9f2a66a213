"""Shadows as shapes of a drawing, above all that they shade and below their casters.

The shadow of a box consists of gradients on whole pixels, which abut: four strips, four corners and a middle; that of
an ellipse is one radial gradient. Along a side the shadow changes in one direction. Around a corner it is nearly round,
and the nearest circular or elliptic gradient stands for it. A shadow of any other outline consists of even shapes, each
within the one before and a step darker.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ellipse, Outline, Rectangle
from cubicsplat_cli.artwork.gradients.parts import LEAST_AREA
from cubicsplat_cli.artwork.gradients.shade import gradient_of
from cubicsplat_cli.artwork.gradients.shades import shade_of
from cubicsplat_cli.artwork.layers.completion import outlines_of
from cubicsplat_cli.artwork.layers.extents import extents_of
from cubicsplat_cli.artwork.regions.fills import CONTACT, EVEN, SEEN
from cubicsplat_cli.artwork.regions.regions import ShadowSides
from cubicsplat_cli.artwork.regions.sampling import share_positions
from cubicsplat_cli.artwork.shadows.boxes import Box
from cubicsplat_cli.artwork.shadows.lifting import Lifted, sides_of
from cubicsplat_cli.artwork.shadows.shadow import FAINT, Cast
from cubicsplat_cli.artwork.shadows.soft import SoftArea
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.raster.shades import Pixels
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import Gradient, mean_fill, painted

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

    @property
    def corner(self) -> tuple[int, int]:
        """Coordinates x, y of the window in the picture."""
        return self.window[1].start, self.window[0].start


def sliced(cut: Cut) -> list[Shape] | None:
    """Return the shapes of a shadow, which do not overlap; None if they would differ too much from it."""
    rows, columns = np.nonzero(255.0 * cut.share > 0.5 * FAINT)
    if len(rows) == 0:
        return []
    x0, y0, x1, y1 = int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1
    layers = cut.cast.layers
    strongest = max(layers, key=lambda layer: layer.alpha)
    box = strongest.of(cut.cast.box).moved(-cut.corner[0], -cut.corner[1])
    sigma = sum(layer.alpha * layer.sigma for layer in layers) / sum(layer.alpha for layer in layers)
    if box.round:
        x, y, rx, ry = 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (x1 - x0) + 1.0, 0.5 * (y1 - y0) + 1.0
        shapes = [_piece(cut, Ellipse(x + cut.corner[0], y + cut.corner[1], rx, ry))]
    else:
        shapes = _nine(cut, (x0, y0, x1, y1), box, CORNER * sigma)
    return shapes if _worst(cut, shapes) <= SEEN else None


def _nine(cut: Cut, frame: tuple[int, int, int, int], box: Box, reach: float) -> list[Shape]:
    """Return nine pieces, or fewer where some have no room. reach: px beyond its radius that a corner takes."""
    xs = _cuts(frame[0], frame[2], box.left, box.right, reach + box.rx)
    ys = _cuts(frame[1], frame[3], box.top, box.bottom, reach + box.ry)
    dx, dy = cut.corner
    return [
        _piece(cut, Rectangle(float(x0 + dx), float(y0 + dy), float(x1 - x0), float(y1 - y0)))
        for y0, y1 in pairwise(ys)
        for x0, x1 in pairwise(xs)
        if x1 > x0 and y1 > y0
    ]


def _cuts(first: int, last: int, low: float, high: float, reach: float) -> list[int]:
    """Return the coordinates of the cuts of a shadow from `first` to `last` of a box from `low` to `high`: its ends,
    and the ends of corners."""
    middle = 0.5 * (low + high)
    one, other = round(min(low + reach, middle)), round(max(high - reach, middle))
    inner = [int(np.clip(cut, first, last)) for cut in (one, max(other, one))]
    return [first, *inner, last]


def _piece(cut: Cut, outline: Rectangle | Ellipse) -> Shape:
    """Return one piece as a shape."""
    covered = _covered(outline, cut)
    rows, columns = np.nonzero(covered & cut.shown)
    if len(rows) < LEAST_AREA:
        rows, columns = np.nonzero(covered)
    alpha = cut.share[rows, columns]
    values = np.column_stack([alpha[:, None] * cut.colour, 255.0 * alpha])
    dx, dy = cut.corner
    gradient: Gradient | None = None
    if 255.0 * float(np.ptp(alpha)) > FAINT:
        gradient = gradient_of(shade_of(Pixels(columns + dx + 0.5, rows + dy + 0.5, values)))
        fill = mean_fill(gradient)
    else:
        red, green, blue = (round(float(v)) for v in cut.colour)
        fill = (red, green, blue, round(255.0 * float(alpha.mean())))
    return Shape(fill, (outline,), NAME, gradient)


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
    dx, dy = cut.corner
    alpha = np.zeros(cut.share.shape)
    for shape in shapes:
        covered = _covered(shape.outlines[0], cut)
        y, x = np.nonzero(covered)
        if shape.gradient is None:
            alpha[covered] = shape.fill[3] / 255.0
        else:
            alpha[covered] = painted(shape.gradient, x + dx + 0.5, y + dy + 0.5)[:, 3]
    off = 255.0 * np.abs(alpha - cut.share)[cut.shown]
    return float(np.percentile(off[255.0 * cut.share[cut.shown] > 0.5 * FAINT], 99)) if len(off) else 0.0


def _contoured(area: SoftArea) -> Iterator[Shape]:
    """Yield a soft area's even shapes, back to front: opaque on an opaque ground, so that rounding loses nothing."""
    share, shown, colour = area.share, area.mask, area.colour[:3]
    ground = area.ground.fill[:3] if area.ground.fill[3] == 255.0 else None
    whole = 255.0 if ground is None else float(np.abs(colour - ground).max())  # levels of full shade
    levels = whole * share
    slope = np.maximum(np.hypot(*np.gradient(levels)), 1e-3)
    values, slopes = levels[shown], slope[shown]
    most, error = float(values.max()), area.rough * 255.0 * EVEN / float(slopes.max())
    dark = 0.0
    while dark < most:
        near = np.abs(values - dark - STEPS[0]) < STEPS[0]
        step = int(np.clip(APART * np.median(slopes[near]), *STEPS)) if near.any() else STEPS[1]
        alpha = 255 if ground is not None else round(255.0 * min(step / (whole - dark), 1.0))
        darker = dark + (step if ground is not None else (whole - dark) * alpha / 255.0)
        fill = colour if ground is None else ground + min(darker / whole, 1.0) * (colour - ground)
        red, green, blue = (round(float(v)) for v in fill)
        for outlines in _outlines(0.5 + (levels - 0.5 * (dark + darker)) / slope, error):
            yield Shape((red, green, blue, alpha), outlines, NAME)
        dark = darker


def _outlines(part: np.ndarray, error: float) -> Iterator[tuple[Outline, ...]]:
    """Yield the outlines of a shape that covers these parts of the pixels (H, W), to an error in levels."""
    cover = part >= 0.5
    found = share_positions(np.clip(part, 0.0, 1.0), cover, error)
    if cover.any():
        for extent in extents_of(cover, np.zeros_like(cover), found):
            yield outlines_of(extent, cover.shape, 1.0)


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
            shown = shaded & ~cast.mask
            rows, columns, share = cast.darkening(shown.shape)
            if share.size:
                window, dark = (rows, columns), np.zeros(shown.shape, dtype=bool)
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
        they would shade other shapes than in the picture.
        """
        places = self._places(drawing)
        if None in places or None in self._shapes:
            return None
        both = zip(places, self._shapes, strict=True)
        # With the number of the shape that each lies right below.
        below = [(place or 0, shape) for place, shapes in both for shape in shapes or ()]
        every = sorted([*below, *enumerate(self.lifted.meant(drawing).shapes)], key=lambda pair: pair[0])
        return replace(drawing, shapes=tuple(shape for _, shape in every))


def _place(owner: np.ndarray, count: int, inner: np.ndarray, outer: np.ndarray) -> int | None:
    """Return the number of shapes below a shadow; None if one of these is not shaded.

    owner: (H, W) as of `_owners`. inner, outer: as of `sides_of`.
    """
    below, above = (np.bincount(owner[side & (owner >= 0)], minlength=count) for side in (inner, outer))
    lies_below = (below >= CONTACT) & (below > above)
    place = int(np.flatnonzero(lies_below).max()) + 1 if lies_below.any() else 0
    return None if ((above >= CONTACT) & ~lies_below)[:place].any() else place


def _owners(drawing: Drawing) -> np.ndarray:
    """Return (H, W) int the number of the uppermost shape that covers half of each pixel, -1 for none."""
    out = np.full((drawing.height, drawing.width), -1)
    for number, shape in enumerate(drawing.shapes):
        rows, columns = shape.window()
        seen = out[rows, columns]
        seen[shape.coverage(rows.start, columns.start, *seen.shape) >= 0.5] = number
    return out
