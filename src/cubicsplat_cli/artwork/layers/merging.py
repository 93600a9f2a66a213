"""Regions as they are without the translucent overlays that cover them, and the paint of these.

An overlay of paint F and opacity a shows C = a F + (1 - a) G over a fill G. Two grounds say both, as C1 - C2 is
(1 - a)(G1 - G2) in all channels (Metelli 1974, "The perception of transparency"); premultiplied ones, so that opacity
is a channel like the others.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import permutations

import numpy as np

from cubicsplat_cli.artwork.channels import FULL, widened
from cubicsplat_cli.artwork.regions.fills import APART, ROUNDED, SEEN
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.sparse import linked_groups
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import Rgba

MOST_BESIDE = 5  # overlays beside a region that several of them may make
_OPACITIES = np.arange(5, 251)  # of 8 bits: 0.02 to 0.98


@record
class Overlay:
    """paint: of a translucent shape, sRGB and opacity. cover: (H, W) bool, the pixels that show it."""

    paint: Rgba
    cover: np.ndarray


def merged(regions: Regions, grounds: dict[int, int], fixed: np.ndarray) -> tuple[Regions, np.ndarray]:
    """The regions with some joined to those that lie beneath them (covered: beneath), and which of them are fixed."""
    under = np.arange(regions.count)
    under[list(grounds)] = list(grounds.values())
    fill, first, second = regions.fill_of[under], regions.borders.first, regions.borders.second
    joined = (fill[first] == fill[second]) & np.isin(first, list(grounds))
    count, name = linked_groups(regions.count, first[joined], second[joined])
    fills, fill_of, stays = np.zeros((count, 4)), np.zeros(count, dtype=fill.dtype), np.zeros(count, dtype=bool)
    fills[name], fill_of[name], stays[name] = regions.fills[under], fill, fixed
    return Regions(name[regions.labels].astype(np.int32), fills, fill_of), stays


def with_covered(
    regions: Regions, fixed: np.ndarray, overlays: list[Overlay]
) -> tuple[Regions, np.ndarray, list[Overlay]]:
    """The regions without those that overlays make of a neighbour, which of them are fixed, and the overlays, uppermost
    first, that cover these as well.

    What lies beneath one overlay only where another one lies too meets it in no X of its own.
    """
    while found := next(_covered(regions, fixed, overlays), None):
        region, ground, over = found
        mask = regions.labels == region
        overlays = [replace(s, cover=s.cover | mask) if s in over else s for s in _ordered(overlays, over)]
        regions, fixed = merged(regions, {region: ground}, fixed)
    return regions, fixed, overlays


def _covered(
    regions: Regions, fixed: np.ndarray, overlays: list[Overlay]
) -> Iterator[tuple[int, int, tuple[Overlay, ...]]]:
    """Yield each region that overlays make of a neighbour, that neighbour, and these overlays, uppermost first. They
    touch the region and cover nothing of it.
    """
    boxes = ndimage.find_objects(regions.labels + 1)
    for region in np.flatnonzero(~fixed).tolist():
        window = widened(boxes[region], 1, regions.labels.shape)
        mask = regions.labels[window] == region
        rim = ndimage.binary_dilation(mask) & ~mask
        beside = [s for s in overlays if s.cover[window][rim].any() and not s.cover[window][mask].any()]
        if 0 < len(beside) <= MOST_BESIDE:
            for ground in (k for k in regions.borders.beside[region] if not fixed[k]):
                if over := _over(overlays, beside, regions.fills[region], regions.fills[ground]):
                    yield region, ground, over


def _over(overlays: list[Overlay], beside: list[Overlay], fill: np.ndarray, under: np.ndarray) -> tuple[Overlay, ...]:
    """Those of some overlays beside each other that make a fill of one beneath, uppermost first; () without such."""
    of, left, added = _orders(tuple(each.paint for each in beside))
    off = np.abs(added + left[:, None] * under - fill).max(axis=1)
    for k in np.flatnonzero(off <= ROUNDED).tolist():
        some = tuple(beside[i] for i in of[k])
        # Many overlays make the same of anything: each must change it.
        paints = [each.paint for each in some]
        fewer = [_through(paints[:i] + paints[i + 1 :], under) for i in range(len(paints))]
        if min(np.abs(other - fill).max() for other in fewer) >= SEEN and _ordered(overlays, some):
            return some
    return ()


@lru_cache(maxsize=256)  # of the same paints it is asked often
def _orders(paints: tuple[Rgba, ...]) -> tuple[list[tuple[int, ...]], np.ndarray, np.ndarray]:
    """Choices of overlays, some or all and in each order, since they were seen to overlap nowhere: the numbers of each,
    uppermost first; the share (n,) of a ground that they leave, and the levels (n, 4) that they add.
    """
    of = [some for count in range(1, len(paints) + 1) for some in permutations(range(len(paints)), count)]
    left = np.array([math.prod(1.0 - paints[i][3] / FULL for i in some) for some in of])
    return of, left, np.array([_through([paints[i] for i in some], np.zeros(4)) for some in of])


def _through(some: Sequence[Rgba], fill: np.ndarray) -> np.ndarray:
    """(4,) levels of what paints, uppermost first, make of a fill."""
    for paint in reversed(some):
        fill = laid_over(paint, fill)
    return fill


def _ordered(overlays: list[Overlay], some: tuple[Overlay, ...]) -> list[Overlay]:
    """The overlays, uppermost first, with some of them in this order and those that overlap in the order that they
    have; empty where that cannot be.
    """
    left, out = list(overlays), []
    while left:
        free = [
            each
            for k, each in enumerate(left)
            if not any((other.cover & each.cover).any() for other in left[:k])
            and not any(other in left for other in some[: some.index(each) if each in some else 0])
        ]
        if not free:
            return []
        out.append(free[0])
        left.remove(free[0])
    return out


def laid_over(paint: Rgba, grounds: np.ndarray) -> np.ndarray:
    """Premultiplied levels of what a paint makes of grounds, both (..., 4)."""
    return paint_levels(paint) + (1.0 - paint[3] / FULL) * grounds


def paint_levels(paint: Rgba) -> np.ndarray:
    """(4,) premultiplied levels of a paint."""
    return np.array([*(v * paint[3] / FULL for v in paint[:3]), float(paint[3])])


def paint_of(seen: np.ndarray, grounds: np.ndarray) -> Rgba | None:
    """The paint that makes `seen` (n, 4) of `grounds` (n, 4), premultiplied levels, n >= 2, by least squares over all
    opacities of 8 bits; None where none does, or where the grounds are too much alike to tell.
    """
    if np.ptp(grounds, axis=0).max() < APART or np.ptp(seen, axis=0).max() < SEEN:
        return None
    opacity = _OPACITIES[:, None] / FULL
    rest = seen - (1.0 - opacity)[:, None] * grounds
    colours = np.clip(np.rint((rest.mean(axis=1) / opacity)[:, :3]), 0.0, FULL)
    made = np.concatenate([colours * opacity, FULL * opacity], axis=1)
    off = np.abs(rest - made[:, None])
    k = int((off**2).sum(axis=(1, 2)).argmin())
    if off[k].max() > ROUNDED:
        return None
    r, g, b = (int(v) for v in colours[k])
    return r, g, b, int(_OPACITIES[k])


def likeliest(seen: np.ndarray, grounds: np.ndarray) -> Rgba:
    """Of the fills that make what is `seen` (n, 4) of `grounds` (n, 4) the likeliest one: that with which a drawing
    program gets the very same numbers, at an opacity in whole twentieths, black or white.

    Programs round what an opacity leaves of a ground to the nearest number, or, as (v + 255) >> 8, mostly up; what they
    were given follows from what they made only by trying. Of a faint paint many colours make the same.
    """
    found, colours = list[tuple[tuple[float, bool, bool, float], Rgba]](), np.arange(int(FULL) + 1)
    for opacity in _OPACITIES.tolist():
        through = grounds * (FULL - opacity)
        over = np.rint(colours * opacity / FULL)[:, None, None]
        for left in (np.rint(through / FULL), np.floor((through + FULL) / (FULL + 1.0))):
            off = np.abs(seen[:, :3] - left[:, :3] - over).sum(axis=1)
            clear = np.abs(seen[:, 3] - left[:, 3] - opacity).sum()
            least = off.min(axis=0)
            plain = [v for v in (0, int(FULL)) if (off[v] == least).all()]
            mean = (seen - grounds * (1.0 - opacity / FULL)).mean(axis=0)[:3] * FULL / opacity
            tied = np.where(off == least, np.abs(colours[:, None] - mean), np.inf)
            chosen = [plain[0]] * 3 if plain else tied.argmin(axis=0).tolist()
            paint = chosen[0], chosen[1], chosen[2], opacity
            misfit = float(((seen - laid_over(paint, grounds)) ** 2).sum())
            whole = abs(opacity - FULL * round(20.0 * opacity / FULL) / 20.0) <= 0.5
            found.append(((float(least.sum() + clear), not whole, not plain, misfit), paint))
    return min(found, key=lambda each: each[0])[1]
