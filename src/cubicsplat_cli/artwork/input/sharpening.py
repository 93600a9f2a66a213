"""Undo the sharpening of a picture, which leaves halos along its edges.

Programs reduce pictures by Lanczos' filter or a cubic one, whose negative lobes overshoot at edges, or sharpen them by
an unsharp mask. A halo is lighter than the lighter side of an edge, or darker than the darker one, by a share of their
contrast. Lanczos' filter hardly changes pixels on the edge itself, so its halos are taken off and these stay. An
unsharp mask does, so it is undone.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.input.condition import ROUGH, rippled
from cubicsplat_cli.artwork.input.linear_light import blended_in_light, in_light
from cubicsplat_cli.artwork.regions.sampling import CONTRAST, EXAMINED
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import second_differences, spread

REACH = 5  # px from an edge, where Lanczos' filter of three lobes rings no more
FLAT = 2.0  # levels within 3 x 3 px of a fill of one colour, at most: rounding, and the third lobe
LEAST = 0.1  # of 3 x 3 pixels, less than one: none is known
HALO = 0.02  # of the contrast: rounding and gradients make less at CONTRAST levels
MOST = 0.15  # of the contrast: what differs more from both sides of an edge is a shape between them
BEYOND = 0.5  # of the contrast: no filter overshoots by as much in any channel, even of linear light in the dark
RIPPLE = 0.05  # of the contrast: the second lobes of Lanczos' filter, within the range of both sides, make 0.02 each
FEWEST = 32  # sides of edges that tell a filter
WINDOW = 128  # px of the part of a picture in which an unsharp mask is estimated
# Amounts, and px of radius. A narrower mask is like the filters that reduce pictures; a stronger or wider one flattens
# any picture.
WEAKEST, STRONGEST, NARROWEST, WIDEST = 0.2, 3.0, 0.8, 3.5
LEAST_BEND = 0.5  # amount times squared radius in px of a narrow mask, which tells it; Lanczos' filter has at most 0.4
# Of the pixels that are not flat, or of the logarithms of the misfits of profiles, at least so large a share goes with
# a mask; reduction by Lanczos' filter leaves 0.05.
LEAST_GAIN = 0.06
SIDE = 7  # px of a profile on each side of its edge: a mask of 2 px changes nothing beyond
PLACES = np.linspace(-0.6, 0.6, 13)  # px of an edge from the middle of its profile
EDGE_NOISE = 5.0  # levels by which pixels near edges are off in JPEGs of usual quality
UNTOLD = 0.01  # weight of a pixel that is cut off at an end of the scale, where a JPEG keeps it apart by a few levels


class UnsharpMask(NamedTuple):
    """A mask that adds to a picture `amount` times what a Gaussian blur of `radius` px takes away from it; noise:
    levels by which pixels are off after it.
    """

    amount: float
    radius: float
    noise: float = 0.0

    def of(self, levels: np.ndarray) -> np.ndarray:
        """Return a picture (H, W, 4) in 0..255 sharpened."""
        soft = ndimage.gaussian_filter(levels, (self.radius, self.radius, 0.0), mode="nearest", truncate=3.0)
        return np.clip(levels + self.amount * (levels - soft), 0.0, 255.0)

    @property
    def likely(self) -> bool:
        """True for the masks that programs apply, but for those that are like the filters that reduce pictures."""
        broad = self.radius >= NARROWEST or self.amount * self.radius**2 >= LEAST_BEND
        return WEAKEST <= self.amount <= STRONGEST and self.radius <= WIDEST and broad

    def undone(self, levels: np.ndarray, passes: int = 3) -> np.ndarray:
        """Return the picture (H, W, 4) in 0..255 that the mask turns into the given one, by Richardson's iteration.

        Where halos were cut off at an end of the scale, many pictures are possible. The iteration starts from one
        without halos, which it finds better with each pass.
        """
        size = 2 * math.ceil(2.0 * self.radius) + 1
        highest = 0.5 * self.amount * ndimage.ranges(levels, (size, size, 1))  # of a halo along a straight edge
        # The mask has eigenvalues from 1 to 1 + amount, so each step leaves amount / (2 + amount) of the error.
        steps = math.ceil(6.0 / math.log(1.0 + 2.0 / self.amount))
        found = levels
        for _ in range(passes):
            low, high = _range_of(found, _even(found, ROUGH + 2.0 * self.noise), size + 4)
            clipped = np.clip(levels, low, high)
            found = np.where(np.abs(clipped - levels) <= highest, clipped, levels)
            for _ in range(steps):
                sharp = self.of(found)
                off = levels - sharp
                off[((sharp <= 0.0) | (sharp >= 255.0)) & (np.abs(off) <= self.noise)] = 0.0
                found = np.clip(found + off * (2.0 / (2.0 + self.amount)), 0.0, 255.0)
        return found


def unsharp_mask(levels: np.ndarray, *, lossy: bool = False) -> UnsharpMask | None:
    """Return the unsharp mask by which an opaque picture (H, W, 4) in 0..255 was sharpened; None for none.

    It is the one without which most pixels are flat. A weaker one leaves halos, and a stronger one blurs edges. In a
    picture that was compressed with loss no pixels are flat. Its mask is the likeliest by the profiles of its edges.
    """
    if levels[..., 3].min() < 255.0:
        return None
    if lossy or rippled(levels):
        mask, gain = _likeliest(_profiles(levels, levels))
        if mask:
            # Halos of near edges overlap. Without them more profiles are even at their ends.
            mask, gain = _likeliest(_profiles(levels, mask.undone(levels, passes=1)))
    else:
        window = _busiest(levels)
        mask, gain = _best(lambda mask: _rough(mask.undone(window, passes=1)), _rough(window))
    return mask if mask and mask.likely and gain >= LEAST_GAIN else None


def _best(cost: Callable[[UnsharpMask], float], unmasked: float) -> tuple[UnsharpMask | None, float]:
    """Return the unsharp mask of least cost, and by what share that is lower than without one; None, 0 if it is not."""

    def of(logarithms: np.ndarray) -> float:
        return cost(UnsharpMask(*np.exp(logarithms).tolist()))

    starts = np.log([*itertools.product((0.4, 1.2), (1.0, 2.0, 3.2))])  # amounts and px of radius
    costs = [of(start) for start in starts]
    if min(costs) >= unmasked:
        return None, 0.0
    from scipy.optimize import minimize

    bounds = np.log([(0.5 * WEAKEST, 1.5 * STRONGEST), (0.7 * NARROWEST, 1.5 * WIDEST)])
    start = starts[np.argmin(costs)]
    around = np.add(start, [[0.0, 0.0], [0.3, 0.0], [0.0, 0.3]])
    options = {"initial_simplex": around, "xatol": 0.03, "fatol": 1e-3 * unmasked}
    found = minimize(of, start, method="Nelder-Mead", bounds=bounds, options=options)
    return UnsharpMask(*np.exp(found.x).tolist()), 1.0 - found.fun / unmasked


def _profiles(levels: np.ndarray, plain: np.ndarray) -> np.ndarray:
    """Return profiles (n, 2 * SIDE + 1) of a picture (H, W, 4) across straight edges that are nearly upright or level,
    at most 600, rising; by a picture with fewer halos (H, W, 4), in which they are even at their ends: pixels there
    differ by 0.08 of the contrast at most, and the rows beside a profile by 0.6.
    """
    reach, found = np.arange(-SIDE, SIDE + 1), list[np.ndarray]()
    for values, even in zip(_lines_of(levels[..., :3]), _lines_of(plain[..., :3]), strict=True):
        slopes = np.abs(even[:, 2:] - even[:, :-2])
        y, x = np.nonzero(slopes[1:-1, SIDE - 1 : 1 - SIDE] >= 0.5 * CONTRAST)
        few = slice(None, None, 1 + len(y) // EXAMINED)
        y, x = y[few, None] + 1, x[few, None] + SIDE
        lines, steep = even[y, x + reach], slopes[y, x + np.arange(-2, 1)]
        contrast = np.abs(lines[:, -2:].mean(axis=1) - lines[:, :2].mean(axis=1))
        told = (contrast >= CONTRAST) & (steep[:, 1] > steep[:, 0]) & (steep[:, 1] >= steep[:, 2])
        told &= np.abs(even[y - 1, x + reach] - even[y + 1, x + reach]).max(axis=1) <= 0.6 * contrast
        told &= np.abs(np.diff(lines, axis=1)[:, [0, 1, -2, -1]]).max(axis=1) <= 0.08 * contrast
        lines = values[y, x + reach][told]
        found.append(np.where(lines[:, :1] > lines[:, -1:], lines[:, ::-1], lines))
    profiles = np.concatenate(found)
    return profiles[:: 1 + len(profiles) // 600].astype(np.float64)


def _lines_of(levels: np.ndarray) -> list[np.ndarray]:
    """Return the channels of a picture (H, W, C), each by its rows and by its columns."""
    return [lines for channel in np.moveaxis(levels, 2, 0) for lines in (channel, channel.T)]


def _likeliest(profiles: np.ndarray) -> tuple[UnsharpMask | None, float]:
    """Return the unsharp mask that best explains profiles (n, 2 * SIDE + 1) of edges, as `_best` does."""
    if len(profiles) < FEWEST:
        return None, 0.0

    def unlikely(mask: UnsharpMask) -> float:
        return float(np.log1p(_misfits(profiles, mask) / EDGE_NOISE**2).mean())

    mask, gain = _best(unlikely, unlikely(UnsharpMask(0.0, 1.0)))
    return mask and mask._replace(noise=EDGE_NOISE), gain


def _misfits(profiles: np.ndarray, mask: UnsharpMask) -> np.ndarray:
    """Return the mean squares (n,), in levels, of what the nearest edges under a mask leave of profiles (n, 2 * SIDE +
    1). An edge is a ramp of a pixel between two levels, and is cut off at the ends of the scale.
    """
    at = np.arange(-3 * SIDE, 3 * SIDE + 1) - PLACES[:, None]
    ramps = np.clip(at + 0.5, 0.0, 1.0)
    soft = ndimage.gaussian_filter(ramps.astype(np.float32), (0.0, mask.radius), mode="nearest", truncate=3.0)
    light = (ramps + mask.amount * (ramps - soft))[:, 2 * SIDE : -2 * SIDE]
    shares = np.stack([1.0 - light, light], axis=1)  # (places, 2, pixels), of both levels
    ends = np.stack([profiles[:, :2].mean(axis=1), profiles[:, -2:].mean(axis=1)], axis=1)
    sides = np.broadcast_to(ends[:, None], (len(profiles), len(PLACES), 2))
    for _ in range(2):  # Gauss-Newton
        drawn = np.einsum("ncs,csp->ncp", sides, shares)
        weights = np.where((drawn > 0.0) & (drawn < 255.0), 1.0, UNTOLD)
        normal = np.einsum("ncp,csp,ctp->ncst", weights, shares, shares)
        toward = np.einsum("ncp,csp,ncp->ncs", weights, shares, profiles[:, None] - np.clip(drawn, 0.0, 255.0))
        sides = np.clip(sides + np.linalg.solve(normal + UNTOLD * np.eye(2), toward[..., None])[..., 0], 0.0, 255.0)
    drawn = np.clip(np.einsum("ncs,csp->ncp", sides, shares), 0.0, 255.0)
    return np.square(profiles[:, None] - drawn).mean(axis=2).min(axis=1)


def _busiest(levels: np.ndarray) -> np.ndarray:
    """Return the part of a picture, at most WINDOW px wide and high, with the most edges."""
    busy = ndimage.uniform_filter((second_differences(levels) > ROUGH).astype(np.float32), WINDOW)
    y, x = (max(0, int(at) - WINDOW // 2) for at in np.unravel_index(busy.argmax(), busy.shape))
    return np.ascontiguousarray(levels[y : y + WINDOW, x : x + WINDOW])


def _rough(levels: np.ndarray) -> float:
    """Return the number of pixels that are not flat, where a difference of ROUGH levels counts half."""
    squares = np.square(spread(levels, 3, 3), dtype=np.float64)
    return float((squares / (squares + ROUGH**2)).sum())


def _even(levels: np.ndarray, most: float) -> np.ndarray:
    """Return (H, W) bool: pixels away from edges and halos, where second differences are at most so many levels."""
    return ndimage.maximum_filter(second_differences(levels), 3) <= most


def _range_of(levels: np.ndarray, even: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the largest value of even pixels in odd windows around each pixel, inf and -inf for none."""
    low, high = (np.where(even[..., None], levels, np.float32(none)) for none in (np.inf, -np.inf))
    return ndimage.minimum_filter(low, (size, size, 1)), ndimage.maximum_filter(high, (size, size, 1))


def without_halos(levels: np.ndarray) -> np.ndarray:
    """Return a picture (H, W, 4) premultiplied RGBA in 0..255 without halos; the same array if it has none.

    Halos are clipped to the range of the even pixels around. Within that range, pixels that are nearly like the flat
    pixels on their side of an edge become like these. Halos beside steep gradients are within the range of these, so a
    picture with mostly steep ones stays. So does one that was compressed with loss, whose ringing looks like halos.

    A picture was filtered as linear light if without such halos its edges are blended so. Its halos and second lobes
    are the wider in the dark.
    """
    axes = levels, levels.swapaxes(0, 1)
    for looking in (False, True):  # at what lies beside edges, where these seem to have halos
        edges = [each for axis in axes for each in _edges(axis, looking)]
        sharpened = _sharpened(edges)
        if not (sharpened or _sharpened(each._replace(lines=in_light(each.lines)) for each in edges)):
            return levels
    if rippled(levels):
        return levels
    even, flat = _even(levels, ROUGH), spread(levels, 3, 3) <= FLAT
    if flat[even].sum() <= 0.5 * even.sum():
        return levels
    of_light = np.rint(_without_halos(levels, even, flat, light=True))
    if blended_in_light(of_light):
        return of_light
    return _without_halos(levels, even, flat, light=False) if sharpened else levels


def _without_halos(levels: np.ndarray, even: np.ndarray, flat: np.ndarray, light: bool) -> np.ndarray:
    """Return a picture (H, W, 4) without the halos that a filter left in it, of linear light if `light`. even, flat:
    (H, W) bool, its pixels away from edges, and those of one colour.
    """
    known, filtered = flat[..., None], _filtered(levels, light)
    low, high = _range_of(levels, even, 2 * REACH + 1)
    clipped = np.clip(levels, low, high)
    most = MOST * (_filtered(high, light) - _filtered(low, light))
    clipped = np.where(np.abs(_filtered(clipped, light) - filtered) <= most, clipped, levels)
    side = np.where(known, clipped, np.float32(0.0))
    for _ in range(REACH):
        weight = ndimage.uniform_filter(known.astype(np.float32), (3, 3, 1), mode="nearest")
        mean = ndimage.uniform_filter(side, (3, 3, 1), mode="nearest") / np.maximum(weight, LEAST)
        side, known = np.where(known | (weight < LEAST), side, mean), known | (weight >= LEAST)
    contrast = ndimage.ranges(filtered, (2 * REACH + 1, 2 * REACH + 1, 1))
    off = np.abs(_filtered(clipped, light) - _filtered(side, light))
    found = np.where(known & (off <= RIPPLE * contrast), side, clipped).astype(np.float32)
    found[..., :3] = np.minimum(found[..., :3], found[..., 3:])  # premultiplied
    return found


def _filtered(levels: np.ndarray, light: bool) -> np.ndarray:
    """Return levels (H, W, 4) as a filter saw them: their colours as linear light if `light`."""
    if not light:
        return levels
    seen = np.clip(levels, 0.0, 255.0)  # where no pixel is even its range is not finite
    seen[..., :3] = in_light(seen[..., :3])
    return seen


def _edges(levels: np.ndarray, looking: bool) -> list[_Edges]:
    """Return the edges along the rows of each channel of a picture (H, W, C); looking: at what lies beside them."""
    beyond = _beyond(levels) if looking else np.zeros((len(levels), max(levels.shape[1] - 2 * REACH, 0)), dtype=bool)
    return [_Edges.of(values, beyond) for values in np.moveaxis(levels, 2, 0)]


def _beyond(levels: np.ndarray) -> np.ndarray:
    """Return (H, W - 2 * REACH) bool: from which pixels on, of a row, some channel differs from both of its ends by
    more than a halo."""
    size, ends = (1, 2 * REACH + 1, 1), np.stack([levels[:, : -2 * REACH], levels[:, 2 * REACH :]])
    low, high = ends.min(axis=0), ends.max(axis=0)
    least, most = (each(levels, size)[:, REACH:-REACH] for each in (ndimage.minimum_filter, ndimage.maximum_filter))
    return np.asarray(largest(np.maximum(low - least, most - high)) > BEYOND * largest(high - low))


class _Edges(NamedTuple):
    """lines: (n, 2 * REACH + 1) the values of a channel across edges, rising; beyond: (n,) bool, where some channel
    differs from both sides by more than a halo, as an outline between two fills does."""

    lines: np.ndarray
    beyond: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray, beyond: np.ndarray) -> _Edges:
        """Return the edges along the rows of a channel (H, W). beyond: (H, W - 2 * REACH) bool."""
        steps = np.abs(values[:, REACH + 1 : 1 - REACH] - values[:, REACH - 1 : -REACH - 1])
        y, x = np.nonzero(steps >= 0.5 * CONTRAST)
        lines = values[y[:, None], x[:, None] + np.arange(2 * REACH + 1)].astype(np.float64)
        falling = lines[:, 0] > lines[:, -1]
        lines[falling] = lines[falling, ::-1]
        even = np.abs(np.diff(lines, axis=1)[:, [0, -1]]).max(axis=1) <= ROUGH
        told = even & (lines[:, -2:].mean(axis=1) - lines[:, :2].mean(axis=1) >= CONTRAST)
        return cls(lines[told], beyond[y, x][told])


def _sharpened(edges: Iterable[_Edges]) -> bool:
    """Return True if at least half of the edges of all channels have halos, on their light sides and on their dark
    ones. What differs by more lies beside the edge, as letters do.
    """
    sides = [np.concatenate(found) for found in zip(*map(_halos, edges), strict=True)]
    told = [halos for halos in sides if len(halos) >= FEWEST]
    return bool(told) and all(((halos > HALO) & (halos <= MOST)).mean() >= 0.5 for halos in told)


def _halos(given: _Edges) -> tuple[np.ndarray, np.ndarray]:
    """Return the sizes of the halos on the light (n,) and dark (m,) sides of edges, over the contrast, inf where
    something lies beside these. Sides too near to an end of the scale, where a halo was cut off, do not count.
    """
    edges, beyond = given
    dark, light = edges[:, :2].mean(axis=1), edges[:, -2:].mean(axis=1)
    contrast, half = light - dark, 0.5 * (light + dark)
    # The pixel in the middle holds the point half of the way.
    middle = (edges[:, REACH - 1] < half) & (edges[:, REACH] >= half)
    room = light + MOST * contrast <= 255.0, dark - MOST * contrast >= 0.0
    sides = (middle & room[0], -edges[:, ::-1]), (middle & room[1], edges)
    near, found = np.arange(2, REACH), []
    for told, side in sides:
        own = side[told]
        # A side is a straight line through its far pixels: a soft shadow is darkest at the edge, too.
        line = own[:, :1] + (own[:, 2:3] - own[:, :1]) / 2.0 * near
        sizes = (line - own[:, near]).max(axis=1) / contrast[told]
        found.append(np.where(beyond[told], np.inf, sizes))
    return found[0], found[1]
