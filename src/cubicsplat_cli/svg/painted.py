"""The shapes of any SVG as cubics and paints in px, for programs without style sheets and transforms."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass, field, replace
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import points_at
from cubicsplat_cli.artwork.geometry.stroke import MOST_DASHES, dashed, measured
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.formatting import counted, hex_text, one_line
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import Gradient
from cubicsplat_cli.svg.elements import StyledShape, StyledTree, local_name, reference
from cubicsplat_cli.svg.own import LINEAR, MOST_STOPS, RADIAL, GradientReader, OwnElement
from cubicsplat_cli.svg.paths import MAX_COMMANDS, Subpath, TooLong, cubic_subpaths
from cubicsplat_cli.svg.quantise import MAX_COORDINATE
from cubicsplat_cli.svg.shading import without_shading
from cubicsplat_cli.svg.untrusted import SvgSize
from cubicsplat_cli.svg.values import Rgba, colour, parse_length, share

LEAST_OPACITY = 1.0 / 512.0  # below it nothing shows in 8 bits
_REFERENCE = re.compile(r"url\(\s*['\"]?#([^'\")]+)['\"]?\s*\)\s*(.*)")
Paint = Rgba | Gradient  # sRGB and opacity in [0, 1]; or a gradient in px, its stops with the shape's opacity


@record
class PaintedShape:
    """A shape in px.

    name: its id, or else the name of its element. lines: its subpaths. fill, stroke: None if there is none. width: of
    the stroke. even_odd: the rule of the fill. cap, join, limit: of the stroke, as in SVG. matrix: (3, 3) to px from
    its own units, in which the stroke has the same width in all directions.
    """

    name: str
    lines: list[Subpath]
    fill: Paint | None
    stroke: Paint | None
    width: float
    even_odd: bool
    cap: str
    join: str
    limit: float
    matrix: np.ndarray


@dataclass(eq=False)
class PaintedShapes:
    """The shapes of a drawing, px, the first at the back. left_out: kinds of what they lack of the SVG, counted."""

    width: float
    height: float
    shapes: list[PaintedShape] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)

    def notes(self, of: str = "") -> list[str]:
        """Return a sentence that names what is left out, or none. of: completes "left out"."""
        parts = [counted(count, name) for name, count in sorted(self.left_out.items()) if count]
        return [f"left out{of}: {', '.join(parts)}"] if parts else []


def painted_shapes(svg: bytes, source: str, size: SvgSize, drawn: SvgSize) -> PaintedShapes:
    """Return the shapes of a checked SVG of natural size `size`, drawn at size `drawn` and centred in it.

    source: its name for messages. Raises InputError for an SVG that cannot be read or has too many segments.
    """
    made = PaintedShapes(drawn.width, drawn.height)
    scale = min(drawn.width / size.width, drawn.height / size.height)
    to_px = np.diag([scale, scale, 1.0])
    to_px[:2, 2] = (drawn.width - scale * size.width) / 2.0, (drawn.height - scale * size.height) / 2.0
    try:
        root = ElementTree.fromstring(svg)
        made.left_out["shading"] += without_shading(root)
        tree = StyledTree(root, made.left_out)
        gradients, segments = _gradients(tree), 0
        for shape in tree.shapes(size.width, size.height):
            for painted in _painted(shape, to_px @ shape.matrix, gradients, made.left_out):
                made.shapes.append(painted)
                segments += sum(len(line.cubics) for line in painted.lines)
            if segments > MAX_COMMANDS:
                raise TooLong(f"has more than {MAX_COMMANDS} segments; simplify it")
    except (InputError, ValueError, ElementTree.ParseError) as error:
        raise InputError(f"{source}: {one_line(error)}") from error
    return made


def _painted(
    shape: StyledShape, matrix: np.ndarray, gradients: GradientReader, left_out: Counter[str]
) -> list[PaintedShape]:
    """Return the shape in px, its dashes apart from its fill; none if nothing of it is seen. matrix: (3, 3) from its
    units to px.
    """
    style = shape.style
    try:
        lines = cubic_subpaths(shape.path_data())
        if not lines or not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:2, :2])) < 1e-12:
            return []
        fill, stroke = (_paint(shape, name, lines, matrix, gradients, left_out) for name in ("fill", "stroke"))
        width = parse_length(style["stroke-width"], shape.view[0]) * math.sqrt(abs(np.linalg.det(matrix[:2, :2])))
        limit = parse_length(style["stroke-miterlimit"], 1.0)
        dashes = _dashes(shape, lines) if stroke is not None and width > 0.0 else None
    except TooLong:
        raise
    except (InputError, ValueError):
        left_out[f"{shape.name} that cannot be read"] += 1
        return []
    fill, stroke = (None if shape.name == "line" else fill), (stroke if width > 0.0 else None)
    if fill is None and stroke is None:
        return []
    cap = style["stroke-linecap"] if style["stroke-linecap"] in ("round", "square") else "butt"
    join = style["stroke-linejoin"] if style["stroke-linejoin"] in ("round", "bevel") else "miter"
    lines = [line.mapped(matrix) for line in lines]
    if max(float(np.abs(line.cubics).max()) for line in lines) > MAX_COORDINATE:
        left_out[f"{shape.name} beyond {MAX_COORDINATE:.0f} px"] += 1
        return []
    name, even_odd = shape.element.get("id") or shape.name, style["fill-rule"] == "evenodd"
    whole = PaintedShape(name, lines, fill, stroke, width, even_odd, cap, join, limit, matrix)
    if dashes is None:
        return [whole]
    parts = [replace(whole, stroke=None), replace(whole, lines=[line.mapped(matrix) for line in dashes], fill=None)]
    return parts[fill is None : 1 + bool(dashes)]


def _dashes(shape: StyledShape, lines: list[Subpath]) -> list[Subpath] | None:
    """Return the dashes of a shape's stroke, by its subpaths in its own units; None if it is a whole line.

    Raises ValueError for a pattern that cannot be read, InputError for too many dashes.
    """
    text = shape.style["stroke-dasharray"].replace(",", " ")
    if text.strip() in ("none", ""):
        return None
    pattern = [parse_length(part, shape.view[0]) for part in text.split()] * 2
    offset = parse_length(shape.style["stroke-dashoffset"], shape.view[0])
    if min(pattern) < 0.0 or not sum(pattern):
        return None
    cubics = [line.ring() if line.closed else line.cubics for line in lines]
    if (length := parse_length(shape.element.get("pathLength", "0"), 1.0)) > 0.0:
        scale = sum(float(measured(each)[1][-1]) for each in cubics) / length
        pattern, offset = [scale * part for part in pattern], scale * offset
    if not math.isfinite(sum(pattern) + offset):
        raise ValueError("lengths beyond all bounds")
    dashes = list[Subpath]()
    for each in cubics:
        dashes += [Subpath(part, False) for part in dashed(each, pattern, offset)]
        if len(dashes) > MOST_DASHES:
            raise TooLong(f"has lines of more than {MOST_DASHES} dashes; make them longer")
    return dashes


def _paint(
    shape: StyledShape, name: str, lines: list[Subpath], matrix: np.ndarray, gradients: GradientReader,
    left_out: Counter[str],
) -> Paint | None:  # fmt: skip
    """Return the "fill" or "stroke" of a shape, None if there is none. lines: its subpaths in its own units."""
    style = shape.style
    match = _REFERENCE.fullmatch(style[name])
    paint: Paint | None
    if match is None:
        paint = colour(style[name], style["color"])
    elif match[1] in gradients:
        # The bounding box, true to a thousandth of each cubic.
        cubics = np.concatenate([line.cubics for line in lines])
        points = points_at(cubics, np.linspace(0.0, 1.0, 33)).reshape(-1, 2)
        (left, top), (width, height) = points.min(axis=0).tolist(), np.ptp(points, axis=0).tolist()
        paint = gradients.gradient(match[1], (left, top, width, height), matrix)
    else:
        left_out["pattern"] += 1
        paint = colour(match[2], style["color"]) if match[2] else None
    opacity = share(style[f"{name}-opacity"]) * shape.opacity
    if paint is None or opacity < LEAST_OPACITY:
        return None
    if isinstance(paint, tuple):
        return (*paint[:3], paint[3] * opacity)
    stops = (replace(stop, colour=(*stop.colour[:3], round(stop.colour[3] * opacity))) for stop in paint.stops)
    return replace(paint, stops=tuple(stops))


def _gradients(tree: StyledTree) -> GradientReader:
    """Return the gradients of a document of any origin; nothing can refer to those without an id."""
    elements = []
    for element in tree.root.iter():
        name = local_name(element)
        if name not in (LINEAR, RADIAL) or not element.get("id"):
            continue
        link = {"href": f"#{reference(element)}"} if reference(element) else {}
        elements.append(OwnElement(name, {**element.attrib, **link}))
        stops = [stop for stop in element if local_name(stop) == "stop"]
        for stop in stops[:MOST_STOPS]:
            try:
                elements[-1].children.append(OwnElement("stop", _stop(tree, stop)))
            except ValueError:
                tree.left_out["stop that cannot be read"] += 1
        tree.left_out["stop"] += len(stops[MOST_STOPS:])
    return GradientReader(elements)


def _stop(tree: StyledTree, stop: ElementTree.Element) -> dict[str, str]:
    """Return the attributes of a stop in the form of `GradientReader`."""
    values = tree.declared(stop)
    rgba = colour(values.get("stop-color", "black"), values.get("color", "black")) or (0.0, 0.0, 0.0, 0.0)
    return {
        "offset": repr(share(values.get("offset", "0"))),
        "stop-color": hex_text(round(255.0 * channel) for channel in rgba[:3]),
        "stop-opacity": repr(rgba[3] * share(values.get("stop-opacity", "1"))),
    }
