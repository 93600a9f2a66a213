"""Documents, text, numbers, colours and gradients as XML and SVG write them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import lru_cache
from urllib.parse import quote
from xml.etree import ElementTree

from cubicsplat_cli.scene.paint import Gradient, LinearGradient, Rgba

OPAQUE = 255

# XML 1.0 allows tab, newline, carriage return and these ranges; a file name may hold anything.
_NOT_XML = "[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"
_SPACE = re.compile(r" />(?=\n|<stop|</(?:linear|radial)Gradient)")
_NOT_ID = re.compile(r"[^A-Za-z0-9_.]+")
_TAG = re.compile(r"<[^>]*>")
# Kept as they are in a data URI that stands between double quotes, as in an attribute or in CSS; all else is escaped.
_SAFE_IN_URI = " !$&'()*+,/:;=?@"
_DECIMALS = 3  # of offsets and opacities


@lru_cache(1 << 16)  # most numbers of a path are small and come again
def format_number(value: int, precision: int) -> str:
    """`value` * 10^-precision as short decimal text: no leading zero, no trailing zeros, no exponent.

    >>> format_number(-50, 2), format_number(1234, 2), format_number(300, 2)
    ('-.5', '12.34', '3')
    """
    sign = "-" if value < 0 else ""
    digits = str(abs(value))
    if precision == 0:
        return sign + digits
    digits = digits.rjust(precision + 1, "0")
    whole, fraction = digits[:-precision], digits[-precision:].rstrip("0")
    if not fraction:
        return "0" if whole == "0" else sign + whole
    return f"{sign}{'' if whole == '0' else whole}.{fraction}"


def joined(numbers: Iterable[int]) -> str:
    """Whole numbers in a row; a minus separates them as well as a space does."""
    return " ".join(map(str, numbers)).replace(" -", "-")


def xml_text(text: str) -> str:
    """The text with a replacement character for each that XML cannot hold."""
    # What is printable can be held; to compile the expression takes longer than to write most files.
    return text if text.isprintable() else re.sub(_NOT_XML, "\ufffd", text)


def comment_text(text: str) -> str:
    """The text as the inside of a comment: "--" is not allowed there, nor a "-" at its end."""
    return f" {re.sub('-(?=-)', '- ', xml_text(text)).strip()} "


def data_uri(svg: str) -> str:
    """An SVG as a `data:` URI for use between double quotes: attributes in single quotes, no XML declaration and no
    space between elements, and percent signs for what a URI cannot hold. That is shorter than base64.
    """
    text = re.sub(r"^<\?xml[^>]*>\s*", "", svg)
    text = _TAG.sub(lambda tag: tag[0] if "'" in tag[0] else tag[0].replace('"', "'"), text)
    text = re.sub(r">\s+<", "><", text).strip()
    return "data:image/svg+xml," + quote(text, safe=_SAFE_IN_URI)


class Identifiers:
    """Names as `id` attributes, no two alike: repeated ones get a hyphen and a number."""

    def __init__(self) -> None:
        self._last: dict[str, int] = {}

    def unique(self, name: str) -> str:
        """Letters, digits, underscores, dots and single hyphens, never beginning with a digit."""
        text = _NOT_ID.sub("-", name).strip("-.") or "shape"
        text = text if text[0].isalpha() or text[0] == "_" else f"_{text}"
        identifier = text
        while identifier in self._last:
            self._last[text] += 1
            identifier = f"{text}-{self._last[text]}"
        self._last[identifier] = 1
        return identifier


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


def minified(svg: str) -> str:
    """A document in one line, without what its picture does not need: declaration, comment, title, size in px, and ids
    but those of gradients.
    """
    text = re.sub(r"^<\?xml[^>]*>|<!--.*?-->|<title>.*?</title>|\n", "", svg, flags=re.DOTALL)
    text = re.sub(r" +(?=viewBox)", " ", _SIDE.sub("", text, count=2), count=1)
    return re.sub(r'(?<=<)(path|rect|circle|ellipse|g) id="[^"]*"', r"\1", text)


_SIDE = re.compile(r'(?<= )(width|height)="[^"]*"')


def with_lengths(svg: str, width: str, height: str) -> str:
    """A document that says another width and height in its root; its viewBox stays."""
    sides = {"width": width, "height": height}
    end = svg.index(">", svg.index("<svg"))
    return _SIDE.sub(lambda side: f'{side[1]}="{sides[side[1]]}"', svg[:end]) + svg[end:]


def document(root: ElementTree.Element) -> str:
    """The text of a document, with an element of the root or of a group on each line."""
    for parent in (root, *root.iter("g")):
        parent.text = "\n"
        for child in parent:
            child.tail = "\n"
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{in_short(ElementTree.tostring(root, encoding="unicode"))}\n'


def paint(fill: Rgba) -> dict[str, str]:
    """The attributes that fill a shape with a colour."""
    red, green, blue, alpha = fill
    return {"fill": short_colour(red, green, blue), **opacity_of("fill", alpha)}


def opacity_of(kind: str, alpha: int) -> dict[str, str]:
    """The attribute of an opacity of 0..255 of a "fill", "stroke" or "stop"; none where it is opaque."""
    if alpha == OPAQUE:
        return {}
    return {f"{kind}-opacity": format_number(round(alpha * 10**_DECIMALS / OPAQUE), _DECIMALS)}


class GradientElements:
    """The gradients of one file, equal ones written once. precision: decimals of their coordinates in px."""

    def __init__(self, names: Identifiers, precision: int) -> None:
        self._names, self._precision = names, precision
        self._identifiers: dict[str, str] = {}

    def fill(self, gradient: Gradient) -> tuple[str, ElementTree.Element | None]:
        """The `fill` of a shape, and the element to be put before it; None where that is in the file already."""
        element = gradient_element(gradient, self._precision)
        text = ElementTree.tostring(element, encoding="unicode")
        new = text not in self._identifiers
        if new:
            self._identifiers[text] = self._names.unique("gradient")
            element.attrib = {"id": self._identifiers[text], **element.attrib}
        return f"url(#{self._identifiers[text]})", element if new else None


def gradient_element(gradient: Gradient, precision: int) -> ElementTree.Element:
    """A linearGradient or radialGradient without an id, its stops within."""

    def number(value: float) -> str:
        return format_number(round(value * 10**precision), precision)

    if isinstance(gradient, LinearGradient):
        ends = {"x1": gradient.x1, "y1": gradient.y1, "x2": gradient.x2, "y2": gradient.y2}
        element = ElementTree.Element("linearGradient", {name: number(value) for name, value in ends.items()})
    elif number(gradient.rx) == number(gradient.ry):
        round_one = {"cx": gradient.cx, "cy": gradient.cy, "r": gradient.rx}
        if gradient.focus is not None:
            round_one |= dict(zip(("fx", "fy"), gradient.focus, strict=True))
        element = ElementTree.Element("radialGradient", {name: number(value) for name, value in round_one.items()})
    else:
        # The unit circle, brought to the ellipse.
        matrix = " ".join(number(value) for value in gradient.matrix().T.ravel())
        unit = {"cx": "0", "cy": "0", "r": "1"}
        if gradient.focus is not None:
            focus = (round(10**_DECIMALS * place) for place in gradient.unit_focus().tolist())
            unit |= {name: format_number(place, _DECIMALS) for name, place in zip(("fx", "fy"), focus, strict=True)}
        unit["gradientTransform"] = f"matrix({matrix})"
        element = ElementTree.Element("radialGradient", unit)
    element.set("gradientUnits", "userSpaceOnUse")
    for stop in gradient.stops:
        red, green, blue, alpha = stop.colour
        attributes = {"offset": format_number(round(stop.offset * 10**_DECIMALS), _DECIMALS)}
        attributes["stop-color"] = short_colour(red, green, blue)
        attributes |= opacity_of("stop", alpha)
        ElementTree.SubElement(element, "stop", attributes)
    return element
