"""Gradients: stops, units, transforms, and what one inherits from another."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from cubicsplat_cli.scene.paint import Gradient, LinearGradient, Stop, radial_from
from cubicsplat_cli.svg.own import OwnElement
from cubicsplat_cli.svg.values import hex_colour, is_transform, number, share, transform_matrix

LINEAR, RADIAL = "linearGradient", "radialGradient"
_HREF = ("href", "xlink:href")
_PLACES = {LINEAR: ("x1", "y1", "x2", "y2"), RADIAL: ("cx", "cy", "r")}
_DEFAULTS = {"x1": "0", "y1": "0", "x2": "100%", "y2": "0", "cx": "50%", "cy": "50%", "r": "50%"}
_DEEPEST = 16  # gradients that inherit from each other
MOST_STOPS = 1000

Box = tuple[float, float, float, float]  # left, top, width, height in px
_log = logging.getLogger("cubicsplat")


@dataclass
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
        return _linear(places, matrix, stops) if name == LINEAR else _radial(places, matrix, stops)

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
        places = {"fx": "cx", "fy": "cy"}
        names |= {n for n, own in places.items() if inherited(n, "") not in ("", inherited(own, _DEFAULTS[own]))}
        names |= {"fr"} if inherited("fr", "0") not in ("0", "0%") else set()
        if names - self._left_out:
            _log.warning("left out of the SVG's gradients: %s", ", ".join(sorted(names - self._left_out)))
            self._left_out |= names


def _stop(attributes: dict[str, str], before: list[Stop]) -> Stop:
    """The stop of an element; its offset is at least that of the one before it (SVG 1.1, section 13.2.4)."""
    if len(before) >= MOST_STOPS:
        raise ValueError(f"has more than {MOST_STOPS} stops in a gradient")
    opacity, offset = share(attributes.get("stop-opacity", "1")), share(attributes.get("offset", "0"))
    ink = (*hex_colour(attributes.get("stop-color", "#000")), round(255.0 * opacity))
    return Stop(max(offset, before[-1].offset if before else 0.0), ink)


def _place(text: str, name: str, relative: bool) -> float:
    """A coordinate in px, or where it is relative a share of the bounding box."""
    try:
        return number(text.removesuffix("%")) / 100.0 if relative and text.endswith("%") else number(text)
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


def _radial(places: list[float], matrix: np.ndarray, stops: tuple[Stop, ...]) -> Gradient:
    cx, cy, r = places
    if r <= 0.0:
        return LinearGradient(0.0, 0.0, 1.0, 0.0, (stops[-1],))
    return radial_from(matrix[:2] @ np.array([[r, 0.0, cx], [0.0, r, cy], [0.0, 0.0, 1.0]]), stops)
