"""Reads the SVG files that `write_drawing` makes back into a drawing; any other SVG is refused with a clear line.

Expat with a whitelist of elements and attributes: no document type, no entities, nothing fetched.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from typing import TypeVar
from xml.parsers import expat

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Outline, Rectangle, Ring, signed_area
from cubicsplat_cli.artwork.geometry.stroke import Path
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.artwork.strokes.offset import outlines_of_stroke
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.formatting import printable
from cubicsplat_cli.scene.paint import Ink, mean_ink
from cubicsplat_cli.svg.canvas import canvas_size
from cubicsplat_cli.svg.gradient_reader import LINEAR, RADIAL, STOP, GradientReader
from cubicsplat_cli.svg.pathparse import Piece, subpaths
from cubicsplat_cli.svg.quantise import MAX_COORDINATE
from cubicsplat_cli.svg.rounded import rounded_of
from cubicsplat_cli.svg.strokes import STROKE_PAINT, read_chain, read_pen

_COLOUR = re.compile(r"#([0-9a-fA-F]{3}|[0-9a-fA-F]{6})")
_NUMBER = re.compile(r"-?(?:\d{1,9}(?:\.\d{1,12})?|\.\d{1,12})")
_ROTATION = re.compile(r"rotate\((-?[\d.]{1,12}) (-?[\d.]{1,20}) (-?[\d.]{1,20})\)")
_REFERENCE = re.compile(r"url\(\s*['\"]?#([^'\"()]+?)['\"]?\s*\)")
_GRADIENTS = (LINEAR, RADIAL)
_PAINT = {"id", "fill", "fill-opacity"}
_LENGTHS = {
    "circle": ("cx", "cy", "r"),
    "ellipse": ("cx", "cy", "rx", "ry"),
    "rect": ("x", "y", "width", "height", "rx"),
    "path": (),
}
_MORE = {"circle": set(), "ellipse": {"transform"}, "rect": {"transform"}, "path": {"d", "transform"}}
_ROOT = {"width", "height", "viewBox", "xmlns", "xmlns:xlink"}
AnyPath = TypeVar("AnyPath", bound=Path)
# A joint that turns by less is meant to be smooth.
_SMOOTH = math.radians(0.5)


class _Found(Exception):
    """The first element that tells the two kinds of file apart."""


def is_drawing(data: bytes) -> bool:
    """Whether an SVG has shapes right below its root, as artwork has, and no group of curves. False for bad XML."""
    depth, answer = 0, False

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth, answer
        depth += 1
        if depth == 2 and (name == "g" or name in _LENGTHS):
            answer = name != "g"
            if name != "rect":  # which may be either's background
                raise _Found

    def end(_name: str) -> None:
        nonlocal depth
        depth -= 1

    parser = expat.ParserCreate("utf-8")
    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(data, True)
    except _Found:
        return answer
    except expat.ExpatError:
        return False
    return answer


def read_drawing(text: str | bytes) -> Drawing:
    """The drawing of an SVG that `write_drawing` wrote; InputError for anything else."""
    collector = _Collector()
    parser = expat.ParserCreate("utf-8")
    collector.parser = parser
    parser.StartElementHandler = collector.start
    parser.EndElementHandler = collector.end
    parser.StartDoctypeDeclHandler = _refuse_doctype
    parser.EntityDeclHandler = _refuse_doctype
    try:
        parser.Parse(text.encode() if isinstance(text, str) else text, True)
    except expat.ExpatError as error:
        raise InputError(f"the SVG is not well-formed XML: {error}; it may be cut short, write it again") from error
    if collector.size is None:
        raise InputError("the SVG says no size; give a file that `cubicsplat vectorize` wrote")
    return Drawing(*collector.size, tuple(collector.painted()))


def _refuse_doctype(*_: object) -> None:
    raise InputError("the SVG has a DOCTYPE or entity declaration, which cubicsplat never writes and does not read")


@dataclass
class _Collector:
    """Follows the elements of one document: svg > (title, gradients, defs > gradients, shapes)."""

    parser: expat.XMLParserType | None = None
    size: tuple[int, int] | None = None
    depth: int = 0
    shapes: list[Shape] = field(default_factory=list)
    # Of elements in a gradient: the first of their shapes, how many, and the gradient's id.
    references: list[tuple[int, int, str]] = field(default_factory=list)
    inside: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.gradients = GradientReader(self.foreign)

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self.depth += 1
        parent = self.inside[-1] if self.inside else ""
        self.inside.append(name)
        if self.depth == 1 and name == "svg":
            self._root(attributes)
        elif self.depth == 2 and name in _LENGTHS:
            self._add(name, attributes)
        elif (name in _GRADIENTS and parent in ("svg", "defs")) or (name == STOP and parent in _GRADIENTS):
            self.gradients.start(name, attributes)
        elif self.depth != 2 or name not in ("title", "defs"):
            raise self.foreign(f"has an unexpected <{name}> element")

    def end(self, name: str) -> None:
        self.depth -= 1
        self.inside.pop()
        self.gradients.end(name)

    def painted(self) -> list[Shape]:
        """The shapes, with the gradients that some of them are filled with, wherever those stand."""
        for first, count, identifier in self.references:
            rings = [o.ring() for shape in self.shapes[first : first + count] for o in shape.outlines]
            low, high = extent_of(rings)
            gradient = self.gradients.gradient(identifier, (*low.tolist(), *(high - low).tolist()))
            for index in range(first, first + count):
                self.shapes[index] = replace(self.shapes[index], ink=mean_ink(gradient), gradient=gradient)
        return self.shapes

    def _add(self, name: str, attributes: dict[str, str]) -> None:
        if attributes.get("fill") == "none":
            self.shapes += self._strokes(name, attributes)
            return
        match = _REFERENCE.fullmatch(attributes.get("fill", ""))
        if match is None:
            self.shapes += self._shapes(name, attributes)
            return
        if attributes.get("fill-opacity", "1") != "1":
            raise self.foreign("has a fill-opacity beside a gradient; give its stops the opacity")
        shapes = self._shapes(name, attributes | {"fill": "#000"})
        self.references.append((len(self.shapes), len(shapes), match[1]))
        self.shapes += shapes

    def foreign(self, what: str) -> InputError:
        """The error for a document that is not ours, with the line where that shows."""
        line = self.parser.CurrentLineNumber if self.parser is not None else 0
        return InputError(
            f"this SVG was not written by cubicsplat or was edited: line {line} {printable(what)[:120]}; "
            "`cubicsplat render` and `cubicsplat eval` take any SVG"
        )

    def _root(self, attributes: dict[str, str]) -> None:
        self._check(attributes, _ROOT)
        self.size = canvas_size(attributes, self.foreign)

    def _check(self, attributes: dict[str, str], known: set[str]) -> None:
        for name in attributes:
            if name not in known:
                raise self.foreign(f"has an unexpected attribute {name!r}")

    def _shapes(self, name: str, attributes: dict[str, str]) -> list[Shape]:
        """One shape, of a compound path one for each ring that runs clockwise as seen: the others are its holes."""
        self._check(attributes, _PAINT | set(_LENGTHS[name]) | _MORE[name])
        ink, identifier = self._ink(attributes), attributes.get("id", "")
        if name != "path":
            return [Shape(ink, (self._primitive(name, attributes),), identifier)]
        groups: list[list[Outline]] = []
        for outline, clockwise in self._rings(attributes.get("d", "")):
            if clockwise or not groups:
                groups.append([])
            groups[-1].append(self._turned(outline, attributes))
        return [Shape(ink, tuple(group), identifier) for group in groups]

    def _strokes(self, name: str, attributes: dict[str, str]) -> list[Shape]:
        """One stroke, of a path one for each of its subpaths."""
        self._check(attributes, STROKE_PAINT | set(_LENGTHS[name]) | _MORE[name])
        paint = {"fill": attributes.get("stroke", ""), "fill-opacity": attributes.get("stroke-opacity", "1")}
        ink, drawn = self._ink(paint), read_pen(attributes, self._number, self.foreign)
        paths: list[Path] = []
        if name != "path":
            paths = [self._primitive(name, attributes)]
        else:
            for subpath in self._subpaths(attributes.get("d", "")):
                closed = bool(subpath) and subpath[-1].command == "Z"
                if not closed and not re.fullmatch(r"[LHVCS]+", "".join(piece.command for piece in subpath)):
                    raise self.foreign("has an open path of other than L, H, V, C and S")
                paths.append(self._outline(subpath)[0] if closed else read_chain(self._bounded(subpath)))
            paths = [self._turned(path, attributes) for path in paths]
        strokes = [replace(drawn, path=path) for path in paths]
        identifier = attributes.get("id", "")
        return [Shape(ink, outlines_of_stroke(stroke), identifier, stroke=stroke) for stroke in strokes]

    def _ink(self, attributes: dict[str, str]) -> Ink:
        match = _COLOUR.fullmatch(attributes.get("fill", ""))
        if match is None:
            raise self.foreign(f"has the colour {attributes.get('fill')!r}, not #rgb or #rrggbb")
        digits = match[1] if len(match[1]) == 6 else "".join(2 * digit for digit in match[1])
        opacity = self._number(attributes.get("fill-opacity", "1"))
        if not 0.0 <= opacity <= 1.0:
            raise self.foreign(f"has the opacity {opacity:g}, not one in 0..1")
        red, green, blue = bytes.fromhex(digits)
        return red, green, blue, round(255.0 * opacity)

    def _number(self, text: str) -> float:
        if not _NUMBER.fullmatch(text) or abs(float(text)) > MAX_COORDINATE:
            raise self.foreign(f"has the number {text!r} where one in px is wanted")
        return float(text)

    def _primitive(self, name: str, attributes: dict[str, str]) -> Outline:
        lengths = [self._number(attributes.get(length, "0")) for length in _LENGTHS[name]]
        if min(lengths[2:4]) <= 0.0 or lengths[-1] < 0.0:
            raise self.foreign(f"has a <{name}> without extent")
        if name == "circle":
            x, y, radius = lengths
            return Circle(x, y, radius)
        if name == "ellipse":
            x, y, rx, ry = lengths
            return Ellipse(x, y, rx, ry, self._angle(attributes))
        x, y, width, height, radius = lengths
        return Rectangle(x, y, width, height, radius, self._angle(attributes))

    def _angle(self, attributes: dict[str, str]) -> float:
        if "transform" not in attributes:
            return 0.0
        match = _ROTATION.fullmatch(attributes["transform"])
        if match is None:
            raise self.foreign("has a transform other than a rotation about the middle")
        return math.radians(self._number(match[1]))

    def _turned(self, path: AnyPath, attributes: dict[str, str]) -> AnyPath:
        """What an element holds, turned as it says: of paths only rounded rectangles are."""
        if "transform" not in attributes:
            return path
        if not isinstance(path, Rectangle):
            raise self.foreign("has a transform of a path other than a rounded rectangle")
        return replace(path, angle=self._angle(attributes))

    def _rings(self, d: str) -> list[tuple[Outline, bool]]:
        """Each ring, and whether it runs clockwise as seen."""
        return [self._outline(subpath) for subpath in self._subpaths(d)]

    def _subpaths(self, d: str) -> list[list[Piece]]:
        try:
            found = subpaths(d)
        except InputError as error:
            raise self.foreign(f"has {error}") from error
        if not found:
            raise self.foreign("has a path without data")
        return found

    def _bounded(self, subpath: list[Piece]) -> list[Piece]:
        """The subpath, none of whose points lies too far away."""
        numbers = [*(v for p in subpath for point in (p.start, p.end, *p.handles) for v in point)]
        if not all(abs(number) <= MAX_COORDINATE for number in numbers):  # false for NaN too
            raise self.foreign(f"has a point more than {MAX_COORDINATE:.0f} px from the origin")
        return subpath

    def _outline(self, subpath: list[Piece]) -> tuple[Outline, bool]:
        self._bounded(subpath)
        letters = "".join(piece.command for piece in subpath)
        if letters == "AAZ":
            return self._ellipse(*subpath[:2]), subpath[0].numbers[4] == 1.0
        rounded = rounded_of(subpath)
        if rounded is not None:
            return rounded
        if not re.fullmatch(r"[LHVCS]+Z", letters):
            raise self.foreign(
                "has path data other than closed rings of L, H, V, C, S, two half ellipses, or a rounded rectangle"
            )
        ring = _ring(subpath)
        return ring, signed_area(ring) > 0.0

    def _ellipse(self, first: Piece, second: Piece) -> Outline:
        rx, ry, degrees = first.numbers[:3]
        middle = ((first.start[0] + first.end[0]) / 2.0, (first.start[1] + first.end[1]) / 2.0)
        if second.end != first.start or first.numbers != second.numbers or min(rx, ry) <= 0.0:
            raise self.foreign("has arcs that are not two halves of an ellipse")
        return Circle(*middle, rx) if rx == ry else Ellipse(*middle, rx, ry, math.radians(degrees))


def extent_of(rings: list[Ring]) -> tuple[np.ndarray, np.ndarray]:
    """The corners (2,) of the box around rings, left and top, right and bottom, px: that of the curves themselves."""
    t = np.linspace(0.0, 1.0, 65)[:, None, None]
    s = 1.0 - t
    points = []
    for ring in rings:
        a, b, c, d = ring.cubics.transpose(1, 0, 2)
        points.append((s**3 * a + 3.0 * s * s * t * b + 3.0 * s * t * t * c + t**3 * d).reshape(-1, 2))
    every = np.concatenate(points)
    return every.min(axis=0), every.max(axis=0)


def _ring(subpath: list[Piece]) -> Ring:
    """Of pieces of which the last one closes the ring: a line of its own where that has a length."""
    if math.dist(subpath[-1].start, subpath[-1].end) < 1e-9 and len(subpath) > 1:
        subpath = subpath[:-1]
    anchors = np.array([piece.start for piece in subpath])
    ends = np.roll(anchors, -1, axis=0)
    lines = np.array([not piece.handles for piece in subpath])
    controls = anchors[:, None] + (ends - anchors)[:, None] * np.array([1.0, 2.0])[None, :, None] / 3.0
    for index, piece in enumerate(subpath):
        if piece.handles:
            controls[index] = piece.handles
    return Ring(anchors, controls, lines, _smooth(anchors, controls))


def _smooth(anchors: np.ndarray, controls: np.ndarray) -> np.ndarray:
    """(A,) bool: where the two handles of an anchor are opposite to each other."""
    back, ahead = anchors - np.roll(controls[:, 1], 1, axis=0), controls[:, 0] - anchors
    cross = back[:, 0] * ahead[:, 1] - back[:, 1] * ahead[:, 0]
    dot = (back * ahead).sum(axis=1)
    return (dot > 0.0) & (np.abs(np.arctan2(cross, dot)) < _SMOOTH)
