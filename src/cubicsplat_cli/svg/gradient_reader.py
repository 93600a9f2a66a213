"""Gradients of any SVG, as far as they are plain: stops, units, transforms, and what one inherits from another."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.scene.paint import Gradient, LinearGradient, Stop, radial_from
from cubicsplat_cli.svg.transforms import one_transform

LINEAR, RADIAL, STOP = "linearGradient", "radialGradient", "stop"
_HREF = ("href", "xlink:href")
_PLACES = {LINEAR: ("x1", "y1", "x2", "y2"), RADIAL: ("cx", "cy", "r")}
_DEFAULTS = {"x1": "0", "y1": "0", "x2": "100%", "y2": "0", "cx": "50%", "cy": "50%", "r": "50%"}
_COMMON = {"id", "gradientUnits", "gradientTransform", "spreadMethod", "xmlns", *_HREF}
_FOCUS = {"fx", "fy", "fr"}
_STOP = {"offset", "stop-color", "stop-opacity"}
_COLOUR = re.compile(r"#([0-9a-fA-F]{3}|[0-9a-fA-F]{6})")
_NUMBER = re.compile(r"[+-]?(?:\d{1,9}(?:\.\d{0,12})?|\.\d{1,12})(?:[eE][+-]?\d{1,2})?")
_TRANSFORM = re.compile(r"\s*(matrix|translate|scale|rotate|skewX|skewY)\s*\(([^()]*)\)[\s,]*")
_COUNTS = {"matrix": (6,), "translate": (1, 2), "scale": (1, 2), "rotate": (1, 3), "skewX": (1,), "skewY": (1,)}
_DEEPEST = 16  # gradients that inherit from each other
_MOST_STOPS = 1000

Box = tuple[float, float, float, float]  # left, top, width, height in px
_log = logging.getLogger("cubicsplat")


@dataclass
class _Element:
    name: str
    attributes: Mapping[str, str]
    stops: list[Stop] = field(default_factory=list)


class GradientReader:
    """The gradients of one document, which may be used before they are defined.

    foreign: makes the error for what cannot be read. What is left out (reflected and repeated spreads, foci) is logged
    in one line for each kind.
    """

    def __init__(self, foreign: Callable[[str], InputError]) -> None:
        self._foreign = foreign
        self._elements: dict[str, _Element] = {}
        self._open: _Element | None = None
        self._left_out: set[str] = set()

    def start(self, name: str, attributes: Mapping[str, str]) -> None:
        """The start of a gradient or of one of its stops."""
        if name == STOP:
            if self._open is None:
                raise self._foreign("has a <stop> outside of a gradient")
            self._stop(self._open.stops, attributes)
            return
        known = {*_COMMON, *_PLACES[name], *(_FOCUS if name == RADIAL else ())}
        self._check(attributes, known)
        if "id" not in attributes:
            raise self._foreign(f"has a <{name}> without an id")
        self._open = self._elements[attributes["id"]] = _Element(name, attributes)

    def end(self, name: str) -> None:
        """The end of an element that was started here."""
        if name in _PLACES:
            self._open = None

    def gradient(self, identifier: str, box: Box) -> Gradient:
        """The gradient of a fill "url(#identifier)" for a shape with a bounding box."""
        element = self._elements.get(identifier)
        if element is None:
            raise self._foreign(f"is filled with #{identifier}, which is no gradient in it")
        line = self._line_of(element)
        stops = next((tuple(e.stops) for e in line if e.stops), ())
        if not stops:
            raise self._foreign(f"has the gradient #{identifier} without stops")

        def inherited(name: str, default: str) -> str:
            return next((e.attributes[name] for e in line if name in e.attributes), default)

        self._note_left_out(inherited)
        units = inherited("gradientUnits", "objectBoundingBox")
        if units not in ("objectBoundingBox", "userSpaceOnUse"):
            raise self._foreign(f"has gradientUnits={units!r}, not objectBoundingBox or userSpaceOnUse")
        whole = units == "objectBoundingBox"
        places = [self._length(inherited(n, _DEFAULTS[n]), n, whole) for n in _PLACES[element.name]]
        matrix = self._transform(inherited("gradientTransform", ""))
        if whole:
            left, top, width, height = box
            matrix = np.array([[width, 0.0, left], [0.0, height, top], [0.0, 0.0, 1.0]]) @ matrix
        if abs(np.linalg.det(matrix[:2, :2])) < 1e-12:
            raise self._foreign(f"has the gradient #{identifier} flattened to nothing")
        return self._linear(places, matrix, stops) if element.name == LINEAR else self._radial(places, matrix, stops)

    def _line_of(self, element: _Element) -> list[_Element]:
        """The element and those that it inherits from, one after the other."""
        line = [element]
        while len(line) <= _DEEPEST:
            reference = next((line[-1].attributes[name] for name in _HREF if name in line[-1].attributes), None)
            if reference is None:
                return line
            following = self._elements.get(reference.removeprefix("#"))
            if following is None:
                raise self._foreign(f"has a gradient that refers to {reference!r}, which is none in it")
            line.append(following)
        raise self._foreign("has gradients that refer to each other without end")

    def _note_left_out(self, inherited: Callable[[str, str], str]) -> None:
        found = {f"spreadMethod={inherited('spreadMethod', 'pad')!r}"} - {"spreadMethod='pad'"}
        places = {"fx": "cx", "fy": "cy"}
        found |= {n for n, own in places.items() if inherited(n, "") not in ("", inherited(own, _DEFAULTS[own]))}
        found |= {"fr"} if inherited("fr", "0") not in ("0", "0%") else set()
        if found - self._left_out:
            _log.warning("left out of the SVG's gradients: %s", ", ".join(sorted(found - self._left_out)))
            self._left_out |= found

    def _linear(self, places: list[float], matrix: np.ndarray, stops: tuple[Stop, ...]) -> Gradient:
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

    def _radial(self, places: list[float], matrix: np.ndarray, stops: tuple[Stop, ...]) -> Gradient:
        cx, cy, r = places
        if r <= 0.0:
            return LinearGradient(0.0, 0.0, 1.0, 0.0, (stops[-1],))
        return radial_from(matrix[:2] @ np.array([[r, 0.0, cx], [0.0, r, cy], [0.0, 0.0, 1.0]]), stops)

    def _stop(self, stops: list[Stop], attributes: Mapping[str, str]) -> None:
        self._check(attributes, _STOP)
        if len(stops) >= _MOST_STOPS:
            raise self._foreign(f"has more than {_MOST_STOPS} stops in a gradient")
        match = _COLOUR.fullmatch(attributes.get("stop-color", "#000"))
        if match is None:
            raise self._foreign(f"has the colour {attributes['stop-color']!r}, not #rgb or #rrggbb")
        digits = match[1] if len(match[1]) == 6 else "".join(2 * digit for digit in match[1])
        opacity = min(max(self._length(attributes.get("stop-opacity", "1"), "stop-opacity", True), 0.0), 1.0)
        offset = min(max(self._length(attributes.get("offset", "0"), "offset", True), 0.0), 1.0)
        red, green, blue = bytes.fromhex(digits)
        last = stops[-1].offset if stops else 0.0
        stops.append(Stop(max(offset, last), (red, green, blue, round(255.0 * opacity))))

    def _length(self, text: str, name: str, shares: bool) -> float:
        share = text.endswith("%")
        number = text.removesuffix("%")
        if not _NUMBER.fullmatch(number) or (share and not shares):
            raise self._foreign(f"has {name}={text!r}, which is no number" + (" in px" if not shares else ""))
        return float(number) / (100.0 if share else 1.0)

    def _transform(self, text: str) -> np.ndarray:
        """(3, 3) of a list of transforms."""
        whole, position = np.eye(3), 0
        while position < len(text):
            match = _TRANSFORM.match(text, position)
            numbers = re.split(r"[\s,]+", match[2].strip()) if match else []
            if match is None or len(numbers) not in _COUNTS[match[1]]:
                raise self._foreign(f"has the transform {text!r}, which cannot be read")
            whole = whole @ one_transform(match[1], [self._length(n, "gradientTransform", False) for n in numbers])
            position = match.end()
        return whole

    def _check(self, attributes: Mapping[str, str], known: set[str]) -> None:
        for name in attributes:
            if name not in known:
                raise self._foreign(f"has an unexpected attribute {name!r}")
