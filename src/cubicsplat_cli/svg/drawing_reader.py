"""Reads the SVG files that `write_drawing` makes back into a drawing; refuses any other with one line."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Outline, Rectangle, Ring, extent_of, signed_area
from cubicsplat_cli.artwork.geometry.stroke import (
    BEVEL,
    BUTT,
    MITER,
    ROUND,
    SQUARE,
    Chain,
    Path,
    Stroke,
    outlines_of_stroke,
)
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.scene.paint import Gradient, Rgba, mean_fill
from cubicsplat_cli.svg.drawing_paths import controls_of, ring_of, rounded_of
from cubicsplat_cli.svg.own import REFERENCE, GradientReader, OwnElement, canvas_size, own_elements, own_subpaths
from cubicsplat_cli.svg.paths import PathSegment
from cubicsplat_cli.svg.quantise import MAX_COORDINATE
from cubicsplat_cli.svg.scene_writer import CURVES_ID
from cubicsplat_cli.svg.shading import ISOLATED, SCALES, ShadedShape
from cubicsplat_cli.svg.values import hex_colour, parse_number, picture_in

_ROTATION = re.compile(r"rotate\((-?[\d.]{1,12}) (-?[\d.]{1,20}) (-?[\d.]{1,20})\)")
_REFERENCE = re.compile(r"url\(\s*['\"]?#([^'\"()]+?)['\"]?\s*\)")
_CAPS, _JOINS = (BUTT, ROUND, SQUARE), (MITER, ROUND, BEVEL)
_LENGTHS = {
    "circle": ("cx", "cy", "r"),
    "ellipse": ("cx", "cy", "rx", "ry"),
    "rect": ("x", "y", "width", "height", "rx"),
    "path": (),
}
AnyPath = TypeVar("AnyPath", bound=Path)


def holds_drawing(elements: Sequence[OwnElement]) -> bool:
    """Whether a document has shapes right below its root or in groups of a name alone, as artwork has, and no group of
    curves.

    The first element that can tell decides; a `rect` may be the background of either.
    """
    places = [each.place for each in elements if (each.place == "svg/g" and not _is_group(each)) or _is_shape(each)]
    return next((place for place in places if place != "svg/rect"), places[0] if places else "svg/g") != "svg/g"


def _is_group(element: OwnElement) -> bool:
    """Whether a group is one of shapes, which has a name alone, or a shading."""
    return set(element.attributes) - {"clip-path"} == {"id"} and element.attributes["id"] != CURVES_ID


def _is_shape(element: OwnElement) -> bool:
    return element.name in _LENGTHS


def read_drawing(text: str | bytes) -> Drawing:
    """The drawing of an SVG that `write_drawing` wrote; InputError for anything else."""
    return drawing_of(own_elements(text))


def drawing_of(elements: Sequence[OwnElement]) -> Drawing:
    """The drawing that the elements of a document hold; InputError where they are not those of `write_drawing`."""
    width, height = canvas_size(elements[0])
    content = _Content((width, height), GradientReader(elements))
    for element in elements:
        try:
            content.add(element)
        except ValueError as error:
            raise element.refused(error) from error
    try:
        return Drawing(width, height, content.shapes())
    except ValueError as error:
        raise elements[-1].refused(error) from error


class _Content:
    """The shapes of a document, and the shading of each, as they are read. size: of the canvas, px."""

    def __init__(self, size: tuple[int, int], gradients: GradientReader) -> None:
        self._size, self._gradients = size, gradients
        self._shapes: list[Shape] = []
        self._clips: dict[str, tuple[Outline, ...]] = {}
        self._clip = ""  # the clip path that is being read
        self._shaded: ShadedShape | None = None  # the group that is being read
        self._steps, self._opacity = 1, 1.0  # a px; and of curves that say none

    def shapes(self) -> tuple[Shape, ...]:
        """The shapes read so far. Raises ValueError where a shading is not whole."""
        self._end_shading()
        return tuple(self._shapes)

    def add(self, element: OwnElement) -> None:
        """Raises ValueError for an element that `write_drawing` would not have put there."""
        given, place = element.attributes, element.place
        if place == "svg/clipPath":
            self._clip = given.get("id", "")
        elif place.startswith("svg/clipPath/"):
            self._clips[self._clip] = tuple(outline for outlines in _filled(element) for outline in outlines)
        elif place == "svg/g":
            self._end_shading()
            if not _is_group(element):
                raise ValueError("has an unexpected <g> element")
            if "clip-path" in given:
                self._begin_shading(given["id"], given["clip-path"])
        elif self._shaded is not None and place.startswith("svg/g/g"):
            self._add_to(self._shaded, element)
        elif _is_shape(element):
            self._end_shading()
            stroked = given.get("fill") == "none"
            self._shapes += _strokes(element) if stroked else _fills(element, self._gradients)

    def _begin_shading(self, name: str, reference: str) -> None:
        match = REFERENCE.fullmatch(reference)
        if match is None or match[1] not in self._clips:
            raise ValueError(f"has the clip-path {reference!r}, which is none of a shape before it")
        self._shaded = ShadedShape(name, self._clips[match[1]], self._size)

    def _add_to(self, shaded: ShadedShape, element: OwnElement) -> None:
        """Adds what is within the group of a shape with shading."""
        given, place = element.attributes, element.place
        if place == "svg/g/g":
            if given.get("opacity") != ISOLATED:
                raise ValueError("has an unexpected <g> element")
        elif place == "svg/g/g/rect":
            shaded.add_ground(*_paint(given, [_primitive(element).ring()], self._gradients))
        elif place == "svg/g/g/image":
            x, y, width, height = (_coordinate(given.get(name, "0")) for name in _LENGTHS["rect"][:4])
            if min(width, height) <= 0.0 or given.get("preserveAspectRatio") != "none":
                raise ValueError("has an <image> without extent, or with its own shape")
            shaded.add_image((x, y, width, height), picture_in(given.get("xlink:href", ""))[0])
        elif place == "svg/g/g/g":
            if given.get("transform") not in SCALES:
                raise ValueError("has an unexpected <g> element")
            self._steps, self._opacity = SCALES[given["transform"]], _opacity(given, "fill")
        else:
            opacity = _opacity(given, "fill") if "fill-opacity" in given else self._opacity
            for subpath in own_subpaths(element):
                shaded.add_curve(_closed_ring(subpath), self._steps, hex_colour(given.get("fill", "")), opacity)

    def _end_shading(self) -> None:
        if self._shaded is not None:
            self._shapes.append(self._shaded.shape())
            self._shaded, self._opacity = None, 1.0


def _closed_ring(subpath: Sequence[PathSegment]) -> Ring:
    if not re.fullmatch(r"[LHVC]+Z", _letters(subpath)):
        raise ValueError("has path data other than closed rings of L, H, V and C")
    return ring_of(subpath)


def _fills(element: OwnElement, gradients: GradientReader) -> list[Shape]:
    """One shape, of a compound path one for each ring that runs clockwise as seen: the others are its holes."""
    given = element.attributes
    for name in given:
        if name.startswith("stroke"):
            raise ValueError(f"has an unexpected attribute {name!r}")
    groups = _filled(element)
    fill, gradient = _paint(given, [outline.ring() for group in groups for outline in group], gradients)
    return [Shape(fill, tuple(group), given.get("id", ""), gradient=gradient) for group in groups]


def _filled(element: OwnElement) -> list[list[Outline]]:
    """The outlines of each shape of an element: an outer one, then its holes."""
    groups: list[list[Outline]] = []
    if element.name != "path":
        groups = [[_primitive(element)]]
    else:
        for outline, clockwise in map(_outline, own_subpaths(element)):
            if clockwise or not groups:
                groups.append([])
            groups[-1].append(_rotated(outline, element.attributes))
    return groups


def _paint(given: dict[str, str], rings: list[Ring], gradients: GradientReader) -> tuple[Rgba, Gradient | None]:
    """The fill of an element of these rings, and its gradient or None."""
    match = _REFERENCE.fullmatch(given.get("fill", ""))
    if match is None:
        return _fill(given, "fill"), None
    if given.get("fill-opacity", "1") != "1":
        raise ValueError("has a fill-opacity beside a gradient; give its stops the opacity")
    low, high = extent_of(rings)
    gradient = gradients.gradient(match[1], (*low.tolist(), *(high - low).tolist()))
    return mean_fill(gradient), gradient


def _strokes(element: OwnElement) -> list[Shape]:
    """One stroke, of a path one for each of its subpaths."""
    given = element.attributes
    fill, width = _fill(given, "stroke"), _coordinate(given.get("stroke-width", "1"))
    if width <= 0.0:
        raise ValueError("has a stroke without a width")
    cap, join = given.get("stroke-linecap", BUTT), given.get("stroke-linejoin", MITER)
    if cap not in _CAPS or join not in _JOINS:
        raise ValueError(f"has the stroke-linecap {cap!r} and the stroke-linejoin {join!r}")
    if element.name != "path":
        paths: list[Path] = [_primitive(element)]
    else:
        paths = [_rotated(_centre_line(subpath), given) for subpath in own_subpaths(element)]
    strokes = [Stroke(path, width, cap, join) for path in paths]
    return [Shape(fill, outlines_of_stroke(stroke), given.get("id", ""), stroke=stroke) for stroke in strokes]


def _fill(given: dict[str, str], kind: str) -> Rgba:
    """The colour and opacity of a "fill" or "stroke"."""
    return (*hex_colour(given.get(kind, "")), round(255.0 * _opacity(given, kind)))


def _opacity(given: dict[str, str], kind: str) -> float:
    opacity = parse_number(given.get(f"{kind}-opacity", "1"))
    if not 0.0 <= opacity <= 1.0:
        raise ValueError(f"has the opacity {opacity:g}, not one in 0..1")
    return opacity


def _coordinate(text: str) -> float:
    value = parse_number(text)
    if abs(value) > MAX_COORDINATE:
        raise ValueError(f"has the number {text!r}, more than {MAX_COORDINATE:.0f} px")
    return value


def _primitive(element: OwnElement) -> Circle | Ellipse | Rectangle:
    lengths = [_coordinate(element.attributes.get(name, "0")) for name in _LENGTHS[element.name]]
    if min(lengths[2:4]) <= 0.0 or lengths[-1] < 0.0:
        raise ValueError(f"has a <{element.name}> without extent")
    if element.name == "circle":
        x, y, radius = lengths
        return Circle(x, y, radius)
    if element.name == "ellipse":
        x, y, rx, ry = lengths
        return Ellipse(x, y, rx, ry, _angle(element.attributes))
    x, y, width, height, radius = lengths
    return Rectangle(x, y, width, height, radius, _angle(element.attributes))


def _angle(given: dict[str, str]) -> float:
    """The angle in radians, clockwise as seen, of an element's rotation about its centre."""
    match = _ROTATION.fullmatch(given.get("transform", "rotate(0 0 0)"))
    if match is None:
        raise ValueError("has a transform other than a rotation about the middle")
    return math.radians(_coordinate(match[1]))


def _rotated(path: AnyPath, given: dict[str, str]) -> AnyPath:
    """A path with the rotation of its element, which only rounded rectangles may have."""
    if "transform" not in given:
        return path
    if not isinstance(path, Rectangle):
        raise ValueError("has a transform of a path other than a rounded rectangle")
    return replace(path, angle=_angle(given))


def _letters(subpath: Sequence[PathSegment]) -> str:
    """The commands of a subpath. Raises ValueError where a point of it is too far away."""
    coordinates = [v for piece in subpath for point in (piece.start, piece.end, *piece.handles) for v in point]
    if not all(abs(coordinate) <= MAX_COORDINATE for coordinate in coordinates):  # false for NaN too
        raise ValueError(f"has a point more than {MAX_COORDINATE:.0f} px from the origin")
    return "".join(piece.command for piece in subpath)


def _outline(subpath: Sequence[PathSegment]) -> tuple[Outline, bool]:
    """A closed subpath, and whether it runs clockwise as seen."""
    letters = _letters(subpath)
    if letters == "AAZ":
        return _ellipse(*subpath[:2]), subpath[0].numbers[4] == 1.0
    rounded = rounded_of(subpath)
    if rounded is not None:
        return rounded
    if not re.fullmatch(r"[LHVCS]+Z", letters):
        raise ValueError(
            "has path data other than closed rings of L, H, V, C, S, two half ellipses, or a rounded rectangle"
        )
    ring = ring_of(subpath)
    return ring, signed_area(ring) > 0.0


def _centre_line(subpath: Sequence[PathSegment]) -> Path:
    """The path of a stroke: an outline if it is closed."""
    if subpath and subpath[-1].command == "Z":
        return _outline(subpath)[0]
    if not re.fullmatch(r"[LHVCS]+", _letters(subpath)):
        raise ValueError("has an open path of other than L, H, V, C and S")
    anchors = np.array([*(piece.start for piece in subpath), subpath[-1].end])
    controls, lines = controls_of(subpath, anchors[1:])
    return Chain(anchors, controls, lines, np.zeros(len(anchors), dtype=bool))


def _ellipse(first: PathSegment, second: PathSegment) -> Outline:
    rx, ry, degrees = first.numbers[:3]
    centre = ((first.start[0] + first.end[0]) / 2.0, (first.start[1] + first.end[1]) / 2.0)
    if second.end != first.start or first.numbers != second.numbers or min(rx, ry) <= 0.0:
        raise ValueError("has arcs that are not two halves of an ellipse")
    return Circle(*centre, rx) if rx == ry else Ellipse(*centre, rx, ry, math.radians(degrees))
