"""The parts of a drawing back to front: those of its layers, with translucent sheets above what shows through them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.layers.extents import OPAQUE, Extent, extents, extents_of
from cubicsplat_cli.artwork.layers.stacking import Stack, stack
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.artwork.tracing.contours import EdgePositions
from cubicsplat_cli.artwork.translucent.merging import Sheet
from cubicsplat_cli.artwork.translucent.sheets import without_sheets


@dataclass(frozen=True)
class TranslucentPart:
    """ink: (4,) premultiplied levels. extent: how far the part reaches."""

    ink: np.ndarray
    extent: Extent


def parts_of(regions: Regions, found: EdgePositions, joined: bool, fixed: np.ndarray | None) -> list[TranslucentPart]:
    """The parts of regions, back to front.

    found: where the outlines of the regions run. joined: as of `stack`. fixed: (R,) bool, regions that lie beneath no
    translucent sheet and show none; None for no sheets at all.
    """
    sheets: tuple[Sheet, ...] = ()
    if fixed is not None:
        regions, sheets = without_sheets(regions, found, fixed)
    layers = stack(regions, found, joined)
    parts = [
        TranslucentPart(regions.inks[layers.layers[each.layer].region], each)
        for each in extents(regions, layers, found)
    ]
    return _with_sheets(parts, sheets, layers, regions, found) if sheets else parts


def _with_sheets(
    parts: list[TranslucentPart], sheets: tuple[Sheet, ...], layers: Stack, regions: Regions, found: EdgePositions
) -> list[TranslucentPart]:
    """The parts of layers with those of sheets, each behind the layers that are in front of all that it covers."""
    depth = layers.rank[regions.labels]
    opaque = regions.inks[regions.labels, 3] >= OPAQUE
    reached = depth.copy()
    behind: dict[int, list[TranslucentPart]] = {}
    # A sheet was found without those above it: the lowest come first, and the others go above them.
    for sheet in reversed(sheets):
        place = int(reached[sheet.cover].max())
        reached[sheet.cover] = place
        above = (depth > place) & opaque
        behind.setdefault(place, []).extend(
            TranslucentPart(sheet.paint.premultiplied, each) for each in extents_of(sheet.cover, above, found)
        )
    out = behind.get(-1, [])
    for k, part in enumerate(parts):
        out.append(part)
        if k + 1 == len(parts) or parts[k + 1].extent.layer != part.extent.layer:
            out.extend(behind.get(part.extent.layer, []))
    return out
