"""The plan of a drawing: the picture in flat fills, and its regions, layers and contours, the parts of shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.gradients.bands import banded_areas
from cubicsplat_cli.artwork.gradients.flattening import Flattened, flattened
from cubicsplat_cli.artwork.gradients.noisy import without_blurred_gradients, without_noisy_gradients
from cubicsplat_cli.artwork.input.chroma import mixture_of
from cubicsplat_cli.artwork.input.condition import MISFIT, Condition
from cubicsplat_cli.artwork.input.pens import sharpened
from cubicsplat_cli.artwork.input.prepare import PreparedInput
from cubicsplat_cli.artwork.input.recompressed import before_compression
from cubicsplat_cli.artwork.input.restore import restored, without_fragments
from cubicsplat_cli.artwork.layers.seams import without_seams
from cubicsplat_cli.artwork.layers.translucent import TranslucentPart, parts_of
from cubicsplat_cli.artwork.limits import MOST_COMPLETED, MOST_REGIONS, bounded_regions
from cubicsplat_cli.artwork.regions.fewer import fewer_colours, nearest_colours
from cubicsplat_cli.artwork.regions.fills import LEAST_FLAT, flat_pixels
from cubicsplat_cli.artwork.regions.regions import FlatPicture, PixelFills, Regions, ShadowSides, find_regions
from cubicsplat_cli.artwork.regions.sampling import ROUNDING, edge_positions
from cubicsplat_cli.artwork.settings import ON, ArtworkSettings
from cubicsplat_cli.progress import log, work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.outlines import EdgePositions
from cubicsplat_cli.record import record

BLUR = 1.5  # px, through which pictures without interiors have regions
SMALL = 600  # px of a picture that may consist of edges


def flat_fills(prepared: PreparedInput, settings: ArtworkSettings) -> tuple[Flattened, FlatPicture, np.ndarray, float]:
    """Return the prepared picture in flat fills, and with its gradients as placeholders; the same as if it were clean,
    in the requested colours; the levels (H, W, 4) that outlines are fitted to, and their error at edges, in [0, 1].
    """
    condition, levels, compression = prepared.condition, prepared.levels, prepared.compression
    work().at("finding gradients", 0.05)
    flat = _without_gradients(prepared, settings)
    work().at("finding colours", 0.1)
    picture = as_if_clean(flat, prepared, settings)
    # A blur hides steps, and chosen fills form no bands.
    own_fills = settings.free_fills and not condition.blur
    if banded := banded_areas(levels, picture, flat, condition) if condition.jpeg and own_fills else []:
        flat = without_noisy_gradients(levels, condition, banded, flat.areas)
        picture = as_if_clean(flat, prepared, settings)
    if compression is not None and compression.known and own_fills:
        picture, target = before_compression(levels, flat, picture, condition, compression)
        if compression.webp:  # smoothed as it is decoded: its small parts are bands of shading, not what ringing leaves
            return flat, picture, target, 8.0 / 255.0
        # Pixels on edges are off by half a step of the coefficients that matter.
        return flat, without_fragments(picture, target, condition), target, 4.0 / 255.0
    if condition.jpeg and own_fills:
        picture = without_fragments(picture, flat.levels, condition)
    return flat, picture, flat.levels, condition.edge_error / 255.0


def _without_gradients(prepared: PreparedInput, settings: ArtworkSettings) -> Flattened:
    """Return the picture with placeholders for its gradients, and with its noise; without any if the fills are chosen,
    and in scans, whose light is never removed completely.
    """
    levels, condition = prepared.levels, prepared.condition
    if not settings.free_fills or prepared.scanned:
        return Flattened(levels)
    if condition.clean:
        return flattened(levels, layered=settings.may_overlap and settings.curves is None)
    if not condition.only_blurred:
        return without_noisy_gradients(levels, condition)
    return prepared.flat or without_blurred_gradients(levels, condition.blur)


def as_if_clean(flat: Flattened, prepared: PreparedInput, settings: ArtworkSettings) -> FlatPicture:
    """Return a picture without gradients as if it were clean, in the requested colours."""
    if prepared.pens is not None:
        picture = FlatPicture(*sharpened(flat.levels, prepared.pens))
    elif prepared.condition.clean:
        picture = FlatPicture(flat.levels, standing=flat.fills)
    else:
        picture = restored(flat.levels, prepared.condition, flat.fills)
    return picture if settings.free_fills else _in_chosen_colours(picture, settings)


def _in_chosen_colours(picture: FlatPicture, settings: ArtworkSettings) -> FlatPicture:
    """Return a clean picture in at most as many colours as requested, and in the near ones of the palette."""
    levels = picture.levels
    regions = find_regions(picture)
    _, first, number = np.unique(regions.fill_of, return_index=True, return_inverse=True)
    fills, labels = regions.fills[first], number[regions.labels]
    colours, owner = fewer_colours(fills, np.bincount(labels.ravel(), minlength=len(fills)), settings.colors)
    if settings.palette:
        colours, becomes = nearest_colours(colours, settings.palette, settings.palette_tolerance)
        owner = becomes[owner]
    # Blends keep their shares.
    return FlatPicture(mixture_of(levels, fills, labels, MISFIT, 0.0, snap=0.0).painted(colours[owner]), colours)


@record
class Plan:
    """The parts of a drawing, back to front, and what they are of: levels (H, W, 4), their fills, regions and edges."""

    levels: np.ndarray
    fills: PixelFills
    regions: Regions
    edges: EdgePositions
    parts: list[TranslucentPart]


def planned(
    picture: FlatPicture,
    settings: ArtworkSettings,
    condition: Condition,
    placeholders: np.ndarray | None = None,
    shaded: Sequence[ShadowSides] = (),
) -> Plan:
    """Return the plan of a picture's drawing, with at most settings.curves parts.

    settings: with areas in px of the picture. condition: of its edges, once it is restored. placeholders: (G, 4) fills
    of gradients, which no translucent shape changes; None for opaque shapes only. shaded: as of `stack`.
    """
    min_area = settings.min_area
    while True:
        work().at("finding regions", 0.15)
        soft, fills, regions = _regions(picture, min_area)
        if picture.labels is None:  # else its pixels were made, without seams
            soft = without_seams(soft, regions)
        work().at("locating edges", 0.2)
        edges = edge_positions(soft, regions, ROUNDING + condition.restored_error, condition.share_error)
        fixed = None
        if placeholders is not None:
            fixed = (np.rint(regions.fills)[:, None] == placeholders[None]).all(axis=2).any(axis=1)
        whole = regions.count <= MOST_COMPLETED
        if not whole:
            text = "%d regions are many: what lies above what, hidden parts and translucency are not sought"
            log.warning(text, regions.count)
        parts = parts_of(regions, edges, settings.completion == ON and whole, fixed if whole else None, shaded)
        if settings.curves is None or len(parts) <= settings.curves or min_area > soft[..., 0].size:
            return Plan(soft, fills, regions, edges, parts)
        # The smallest regions join their neighbours until the rest is few enough.
        areas = np.sort(regions.areas)[::-1]
        min_area = max(2.0 * min_area, float(areas[min(settings.curves, len(areas) - 1)]) + 1.0)


def _regions(picture: FlatPicture, min_area: float) -> tuple[np.ndarray, PixelFills, Regions]:
    """Return the picture, blurred if it has no interiors, its fills, and its regions."""
    soft, limit = picture.levels, MOST_REGIONS
    if soft.shape[0] * soft.shape[1] > SMALL and flat_pixels(soft).mean() < LEAST_FLAT:
        soft, limit = ndimage.gaussian_filter(soft, (BLUR, BLUR, 0.0), mode="nearest"), MOST_COMPLETED
        picture = replace(picture, levels=soft, labels=None)
    most = None if picture.palette is None else len(picture.palette)
    return soft, *bounded_regions(picture, min_area, most, limit)
