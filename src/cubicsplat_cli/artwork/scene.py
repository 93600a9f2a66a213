"""Drawings as scenes for the engines."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import FINE
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.scene import LayeredScene, Scene, SceneLayer
from cubicsplat_cli.scene.gradients import gradients_of


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
    fills = np.array([(*s.fill[:3], 255) if s.gradient else s.fill for s in front_first], np.float32)
    rings = [[ring.cubics[:, :3].reshape(-1, 2).astype(np.float32) for ring in s.oriented(FINE)] for s in front_first]
    scene = Scene.filled(drawing.width, drawing.height, rings, fills / np.float32(255.0))
    return replace(scene, gradients=gradients_of([shape.gradient for shape in front_first]))
