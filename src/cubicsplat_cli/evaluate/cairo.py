"""Drawing by cairosvg into memory of ours: no PNG between, and any part of the picture."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType

import numpy as np

from cubicsplat_cli.errors import InputError

# Where red, green, blue and alpha are in a pixel as cairo has it: a native 32-bit number, alpha first.
RGBA = [2, 1, 0, 3] if sys.byteorder == "little" else [1, 2, 3, 0]
_STRIP_PIXELS = 2**18


def refuse_url(url: str, _resource_type: str) -> bytes:
    """What cairosvg is to call where an SVG refers to something: raises InputError."""
    raise InputError(f"the SVG refers to {url[:80]}, which is never fetched")


def draw(
    module: ModuleType, svg: bytes, width: int, height: int, part: tuple[int, int, int, int] | None = None
) -> np.ndarray:
    """An SVG drawn at width x height px, or a part of that: left, top, width and height in px.

    Returns (h, w, 4) uint8 premultiplied, its channels where RGBA says. module: cairosvg. Raises InputError for an
    empty SVG, and whatever cairosvg raises.
    """
    # An empty bytestring would make cairosvg take a URL, which here is none.
    if not svg:
        raise InputError("the SVG is empty")
    left, top, part_width, part_height = part or (0, 0, width, height)
    surfaces = importlib.import_module(f"{module.__name__}.surface")
    trees = importlib.import_module(f"{module.__name__}.parser")
    cairo = surfaces.cairo
    pixels = np.zeros((part_height, part_width, 4), np.uint8)
    memory = pixels.reshape(-1).data

    class OnPixels(surfaces.PNGSurface):  # type: ignore[misc, name-defined]
        def _create_surface(self, whole_width: float, whole_height: float) -> tuple[object, float, float]:
            surface = cairo.ImageSurface(cairo.FORMAT_ARGB32, part_width, part_height, memory, 4 * part_width)
            surface.set_device_offset(-left, -top)
            return surface, whole_width, whole_height

    tree = trees.Tree(bytestring=svg, unsafe=False, url_fetcher=refuse_url)
    drawn = OnPixels(tree, None, 96, output_width=width, output_height=height)
    drawn.cairo.finish()
    return pixels


def make_straight(pixels: np.ndarray) -> None:
    """Turn what `draw` returns into straight RGBA, in its place and rounded as cairo does when it writes a PNG."""
    rows = max(1, _STRIP_PIXELS // pixels.shape[1])
    for top in range(0, pixels.shape[0], rows):
        part = pixels[top : top + rows]
        straight = part[..., RGBA]
        alpha = straight[..., 3:]
        if int(alpha.min()) < 255:
            colours = straight[..., :3] * np.uint16(255) + alpha // 2
            straight[..., :3] = colours // np.maximum(alpha, 1)
        part[:] = straight
