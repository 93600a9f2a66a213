"""Parts of report pages: templates, pictures as data URLs, and SVGs: an own file element by element, any other one as a
picture.

Whatever a template is given is text until the template says otherwise.
"""

from __future__ import annotations

import base64
import io
import math
import re
from functools import lru_cache
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from PIL import Image

from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.metrics import measurable
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.raster.engines import leave_one_out_importance
from cubicsplat_cli.record import record
from cubicsplat_cli.scene import Scene, scaled_scene
from cubicsplat_cli.svg.drawing_reader import drawing_of, holds_drawing
from cubicsplat_cli.svg.elements import SVG
from cubicsplat_cli.svg.own import own_elements
from cubicsplat_cli.svg.scene_reader import curves_of

_BROWSERS_SHOW = {"PNG": "image/png", "JPEG": "image/jpeg", "WEBP": "image/webp", "GIF": "image/gif"}
_MAGIC = (b"\x89PNG", b"\xff\xd8", b"RIFF", b"GIF8")  # of these; others may need a reader that is not there
_ORIENTATION = 0x0112  # EXIF
_QUALITY = 95
THUMBNAIL = 144  # px: 72 on the page, for dense screens
_THUMBNAIL_QUALITY = 80
_INDENTATION = re.compile(r"\n\s+")
_COMMENTS = re.compile(r"(?m)^\s*// .*\n")  # of scripts, on lines of their own
_AROUND = re.compile(r"\s*([{};,])\s*|(:) ")  # what style sheets do not need spaces about
_SAMPLES = 48  # edges per cubic, as of the exact finish


def picture_url(picture: Picture, data: bytes) -> str:
    """A data: URL of the picture. data: the bytes of the file that it was read from.

    Those bytes where a browser shows the same pixels, else WebP: without loss, unless that took more than the file.
    """
    mime = _mime(picture, data)
    if mime is not None:
        return data_url(mime, data)
    image = Image.fromarray(eight_bit_pixels(picture))
    exact = _webp(image, lossless=True)
    return data_url("image/webp", exact if len(exact) <= len(data) else _webp(image, quality=_QUALITY))


def thumbnail_url(pixels: np.ndarray) -> str:
    """A data: URL of (H, W, 3 or 4) uint8, at most THUMBNAIL px a side."""
    image = Image.fromarray(pixels)
    image.thumbnail((THUMBNAIL, THUMBNAIL))
    return data_url("image/webp", _webp(image, quality=_THUMBNAIL_QUALITY))


def picture_data_url(pixels: np.ndarray) -> str:
    """A data: URL of (H, W, 3 or 4) uint8 as WebP, with little loss."""
    return data_url("image/webp", _webp(Image.fromarray(pixels), quality=_QUALITY))


def data_url(mime: str, data: bytes) -> str:
    """The bytes as a URL."""
    return f"data:{mime};base64,{base64.b64encode(data).decode('ascii')}"


def eight_bit_pixels(picture: Picture) -> np.ndarray:
    """(H, W, 3), or straight (H, W, 4) where the picture has transparency; uint8."""
    channels = picture.rgb if picture.alpha is None else np.dstack([picture.rgb, picture.alpha])
    return np.round(channels * 255.0).astype(np.uint8)


def _mime(picture: Picture, data: bytes) -> str | None:
    """The type of the file where a browser shows it as it was read here; None for all that is turned, resized, has
    other colours or more bits.
    """
    if not data.startswith(_MAGIC):
        return None
    with Image.open(io.BytesIO(data)) as image:
        mime = _BROWSERS_SHOW.get(image.format or "")
        turned = image.getexif().get(_ORIENTATION, 1) != 1
        if mime is None or turned or getattr(image, "n_frames", 1) > 1 or image.size != (picture.width, picture.height):
            return None
        plain = np.asarray(image.convert("RGBA"))
    ours = eight_bit_pixels(picture)
    alpha = 255 if picture.alpha is None else ours[..., 3]
    seen = plain[..., 3:] > 0
    same = bool((plain[..., 3] == alpha).all()) and np.array_equal(plain[..., :3] * seen, ours[..., :3] * seen)
    return mime if same else None


def _webp(image: Image.Image, **options: object) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", **options)
    return buffer.getvalue()


def rendered(template: str, **values: Any) -> str:
    """The text of a template, without the spaces that only its authors need; a value that it asks for and does not get
    is an error.
    """
    return _INDENTATION.sub("\n", _environment().get_template(template).render(**values))


class _Shortened(PackageLoader):
    """Loads style sheets and scripts without what only their authors need."""

    def get_source(self, environment: Environment, template: str) -> Any:
        text, *rest = super().get_source(environment, template)
        if template.endswith(".js"):
            text = _COMMENTS.sub("", text)
        elif template.endswith(".css"):
            text = _AROUND.sub(r"\1\2", text)
        return text, *rest


@lru_cache(maxsize=1)
def _environment() -> Environment:
    loader = _Shortened("cubicsplat_cli.html_report")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)


@record
class Shown:
    """An SVG of ours, read by readers that let nothing pass that could act or fetch.

    markup: its elements as HTML takes them. losses_db: for each drawn element in the order of the file, by how many dB
    the PSNR falls without it (below 0: it rises). count: of its curves, or of its shapes, of which one element may hold
    many. kind: the name of one, "curve" of a photo, "shape" of artwork.
    """

    kind: str
    markup: str
    losses_db: list[float]
    count: int


def shown_elements(svg: bytes, picture: Picture, threads: int | None = None) -> Shown | None:
    """The SVG as elements, with what each of them is worth; None where it is none of ours."""
    try:
        kind, scene, names = _scene(svg)
    except InputError:
        return None
    return Shown(kind, _markup(svg), [] if scene is None else _losses(scene, names, picture, threads), len(names))


def _markup(svg: bytes) -> str:
    """The elements alone: what HTML might take for something else (comments, instructions, CDATA) is gone, and so is
    the title, which browsers would show under the pointer.
    """
    root = ElementTree.fromstring(svg)
    for title in root.findall(f"{SVG}title"):
        root.remove(title)
    ElementTree.register_namespace("", SVG[1:-1])
    return ElementTree.tostring(root, encoding="unicode").replace(" />", "/>")


def _scene(svg: bytes) -> tuple[str, Scene | None, list[str]]:
    """Names of its elements, the scene, and for each of its curves, front to back, the element it belongs to;
    InputError for foreign files.
    """
    elements = own_elements(svg)
    if not holds_drawing(elements):
        scene = curves_of(elements)
        return "curve", scene, [str(index) for index in range(scene.curves)]
    drawing = drawing_of(elements)
    # Several shapes in one path share its id.
    names = [shape.name or str(index) for index, shape in enumerate(drawing.shapes)]
    # What a shape is worth beneath its shading says nothing of either.
    plain = drawing.shapes and all(shape.shading is None for shape in drawing.shapes)
    return "shape", (scene_of(drawing) if plain else None), names[::-1]


def _losses(scene: Scene, names: list[str], picture: Picture, threads: int | None) -> list[float]:
    """Loss in dB without each element, back to front."""
    reference = measurable(picture)
    sized = scaled_scene(scene, reference.width, reference.height)
    target = reference.premultiplied() if sized.background is None else reference.premultiplied()[..., :3]
    loss, values = leave_one_out_importance(sized, target, None, _SAMPLES, threads)
    worth = dict.fromkeys(names[::-1], 0.0)
    for name, value in zip(names, values.tolist(), strict=True):
        worth[name] += value
    # A picture without any error has no PSNR; half a step of 8 bits at one pixel is the least error that counts.
    floor = max(loss, (0.5 / 255.0) ** 2)
    return [round(10.0 * math.log10(max(floor + value, 1e-12) / floor), 5) for value in worth.values()]
