"""The shading of a shape as a group clipped a little inside its outline, and back from there."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring
from cubicsplat_cli.artwork.shapes import Shading
from cubicsplat_cli.scene import EmbeddedImage, Scene, pack_rings
from cubicsplat_cli.scene.paint import Gradient, Rgba
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.embedded import uri_of
from cubicsplat_cli.svg.markup import GradientElements, Identifiers, format_number, short_colour
from cubicsplat_cli.svg.quantise import OPACITY_DECIMALS, to_grid

PRECISION = 1  # decimals of px: edges within the shading are soft
SCALE = f"scale({format_number(1, PRECISION)})"  # whole numbers to px
REFERENCE = re.compile(r"url\(#([A-Za-z0-9_.-]+)\)")
SHADING = "-shading"  # the end of a group's name
_UNIT = 10**PRECISION
XLINK = "http://www.w3.org/1999/xlink"


def add_shading(
    parent: ElementTree.Element, shading: Shading, names: Identifiers, gradients: GradientElements, shape: str
) -> None:
    """Appends the group of a shape's shading, named after the shape's id, and before it what clips it.

    The group holds its ground, a rectangle, and the group of its curves, whose numbers are whole tenths of a px, or an
    embedded picture.
    """
    fill, gradient = short_colour(*shading.fill[:3]), None
    if shading.gradient is not None:
        fill, gradient = gradients.fill(shading.gradient)
    if gradient is not None:
        parent.append(gradient)
    clip = ElementTree.SubElement(parent, "clipPath", {"id": names.unique(f"{shape}-inside")})
    ElementTree.SubElement(clip, "path", {"d": "".join(_polygon(ring) for ring in shading.clip)})
    attributes = {"id": names.unique(f"{shape}{SHADING}"), "clip-path": f"url(#{clip.attrib['id']})"}
    group = ElementTree.SubElement(parent, "g", attributes)
    ElementTree.SubElement(group, "rect", {**_box(shading.clip), "fill": fill})
    group.append(_image(shading.curves) if isinstance(shading.curves, EmbeddedImage) else _curves(shading.curves))


def _image(image: EmbeddedImage) -> ElementTree.Element:
    box = {"x": image.left, "y": image.top, "width": image.width, "height": image.height}
    attributes = {name: format_number(round(value * _UNIT), PRECISION) for name, value in box.items()}
    # SVG 1.1 has no other reference; what knows SVG 2 knows it too.
    attributes |= {"preserveAspectRatio": "none", "xmlns:xlink": XLINK, "xlink:href": uri_of(image.data)}
    return ElementTree.Element("image", attributes)


def _curves(scene: Scene) -> ElementTree.Element:
    from cubicsplat_cli.svg.scene_writer import path_strings  # which most drawings do not need

    grid = to_grid(scene, PRECISION)
    opacities, opaque = grid.opacities.tolist(), 10**OPACITY_DECIMALS
    shared = max(set(opacities), key=opacities.count)
    group = ElementTree.Element("g", {"transform": SCALE})
    if shared < opaque:
        group.set("fill-opacity", format_number(shared, OPACITY_DECIMALS))
    data = path_strings(grid.points, grid.ring_ends, closed=grid.mode is Mode.CLOSED)
    if _straight(scene.points):
        data = [_lines(corners) for corners in grid.points[:, ::3].tolist()]
    for index in reversed(range(len(data))):
        curve = {"d": data[index], "fill": short_colour(*grid.colours[index].tolist())}
        if opacities[index] != shared:
            curve["fill-opacity"] = format_number(opacities[index], OPACITY_DECIMALS)
        ElementTree.SubElement(group, "path", curve)
    return group


def _straight(points: np.ndarray) -> bool:
    """Whether all curves (N, 3M, 2) are polygons: their handles are the thirds of their sides."""
    anchors = points[:, ::3]
    sides = np.roll(anchors, -1, axis=1) - anchors
    return all(np.allclose(points[:, k::3], anchors + k / 3.0 * sides, atol=0.5 / _UNIT) for k in (1, 2))


def _lines(corners: Sequence[Sequence[int]]) -> str:
    """The path data of a polygon in whole numbers, each corner relative to the one before."""
    (x, y), *_ = corners
    steps = [f"{b[0] - a[0]} {b[1] - a[1]}" for a, b in pairwise(corners)]
    return f"M{x} {y}l{' '.join(steps)}z".replace(" -", "-")


def _polygon(ring: Ring) -> str:
    """The path data of a polygon in px."""
    corners = np.rint(ring.anchors * _UNIT).astype(int)
    numbers = [[format_number(value, PRECISION) for value in corner] for corner in corners[:1].tolist()]
    numbers += [[format_number(v, PRECISION) for v in step] for step in np.diff(corners, axis=0).tolist()]
    first, *others = [" ".join(pair) for pair in numbers]
    return f"M{first}l{' '.join(others)}z".replace(" -", "-")


def _box(clip: tuple[Ring, ...]) -> dict[str, str]:
    """The attributes of the box of whole px around rings."""
    points = np.concatenate([ring.anchors for ring in clip])
    low, high = np.floor(points.min(axis=0)).astype(int), np.ceil(points.max(axis=0)).astype(int)
    sides = {"x": low[0], "y": low[1], "width": high[0] - low[0], "height": high[1] - low[1]}
    return {name: str(int(value)) for name, value in sides.items()}


class ShadingReader:
    """The parts of one group of shading as they are read. size: of the canvas, px."""

    def __init__(self, clip: tuple[Ring, ...], size: tuple[int, int]) -> None:
        self._clip, self._size = clip, size
        self._ground: tuple[Rgba, Gradient | None] | None = None
        self._curves: list[tuple[Ring, Rgba]] = []
        self._image: EmbeddedImage | None = None

    def add_ground(self, fill: Rgba, gradient: Gradient | None) -> None:
        """The paint beneath the curves. Raises ValueError where there is one already, or one that shines through."""
        if self._ground is not None or fill[3] != 255:
            raise ValueError("is a second ground of a shading, or not opaque")
        self._ground = fill, gradient

    def add_curve(self, ring: Ring, colour: tuple[int, int, int], opacity: float) -> None:
        """A curve in front of those before, in whole units of the file."""
        moved = Ring(ring.anchors / _UNIT, ring.controls / _UNIT, ring.lines, ring.smooth)
        self._curves.append((moved, (*colour, opacity)))  # type: ignore[arg-type]

    def add_image(self, box: tuple[float, float, float, float], data: bytes) -> None:
        """A picture in place of curves. Raises ValueError where there are such already."""
        if self._image is not None or self._curves:
            raise ValueError("is an image beside another one or curves")
        self._image = EmbeddedImage(self._size, *box, data)

    def shading(self) -> Shading:
        """What was read. Raises ValueError where the ground, or curves and a picture, are missing."""
        if self._ground is not None and self._image is not None and not self._curves:
            return Shading(self._clip, *self._ground, self._image)
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
        return Shading(self._clip, *self._ground, scene)
