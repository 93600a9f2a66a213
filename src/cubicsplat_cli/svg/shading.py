"""A shape with shading as a group clipped at its outline, and back from there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Outline, Ring
from cubicsplat_cli.artwork.shapes import Shape
from cubicsplat_cli.scene import EmbeddedImage, Scene, pack_rings
from cubicsplat_cli.scene.paint import Gradient, Rgba
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.markup import Identifiers, format_number, joined, short_colour
from cubicsplat_cli.svg.quantise import OPACITY_DECIMALS, to_grid
from cubicsplat_cli.svg.values import uri_of

# Whole numbers to px: steps a px, and steps that a curve's size has at least, which is the root of its area: rounding
# to a twentieth of it adds 2 % to the error of soft shading and takes 12 % of its bytes.
SCALES = {f"scale({format_number(round(1e4 / steps), 4)})": steps for steps in (1, 2, 5, 10, 20, 50, 100)}
STEPS_OF_SIZE = 20.0
PHOTO_STEPS = 10  # a px at least, of curves with bent sides, which a photo has for its edges
GROUNDS = 2  # rectangles of paint beneath curves
IMAGE_DECIMALS = 2  # px
XLINK = "http://www.w3.org/1999/xlink"
ISOLATED = ".999"  # the opacity of a group that is to be drawn on its own: the largest that all renderers tell from 1


def clipped(elements: Sequence[ElementTree.Element], shape: Shape, names: Identifiers) -> list[ElementTree.Element]:
    """The elements of a shape with shading, of which `elements` are those without: its gradient, what clips it, and a
    group by its name, clipped, that holds its paint and its curves or picture.

    A renderer that clips each element by itself, as cairo does, covers 1 - (1 - c)^n of a pixel of coverage c with n of
    them. So they are in a group of a little less than full opacity, which is clipped as a whole. Cairo clips within
    that group too, so that c times as much is covered; with four layers of paint, two fills and two strokes, that is
    less than c by 0.08 at most.
    """
    *before, element = elements
    assert shape.shading is not None
    paint, name = element.attrib.pop("fill"), element.attrib.pop("id")
    clip = ElementTree.Element("clipPath", {"id": names.unique(f"{name}-outline")})
    clip.append(element)
    group = ElementTree.Element("g", {"id": name, "clip-path": f"url(#{clip.attrib['id']})"})
    whole = ElementTree.SubElement(group, "g", {"opacity": ISOLATED})
    box = shape.box()
    sides = {"x": box.x, "y": box.y, "width": box.width, "height": box.height}
    attributes = {key: str(int(value)) for key, value in sides.items()}
    stroke = {"stroke": paint, "stroke-width": str(int(min(box.width, box.height)))}
    for _ in range(GROUNDS):
        ElementTree.SubElement(whole, "rect", {**attributes, "fill": paint, **stroke})
    whole.append(_image(shape.shading) if isinstance(shape.shading, EmbeddedImage) else _curves(shape.shading))
    return [*before, clip, group]


def _image(image: EmbeddedImage) -> ElementTree.Element:
    box = {"x": image.left, "y": image.top, "width": image.width, "height": image.height}
    attributes = {name: format_number(round(value * 10**IMAGE_DECIMALS), IMAGE_DECIMALS) for name, value in box.items()}
    # SVG 1.1 has no other reference; what knows SVG 2 knows it too.
    attributes |= {"preserveAspectRatio": "none", "xmlns:xlink": XLINK, "xlink:href": uri_of(image.data)}
    return ElementTree.Element("image", attributes)


def without_shading(root: ElementTree.Element) -> int:
    """Replaces the groups of `clipped` in a document by their shapes in their paint alone; returns how many."""
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
    data = path_strings(grid.points, grid.ring_ends, closed=grid.mode is Mode.CLOSED)
    if _straight(scene.points, 0.5 / steps):
        data = [_lines(corners) for corners in grid.points[:, ::3].tolist()]
    for index in reversed(range(len(data))):
        curve = {"d": data[index], "fill": short_colour(*grid.colours[index].tolist())}
        if opacities[index] != shared:
            curve["fill-opacity"] = format_number(opacities[index], OPACITY_DECIMALS)
        ElementTree.SubElement(group, "path", curve)
    return group


def _scale(points: np.ndarray) -> tuple[str, int]:
    """The coarsest of SCALES that is fine enough for curves (N, 3M, 2), and its steps a px."""
    x, y = np.moveaxis(points[:, ::3], 2, 0)
    areas = 0.5 * np.abs((x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1))
    enough = STEPS_OF_SIZE / max(math.sqrt(float(np.median(areas))), 1e-6)
    enough = enough if _straight(points, 0.5 / PHOTO_STEPS) else max(enough, PHOTO_STEPS)
    return next((each for each in SCALES.items() if each[1] >= enough), list(SCALES.items())[-1])


def _straight(points: np.ndarray, off: float) -> bool:
    """Whether all curves (N, 3M, 2) are polygons: their handles are the thirds of their sides, to so many px."""
    anchors = points[:, ::3]
    sides = np.roll(anchors, -1, axis=1) - anchors
    return all(np.allclose(points[:, k::3], anchors + k / 3.0 * sides, atol=off) for k in (1, 2))


def _lines(corners: Sequence[Sequence[int]]) -> str:
    """The path data of a polygon in whole numbers, each corner relative to the one before."""
    steps = [b[axis] - a[axis] for a, b in pairwise(corners) for axis in (0, 1)]
    return f"M{joined(corners[0])}l{joined(steps)}z"


class ShadedShape:
    """The parts of one shape with shading as they are read. size: of the canvas, px."""

    def __init__(self, name: str, outlines: tuple[Outline, ...], size: tuple[int, int]) -> None:
        self._name, self._outlines, self._size = name, outlines, size
        self._ground: tuple[Rgba, Gradient | None] | None = None
        self._curves: list[tuple[Ring, Rgba]] = []
        self._image: EmbeddedImage | None = None

    def add_ground(self, fill: Rgba, gradient: Gradient | None) -> None:
        """The paint beneath the curves. Raises ValueError where there is another already, or it shines through."""
        if self._ground not in (None, (fill, gradient)) or fill[3] != 255:
            raise ValueError("is another ground of a shading, or not opaque")
        self._ground = fill, gradient

    def add_curve(self, ring: Ring, steps: int, colour: tuple[int, int, int], opacity: float) -> None:
        """A curve in front of those before, in so many steps a px."""
        moved = Ring(ring.anchors / steps, ring.controls / steps, ring.lines, ring.smooth)
        self._curves.append((moved, (*colour, opacity)))  # type: ignore[arg-type]

    def add_image(self, box: tuple[float, float, float, float], data: bytes) -> None:
        """A picture in place of curves. Raises ValueError where there are such already."""
        if self._image is not None or self._curves:
            raise ValueError("is an image beside another one or curves")
        self._image = EmbeddedImage(self._size, *box, data)

    def shape(self) -> Shape:
        """What was read. Raises ValueError where the ground, or curves and a picture, are missing."""
        if self._ground is not None and self._image is not None and not self._curves:
            fill, gradient = self._ground
            return Shape(fill, self._outlines, self._name, gradient, shading=self._image)
        if self._ground is None or not self._curves or self._image is not None:
            raise ValueError("has a shading without a ground or without curves")
        front_first = self._curves[::-1]
        rings = [[ring.cubics[:, :3].reshape(-1, 2).astype(np.float32)] for ring, _ in front_first]
        points, ring_ends = pack_rings(Mode.CLOSED, rings)
        fills = np.array([fill for _, fill in front_first], np.float32)
        scene = Scene(
            Mode.CLOSED, *self._size, points.astype(np.float32), fills[:, :3] / np.float32(255.0),
            np.ascontiguousarray(fills[:, 3]), np.zeros(len(rings), np.float32), ring_ends=ring_ends,
        )  # fmt: skip
        fill, gradient = self._ground
        return Shape(fill, self._outlines, self._name, gradient, shading=scene)
