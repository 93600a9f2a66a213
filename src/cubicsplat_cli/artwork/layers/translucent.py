"""The parts of a drawing back to front: those of its layers, with translucent overlays above what shows through them.

The regions C1 and C2 that an overlay makes of its grounds G1 and G2 meet these in an X: there the overlay's edge, from
G1 | C1 to G2 | C2, crosses the grounds' edge, from G1 | G2 to C1 | C2. All that an overlay covers must follow from one
paint. Without it C1 and G1 are one region, and the next overlay beneath it can be found.

Opaque shapes hardly ever meet so, as the upper one hides the lower one's edge.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from cubicsplat_cli.artwork.geometry.fitting import GAP
from cubicsplat_cli.artwork.layers.extents import Extent, extents, extents_of
from cubicsplat_cli.artwork.layers.merging import Overlay, likeliest, merged, paint_levels, paint_of, with_covered
from cubicsplat_cli.artwork.layers.stacking import LEAST_TURN, MEETING, REACHES, SMOOTH, Stack, stack
from cubicsplat_cli.artwork.layers.ways import SLACK
from cubicsplat_cli.artwork.regions.fills import OPAQUE
from cubicsplat_cli.artwork.regions.regions import Regions, ShadowSides
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.borders import meeting
from cubicsplat_cli.raster.outlines import EdgePositions, Heading, heading
from cubicsplat_cli.record import record

RADII = (4.0, 6.0, 8.0)  # px of circles around a meeting, on the first of which all four regions lie
SIGMAS = 3.0  # standard errors by which places or directions that are one differ at most


@record
class TranslucentPart:
    """fill: (4,) premultiplied levels. extent: how far the part reaches."""

    fill: np.ndarray
    extent: Extent


def parts_of(
    regions: Regions, found: EdgePositions, joined: bool, fixed: np.ndarray | None, shaded: Sequence[ShadowSides] = ()
) -> list[TranslucentPart]:
    """The parts of regions, back to front.

    found: where the outlines of the regions run. joined, shaded: as of `stack`. fixed: (R,) bool, regions that lie
    beneath no translucent overlay and show none; None for no overlays at all.
    """
    overlays: tuple[Overlay, ...] = ()
    if fixed is not None:
        regions, overlays = without_overlays(regions, found, fixed)
    layers = stack(regions, found, joined, shaded)
    over = _parts_over(layers, overlays, regions, found) if overlays else {}
    parts = over.get(-1, [])
    for place, own in enumerate(extents(regions, layers, found)):
        fill = regions.fills[layers.layers[place][0]]
        parts += [*(TranslucentPart(fill, extent) for extent in own), *over.get(place, [])]
    return parts


def _parts_over(
    layers: Stack, overlays: tuple[Overlay, ...], regions: Regions, found: EdgePositions
) -> dict[int, list[TranslucentPart]]:
    """The parts of overlays by the layer that each comes above, the uppermost of all that it covers; -1 for none."""
    depth = layers.rank[regions.labels]
    opaque = (regions.fills[:, 3] >= OPAQUE)[regions.labels]
    reached = depth.copy()
    parts: dict[int, list[TranslucentPart]] = {}
    # An overlay was found without those above it: the lowest come first, and the others go above them.
    for overlay in reversed(overlays):
        place = int(reached[overlay.cover].max())
        reached[overlay.cover] = place
        paint, own = paint_levels(overlay.paint), extents_of(overlay.cover, (depth > place) & opaque, found)
        parts.setdefault(place, []).extend(TranslucentPart(paint, extent) for extent in own)
    return parts


def without_overlays(regions: Regions, found: EdgePositions, fixed: np.ndarray) -> tuple[Regions, tuple[Overlay, ...]]:
    """The regions as they are without translucent overlays, and the overlays, the uppermost first.

    found: where the outlines of the regions run. fixed: (R,) bool, regions whose fill is not what is seen.
    """
    overlays: list[Overlay] = []
    while (grounds := _uppermost(regions, found, fixed)) is not None:
        pairs = np.unique([[regions.fills[c], regions.fills[g]] for c, g in grounds.items()], axis=0)
        overlays.append(Overlay(likeliest(pairs[:, 0], pairs[:, 1]), _mask_of(regions, grounds)))
        regions, fixed = merged(regions, grounds, fixed)
        regions, fixed, overlays = with_covered(regions, fixed, overlays)
    return regions, tuple(overlays)


def _mask_of(regions: Regions, some: Iterable[int]) -> np.ndarray:
    """(H, W) bool: the pixels of some regions."""
    return np.isin(np.arange(regions.count), list(some))[regions.labels]


def _uppermost(regions: Regions, found: EdgePositions, fixed: np.ndarray) -> dict[int, int] | None:
    """The regions that the largest overlay covers, of those that nothing speaks against, and beneath each what it lies
    on: where several lie over each other that is one of them rather than the place in which they do.
    """
    areas = regions.areas
    # An overlay must make the description shorter: fewer outlines than what it covers has without it.
    good = [
        grounds
        for grounds, sure in _overlays(regions, _crossings(regions, found, fixed))
        if sure > 0 and ndimage.label(_mask_of(regions, grounds))[1] < len(grounds)
    ]
    return max(good, key=lambda grounds: (sum(areas[c] for c in grounds), -min(grounds)), default=None)


def _crossings(regions: Regions, found: EdgePositions, fixed: np.ndarray) -> list[tuple[dict[int, int], int]]:
    """Regions that an overlay may cover, and beneath each what it lies on (dictionary), of one X; and 1 where both
    edges are seen to go straight on there, else 0.
    """
    out = []
    for at, around in meetings(regions.labels):
        if fixed[around].any():
            continue
        for k in range(4):
            c1, c2, g2, g1 = around[k:] + around[:k]
            if paint_of(regions.fills[[c1, c2]], regions.fills[[g1, g2]]) is None:
                continue
            own = goes_on(regions.labels, found, at, (g1, c1), (g2, c2))
            beneath = goes_on(regions.labels, found, at, (g1, g2), (c1, c2))
            if own is not False and beneath is not False:
                out.append(({c1: g1, c2: g2}, int(bool(own and beneath))))
    return out


def _overlays(regions: Regions, crossings: list[tuple[dict[int, int], int]]) -> list[tuple[dict[int, int], int]]:
    """Crossings that share a region and are of one paint, all in one, the surest ones first."""
    out = []
    left = sorted(crossings, key=lambda crossing: -crossing[1])
    while left:
        grounds, sure = left.pop(0)
        growing = True
        while growing:
            growing = False
            for each in list(left):
                # Both may be of one overlay if what one covers lies on nothing that the other covers.
                apart = each[0].keys().isdisjoint(grounds.values()) and grounds.keys().isdisjoint(each[0].values())
                if grounds.keys().isdisjoint(each[0]) or not apart:
                    continue
                trial = grounds | each[0]
                if paint_of(regions.fills[list(trial)], regions.fills[list(trial.values())]) is not None:
                    grounds, sure, growing = trial, sure + each[1], True
                    left.remove(each)
        out.append((grounds, sure))
    return out


def meetings(labels: np.ndarray) -> list[tuple[np.ndarray, list[int]]]:
    """The places (2,), x and y in px, where exactly four different regions of a map (H, W) meet, and these in order."""
    several = meeting(labels)
    if not several.any():
        return []
    near, count = ndimage.label(ndimage.binary_dilation(np.pad(several, MEETING), np.ones((MEETING, MEETING), bool)))
    near = near[MEETING:-MEETING, MEETING:-MEETING]
    middles = ndimage.center_of_mass(several, near, np.arange(1, count + 1))
    places = [np.array([x + 1.0, y + 1.0]) for y, x in middles]
    return [(at, around) for at in places if (around := _around(labels, at))]


def _around(labels: np.ndarray, at: np.ndarray) -> list[int]:
    """The four regions around a place in their order; none where others meet there."""
    turn = np.linspace(0.0, 2.0 * math.pi, 96, endpoint=False)
    for radius in RADII:
        x, y = np.floor(at[0] + radius * np.cos(turn)).astype(int), np.floor(at[1] + radius * np.sin(turn)).astype(int)
        if x.min() < 0 or y.min() < 0 or x.max() >= labels.shape[1] or y.max() >= labels.shape[0]:
            return []
        seen = labels[y, x]
        runs = seen[seen != np.roll(seen, 1)]
        if len(runs) == 4 and len(set(runs.tolist())) == 4:
            return runs.tolist()
    return []


def goes_on(labels: np.ndarray, found: EdgePositions, at: np.ndarray, *edges: tuple[int, int]) -> bool | None:
    """True if the edge between one pair of regions goes straight on as that between another pair at a meeting; None
    where one of the two is too short or too rough to tell.
    """
    one, other = (_arm(labels, found, at, pair) for pair in edges)
    if one is None or other is None:
        return None
    turn = math.pi - math.acos(float(np.clip(one.tangent @ other.tangent, -1.0, 1.0)))
    error = math.hypot(one.error, other.error, LEAST_TURN)
    normal = np.array([-one.tangent[1], one.tangent[0]])
    return turn <= SIGMAS * error and abs(float((other.at - one.at) @ normal)) <= SLACK


def _arm(labels: np.ndarray, found: EdgePositions, at: np.ndarray, pair: tuple[int, int]) -> Heading | None:
    """The direction of the edge between two regions at a meeting."""
    reach = int(REACHES[0]) + 2
    top, left = max(int(at[1]) - reach, 0), max(int(at[0]) - reach, 0)
    view = labels[top : int(at[1]) + reach + 1, left : int(at[0]) + reach + 1]
    first, second = view == pair[0], view == pair[1]
    y, x = np.nonzero((first[:-1] & second[1:]) | (second[:-1] & first[1:]))
    level = np.stack([x + left + 0.5, found.rows[y + top + 1, x + left]], axis=1)
    level_sigma = found.row_sigma[y + top + 1, x + left]
    y, x = np.nonzero((first[:, :-1] & second[:, 1:]) | (second[:, :-1] & first[:, 1:]))
    upright = np.stack([found.columns[y + top, x + left + 1], y + top + 0.5], axis=1)
    upright_sigma = found.column_sigma[y + top, x + left + 1]
    # The two may have other edges near: what counts is the one that begins here, as far as it has no gap.
    near = [int((np.hypot(*(each - at).T) <= RADII[-1]).sum()) for each in (level, upright)]
    points, sigma = (level, level_sigma) if near[0] >= near[1] else (upright, upright_sigma)
    order = np.argsort(np.hypot(*(points - at).T), kind="stable")
    gaps = np.flatnonzero(np.hypot(*np.diff(points[order], axis=0).T) > GAP)
    order = order[: gaps[0] + 1] if len(gaps) else order
    for length in REACHES:
        ends = heading(points[order], sigma[order], length)
        if ends is not None and ends.misfit <= SMOOTH:
            return ends
    return None
