"""Drawings as scenes for the engines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import FINE
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.scene import LayeredScene, Scene, SceneLayer, pack_rings
from cubicsplat_cli.scene.gradients import gradients_of
from cubicsplat_cli.scene.paint import Rgba
from cubicsplat_cli.settings import Mode


def picture_of(drawing: Drawing) -> Scene | LayeredScene:
    """Return a drawing as a scene; in layers if shapes have shading."""
    if all(shape.shading is None for shape in drawing.shapes):
        return scene_of(drawing)
    layers = list[SceneLayer]()
    for plain, group in groupby(drawing.shapes, lambda shape: shape.shading is None):
        shapes = list(group)
        layers += [SceneLayer(_part(drawing, shapes))] if plain else [_shaded(drawing, shape) for shape in shapes]
    return LayeredScene(drawing.width, drawing.height, tuple(layers))


def _shaded(drawing: Drawing, shape: Shape) -> SceneLayer:
    """Return a layer of a shape's paint and shading, both clipped at its outlines."""
    clip = replace(shape, fill=(255, 255, 255, 255), gradient=None)
    ground = _part(drawing, [replace(shape, outlines=(shape.box(),))])
    return SceneLayer(ground, shape.shading, _part(drawing, [clip]))


def _part(drawing: Drawing, shapes: list[Shape]) -> Scene:
    return scene_of(Drawing(drawing.width, drawing.height, tuple(shapes)))


def scene_of(drawing: Drawing) -> Scene:
    """Return the shapes as closed curves of one or more rings, front to back, without a background (numpy arrays). Arcs
    of primitives become cubics, true to 1e-5 of a radius. Raises InputError for a drawing without shapes.
    """
    if not drawing.shapes:
        raise InputError("the drawing has no shapes; give one of a picture that is not all transparent")
    front_first = drawing.shapes[::-1]
    # A gradient's opacity is that of its stops.
    fills = [(*s.fill[:3], 255) if s.gradient else s.fill for s in front_first]
    rings = [[ring.cubics[:, :3].reshape(-1, 2).astype(np.float32) for ring in s.oriented(FINE)] for s in front_first]
    scene = filled_scene(drawing.width, drawing.height, rings, fills)
    return replace(scene, gradients=gradients_of([shape.gradient for shape in front_first]))


def filled_scene(width: int, height: int, rings: list[list[np.ndarray]], fills: Sequence[Rgba]) -> Scene:
    """Return closed curves, front to back, of rings (3m, 2) px and 8-bit fills, without a background."""
    points, ring_ends = pack_rings(Mode.CLOSED, rings)
    colours = np.array(fills, np.float32) / np.float32(255.0)
    rgb, opacities = np.ascontiguousarray(colours[:, :3]), np.ascontiguousarray(colours[:, 3])
    half_widths = np.zeros(len(fills), np.float32)
    return Scene(Mode.CLOSED, width, height, points, rgb, opacities, half_widths, ring_ends=ring_ends)
