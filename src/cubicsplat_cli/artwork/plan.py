"""What is drawn of a flat picture: its inks, regions, layers and contours, down to the parts that become shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from cubicsplat_cli.artwork.layers.seams import without_seams
from cubicsplat_cli.artwork.limits import MOST_REGIONS, bounded_regions
from cubicsplat_cli.artwork.regions.inks import LEAST_FLAT, flat_pixels, picture_inks
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.artwork.settings import ON, ArtworkSettings
from cubicsplat_cli.artwork.tracing.contours import ROUNDING, Crossings, crossings
from cubicsplat_cli.artwork.translucent.parts import Part, parts_of

# A picture of more than FEW regions has regions of LEAST_AREA px and more on average, or is blurred by the next of
# BLURS, px.
FEW, LEAST_AREA = 16, 10
BLURS = (0.0, 1.5, 3.0, 6.0, 12.0, 24.0)


@dataclass(frozen=True, eq=False)
class Plan:
    """levels: (H, W, 4) the picture that is drawn. regions: of it. found: where they end. parts: back to front."""

    levels: np.ndarray
    regions: Regions
    found: Crossings
    parts: list[Part]


def planned(
    levels: np.ndarray,
    settings: ArtworkSettings,
    factor: int,
    error: float,
    standing: np.ndarray | None,
    inks: np.ndarray | None,
) -> Plan:
    """What is drawn of a flat picture (H, W, 4), premultiplied levels: at most settings.curves parts.

    factor: by which the drawing is enlarged at last. error: in levels, of pixels on edges beyond that of a clean
    picture. standing: (G, 4) inks that stand for gradients, of which no translucent shape makes others; None where no
    such shapes are sought. inks: (k, 4) those of the picture, None where they are not known.
    """
    min_area = settings.min_area / factor**2
    while True:
        soft, regions = _regions(levels, settings, min_area, inks)
        soft = without_seams(soft, regions)
        found = crossings(soft, regions, ROUNDING + error)
        fixed = None
        if standing is not None:
            fixed = (np.rint(regions.inks)[:, None] == standing[None]).all(axis=2).any(axis=1)
        parts = parts_of(regions, found, settings.completion == ON, fixed)
        if settings.curves is None or len(parts) <= settings.curves or min_area > levels[..., 0].size:
            return Plan(soft, regions, found, parts)
        # The regions beyond as many as may be drawn join their neighbours.
        areas = np.sort(regions.areas())[::-1]
        min_area = max(2.0 * min_area, float(areas[min(settings.curves, len(areas) - 1)]) + 1.0)


def _regions(
    levels: np.ndarray, settings: ArtworkSettings, min_area: float, inks: np.ndarray | None
) -> tuple[np.ndarray, Regions]:
    """The regions of a picture, and the picture they are of: blurred where there would be as many as px."""
    many = max(FEW, levels.shape[0] * levels.shape[1] // LEAST_AREA)
    soft = levels
    for blur in BLURS:
        if blur:
            soft = ndimage.gaussian_filter(levels, (blur, blur, 0.0), mode="nearest")
        elif levels.shape[0] * levels.shape[1] > MOST_REGIONS and flat_pixels(levels).mean() < LEAST_FLAT:
            continue
        palette = picture_inks(soft) if inks is None else inks
        regions = bounded_regions(soft, palette, min_area, None if inks is None else len(inks))
        if regions.count <= min(many, MOST_REGIONS):
            break
    return soft, regions
