"""Files of ours as XML: only known elements and attributes, no document type, no entities, nothing fetched."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple
from xml.parsers import expat

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.formatting import printable
from cubicsplat_cli.svg.paths import PathSegment, subpaths

MAX_OWN_BYTES = 256 * 1024 * 1024
MAX_ELEMENTS = 2_000_000  # of any SVG that is read
_MAX_SHOWN = 120  # characters of a message that come from the file
_PIXELS = re.compile(r"[1-9]\d{0,6}")
_PAINT = {"id", "fill", "fill-opacity"}
_STROKE = {"stroke", "stroke-opacity", "stroke-width", "stroke-linecap", "stroke-linejoin"}
_GRADIENT = {"id", "gradientUnits", "gradientTransform", "spreadMethod", "href", "xlink:href"}
# The places of elements in files of ours, and the attributes of each.
_OWN: dict[str, set[str]] = {
    "svg": {"width", "height", "viewBox", "version", "baseProfile"},
    "svg/title": set(),
    "svg/defs": set(),
    "svg/g": {"id", "transform", "fill-rule", "fill", "fill-opacity", *_STROKE},
    "svg/g/path": {"d", "fill", "fill-opacity", "stroke", "stroke-opacity", "stroke-width"},
    "svg/path": {"d", "transform", *_PAINT, *_STROKE},
    "svg/rect": {"x", "y", "width", "height", "rx", "transform", *_PAINT, *_STROKE},
    "svg/circle": {"cx", "cy", "r", *_PAINT, *_STROKE},
    "svg/ellipse": {"cx", "cy", "rx", "ry", "transform", *_PAINT, *_STROKE},
}
for _place in ("svg", "svg/defs"):
    _OWN[f"{_place}/linearGradient"] = {"x1", "y1", "x2", "y2", *_GRADIENT}
    _OWN[f"{_place}/radialGradient"] = {"cx", "cy", "r", "fx", "fy", "fr", *_GRADIENT}
    for _name in ("linearGradient", "radialGradient"):
        _OWN[f"{_place}/{_name}/stop"] = {"offset", "stop-color", "stop-opacity"}


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
    attribute that is not in the table, a size other than whole pixels.
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
    width, height = (root.attributes.get(name, "") for name in ("width", "height"))
    if not (_PIXELS.fullmatch(width) and _PIXELS.fullmatch(height)):
        raise root.refused("needs width and height in whole pixels")
    if root.attributes.get("viewBox") != f"0 0 {width} {height}":
        raise root.refused("needs a viewBox equal to its width and height")
    return int(width), int(height)


def own_subpaths(element: OwnElement) -> list[list[PathSegment]]:
    """The subpaths of a path. Raises ValueError for bad path data and for none."""
    try:
        paths = subpaths(element.attributes.get("d", ""))
    except InputError as error:
        raise ValueError(f"has {error}") from error
    if not paths:
        raise ValueError("has a path without data")
    return paths
