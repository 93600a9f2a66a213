"""Checks an SVG file of unknown origin before any renderer reads it, and reads its size.

One expat pass fetches and expands nothing. It refuses gzip (.svgz), entity declarations, pictures except PNG and JPEG
files that are embedded and drawn once, every other reference that leaves the document, and references that would draw
the same elements too many times.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.marks import GZIP
from cubicsplat_cli.files.read import MAX_SVG_BYTES, looks_like_svg
from cubicsplat_cli.record import record
from cubicsplat_cli.svg.own import MAX_ELEMENTS
from cubicsplat_cli.svg.values import MOST_PIXELS, absolute_length, picture_in

MAX_DEPTH = 256
MAX_RADIUS = 1e9  # a circle of infinite radius is drawn without end
MAX_USED = 100_000  # elements drawn once more by <use>: the limit of cairosvg, which takes 20 s to reach it
_ROUND = {"r", "rx", "ry"}
_PICTURES = {"feImage", "foreignObject"}
_DRAWN_ONCE = {"svg", "g"}  # elements that may hold an embedded picture, because no reference draws them again
_OUTSIDE = re.compile(r"@import|url\(\s*['\"]?\s*(?!#)[^\s'\"#)]", re.IGNORECASE)
_INSIDE = re.compile(r"url\(\s*['\"]?\s*#([^'\")\s]+)")


@record
class SvgSize:
    """Natural size of an SVG in px, from its width and height, else from its viewBox."""

    width: float
    height: float


def check_untrusted(data: bytes, source: str, *, otherwise: SvgSize | None = None) -> SvgSize:
    """Refuse an SVG that no renderer should be given; return its natural size.

    data: the file's bytes. source: its name for messages. otherwise: the size of a file that gives none. Raises
    InputError, which says what is wrong.
    """
    if not data.strip():
        raise InputError(f"{source}: is empty; give an SVG file")
    if len(data) > MAX_SVG_BYTES:
        raise InputError(f"{source}: has {len(data)} bytes; an SVG of at most {MAX_SVG_BYTES} bytes is read")
    if data.startswith(GZIP):
        raise InputError(f"{source}: is compressed (.svgz); unpack it first, for example with gunzip")
    scan = _Scan(source)
    parser = expat.ParserCreate()
    parser.StartElementHandler = scan.start
    parser.EndElementHandler = scan.end
    parser.CharacterDataHandler = scan.text
    parser.EntityDeclHandler = scan.entity
    parser.ProcessingInstructionHandler = scan.instruction
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        if not looks_like_svg(Path(), data):
            raise InputError(f"{source}: is no SVG; give an SVG file") from error
        raise InputError(f"{source}: is not well-formed XML ({error}); export it again") from error
    except (LookupError, ValueError) as error:
        raise InputError(f"{source}: has an encoding that cannot be read ({error}); save it as UTF-8") from error
    scan.check_references()
    size = _size_of(scan.root) or otherwise
    if size is None:
        raise InputError(f"{source}: says no size; give it a width and height, or a viewBox")
    return size


def _size_of(root: dict[str, str]) -> SvgSize | None:
    """Return the size from the attributes of a root: width and height, else the viewBox; None if neither gives it."""
    width, height = _pixels(root.get("width")), _pixels(root.get("height"))
    if width is None or height is None:
        box = [_pixels(part) for part in re.split(r"[\s,]+", root.get("viewBox", "").strip())]
        if len(box) == 4 and box[2] and box[3]:
            width, height = box[2], box[3]
    return SvgSize(width, height) if width and height and width > 0 and height > 0 else None


def _pixels(text: str | None) -> float | None:
    value = absolute_length(text)
    return value if value is not None and math.isfinite(value) else None


def with_size(data: bytes, size: SvgSize) -> bytes:
    """Return the bytes of an SVG with this size in its root, the only place where renderers read it."""
    with suppress(ElementTree.ParseError):  # of a prefix without a namespace, which renderers report
        root = ElementTree.fromstring(data)
        root.attrib |= {"width": f"{size.width:g}", "height": f"{size.height:g}"}
        return ElementTree.tostring(root)
    return data


@dataclass(eq=False)
class _Named:
    """An element that references may name.

    elements: it and those in it, except those of `inside`, which have names themselves. uses: the names in its <use>.
    paints: the names in its fills, masks, markers and so on.
    """

    elements: int = 0
    uses: list[str] = field(default_factory=list)
    paints: list[str] = field(default_factory=list)
    inside: list[_Named] = field(default_factory=list)


class _Scan:
    """Handlers of one pass over one document."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.elements = self.images = self.image_pixels = 0
        self.within: list[str] = []  # names of the open elements
        self.style_text: list[str] = []
        self.root: dict[str, str] = {}
        self.named: dict[str, _Named] = {}
        self.open = [_Named()]

    def start(self, name: str, attributes: dict[str, str]) -> None:
        local = name.rpartition(":")[2]
        if self.elements == 0:
            if local != "svg":
                raise InputError(f"{self.source}: is XML but no SVG (it begins with <{local}>); give an SVG file")
            self.root = attributes
        self.elements += 1
        if self.elements > MAX_ELEMENTS or len(self.within) >= MAX_DEPTH:
            raise InputError(f"{self.source}: has more than {MAX_ELEMENTS} elements or {MAX_DEPTH} levels; simplify it")
        if local in _PICTURES or (local == "image" and not self._is_embedded(attributes)):
            raise InputError(f"{self.source}: holds a <{local}> element, which is not drawn here; remove it first")
        self.within.append(local)
        self._open(attributes.get("id"))
        for key, value in attributes.items():
            self._check_attribute(local, key, value)

    def _open(self, name: str | None) -> None:
        """Count an element: by itself if it has a new name, else with the nearest named element around it."""
        holder = self.open[-1]
        if name is not None and name not in self.named:
            self.named[name] = _Named()
            holder.inside.append(self.named[name])
            holder = self.named[name]
        holder.elements += 1
        self.open.append(holder)

    def _is_embedded(self, attributes: dict[str, str]) -> bool:
        """True if an <image> holds a PNG or JPEG and is, apart from references, drawn once."""
        self.images += 1
        references = [value for name, value in attributes.items() if name.rpartition(":")[2] == "href"]
        if len(references) != 1 or not _DRAWN_ONCE.issuperset(self.within):
            return False
        try:
            self.image_pixels += picture_in(references[0])[1]
        except ValueError:
            return False
        return self.image_pixels <= MOST_PIXELS

    def _check_attribute(self, element: str, name: str, value: str) -> None:
        """Note the references of an attribute. Raises InputError for one that leaves the document, and huge radii."""
        local = name.rpartition(":")[2]
        if local == "href":
            link = value.strip()
            # A link matters only when clicked; drawing follows every other reference.
            if element not in ("a", "image") and link and not link.startswith("#"):
                raise self._outside(f"{element} {name}")
            if element == "use":
                self.open[-1].uses.append(link.removeprefix("#"))
        if local in _ROUND and abs(absolute_length(value) or 0.0) > MAX_RADIUS:
            raise InputError(f"{self.source}: has {local}={value!r}, too large to draw; make it smaller")
        if "(" in value:
            if _OUTSIDE.search(value):
                raise self._outside(f"{element} {name}")
            self.open[-1].paints += _INSIDE.findall(value)

    def end(self, name: str) -> None:
        self.within.pop()
        self.open.pop()
        if name.rpartition(":")[2] == "style":
            if _OUTSIDE.search("".join(self.style_text)):
                raise self._outside("style")
            self.style_text.clear()

    def text(self, text: str) -> None:
        if "style" in self.within:
            self.style_text.append(text)

    def entity(self, name: str, *_: object) -> None:
        raise InputError(f"{self.source}: declares the entity {name!r}, which is refused; export it as plain SVG")

    def instruction(self, target: str, _data: str) -> None:
        if target.lower() == "xml-stylesheet":
            raise self._outside("xml-stylesheet")

    def check_references(self) -> None:
        """Raise InputError if references draw too many elements, or an element itself."""
        if self.images and any(named.uses for named in (self.open[0], *self.named.values())):
            raise InputError(f"{self.source}: holds an <image> element and <use>, which may draw it often; remove one")
        for following_all, most in ((False, MAX_USED), (True, MAX_ELEMENTS)):
            if self._drawn(self.open[0], {}, following_all, 0) - self.elements > most:
                raise InputError(f"{self.source}: draws more than {most} elements by references; simplify it")

    def _drawn(self, named: _Named, counts: dict[int, int], following_all: bool, depth: int) -> int:
        """Return the number of elements drawn for one and its content; `counts` holds the results so far."""
        if depth > MAX_DEPTH:
            raise InputError(f"{self.source}: has references to themselves, or {MAX_DEPTH} in one another; simplify it")
        if id(named) not in counts:
            referred = named.uses + (named.paints if following_all else [])
            parts = [*named.inside, *(self.named[name] for name in referred if name in self.named)]
            drawn = [self._drawn(part, counts, following_all, depth + 1) for part in parts]
            counts[id(named)] = named.elements + sum(drawn)
        return counts[id(named)]

    def _outside(self, where: str) -> InputError:
        text = f"refers to something outside the file ({where}), never fetched here"
        return InputError(f"{self.source}: {text}; remove it")
