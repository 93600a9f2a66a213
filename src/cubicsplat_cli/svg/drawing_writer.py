"""Artwork as one plain SVG 1.1 document: primitives as such, one path per other shape, exact colours, named shapes; and
mosaics of cells, a path of horizontal and vertical lines for each colour.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import (
    Circle,
    Ellipse,
    Outline,
    Rectangle,
    Ring,
    reversed_ring,
    signed_area,
)
from cubicsplat_cli.artwork.geometry.steps import suggested_precision, to_steps
from cubicsplat_cli.artwork.geometry.stroke import BUTT, MITER, Chain, Stroke
from cubicsplat_cli.artwork.shapes import Drawing, Shape, colour_group, colour_name
from cubicsplat_cli.svg.compound import compounds
from cubicsplat_cli.svg.drawing_grid import form_of, grid_rings
from cubicsplat_cli.svg.drawing_paths import MOST_ON_RECT, PathText, add_ring, add_rounded, add_stroke
from cubicsplat_cli.svg.markup import (
    GradientElements,
    Identifiers,
    document,
    empty_document,
    format_number,
    opacity_of,
    paint,
    short_colour,
)
from cubicsplat_cli.svg.quantise import check_precision
from cubicsplat_cli.svg.shading import clipped

if TYPE_CHECKING:
    from cubicsplat_cli.artwork.mosaic import CellLayer, Mosaic

_ANGLE_DECIMALS = 3  # degrees


def write_drawing(drawing: Drawing, *, precision: int | None = None, title: str, comment: str) -> str:
    """The SVG text of artwork: its shapes in order, the first at the back, nothing else in it; see `compounds`. Of
    shapes that abut each is a path of its own. Shapes in a row that are in one group are in one `<g>`.

    precision: decimals of the coordinates in px, 0..6; by default `suggested_precision`. title: any text, shown by
    viewers. comment: one line for an XML comment; the command line knows its own files by it. A shape that is smaller
    than the grid's step is left out. Raises UsageError for a bad precision.
    """
    if precision is None:
        precision = suggested_precision(drawing.width, drawing.height)
    check_precision(precision)
    root = empty_document(drawing.width, drawing.height, title, comment)
    names = Identifiers()
    gradients = GradientElements(names, precision)
    groups = [[shape] for shape in drawing.shapes] if drawing.abutting else compounds(drawing.shapes)
    rings = _GridRings(drawing.shapes, precision, drawing.abutting)
    held: tuple[str, ElementTree.Element] = ("", root)
    for group in groups:
        element = _element(group, precision, rings)
        if element is None:
            continue
        if group[0].group != held[0]:
            held = group[0].group, group_element(root, group[0].group, names)
        finished = _finished(element, group[0], names, gradients, precision)
        held[1].extend(finished if group[0].shading is None else clipped(finished, group[0], names))
    return document(root)


def group_element(root: ElementTree.Element, name: str, names: Identifiers) -> ElementTree.Element:
    """A new group of a name; the root for no name."""
    return ElementTree.SubElement(root, "g", {"id": names.unique(name)}) if name else root


def drawn_elements(svg: str) -> int:
    """The number of elements that a text of `write_drawing` draws; at most its shapes, since one may hold many."""
    return len(re.findall(r"<(?:path|circle|ellipse|rect)\b", svg)) - svg.count("<clipPath")


def _finished(
    element: ElementTree.Element, shape: Shape, names: Identifiers, gradients: GradientElements, precision: int
) -> list[ElementTree.Element]:
    """The element with its id in front and its paint behind; before it its gradient, where that is new."""
    red, green, blue, alpha = shape.fill
    attributes = {"id": names.unique(shape.name), **element.attrib}
    before = None
    if shape.stroke is not None:
        attributes |= {"fill": "none", "stroke": short_colour(red, green, blue)}
        attributes |= opacity_of("stroke", alpha)
        attributes |= _pen(shape.stroke, precision)
    elif shape.gradient is not None:
        attributes["fill"], before = gradients.fill(shape.gradient)
    else:
        attributes |= paint(shape.fill)
    element.attrib = attributes
    return [element] if before is None else [before, element]


def _pen(stroke: Stroke, precision: int) -> dict[str, str]:
    """The attributes that say how a stroke is drawn, those left out that are as SVG has them anyway."""
    width = max(1, int(to_steps(stroke.width, precision)))
    attributes = {"stroke-width": format_number(width, precision)}
    if stroke.cap != BUTT and not stroke.closed:
        attributes["stroke-linecap"] = stroke.cap
    if stroke.join != MITER:
        attributes["stroke-linejoin"] = stroke.join
    return attributes


class _GridRings:
    """The rings of a drawing in whole steps of the file's grid, each rounded once.

    exact: every point of a path stands at its own step, as in the paths that share it. repeated: the forms that more
    than one ring has.
    """

    def __init__(self, shapes: Sequence[Shape], precision: int, exact: bool) -> None:
        self.exact = exact
        self._precision = precision
        self._cache: dict[tuple[int, bool], tuple[Ring, Ring]] = {}
        placed = [
            (outline, index == 0)
            for shape in shapes
            if shape.stroke is None
            for index, outline in enumerate(shape.outlines)
            if isinstance(outline, Ring)
        ]
        given = {(id(ring), clockwise): ring for ring, clockwise in placed}
        turned = [_turned_to(ring, clockwise) for (_, clockwise), ring in given.items()]
        for (key, ring), grid in zip(given.items(), grid_rings(turned, precision, exact), strict=True):
            self._cache[key] = ring, grid
        forms = Counter(form_of(self.of(*each)) for each in placed)
        self.repeated = {form for form, count in forms.items() if count > 1}

    def of(self, ring: Ring, clockwise: bool) -> Ring:
        """One of them, as seen clockwise or not."""
        cached = self._cache.get((id(ring), clockwise))
        if cached is None:
            cached = ring, grid_rings([_turned_to(ring, clockwise)], self._precision, self.exact)[0]
            self._cache[id(ring), clockwise] = cached
        return cached[1]


def _turned_to(ring: Ring, clockwise: bool) -> Ring:
    return ring if (signed_area(ring) > 0.0) == clockwise else reversed_ring(ring)


def _element(group: Sequence[Shape], precision: int, rings: _GridRings) -> ElementTree.Element | None:
    """The element of one shape, or of several of one colour as a compound path; None if none of it is left."""
    stroke = group[0].stroke
    if stroke is not None and not isinstance(stroke.path, (Chain, Ring)):
        return _primitive(stroke.path, precision)
    first = group[0].outlines
    if stroke is None and len(group) == 1 and len(first) == 1 and not isinstance(first[0], Ring):
        return _primitive(first[0], precision)
    path = PathText(precision)
    for shape in group:
        if shape.stroke is not None:
            add_stroke(path, shape.stroke.path, precision)
            continue
        for index, outline in enumerate(shape.outlines):
            _add_outline(path, outline, precision, index == 0, rings)
    return ElementTree.Element("path", {"d": path.text}) if path.text else None


def _primitive(outline: Circle | Ellipse | Rectangle, precision: int) -> ElementTree.Element | None:
    """A circle, ellipse or rect; None where it has no extent."""
    if isinstance(outline, Circle):
        return _shown("circle", {"cx": outline.cx, "cy": outline.cy, "r": outline.r}, "r", precision)
    if isinstance(outline, Ellipse):
        lengths = {"cx": outline.cx, "cy": outline.cy, "rx": outline.rx, "ry": outline.ry}
        return _turned(_shown("ellipse", lengths, "rx", precision), outline.angle, outline.cx, outline.cy, precision)
    unit = 10.0**precision
    if (disc := _disc(outline, precision)) is not None:
        return _primitive(disc, precision)
    # Both ends of a side are rounded, so that it meets its neighbours'.
    left, right = (int(to_steps(x, precision)) / unit for x in (outline.x, outline.x + outline.width))
    top, bottom = (int(to_steps(y, precision)) / unit for y in (outline.y, outline.y + outline.height))
    lengths = {"x": left, "y": top, "width": right - left, "height": bottom - top, "rx": outline.radius}
    middle = ((left + right) / 2.0, (top + bottom) / 2.0)
    if outline.radius > MOST_ON_RECT:
        path = PathText(precision)
        add_rounded(path, outline, precision, clockwise=True)
        return _turned(ElementTree.Element("path", {"d": path.text}), outline.angle, *middle, precision)
    return _turned(_shown("rect", lengths, "width", precision), outline.angle, *middle, precision)


def _disc(box: Rectangle, precision: int) -> Circle | None:
    """The circle that a rectangle is which has nothing but round corners; None for others."""
    if max(box.width, box.height) - 2.0 * box.radius >= 10.0**-precision:
        return None
    return Circle(box.x + box.width / 2.0, box.y + box.height / 2.0, box.radius)


def _shown(name: str, lengths: dict[str, float], extent: str, precision: int) -> ElementTree.Element | None:
    """An element with its lengths; those that are zero are left out, as zero is what they are then."""
    steps = {attribute: int(to_steps(length, precision)) for attribute, length in lengths.items()}
    if steps[extent] <= 0 or steps.get("height", 1) <= 0 or steps.get("ry", 1) <= 0:
        return None
    return ElementTree.Element(name, {a: format_number(value, precision) for a, value in steps.items() if value})


def _turned(
    element: ElementTree.Element | None, angle: float, x: float, y: float, precision: int
) -> ElementTree.Element | None:
    degrees = _degrees(angle)
    if element is not None and degrees != "0":
        middle = (format_number(int(to_steps(value, precision + 1)), precision + 1) for value in (x, y))
        element.set("transform", f"rotate({degrees} {' '.join(middle)})")
    return element


def _degrees(angle: float) -> str:
    return format_number(round(math.degrees(angle) * 10**_ANGLE_DECIMALS), _ANGLE_DECIMALS)


def _add_outline(path: PathText, outline: Outline, precision: int, clockwise: bool, rings: _GridRings) -> None:
    """One ring of a compound path: the outer ones clockwise as seen, holes the other way; none without extent."""
    if not isinstance(outline, Ring) and _primitive(outline, precision) is None:
        return
    if isinstance(outline, Rectangle):
        outline = _disc(outline, precision) or outline
    if isinstance(outline, (Circle, Ellipse)):
        _add_ellipse(path, outline, precision, clockwise)
        return
    if isinstance(outline, Rectangle) and outline.radius > 0.0 and outline.angle == 0.0:
        add_rounded(path, outline, precision, clockwise=clockwise)
        return
    ring = rings.of(outline.ring(), clockwise)
    add_ring(path, ring, rings.exact, relative=form_of(ring) in rings.repeated)


def _add_ellipse(path: PathText, outline: Circle | Ellipse, precision: int, clockwise: bool) -> None:
    """Two half arcs between the ends of the first axis."""
    ellipse = Ellipse(outline.cx, outline.cy, outline.r, outline.r) if isinstance(outline, Circle) else outline
    radii = (int(to_steps(ellipse.rx, precision)), int(to_steps(ellipse.ry, precision)))
    if min(radii) <= 0:
        return
    along = (
        to_steps(ellipse.rx * math.cos(ellipse.angle), precision),
        to_steps(ellipse.rx * math.sin(ellipse.angle), precision),
    )
    middle = to_steps(ellipse.cx, precision), to_steps(ellipse.cy, precision)
    ends = [(int(middle[0] + sign * along[0]), int(middle[1] + sign * along[1])) for sign in (-1, 1)]
    path.move(ends[0])
    for end in (ends[1], ends[0]):
        path.arc(radii, _degrees(ellipse.angle), (1, int(clockwise)), end)
    path.close()


def write_mosaic(
    mosaic: Mosaic, *, precision: int | None = None, title: str, comment: str, grouped: bool = False
) -> str:
    """The SVG text of a mosaic; arguments and errors as of `write_drawing`. grouped: each colour is in a group."""
    if precision is None:
        precision = suggested_precision(mosaic.width, mosaic.height)
    check_precision(precision)
    root, names = empty_document(mosaic.width, mosaic.height, title, comment), Identifiers()
    for layer in mosaic.layers:
        data = _layer_path(layer, precision)
        if data:
            held = group_element(root, colour_group(layer.fill) if grouped else "", names)
            name = names.unique(_layer_name(layer, mosaic))
            held.append(ElementTree.Element("path", {"id": name, "d": data, **paint(layer.fill)}))
    return document(root)


def _layer_name(layer: CellLayer, mosaic: Mosaic) -> str:
    corners, _ = layer.loops
    whole = len(corners) == 4 and (np.ptp(corners, axis=0) == (mosaic.width, mosaic.height)).all()
    return "background" if whole else colour_name(layer.fill)


def _layer_path(layer: CellLayer, precision: int) -> str:
    """The loops of a layer in steps of 10^-precision px, relative, so that like forms are the same text."""
    places, ends = layer.loops
    corners = to_steps(places, precision)
    starts = np.concatenate([[0], ends[:-1]])
    steps = np.diff(corners, axis=0, append=corners[:1])
    # A loop has as many level as upright sides: these take turns throughout the layer.
    level, upright = _texts(steps[::2, 0], "h", precision), _texts(steps[1::2, 1], "v", precision)
    tokens = [token for pair in zip(level, upright, strict=True) for token in pair]
    begins = np.diff(corners[starts], axis=0, prepend=np.zeros((1, 2), dtype=np.int64))
    across, down = _texts(begins[:, 0], "zm", precision), _texts(begins[:, 1], "", precision)
    for start, end, x, y in zip(starts.tolist(), ends.tolist(), across, down, strict=True):
        tokens[start] = f"{x}{y if y[0] == '-' else f' {y}'}{tokens[start]}"
        tokens[end - 1] = ""  # what closes the loop
    return "M" + "".join(tokens)[2:] + "z" if tokens else ""


def _texts(values: np.ndarray, letter: str, precision: int) -> list[str]:
    """Each of the numbers (n,), in steps, as text after a letter."""
    different, which = np.unique(values, return_inverse=True)
    texts: Callable[[int], str] = [letter + format_number(int(value), precision) for value in different].__getitem__
    return [texts(index) for index in which.tolist()]
