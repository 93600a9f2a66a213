"""Regions as they are without the translucent overlays that cover them."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.artwork.translucent.paint import LEAST_SEEN, ROUNDED, Paint
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.graphs import linked_groups
from cubicsplat_cli.records import dataclass, replace

MOST_BESIDE = 5  # overlays beside a region that several of them may make


@dataclass(frozen=True, eq=False)
class Overlay:
    """paint: of a translucent shape. cover: (H, W) bool, the pixels that show it."""

    paint: Paint
    cover: np.ndarray


def merged(regions: Regions, grounds: dict[int, int], fixed: np.ndarray) -> tuple[Regions, np.ndarray]:
    """The regions with some joined to what lies beneath them (region that is covered: region beneath it), and which of
    them are fixed.
    """
    fill = regions.fill_of.copy()
    for covered, ground in grounds.items():
        fill[covered] = regions.fill_of[ground]
    labels = regions.labels
    joined = [(a, b) for a, b in _touching(labels) if fill[a] == fill[b] and (a in grounds or b in grounds)]
    rows, columns = (np.array([pair[i] for pair in joined], dtype=int) for i in (0, 1))
    count, name = linked_groups(regions.count, rows, columns)
    fills, fill_of, stays = np.zeros((count, 4)), np.zeros(count, dtype=fill.dtype), np.zeros(count, dtype=bool)
    under = np.arange(regions.count)
    under[list(grounds)] = list(grounds.values())
    fills[name], fill_of[name], stays[name] = regions.fills[under], fill, fixed
    return Regions(name[labels].astype(np.int32), fills, fill_of), stays


def _touching(labels: np.ndarray) -> list[tuple[int, int]]:
    """The pairs of different regions with a common edge, ascending, each one once or twice."""
    found: set[tuple[int, int]] = set()
    for a, b in ((labels[1:], labels[:-1]), (labels[:, 1:], labels[:, :-1])):
        edge = a != b
        found |= set(zip(a[edge].tolist(), b[edge].tolist(), strict=True))
    return sorted(found)


def with_covered(
    regions: Regions, fixed: np.ndarray, overlays: list[Overlay]
) -> tuple[Regions, np.ndarray, list[Overlay]]:
    """The regions without those that overlays make of a neighbour, which of them are fixed, and the overlays, uppermost
    first, that cover these as well.

    What lies beneath one overlay only where another one lies too meets it in no X of its own.
    """
    left = True
    while overlays and left:
        left = False
        for above, below in (pair for a, b in _touching(regions.labels) for pair in ((a, b), (b, a))):
            over = () if fixed[[above, below]].any() else _over(regions, overlays, above, below)
            if over:
                mask = regions.labels == above
                overlays = [replace(s, cover=s.cover | mask) if s in over else s for s in _ordered(overlays, over)]
                regions, fixed = merged(regions, {above: below}, fixed)
                left = True
                break
    return regions, fixed, overlays


def _over(regions: Regions, overlays: list[Overlay], region: int, ground: int) -> tuple[Overlay, ...]:
    """The overlays beside a region that make its colour of another one's, uppermost first; () where none do."""
    rows, columns = ndimage.find_objects((regions.labels == region).astype(np.uint8))[0]
    window = tuple(slice(max(side.start - 1, 0), side.stop + 1) for side in (rows, columns))
    mask = regions.labels[window] == region
    rim = ndimage.binary_dilation(mask) & ~mask
    beside = [s for s in overlays if s.cover[window][rim].any() and not s.cover[window][mask].any()]
    if len(beside) > MOST_BESIDE:
        return ()
    fill, under = regions.fills[region], regions.fills[ground]
    for count in range(1, len(beside) + 1):
        # Overlays that were seen to overlap nowhere may lie over each other in either order.
        for some in permutations(beside, count):
            if np.abs(_through(some, under) - fill).max() > ROUNDED:
                continue
            # Many overlays make the same of anything: each must change it.
            fewer = [_through(some[:k] + some[k + 1 :], under) for k in range(count)]
            if min(np.abs(other - fill).max() for other in fewer) >= LEAST_SEEN and _ordered(overlays, some):
                return some
    return ()


def _through(some: tuple[Overlay, ...], fill: np.ndarray) -> np.ndarray:
    """(4,) levels of what overlays, uppermost first, make of a fill."""
    for each in reversed(some):
        fill = each.paint.over(fill[None])[0]
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
