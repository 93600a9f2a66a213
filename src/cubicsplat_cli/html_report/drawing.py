"""Prepare an SVG for a page: an own file is embedded element by element, any other one as a picture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.etree import ElementTree

from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.metrics import measurable
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.raster.engines import leave_one_out_importance
from cubicsplat_cli.scene import Scene, scaled_scene
from cubicsplat_cli.svg.drawing_reader import drawing_of, holds_drawing
from cubicsplat_cli.svg.own import own_elements
from cubicsplat_cli.svg.scene_reader import curves_of

_SAMPLES = 48  # edges per cubic, as of the exact finish
_SVG = "http://www.w3.org/2000/svg"


@dataclass(frozen=True, eq=False)
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
    for title in root.findall(f"{{{_SVG}}}title"):
        root.remove(title)
    ElementTree.register_namespace("", _SVG)
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
