"""Polygons on a coarse grid as the shortest SVG, a placeholder of a few hundred bytes for a photo.

The file holds nothing but a view box, a background and paths. It has no size, comment, title, ids or decimals, one
opacity for all, and colours of 12 bits. Paths are relative, since most differences have one digit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.shapes import polygon_points
from cubicsplat_cli.svg.markup import format_number, joined

LEVELS = 15  # of a colour channel of 4 bits
TENTHS = 10  # of the opacity


@dataclass(eq=False)
class GridPolygons:
    """N polygons, front to back, on a grid.

    size: width and height in units; the height may have two decimals, so that the picture keeps its shape. vertices:
    (n, 2) int64 of each polygon, units. colours: (N, 3) int64 in 0..15. background: (3,) in 0..15, or None. opacity:
    of all polygons, 1..10 tenths.
    """

    size: tuple[float, float]
    vertices: list[np.ndarray]
    colours: np.ndarray
    background: np.ndarray | None
    opacity: int

    def path(self, index: int) -> str:
        """Return the element of one polygon; each vertex after the first is relative to the one before."""
        vertices = self.vertices[index].tolist()
        befores = [[0, 0], *vertices]
        d = joined(n for (x, y), (a, b) in zip(vertices, befores, strict=False) for n in (x - a, y - b))
        return f'<path d="m{d}" fill="{_hex(self.colours[index])}"/>'

    def head(self) -> str:
        """Return the document up to its first polygon."""
        size = " ".join(format_number(round(100 * side), 2) for side in self.size)
        opacity = f' fill-opacity="{format_number(self.opacity, 1)}"' if self.opacity < TENTHS else ""
        start = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}"{opacity}>'
        if self.background is None:
            return start
        width, height = (math.ceil(side) for side in self.size)
        opaque = opacity and ' fill-opacity="1"'
        return f'{start}<path d="m0 0h{width}v{height}H0" fill="{_hex(self.background)}"{opaque}/>'

    def text(self) -> str:
        """Return the SVG document, back to front."""
        return self.head() + "".join(map(self.path, reversed(range(len(self.vertices))))) + "</svg>"

    def scene(self, width: int, height: int) -> Scene:
        """Return the polygons as a scene on a canvas of width x height px."""
        scale = np.array([width, height]) / self.size
        rings = [[polygon_points(vertices[None] * scale)[0].astype(np.float32)] for vertices in self.vertices]
        fills = np.pad(self.colours / LEVELS, ((0, 0), (0, 1)), constant_values=self.opacity / TENTHS)
        background = None if self.background is None else tuple((self.background / LEVELS).tolist())
        return Scene.filled(width, height, rings, fills.astype(np.float32), background)


def grid_size(width: int, height: int, units: int) -> tuple[float, float]:
    """Return the size of a grid of about `units` units, at most 99, on the longer side.

    Of the sizes within a twentieth it is the one on which the sides of the picture are nearest to whole units.
    """
    longer, shorter = max(width, height), min(width, height)
    choices = range(max(1, math.ceil(0.95 * units)), min(99, math.floor(1.05 * units)) + 1)
    best = min(choices, key=lambda n: (abs(n * shorter / longer - round(n * shorter / longer)), -n))
    other = max(0.01, round(best * shorter / longer, 2))
    return (best, other) if width >= height else (other, best)


def polygons_on_grid(scene: Scene, size: tuple[float, float]) -> GridPolygons:
    """Return the polygons of a scene of numpy arrays, rounded to a grid; the anchors of its curves are the vertices."""
    vertices = np.rint(scene.points[:, ::3] * (np.array(size) / (scene.width, scene.height))).astype(np.int64)
    background = None if scene.background is None else np.rint(LEVELS * np.array(scene.background)).astype(np.int64)
    colours = np.rint(LEVELS * scene.colours).astype(np.int64)
    opacity = int(np.clip(round(TENTHS * float(scene.opacities.mean())), 1, TENTHS))
    return GridPolygons(size, list(vertices), colours, background, opacity)


def _hex(colour: np.ndarray) -> str:
    return "#" + "".join(f"{value:x}" for value in colour.tolist())
