"""Reads the SVG files of `write_drawing` back into a drawing; refuses any other with one line."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Outline, Rectangle, Ring, extent_of, signed_area
from cubicsplat_cli.artwork.geometry.stroke import (
    BUTT,
    CAPS,
    JOINS,
    MITER,
    MOST_DASHES,
    Chain,
    Path,
    Stroke,
    outlines_of_stroke,
)
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.scene import EmbeddedImage, Scene
from cubicsplat_cli.scene.paint import Gradient, Rgba, mean_fill
from cubicsplat_cli.svg.drawing_paths import LETTERS, controls_of, ring_of, rounded_of
from cubicsplat_cli.svg.own import GEOMETRY, REFERENCE, GradientReader, OwnElement, own_elements
from cubicsplat_cli.svg.paths import PathSegment
from cubicsplat_cli.svg.quantise import MAX_COORDINATE
from cubicsplat_cli.svg.scene_writer import CURVES_ID
from cubicsplat_cli.svg.shading import ISOLATED, SCALES
from cubicsplat_cli.svg.values import hex_colour, parse_number, picture_in

_ROTATION = re.compile(r"rotate\((-?[\d.]{1,12}) (-?[\d.]{1,20}) (-?[\d.]{1,20})\)")
_REFERENCE = re.compile(r"url\(\s*['\"]?#([^'\"()]+?)['\"]?\s*\)")
# px^2: a hole of less area may run the wrong way round after its points are rounded, and an outer ring is not visible.
_INVISIBLE = 0.1
ShadingCurve = tuple[np.ndarray, tuple[float, ...]]  # control points (K, 2) px; sRGB levels and opacity
AnyPath = TypeVar("AnyPath", bound=Path)


def holds_drawing(elements: Sequence[OwnElement]) -> bool:
    """Return whether a document holds a drawing, not a scene of curves.

    A drawing has shapes right below its root, or in groups with nothing but a name. The first element that can tell
    decides; a `rect` may be the background of either.
    """
    places = [e.place for e in elements if e.name in GEOMETRY or (e.place == "svg/g" and not _is_group(e))]
    return next((place for place in places if place != "svg/rect"), places[0] if places else "svg/g") != "svg/g"


def _is_group(element: OwnElement) -> bool:
    """Return whether a group is one of shapes, which has nothing but a name, or of shading."""
    return set(element.attributes) - {"clip-path"} == {"id"} and element.attributes["id"] != CURVES_ID


def read_drawing(text: str | bytes) -> Drawing:
    """Return the drawing of an SVG that `write_drawing` wrote. Raises InputError for anything else."""
    return drawing_of(own_elements(text))


def drawing_of(elements: Sequence[OwnElement]) -> Drawing:
    """Return the drawing of a document's elements. Raises InputError if they are not those of `write_drawing`."""
    size, gradients = elements[0].canvas_size(), GradientReader(elements)
    shapes, dashes = list[Shape](), 0
    clips: dict[str, tuple[Outline, ...]] = {}
    for element in elements[0].children:
        with element.checked():
            if element.name == "clipPath":
                outlines = (outline for child in element.children for group in _filled(child) for outline in group)
                clips[element.attributes.get("id", "")] = tuple(outlines)
            elif element.name == "g" and not _is_group(element):
                raise ValueError("has an unexpected <g> element")
            elif "clip-path" in element.attributes:
                clip = element.attributes["clip-path"]
                match = REFERENCE.fullmatch(clip)
                if match is None or match[1] not in clips:
                    raise ValueError(f"has the clip-path {clip!r}, which is none of a shape before it")
                shapes.append(_shaded(element, clips[match[1]], size, gradients))
            else:
                for shape in (element, *element.children):
                    with shape.checked():
                        for made in _shapes(shape, gradients):
                            shapes.append(made)
                            dashes += len(made.outlines) if made.stroke and made.stroke.dashes else 0
                            if dashes > MOST_DASHES:
                                raise ValueError(f"is one of more than {MOST_DASHES} dashes")
    return Drawing(*size, tuple(shapes))


def _shaded(
    group: OwnElement, outlines: tuple[Outline, ...], size: tuple[int, int], gradients: GradientReader
) -> Shape:
    """Return the shape of a group with shading. size: of the canvas, px. Raises ValueError if a part is missing."""
    ground: tuple[Rgba, Gradient | None] | None = None
    images: list[EmbeddedImage] = []
    curves: list[ShadingCurve] = []
    for element in group.children:
        with element.checked():
            if element.name != "g" or element.attributes.get("opacity") != ISOLATED:
                raise ValueError(f"has an unexpected <{element.name}> element")
        for part in element.children:
            with part.checked():
                if part.name == "image":
                    if images or curves:
                        raise ValueError("is an image beside another one or curves")
                    images.append(_image(part.attributes, size))
                elif part.name == "g":
                    curves += _shading_curves(part)
                else:
                    paint = _paint(part.attributes, [_primitive(part).ring()], gradients)
                    if ground not in (None, paint) or paint[0][3] != 255:
                        raise ValueError("is another ground of a shading, or not opaque")
                    ground = paint
    if ground is None or bool(curves) == bool(images):
        raise ValueError("has a shading without a ground or without curves")
    if images:
        return Shape(ground[0], outlines, group.attributes["id"], ground[1], shading=images[0])
    rings, colours = zip(*curves[::-1], strict=True)  # the first one of a scene is at the front
    fills = np.array(colours, np.float32) / np.array([255.0, 255.0, 255.0, 1.0], np.float32)
    shading = Scene.filled(*size, [[ring.astype(np.float32)] for ring in rings], fills)
    return Shape(ground[0], outlines, group.attributes["id"], ground[1], shading=shading)


def _image(given: dict[str, str], size: tuple[int, int]) -> EmbeddedImage:
    x, y, width, height = (_coordinate(given.get(name, "0")) for name in ("x", "y", "width", "height"))
    if min(width, height) <= 0.0 or given.get("preserveAspectRatio") != "none":
        raise ValueError("has an <image> without extent, or with its own shape")
    return EmbeddedImage(size, x, y, width, height, picture_in(given.get("xlink:href", ""))[0])


def _shading_curves(group: OwnElement) -> list[ShadingCurve]:
    """Return the curves of a shading, back to front."""
    if group.attributes.get("transform") not in SCALES:
        raise ValueError("has an unexpected <g> element")
    steps, shared = SCALES[group.attributes["transform"]], _opacity(group.attributes, "fill")
    curves: list[ShadingCurve] = []
    for path in group.children:
        with path.checked():
            given = path.attributes
            fill = *hex_colour(given.get("fill", "")), _opacity({"fill-opacity": str(shared), **given}, "fill")
            for subpath in path.subpaths():
                if not re.fullmatch(r"[LHVC]+Z", _letters(subpath)):
                    raise ValueError("has path data other than closed rings of L, H, V and C")
                curves.append((ring_of(subpath).cubics[:, :3].reshape(-1, 2) / steps, fill))
    return curves


def _shapes(element: OwnElement, gradients: GradientReader) -> Iterable[Shape]:
    """Return the shapes of an element, none of a gradient, a title or a group."""
    if element.place in ("svg/g/g", "svg/g/polygon"):
        raise ValueError(f"has an unexpected <{element.name}> element")
    if element.name not in GEOMETRY:
        return []
    if element.attributes.get("fill") == "none":
        return _strokes(element)
    fills = _fills(element, gradients)
    if "stroke" not in element.attributes:
        return fills
    if len(fills) > 1 or len(fills[0].outlines) > 1:
        raise ValueError("has a stroke around several outlines")
    return [*fills, *_strokes(element)]


def _fills(element: OwnElement, gradients: GradientReader) -> list[Shape]:
    """Return one shape, or one for each ring of a compound path that runs clockwise as seen; the others are holes."""
    given = element.attributes
    for name in given:
        if name.startswith("stroke") and "stroke" not in given:
            raise ValueError(f"has an unexpected attribute {name!r}")
    groups = _filled(element)
    fill, gradient = _paint(given, [outline.ring() for group in groups for outline in group], gradients)
    return [Shape(fill, tuple(group), given.get("id", ""), gradient=gradient) for group in groups]


def _filled(element: OwnElement) -> list[list[Outline]]:
    """Return the outlines of each shape of an element: an outer one, then its holes."""
    if element.name != "path":
        return [[_primitive(element)]]
    groups: list[list[Outline]] = []
    for outline, clockwise in map(_outline, element.subpaths()):
        if clockwise or not groups:
            groups.append([])
        groups[-1].append(_rotated(outline, element.attributes))
    return groups


def _paint(given: dict[str, str], rings: list[Ring], gradients: GradientReader) -> tuple[Rgba, Gradient | None]:
    """Return the fill of an element with these rings, and its gradient or None."""
    match = _REFERENCE.fullmatch(given.get("fill", ""))
    if match is None:
        return fill_of(given, "fill"), None
    if given.get("fill-opacity", "1") != "1":
        raise ValueError("has a fill-opacity beside a gradient; give its stops the opacity")
    low, high = extent_of(rings)
    gradient = gradients.gradient(match[1], (*low.tolist(), *(high - low).tolist()))
    return mean_fill(gradient), gradient


def _strokes(element: OwnElement) -> Iterator[Shape]:
    """Yield one stroke, or one for each subpath of a path."""
    given = element.attributes
    fill, width = fill_of(given, "stroke"), _coordinate(given.get("stroke-width", "1"))
    if width <= 0.0:
        raise ValueError("has a stroke without a width")
    cap, join = given.get("stroke-linecap", BUTT), given.get("stroke-linejoin", MITER)
    if cap not in CAPS or join not in JOINS:
        raise ValueError(f"has the stroke-linecap {cap!r} and the stroke-linejoin {join!r}")
    if element.name != "path":
        paths: list[Path] = [_primitive(element)]
    else:
        paths = [_rotated(_centre_line(subpath), given) for subpath in element.subpaths()]
    dashes = tuple(map(_coordinate, given.get("stroke-dasharray", "").split()))
    if dashes and (len(dashes) % 2 or min(dashes) < 0.0 or not sum(dashes)):
        raise ValueError(f"has the stroke-dasharray {given['stroke-dasharray']!r}, not lengths of dashes and gaps")
    offset = _coordinate(given.get("stroke-dashoffset", "0"))
    for path in paths:
        stroke = Stroke(path, width, cap, join, dashes, offset)
        yield Shape(fill, outlines_of_stroke(stroke), given.get("id", ""), stroke=stroke)


def fill_of(given: dict[str, str], kind: str) -> Rgba:
    """Return the colour and opacity of a "fill" or "stroke"."""
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
    names = [name for name in GEOMETRY[element.name] if name != "transform"]
    lengths = [_coordinate(element.attributes.get(name, "0")) for name in names]
    if min(lengths[2:4]) <= 0.0 or lengths[-1] < 0.0:
        raise ValueError(f"has a <{element.name}> without extent")
    if element.name == "circle":
        return Circle(*lengths)
    lengths.append(angle_of(element.attributes))
    return Ellipse(*lengths) if element.name == "ellipse" else Rectangle(*lengths)


def angle_of(given: dict[str, str]) -> float:
    """Return the rotation of an element about its centre, in radians, clockwise as seen."""
    match = _ROTATION.fullmatch(given.get("transform", "rotate(0 0 0)"))
    if match is None:
        raise ValueError("has a transform other than a rotation about the middle")
    return math.radians(_coordinate(match[1]))


def _rotated(path: AnyPath, given: dict[str, str]) -> AnyPath:
    """Return a path with the rotation of its element, which only rounded rectangles may have."""
    if "transform" not in given:
        return path
    if not isinstance(path, Rectangle):
        raise ValueError("has a transform of a path other than a rounded rectangle")
    return replace(path, angle=angle_of(given))


def _letters(subpath: Sequence[PathSegment]) -> str:
    """Return the letters of a subpath's commands. Raises ValueError for a point that is too far away."""
    coordinates = [v for piece in subpath for point in (piece.start, piece.end, *piece.handles) for v in point]
    if not all(abs(coordinate) <= MAX_COORDINATE for coordinate in coordinates):  # false for NaN too
        raise ValueError(f"has a point more than {MAX_COORDINATE:.0f} px from the origin")
    return "".join(piece.command for piece in subpath)


def _outline(subpath: Sequence[PathSegment]) -> tuple[Outline, bool]:
    """Return the outline of a closed subpath, and whether it runs clockwise as seen."""
    letters = _letters(subpath)
    if letters == "AAZ":
        return _ellipse(*subpath[:2]), subpath[0].numbers[4] == 1.0
    rounded = rounded_of(subpath) if letters in LETTERS else None
    if rounded is not None:
        return rounded
    if not re.fullmatch(r"[LHVCS]+Z", letters):
        known = "closed rings of L, H, V, C, S, two half ellipses, or a rounded rectangle"
        raise ValueError(f"has path data other than {known}")
    ring = ring_of(subpath)
    return ring, signed_area(ring) > _INVISIBLE


def _centre_line(subpath: Sequence[PathSegment]) -> Path:
    """Return the path of a stroke, which is an outline if it is closed."""
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
