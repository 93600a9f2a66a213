"""Pictures as they are compared: read row by row, without a float copy of the whole; or, for scale consistency, drawn
K times as large, tile by tile, and averaged back to their own size.

The native picture composites anti-aliased coverages, one number per pixel and curve; the large picture composites K x K
places of a pixel first and averages then. The two differ where outlines share a pixel (conflation), so both are
measured. cairosvg draws each tile of the unchanged file on a surface that is shifted under the drawing (cairo's
device offset); resvg draws the file inside an SVG whose viewBox is the tile.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import ModuleType
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.rerender import (
    RGBA,
    Rendered,
    choose_renderer,
    draw_by_cairo,
    draw_by_resvg,
    drawing_with,
    full_name,
)
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.record import record
from cubicsplat_cli.settings import SCALE

if TYPE_CHECKING:
    from cubicsplat_cli.scene import LayeredScene, Scene
    from cubicsplat_cli.svg.untrusted import SvgSize

# A pixel takes 4 bytes on cairo's surface, 16 in the engine's picture, up to 40 with resvg and its PNG.
TILE_PIXELS = 2**22
_MOST_SAMPLES = 64
# cairo's image surfaces end at 32767 px a side.
MAX_TILE_SIDE = 16_384


def downsampled_svg(
    svg: bytes,
    width: int,
    height: int,
    scale: int,
    *,
    source: str = "SVG",
    renderer: str = "auto",
    tile_pixels: int = TILE_PIXELS,
) -> Rendered:
    """Draw SVG bytes of any origin at (width * scale) x (height * scale) px and average to width x height.

    The pixels are (H, W, 4) float32, premultiplied, in [0, 1]. Memory is bounded by one tile, of at most `tile_pixels`
    px of the enlarged picture, and the result. Raises UsageError for a scale outside 1..12, and what `check_untrusted`
    and `rerender` raise.
    """
    from cubicsplat_cli.svg.untrusted import check_untrusted

    SCALE.check("scale", scale)
    size = check_untrusted(svg, source)
    module, name, note = choose_renderer(renderer)
    pixels = np.empty((height, width, 4), np.float32)
    with drawing_with(name, source):
        for tile in tiles(width, height, scale, tile_pixels):
            if name == "cairosvg":
                part = _tile_cairosvg(module, svg, width * scale, height * scale, scale, tile)
            else:
                part = _tile_resvg(module, svg, size, width * scale, height * scale, scale, tile)
            pixels[tile.rows, tile.columns] = part
    return Rendered(pixels, full_name(module, name), note)


def scaled_samples(samples: int, scale: int) -> int:
    """Edges per cubic that keep the polyline as near to the curve, in pixels of the large picture, as `samples` does
    in the native one: the error falls with the square of their number. At most 64.
    """
    return min(_MOST_SAMPLES, round(samples * scale**0.5))


def downsampled_scene(
    scene: Scene, scale: int, *, samples: int = 24, threads: int | None = None, tile_pixels: int = TILE_PIXELS
) -> np.ndarray:
    """The engine's exact picture of a scene `scale` times as large, averaged back: (H, W, C) float32.

    C = 3, or 4 (premultiplied) without a background. samples: edges per cubic at scale 1. Memory is bounded by one
    tile, as of `downsampled_svg`, and the result. Raises UsageError for a scale outside 1..12, InputError for a scene
    that is not valid.
    """
    SCALE.check("scale", scale)
    scene.validate()
    picture = np.empty((scene.height, scene.width, scene.channels), np.float32)
    for tile in tiles(scene.width, scene.height, scale, tile_pixels):
        drawn = draw_part(scene, scale, tile, scaled_samples(samples, scale), threads)
        picture[tile.rows, tile.columns] = area_means(drawn, scale)
    return picture


def draw_part(scene: Scene, scale: int, tile: Tile, samples: int, threads: int | None) -> np.ndarray:
    """(h * scale, w * scale, C) float32: the engine's exact picture of the enlarged scene, where it lies on the tile.

    samples: edges per cubic at most. threads: None for one per core.
    """
    from cubicsplat_cli.raster.engines import render_scene
    from cubicsplat_cli.scene.arrays import padded

    scene = scene.as_numpy()
    corner = np.array([tile.left, tile.top], scene.points.dtype)
    size = np.array([tile.width, tile.height], scene.points.dtype)
    points, used = scene.unpadded() - corner, scene.points_used()
    # A curve lies within the hull of its control points; one more pixel than its half-width is left around it.
    reach, starts = scene.half_widths[:, None] + 1.0, used.cumsum() - used
    low, high = np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts)
    touches = ((high >= -reach) & (low <= size + reach)).all(axis=1)
    # A scene has at least one curve; where none touches the tile, one that does not is as good.
    touches[0] = True
    points = padded(points[touches.repeat(used)] * points.dtype.type(scale), used[touches])
    part = replace(scene, points=scene.points[:, :0]).chosen(touches)
    gradients, ends = part.gradients, part.ring_ends
    if gradients is not None:
        gradients = gradients.seen_from(tile.left, tile.top).scaled(scale, scale)
    if ends is not None:  # none has room for more rings than the points now have room for segments
        ends = ends[:, : 1 + int((ends < ends[:, -1:]).sum(axis=1).max())]
    part = replace(
        part, width=tile.width * scale, height=tile.height * scale, points=points,
        half_widths=part.half_widths * scale, gradients=gradients, ring_ends=ends,
    )  # fmt: skip
    return render_scene(part, coverage="exact", samples=samples, threads=threads)


@record
class Tile:
    """A part of a picture in its own pixels, before it is enlarged."""

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
    """Cuts width x height px into tiles of which each, `scale` times as large, has at most about `pixels` px.

    A tile is never smaller than one pixel and never wider than MAX_TILE_SIDE once enlarged.
    """
    widest = MAX_TILE_SIDE // scale
    across = math.ceil(width / math.ceil(width / widest))
    down = max(1, min(widest, pixels // (across * scale * scale)))
    for top in range(0, height, down):
        for left in range(0, width, across):
            yield Tile(left, top, min(across, width - left), min(down, height - top))


def area_means(values: np.ndarray, scale: int) -> np.ndarray:
    """(H * scale, W * scale, C) uint8 or float to (H, W, C) float32 by the mean of each scale x scale block."""
    height, width = values.shape[0] // scale, values.shape[1] // scale
    blocks = values.reshape(height, scale, width, scale, values.shape[2])
    # Whole numbers add up exactly; float32 means of at most 144 values lose nothing that matters.
    total = blocks.sum(axis=(1, 3), dtype=np.uint32 if values.dtype == np.uint8 else np.float32)
    return (total / np.float32(scale * scale)).astype(np.float32)


def _tile_cairosvg(module: ModuleType, svg: bytes, width: int, height: int, scale: int, tile: Tile) -> np.ndarray:
    """(h, w, 4) float32: one tile of an SVG drawn at width x height px, averaged."""
    part = (tile.left * scale, tile.top * scale, tile.width * scale, tile.height * scale)
    drawn = draw_by_cairo(module, svg, width, height, part)
    return area_means(drawn, scale)[..., RGBA] / np.float32(255)


def _tile_resvg(
    module: ModuleType, svg: bytes, size: SvgSize, width: int, height: int, scale: int, tile: Tile
) -> np.ndarray:
    text = crop(svg, size, width, height, Tile(*(scale * v for v in (tile.left, tile.top, tile.width, tile.height))))
    straight = draw_by_resvg(module, text, tile.width * scale, tile.height * scale)
    # In eighths of the tile's rows: the float copy of a whole tile would be four times the tile.
    means = np.empty((tile.height, tile.width, 4), np.float32)
    step = max(1, tile.height // 8)
    for top in range(0, tile.height, step):
        rows = straight[top * scale : (top + step) * scale].astype(np.float32) / np.float32(255)
        rows[..., :3] *= rows[..., 3:]
        means[top : top + step] = area_means(rows, scale)
    return means


def crop(svg: bytes, size: SvgSize, width: int, height: int, part: Tile) -> str:
    """An SVG that shows `part` (px) of `svg` drawn at width x height px: the file, nested in a viewBox of that part.

    size: the file's natural size, its viewBox where it has none.
    """
    from cubicsplat_cli.svg.elements import SVG

    ElementTree.register_namespace("", SVG[1:-1])
    root = ElementTree.fromstring(svg)
    root.attrib = {"viewBox": f"0 0 {size.width:g} {size.height:g}"} | root.attrib
    # Clipping to the whole picture would cost resvg a layer, and every tile lies inside it.
    root.attrib |= {"x": "0", "y": "0", "width": str(width), "height": str(height), "overflow": "visible"}
    box = f"{part.left} {part.top} {part.width} {part.height}"
    sides = {"width": str(part.width), "height": str(part.height)}
    space = {} if root.tag.startswith("{") else {"xmlns": SVG[1:-1]}
    outer = ElementTree.Element(root.tag, {**space, **sides, "viewBox": box})
    outer.append(root)
    return ElementTree.tostring(outer, encoding="unicode")


@record
class ImageSource:
    """A picture of width x height px.

    rows: gives the rows from a first up to, but without, a last one: (n, width, 3) float32 in [0, 1], or premultiplied
    (n, width, 4) where it is `transparent`.
    """

    width: int
    height: int
    transparent: bool
    rows: Callable[[int, int], np.ndarray]


def of_picture(picture: Picture) -> ImageSource:
    """A loaded picture."""
    rgb, alpha = picture.rgb, picture.alpha
    if alpha is None:
        return ImageSource(picture.width, picture.height, False, lambda top, bottom: rgb[top:bottom])

    def rows(top: int, bottom: int) -> np.ndarray:
        part = alpha[top:bottom, :, None]
        return np.concatenate([rgb[top:bottom] * part, part], axis=2)

    return ImageSource(picture.width, picture.height, True, rows)


def of_pixels(pixels: np.ndarray) -> ImageSource:
    """A drawn picture: (H, W, 4) uint8 straight RGBA or (H, W, 3) uint8 RGB. InputError for anything else."""
    if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] not in (3, 4):
        raise InputError(f"a drawn picture must be (H, W, 3 or 4) uint8, not {pixels.shape} {pixels.dtype}")
    height, width, channels = pixels.shape
    transparent = channels == 4 and pixels.size > 0 and int(pixels[..., 3].min()) < 255

    def rows(top: int, bottom: int) -> np.ndarray:
        if not transparent:
            return pixels[top:bottom, :, :3] / np.float32(255)
        values = pixels[top:bottom] / np.float32(255)
        values[..., :3] *= values[..., 3:]
        return values

    return ImageSource(width, height, transparent, rows)


def of_values(values: np.ndarray) -> ImageSource:
    """A float picture, (H, W, 3) or premultiplied (H, W, 4); values are clipped to [0, 1] and not rounded to 8 bits.

    Raises InputError for anything else, and where a value is not finite.
    """
    if values.ndim != 3 or values.shape[2] not in (3, 4):
        raise InputError(f"a picture must be (H, W, 3 or 4), not {values.shape}")
    if not np.isfinite(values).all():
        raise InputError("the picture holds values that are not finite")
    height, width, channels = values.shape

    def rows(top: int, bottom: int) -> np.ndarray:
        return np.clip(values[top:bottom], 0.0, 1.0, dtype=np.float32)

    return ImageSource(width, height, channels == 4, rows)


def of_scene(
    scene: Scene | LayeredScene | None, width: int, height: int, samples: int, threads: int | None = None
) -> ImageSource:
    """The engine's exact picture of a scene at width x height px; of None a transparent one.

    samples: edges per cubic at most. Each call for rows draws them.
    """
    if scene is None:
        return ImageSource(width, height, True, lambda top, bottom: np.zeros((bottom - top, width, 4), np.float32))
    # Most of what is measured is no scene.
    from cubicsplat_cli.scene import LayeredScene, scaled_scene

    if isinstance(scene, LayeredScene):
        return _of_layers(scene.scaled(width, height), samples, threads)
    sized = scaled_scene(scene, width, height)

    def rows(top: int, bottom: int) -> np.ndarray:
        return np.clip(draw_part(sized, 1, Tile(0, top, width, bottom - top), samples, threads), 0.0, 1.0)

    return ImageSource(width, height, scene.background is None, rows)


def _over(below: np.ndarray, above: np.ndarray) -> np.ndarray:
    """One picture (H, W, 4), premultiplied, laid over another."""
    return above + below * (np.float32(1.0) - above[..., 3:])


def _of_layers(scene: LayeredScene, samples: int, threads: int | None) -> ImageSource:
    """The engine's exact picture of layers, each drawn as a whole, clipped, and laid over those before."""
    from cubicsplat_cli.scene import EmbeddedImage

    def rows(top: int, bottom: int) -> np.ndarray:
        tile = Tile(0, top, scene.width, bottom - top)
        out: np.ndarray = np.zeros((bottom - top, scene.width, 4), np.float32)
        for layer in scene.layers:
            drawn: np.ndarray = np.zeros_like(out)
            for each in layer.scenes:
                if isinstance(each, EmbeddedImage):
                    drawn = _over(drawn, each.rows(top, bottom))
                else:
                    drawn = _over(drawn, draw_part(each, 1, tile, samples, threads))
            if layer.clip is not None:
                drawn *= draw_part(layer.clip, 1, tile, samples, threads)[..., 3:]
            out = _over(out, drawn)
        return np.clip(out, 0.0, 1.0)

    return ImageSource(scene.width, scene.height, True, rows)
