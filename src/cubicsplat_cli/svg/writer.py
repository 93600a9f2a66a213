"""A scene as one plain SVG 1.1 document (svgwrite builds the document, `pathdata` the path strings)."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import svgwrite

from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.gradients import gradient_element
from cubicsplat_cli.svg.gridgradients import gradient_decimals
from cubicsplat_cli.svg.markup import in_short
from cubicsplat_cli.svg.pathdata import format_number, path_strings
from cubicsplat_cli.svg.quantise import OPACITY_DECIMALS, GridScene, to_grid

BACKGROUND_ID, CURVES_ID, UNITS_ID = "background", "curves", "units"
# XML 1.0 allows tab, newline, carriage return and these ranges; a file name may hold anything.
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write_svg(scene: Scene, *, precision: int = 2, title: str = "", comment: str = "") -> str:
    """The SVG text of `scene`: one path per curve, back to front, readable by any SVG 1.1 viewer.

    precision: decimals of the coordinates in px, 0..6. title: any text, shown by viewers. comment: one line
    for an XML comment; the command line knows its own files by it. Raises InputError that names the curve
    when a value is not finite or out of range, UsageError for a bad precision.
    """
    grid = to_grid(scene, precision)
    drawing = svgwrite.Drawing(
        size=(grid.width, grid.height), viewBox=f"0 0 {grid.width} {grid.height}", profile="full", debug=False
    )
    if grid.background is not None:
        size = (grid.width, grid.height)
        drawing.add(drawing.rect(id=BACKGROUND_ID, insert=(0, 0), size=size, fill=_hex_colour(grid.background)))
    definitions, fills = _definitions(grid)
    drawing.add(_curve_group(drawing, grid, fills))
    root = drawing.get_xml()
    _finish(root, title, comment, definitions)
    text = in_short(ElementTree.tostring(root, encoding="unicode"))
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _definitions(grid: GridScene) -> tuple[ElementTree.Element, list[str]]:
    """The gradients, and what each curve's paint says.

    Their coordinates are in px and brought to the paths' unit by a transform: cairo fails where they reach 16,384. The
    units come from one that is none itself; a transform would not come along in every renderer.
    """
    definitions = ElementTree.Element("defs")
    fills = [_hex_colour(colour) for colour in grid.colours.tolist()]
    known: dict[str, str] = {}
    for index, gradient in enumerate(grid.gradients):
        if gradient is None:
            continue
        element = gradient_element(gradient, gradient_decimals(grid.precision))
        del element.attrib["gradientUnits"]
        if grid.precision > 0:
            element.set("gradientTransform", f"scale({10**grid.precision}){element.get('gradientTransform', '')}")
        text = ElementTree.tostring(element, encoding="unicode")
        if text not in known:
            known[text] = _short_name(len(known))
            element.attrib = {"id": known[text], "xlink:href": f"#{UNITS_ID}", **element.attrib}
            definitions.append(element)
        fills[index] = f"url(#{known[text]})"
    if known:
        definitions.insert(0, ElementTree.Element("linearGradient", id=UNITS_ID, gradientUnits="userSpaceOnUse"))
    return definitions, fills


def _short_name(number: int) -> str:
    """a .. z, aa .. zz and so on; never an `id` of the document's own elements."""
    name = ""
    while number >= 0:
        name = chr(ord("a") + number % 26) + name
        number = number // 26 - 1
    return name if name not in (BACKGROUND_ID, CURVES_ID, UNITS_ID) else f"{name}-"


def _curve_group(drawing: svgwrite.Drawing, grid: GridScene, fills: list[str]) -> svgwrite.container.Group:
    """The group with what all curves share, and in it the paths; index 0 is the front, so it comes last."""
    closed = grid.mode is Mode.CLOSED
    if closed:
        group = drawing.g(id=CURVES_ID, fill_rule="nonzero")
    else:
        group = drawing.g(id=CURVES_ID, fill="none", stroke_linecap="round", stroke_linejoin="round")
    if grid.precision > 0:
        # One unit of the paths is one step of their grid: whole numbers are the shortest.
        group.update({"transform": f"scale({format_number(1, grid.precision)})"})
    paint = "fill" if closed else "stroke"
    data = path_strings(grid.points, grid.ring_ends, closed=closed)
    opacities, widths = grid.opacities.tolist(), grid.stroke_widths.tolist()
    opaque = 10**OPACITY_DECIMALS
    if grid.one_opacity and opacities[0] < opaque:
        group.update({f"{paint}_opacity": format_number(opacities[0], OPACITY_DECIMALS)})
        opacities = [opaque] * len(opacities)  # said once, for all
    for index in reversed(range(len(data))):
        # A list of one string: svgwrite would take a bare string apart into characters.
        attributes = {paint: fills[index]}
        if opacities[index] < opaque:
            attributes[f"{paint}_opacity"] = format_number(opacities[index], OPACITY_DECIMALS)
        if not closed:
            attributes["stroke_width"] = format_number(widths[index], grid.width_decimals - grid.precision)
        group.add(drawing.path(d=[data[index]], **attributes))
    return group


def _finish(root: ElementTree.Element, title: str, comment: str, definitions: ElementTree.Element) -> None:
    """Add title, comment and definitions, drop svgwrite's empty <defs>, put every element on its own line."""
    for empty in root.findall("defs"):
        root.remove(empty)
    for unused in ("xmlns:ev",) if len(definitions) else ("xmlns:ev", "xmlns:xlink"):
        root.attrib.pop(unused, None)
    title_element = ElementTree.Element("title")
    title_element.text = _xml_text(title)
    # "--" is not allowed inside a comment, nor a "-" at its end.
    comment_text = re.sub("-(?=-)", "- ", _xml_text(comment)).strip()
    root.insert(0, ElementTree.Comment(f" {comment_text} "))
    root.insert(1, title_element)
    if len(definitions):
        root.insert(2, definitions)
    for parent in (root, root[-1], definitions):
        parent.text = "\n"
        for child in parent:
            child.tail = "\n"


def _xml_text(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)


def _hex_colour(colour: tuple[int, int, int] | list[int]) -> str:
    red, green, blue = colour
    return f"#{red:02x}{green:02x}{blue:02x}"
