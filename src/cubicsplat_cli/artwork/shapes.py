"""A drawing: shapes from back to front, each in a fill, opaque or translucent, or in a gradient, and their names."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from cubicsplat_cli.artwork.channels import widened
from cubicsplat_cli.artwork.geometry.outlines import Outline, Rectangle, Ring, extent_of, pieces_of_rings, turned_to
from cubicsplat_cli.artwork.geometry.stroke import Chain, Path, Stroke, outlines_of_stroke, pieces_of
from cubicsplat_cli.raster.outlines import coverage
from cubicsplat_cli.scene import EmbeddedImage, Scene
from cubicsplat_cli.scene.paint import Gradient, Paint, Rgba, colours_in, mean_fill

AnyLine = TypeVar("AnyLine", Outline, Path)
PRICE = 4.0  # nats that a number of a drawing costs in its description
FILL_PARAMETERS = SHAPE_PARAMETERS = 3.0  # numbers of a new fill, and of a shape besides its outlines'
# The names of hues, up to these degrees.
_HUES = {
    15: "red", 42: "orange", 68: "yellow", 160: "green", 195: "teal", 255: "blue", 290: "purple", 335: "pink",
    361: "red",
}  # fmt: skip


@dataclass(frozen=True)
class Shape:
    """One shape in one fill, or in a gradient.

    fill: sRGB and opacity, 8 bits each, not premultiplied; about the mean of a gradient. outlines: the outer one, then
    its holes, in either direction (see `oriented`). name: for an editor's list of layers. gradient: in px of the
    drawing, or None. stroke: the stroke with these outlines, or None. group: the name of its group in the file, or
    empty. shading: None, or curves on the drawing's canvas without a background, or a picture; it lies over the paint,
    which is opaque then, and shows within the outlines alone.
    """

    fill: Rgba
    outlines: tuple[Outline, ...]
    name: str
    gradient: Gradient | None = None
    stroke: Stroke | None = None
    group: str = ""
    shading: Scene | EmbeddedImage | None = None
    over: tuple[Gradient, ...] = ()

    @property
    def paint(self) -> Paint:
        """Its gradient, or else its fill."""
        return self.gradient or self.fill

    @property
    def paths(self) -> tuple[Path, ...]:
        """The outlines, or the centre line of a stroke."""
        return self.outlines if self.stroke is None else (self.stroke.path,)

    def oriented(self, arcs: int = 4) -> tuple[Ring, ...]:
        """Return the rings of the outlines, the first one clockwise as seen and the others the other way: the nonzero
        rule leaves holes empty. arcs: the cubics of a whole turn.
        """
        return tuple(turned_to(outline.ring(arcs), index == 0) for index, outline in enumerate(self.outlines))

    def filled(self, paint: Paint, width: int, height: int) -> Shape:
        """Return the shape in a paint alone, a fill if that has one colour, with its name on a canvas of width x height
        px.
        """
        fill, gradient = (paint, None) if isinstance(paint, tuple) else (mean_fill(paint), paint)
        gradient = gradient if len(set(colours_in(paint))) > 1 else None
        name = shape_name(fill, self.outlines, width, height)
        return replace(self, fill=fill, gradient=gradient, over=(), name=name)

    def stroked(self, stroke: Stroke) -> Shape:
        """Return the shape as a stroke."""
        return replace(self, outlines=outlines_of_stroke(stroke), stroke=stroke)

    def coverage(self, top: int, left: int, height: int, width: int) -> np.ndarray:
        """Return (height, width) the share of each pixel from a row and a column on that the outlines cover."""
        return coverage(*pieces_of_rings(self.oriented()), top, left, height, width)

    def box(self) -> Rectangle:
        """Return the box of whole px around the outlines."""
        low, high = extent_of([outline.ring() for outline in self.outlines])
        (left, top), (right, bottom) = np.floor(low), np.ceil(high)
        return Rectangle(float(left), float(top), float(right - left), float(bottom - top))

    @property
    def window(self) -> tuple[int, int, int, int]:
        """The first row and column of its box, and how many of these it has."""
        box = self.box()
        return int(box.y), int(box.x), int(box.height), int(box.width)

    def covered(self, size: tuple[int, ...], room: int = 0) -> tuple[tuple[slice, slice], np.ndarray]:
        """Return the rows and columns of a canvas of size (H, W) that its box reaches, with `room` px around them, and
        the share (h, w) of each pixel of these that the outlines cover.
        """
        box = self.box()
        ends = np.maximum([[box.y, box.y + box.height], [box.x, box.x + box.width]], 0.0).astype(int).tolist()
        rows, columns = window = widened(tuple(slice(*each) for each in ends), room, size)
        sides = (max(side.stop - side.start, 0) for side in window)  # none beyond the canvas
        return window, self.coverage(rows.start, columns.start, *sides)


@dataclass(frozen=True)
class Drawing:
    """Shapes back to front on a canvas of width x height px, which is transparent elsewhere.

    abutting: shapes overlap only on purpose, beneath later ones, and those that touch share edges to the last digit.
    banded: some fills are bands of shading.
    """

    width: int
    height: int
    shapes: tuple[Shape, ...]
    abutting: bool = False
    banded: bool = False

    @property
    def fills(self) -> tuple[Rgba, ...]:
        """Return the different fills of shapes without a gradient, in the order of first use."""
        return tuple(dict.fromkeys(shape.fill for shape in self.shapes if shape.gradient is None))

    @property
    def gradients(self) -> tuple[Gradient, ...]:
        """Return the different gradients, in the order of first use."""
        return tuple(dict.fromkeys(shape.gradient for shape in self.shapes if shape.gradient is not None))

    @property
    def segments(self) -> int:
        """Return the number of lines and cubics of the outlines, with primitives as their rings."""
        return sum(path.pieces for shape in self.shapes for path in shape.paths)

    @property
    def coordinates(self) -> int:
        """Return the number of coordinates that an artist would write for the outlines."""
        lines = (shape.outlines if shape.stroke is None else (shape.stroke,) for shape in self.shapes)
        twice = sum(fill.outlines[0].coordinates for fill, stroke in pairwise(self.shapes) if is_framed(fill, stroke))
        return sum(line.coordinates for own in lines for line in own) - twice

    def painted(self) -> Drawing:
        """Return the drawing whose placeholders become the mean colours of their gradients, each gradient a shape."""
        shapes = list[Shape]()
        for shape in self.shapes:
            shapes += [shape.filled(g, self.width, self.height) for g in (shape.gradient, *shape.over) if g] or [shape]
        return replace(self, shapes=tuple(shapes))


def is_framed(fill: Shape, stroke: Shape) -> bool:
    """Return whether a stroke runs along the only outline of a fill: in a file both are one element."""
    if stroke.stroke is None or fill.stroke is not None or fill.shading is not None or fill.group != stroke.group:
        return False
    path, *holes = fill.outlines
    return not holes and np.array_equal(path.ring().cubics, pieces_of(stroke.stroke.path)[0])


def ground_shape(fill: Rgba, width: int, height: int) -> Shape:
    """Return a rectangle of one fill over a whole canvas."""
    return Shape(fill, (Rectangle(0.0, 0.0, float(width), float(height)),), "").filled(fill, width, height)


def scaled_drawing(drawing: Drawing, width: int, height: int) -> Drawing:
    """Return the drawing on a canvas of width x height px; the same object if it has that size already.

    Sides are scaled independently, so that a canvas with rounded sides fits again. Primitives stay primitives if both
    factors are alike to a thousandth, else they become rings.
    """
    if (drawing.width, drawing.height) == (width, height):
        return drawing
    across, down = width / drawing.width, height / drawing.height
    shapes = tuple(
        replace(
            shape,
            outlines=tuple(scaled_outline(outline, across, down) for outline in shape.outlines),
            gradient=shape.gradient and shape.gradient.scaled(across, down),
            # A pen is round, so under different factors only its outline remains.
            stroke=_scaled_stroke(shape.stroke, across) if shape.stroke and _alike(across, down) else None,
            shading=shape.shading and shape.shading.scaled(width, height),
        )
        for shape in drawing.shapes
    )
    return replace(drawing, width=width, height=height, shapes=shapes)


def _alike(across: float, down: float) -> bool:
    return abs(across / down - 1.0) <= 1e-3


def _scaled_stroke(stroke: Stroke, factor: float) -> Stroke:
    width, *dashes, offset = (factor * length for length in (stroke.width, *stroke.dashes, stroke.offset))
    return Stroke(scaled_outline(stroke.path, factor, factor), width, stroke.cap, stroke.join, tuple(dashes), offset)


def scaled_outline(outline: AnyLine, across: float, down: float) -> AnyLine:
    """Return an outline, or a centre line, with its x times `across` and its y times `down`."""
    if not _alike(across, down) and not isinstance(outline, Chain):
        outline = outline.ring()
    if isinstance(outline, (Ring, Chain)):
        factors = np.array([across, down])
        changed: dict[str, Any] = {"anchors": outline.anchors * factors, "controls": outline.controls * factors}
        if isinstance(outline, Ring) and outline.otherwise is not None:
            changed["otherwise"] = scaled_outline(outline.otherwise, across, down)
        return replace(outline, **changed)
    # All numbers of a primitive except its angle are lengths.
    return replace(outline, **{f.name: getattr(outline, f.name) * across for f in fields(outline) if f.name != "angle"})


def shape_name(fill: Rgba, outlines: tuple[Outline, ...], width: int, height: int) -> str:
    """Return "background" for a rectangle over the whole canvas, else the name of the fill's colour."""
    first = outlines[0]
    if isinstance(first, Rectangle) and first.width >= width - 0.5 and first.height >= height - 0.5:
        return "background"
    return colour_name(fill)


def colour_group(fill: Rgba) -> str:
    """Return the name of a group of one colour, `color-ff8800`, with two more digits if it is translucent."""
    return f"color-{bytes(fill[: 3 if fill[3] == 255 else 4]).hex()}"


def colour_name(fill: Rgba) -> str:
    """Return the plain name of a colour: black, white, grey, brown, pink or a hue."""
    hue, lightness, saturation = colorsys.rgb_to_hls(*(v / 255.0 for v in fill[:3]))
    if lightness < 0.08:
        return "black"
    if lightness > 0.95:
        return "white"
    if saturation < 0.12:
        return "grey"
    name = next(word for end, word in _HUES.items() if hue * 360.0 < end)
    if name in ("red", "orange") and lightness < 0.35:
        return "brown"
    return "pink" if name == "red" and lightness > 0.75 else name
