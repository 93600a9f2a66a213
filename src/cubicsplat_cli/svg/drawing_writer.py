"""Artwork as one plain SVG 1.1 document: primitives stay primitives, others are paths. Mosaics have a path a colour."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Outline, Rectangle, Ring
from cubicsplat_cli.artwork.geometry.steps import suggested_precision, to_steps
from cubicsplat_cli.artwork.geometry.stroke import BUTT, MITER, Stroke
from cubicsplat_cli.artwork.shapes import Drawing, Shape, colour_group, colour_name
from cubicsplat_cli.settings import PRECISION
from cubicsplat_cli.svg.compound import compounds, primitive_of
from cubicsplat_cli.svg.drawing_paths import MOST_ON_RECT, GridRings, PathText, add_rounded, add_stroke
from cubicsplat_cli.svg.markup import GradientElements, Identifiers, empty_document, format_number, paint, titled
from cubicsplat_cli.svg.shading import clipped

if TYPE_CHECKING:
    from cubicsplat_cli.artwork.mosaic import CellLayer, Mosaic

_ANGLE_DECIMALS = 3  # degrees
_DASH_DECIMALS = 2  # besides those of coordinates


def write_drawing(drawing: Drawing, *, precision: int | None = None, title: str, comment: str) -> str:
    """Return the SVG text of artwork: `elements_of` with a title, any text, which viewers show, and a comment of one
    line, by which the command line recognises its own files.
    """
    return titled(elements_of(drawing, precision), title, comment)


def elements_of(drawing: Drawing, precision: int | None = None) -> Element:
    """Return the root of an SVG of artwork, without a title, its shapes in order, the first at the back.

    `compounds` says which shapes share a path; shapes that abut have one each. Consecutive shapes of a group share a
    `<g>`. A shape that is smaller than a step of the grid is left out.

    precision: decimals of the coordinates in px, 0..6; by default `suggested_precision`. Raises UsageError for a bad
    one.
    """
    precision = _precision_of(drawing, precision)
    root, names = empty_document(drawing.width, drawing.height), Identifiers()
    gradients = GradientElements(lambda: names.unique("gradient"), precision)
    groups = [[shape] for shape in drawing.shapes] if drawing.abutting else compounds(drawing.shapes)
    rings = GridRings(drawing.shapes, precision, drawing.abutting)
    parent, latest = root, ""
    for group in groups:
        element = _element(group, precision, rings)
        if element is None:
            continue
        if group[0].group != latest:
            latest = group[0].group
            parent = _group_element(root, latest, names)
        painted = _painted(element, group, names, gradients, precision)
        parent.extend(painted if group[0].shading is None else clipped(painted, group[0], names))
    return root


def _precision_of(canvas: Drawing | Mosaic, precision: int | None) -> int:
    """Return the precision, by default the suggested one. Raises UsageError for a bad one."""
    precision = suggested_precision(canvas.width, canvas.height) if precision is None else precision
    PRECISION.check("precision", precision)
    return precision


def _group_element(root: Element, name: str, names: Identifiers) -> Element:
    """Add a group with a name and return it; return the root for no name."""
    return SubElement(root, "g", {"id": names.unique(name)}) if name else root


def drawn_elements(svg: str) -> int:
    """Return the number of elements that a text of `write_drawing` draws; one element may hold many shapes."""
    return len(re.findall(r"<(?:path|circle|ellipse|rect)\b", svg)) - svg.count("<clipPath")


def _painted(
    element: Element, group: Sequence[Shape], names: Identifiers, gradients: GradientElements, precision: int
) -> list[Element]:
    """Return the element of a group with its id in front and its paint behind, and before it its gradient if that is
    new.
    """
    shape, around = group[0], group[-1]
    attributes = {"id": names.unique(shape.name), **element.attrib}
    before = None
    if shape.stroke is not None:
        attributes |= {"fill": "none", **paint("stroke", shape.fill), **_pen(shape.stroke, precision)}
    elif shape.gradient is not None:
        attributes["fill"], before = gradients.fill(shape.gradient)
    else:
        attributes |= paint("fill", shape.fill)
    if around.stroke is not None and shape.stroke is None:
        attributes |= {**paint("stroke", around.fill), **_pen(around.stroke, precision)}
    element.attrib = attributes
    return [element] if before is None else [before, element]


def _pen(stroke: Stroke, precision: int) -> dict[str, str]:
    """Return the width, cap and join of a stroke, without the defaults of SVG."""
    attributes = {"stroke-width": format_number(max(1, int(to_steps(stroke.width, precision))), precision)}
    if stroke.cap != BUTT and not stroke.closed:
        attributes["stroke-linecap"] = stroke.cap
    if stroke.join != MITER:
        attributes["stroke-linejoin"] = stroke.join
    if stroke.dashes:
        # Their errors add up along the path.
        fine = precision + _DASH_DECIMALS
        *dashes, offset = (format_number(int(to_steps(each, fine)), fine) for each in (*stroke.dashes, stroke.offset))
        attributes["stroke-dasharray"] = " ".join(dashes)
        if offset != "0":
            attributes["stroke-dashoffset"] = offset
    return attributes


def _element(group: Sequence[Shape], precision: int, rings: GridRings) -> Element | None:
    """Return the element of one shape, of a fill and the stroke around it, or of several shapes of one colour as a
    compound path; None if nothing is left.
    """
    group = group[:1] if group[0].stroke is None and group[-1].stroke is not None else group
    primitive = primitive_of(group[0]) if len(group) == 1 else None
    if primitive is not None:
        return _primitive(primitive, precision)
    path = PathText(precision)
    for shape in group:
        if shape.stroke is not None:
            add_stroke(path, shape.stroke.path)
        else:
            for index, outline in enumerate(shape.outlines):
                _add_outline(path, outline, index == 0, rings)
    return Element("path", {"d": path.text}) if path.text else None


def _primitive(outline: Circle | Ellipse | Rectangle, precision: int) -> Element | None:
    """Return a circle, ellipse or rect, or the path of a rect with rounder corners; None if it has no extent."""
    outline = _disc(outline, precision) if isinstance(outline, Rectangle) else outline
    if isinstance(outline, Circle):
        return _shown("circle", {"cx": outline.cx, "cy": outline.cy, "r": outline.r}, "r", precision)
    if isinstance(outline, Ellipse):
        lengths = {"cx": outline.cx, "cy": outline.cy, "rx": outline.rx, "ry": outline.ry}
        return _turned(_shown("ellipse", lengths, "rx", precision), outline.angle, outline.cx, outline.cy, precision)
    # Both ends of a side are rounded, so that they meet those of its neighbours.
    unit = 10.0**precision
    left, right = (int(to_steps(x, precision)) / unit for x in (outline.x, outline.x + outline.width))
    top, bottom = (int(to_steps(y, precision)) / unit for y in (outline.y, outline.y + outline.height))
    if outline.radius > MOST_ON_RECT:
        path = PathText(precision)
        add_rounded(path, outline, clockwise=True)
        element: Element | None = Element("path", {"d": path.text})
    else:
        lengths = {"x": left, "y": top, "width": right - left, "height": bottom - top, "rx": outline.radius}
        element = _shown("rect", lengths, "width", precision)
    return _turned(element, outline.angle, (left + right) / 2.0, (top + bottom) / 2.0, precision)


def _disc(box: Rectangle, precision: int) -> Circle | Rectangle:
    """Return a rectangle, as a circle if its corners are all of it."""
    if max(box.width, box.height) - 2.0 * box.radius >= 10.0**-precision:
        return box
    return Circle(box.x + box.width / 2.0, box.y + box.height / 2.0, box.radius)


def _shown(name: str, lengths: dict[str, float], extent: str, precision: int) -> Element | None:
    """Return an element with its lengths, except those of zero, the default; None if it has no extent."""
    steps = {attribute: int(to_steps(length, precision)) for attribute, length in lengths.items()}
    if steps[extent] <= 0 or steps.get("height", 1) <= 0 or steps.get("ry", 1) <= 0:
        return None
    return Element(name, {a: format_number(value, precision) for a, value in steps.items() if value})


def _turned(element: Element | None, angle: float, x: float, y: float, precision: int) -> Element | None:
    """Return an element with a rotation about (x, y). angle: radians."""
    degrees = _degrees(angle)
    if element is not None and degrees != "0":
        middle = (format_number(int(to_steps(value, precision + 1)), precision + 1) for value in (x, y))
        element.set("transform", f"rotate({degrees} {' '.join(middle)})")
    return element


def _degrees(angle: float) -> str:
    return format_number(round(math.degrees(angle) * 10**_ANGLE_DECIMALS), _ANGLE_DECIMALS)


def _add_outline(path: PathText, outline: Outline, clockwise: bool, rings: GridRings) -> None:
    """Append one ring of a compound path, clockwise as seen or not, if it has an extent."""
    if not isinstance(outline, Ring) and _primitive(outline, path.precision) is None:
        return
    outline = _disc(outline, path.precision) if isinstance(outline, Rectangle) else outline
    if isinstance(outline, Circle):
        outline = Ellipse(outline.cx, outline.cy, outline.r, outline.r)
    if isinstance(outline, Ellipse):
        _add_ellipse(path, outline, clockwise)
    elif isinstance(outline, Rectangle) and to_steps(outline.radius, path.precision) > 0 and outline.angle == 0.0:
        add_rounded(path, outline, clockwise=clockwise)
    else:
        rings.add(path, outline.ring(), clockwise)


def _add_ellipse(path: PathText, ellipse: Ellipse, clockwise: bool) -> None:
    """Append two half arcs between the ends of the first axis."""
    rx, angle = ellipse.rx, ellipse.angle
    radii = to_steps(np.array([rx, ellipse.ry]), path.precision).tolist()
    middle = to_steps(np.array([ellipse.cx, ellipse.cy]), path.precision)
    along = to_steps(np.array([rx * math.cos(angle), rx * math.sin(angle)]), path.precision)
    start, opposite = tuple((middle - along).tolist()), tuple((middle + along).tolist())
    path.move(start)
    for end in (opposite, start):
        path.arc(radii, _degrees(angle), (1, int(clockwise)), end)
    path.close()


def write_mosaic(mosaic: Mosaic, *, precision: int | None = None, title: str, comment: str, grouped: bool) -> str:
    """Return the SVG text of a mosaic. grouped: whether each colour is in a group. Otherwise like `write_drawing`."""
    precision = _precision_of(mosaic, precision)
    root, names = empty_document(mosaic.width, mosaic.height), Identifiers()
    for layer in mosaic.layers:
        data = _layer_path(layer, precision)
        if data:
            corners, _ = layer.loops
            whole = len(corners) == 4 and (np.ptp(corners, axis=0) == (mosaic.width, mosaic.height)).all()
            parent = _group_element(root, colour_group(layer.fill) if grouped else "", names)
            name = names.unique("background" if whole else colour_name(layer.fill))
            parent.append(Element("path", {"id": name, "d": data, **paint("fill", layer.fill)}))
    return titled(root, title, comment)


def _layer_path(layer: CellLayer, precision: int) -> str:
    """Return the loops of a layer in steps of 10^-precision px, relative, so that equal forms have equal texts."""
    places, ends = layer.loops
    corners = to_steps(places, precision)
    starts = np.concatenate([[0], ends[:-1]])
    steps = np.diff(corners, axis=0, append=corners[:1])
    # Each loop has as many horizontal as vertical sides, so these alternate throughout the layer.
    level, upright = _texts(steps[::2, 0], "h", precision), _texts(steps[1::2, 1], "v", precision)
    tokens = [token for pair in zip(level, upright, strict=True) for token in pair]
    begins = np.diff(corners[starts], axis=0, prepend=np.zeros((1, 2), dtype=np.int64))
    across, down = _texts(begins[:, 0], "zm", precision), _texts(begins[:, 1], "", precision)
    for start, end, x, y in zip(starts.tolist(), ends.tolist(), across, down, strict=True):
        tokens[start] = f"{x}{y if y[0] == '-' else f' {y}'}{tokens[start]}"
        tokens[end - 1] = ""  # closing the loop draws this side
    return "M" + "".join(tokens)[2:] + "z" if tokens else ""


def _texts(values: np.ndarray, letter: str, precision: int) -> list[str]:
    """Return each of the numbers (n,), in steps, as text after a letter."""
    different, which = np.unique(values, return_inverse=True)
    texts = [letter + format_number(value, precision) for value in different.tolist()]
    return [texts[index] for index in which.tolist()]
