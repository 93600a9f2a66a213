"""The plan of a drawing: the picture's fills, regions, layers and contours, down to the parts that become shapes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.layers.seams import without_seams
from cubicsplat_cli.artwork.layers.translucent import TranslucentPart, parts_of
from cubicsplat_cli.artwork.limits import MOST_COMPLETED, MOST_REGIONS, bounded_regions
from cubicsplat_cli.artwork.regions.fills import LEAST_FLAT, flat_pixels, picture_fills
from cubicsplat_cli.artwork.regions.regions import FlatPicture, PixelFills, Regions
from cubicsplat_cli.artwork.regions.sampling import FEW_SAMPLES, ROUNDING, edge_positions
from cubicsplat_cli.artwork.settings import ON, ArtworkSettings
from cubicsplat_cli.progress import log, work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.outlines import EdgePositions
from cubicsplat_cli.record import record

# A picture of more than FEW regions has regions of LEAST_AREA px and more on average, or is blurred by the next of
# BLURS, px.
FEW, LEAST_AREA = 16, 10
BLURS = (0.0, *(1.5 * 2.0**k for k in range(5)))
SMALL = 600  # px of a picture that may be all edges


@record
class Plan:
    """levels: (H, W, 4) the picture that is drawn. fills: of its pixels. regions: of it. found: where they end. parts:
    back to front.
    """

    levels: np.ndarray
    fills: PixelFills
    regions: Regions
    found: EdgePositions
    parts: list[TranslucentPart]


def planned(
    picture: FlatPicture,
    settings: ArtworkSettings,
    factor: int,
    error: float,
    placeholders: np.ndarray | None,
    share_error: float = FEW_SAMPLES,
) -> Plan:
    """The plan of a picture's drawing: at most settings.curves parts.

    factor: by which the drawing is enlarged at last. error: in levels, of pixels on edges beyond that of a clean
    picture. placeholders: (G, 4) fills that stand for gradients, of which no translucent shape makes others; None where
    no such shapes are sought. share_error: of the shares of pixels that shapes cover.
    """
    min_area = settings.min_area / factor**2
    while True:
        work().at("finding regions", 0.15)
        soft, fills, regions = _regions(picture, min_area)
        soft = without_seams(soft, regions)
        work().at("locating edges", 0.2)
        found = edge_positions(soft, regions, ROUNDING + error, share_error)
        fixed = None
        if placeholders is not None:
            fixed = (np.rint(regions.fills)[:, None] == placeholders[None]).all(axis=2).any(axis=1)
        whole = regions.count <= MOST_COMPLETED
        if not whole:
            log.warning(
                "%d regions are many: what lies above what, hidden parts and translucency are not sought", regions.count
            )
        parts = parts_of(regions, found, settings.completion == ON and whole, fixed if whole else None)
        if settings.curves is None or len(parts) <= settings.curves or min_area > soft[..., 0].size:
            return Plan(soft, fills, regions, found, parts)
        # The regions beyond as many as may be drawn join their neighbours.
        areas = np.sort(regions.areas())[::-1]
        min_area = max(2.0 * min_area, float(areas[min(settings.curves, len(areas) - 1)]) + 1.0)


def _regions(picture: FlatPicture, min_area: float) -> tuple[np.ndarray, PixelFills, Regions]:
    """The picture, blurred where there would be as many regions as px, its fills, and its regions."""
    levels, colours = picture.levels, picture.palette
    many = max(FEW, levels.shape[0] * levels.shape[1] // LEAST_AREA)
    soft = levels
    for blur in BLURS:
        work().at()
        if blur:
            soft = ndimage.gaussian_filter(levels, (blur, blur, 0.0), mode="nearest")
        elif levels.shape[0] * levels.shape[1] > SMALL and flat_pixels(levels).mean() < LEAST_FLAT:
            continue
        palette = picture_fills(soft) if colours is None else colours
        most, known = None if colours is None else len(colours), None if blur else picture.labels
        own = replace(picture, levels=soft, palette=palette, labels=known)
        fills, regions = bounded_regions(own, min_area, most, MOST_COMPLETED if blur else MOST_REGIONS)
        if regions.count <= many:
            break
    return soft, fills, regions
