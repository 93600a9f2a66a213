"""A drawing: opaque (or evenly translucent) shapes, back to front."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from cubicsplat_cli.artwork.outlines import Outline, Ring, reversed_ring, signed_area

Ink = tuple[int, int, int, int]
_ALIKE = 1e-3


@dataclass(frozen=True)
class Shape:
    """One shape in one ink.

    ink: sRGB and opacity, 8 bits each, not premultiplied. outlines: first the outer one, then its holes, which may run
    either way: whoever draws them turns them round (`oriented`). name: what an editor's list of layers shows.
    """

    ink: Ink
    outlines: tuple[Outline, ...]
    name: str

    def oriented(self) -> tuple[Ring, ...]:
        """The rings, the outer one clockwise as seen, holes the other way: the nonzero rule leaves holes empty."""
        rings = [outline.ring() for outline in self.outlines]
        wrong = [(signed_area(ring) > 0.0) == (i > 0) for i, ring in enumerate(rings)]
        return tuple(reversed_ring(r) if turn else r for r, turn in zip(rings, wrong, strict=True))


@dataclass(frozen=True)
class Drawing:
    """Shapes back to front on a canvas of width x height px; what no shape covers is transparent."""

    width: int
    height: int
    shapes: tuple[Shape, ...]

    @property
    def inks(self) -> tuple[Ink, ...]:
        """The different inks, in the order of their first use."""
        return tuple(dict.fromkeys(shape.ink for shape in self.shapes))

    @property
    def segments(self) -> int:
        """How many lines and cubics the outlines have, primitives counted as their rings."""
        return sum(outline.ring().pieces for shape in self.shapes for outline in shape.outlines)

    @property
    def coordinates(self) -> int:
        """How many numbers an artist would write for the outlines."""
        return sum(outline.coordinates for shape in self.shapes for outline in shape.outlines)


def scaled_drawing(drawing: Drawing, width: int, height: int) -> Drawing:
    """The drawing on a canvas of width x height px; the same object when it has that size already.

    Sides are scaled independently, so that a canvas whose sides were rounded to whole pixels fits again; primitives
    stay what they are where both factors are alike to a thousandth, and become rings elsewhere.
    """
    if (drawing.width, drawing.height) == (width, height):
        return drawing
    across, down = width / drawing.width, height / drawing.height
    shapes = tuple(
        replace(shape, outlines=tuple(scaled_outline(outline, across, down) for outline in shape.outlines))
        for shape in drawing.shapes
    )
    return Drawing(width, height, shapes)


def scaled_outline(outline: Outline, across: float, down: float) -> Outline:
    """An outline with its x times `across` and its y times `down`."""
    if isinstance(outline, Ring) or abs(across / down - 1.0) > _ALIKE:
        ring = outline.ring()
        factors = np.array([across, down])
        return replace(ring, anchors=ring.anchors * factors, controls=ring.controls * factors)
    # Every number of a primitive but its angle is a length.
    return replace(outline, **{f.name: getattr(outline, f.name) * across for f in fields(outline) if f.name != "angle"})
