"""Writes a shape with shading as a group that is clipped at its outline."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.artwork.shapes import Shape
from cubicsplat_cli.scene import EmbeddedImage, Scene
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.markup import Identifiers, format_number, joined, short_colour
from cubicsplat_cli.svg.quantise import to_grid
from cubicsplat_cli.svg.values import OPACITY_DECIMALS, uri_of

# Transforms of whole numbers to px, by steps per px. The square root of a curve's area has at least STEPS_OF_SIZE
# steps: rounding to a twentieth adds 2 % to the error of soft shading and saves 12 % of its bytes.
SCALES = {f"scale({format_number(round(1e4 / steps), 4)})": steps for steps in (1, 2, 5, 10, 20, 50, 100)}
STEPS_OF_SIZE = 20.0
PHOTO_STEPS = 10  # steps per px at least for curves with bent sides, which follow the edges in a photo
GROUNDS = 2  # rectangles of paint beneath curves
IMAGE_DECIMALS = 2  # px
XLINK = "http://www.w3.org/1999/xlink"
ISOLATED = ".999"  # opacity of a group that is drawn on its own: the largest that all renderers tell from 1


def clipped(elements: Sequence[ElementTree.Element], shape: Shape, names: Identifiers) -> list[ElementTree.Element]:
    """Return the elements of a shape with shading from those without it.

    They are its gradient, its clip path, and a clipped group with its name that holds its paint and its curves or
    picture.

    A renderer that clips each element by itself, as cairo does, covers 1 - (1 - c)^n of a pixel of coverage c with n
    elements. A group of a little less than full opacity is clipped as a whole. Cairo also clips within that group,
    which multiplies the coverage by c again; four layers of paint, two fills and two strokes, bring it back to within
    0.08 of c.
    """
    *before, element = elements
    assert shape.shading is not None
    paint, name = element.attrib.pop("fill"), element.attrib.pop("id")
    clip = ElementTree.Element("clipPath", {"id": names.unique(f"{name}-outline")})
    clip.append(element)
    group = ElementTree.Element("g", {"id": name, "clip-path": f"url(#{clip.attrib['id']})"})
    whole = ElementTree.SubElement(group, "g", {"opacity": ISOLATED})
    box = shape.box()
    sides = {side: str(int(getattr(box, side))) for side in ("x", "y", "width", "height")}
    stroke = {"stroke": paint, "stroke-width": str(int(min(box.width, box.height)))}
    for _ in range(GROUNDS):
        ElementTree.SubElement(whole, "rect", {**sides, "fill": paint, **stroke})
    whole.append(_image(shape.shading) if isinstance(shape.shading, EmbeddedImage) else _curves(shape.shading))
    return [*before, clip, group]


def _image(image: EmbeddedImage) -> ElementTree.Element:
    box = {"x": image.left, "y": image.top, "width": image.width, "height": image.height}
    attributes = {name: format_number(round(value * 10**IMAGE_DECIMALS), IMAGE_DECIMALS) for name, value in box.items()}
    # SVG 1.1 has no other reference, and SVG 2 keeps it.
    attributes |= {"preserveAspectRatio": "none", "xmlns:xlink": XLINK, "xlink:href": uri_of(image.data)}
    return ElementTree.Element("image", attributes)


def without_shading(root: ElementTree.Element) -> int:
    """Replace the groups of `clipped` in a document by their shapes in their paint alone; return how many."""
    clips = {f"url(#{clip.get('id')})": clip for clip in root if clip.tag.endswith("clipPath") and len(clip)}
    replaced = 0
    for index, group in enumerate(root):
        paint = group.find(f"*[@opacity='{ISOLATED}']/*[@stroke-width]")
        if paint is not None and group.get("clip-path") in clips:
            root[index] = clips[group.attrib["clip-path"]][0]
            root[index].attrib.update({"id": group.get("id", ""), "fill": paint.get("fill", "")})
            replaced += 1
    return replaced


def _curves(scene: Scene) -> ElementTree.Element:
    from cubicsplat_cli.svg.scene_writer import path_strings  # which most drawings do not need

    scale, steps = _scale(scene.points)
    grid = to_grid(replace(scene, points=scene.points * np.float32(steps)), 0)
    opacities, opaque = grid.opacities.tolist(), 10**OPACITY_DECIMALS
    shared = max(set(opacities), key=opacities.count)
    group = ElementTree.Element("g", {"transform": scale})
    if shared < opaque:
        group.set("fill-opacity", format_number(shared, OPACITY_DECIMALS))
    if _straight(scene.points, 0.5 / steps):
        data = [_polygon(corners) for corners in grid.points[:, ::3].tolist()]
    else:
        data = path_strings(grid.points, grid.ring_ends, closed=scene.mode is Mode.CLOSED)
    for index in reversed(range(len(data))):
        curve = {"d": data[index], "fill": short_colour(*grid.colours[index].tolist())}
        if opacities[index] != shared:
            curve["fill-opacity"] = format_number(opacities[index], OPACITY_DECIMALS)
        ElementTree.SubElement(group, "path", curve)
    return group


def _scale(points: np.ndarray) -> tuple[str, int]:
    """Return the coarsest of SCALES that is fine enough for curves (N, 3M, 2), and its steps per px."""
    x, y = np.moveaxis(points[:, ::3], 2, 0)
    areas = 0.5 * np.abs((x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1))
    enough = STEPS_OF_SIZE / max(math.sqrt(float(np.median(areas))), 1e-6)
    enough = enough if _straight(points, 0.5 / PHOTO_STEPS) else max(enough, PHOTO_STEPS)
    return next((scale for scale in SCALES.items() if scale[1] >= enough), list(SCALES.items())[-1])


def _straight(points: np.ndarray, off: float) -> bool:
    """True if all curves (N, 3M, 2) are polygons: their handles are at the thirds of their sides, within `off` px."""
    anchors = points[:, ::3]
    sides = np.roll(anchors, -1, axis=1) - anchors
    return all(np.allclose(points[:, k::3], anchors + k / 3.0 * sides, atol=off) for k in (1, 2))


def _polygon(corners: Sequence[Sequence[int]]) -> str:
    """Return the path data of a polygon in whole numbers, each corner relative to the one before."""
    steps = [b[axis] - a[axis] for a, b in pairwise(corners) for axis in (0, 1)]
    return f"M{joined(corners[0])}l{joined(steps)}z"
