"""Documents, text, numbers, colours and gradients as XML and SVG write them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from copy import copy
from functools import lru_cache
from urllib.parse import quote
from xml.etree import ElementTree

from cubicsplat_cli.scene.paint import Gradient, LinearGradient, Rgba
from cubicsplat_cli.svg.values import OPACITY_DECIMALS, OPAQUE

# XML 1.0 allows tab, newline, carriage return and these ranges; a file name may hold anything.
_NOT_XML = "[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"
# The space that ElementTree puts before "/>". A ">" in a title is escaped, so it is no match.
_SPACE = re.compile(r" />(?=\n|<stop|</(?:linear|radial)Gradient)")
_SIDE = re.compile(r'(?<= )(width|height)="[^"]*"')
# Characters that a data URI between double quotes, in an attribute or in CSS, need not escape.
_SAFE_IN_URI = " !$&'()*+,/:;=?@"


@lru_cache(1 << 16)  # most numbers of a path are small and occur often
def format_number(value: int, precision: int) -> str:
    """Return value * 10^-precision as short decimal text: no leading zero, no trailing zeros, no exponent.

    >>> format_number(-50, 2), format_number(1234, 2), format_number(300, 2)
    ('-.5', '12.34', '3')
    """
    sign, digits = "-" if value < 0 else "", str(abs(value)).rjust(precision + 1, "0")
    point = len(digits) - precision
    whole, fraction = digits[:point], digits[point:].rstrip("0")
    if not fraction:
        return "0" if whole == "0" else sign + whole
    return f"{sign}{'' if whole == '0' else whole}.{fraction}"


def joined(numbers: Iterable[int]) -> str:
    """Return whole numbers in a row, with a space between them except before a minus."""
    return " ".join(map(str, numbers)).replace(" -", "-")


def xml_text(text: str) -> str:
    """Return the text with a replacement character for each that XML cannot hold."""
    # XML can hold what is printable. To compile the expression takes longer than to write most files.
    return text if text.isprintable() else re.sub(_NOT_XML, "\ufffd", text)


def comment_text(text: str) -> str:
    """Return the text as the inside of a comment, without "--" and without "-" at its end."""
    return f" {re.sub('-(?=-)', '- ', xml_text(text)).strip()} "


def data_uri(svg: str) -> str:
    """Return an SVG as a `data:` URI for use between double quotes, with few escapes, so shorter than base64."""
    text = re.sub(r"^<\?xml[^>]*>\s*", "", svg)
    text = re.sub(r"<[^>]*>", lambda tag: tag[0] if "'" in tag[0] else tag[0].replace('"', "'"), text)
    text = re.sub(r">\s+<", "><", text).strip()
    return "data:image/svg+xml," + quote(text, safe=_SAFE_IN_URI)


class Identifiers:
    """Names as distinct `id` attributes: a repeated name gets a hyphen and a number."""

    def __init__(self) -> None:
        self._last: dict[str, int] = {}

    def unique(self, name: str) -> str:
        """Return a new id of letters, digits, underscores, dots and single hyphens; it starts with no digit."""
        text = re.sub(r"[^A-Za-z0-9_.]+", "-", name).strip("-.") or "shape"
        text = text if text[0].isalpha() or text[0] == "_" else f"_{text}"
        identifier = text
        while identifier in self._last:
            self._last[text] += 1
            identifier = f"{text}-{self._last[text]}"
        self._last[identifier] = 1
        return identifier


def short_colour(red: int, green: int, blue: int) -> str:
    """Return #rgb if that is exact, else #rrggbb."""
    text = f"{red:02x}{green:02x}{blue:02x}"
    return f"#{text[::2]}" if text[::2] == text[1::2] else f"#{text}"


def empty_document(width: int, height: int) -> ElementTree.Element:
    """Return the root of a picture of width x height px."""
    size = {"width": str(width), "height": str(height), "viewBox": f"0 0 {width} {height}"}
    return ElementTree.Element("svg", {"xmlns": "http://www.w3.org/2000/svg", **size})


def titled(root: ElementTree.Element, title: str, comment: str) -> str:
    """Return the text of a document with a comment and a title at its beginning, and each element of the root, a group
    or the definitions on its own line; the root stays as it is.
    """
    whole = copy(root)
    whole.insert(0, ElementTree.Comment(comment_text(comment)))
    whole.insert(1, ElementTree.Element("title"))
    whole[1].text = xml_text(title)
    for parent in (whole, *whole.iter("g"), *whole.iter("defs")):
        parent.text = "\n"
        for child in parent:
            child.tail = "\n"
    text = _SPACE.sub("/>", ElementTree.tostring(whole, encoding="unicode"))
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def minified(svg: str) -> str:
    """Return a document in one line, without declaration, comment, title, size in px, and ids other than gradients'."""
    text = re.sub(r"^<\?xml[^>]*>|<!--.*?-->|<title>.*?</title>|\n", "", svg, flags=re.DOTALL)
    text = re.sub(r" +(?=viewBox)", " ", _SIDE.sub("", text, count=2), count=1)
    return re.sub(r'(?<=<)(path|rect|circle|ellipse|g) id="[^"]*"', r"\1", text)


def with_lengths(svg: str, width: str, height: str) -> str:
    """Return a document with another width and height in its root; its viewBox stays."""
    sides = {"width": width, "height": height}
    end = svg.index(">", svg.index("<svg"))
    return _SIDE.sub(lambda side: f'{side[1]}="{sides[side[1]]}"', svg[:end]) + svg[end:]


def paint(kind: str, fill: Rgba) -> dict[str, str]:
    """Return the attributes that paint the "fill" or the "stroke" of a shape."""
    return {kind: short_colour(*fill[:3]), **opacity_of(kind, fill[3])}


def opacity_of(kind: str, alpha: int) -> dict[str, str]:
    """Return the attribute of an opacity in 0..255 of a "fill", "stroke" or "stop", empty if it is opaque."""
    if alpha == OPAQUE:
        return {}
    return {f"{kind}-opacity": format_number(round(alpha * 10**OPACITY_DECIMALS / OPAQUE), OPACITY_DECIMALS)}


class GradientElements:
    """The gradients of one file; equal ones are written once. name: returns a new id. precision: decimals in px."""

    def __init__(self, name: Callable[[], str], precision: int) -> None:
        self._name, self._precision = name, precision
        self._identifiers: dict[str, str] = {}

    def fill(self, gradient: Gradient) -> tuple[str, ElementTree.Element | None]:
        """Return the `fill` of a shape, and the element to put before it; None if the file has that already."""
        element = gradient_element(gradient, self._precision)
        text = ElementTree.tostring(element, encoding="unicode")
        if text in self._identifiers:
            return f"url(#{self._identifiers[text]})", None
        name = self._identifiers[text] = self._name()
        element.attrib = {"id": name, **element.attrib}
        return f"url(#{name})", element


def gradient_element(gradient: Gradient, precision: int) -> ElementTree.Element:
    """Return a linearGradient or radialGradient with its stops and without an id."""

    def number(value: float, decimals: int = precision) -> str:
        return format_number(round(value * 10**decimals), decimals)

    if isinstance(gradient, LinearGradient):
        tag = "linearGradient"
        places = {name: number(getattr(gradient, name)) for name in ("x1", "y1", "x2", "y2")}
    else:
        tag, focus = "radialGradient", gradient.focus
        if number(gradient.rx) == number(gradient.ry):
            places = {"cx": number(gradient.cx), "cy": number(gradient.cy), "r": number(gradient.rx)}
            places |= {} if focus is None else {"fx": number(focus[0]), "fy": number(focus[1])}
        else:
            # The transform maps the unit circle to the ellipse.
            places = {"cx": "0", "cy": "0", "r": "1"}
            if focus is not None:
                fx, fy = (number(place, OPACITY_DECIMALS) for place in gradient.frame()[:, 3])
                places |= {"fx": fx, "fy": fy}
            places["gradientTransform"] = f"matrix({' '.join(map(number, gradient.matrix().T.ravel()))})"
    element = ElementTree.Element(tag, {**places, "gradientUnits": "userSpaceOnUse"})
    for stop in gradient.stops:
        attributes = {"offset": number(stop.offset, OPACITY_DECIMALS), "stop-color": short_colour(*stop.colour[:3])}
        ElementTree.SubElement(element, "stop", attributes | opacity_of("stop", stop.colour[3]))
    return element
