"""What a drawing is made of: shapes, coordinates, and the bytes of its text without what nobody sees."""

from __future__ import annotations

import copy
import gzip
import re
from dataclasses import dataclass
from xml.etree import ElementTree

from cubicsplat_cli.bench.artwork.document import Document, local_name
from cubicsplat_cli.bench.artwork.elements import drawn_elements
from cubicsplat_cli.svg.pathparse import count_numbers

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_REFERENCE = re.compile(r"#([^\s'\")]+)")
# Numbers of each primitive; a rect has one more where its corners are round.
_PRIMITIVES = {"circle": 3, "ellipse": 4, "rect": 4, "line": 4}
_NOT_SEEN = {"title", "desc", "metadata"}
_HREF = "{http://www.w3.org/1999/xlink}href"


@dataclass(frozen=True)
class Counts:
    """shapes: elements that are drawn, those of a `use` each time. coordinates: numbers as written: of path data and
    points (an arc has 5), 3 of a circle, 4 of an ellipse, line or rect (5 with round corners), 2 of a `use`.
    primitives: circles, ellipses, rects and lines among the shapes. bytes: gzipped, of `minified`.
    """

    shapes: int
    coordinates: int
    primitives: int
    bytes: int


def count(document: Document) -> Counts:
    """Counts of a document; InputError where its path data cannot be read."""
    names = [local_name(drawn.element) for drawn in drawn_elements(document.root)]
    return Counts(
        shapes=len(names),
        coordinates=sum(_coordinates(element) for element in document.root.iter()),
        primitives=sum(name in _PRIMITIVES for name in names),
        bytes=len(gzip.compress(minified(document.root), 9, mtime=0)),
    )


def minified(root: ElementTree.Element) -> bytes:
    """The document without comments, titles, descriptions, metadata, the space between elements, the ids that nothing
    refers to, and attributes of other namespaces. Numbers and paths stay as they are.
    """
    root = copy.deepcopy(root)
    text = ElementTree.tostring(root, encoding="unicode")
    wanted = set(_REFERENCE.findall(text))
    for element in root.iter():
        for child in list(element):
            if local_name(child) in (*_NOT_SEEN, ""):
                element.remove(child)
        if element.get("id") not in wanted:
            element.attrib.pop("id", None)
        for name in [name for name in element.attrib if name.startswith("{") and name != _HREF]:
            del element.attrib[name]
        if local_name(element) != "style":
            element.text = None
        element.tail = None
    return ElementTree.tostring(root).replace(b" />", b"/>")


def _coordinates(element: ElementTree.Element) -> int:
    name = local_name(element)
    if name == "path":
        return count_numbers(element.get("d", ""))
    if name in ("polygon", "polyline"):
        return len(_NUMBER.findall(element.get("points", "")))
    if name == "use":
        return 2
    return _PRIMITIVES.get(name, 0) + (name == "rect" and (element.get("rx") or element.get("ry")) is not None)
