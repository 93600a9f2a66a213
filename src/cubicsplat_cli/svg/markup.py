"""Documents, text and colours as XML and SVG take them."""

from __future__ import annotations

import re
from xml.etree import ElementTree

from cubicsplat_cli.scene.paint import Ink
from cubicsplat_cli.svg.pathdata import format_number

OPAQUE = 255

# XML 1.0 allows tab, newline, carriage return and these ranges; a file name may hold anything.
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_SPACE = re.compile(r" />(?=\n|<stop|</(?:linear|radial)Gradient)")
_NOT_ID = re.compile(r"[^A-Za-z0-9_.]+")


def xml_text(text: str) -> str:
    """The text with a replacement character for each that XML cannot hold."""
    return _NOT_XML.sub("\ufffd", text)


def comment_text(text: str) -> str:
    """The text as the inside of a comment: "--" is not allowed there, nor a "-" at its end."""
    return f" {re.sub('-(?=-)', '- ', xml_text(text)).strip()} "


class Identifiers:
    """Names as `id` attributes, no two alike: repeated ones get a hyphen and a number."""

    def __init__(self) -> None:
        self._last: dict[str, int] = {}

    def unique(self, name: str) -> str:
        """Letters, digits, underscores, dots and single hyphens, never beginning with a digit."""
        text = _NOT_ID.sub("-", name).strip("-.") or "shape"
        text = text if text[0].isalpha() or text[0] == "_" else f"_{text}"
        found = text
        while found in self._last:
            self._last[text] += 1
            found = f"{text}-{self._last[text]}"
        self._last[found] = 1
        return found


def short_colour(red: int, green: int, blue: int) -> str:
    """#rgb where that says the same, else #rrggbb."""
    text = f"{red:02x}{green:02x}{blue:02x}"
    return f"#{text[::2]}" if text[::2] == text[1::2] else f"#{text}"


def in_short(text: str) -> str:
    """A document without the space that ElementTree puts before "/>"; a ">" in the title is escaped: no match."""
    return _SPACE.sub("/>", text)


def empty_document(width: int, height: int, title: str, comment: str) -> ElementTree.Element:
    """The root of a picture of width x height px, with its comment and title."""
    size = {"width": str(width), "height": str(height), "viewBox": f"0 0 {width} {height}"}
    root = ElementTree.Element("svg", {"xmlns": "http://www.w3.org/2000/svg", **size})
    root.append(ElementTree.Comment(comment_text(comment)))
    ElementTree.SubElement(root, "title").text = xml_text(title)
    return root


def document(root: ElementTree.Element) -> str:
    """The text of a document, with an element of the root on each line."""
    root.text = "\n"
    for child in root:
        child.tail = "\n"
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{in_short(ElementTree.tostring(root, encoding="unicode"))}\n'


def paint(ink: Ink) -> dict[str, str]:
    """The attributes that fill a shape with a colour."""
    red, green, blue, alpha = ink
    opacity = {} if alpha == OPAQUE else {"fill-opacity": format_number(round(1000 * alpha / OPAQUE), 3)}
    return {"fill": short_colour(red, green, blue), **opacity}
