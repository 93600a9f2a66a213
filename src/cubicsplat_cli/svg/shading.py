"""The shading of a shape as a group clipped a little inside its outline, and back from there."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring
from cubicsplat_cli.artwork.shapes import Shading
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.markup import GradientElements, Identifiers, format_number, short_colour
from cubicsplat_cli.svg.quantise import OPACITY_DECIMALS, to_grid
from cubicsplat_cli.svg.scene_writer import path_strings

PRECISION = 1  # decimals of px: no edge of the shading is seen but those of the clip, which lies beneath nothing
_UNIT = 10**PRECISION


def add_shading(
    parent: ElementTree.Element, shading: Shading, names: Identifiers, gradients: GradientElements, shape: str
) -> None:
    """Appends the group of a shape's shading, named after the shape's id, and before it what clips it.

    All lengths are whole tenths of a px, which the group's transform brings to px; it counts for the clip as well. The
    group's first element is the ground, in px, as gradients are.
    """
    grid = to_grid(shading.curves, PRECISION)
    fill, gradient = short_colour(*shading.fill[:3]), None
    if shading.gradient is not None:
        fill, gradient = gradients.fill(shading.gradient)
    if gradient is not None:
        parent.append(gradient)
    clip = ElementTree.SubElement(parent, "clipPath", {"id": names.unique(f"{shape}-inside")})
    ElementTree.SubElement(clip, "path", {"d": "".join(_polygon(ring) for ring in shading.clip)})
    attributes = {"id": names.unique(f"{shape}-shading"), "clip-path": f"url(#{clip.attrib['id']})"}
    group = ElementTree.SubElement(parent, "g", attributes)
    ElementTree.SubElement(group, "rect", {**_box(shading.clip), "fill": fill})
    opacities, opaque = grid.opacities.tolist(), 10**OPACITY_DECIMALS
    shared = opacities[0] if grid.one_opacity else opaque
    common = {"transform": f"scale({format_number(1, PRECISION)})"}
    if shared < opaque:
        common["fill-opacity"] = format_number(shared, OPACITY_DECIMALS)
    curves = ElementTree.SubElement(group, "g", common)
    data = path_strings(grid.points, grid.ring_ends, closed=grid.mode is Mode.CLOSED)
    for index in reversed(range(len(data))):
        curve = {"d": data[index], "fill": short_colour(*grid.colours[index].tolist())}
        if opacities[index] != shared:
            curve["fill-opacity"] = format_number(opacities[index], OPACITY_DECIMALS)
        ElementTree.SubElement(curves, "path", curve)


def _polygon(ring: Ring) -> str:
    """The corners of a ring, each relative to the one before."""
    corners = np.rint(ring.anchors * _UNIT).astype(int)
    texts = [f"{format_number(x, PRECISION)} {format_number(y, PRECISION)}" for x, y in corners[:1].tolist()]
    steps = np.diff(corners, axis=0).tolist()
    texts += [f"{format_number(x, PRECISION)} {format_number(y, PRECISION)}" for x, y in steps]
    return f"M{texts[0]}l{' '.join(texts[1:])}z".replace(" -", "-")


def _box(clip: tuple[Ring, ...]) -> dict[str, str]:
    """The attributes of the box of whole px around rings."""
    points = np.concatenate([ring.anchors for ring in clip])
    low, high = np.floor(points.min(axis=0)).astype(int), np.ceil(points.max(axis=0)).astype(int)
    sides = {"x": low[0], "y": low[1], "width": high[0] - low[0], "height": high[1] - low[1]}
    return {name: str(int(value)) for name, value in sides.items()}
