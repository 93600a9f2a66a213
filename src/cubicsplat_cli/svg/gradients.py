"""Gradients as SVG elements, coordinates in px (gradientUnits="userSpaceOnUse"); equal ones are written once."""

from __future__ import annotations

from xml.etree import ElementTree

from cubicsplat_cli.scene.paint import Gradient, LinearGradient
from cubicsplat_cli.svg.markup import Identifiers, short_colour
from cubicsplat_cli.svg.pathdata import format_number

_OPAQUE = 255
_DECIMALS = 3  # of offsets and opacities


class Gradients:
    """The gradients of one file. precision: decimals of their coordinates in px."""

    def __init__(self, names: Identifiers, precision: int) -> None:
        self._names, self._precision = names, precision
        self._known: dict[str, str] = {}

    def fill(self, gradient: Gradient) -> tuple[str, ElementTree.Element | None]:
        """The `fill` of a shape, and the element to be put before it; None where that is in the file already."""
        element = gradient_element(gradient, self._precision)
        text = ElementTree.tostring(element, encoding="unicode")
        new = text not in self._known
        if new:
            self._known[text] = self._names.unique("gradient")
            attributes = {"id": self._known[text], **element.attrib}
            element.attrib.clear()
            element.attrib.update(attributes)
        return f"url(#{self._known[text]})", element if new else None


def gradient_element(gradient: Gradient, precision: int) -> ElementTree.Element:
    """A linearGradient or radialGradient without an id, its stops within."""

    def number(value: float) -> str:
        return format_number(round(value * 10**precision), precision)

    if isinstance(gradient, LinearGradient):
        ends = {"x1": gradient.x1, "y1": gradient.y1, "x2": gradient.x2, "y2": gradient.y2}
        element = ElementTree.Element("linearGradient", {name: number(value) for name, value in ends.items()})
    elif number(gradient.rx) == number(gradient.ry):
        round_one = {"cx": gradient.cx, "cy": gradient.cy, "r": gradient.rx}
        element = ElementTree.Element("radialGradient", {name: number(value) for name, value in round_one.items()})
    else:
        # The unit circle, brought to the ellipse.
        matrix = " ".join(number(value) for value in gradient.matrix().T.ravel())
        unit = {"cx": "0", "cy": "0", "r": "1", "gradientTransform": f"matrix({matrix})"}
        element = ElementTree.Element("radialGradient", unit)
    element.set("gradientUnits", "userSpaceOnUse")
    for stop in gradient.stops:
        red, green, blue, alpha = stop.ink
        attributes = {"offset": format_number(round(stop.offset * 10**_DECIMALS), _DECIMALS)}
        attributes["stop-color"] = short_colour(red, green, blue)
        if alpha != _OPAQUE:
            attributes["stop-opacity"] = format_number(round(alpha * 10**_DECIMALS / _OPAQUE), _DECIMALS)
        ElementTree.SubElement(element, "stop", attributes)
    return element
