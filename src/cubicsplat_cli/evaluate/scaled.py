"""Scale consistency: a picture drawn K times as large, tile by tile, and averaged back to its own size.

The native picture composites anti-aliased coverages, one number per pixel and curve; the large picture composites K x K
places of a pixel first and averages then. The two differ where outlines share a pixel (conflation), so both figures
are worth having.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cubicsplat_cli.evaluate.rerender import choose_renderer, drawing_with, full_name
from cubicsplat_cli.evaluate.tiles import Tile, area_means, draw_tile, tiles
from cubicsplat_cli.settings import SCALE
from cubicsplat_cli.svg.untrusted import check_untrusted

if TYPE_CHECKING:
    from cubicsplat_cli.scene import Scene

# A pixel takes 4 bytes on cairo's surface, 16 in the engine's picture, up to 40 with resvg and its PNG.
TILE_PIXELS = 2**22
_MOST_SAMPLES = 64


@dataclass(frozen=True, eq=False)
class Downsampled:
    """An SVG drawn large and averaged back: pixels (H, W, 4) float32 premultiplied in [0, 1]; who drew it."""

    pixels: np.ndarray
    renderer: str
    note: str | None


def downsampled_svg(
    svg: bytes, width: int, height: int, scale: int, *, source: str = "SVG", renderer: str | None = None
) -> Downsampled:
    """Draw SVG bytes of any origin at (width * scale) x (height * scale) px and average to width x height.

    Memory is bounded by one tile and the result. Raises UsageError for a scale outside 1..12, and what
    `check_untrusted` and `rerender` raise.
    """
    SCALE.check("scale", scale)
    size = check_untrusted(svg, source)
    module, name, note = choose_renderer(renderer)
    pixels = np.empty((height, width, 4), np.float32)
    with drawing_with(name, source):
        for tile in tiles(width, height, scale, TILE_PIXELS):
            pixels[tile.rows, tile.columns] = draw_tile(name, module, svg, size, width, height, scale, tile)
    return Downsampled(pixels, full_name(module, name), note)


def scaled_samples(samples: int, scale: int) -> int:
    """Edges per cubic that keep the polyline as near to the curve, in pixels of the large picture, as `samples` does
    in the native one: the error falls with the square of their number. At most 64.
    """
    return min(_MOST_SAMPLES, round(samples * scale**0.5))


def downsampled_scene(scene: Scene, scale: int, *, samples: int = 24, threads: int | None = None) -> np.ndarray:
    """The engine's exact picture of a scene `scale` times as large, averaged back: (H, W, C) float32.

    C = 3, or 4 (premultiplied) without a background. samples: edges per cubic at scale 1. Memory is bounded by one
    tile and the result. Raises UsageError for a scale outside 1..12, InputError for a scene that is not valid.
    """
    SCALE.check("scale", scale)
    scene.validate()
    picture = np.empty((scene.height, scene.width, scene.channels), np.float32)
    for tile in tiles(scene.width, scene.height, scale, TILE_PIXELS):
        drawn = draw_part(scene, scale, tile, scaled_samples(samples, scale), threads)
        picture[tile.rows, tile.columns] = area_means(drawn, scale)
    return picture


def draw_part(scene: Scene, scale: int, tile: Tile, samples: int, threads: int | None) -> np.ndarray:
    """(h * scale, w * scale, C) float32: the engine's exact picture of the enlarged scene, where it lies on the tile.

    samples: edges per cubic at most. threads: None for one per core.
    """
    from cubicsplat_cli.raster import render_scene

    scene = scene.as_numpy()
    corner = np.array([tile.left, tile.top], scene.points.dtype)
    size = np.array([tile.width, tile.height], scene.points.dtype)
    # A curve lies within the hull of its control points; one more pixel than its half-width is left around it.
    reach = scene.half_widths[:, None] + 1.0
    low, high = scene.points.min(axis=1) - corner, scene.points.max(axis=1) - corner
    touches = ((high >= -reach) & (low <= size + reach)).all(axis=1)
    # A scene has at least one curve; where none touches the tile, one that does not is as good.
    touches[0] = True
    part = scene.chosen(touches)
    points, gradients = part.points - corner, part.gradients
    points *= scale
    if gradients is not None:
        gradients = gradients.seen_from(tile.left, tile.top).scaled(scale, scale)
    part = replace(
        part, width=tile.width * scale, height=tile.height * scale, points=points,
        half_widths=part.half_widths * scale, gradients=gradients,
    )  # fmt: skip
    return render_scene(part, coverage="exact", samples=samples, threads=threads)
