"""A picture with gradients as one of flat fills: a placeholder fill stands for each gradient.

Where a gradient shares a pixel with its neighbour, the share follows from the colour of the gradient at that place. The
same share of the placeholder makes the pixel of the flat picture. All later stages, from regions to the refinement,
therefore draw gradients as exactly as flat fills, without any special case.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import field
from functools import partial

import numpy as np

from cubicsplat_cli.artwork.channels import largest, packed, unpacked
from cubicsplat_cli.artwork.gradients.areas import gradient_areas, with_tips
from cubicsplat_cli.artwork.gradients.layers import with_layers
from cubicsplat_cli.artwork.gradients.parts import smooth_parts
from cubicsplat_cli.artwork.gradients.shade import ShadedArea, gradient_of
from cubicsplat_cli.artwork.input.restore import BLUR_REACH
from cubicsplat_cli.artwork.regions.fills import APART, FLAT_RANGE, ROUNDED, SEEN
from cubicsplat_cli.artwork.regions.hairlines import NONE
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import blends, nearest_paints
from cubicsplat_cli.raster.unmix import REACH, SLOTS, spread
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.arrays import with_channels
from cubicsplat_cli.scene.paint import Gradient, is_opaque, laid_over, painted

# Levels by which a placeholder may differ from the mean of its gradient, the least first.
SHIFTS = APART * np.array(sorted(range(5, -6, -1), key=abs))
Colours = Callable[[np.ndarray, np.ndarray], np.ndarray]  # a paint's, (n, 4) in levels at columns and rows (n,)


@record
class Flattened:
    """levels: (H, W, 4) the picture in flat fills. fills: (G, 4) whole levels, the placeholders; gradients: those that
    each stands for, back to front; areas: of a picture with noise, the pixels of the gradients, which may overlap."""

    levels: np.ndarray
    fills: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    gradients: tuple[tuple[Gradient, ...], ...] = ()
    areas: tuple[ShadedArea, ...] = ()

    def meant(self, fill: np.ndarray) -> tuple[Gradient, ...]:
        """Return the gradients, back to front, for which a fill (4,) in levels stands; none for any other fill."""
        same = np.flatnonzero((self.fills == np.rint(fill)).all(axis=1))
        return self.gradients[int(same[0])] if len(same) else ()

    def painted(self, picture: np.ndarray, palette: np.ndarray, cover: Callable[[int], np.ndarray]) -> np.ndarray:
        """Return a picture (H, W, 4) in fills (P, 4) with gradients for placeholders. cover: (H, W) of a fill."""
        out = picture.copy()
        for number, fill in enumerate(palette):
            if gradients := self.meant(fill):
                share = cover(number)
                y, x = np.nonzero(share)
                out[y, x] += share[y, x, None] * (colours_of(gradients, x, y) - fill)
        return out


def colours_of(gradients: Sequence[Gradient], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the colours (n, 4) in levels of gradients, back to front, at columns and rows (n,)."""
    return 255.0 * laid_over([painted(gradient, x + 0.5, y + 0.5) for gradient in gradients])


def flattened(levels: np.ndarray, *, layered: bool = False) -> Flattened:
    """Return a picture (H, W, 4), premultiplied levels, without its gradients; the same array if it has none. layered:
    areas may have several gradients, one above the other."""
    parts = smooth_parts(levels)
    areas = gradient_areas(parts)
    if layered:
        areas = with_layers(parts, areas)
    return without_areas(levels, parts.numbers, with_tips(parts, areas))


def without_areas(
    levels: np.ndarray, parts: np.ndarray, areas: list[ShadedArea], line: float = SEEN, blur: float = 0.0
) -> Flattened:
    """Return a picture (H, W, 4), premultiplied levels, without the gradients of these areas. parts: (H, W) int32
    numbers from 1 on of the even parts, 0 for edges. line: levels by which the pixels of thin lines differ from all
    blends of the paints beside them. blur: standard deviation of the blur of edges, px."""
    if not areas:
        return Flattened(levels)
    number = {shades: k for k, shades in enumerate(dict.fromkeys(area.shades for area in areas))}
    gradients = [tuple(map(gradient_of, shades)) for shades in number]
    paint = np.where(parts > 0, parts + len(gradients) - 1, -1).astype(np.int32)
    for area in areas:
        paint[area.patch.window][area.patch.mask] = number[area.shades]
    colours = [partial(colours_of, each) for each in gradients]
    fills = _placeholders_of(levels, paint, gradients)
    out = with_placeholders(levels, paint, colours, fills, line, blur)
    for area in areas:
        if area.ground is not None:
            _fade(out, levels, area, fills[number[area.shades]])
    return Flattened(out, fills, tuple(gradients))


def with_placeholders(
    levels: np.ndarray, paint: np.ndarray, colours: Sequence[Colours], fills: np.ndarray, line: float, blur: float = 0.0
) -> np.ndarray:
    """Return (H, W, 4) levels of a picture with its G varying paints replaced by placeholders. paint: (H, W) int32 the
    paint of every pixel: a varying one below G, an even one from G on, -1 on edges. colours: of each varying paint.
    fills: (G, 4) levels of the placeholders. line, blur: as of `without_areas`."""
    inside = (paint >= 0) & (paint < len(colours))
    out = levels.copy()
    out[inside] = fills[paint[inside]]
    reach = REACH + math.ceil(2.0 * BLUR_REACH * blur)
    near = ndimage.binary_dilation(inside, ndimage.SQUARE, iterations=reach)
    y, x = np.nonzero(near & (paint < 0))
    paints, places = nearest_paints(paint, y * paint.shape[1] + x, reach, SLOTS)
    flats = levels.reshape(-1, 4)[places.ravel()].astype(float)
    # A varying paint has another colour at the pixel itself than a few px away.
    there = flats.copy()
    order = np.argsort(paints, axis=None, kind="stable")
    ends = np.searchsorted(paints.ravel()[order], np.arange(len(colours) + 1))
    for k in np.flatnonzero(np.diff(ends)).tolist():
        slots = order[ends[k] : ends[k + 1]]
        there[slots], flats[slots] = colours[k](x[slots // SLOTS], y[slots // SLOTS]), fills[k]
    value, there, flats = levels[y, x], there.reshape(-1, SLOTS, 4), flats.reshape(-1, SLOTS, 4)
    # Where three paints meet a blur blends them over many pixels.
    flat, left = blends(value, paints, there, flats, blur > 0.0)
    # A thin line over a gradient: its share in a pixel is the pixel's contrast over the highest contrast nearby.
    alone = (left > line) & (paints[:, 0] >= 0)
    if alone.any():
        size, at = np.zeros(paint.shape), (y[alone], x[alone])
        size[at] = largest(np.abs(value[alone] - there[alone, 0]))
        most = ndimage.maximum_filter(size, 2 * REACH + 1)[at]
        share = (size[at] / np.maximum(most, 1e-9))[:, None]
        flat[alone] = value[alone] + (1.0 - share) * (flats[alone, 0] - there[alone, 0])
    out[y, x] = np.clip(flat, 0.0, 255.0)
    return out


def _fade(out: np.ndarray, levels: np.ndarray, area: ShadedArea, fill: np.ndarray) -> None:
    """Draw an edge along the line at which a gradient fades into its ground. fill: (4,) its placeholder."""
    y, x = area.patch.grown(2, levels.shape).places()
    t = area.shade.t(x + 0.5, y + 0.5) - area.shade.ramp.knots[area.rim]
    distance = t / np.maximum(np.hypot(*area.shade.slope(x + 0.5, y + 0.5)), 1e-9)
    share = np.clip(0.5 + (-distance if area.rim else distance), 0.0, 1.0)
    # Pixels of the ground beside the rim, and of the area itself on it.
    ground = largest(np.abs(levels[y, x] - area.ground)) <= ROUNDED
    inside = area.patch.at(y, x)
    at_rim = (share > 0.0) & (share < 1.0) & (inside | ground)
    out[y[at_rim], x[at_rim]] = area.ground + share[at_rim, None] * (fill - area.ground)
    # The area may hold some of the ground beyond the rim.
    beyond = inside & (share <= 0.0)
    out[y[beyond], x[beyond]] = area.ground


def _placeholders_of(levels: np.ndarray, paint: np.ndarray, gradients: list[tuple[Gradient, ...]]) -> np.ndarray:
    """Return (G, 4) for the gradients of each area a fill near its mean that no other paint has."""
    fills, count = [], len(gradients)
    inside = (paint >= 0) & (paint < count)
    sums = [np.bincount(paint[inside], levels[inside][:, k], count) for k in range(4)]
    means = np.stack(sums, axis=1) / np.bincount(paint[inside], minlength=count)[:, None]
    for mean, (lowest, *_) in zip(means, gradients, strict=True):
        alpha = 255.0 if is_opaque(lowest) else float(np.clip(mean[3], APART, 255.0 - APART))
        fills.append(np.append(mean[:3] * (alpha / max(mean[3], 1e-9)), alpha))
    # In a picture with noise small parts are no paints of their own.
    small = ndimage.binary_opening((paint < 0) & (spread(levels, 3, 3) <= 2.0 * FLAT_RANGE), ndimage.SQUARE)
    return np.array(placeholders(fills, levels[paint >= count], levels[small]))


def placeholders(fills: list[np.ndarray], levels: np.ndarray, small: np.ndarray = NONE) -> list[np.ndarray]:
    """Return for each fill (4,) one near it, in whole levels, that differs from all pixels (n, 4) and from the others:
    the first shifted one that is APART from them, and half as far from those of small parts (m, 4), or the farthest."""
    taken, near, out = _few_colours(levels), _few_colours(small), list[np.ndarray]()
    for fill in fills:
        colours = (fill[:3] + SHIFTS[:, None, None] * np.eye(3)).reshape(-1, 3)
        trials = np.rint(with_channels(np.clip(colours, 0.0, fill[3]), 4, fill[3]))
        gaps = np.minimum(_gaps(trials, taken), 2.0 * _gaps(trials, near))
        out.append(trials[int(np.minimum(gaps, APART).argmax())])
        taken = np.vstack([taken, out[-1]])
    return out


def _gaps(trials: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """Return (n,) levels by which trials (n, 4) differ from the nearest of the colours taken (m, 4)."""
    return largest(np.abs(taken[:, None] - trials)).min(axis=0, initial=255.0)


def _few_colours(levels: np.ndarray) -> np.ndarray:
    """Return (n, 4) at most about 4096 of the different whole colours of pixels (m, 4)."""
    codes = np.unique(packed(np.rint(levels)))
    return unpacked(codes[:: max(1, len(codes) // 4096)])
