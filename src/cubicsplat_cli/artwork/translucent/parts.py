"""The parts of a drawing back to front: those of its layers, with translucent overlays above what shows through them.

The regions C1 and C2 that an overlay makes of its grounds G1 and G2 meet these in an X: there the overlay's edge, from
G1 | C1 to G2 | C2, crosses the grounds' edge, from G1 | G2 to C1 | C2. All that an overlay covers must follow from one
paint. Without it C1 and G1 are one region, and the next overlay beneath it can be found.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.layers.extents import OPAQUE, Extent, extents, extents_of
from cubicsplat_cli.artwork.layers.stacking import Stack, stack
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.artwork.tracing.contours import EdgePositions
from cubicsplat_cli.artwork.translucent.meetings import goes_on, meetings
from cubicsplat_cli.artwork.translucent.merging import Overlay, merged, with_covered
from cubicsplat_cli.artwork.translucent.paint import Paint, likeliest, paint_of
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.records import dataclass, replace

MOST_OVERLAYS = 64


@dataclass(frozen=True)
class TranslucentPart:
    """fill: (4,) premultiplied levels. extent: how far the part reaches."""

    fill: np.ndarray
    extent: Extent


def parts_of(regions: Regions, found: EdgePositions, joined: bool, fixed: np.ndarray | None) -> list[TranslucentPart]:
    """The parts of regions, back to front.

    found: where the outlines of the regions run. joined: as of `stack`. fixed: (R,) bool, regions that lie beneath no
    translucent overlay and show none; None for no overlays at all.
    """
    overlays: tuple[Overlay, ...] = ()
    if fixed is not None:
        regions, overlays = without_overlays(regions, found, fixed)
    layers = stack(regions, found, joined)
    parts = [
        TranslucentPart(regions.fills[layers.layers[each.layer].region], each)
        for each in extents(regions, layers, found)
    ]
    return _with_overlays(parts, overlays, layers, regions, found) if overlays else parts


def _with_overlays(
    parts: list[TranslucentPart], overlays: tuple[Overlay, ...], layers: Stack, regions: Regions, found: EdgePositions
) -> list[TranslucentPart]:
    """The parts of layers with those of overlays, each behind the layers that are in front of all that it covers."""
    depth = layers.rank[regions.labels]
    opaque = regions.fills[regions.labels, 3] >= OPAQUE
    reached = depth.copy()
    behind: dict[int, list[TranslucentPart]] = {}
    # An overlay was found without those above it: the lowest come first, and the others go above them.
    for overlay in reversed(overlays):
        place = int(reached[overlay.cover].max())
        reached[overlay.cover] = place
        above = (depth > place) & opaque
        behind.setdefault(place, []).extend(
            TranslucentPart(overlay.paint.premultiplied, each) for each in extents_of(overlay.cover, above, found)
        )
    out = behind.get(-1, [])
    for k, part in enumerate(parts):
        out.append(part)
        if k + 1 == len(parts) or parts[k + 1].extent.layer != part.extent.layer:
            out.extend(behind.get(part.extent.layer, []))
    return out


@dataclass(frozen=True)
class _Crossing:
    """grounds: region that is covered: region beneath it, at one X. sure: both edges are seen to go straight on."""

    grounds: dict[int, int]
    sure: bool


@dataclass(frozen=True)
class _Candidate:
    """An overlay in regions. grounds: region that is covered: region beneath it."""

    paint: Paint
    grounds: dict[int, int]
    sure: int


def without_overlays(
    regions: Regions, found: EdgePositions, fixed: np.ndarray | None = None
) -> tuple[Regions, tuple[Overlay, ...]]:
    """The regions as they are without translucent overlays, and the overlays, the uppermost first.

    found: where the outlines of the regions run. fixed: (R,) bool, regions whose fill is not what is seen.
    """
    overlays: list[Overlay] = []
    fixed = np.zeros(regions.count, dtype=bool) if fixed is None else fixed
    while len(overlays) < MOST_OVERLAYS:
        best = _uppermost(regions, found, fixed)
        if best is None:
            break
        pairs = np.unique([[regions.fills[c], regions.fills[g]] for c, g in best.grounds.items()], axis=0)
        paint = replace(best.paint, fill=likeliest(pairs[:, 0], pairs[:, 1]))
        overlays.append(Overlay(paint, np.isin(regions.labels, list(best.grounds))))
        regions, fixed = merged(regions, best.grounds, fixed)
        regions, fixed, overlays = with_covered(regions, fixed, overlays)
    return regions, tuple(overlays)


def _uppermost(regions: Regions, found: EdgePositions, fixed: np.ndarray) -> _Candidate | None:
    """Of the overlays that nothing speaks against, the largest: where several lie over each other that is one of them
    rather than the place in which they do.
    """
    crossings = _crossings(regions, found, fixed)
    areas = regions.areas()
    good = [each for each in _overlays(regions, crossings) if _plausible(regions, each)]
    if not good:
        return None
    return max(good, key=lambda s: (sum(areas[c] for c in s.grounds), -min(s.grounds)))


def _crossings(regions: Regions, found: EdgePositions, fixed: np.ndarray) -> list[_Crossing]:
    out = []
    for place in meetings(regions.labels):
        if fixed[list(place.regions)].any():
            continue
        for k in range(4):
            c1, c2, g2, g1 = (place.regions[(k + i) % 4] for i in range(4))
            if paint_of(regions.fills[[c1, c2]], regions.fills[[g1, g2]]) is None:
                continue
            own = goes_on(regions.labels, found, place.at, ((g1, c1), (g2, c2)))
            beneath = goes_on(regions.labels, found, place.at, ((g1, g2), (c1, c2)))
            if own is not False and beneath is not False:
                out.append(_Crossing({c1: g1, c2: g2}, bool(own and beneath)))
    return out


def _overlays(regions: Regions, crossings: list[_Crossing]) -> list[_Candidate]:
    """Overlays of crossings that share a region and are of one paint, the surest ones first."""
    out = []
    left = sorted(crossings, key=lambda c: not c.sure)
    while left:
        first = left.pop(0)
        grounds, sure = dict(first.grounds), int(first.sure)
        paint = _paint(regions, grounds)
        growing = True
        while growing:
            growing = False
            for each in list(left):
                if grounds.keys().isdisjoint(each.grounds) or not _agree(grounds, each.grounds):
                    continue
                trial = grounds | each.grounds
                better = _paint(regions, trial)
                if better is not None:
                    grounds, paint, sure, growing = trial, better, sure + each.sure, True
                    left.remove(each)
        assert paint is not None
        out.append(_Candidate(paint, grounds, sure))
    return out


def _agree(one: dict[int, int], other: dict[int, int]) -> bool:
    """Whether what one covers lies on nothing that the other covers, so that both may be of one overlay."""
    return one.keys().isdisjoint(other.values()) and other.keys().isdisjoint(one.values())


def _paint(regions: Regions, grounds: dict[int, int]) -> Paint | None:
    return paint_of(regions.fills[list(grounds)], regions.fills[list(grounds.values())])


def _plausible(regions: Regions, overlay: _Candidate) -> bool:
    """Whether an overlay makes the description shorter: fewer outlines than what it covers has without it."""
    cover = np.isin(regions.labels, list(overlay.grounds))
    return overlay.sure > 0 and ndimage.label(cover)[1] < len(overlay.grounds)
