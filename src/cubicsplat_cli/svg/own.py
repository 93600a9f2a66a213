"""Files of ours as XML: only known elements and attributes, no document type, no entities, nothing fetched.

Their gradients: stops, units, transforms, and what one inherits from another.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple
from xml.parsers import expat

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.formatting import printable
from cubicsplat_cli.progress import log
from cubicsplat_cli.scene.paint import Gradient, LinearGradient, Stop, radial_from
from cubicsplat_cli.svg.paths import PathSegment, subpaths
from cubicsplat_cli.svg.shapes import ATTRIBUTES
from cubicsplat_cli.svg.values import hex_colour, is_transform, parse_number, share, transform_matrix

MAX_OWN_BYTES = 256 * 1024 * 1024
MAX_ELEMENTS = 2_000_000  # of any SVG that is read
_MAX_SHOWN = 120  # characters of a message that come from the file
_VIEW = re.compile(r"0 0 ([1-9]\d{0,6}) ([1-9]\d{0,6})")
_LENGTH = re.compile(r"(\d{1,7}(?:\.\d{1,9})?)(mm|in)?")
_OF_ONE_SHAPE = 1e-3  # by which the proportions may differ: lengths are rounded
_PAINT = {"id", "fill", "fill-opacity"}
_STROKE = {"stroke", "stroke-opacity", "stroke-width", "stroke-linecap", "stroke-linejoin"}
REFERENCE = re.compile(r"url\(#([A-Za-z0-9_.-]+)\)")  # to an element, as our files write it
_GRADIENT = {"id", "gradientUnits", "gradientTransform", "spreadMethod", "href", "xlink:href"}
# The places of elements in files of ours, and the attributes of each.
_OWN: dict[str, set[str]] = {
    "svg": {"width", "height", "viewBox", "version", "baseProfile"},
    "svg/title": set(),
    "svg/defs": set(),
    "svg/g": {"id", "transform", "fill-rule", "fill", "fill-opacity", "clip-path", *_STROKE},
    "svg/clipPath": {"id"},
    "svg/g/g": {"opacity"},
    "svg/g/g/rect": {"x", "y", "width", "height", "fill", "stroke", "stroke-width"},
    "svg/g/g/image": {"x", "y", "width", "height", "preserveAspectRatio", "xlink:href"},
    "svg/g/g/g": {"transform", "fill-opacity"},
    "svg/g/g/g/path": {"d", "fill", "fill-opacity"},
    "svg/path": {"d", "transform", *_PAINT, *_STROKE},
    "svg/rect": {"x", "y", "width", "height", "rx", "transform", *_PAINT, *_STROKE},
    "svg/circle": {"cx", "cy", "r", *_PAINT, *_STROKE},
    "svg/ellipse": {"cx", "cy", "rx", "ry", "transform", *_PAINT, *_STROKE},
}
for _name in ("path", "rect", "circle", "ellipse"):
    _OWN[f"svg/g/{_name}"] = _OWN[f"svg/{_name}"]
    _OWN[f"svg/clipPath/{_name}"] = _OWN[f"svg/{_name}"] - _PAINT - _STROKE
for _name, _attributes in ATTRIBUTES.items():
    _OWN[f"svg/g/{_name}"] = {*_OWN.get(f"svg/g/{_name}", ()), *_attributes, "fill", "fill-opacity"}
for _parent in ("svg", "svg/defs", "svg/g"):
    _OWN[f"{_parent}/linearGradient"] = {"x1", "y1", "x2", "y2", *_GRADIENT}
    _OWN[f"{_parent}/radialGradient"] = {"cx", "cy", "r", "fx", "fy", "fr", *_GRADIENT}
    for _name in ("linearGradient", "radialGradient"):
        _OWN[f"{_parent}/{_name}/stop"] = {"offset", "stop-color", "stop-opacity"}

_RIM = 0.999  # of the way to the rim, the farthest focus
LINEAR, RADIAL = "linearGradient", "radialGradient"
_HREF = ("href", "xlink:href")
_PLACES = {LINEAR: ("x1", "y1", "x2", "y2"), RADIAL: ("cx", "cy", "r")}
_DEFAULTS = {"x1": "0", "y1": "0", "x2": "100%", "y2": "0", "cx": "50%", "cy": "50%", "r": "50%"}
_DEEPEST = 16  # gradients that inherit from each other
MOST_STOPS = 1000

Box = tuple[float, float, float, float]  # left, top, width, height in px


class OwnElement(NamedTuple):
    """An element of a file of ours. place: the names from the root to it, as in "svg/g/path"; line: its first one."""

    place: str
    attributes: dict[str, str]
    line: int

    @property
    def name(self) -> str:
        return self.place.rpartition("/")[2]

    def refused(self, reason: object) -> InputError:
        """The error for a document that is not ours, with the line where that shows."""
        what = printable(str(reason))
        what = what if len(what) <= _MAX_SHOWN else f"{what[:_MAX_SHOWN]}..."
        return InputError(
            f"this SVG was not written by cubicsplat or was edited: line {self.line} {what}; "
            "`cubicsplat render` and `cubicsplat eval` take any SVG"
        )


def own_elements(text: str | bytes) -> list[OwnElement]:
    """The elements of an SVG that has no others than those that cubicsplat writes, the root first.

    Raises InputError for anything else: too large, not XML, a document type or entity declaration, an element or
    attribute that is not in the table, a viewBox other than whole pixels from the origin.
    """
    data = text.encode() if isinstance(text, str) else text
    if len(data) > MAX_OWN_BYTES:
        raise InputError(f"the SVG has {len(data)} bytes; at most {MAX_OWN_BYTES} are read")
    parser = expat.ParserCreate("utf-8")
    elements: list[OwnElement] = []
    places = [""]

    def start(name: str, attributes: dict[str, str]) -> None:
        place = f"{places[-1]}{name}"
        element = OwnElement(place, attributes, parser.CurrentLineNumber)
        places.append(f"{place}/")
        if place not in _OWN:
            raise element.refused(f"has an unexpected <{name}> element")
        if not _OWN[place].issuperset(attributes):
            check_attributes(element, _OWN[place])
        if place == "svg":
            canvas_size(element)
        if len(elements) == MAX_ELEMENTS:
            raise element.refused(f"is one of more than {MAX_ELEMENTS} elements")
        elements.append(element)

    def end(_name: str) -> None:
        places.pop()

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = _refuse_doctype
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise InputError(f"the SVG is not well-formed XML: {error}; it may be cut short, write it again") from error
    return elements


def check_attributes(element: OwnElement, allowed: Iterable[str]) -> None:
    """Raise InputError where an element has an attribute that is not in `allowed`, nor names a namespace."""
    for name in element.attributes:
        if name not in allowed and name.partition(":")[0] != "xmlns":
            raise element.refused(f"has an unexpected attribute {name!r}")


def _refuse_doctype(*_: object) -> None:
    raise InputError("the SVG has a DOCTYPE or entity declaration, which cubicsplat never writes and does not read")


def canvas_size(root: OwnElement) -> tuple[int, int]:
    """Width and height in px of a file of ours. Raises InputError where its root does not say them as ours do."""
    width, height = (_LENGTH.fullmatch(root.attributes.get(name, "")) for name in ("width", "height"))
    if width is None or height is None or width[2] != height[2]:
        raise root.refused("needs width and height in px, mm or in")
    match = _VIEW.fullmatch(root.attributes.get("viewBox", ""))
    if match is None:
        raise root.refused("needs a viewBox of whole pixels from 0 0 on")
    across, down = float(width[1]) * int(match[2]), float(height[1]) * int(match[1])
    if abs(across - down) > _OF_ONE_SHAPE * across:
        raise root.refused("needs a viewBox of the shape of its width and height")
    return int(match[1]), int(match[2])


def own_subpaths(element: OwnElement) -> list[list[PathSegment]]:
    """The subpaths of a path. Raises ValueError for bad path data and for none."""
    try:
        paths = subpaths(element.attributes.get("d", ""))
    except InputError as error:
        raise ValueError(f"has {error}") from error
    if not paths:
        raise ValueError("has a path without data")
    return paths


@dataclass(eq=False)
class _Definition:
    element: OwnElement
    stops: list[Stop] = field(default_factory=list)


class GradientReader:
    """The gradients of one document.

    What is left out (reflected and repeated spreads, foci) is logged in one line for each kind. Raises InputError for
    a stop that cannot be read, and for a gradient without an id.
    """

    def __init__(self, elements: Iterable[OwnElement]) -> None:
        self._definitions: dict[str, _Definition] = {}
        self._left_out: set[str] = set()
        latest: list[Stop] = []
        for element in elements:
            if "Gradient" not in element.place:
                continue
            if element.name == "stop":
                try:
                    latest.append(_stop(element.attributes, latest))
                except ValueError as error:
                    raise element.refused(error) from error
            else:
                if "id" not in element.attributes:
                    raise element.refused(f"has a <{element.name}> without an id")
                definition = self._definitions[element.attributes["id"]] = _Definition(element)
                latest = definition.stops

    def __contains__(self, identifier: str) -> bool:
        return identifier in self._definitions

    def gradient(self, identifier: str, box: Box, to_px: np.ndarray | None = None) -> Gradient:
        """The gradient of a fill "url(#identifier)" for a shape with a bounding box. Raises ValueError for none.

        to_px: (3, 3) from the shape's units, in which the box is, to those of the result; None: the same.
        """
        definition = self._definitions.get(identifier)
        if definition is None:
            raise ValueError(f"is filled with #{identifier}, which is no gradient in it")
        chain = self._chain_of(definition)
        stops = next((tuple(each.stops) for each in chain if each.stops), ())
        if not stops:
            raise ValueError(f"has the gradient #{identifier} without stops")
        name = definition.element.name

        def inherited(attribute: str, default: str) -> str:
            attributes = (each.element.attributes for each in chain)
            return next((each[attribute] for each in attributes if attribute in each), default)

        self._note_left_out(inherited)
        units = inherited("gradientUnits", "objectBoundingBox")
        if units not in ("objectBoundingBox", "userSpaceOnUse"):
            raise ValueError(f"has gradientUnits={units!r}, not objectBoundingBox or userSpaceOnUse")
        relative = units == "objectBoundingBox"
        places = [_place(inherited(n, _DEFAULTS[n]), n, relative) for n in _PLACES[name]]
        transform = inherited("gradientTransform", "")
        if not is_transform(transform):
            raise ValueError(f"has the transform {transform!r}, which cannot be read")
        matrix = transform_matrix(transform)
        if relative:
            left, top, width, height = box
            matrix = np.array([[width, 0.0, left], [0.0, height, top], [0.0, 0.0, 1.0]]) @ matrix
        if to_px is not None:
            matrix = to_px @ matrix
        if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:2, :2])) < 1e-12:
            raise ValueError(f"has the gradient #{identifier} flattened to nothing")
        if name == LINEAR:
            return _linear(places, matrix, stops)
        focus = [
            _place(inherited(n, inherited(own, _DEFAULTS[own])), n, relative) for n, own in (("fx", "cx"), ("fy", "cy"))
        ]
        return _radial(places, focus, matrix, stops)

    def _chain_of(self, definition: _Definition) -> list[_Definition]:
        """The gradient and those that it inherits from, one after the other."""
        chain = [definition]
        while len(chain) <= _DEEPEST:
            attributes = chain[-1].element.attributes
            reference = next((attributes[name] for name in _HREF if name in attributes), None)
            if reference is None:
                return chain
            following = self._definitions.get(reference.removeprefix("#"))
            if following is None:
                raise ValueError(f"has a gradient that refers to {reference!r}, which is none in it")
            chain.append(following)
        raise ValueError("has gradients that refer to each other without end")

    def _note_left_out(self, inherited: Callable[[str, str], str]) -> None:
        names = {f"spreadMethod={inherited('spreadMethod', 'pad')!r}"} - {"spreadMethod='pad'"}
        names |= {"fr"} if inherited("fr", "0") not in ("0", "0%") else set()
        if names - self._left_out:
            log.warning("left out of the SVG's gradients: %s", ", ".join(sorted(names - self._left_out)))
            self._left_out |= names


def _stop(attributes: dict[str, str], before: list[Stop]) -> Stop:
    """The stop of an element; its offset is at least that of the one before it (SVG 1.1, section 13.2.4)."""
    if len(before) >= MOST_STOPS:
        raise ValueError(f"has more than {MOST_STOPS} stops in a gradient")
    opacity, offset = share(attributes.get("stop-opacity", "1")), share(attributes.get("offset", "0"))
    fill = (*hex_colour(attributes.get("stop-color", "#000")), round(255.0 * opacity))
    return Stop(max(offset, before[-1].offset if before else 0.0), fill)


def _place(text: str, name: str, relative: bool) -> float:
    """A coordinate in px, or where it is relative a share of the bounding box."""
    try:
        return parse_number(text.removesuffix("%")) / 100.0 if relative and text.endswith("%") else parse_number(text)
    except ValueError as error:
        raise ValueError(f"has {name}={text!r}, which is no number" + ("" if relative else " in px")) from error


def _linear(places: list[float], matrix: np.ndarray, stops: tuple[Stop, ...]) -> Gradient:
    x1, y1, x2, y2 = places
    square = (x2 - x1) ** 2 + (y2 - y1) ** 2
    if square <= 0.0:
        # SVG 1.1: where both ends are one, the last stop fills everything.
        return LinearGradient(0.0, 0.0, 1.0, 0.0, (stops[-1],))
    # Lines of one colour stay such under any transform, but no longer stand upright on the way between the ends.
    slope = np.array([x2 - x1, y2 - y1]) / square @ np.linalg.inv(matrix[:2, :2])
    start = matrix[:2] @ (x1, y1, 1.0)
    end = start + slope / float(slope @ slope)
    return LinearGradient(float(start[0]), float(start[1]), float(end[0]), float(end[1]), stops)


def _radial(places: list[float], focus: list[float], matrix: np.ndarray, stops: tuple[Stop, ...]) -> Gradient:
    cx, cy, r = places
    if r <= 0.0:
        return LinearGradient(0.0, 0.0, 1.0, 0.0, (stops[-1],))
    circle = matrix[:2] @ np.array([[r, 0.0, cx], [0.0, r, cy], [0.0, 0.0, 1.0]])
    off = np.array(focus) - (cx, cy)
    if not off.any():
        return radial_from(circle, stops)
    # One beyond the circle is moved to its rim (SVG 1.1, section 13.2.3), where t would have no bound.
    x, y = (matrix[:2] @ (*((cx, cy) + off * min(1.0, _RIM * r / float(np.hypot(*off)))), 1.0)).tolist()
    return radial_from(circle, stops, (x, y))
