"""The elements of files that cubicsplat wrote, and the gradients of any SVG.

Only elements and attributes that cubicsplat writes are accepted. A document type or an entity is refused.
"""

from __future__ import annotations

import re
from collections import ChainMap
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import field
from xml.parsers import expat

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.formatting import printable
from cubicsplat_cli.progress import log
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import Gradient, LinearGradient, Stop, radial_from
from cubicsplat_cli.svg.paths import PathSegment, subpaths
from cubicsplat_cli.svg.values import hex_colour, is_transform, parse_number, share, transform_matrix

MAX_OWN_BYTES = 256 * 1024 * 1024
MAX_ELEMENTS = 2_000_000  # of any SVG that is read
_MAX_SHOWN = 120  # characters of the file in a message
_VIEW = re.compile(r"0 0 ([1-9]\d{0,6}) ([1-9]\d{0,6})")
_LENGTH = re.compile(r"(\d{1,7}(?:\.\d{1,9})?)(mm|in)?")
_SAME_SHAPE = 1e-3  # relative difference of proportions, since lengths are rounded
REFERENCE = re.compile(r"url\(#([A-Za-z0-9_.-]+)\)")  # as cubicsplat writes it
LINEAR, RADIAL = "linearGradient", "radialGradient"
# The attributes that give the geometry of each shape.
GEOMETRY = {
    "path": ("d", "transform"),
    "rect": ("x", "y", "width", "height", "rx", "transform"),
    "circle": ("cx", "cy", "r"),
    "ellipse": ("cx", "cy", "rx", "ry", "transform"),
}
_STROKE = {"stroke", "stroke-opacity", "stroke-width", "stroke-linecap", "stroke-linejoin"}
_DASHES = {"stroke-dasharray", "stroke-dashoffset"}
_GRADIENT = {"id", "gradientUnits", "gradientTransform", "spreadMethod", "href", "xlink:href"}
# The attributes of each element, by its place in a file.
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
    "svg/g/polygon": {"points", "fill", "fill-opacity"},
}
for _name, _geometry in GEOMETRY.items():
    _OWN[f"svg/clipPath/{_name}"] = {*_geometry}
    _OWN[f"svg/{_name}"] = _OWN[f"svg/g/{_name}"] = {*_geometry, "id", "fill", "fill-opacity", *_STROKE, *_DASHES}
for _parent in ("svg", "svg/defs", "svg/g"):
    _OWN[f"{_parent}/linearGradient"] = {"x1", "y1", "x2", "y2", *_GRADIENT}
    _OWN[f"{_parent}/radialGradient"] = {"cx", "cy", "r", "fx", "fy", "fr", *_GRADIENT}
    for _name in (LINEAR, RADIAL):
        _OWN[f"{_parent}/{_name}/stop"] = {"offset", "stop-color", "stop-opacity"}

_RIM = 0.999  # largest distance of a focus from the middle, in radii
# The coordinates of each kind of gradient; the default of a focus is the middle.
_PLACES = {LINEAR: ("x1", "y1", "x2", "y2"), RADIAL: ("cx", "cy", "r", "fx", "fy")}
_DEFAULTS = {"x1": "0", "y1": "0", "x2": "100%", "y2": "0", "cx": "50%", "cy": "50%", "r": "50%"}
_DEEPEST = 16  # gradients that inherit from each other
MOST_STOPS = 1000

Box = tuple[float, float, float, float]  # left, top, width and height in px


@record
class OwnElement:
    """An element of a file. place: the names from the root to it, such as "svg/g/path". line: of its start tag."""

    place: str
    attributes: dict[str, str]
    line: int = 0
    children: list[OwnElement] = field(default_factory=list)

    @property
    def name(self) -> str:
        return self.place.rpartition("/")[2]

    def refused(self, reason: object) -> InputError:
        """Return the error, with the line, for a document that cubicsplat did not write."""
        what = printable(str(reason))
        what = what if len(what) <= _MAX_SHOWN else f"{what[:_MAX_SHOWN]}..."
        text = f"this SVG was not written by cubicsplat or was edited: line {self.line} {what}"
        return InputError(f"{text}; `cubicsplat render` and `cubicsplat eval` take any SVG")

    @contextmanager
    def checked(self) -> Iterator[None]:
        """Within, a ValueError says what is wrong with this element; it becomes the InputError of `refused`."""
        try:
            yield
        except ValueError as error:
            raise self.refused(error) from error

    def check_attributes(self, allowed: Iterable[str]) -> None:
        """Raise InputError for an attribute that is not in `allowed` and declares no namespace."""
        for name in self.attributes:
            if name not in allowed and name.partition(":")[0] != "xmlns":
                raise self.refused(f"has an unexpected attribute {name!r}")

    def canvas_size(self) -> tuple[int, int]:
        """Return the width and height of a root in px. Raises InputError where they are not as cubicsplat writes."""
        width, height = (_LENGTH.fullmatch(self.attributes.get(name, "")) for name in ("width", "height"))
        if width is None or height is None or width[2] != height[2]:
            raise self.refused("needs width and height in px, mm or in")
        match = _VIEW.fullmatch(self.attributes.get("viewBox", ""))
        if match is None:
            raise self.refused("needs a viewBox of whole pixels from 0 0 on")
        across, down = float(width[1]) * int(match[2]), float(height[1]) * int(match[1])
        if abs(across - down) > _SAME_SHAPE * across:
            raise self.refused("needs a viewBox of the shape of its width and height")
        return int(match[1]), int(match[2])

    def subpaths(self) -> list[list[PathSegment]]:
        """Return the subpaths of a path. Raises ValueError for bad path data and for none."""
        try:
            paths = subpaths(self.attributes.get("d", ""))
        except InputError as error:
            raise ValueError(f"has {error}") from error
        if not paths:
            raise ValueError("has a path without data")
        return paths


def own_elements(text: str | bytes) -> list[OwnElement]:
    """Return the elements of an SVG that cubicsplat wrote, the root first.

    Raises InputError for a file that is too large, XML that is not well-formed, a document type or an entity, an
    element or attribute that cubicsplat does not write, and a viewBox other than whole pixels from the origin.
    """
    data = text.encode() if isinstance(text, str) else text
    if len(data) > MAX_OWN_BYTES:
        raise InputError(f"the SVG has {len(data)} bytes; at most {MAX_OWN_BYTES} are read")
    parser = expat.ParserCreate("utf-8")
    elements: list[OwnElement] = []
    around: list[OwnElement] = []

    def start(name: str, attributes: dict[str, str]) -> None:
        place = f"{around[-1].place}/{name}" if around else name
        element = OwnElement(place, attributes, parser.CurrentLineNumber)
        if around:
            around[-1].children.append(element)
        around.append(element)
        if place not in _OWN:
            raise element.refused(f"has an unexpected <{name}> element")
        if not _OWN[place].issuperset(attributes):
            element.check_attributes(_OWN[place])
        if place == "svg":
            element.canvas_size()
        if len(elements) == MAX_ELEMENTS:
            raise element.refused(f"is one of more than {MAX_ELEMENTS} elements")
        elements.append(element)

    def refuse_doctype(*_: object) -> None:
        raise InputError("the SVG has a DOCTYPE or entity declaration, which cubicsplat never writes and does not read")

    parser.StartElementHandler, parser.EndElementHandler = start, lambda _: around.pop()
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse_doctype
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise InputError(f"the SVG is not well-formed XML: {error}; it may be cut short, write it again") from error
    return elements


class GradientReader:
    """The gradients of one document by their ids.

    It leaves out spread methods other than "pad" and the circle of a focus (`fr`); the log gets a line for each kind.
    Raises InputError for a stop that cannot be read, and for a gradient without an id.
    """

    def __init__(self, elements: Iterable[OwnElement]) -> None:
        self._elements: dict[str, OwnElement] = {}
        self._stops: dict[str, list[Stop]] = {}
        self._left_out: set[str] = set()
        for element in elements:
            if not element.name.endswith("Gradient"):
                continue
            identifier = element.attributes.get("id")
            if identifier is None:
                raise element.refused(f"has a <{element.name}> without an id")
            stops: list[Stop] = []
            for stop in element.children:
                with stop.checked():
                    stops.append(_stop(stop.attributes, stops))
            self._elements[identifier], self._stops[identifier] = element, stops

    def __contains__(self, identifier: str) -> bool:
        return identifier in self._elements

    def gradient(self, identifier: str, box: Box, to_px: np.ndarray | None = None) -> Gradient:
        """Return the gradient of a fill "url(#identifier)" for a shape with a bounding box.

        to_px: (3, 3) from the units of the shape and its box to those of the result; None where they are the same.
        Raises ValueError where there is none, or it cannot be read.
        """
        if identifier not in self._elements:
            raise ValueError(f"is filled with #{identifier}, which is no gradient in it")
        chain = self._chain_of(identifier)
        stops = next((tuple(self._stops[name]) for name in chain if self._stops[name]), ())
        if not stops:
            raise ValueError(f"has the gradient #{identifier} without stops")
        given = ChainMap(*(self._elements[name].attributes for name in chain))
        self._note_left_out(given)
        units = given.get("gradientUnits", "objectBoundingBox")
        if units not in ("objectBoundingBox", "userSpaceOnUse"):
            raise ValueError(f"has gradientUnits={units!r}, not objectBoundingBox or userSpaceOnUse")
        relative, kind = units == "objectBoundingBox", self._elements[identifier].name
        defaults = {**_DEFAULTS, "fx": given.get("cx", "50%"), "fy": given.get("cy", "50%")}
        places = [_place(given.get(name, defaults[name]), name, relative) for name in _PLACES[kind]]
        transform = given.get("gradientTransform", "")
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
        return (_linear if kind == LINEAR else _radial)(places, matrix, stops)

    def _chain_of(self, identifier: str) -> list[str]:
        """Return the ids of a gradient and of those that it inherits from, one after the other."""
        chain = [identifier]
        while len(chain) <= _DEEPEST:
            attributes = self._elements[chain[-1]].attributes
            reference = attributes.get("href", attributes.get("xlink:href"))
            if reference is None:
                return chain
            chain.append(reference.removeprefix("#"))
            if chain[-1] not in self._elements:
                raise ValueError(f"has a gradient that refers to {reference!r}, which is none in it")
        raise ValueError("has gradients that refer to each other without end")

    def _note_left_out(self, given: Mapping[str, str]) -> None:
        names = {f"spreadMethod={given.get('spreadMethod', 'pad')!r}"} - {"spreadMethod='pad'"}
        names |= {"fr"} if given.get("fr", "0") not in ("0", "0%") else set()
        if names - self._left_out:
            log.warning("left out of the SVG's gradients: %s", ", ".join(sorted(names - self._left_out)))
            self._left_out |= names


def _stop(attributes: dict[str, str], before: list[Stop]) -> Stop:
    """Return the stop of an element; its offset is at least that of the stop before (SVG 1.1, section 13.2.4)."""
    if len(before) >= MOST_STOPS:
        raise ValueError(f"has more than {MOST_STOPS} stops in a gradient")
    opacity, offset = share(attributes.get("stop-opacity", "1")), share(attributes.get("offset", "0"))
    fill = (*hex_colour(attributes.get("stop-color", "#000")), round(255.0 * opacity))
    return Stop(max(offset, before[-1].offset if before else 0.0), fill)


def _place(text: str, name: str, relative: bool) -> float:
    """Return a coordinate in px, or, if relative, a share of the bounding box."""
    try:
        return parse_number(text.removesuffix("%")) / 100.0 if relative and text.endswith("%") else parse_number(text)
    except ValueError as error:
        raise ValueError(f"has {name}={text!r}, which is no number" + ("" if relative else " in px")) from error


def _linear(places: list[float], matrix: np.ndarray, stops: tuple[Stop, ...]) -> Gradient:
    x1, y1, x2, y2 = places
    square = (x2 - x1) ** 2 + (y2 - y1) ** 2
    if square <= 0.0:
        # SVG 1.1: if both ends are one point, the last stop fills everything.
        return LinearGradient(0.0, 0.0, 1.0, 0.0, (stops[-1],))
    # An affine map keeps lines of one colour straight, but no longer at right angles to the line between the ends.
    slope = np.array([x2 - x1, y2 - y1]) / square @ np.linalg.inv(matrix[:2, :2])
    start = matrix[:2] @ (x1, y1, 1.0)
    end = start + slope / float(slope @ slope)
    return LinearGradient(float(start[0]), float(start[1]), float(end[0]), float(end[1]), stops)


def _radial(places: list[float], matrix: np.ndarray, stops: tuple[Stop, ...]) -> Gradient:
    cx, cy, r, fx, fy = places
    if r <= 0.0:
        return LinearGradient(0.0, 0.0, 1.0, 0.0, (stops[-1],))
    circle = matrix[:2] @ np.array([[r, 0.0, cx], [0.0, r, cy], [0.0, 0.0, 1.0]])
    off = np.array([fx, fy]) - (cx, cy)
    if not off.any():
        return radial_from(circle, stops)
    # A focus outside the circle is moved to its rim (SVG 1.1, section 13.2.3), where t would have no bound.
    x, y = (matrix[:2] @ (*((cx, cy) + off * min(1.0, _RIM * r / float(np.hypot(*off)))), 1.0)).tolist()
    return radial_from(circle, stops, (x, y))
