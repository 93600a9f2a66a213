"""A picture with gradients as one of flat fills: each gradient becomes a fill that stands for it.

Where a gradient and its neighbour share a pixel, the share follows from what the gradient has at that very place; the
same share of the fill that stands for it makes the flat picture's pixel. So whatever comes after, from regions to the
polish, draws gradients as exactly as flat fills, and knows nothing of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import field

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.gradients.areas import gradient_areas
from cubicsplat_cli.artwork.gradients.parts import smooth_parts
from cubicsplat_cli.artwork.gradients.shade import ShadedArea, gradient_of
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import blends, nearest_paints
from cubicsplat_cli.raster.unmix import REACH, SLOTS
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import Gradient, painted

# Levels by which a clean picture's pixel is off all blends of the paints near it where a thin line lies there: half of
# one of 4 x 4 samples a pixel, at full contrast.
LINE = 8.0
WIDER = 5.0  # standard deviations of a blur, by which paints are sought farther
APART = 24.0  # levels between the fills that stand for gradients and all others
LEAST_OPACITY, MOST_CLEAR = 32.0, 240.0  # levels of a fill for a gradient that is translucent somewhere
SHIFTS = (0.0, 24.0, -24.0, 48.0, -48.0, 80.0, -80.0, 120.0, -120.0)


@record
class Flattened:
    """levels: (H, W, 4) the picture in flat fills. fills: (G, 4) levels, whole numbers, those that stand for gradients;
    gradients: what they stand for; areas: where these were found, which may overlap, of a picture with noise.
    """

    levels: np.ndarray
    fills: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    gradients: tuple[Gradient, ...] = ()
    areas: tuple[ShadedArea, ...] = ()

    def gradient(self, fill: np.ndarray) -> Gradient | None:
        """The gradient that a fill (4,) in levels stands for, or None."""
        own = np.flatnonzero((self.fills == np.rint(fill)).all(axis=1))
        return self.gradients[int(own[0])] if len(own) else None

    def painted(self, palette: np.ndarray, labels: np.ndarray) -> np.ndarray:
        """(H, W, 4) levels of labels (H, W) of a palette (P, 4), with the gradients that its fills stand for."""
        out = palette[labels]
        for fill, own in enumerate(palette):
            if (gradient := self.gradient(own)) is not None:
                y, x = np.nonzero(labels == fill)
                out[y, x] = 255.0 * painted(gradient, x + 0.5, y + 0.5)
        return out


def flattened(levels: np.ndarray) -> Flattened:
    """A picture (H, W, 4), premultiplied levels, without its gradients; the same array where it has none."""
    parts, count = smooth_parts(levels)
    return without_areas(levels, parts, gradient_areas(levels, parts, count) if count else [])


def without_areas(
    levels: np.ndarray, parts: np.ndarray, areas: list[ShadedArea], line: float = LINE, blur: float = 0.0
) -> Flattened:
    """A picture (H, W, 4), premultiplied levels, without the gradients of these areas.

    parts: (H, W) int32 numbers from 1 on of what changes evenly, 0 for edges. line: levels by which the pixels of thin
    lines are off all blends of what lies beside them. blur: px, standard deviation of what edges are blurred by.
    """
    if not areas:
        return Flattened(levels)
    shades = list({id(area.shade): area.shade for area in areas}.values())
    gradients = [gradient_of(shade) for shade in shades]
    paint = np.where(parts > 0, parts + len(gradients) - 1, -1).astype(np.int32)
    number = {id(shade): k for k, shade in enumerate(shades)}
    for area in areas:
        paint[area.patch.window][area.patch.mask] = number[id(area.shade)]
    colours = [lambda x, y, own=gradient: 255.0 * painted(own, x + 0.5, y + 0.5) for gradient in gradients]
    fills = _standing_for(levels, paint, gradients)
    out = with_placeholders(levels, paint, colours, fills, line, blur)
    for area in areas:
        if area.ground is not None:
            _fade(out, levels, area, fills[number[id(area.shade)]])
    return Flattened(out, fills, tuple(gradients))


def with_placeholders(
    levels: np.ndarray,
    paint: np.ndarray,
    colours: Sequence[Callable[[np.ndarray, np.ndarray], np.ndarray]],
    fills: np.ndarray,
    line: float = LINE,
    blur: float = 0.0,
) -> np.ndarray:
    """(H, W, 4) levels of a picture with each of its G paints that change replaced by what stands for it.

    paint: (H, W) int32, below G one that changes, from G on what is even, -1 an edge. colours: what each that changes
    has, (n, 4) levels at columns and rows (n,). fills: (G, 4) levels that stand for it. line, blur: as of
    `without_areas`.
    """
    inside = (paint >= 0) & (paint < len(colours))
    out = levels.copy()
    out[inside] = fills[paint[inside]]
    reach = REACH + math.ceil(WIDER * blur)
    near = ndimage.binary_dilation(inside, ndimage.SQUARE, iterations=reach)
    y, x = np.nonzero(near & (paint < 0))
    if len(y) == 0:
        return out
    paints, places = nearest_paints(paint, y * paint.shape[1] + x, reach, SLOTS)
    flats = levels.reshape(-1, 4)[places.ravel()].astype(float)
    # What changes has other colours at the pixel itself than a few px away.
    there = flats.copy()
    order = np.argsort(paints, axis=None, kind="stable")
    ends = np.searchsorted(paints.ravel()[order], np.arange(len(colours) + 1))
    for k in np.flatnonzero(np.diff(ends)).tolist():
        own = order[ends[k] : ends[k + 1]]
        there[own], flats[own] = colours[k](x[own // SLOTS], y[own // SLOTS]), fills[k]
    value, there, flats = levels[y, x], there.reshape(-1, SLOTS, 4), flats.reshape(-1, SLOTS, 4)
    # Where three paints meet a blur blends them over many pixels.
    flat, left = blends(value, paints, there, flats, blur > 0.0)
    # A thin line over a gradient: as much of it as of its strongest pixel near.
    alone = np.flatnonzero((left > line) & (paints[:, 0] >= 0))
    if len(alone):
        size = np.zeros(paint.shape)
        size[y[alone], x[alone]] = largest(np.abs(value[alone] - there[alone, 0]))
        most = ndimage.maximum_filter(size, 2 * REACH + 1)[y[alone], x[alone]]
        share = (size[y[alone], x[alone]] / np.maximum(most, 1e-9))[:, None]
        flat[alone] = value[alone] + (1.0 - share) * (flats[alone, 0] - there[alone, 0])
    out[y, x] = np.clip(flat, 0.0, 255.0)
    return out


def _fade(out: np.ndarray, levels: np.ndarray, area: ShadedArea, fill: np.ndarray) -> None:
    """Draws an edge where a gradient ends without one, along the line at which it does. fill: (4,)
    what stands for the gradient."""
    y, x = area.patch.grown(2, levels.shape).places()
    t = area.shade.t(x + 0.5, y + 0.5)
    distance = (t - area.rim) / np.maximum(np.hypot(*area.shade.slope(x + 0.5, y + 0.5)), 1e-9)
    share = np.clip(0.5 + (-distance if area.inwards else distance), 0.0, 1.0)
    # Pixels of the ground beside the rim, and of the area itself on it.
    ground = largest(np.abs(levels[y, x] - area.ground)) <= 1.5
    own = area.patch.at(y, x)
    at_rim = (share > 0.0) & (share < 1.0) & (own | ground)
    out[y[at_rim], x[at_rim]] = area.ground + share[at_rim, None] * (fill - area.ground)
    # What is left of the ground beyond the rim, and was held for the gradient, is ground.
    beyond = own & (share <= 0.0)
    out[y[beyond], x[beyond]] = area.ground


def _standing_for(levels: np.ndarray, paint: np.ndarray, gradients: list[Gradient]) -> np.ndarray:
    """(G, 4) for each gradient a colour near its mean that no other paint has."""
    count = len(gradients)
    inside = (paint >= 0) & (paint < count)
    sums = [np.bincount(paint[inside], levels[inside][:, k], count) for k in range(4)]
    means = np.stack(sums, axis=1) / np.bincount(paint[inside], minlength=count)[:, None]
    fills = []
    for mean, gradient in zip(means, gradients, strict=True):
        clear = any(stop.colour[3] < 255 for stop in gradient.stops)
        alpha = float(np.clip(mean[3], LEAST_OPACITY, MOST_CLEAR)) if clear else 255.0
        fills.append(np.append(mean[:3] * (alpha / max(mean[3], 1e-9)), alpha))
    return np.array(placeholders(fills, levels[paint >= count]))


def placeholders(fills: list[np.ndarray], levels: np.ndarray) -> list[np.ndarray]:
    """For each fill (4,) one near it that neither pixels (n, 4) have nor another one of these."""
    taken, out = _some_colours(levels), list[np.ndarray]()
    for fill in fills:
        out.append(_placeholder(fill, taken))
        taken = np.vstack([taken, out[-1]])
    return out


def _placeholder(fill: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """(4,) whole levels: the first of some colours near a fill (4,) that is APART from all those taken (n, 4), or the
    one that is farthest from them.
    """
    best, most = fill, -1.0
    for shift in SHIFTS:
        for channel in (0, 1, 2):
            trial = fill.copy()
            trial[channel] += shift
            trial = np.rint(np.append(np.clip(trial[:3], 0.0, fill[3]), fill[3]))
            gap = float(largest(np.abs(taken - trial)).min(initial=255.0))
            if gap > most + 1e-9 and most < APART:
                best, most = trial, gap
    return best


def _some_colours(levels: np.ndarray) -> np.ndarray:
    """(m, 4) the different colours, in whole levels, of pixels (n, 4): all of them or some thousands."""
    codes = np.rint(levels).astype(np.int64) @ (256 ** np.arange(4)[::-1])
    codes = np.unique(codes)
    codes = codes if len(codes) <= 4096 else codes[:: len(codes) // 4096]
    return (codes[:, None] // 256 ** np.arange(4)[::-1] % 256).astype(float)
