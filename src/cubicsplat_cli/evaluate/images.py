"""Pictures for comparison: sources read row by row, without a float copy of the whole (`ImageSource`); and pictures
drawn K times as large, tile by tile, and averaged back to their own size, for scale consistency.

The native picture composites anti-aliased coverages, one number per pixel and curve. The large picture composites K x K
samples of a pixel, then averages them. The two differ in pixels that outlines share (conflation), so both are measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.rerender import RGBA, Rendered, choose_renderer, draw_by_cairo, draw_by_resvg, drawing_with
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.record import record
from cubicsplat_cli.scene import AnyScene, EmbeddedImage, LayeredScene, Scene
from cubicsplat_cli.scene.arrays import block_means, padded
from cubicsplat_cli.scene.paint import laid_over
from cubicsplat_cli.settings import SCALE

if TYPE_CHECKING:
    from cubicsplat_cli.svg.untrusted import SvgSize

# A pixel takes 4 bytes on cairo's surface, 16 in the engine's picture, up to 60 with resvg and its PNG.
TILE_PIXELS = 2**22
# cairo's image surfaces end at 32767 px a side.
MAX_TILE_SIDE = 16_384


def downsampled_svg(
    svg: bytes, width: int, height: int, scale: int, *, source: str = "SVG", renderer: str = "auto",
    tile_pixels: int = TILE_PIXELS,
) -> Rendered:  # fmt: skip
    """Draw SVG bytes of any origin at (width * scale) x (height * scale) px and average to width x height.

    The pixels are (H, W, 4) float32, premultiplied, in [0, 1]. Memory is bounded by the result and one tile, of at most
    `tile_pixels` px of the enlarged picture. Raises UsageError for a scale outside 1..12, and the errors of
    `check_untrusted` and `rerender`.
    """
    from cubicsplat_cli.svg.untrusted import check_untrusted

    SCALE.check("scale", scale)
    size = check_untrusted(svg, source)
    module, name, note = choose_renderer(renderer)
    pixels, large = np.empty((height, width, 4), np.float32), (width * scale, height * scale)
    with drawing_with(name, source):
        for tile in tiles(width, height, scale, tile_pixels):
            part = Tile(*(scale * length for length in tile))
            if name == "cairosvg":
                means = block_means(draw_by_cairo(module, svg, *large, part), scale)[..., RGBA] / np.float32(255)
            else:
                drawn = draw_by_resvg(module, crop(svg, size, *large, part), part.width, part.height)
                means = block_means(_premultiplied(drawn), scale)
            pixels[tile.rows, tile.columns] = means
    return Rendered(pixels, f"{module.__name__} {module.__version__}", note)


def scaled_samples(samples: int, scale: int) -> int:
    """Return the edges per cubic that keep the polyline as near to the curve, in px of the large picture, as `samples`
    does in the native one: the error falls with the square of their number. At most 64.
    """
    return min(64, round(samples * scale**0.5))


def downsampled_scene(
    scene: Scene, scale: int, *, samples: int = 24, threads: int | None = None, tile_pixels: int = TILE_PIXELS
) -> np.ndarray:
    """Return the engine's exact picture of a scene `scale` times as large, averaged back: (H, W, C) float32.

    C = 3, or 4 (premultiplied) without a background. samples: edges per cubic at scale 1. tile_pixels: see
    `downsampled_svg`. Raises UsageError for a scale outside 1..12, InputError for an invalid scene.
    """
    SCALE.check("scale", scale)
    scene.validate()
    picture = np.empty((scene.height, scene.width, scene.channels), np.float32)
    for tile in tiles(scene.width, scene.height, scale, tile_pixels):
        drawn = draw_part(scene, scale, tile, scaled_samples(samples, scale), threads)
        picture[tile.rows, tile.columns] = block_means(drawn, scale)
    return picture


def draw_part(scene: Scene, scale: int, tile: Tile, samples: int, threads: int | None) -> np.ndarray:
    """Return a tile of the engine's exact picture of an enlarged scene, (h * scale, w * scale, C) float32.

    samples: edges per cubic at most. threads: None for one per core.
    """
    from cubicsplat_cli.raster.engines import render_scene

    scene = scene.as_numpy()
    corner = np.array([tile.left, tile.top], scene.points.dtype)
    size = np.array([tile.width, tile.height], scene.points.dtype)
    points, used = scene.unpadded() - corner, scene.points_used()
    # A curve lies within its half-width, and one pixel more for anti-aliasing, of the hull of its control points.
    reach, starts = scene.half_widths[:, None] + 1.0, used.cumsum() - used
    low, high = np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts)
    touches = ((high >= -reach) & (low <= size + reach)).all(axis=1)
    touches[0] = True  # a scene has at least one curve
    points = padded(points[touches.repeat(used)], used[touches])
    part = replace(scene, points=scene.points[:, :0]).chosen(touches)
    gradients, ends = part.gradients, part.ring_ends
    if gradients is not None:
        gradients = gradients.seen_from(tile.left, tile.top)
    if ends is not None:  # the remaining curves may have fewer rings
        ends = ends[:, : 1 + int((ends < ends[:, -1:]).sum(axis=1).max())]
    part = replace(part, width=tile.width, height=tile.height, points=points, gradients=gradients, ring_ends=ends)
    enlarged = part.scaled(tile.width * scale, tile.height * scale)
    return render_scene(enlarged, coverage="exact", samples=samples, threads=threads)


class Tile(NamedTuple):
    """A part of a picture, px."""

    left: int
    top: int
    width: int
    height: int

    @property
    def rows(self) -> slice:
        return slice(self.top, self.top + self.height)

    @property
    def columns(self) -> slice:
        return slice(self.left, self.left + self.width)


def tiles(width: int, height: int, scale: int, pixels: int) -> Iterator[Tile]:
    """Cut width x height px into tiles of a pixel at least; `scale` times as large, each has about `pixels` px at most
    and is at most MAX_TILE_SIDE wide.
    """
    widest = MAX_TILE_SIDE // scale
    across = math.ceil(width / math.ceil(width / widest))
    down = max(1, min(widest, pixels // (across * scale * scale)))
    for top in range(0, height, down):
        for left in range(0, width, across):
            yield Tile(left, top, min(across, width - left), min(down, height - top))


def _premultiplied(pixels: np.ndarray) -> np.ndarray:
    """Return premultiplied floats in [0, 1] of straight RGBA uint8."""
    values = pixels / np.float32(255)
    values[..., :3] *= values[..., 3:]
    return values


def crop(svg: bytes, size: SvgSize, width: int, height: int, part: Tile) -> str:
    """Return an SVG that shows `part` (px) of `svg` drawn at width x height px: the file nested in a viewBox.

    size: the file's natural size, which becomes its viewBox if it has none.
    """
    from cubicsplat_cli.svg.elements import SVG

    root = ElementTree.fromstring(svg)
    root.attrib = {"viewBox": f"0 0 {size.width:g} {size.height:g}"} | root.attrib
    # Every tile lies inside the picture, and clipping to that would cost resvg a layer.
    root.attrib |= {"x": "0", "y": "0", "width": str(width), "height": str(height), "overflow": "visible"}
    box = f"{part.left} {part.top} {part.width} {part.height}"
    sides = {"width": str(part.width), "height": str(part.height)}
    space = {} if root.tag.startswith("{") else {"xmlns": SVG[1:-1]}
    outer = ElementTree.Element(root.tag, {**space, **sides, "viewBox": box})
    outer.append(root)
    return ElementTree.tostring(outer, encoding="unicode")


@record
class ImageSource:
    """A picture of width x height px. rows: returns the rows from a first one up to, but without, a last one: (n,
    width, 3) float32 in [0, 1], or premultiplied (n, width, 4) if the picture is `transparent`.
    """

    width: int
    height: int
    transparent: bool
    rows: Callable[[int, int], np.ndarray]


def of_picture(picture: Picture) -> ImageSource:
    """Return the source of a loaded picture."""

    def rows(top: int, bottom: int) -> np.ndarray:
        alpha = None if picture.alpha is None else picture.alpha[top:bottom]
        return replace(picture, rgb=picture.rgb[top:bottom], alpha=alpha).target()

    return ImageSource(picture.width, picture.height, picture.alpha is not None, rows)


def of_pixels(pixels: np.ndarray) -> ImageSource:
    """Return the source of (H, W, 4) uint8 straight RGBA or (H, W, 3) uint8 RGB. Raises InputError for others."""
    if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] not in (3, 4):
        raise InputError(f"a drawn picture must be (H, W, 3 or 4) uint8, not {pixels.shape} {pixels.dtype}")
    height, width, channels = pixels.shape
    transparent = channels == 4 and pixels.size > 0 and int(pixels[..., 3].min()) < 255

    def rows(top: int, bottom: int) -> np.ndarray:
        part = pixels[top:bottom]
        return _premultiplied(part) if transparent else part[..., :3] / np.float32(255)

    return ImageSource(width, height, transparent, rows)


def of_values(values: np.ndarray) -> ImageSource:
    """Return the source of floats, (H, W, 3) or premultiplied (H, W, 4), clipped to [0, 1] and not rounded to 8 bits.

    Raises InputError for another shape, and if a value is not finite.
    """
    if values.ndim != 3 or values.shape[2] not in (3, 4):
        raise InputError(f"a picture must be (H, W, 3 or 4), not {values.shape}")
    if not np.isfinite(values).all():
        raise InputError("the picture holds values that are not finite")
    height, width, channels = values.shape

    def rows(top: int, bottom: int) -> np.ndarray:
        return np.clip(values[top:bottom], 0.0, 1.0, dtype=np.float32)

    return ImageSource(width, height, channels == 4, rows)


def of_scene(scene: AnyScene | None, width: int, height: int, samples: int, threads: int | None = None) -> ImageSource:
    """Return the source of the engine's exact picture of a scene at width x height px; without a scene it is clear.

    samples: edges per cubic at most. Each call of `rows` draws them. Each of several layers is drawn as a whole,
    clipped, and laid over the layers before it.
    """
    sized = (scene or LayeredScene(width, height, ())).scaled(width, height)

    def rows(top: int, bottom: int) -> np.ndarray:
        def drawn(part: Scene | EmbeddedImage) -> np.ndarray:
            if isinstance(part, EmbeddedImage):
                return part.rows(top, bottom)
            return draw_part(part, 1, Tile(0, top, width, bottom - top), samples, threads)

        if isinstance(sized, Scene):
            return np.clip(drawn(sized), 0.0, 1.0)
        out: np.ndarray = np.zeros((bottom - top, width, 4), np.float32)
        for layer in sized.layers:
            whole = laid_over([drawn(part) for part in layer.scenes])
            out = laid_over((out, whole if layer.clip is None else whole * drawn(layer.clip)[..., 3:]))
        return np.clip(out, 0.0, 1.0)

    return ImageSource(width, height, isinstance(sized, LayeredScene) or sized.background is None, rows)
