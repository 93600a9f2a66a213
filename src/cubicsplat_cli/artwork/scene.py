"""A drawing as a scene that the engines render."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.geometry.fine import fine_ring
from cubicsplat_cli.artwork.geometry.outlines import Outline, Ring, reversed_ring, signed_area
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.scene import LayeredScene, Scene, SceneLayer, pack_rings
from cubicsplat_cli.scene.gradients import gradients_of
from cubicsplat_cli.settings import Mode


def picture_of(drawing: Drawing) -> Scene | LayeredScene:
    """`scene_of` a drawing without shading; of one with shading those and the others in layers."""
    if all(shape.shading is None for shape in drawing.shapes):
        return scene_of(drawing)
    layers, plain = [], list[Shape]()
    for shape in drawing.shapes:
        if shape.shading is None:
            plain.append(shape)
        else:
            if plain:
                layers.append(SceneLayer(_part(drawing, plain)))
            layers.append(_shaded(drawing, shape))
            plain = []
    if plain:
        layers.append(SceneLayer(_part(drawing, plain)))
    return LayeredScene(drawing.width, drawing.height, tuple(layers))


def _shaded(drawing: Drawing, shape: Shape) -> SceneLayer:
    """A shape's paint, as far as its box, and its shading, both within its outlines."""
    clip = replace(shape, fill=(255, 255, 255, 255), gradient=None)
    ground = _part(drawing, [replace(shape, outlines=(shape.box(),))])
    return SceneLayer(ground, shape.shading, _part(drawing, [clip]), shape.name)


def _part(drawing: Drawing, shapes: list[Shape]) -> Scene:
    return scene_of(Drawing(drawing.width, drawing.height, tuple(shapes)))


def scene_of(drawing: Drawing) -> Scene:
    """The shapes as closed curves of one or more rings, front to back, without a background (numpy arrays).

    Arcs of primitives become cubics that are true to 1e-5 of a radius. Raises InputError for a drawing without shapes,
    which no scene can be.
    """
    if not drawing.shapes:
        raise InputError("the drawing has no shapes; give one of a picture that is not all transparent")
    front_first = drawing.shapes[::-1]
    points, ring_ends = pack_rings(Mode.CLOSED, [_rings(shape) for shape in front_first])
    # The opacity of a gradient is its stops'.
    fills = np.array([(*s.fill[:3], 255) if s.gradient else s.fill for s in front_first], np.float32)
    fills /= np.float32(255.0)
    return Scene(
        mode=Mode.CLOSED,
        width=drawing.width,
        height=drawing.height,
        points=points,
        colours=np.ascontiguousarray(fills[:, :3]),
        opacities=np.ascontiguousarray(fills[:, 3]),
        half_widths=np.zeros(len(front_first), np.float32),
        ring_ends=ring_ends,
        gradients=gradients_of([shape.gradient for shape in front_first]),
    )


def _rings(shape: Shape) -> list[np.ndarray]:
    """(3m, 2) control points of each ring: the outer one clockwise as seen, holes the other way."""
    return [_points(outline, clockwise=index == 0) for index, outline in enumerate(shape.outlines)]


def _points(outline: Outline, *, clockwise: bool) -> np.ndarray:
    ring = outline if isinstance(outline, Ring) else fine_ring(outline)
    if (signed_area(ring) > 0.0) != clockwise:
        ring = reversed_ring(ring)
    return ring.cubics[:, :3].reshape(-1, 2).astype(np.float32)
