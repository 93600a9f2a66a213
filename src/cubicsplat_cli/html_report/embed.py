"""Parts of report pages: templates, pictures as data URLs, and the elements of SVGs of our own.

Templates escape all values that they do not declare safe.
"""

from __future__ import annotations

import io
import math
import re
from functools import lru_cache
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from PIL import Image

from cubicsplat_cli._version import __version__
from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.metrics import measurable
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.files.marks import PROGRAM
from cubicsplat_cli.files.write import encoded
from cubicsplat_cli.raster.engines import leave_one_out_importance
from cubicsplat_cli.record import record
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import with_channels
from cubicsplat_cli.svg.drawing_reader import drawing_of, holds_drawing
from cubicsplat_cli.svg.elements import SVG
from cubicsplat_cli.svg.own import own_elements
from cubicsplat_cli.svg.scene_reader import curves_of
from cubicsplat_cli.svg.values import uri_of

# Of the formats that browsers show: the types, and the first bytes. Pillow may lack readers of other formats.
_BROWSERS_SHOW = {"PNG": "image/png", "JPEG": "image/jpeg", "WEBP": "image/webp", "GIF": "image/gif"}
_MAGIC = (b"\x89PNG", b"\xff\xd8", b"RIFF", b"GIF8")
_QUALITY = 95
THUMBNAIL = 144  # px: 72 on the page, for dense screens
_SAMPLES = 48  # edges per cubic, as of the exact finish


def picture_url(picture: Picture, data: bytes) -> str:
    """Return a data: URL of the picture. data: the bytes of its file.

    It holds those bytes if a browser shows the same pixels, else a WebP: without loss unless larger than the file.
    """
    mime = _mime(picture, data)
    if mime is not None:
        return uri_of(data, mime)
    image = Image.fromarray(picture.pixels())
    exact = encoded(image, "WEBP", lossless=True)
    return uri_of(exact if len(exact) <= len(data) else encoded(image, "WEBP", quality=_QUALITY), "image/webp")


def thumbnail_url(pixels: np.ndarray) -> str:
    """Return a data: URL of (H, W, 3 or 4) uint8, scaled to at most THUMBNAIL px a side."""
    image = Image.fromarray(pixels)
    image.thumbnail((THUMBNAIL, THUMBNAIL))
    return uri_of(encoded(image, "WEBP", quality=80), "image/webp")


def picture_data_url(pixels: np.ndarray) -> str:
    """Return a data: URL of (H, W, 3 or 4) uint8 as WebP, with little loss."""
    return uri_of(encoded(Image.fromarray(pixels), "WEBP", quality=_QUALITY), "image/webp")


def _mime(picture: Picture, data: bytes) -> str | None:
    """Return the file's type, None if browsers show it other than as read: turned, resized, other colours or bits."""
    if not data.startswith(_MAGIC):
        return None
    with Image.open(io.BytesIO(data)) as image:
        mime = _BROWSERS_SHOW.get(image.format or "")
        turned = image.getexif().get(0x0112, 1) != 1  # EXIF orientation
        if mime is None or turned or getattr(image, "n_frames", 1) > 1 or image.size != (picture.width, picture.height):
            return None
        plain = np.asarray(image.convert("RGBA"))
    ours, visible = with_channels(picture.pixels(), 4, 255), plain[..., 3:] > 0
    same = np.array_equal(plain[..., 3], ours[..., 3])
    return mime if same and np.array_equal(plain[..., :3] * visible, ours[..., :3] * visible) else None


def rendered(template: str, **values: Any) -> bytes:
    """Return the file that a template makes, without indentation. A missing value of the template is an error."""
    values = {"program": PROGRAM, "version": __version__, **values}
    return re.sub(r"\n\s+", "\n", _environment().get_template(template).render(**values)).encode()


class _Shortened(PackageLoader):
    """Loads scripts without their lines of comments, and style sheets without needless spaces."""

    def get_source(self, environment: Environment, template: str) -> Any:
        text, *rest = super().get_source(environment, template)
        if template.endswith(".js"):
            text = re.sub(r"(?m)^\s*// .*\n", "", text)
        elif template.endswith(".css"):
            text = re.sub(r"\s*([{};,])\s*|(:) ", r"\1\2", text)
        return text, *rest


@lru_cache(maxsize=1)
def _environment() -> Environment:
    loader = _Shortened("cubicsplat_cli.html_report")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)


@record
class Shown:
    """An SVG of ours; its readers refuse everything that could act or fetch.

    kind: "curve" for a photo, "shape" for artwork. markup: its elements as HTML. losses_db: for each drawn element, in
    the order of the file, the dB by which the PSNR falls without it (below 0: it rises). count: of its curves, or of
    its shapes, many of which may share one element.
    """

    kind: str
    markup: str
    losses_db: list[float]
    count: int


def shown_elements(svg: bytes, picture: Picture, threads: int | None = None) -> Shown | None:
    """Return the elements of an SVG of ours with their worth; None for other SVGs."""
    try:
        kind, scene, names = _scene(svg)
    except InputError:
        return None
    return Shown(kind, _markup(svg), [] if scene is None else _losses(scene, names, picture, threads), len(names))


def _markup(svg: bytes) -> str:
    """Return the elements alone, without anything that HTML reads differently (comments, instructions, CDATA), and
    without the title, which browsers would show under the pointer.
    """
    root = ElementTree.fromstring(svg)
    for title in root.findall(f"{SVG}title"):
        root.remove(title)
    return ElementTree.tostring(root, encoding="unicode").replace(" />", "/>")


def _scene(svg: bytes) -> tuple[str, Scene | None, list[str]]:
    """Return kind, scene, and the name of each curve's element, front to back. Raises InputError for foreign files."""
    elements = own_elements(svg)
    if not holds_drawing(elements):
        scene = curves_of(elements)
        return "curve", scene, [str(index) for index in range(scene.curves)]
    drawing = drawing_of(elements)
    # The shapes of one path share its id.
    names = [shape.name or str(index) for index, shape in enumerate(drawing.shapes)]
    # Beneath its shading, the worth of a shape has no meaning.
    plain = drawing.shapes and all(shape.shading is None for shape in drawing.shapes)
    return "shape", (scene_of(drawing) if plain else None), names[::-1]


def _losses(scene: Scene, names: list[str], picture: Picture, threads: int | None) -> list[float]:
    """Return the loss in dB without each element, back to front."""
    reference = measurable(picture)
    sized = scene.scaled(reference.width, reference.height)
    target = reference.premultiplied() if sized.background is None else reference.premultiplied()[..., :3]
    loss, values = leave_one_out_importance(sized, target, None, _SAMPLES, threads)
    worth = dict.fromkeys(names[::-1], 0.0)
    for name, value in zip(names, values.tolist(), strict=True):
        worth[name] += value
    # A picture without any error has no PSNR: half a step of 8 bits is the least error that counts.
    floor = max(loss, (0.5 / 255.0) ** 2)
    return [round(10.0 * math.log10(max(floor + value, 1e-12) / floor), 5) for value in worth.values()]
