"""The parts of a drawing back to front: those of its layers, with translucent overlays above what shows through
them."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.layers.extents import OPAQUE, Extent, extents, extents_of
from cubicsplat_cli.artwork.layers.stacking import Stack, stack
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.artwork.tracing.contours import EdgePositions
from cubicsplat_cli.artwork.translucent.merging import Overlay
from cubicsplat_cli.artwork.translucent.overlays import without_overlays
from cubicsplat_cli.records import dataclass


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
