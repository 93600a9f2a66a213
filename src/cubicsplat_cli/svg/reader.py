"""Reads the SVG files that `write_svg` makes back into a scene; any other SVG is refused with a clear line.

Expat with a whitelist of elements and attributes: no document type, no entities, nothing fetched.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat

import numpy as np

from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.scene import Scene, pack_rings
from cubicsplat_cli.scene.gradients import gradients_of
from cubicsplat_cli.scene.paint import Gradient, mean_ink
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.canvas import canvas_size
from cubicsplat_cli.svg.drawing_reader import is_drawing, read_drawing
from cubicsplat_cli.svg.gradient_reader import LINEAR, RADIAL, STOP, GradientReader
from cubicsplat_cli.svg.gridgradients import settled
from cubicsplat_cli.svg.writer import BACKGROUND_ID, CURVES_ID, UNITS_ID

MAX_SVG_BYTES = 256 * 1024 * 1024
MAX_TOKENS = 1_000_000  # of one curve: a scene's arrays have room for the longest in each row
MAX_NUMBER_LENGTH = 24
MAX_SHOWN = 120  # characters of a message that come from the file

_TOKEN = re.compile(r"[\s,]*(?:([A-Za-z])|([+-]?)(?:(\d+)\.?(\d*)|\.(\d+)))")
_COLOUR = re.compile(r"#[0-9a-fA-F]{6}")
_DECIMAL = re.compile(r"(?:\d+(?:\.\d*)?|\.\d+)")
_REFERENCE = re.compile(r"url\(#([A-Za-z0-9_.-]+)\)")
_FILLED = (0.0, 0.0, 0.0)  # in the place of a gradient's colour until all are read
_OF_GRADIENTS = {f"svg/defs/{name}{rest}" for name in (LINEAR, RADIAL) for rest in ("", f"/{STOP}")}
_ROOT_ATTRIBUTES = {"width", "height", "viewBox", "version", "baseProfile"}
_ENLARGED = re.compile(r"(?:scale\(1(0{1,6})\))?")
_SCALE = re.compile(r"scale\((?:1|\.(0{0,5})1)\)")
_RECT_ATTRIBUTES = {"id", "x", "y", "width", "height", "fill"}
_GROUP_ATTRIBUTES = {
    "id": CURVES_ID,
    "fill-rule": "nonzero",
    "fill": "none",
    "stroke-linecap": "round",
    "stroke-linejoin": "round",
}
_PATH_ATTRIBUTES = {
    Mode.CLOSED: {"d", "fill", "fill-opacity"},
    Mode.OPEN: {"d", "stroke", "stroke-opacity", "stroke-width"},
}


def read_svg(text: str | bytes) -> Scene:
    """The scene of an SVG that cubicsplat wrote (numpy arrays, index 0 the front).

    Raises InputError for anything else: too large, not XML, a document type or entity declaration, an unknown
    element or attribute, path data other than M, C, c and z, curves of different kinds, strokes of several
    subpaths, or no curve at all.
    """
    data = text.encode() if isinstance(text, str) else text
    if len(data) > MAX_SVG_BYTES:
        raise InputError(f"the SVG has {len(data)} bytes; at most {MAX_SVG_BYTES} are read")
    if is_drawing(data):
        return scene_of(read_drawing(data))
    collector = _Collector()
    parser = expat.ParserCreate("utf-8")
    parser.StartElementHandler = collector.start
    parser.EndElementHandler = collector.end
    parser.StartDoctypeDeclHandler = _refuse_doctype
    parser.EntityDeclHandler = _refuse_doctype
    collector.parser = parser
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise InputError(f"the SVG is not well-formed XML: {error}; it may be cut short, write it again") from error
    return collector.scene()


def _refuse_doctype(*_: object) -> None:
    raise InputError("the SVG has a DOCTYPE or entity declaration, which cubicsplat never writes and does not read")


@dataclass
class _Command:
    """A letter of path data and the numbers up to the next one, as integers."""

    letter: str
    numbers: list[int] = field(default_factory=list)


@dataclass
class _Collector:
    """Follows the elements of one document: svg > (title, defs > gradients, rect, g > path...)."""

    parser: expat.XMLParserType | None = None
    size: tuple[int, int] | None = None
    background: tuple[float, float, float] | None = None
    mode: Mode | None = None
    opacity: str = "1"  # of curves that say none
    shift: int = 0  # the paths' unit is 10^-shift px
    stack: list[str] = field(default_factory=list)
    curves: list[list[list[tuple[float, float]]]] = field(default_factory=list)  # the rings of each
    colours: list[tuple[float, float, float]] = field(default_factory=list)
    opacities: list[float] = field(default_factory=list)
    half_widths: list[float] = field(default_factory=list)
    fills: list[str | None] = field(default_factory=list)  # the ids of the curves' gradients
    enlarged: set[int] = field(default_factory=set)  # powers of ten by which gradients are enlarged

    def __post_init__(self) -> None:
        self.gradients = GradientReader(self.foreign)

    def start(self, name: str, attributes: dict[str, str]) -> None:
        place = "/".join([*self.stack, name])
        self.stack.append(name)
        if place == "svg":
            self._root(attributes)
        elif place == "svg/rect" and self.mode is None and self.background is None:
            self._rect(attributes)
        elif place == "svg/g" and self.mode is None:
            self._group(attributes)
        elif place == "svg/g/path":
            self._path(attributes)
        elif place in _OF_GRADIENTS:
            self.gradients.start(name, attributes if name == STOP else self._in_px(attributes))
        elif place not in ("svg/title", "svg/defs"):
            raise self.foreign(f"has an unexpected <{name}> element")

    def end(self, name: str) -> None:
        self.stack.pop()
        self.gradients.end(name)

    def foreign(self, what: str) -> InputError:
        """The error for a document that is not ours, with the line where that shows."""
        line = self.parser.CurrentLineNumber if self.parser is not None else 0
        if len(what) > MAX_SHOWN:  # it quotes the file
            what = f"{what[:MAX_SHOWN]}..."
        return InputError(
            f"this SVG was not written by cubicsplat or was edited: line {line} {what}; "
            "`cubicsplat render` and `cubicsplat eval` take any SVG"
        )

    def _known(self, attributes: dict[str, str], known: set[str]) -> None:
        for name in attributes:
            if name not in known and name.split(":")[0] != "xmlns":
                raise self.foreign(f"has an unexpected attribute {name!r}")

    def _root(self, attributes: dict[str, str]) -> None:
        self._known(attributes, _ROOT_ATTRIBUTES)
        self.size = canvas_size(attributes, self.foreign)

    def _rect(self, attributes: dict[str, str]) -> None:
        self._known(attributes, _RECT_ATTRIBUTES)
        if attributes.get("id", BACKGROUND_ID) != BACKGROUND_ID:
            raise self.foreign(f"has a <rect> called {attributes['id']!r}")
        place = (attributes.get("x", "0"), attributes.get("y", "0"))
        size = (attributes.get("width"), attributes.get("height"))
        if self.size is None or place != ("0", "0") or size != (str(self.size[0]), str(self.size[1])):
            raise self.foreign("has a <rect> that is not the background")
        self.background = self._colour(attributes.get("fill", ""))

    def _group(self, attributes: dict[str, str]) -> None:
        scale = _SCALE.fullmatch(attributes.pop("transform", "scale(1)"))
        if scale is None:
            raise self.foreign("has a transform other than the scale of a precision")
        self.shift = 0 if scale[1] is None else len(scale[1]) + 1
        # Of fills where the group does not say that there are none.
        self.opacity = attributes.pop("stroke-opacity" if "fill" in attributes else "fill-opacity", "1")
        self._known(attributes, set(_GROUP_ATTRIBUTES))
        for name, value in attributes.items():
            if value != _GROUP_ATTRIBUTES[name]:
                raise self.foreign(f"has {name}={value!r}")
        attributes.pop("id", None)
        if set(attributes) == {"fill-rule"}:
            self.mode = Mode.CLOSED
        elif set(attributes) == {"fill", "stroke-linecap", "stroke-linejoin"}:
            self.mode = Mode.OPEN
        else:
            raise self.foreign("has a <g> that says neither closed nor open curves")

    def _path(self, attributes: dict[str, str]) -> None:
        if self.mode is None:
            raise self.foreign("has a <path> outside the group")
        self._known(attributes, _PATH_ATTRIBUTES[self.mode])
        paint = "fill" if self.mode is Mode.CLOSED else "stroke"
        self.curves.append(self._rings(attributes.get("d", "")))
        fill = attributes.get(paint, "")
        match = _REFERENCE.fullmatch(fill)
        self.fills.append(match[1] if match else None)
        self.colours.append(_FILLED if match else self._colour(fill))
        self.opacities.append(self._decimal(attributes.get(f"{paint}-opacity", self.opacity), 1.0))
        width = attributes.get("stroke-width", "") if self.mode is Mode.OPEN else "0"
        self.half_widths.append(self._decimal(width, float("inf"), self.shift) / 2.0)

    def _colour(self, text: str) -> tuple[float, float, float]:
        if not _COLOUR.fullmatch(text):
            raise self.foreign(f"has the colour {text!r}, not #rrggbb")
        red, green, blue = bytes.fromhex(text[1:])
        return (red / 255, green / 255, blue / 255)

    def _decimal(self, text: str, largest: float, shift: int = 0) -> float:
        """A number in 0..largest times 10^-shift, rounded once."""
        if len(text) > MAX_NUMBER_LENGTH or not _DECIMAL.fullmatch(text) or float(text) > largest:
            raise self.foreign(f"has the number {text!r} where one in 0..{largest:g} is wanted")
        whole, _, fraction = text.partition(".")
        return int(whole + fraction) / 10 ** (len(fraction) + shift)

    def _rings(self, d: str) -> list[list[tuple[float, float]]]:
        """Control points of each subpath of one path, exact: added up as integers of the path's finest decimal."""
        tokens = self._tokens(d)
        decimals = max((len(fraction) for _, _, _, fraction in tokens), default=0)
        subpaths: list[list[_Command]] = []
        for letter, sign, whole, fraction in tokens:
            if letter == "M" or (letter == "m" and not subpaths):  # a later m would be relative
                subpaths.append([_Command("M")])
            elif not subpaths:
                raise self.foreign("has path data that does not begin with M")
            elif letter:
                subpaths[-1].append(_Command(letter))
            else:
                value = int((whole + fraction.ljust(decimals, "0")) or "0")
                subpaths[-1][-1].numbers.append(-value if sign == "-" else value)
        if not subpaths or (len(subpaths) > 1 and self.mode is Mode.OPEN):
            raise self.foreign("has a path without data or a stroke of several subpaths")
        scale = 10 ** (decimals + self.shift)
        rings = [self._ring(commands) for commands in subpaths]
        return [[(x / scale, y / scale) for x, y in zip(ring[::2], ring[1::2], strict=True)] for ring in rings]

    def _ring(self, commands: list[_Command]) -> list[int]:
        """Absolute coordinates x0, y0, x1, ... of one subpath's control points."""
        closed = self.mode is Mode.CLOSED
        if closed and (commands[-1].letter not in "zZ" or commands[-1].numbers):
            raise self.foreign("has a closed curve whose path does not end with z")
        coordinates = self._walk(commands[:-1] if closed else commands)
        if closed and coordinates[-2:] != coordinates[:2]:
            raise self.foreign("has a closed curve that does not return to its start")
        return coordinates[:-2] if closed else coordinates

    def _walk(self, commands: list[_Command]) -> list[int]:
        """Absolute coordinates of a subpath that starts with M and goes on with cubics."""
        if any(command.letter not in "cC" for command in commands[1:]):
            raise self.foreign("has path data other than M, cubics and z")
        if len(commands) < 2 or len(commands[0].numbers) != 2:
            raise self.foreign("has path data that does not begin with one point and a cubic")
        coordinates = list(commands[0].numbers)
        for command in commands[1:]:
            if not command.numbers or len(command.numbers) % 6:
                raise self.foreign("has a cubic with a wrong count of numbers")
            for first in range(0, len(command.numbers), 6):
                x, y = coordinates[-2:] if command.letter == "c" else (0, 0)
                six = command.numbers[first : first + 6]
                coordinates.extend([six[0] + x, six[1] + y, six[2] + x, six[3] + y, six[4] + x, six[5] + y])
        return coordinates

    def _tokens(self, d: str) -> list[tuple[str, str, str, str]]:
        """Path data as (letter, sign, whole digits, decimal digits); letter is empty for numbers."""
        tokens: list[tuple[str, str, str, str]] = []
        position, d = 0, d.strip()
        while position < len(d):
            match = _TOKEN.match(d, position)
            if match is None or match.end() - match.start() > MAX_NUMBER_LENGTH:
                raise self.foreign(f"has path data that cannot be read at {d[position : position + 12]!r}")
            letter, sign, whole, fraction, only_fraction = match.groups(default="")
            if len(tokens) == MAX_TOKENS:
                raise self.foreign(f"has a curve of more than {MAX_TOKENS} numbers")
            tokens.append((letter, sign, whole, fraction or only_fraction))
            position = match.end()
        return tokens

    def scene(self) -> Scene:
        """The scene of all that was seen, its order turned so that index 0 is the front."""
        if self.size is None or self.mode is None or not self.curves:
            raise InputError("the SVG holds no curves of cubicsplat; give a file that `cubicsplat vectorize` wrote")
        width, height = self.size
        points, ring_ends = self._points(self.mode)
        if self.enlarged - {self.shift}:
            raise self.foreign("has gradients in another unit than the paths")
        paints = [None if fill is None else self._paint(fill) for fill in self.fills[::-1]]
        colours = _array(self.colours)
        for curve, paint in enumerate(paints):
            if paint is not None:
                colours[curve] = np.array(mean_ink(paint)[:3]) / 255.0
        scene = Scene(
            mode=self.mode,
            width=width,
            height=height,
            points=points,
            colours=colours,
            opacities=_array(self.opacities),
            half_widths=_array(self.half_widths),
            background=self.background,
            ring_ends=ring_ends,
            gradients=gradients_of(paints),
        )
        scene.validate()
        return scene

    def _in_px(self, attributes: dict[str, str]) -> dict[str, str]:
        """The attributes of a gradient without the transform that brings it to the unit of the paths."""
        if attributes.get("id") == UNITS_ID and attributes.get("gradientUnits") == "userSpaceOnUse":
            return attributes
        scale = _ENLARGED.match(attributes.get("gradientTransform", ""))
        if attributes.get("xlink:href") != f"#{UNITS_ID}" or scale is None:
            raise self.foreign("has a gradient that is not in px")
        self.enlarged.add(len(scale[1] or ""))
        return attributes | {"gradientTransform": attributes.get("gradientTransform", "")[scale.end() :]}

    def _paint(self, identifier: str) -> Gradient:
        return settled(self.gradients.gradient(identifier, (0.0, 0.0, 1.0, 1.0)))

    def _points(self, mode: Mode) -> tuple[np.ndarray, np.ndarray | None]:
        if all(len(rings) == 1 and len(rings[0]) == len(self.curves[0][0]) for rings in self.curves):
            return _array([rings[0] for rings in self.curves]), None  # the quick way for many curves
        curves = [[np.array(ring, np.float64) for ring in rings] for rings in self.curves[::-1]]
        points, ring_ends = pack_rings(mode, curves)
        return points.astype(np.float32), ring_ends


def _array(values: list[Any]) -> np.ndarray:
    return np.asarray(values[::-1], dtype=np.float64).astype(np.float32)
