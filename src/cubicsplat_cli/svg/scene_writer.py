"""A scene as one plain SVG 1.1 document or as the list of Geometrize, and the bytes that each curve takes in an SVG."""

from __future__ import annotations

import itertools
import json
import math
import string
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np
import svgwrite

from cubicsplat_cli.formatting import hex_text
from cubicsplat_cli.scene import Scene, ring_slices
from cubicsplat_cli.scene.arrays import as_numpy
from cubicsplat_cli.scene.shapes import lengths, nearest_shape
from cubicsplat_cli.settings import ANY, Mode, width_decimals
from cubicsplat_cli.svg.markup import GradientElements, format_number, gradient_element, joined, titled
from cubicsplat_cli.svg.quantise import GridScene, gradient_decimals, to_grid
from cubicsplat_cli.svg.values import OPACITY_DECIMALS, levels_of

BACKGROUND_ID, CURVES_ID, UNITS_ID = "background", "curves", "units"
# Bytes of a path besides its data: tag, colour and width; and its opacity, unless the group says it for all.
MARKUP = {Mode.CLOSED: 28, Mode.OPEN: 50}
OPACITY_MARKUP = {Mode.CLOSED: 20, Mode.OPEN: 22}
# Bytes of a gradient besides those of `gradient_element`: two names, and a transform in place of the units.
GRADIENT_MARKUP = 34
ANGLE_DECIMALS = 2
# What the group of the curves says for all of them.
GROUP_STYLES = {
    Mode.CLOSED: {"fill-rule": "nonzero"},
    Mode.OPEN: {"fill": "none", "stroke-linecap": "round", "stroke-linejoin": "round"},
}
# The numbers of Geometrize for the kinds of shapes; a background has 0.
GEOMETRIZE_TYPES = {"rectangle": 1, "triangle": 2, "ellipse": 4}


def write_svg(scene: Scene, *, precision: int = 2, title: str = "", comment: str = "", shapes: str = ANY) -> str:
    """Return the SVG text of a scene: one path per curve, back to front, readable by any SVG 1.1 viewer.

    precision: decimals of the coordinates in px, 0..6. title: any text; viewers show it. comment: one line for an XML
    comment, by which the command line recognises its own files. shapes: the kind of all curves; they are written as
    `<ellipse>`, `<rect>` or `<polygon>` instead of paths. Raises the errors of `to_grid`.
    """
    grid = to_grid(scene, precision)
    size = (scene.width, scene.height)
    drawing = svgwrite.Drawing(size=size, viewBox=f"0 0 {scene.width} {scene.height}", profile="full", debug=False)
    if (background := levels_of(scene.background)) is not None:
        drawing.add(drawing.rect(id=BACKGROUND_ID, insert=(0, 0), size=size, fill=hex_text(background)))
    definitions, paints = _definitions(grid)
    drawing.add(_curve_group(drawing, scene.mode, grid, paints))
    root = drawing.get_xml()
    if shapes != ANY:
        for path, points in zip(root[-1], as_numpy(scene.points)[::-1] * 10.0**precision, strict=True):
            path.tag, geometry = _shape_element(shapes, points)
            del path.attrib["d"]
            path.attrib = geometry | path.attrib
    root.remove(root.find("defs"))  # svgwrite's own, which is empty
    del root.attrib["xmlns:ev"]
    if len(definitions):
        root.insert(0, definitions)
    else:
        del root.attrib["xmlns:xlink"]
    return titled(root, title, comment)


def _definitions(grid: GridScene) -> tuple[ElementTree.Element, list[str]]:
    """Return the gradients, and the paint of each curve.

    Coordinates of gradients are in px, since cairo fails where they reach 16,384; a transform converts them to the unit
    of the paths. They inherit their units from an empty gradient. They cannot inherit a transform in every renderer.
    """
    definitions = ElementTree.Element("defs")
    paints = [hex_text(colour) for colour in grid.colours.tolist()]
    letters = (itertools.product(string.ascii_lowercase, repeat=size) for size in itertools.count(1))
    names = map("".join, itertools.chain.from_iterable(letters))  # a .. z, aa .. zz and so on
    gradients = GradientElements(names.__next__, gradient_decimals(grid.precision))
    for index, gradient in enumerate(grid.gradients):
        if gradient is None:
            continue
        paints[index], element = gradients.fill(gradient)
        if element is not None:
            name, _ = element.attrib.pop("id"), element.attrib.pop("gradientUnits")
            element.attrib = {"id": name, "xlink:href": f"#{UNITS_ID}", **element.attrib}
            if grid.precision > 0:
                element.set("gradientTransform", f"scale({10**grid.precision}){element.get('gradientTransform', '')}")
            definitions.append(element)
    if len(definitions):
        definitions.insert(0, ElementTree.Element("linearGradient", id=UNITS_ID, gradientUnits="userSpaceOnUse"))
    return definitions, paints


def _curve_group(drawing: svgwrite.Drawing, mode: Mode, grid: GridScene, paints: list[str]) -> svgwrite.container.Group:
    """Return the group of all paths with what they share; index 0 is the front, so it comes last."""
    closed = mode is Mode.CLOSED
    group = drawing.g(id=CURVES_ID)
    group.update(GROUP_STYLES[mode])
    if grid.precision > 0:
        # The unit of the paths is one step of their grid, because whole numbers are the shortest.
        group.update({"transform": f"scale({format_number(1, grid.precision)})"})
    kind = "fill" if closed else "stroke"
    data = path_strings(grid.points, grid.ring_ends, closed=closed)
    opacities, widths = grid.opacities.tolist(), grid.stroke_widths.tolist()
    opaque = 10**OPACITY_DECIMALS
    if grid.one_opacity and opacities[0] < opaque:
        group.update({f"{kind}_opacity": format_number(opacities[0], OPACITY_DECIMALS)})
        opacities = [opaque] * len(opacities)
    for index in reversed(range(len(data))):
        attributes = {kind: paints[index]}
        if opacities[index] < opaque:
            attributes[f"{kind}_opacity"] = format_number(opacities[index], OPACITY_DECIMALS)
        if not closed:
            attributes["stroke_width"] = format_number(widths[index], width_decimals(grid.precision) - grid.precision)
        # svgwrite would take a bare string apart into characters, so it gets a list.
        group.add(drawing.path(d=[data[index]], **attributes))
    return group


def path_strings(points: np.ndarray, ring_ends: np.ndarray | None = None, *, closed: bool) -> list[str]:
    """Return the `d` attribute of every curve, with a subpath for each of its rings.

    points: (N, K, 2) int64 in steps of the grid, K = 3M (closed) or 3M + 1 (open). ring_ends: as in `Scene`. Relative
    coordinates are differences of grid points, so no rounding error builds up along a curve.
    """
    if ring_ends is None:
        return [path_values([curve], closed=closed)[0] for curve in points.tolist()]
    return [
        "".join(path_values([curve[ring].tolist()], closed=closed)[0] for ring in rings)
        for curve, rings in zip(points, ring_slices(ring_ends, closed=closed), strict=True)
    ]


def path_values(knots: list[list[list[int]]], *, closed: bool) -> list[str]:
    """Return the path data of a ring or stroke, whose control points (K, 2) are given at one or more knots in time.

    Each cubic has its shorter form, absolute or relative: the same in all knots, as SMIL needs to go from one to the
    next. The letter is left out where it repeats.
    """
    texts, letter = ["M" + joined(points[0]) for points in knots], ""
    chains = [[*points, points[0]] if closed else points for points in knots]
    for start in range(0, len(chains[0]) - 1, 3):
        lower, upper = [], []
        for chain in chains:
            (x, y), (a, b), (c, d), (e, f) = chain[start : start + 4]
            lower.append(_after(letter, "c", joined((a - x, b - y, c - x, d - y, e - x, f - y))))
            upper.append(_after(letter, "C", joined((a, b, c, d, e, f))))
        longer = sum(map(len, lower)) - sum(map(len, upper))
        letter, chosen = ("c", lower) if longer < 0 or (longer == 0 and letter != "C") else ("C", upper)
        texts = [text + part for text, part in zip(texts, chosen, strict=True)]
    return [text + ("z" if closed else "") for text in texts]


def _after(letter: str, form: str, numbers: str) -> str:
    """Return numbers with what must stand before them: the letter of their form, a space, or nothing."""
    if form != letter:
        return form + numbers
    return numbers if numbers[0] == "-" else f" {numbers}"


def bytes_by_curve(scene: Scene, precision: int) -> list[int]:
    """Return the bytes of each curve's path and gradient, uncompressed. precision: decimals of coordinates in px."""
    grid = to_grid(scene, precision)
    paths = path_strings(grid.points, grid.ring_ends, closed=scene.mode is Mode.CLOSED)
    markup = MARKUP[scene.mode] + (0 if grid.one_opacity else OPACITY_MARKUP[scene.mode])
    sizes = [markup + len(data) for data in paths]
    for index, gradient in enumerate(grid.gradients):
        if gradient is not None:
            element = gradient_element(gradient, gradient_decimals(precision))
            sizes[index] += GRADIENT_MARKUP + len(ElementTree.tostring(element))
    return sizes


def _shape_element(kind: str, points: np.ndarray) -> tuple[str, dict[str, str]]:
    """Return the tag and the geometry of a shape with control points (K, 2), in whole units of the file."""
    if kind not in ("ellipse", "rectangle"):
        return "polygon", {"points": " ".join(map(str, np.rint(points[::3]).astype(int).ravel().tolist()))}
    *box, degrees = _framed(kind, points)
    x, y, a, b = map(round, box)
    if kind == "ellipse":
        tag, numbers = "ellipse", {"cx": x, "cy": y, "rx": a, "ry": b}
    else:
        tag, numbers = "rect", {"x": x - a, "y": y - b, "width": 2 * a, "height": 2 * b}
    geometry = {name: str(value) for name, value in numbers.items()}
    angle = format_number(round(degrees * 10**ANGLE_DECIMALS), ANGLE_DECIMALS)
    if angle != "0":
        geometry["transform"] = f"rotate({angle} {x} {y})"
    return tag, geometry


def _framed(kind: str, points: np.ndarray) -> tuple[float, float, float, float, float]:
    """Return x and y of the middle, the half axes, and the degrees of the first one in [0, 180), clockwise as seen."""
    values = nearest_shape(kind, points[None].astype(np.float64))
    x, y, across, down, second = values[0].tolist()
    return x, y, float(lengths(values)[0, 0]), abs(second), math.degrees(math.atan2(down, across)) % 180.0


def geometrize_list(kind: str, scene: Scene, scores: list[float], marks: Mapping[str, str]) -> str:
    """Return a scene as the JSON list that Geometrize reads, from back to front, the background first.

    Each item has `type`, `data`, `color` (8-bit RGBA) and `score`. Coordinates are whole px, angles whole degrees.
    scores: (N + 1,) of the background alone, and with each further shape. marks: further members of the first item.
    """
    ground = _rgba(scene.background or (0.0, 0.0, 0.0), float(scene.background is not None))
    items: list[dict[str, Any]] = [{"type": 0, "data": [0, 0, scene.width, scene.height], "color": ground}]
    arrays = (as_numpy(a)[::-1] for a in (scene.points, scene.colours, scene.opacities))
    for points, colour, opacity in zip(*arrays, strict=True):
        if kind == "triangle":
            data = np.rint(points[::3]).astype(int).ravel().tolist()
        else:
            x, y, a, b, degrees = _framed(kind, points)
            box = (x - a, y - b, x + a, y + b) if kind == "rectangle" else (x, y, a, b)
            data = [round(value) for value in (*box, degrees)]
        items.append({"type": GEOMETRIZE_TYPES[kind], "data": data, "color": _rgba(colour.tolist(), float(opacity))})
    items = [{**item, "score": round(score, 6)} for item, score in zip(items, scores, strict=True)]
    return "[\n" + ",\n".join(map(json.dumps, ({**items[0], **marks}, *items[1:]))) + "\n]\n"


def _rgba(colour: Any, opacity: float) -> list[int]:
    return [round(255.0 * value) for value in (*colour, opacity)]
