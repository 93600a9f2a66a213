"""Regions as they are without the translucent sheets that cover them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.artwork.translucent.paint import LEAST_SEEN, ROUNDED, Paint
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.graphs import linked_groups

MOST_BESIDE = 5  # sheets beside a region that several of them may make


@dataclass(frozen=True, eq=False)
class Sheet:
    """paint: of a translucent shape. cover: (H, W) bool, the pixels that show it."""

    paint: Paint
    cover: np.ndarray


def merged(regions: Regions, grounds: dict[int, int], fixed: np.ndarray) -> tuple[Regions, np.ndarray]:
    """The regions with some joined to what lies beneath them (region that is covered: region beneath it), and which of
    them are fixed.
    """
    ink = regions.ink_of.copy()
    for covered, ground in grounds.items():
        ink[covered] = regions.ink_of[ground]
    labels = regions.labels
    joined = [(a, b) for a, b in _touching(labels) if ink[a] == ink[b] and (a in grounds or b in grounds)]
    rows, columns = (np.array([pair[i] for pair in joined], dtype=int) for i in (0, 1))
    count, name = linked_groups(regions.count, rows, columns)
    inks, ink_of, stays = np.zeros((count, 4)), np.zeros(count, dtype=ink.dtype), np.zeros(count, dtype=bool)
    under = np.arange(regions.count)
    under[list(grounds)] = list(grounds.values())
    inks[name], ink_of[name], stays[name] = regions.inks[under], ink, fixed
    return Regions(name[labels].astype(np.int32), inks, ink_of), stays


def _touching(labels: np.ndarray) -> list[tuple[int, int]]:
    """The pairs of different regions with a common edge, ascending, each one once or twice."""
    found: set[tuple[int, int]] = set()
    for a, b in ((labels[1:], labels[:-1]), (labels[:, 1:], labels[:, :-1])):
        edge = a != b
        found |= set(zip(a[edge].tolist(), b[edge].tolist(), strict=True))
    return sorted(found)


def with_covered(regions: Regions, fixed: np.ndarray, sheets: list[Sheet]) -> tuple[Regions, np.ndarray, list[Sheet]]:
    """The regions without those that sheets make of a neighbour, which of them are fixed, and the sheets, uppermost
    first, that cover these as well.

    What lies beneath one sheet only where another one lies too meets it in no X of its own.
    """
    left = True
    while sheets and left:
        left = False
        for above, below in (pair for a, b in _touching(regions.labels) for pair in ((a, b), (b, a))):
            over = () if fixed[[above, below]].any() else _over(regions, sheets, above, below)
            if over:
                mask = regions.labels == above
                sheets = [replace(s, cover=s.cover | mask) if s in over else s for s in _ordered(sheets, over)]
                regions, fixed = merged(regions, {above: below}, fixed)
                left = True
                break
    return regions, fixed, sheets


def _over(regions: Regions, sheets: list[Sheet], region: int, ground: int) -> tuple[Sheet, ...]:
    """The sheets beside a region that make its colour of another one's, uppermost first; () where none do."""
    rows, columns = ndimage.find_objects((regions.labels == region).astype(np.uint8))[0]
    window = tuple(slice(max(side.start - 1, 0), side.stop + 1) for side in (rows, columns))
    mask = regions.labels[window] == region
    rim = ndimage.binary_dilation(mask) & ~mask
    beside = [s for s in sheets if s.cover[window][rim].any() and not s.cover[window][mask].any()]
    if len(beside) > MOST_BESIDE:
        return ()
    ink, under = regions.inks[region], regions.inks[ground]
    for count in range(1, len(beside) + 1):
        # Sheets that were seen to overlap nowhere may lie over each other in either order.
        for some in permutations(beside, count):
            if np.abs(_through(some, under) - ink).max() > ROUNDED:
                continue
            # Many sheets make the same of anything: each must change it.
            fewer = [_through(some[:k] + some[k + 1 :], under) for k in range(count)]
            if min(np.abs(other - ink).max() for other in fewer) >= LEAST_SEEN and _ordered(sheets, some):
                return some
    return ()


def _through(some: tuple[Sheet, ...], ink: np.ndarray) -> np.ndarray:
    """(4,) levels of what sheets, uppermost first, make of an ink."""
    for each in reversed(some):
        ink = each.paint.over(ink[None])[0]
    return ink


def _ordered(sheets: list[Sheet], some: tuple[Sheet, ...]) -> list[Sheet]:
    """The sheets, uppermost first, with some of them in this order and those that overlap in the order that they have;
    empty where that cannot be.
    """
    left, out = list(sheets), []
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
