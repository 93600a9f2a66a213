"""A drawing: shapes in a fill, opaque or evenly translucent, or in a gradient, back to front; their names for an
editor's list of layers.
"""

from __future__ import annotations

import colorsys
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Outline, Rectangle, Ring, extent_of, oriented
from cubicsplat_cli.artwork.geometry.stroke import Chain, Path, Stroke
from cubicsplat_cli.scene import EmbeddedImage, Scene, resized
from cubicsplat_cli.scene.paint import Gradient, Rgba

_ALIKE = 1e-3
AnyLine = TypeVar("AnyLine", Outline, Path)
# Hues in degrees up to which a colour has this name.
_HUES = ((15, "red"), (42, "orange"), (68, "yellow"), (160, "green"), (195, "teal"), (255, "blue"), (290, "purple"))
_HUES_END = ((335, "pink"), (361, "red"))


@dataclass(frozen=True)
class Shape:
    """One shape in one fill, or in a gradient.

    fill: sRGB and opacity, 8 bits each, not premultiplied; of a gradient about its mean. outlines: first the outer one,
    then its holes, which may run either way: whoever draws them turns them round (`oriented`). name: what an editor's
    list of layers shows. gradient: in px of the drawing, or None. stroke: whose outlines these are, or None. group: the
    name of the group in the file that it is in, empty for none. shading: None, or filled curves on the drawing's
    canvas, without a background, or a picture, over its paint, which is opaque then; seen within its outlines alone.
    """

    fill: Rgba
    outlines: tuple[Outline, ...]
    name: str
    gradient: Gradient | None = None
    stroke: Stroke | None = None
    group: str = ""
    shading: Scene | EmbeddedImage | None = None

    def oriented(self) -> tuple[Ring, ...]:
        """The rings, the outer one clockwise as seen, holes the other way: the nonzero rule leaves holes empty."""
        return oriented([outline.ring() for outline in self.outlines])

    def filled(self, fill: Rgba, width: int, height: int) -> Shape:
        """The shape in a flat fill, on a canvas of width x height px, with the name of that."""
        return replace(self, fill=fill, gradient=None, name=shape_name(fill, self.outlines, width, height))

    def box(self) -> Rectangle:
        """The box of whole px around its outlines."""
        low, high = extent_of([outline.ring() for outline in self.outlines])
        (left, top), (right, bottom) = np.floor(low), np.ceil(high)
        return Rectangle(float(left), float(top), float(right - left), float(bottom - top))


@dataclass(frozen=True)
class Drawing:
    """Shapes back to front on a canvas of width x height px; what no shape covers is transparent.

    abutting: none overlaps another, but for what was made to reach beneath those drawn later, and shapes that touch
    share their edges to the last digit.
    """

    width: int
    height: int
    shapes: tuple[Shape, ...]
    abutting: bool = False

    @property
    def fills(self) -> tuple[Rgba, ...]:
        """The different fills of the shapes without a gradient, in the order of their first use."""
        return tuple(dict.fromkeys(shape.fill for shape in self.shapes if shape.gradient is None))

    @property
    def gradients(self) -> tuple[Gradient, ...]:
        """The different gradients, in the order of their first use."""
        return tuple(dict.fromkeys(shape.gradient for shape in self.shapes if shape.gradient is not None))

    @property
    def segments(self) -> int:
        """The number of lines and cubics of the outlines, primitives counted as their rings."""
        paths = (shape.outlines if shape.stroke is None else (shape.stroke.path,) for shape in self.shapes)
        return sum(path.pieces for own in paths for path in own)

    @property
    def coordinates(self) -> int:
        """The number of numbers that an artist would write for the outlines."""
        lines = (shape.outlines if shape.stroke is None else (shape.stroke,) for shape in self.shapes)
        return sum(line.coordinates for own in lines for line in own)


def ground_shape(fill: Rgba, width: int, height: int) -> Shape:
    """A rectangle of one fill over a whole canvas."""
    return Shape(fill, (Rectangle(0.0, 0.0, float(width), float(height)),), "").filled(fill, width, height)


def scaled_drawing(drawing: Drawing, width: int, height: int) -> Drawing:
    """The drawing on a canvas of width x height px; the same object when it has that size already.

    Sides are scaled independently, so that a canvas whose sides were rounded to whole pixels fits again; primitives
    stay what they are where both factors are alike to a thousandth, and become rings elsewhere.
    """
    if (drawing.width, drawing.height) == (width, height):
        return drawing
    across, down = width / drawing.width, height / drawing.height
    shapes = tuple(
        replace(
            shape,
            outlines=tuple(scaled_outline(outline, across, down) for outline in shape.outlines),
            gradient=shape.gradient and shape.gradient.scaled(across, down),
            # A pen is round: where sides grow differently its outline is all that is left.
            stroke=_scaled_stroke(shape.stroke, across) if shape.stroke and _alike(across, down) else None,
            shading=shape.shading and resized(shape.shading, width, height),
        )
        for shape in drawing.shapes
    )
    return Drawing(width, height, shapes)


def _alike(across: float, down: float) -> bool:
    return abs(across / down - 1.0) <= _ALIKE


def _scaled_stroke(stroke: Stroke, factor: float) -> Stroke:
    return replace(stroke, path=scaled_outline(stroke.path, factor, factor), width=stroke.width * factor)


def scaled_outline(outline: AnyLine, across: float, down: float) -> AnyLine:
    """An outline, or a centre line, with its x times `across` and its y times `down`."""
    if not _alike(across, down) and not isinstance(outline, Chain):
        outline = outline.ring()
    if isinstance(outline, (Ring, Chain)):
        factors = np.array([across, down])
        return replace(outline, anchors=outline.anchors * factors, controls=outline.controls * factors)
    # Every number of a primitive but its angle is a length.
    return replace(outline, **{f.name: getattr(outline, f.name) * across for f in fields(outline) if f.name != "angle"})


def shape_name(fill: Rgba, outlines: tuple[Outline, ...], width: int, height: int) -> str:
    """ "background" for a rectangle over the whole canvas, else the plain name of the fill's colour."""
    first = outlines[0]
    if isinstance(first, Rectangle) and first.width >= width - 0.5 and first.height >= height - 0.5:
        return "background"
    return colour_name(fill)


def colour_group(fill: Rgba) -> str:
    """The name of a group of one colour, `color-ff8800`, with two more digits where it is translucent."""
    return "color-{:02x}{:02x}{:02x}".format(*fill[:3]) + ("" if fill[3] == 255 else f"{fill[3]:02x}")


def colour_name(fill: Rgba) -> str:
    """The plain name of a colour: black, white, grey, brown, pink or a hue."""
    hue, lightness, saturation = colorsys.rgb_to_hls(*(v / 255.0 for v in fill[:3]))
    if lightness < 0.08:
        return "black"
    if lightness > 0.95:
        return "white"
    if saturation < 0.12:
        return "grey"
    name = next(word for end, word in _HUES + _HUES_END if hue * 360.0 < end)
    if name in ("red", "orange") and lightness < 0.35:
        return "brown"
    return "pink" if name == "red" and lightness > 0.75 else name
