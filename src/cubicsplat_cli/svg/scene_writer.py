"""A scene as one plain SVG 1.1 document, and the bytes that each curve takes in it."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

import numpy as np
import svgwrite

from cubicsplat_cli.formatting import hex_text
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import as_numpy
from cubicsplat_cli.settings import ANY, Mode
from cubicsplat_cli.svg.markup import comment_text, format_number, gradient_element, in_short, joined, xml_text
from cubicsplat_cli.svg.quantise import OPACITY_DECIMALS, GridScene, gradient_decimals, ring_slices, to_grid
from cubicsplat_cli.svg.shapes import shape_element

BACKGROUND_ID, CURVES_ID, UNITS_ID = "background", "curves", "units"
# Bytes of a path beside its data: its tag, colour and width; and its opacity, where that is not said for all at once.
MARKUP = {Mode.CLOSED: 28, Mode.OPEN: 50}
OPACITY_MARKUP = {Mode.CLOSED: 20, Mode.OPEN: 22}
# Those of a gradient beside what `gradient_element` writes: its name, twice, and transform in place of its units.
GRADIENT_MARKUP = 34


def write_svg(scene: Scene, *, precision: int = 2, title: str = "", comment: str = "", shapes: str = ANY) -> str:
    """The SVG text of `scene`: one path per curve, back to front, readable by any SVG 1.1 viewer.

    shapes: the kind of all curves, which are written as such: `<ellipse>`, `<rect>` or `<polygon>` in place of paths.

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
        drawing.add(drawing.rect(id=BACKGROUND_ID, insert=(0, 0), size=size, fill=hex_text(grid.background)))
    definitions, fills = _definitions(grid)
    drawing.add(_curve_group(drawing, grid, fills))
    root = drawing.get_xml()
    if shapes != ANY:
        _write_shapes(root[-1], shapes, as_numpy(scene.points) * 10.0**precision)
    _finish(root, title, comment, definitions)
    text = in_short(ElementTree.tostring(root, encoding="unicode"))
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _definitions(grid: GridScene) -> tuple[ElementTree.Element, list[str]]:
    """The gradients, and what each curve's paint says.

    Their coordinates are in px and brought to the paths' unit by a transform: cairo fails where they reach 16,384. The
    units come from one that is none itself; a transform would not come along in every renderer.
    """
    definitions = ElementTree.Element("defs")
    fills = [hex_text(colour) for colour in grid.colours.tolist()]
    names: dict[str, str] = {}
    for index, gradient in enumerate(grid.gradients):
        if gradient is None:
            continue
        element = gradient_element(gradient, gradient_decimals(grid.precision))
        del element.attrib["gradientUnits"]
        if grid.precision > 0:
            element.set("gradientTransform", f"scale({10**grid.precision}){element.get('gradientTransform', '')}")
        text = ElementTree.tostring(element, encoding="unicode")
        if text not in names:
            names[text] = _short_name(len(names))
            element.attrib = {"id": names[text], "xlink:href": f"#{UNITS_ID}", **element.attrib}
            definitions.append(element)
        fills[index] = f"url(#{names[text]})"
    if names:
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


def _write_shapes(group: ElementTree.Element, kind: str, points: np.ndarray) -> None:
    """Turns the paths of a group into elements of a kind. points: (N, K, 2) of all curves, in units of the file."""
    for path, each in zip(group, points[::-1], strict=True):
        path.tag, attributes = shape_element(kind, each)
        fill = {name: value for name, value in path.attrib.items() if name != "d"}
        path.attrib = attributes | fill


def _finish(root: ElementTree.Element, title: str, comment: str, definitions: ElementTree.Element) -> None:
    """Add title, comment and definitions, drop svgwrite's empty <defs>, put every element on its own line."""
    for empty in root.findall("defs"):
        root.remove(empty)
    for unused in ("xmlns:ev",) if len(definitions) else ("xmlns:ev", "xmlns:xlink"):
        root.attrib.pop(unused, None)
    title_element = ElementTree.Element("title")
    title_element.text = xml_text(title)
    root.insert(0, ElementTree.Comment(comment_text(comment)))
    root.insert(1, title_element)
    if len(definitions):
        root.insert(2, definitions)
    for parent in (root, root[-1], definitions):
        parent.text = "\n"
        for child in parent:
            child.tail = "\n"


def path_strings(points: np.ndarray, ring_ends: np.ndarray | None = None, *, closed: bool) -> list[str]:
    """The `d` attribute of every curve, with a subpath for each of its rings.

    points: (N, K, 2) int64, K = 3M (closed) or 3M + 1 (open). ring_ends: as in `Scene`. Whole numbers need no decimal
    point, so the unit of the path is the step of the grid, and a transform brings it to pixels. Relative coordinates
    are differences of grid points, so no rounding error builds up along a curve.
    """
    if ring_ends is None:
        return _chains(points, closed)
    return [
        "".join(_chains(curve[None, ring], closed)[0] for ring in rings)
        for curve, rings in zip(points, ring_slices(ring_ends, closed=closed), strict=True)
    ]


def _chains(points: np.ndarray, closed: bool) -> list[str]:
    """Path data of curves of one ring and equal length (N, K, 2)."""
    count, per_curve = points.shape[:2]
    segments = per_curve // 3
    ends = 3 * np.arange(segments)[:, None] + np.array([1, 2, 3])
    absolute = points[:, ends % per_curve if closed else ends]  # (N, M, 3, 2)
    relative = absolute - points[:, 3 * np.arange(segments)][:, :, None]
    flat_shape = (count, segments, 6)
    end = "z" if closed else ""
    return [
        "M" + joined(start) + _cubics(curve_absolute, curve_relative) + end
        for start, curve_absolute, curve_relative in zip(
            points[:, 0].tolist(),
            absolute.reshape(flat_shape).tolist(),
            relative.reshape(flat_shape).tolist(),
            strict=True,
        )
    ]


def _cubics(absolute: Sequence[Sequence[int]], relative: Sequence[Sequence[int]]) -> str:
    """One curve's segments, each in its shorter form; the letter is left out where it repeats."""
    pieces: list[str] = []
    letter = ""
    for absolute_numbers, relative_numbers in zip(absolute, relative, strict=True):
        lower, upper = joined(relative_numbers), joined(absolute_numbers)
        lower = (_separator(lower) if letter == "c" else "c") + lower
        upper = (_separator(upper) if letter == "C" else "C") + upper
        take_lower = len(lower) < len(upper) or (len(lower) == len(upper) and letter != "C")
        letter = "c" if take_lower else "C"
        pieces.append(lower if take_lower else upper)
    return "".join(pieces)


def _separator(number: str) -> str:
    """The separator before a number that follows another: none before a minus."""
    return "" if number[0] == "-" else " "


def bytes_by_curve(scene: Scene, precision: int) -> list[int]:
    """Bytes of each curve's path and gradient, uncompressed, coordinates with `precision` decimals of a px."""
    grid = to_grid(scene, precision)
    paths = path_strings(grid.points, grid.ring_ends, closed=scene.mode is Mode.CLOSED)
    markup = MARKUP[scene.mode] + (0 if grid.one_opacity else OPACITY_MARKUP[scene.mode])
    sizes = [markup + len(data) for data in paths]
    for index, gradient in enumerate(grid.gradients):
        if gradient is not None:
            element = gradient_element(gradient, gradient_decimals(precision))
            sizes[index] += GRADIENT_MARKUP + len(ElementTree.tostring(element))
    return sizes
