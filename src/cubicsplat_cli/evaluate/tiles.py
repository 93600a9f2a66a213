"""Parts of an SVG drawn at many times its size, so that no picture ever needs more memory than one tile.

cairosvg draws each tile of the unchanged file on a surface that is shifted under the drawing (cairo's device offset);
resvg draws the file inside an SVG whose viewBox is the tile.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate import cairo
from cubicsplat_cli.evaluate.rerender import decode_png
from cubicsplat_cli.svg.untrusted import SvgSize

# cairo's image surfaces end at 32767 px a side.
MAX_TILE_SIDE = 16_384
_SVG = "http://www.w3.org/2000/svg"


@dataclass(frozen=True)
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


def draw_tile(
    name: str, module: ModuleType, svg: bytes, size: SvgSize, width: int, height: int, scale: int, tile: Tile
) -> np.ndarray:
    """One tile of an SVG drawn at (width * scale) x (height * scale) px, area-averaged to (h, w, 4) float32.

    Premultiplied RGBA in [0, 1]. size: the SVG's natural size. name: "cairosvg" or "resvg", module: its package.
    """
    if name == "cairosvg":
        return _tile_cairosvg(module, svg, width * scale, height * scale, scale, tile)
    return _tile_resvg(module, svg, size, width * scale, height * scale, scale, tile)


def _tile_cairosvg(module: ModuleType, svg: bytes, width: int, height: int, scale: int, tile: Tile) -> np.ndarray:
    part = (tile.left * scale, tile.top * scale, tile.width * scale, tile.height * scale)
    drawn = cairo.draw(module, svg, width, height, part)
    return area_means(drawn, scale)[..., cairo.RGBA] / np.float32(255)


def _tile_resvg(
    module: ModuleType, svg: bytes, size: SvgSize, width: int, height: int, scale: int, tile: Tile
) -> np.ndarray:
    text = crop(svg, size, width, height, Tile(*(scale * v for v in (tile.left, tile.top, tile.width, tile.height))))
    fonts = "<text" not in text
    png = module.svg_to_bytes(
        svg_string=text, width=tile.width * scale, height=tile.height * scale, skip_system_fonts=fonts, dpi=96
    )
    straight = decode_png(bytes(png))
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

    size: the file's natural size, its viewBox where it has none. Raises InputError for text that is not UTF-8.
    """
    try:
        text = svg.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError("an SVG that is not UTF-8 cannot be drawn in parts by resvg; save it as UTF-8") from error
    name, attributes, begin = _root(text.encode())
    body = text.encode()[begin:].decode()
    end = _tag_end(body)
    attributes = {"viewBox": f"0 0 {size.width:g} {size.height:g}"} | attributes
    # Clipping to the whole picture would cost resvg a layer, and every tile lies inside it.
    attributes |= {"x": "0", "y": "0", "width": str(width), "height": str(height), "overflow": "visible"}
    tag = " ".join([name, *(f"{key}={quoteattr(value)}" for key, value in attributes.items())])
    box = f"{part.left} {part.top} {part.width} {part.height}"
    outer = f'<svg xmlns="{_SVG}" width="{part.width}" height="{part.height}" viewBox="{box}">'
    return f"{outer}<{tag}{body[end:]}</svg>"


def _root(svg: bytes) -> tuple[str, dict[str, str], int]:
    """Name and attributes of the root element, and the byte at which its tag begins."""
    found: list[tuple[str, dict[str, str], int]] = []
    parser = expat.ParserCreate("utf-8")

    def start(name: str, attributes: dict[str, str]) -> None:
        if not found:
            found.append((name, attributes, parser.CurrentByteIndex))

    parser.StartElementHandler = start
    parser.Parse(svg, True)
    return found[0]


def _tag_end(text: str) -> int:
    """Where the tag that `text` begins with ends: the place of its `>` or `/>`."""
    quote = ""
    for place, letter in enumerate(text):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        elif letter == ">":
            return place - 1 if text[place - 1] == "/" else place
    raise InputError("the SVG's first tag does not end")
