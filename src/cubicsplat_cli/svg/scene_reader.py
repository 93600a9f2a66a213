"""Reads the SVG files of `write_svg` and `write_drawing` back into a scene; refuses any other with one line."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.scene import Scene, pack_rings
from cubicsplat_cli.scene.gradients import gradients_of
from cubicsplat_cli.scene.paint import Gradient, LinearGradient, RadialGradient, mean_fill
from cubicsplat_cli.scene.shapes import shape_points
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.drawing_reader import angle_of, drawing_of, holds_drawing
from cubicsplat_cli.svg.own import REFERENCE, GradientReader, OwnElement, own_elements
from cubicsplat_cli.svg.paths import PathSegment
from cubicsplat_cli.svg.quantise import MAX_COORDINATE
from cubicsplat_cli.svg.scene_writer import BACKGROUND_ID, CURVES_ID, GROUP_STYLES, UNITS_ID, write_svg
from cubicsplat_cli.svg.values import hex_colour, parse_number, unit_colour

_WIDTH_DECIMALS, _GRADIENT_DECIMALS = 9, 7  # more than any file has
_SCALE = re.compile(r"scale\((?:1|\.(0{0,5})1)\)")
_BACKGROUND_ATTRIBUTES = ("id", "x", "y", "width", "height", "fill")
_GROUP_ATTRIBUTES = {"id": CURVES_ID, **GROUP_STYLES[Mode.CLOSED], **GROUP_STYLES[Mode.OPEN]}
# Rings, colour, opacity, half-width and gradient.
_Curve = tuple[list[np.ndarray], list[float], float, float, Gradient | None]
# The geometry of shapes other than paths.
_SHAPES = {
    "ellipse": ("cx", "cy", "rx", "ry", "transform"),
    "rect": ("x", "y", "width", "height", "transform"),
    "polygon": ("points",),
}


def quantise_scene(scene: Scene, precision: int) -> Scene:
    """Return the scene as a file with `precision` decimals holds it. Raises what `write_svg` raises."""
    return read_svg(write_svg(scene, precision=precision))


def read_svg(text: str | bytes) -> Scene:
    """Return the scene of an SVG that cubicsplat wrote (numpy arrays, index 0 the front).

    Raises InputError for anything else: what `own_elements` refuses, path data other than M, C, c and z, curves of
    different kinds, strokes of several subpaths, no curve at all, or a drawing with shading.
    """
    elements = own_elements(text)
    shading = next((element for element in elements if element.place == "svg/clipPath"), None)
    if shading is not None:
        advice = "use cubicsplat_cli.svg.drawing_reader.read_drawing"
        raise InputError(f"line {shading.line} clips shading, which no scene of curves has; {advice}")
    return scene_of(drawing_of(elements)) if holds_drawing(elements) else curves_of(elements)


def curves_of(elements: Sequence[OwnElement]) -> Scene:
    """Return the scene of a document's elements. Raises InputError if they are not those of `write_svg`."""
    width, height = elements[0].canvas_size()
    background, group = None, None
    curves: list[_Curve] = []
    for element in elements[0].children:
        with element.checked():
            if element.name == "rect" and group is None and background is None:
                background = _background(element, width, height)
            elif element.name == "g" and group is None:
                group = _group_of(element)
                scale = f"scale({10**group.shift})" if group.shift else ""
                gradients = GradientReader(_in_px(each, scale) for each in elements if each.name.endswith("Gradient"))
                for child in element.children:
                    with child.checked():
                        curves.append(_curve(child, group, gradients))
            elif element.name not in ("title", "defs"):
                raise ValueError(f"has an unexpected <{element.name}> element")
    if group is None or not curves:
        raise InputError("the SVG holds no curves of cubicsplat; give a file that `cubicsplat vectorize` wrote")
    # The last curve is at the front, where a scene begins.
    rings, colours, opacities, half_widths, paints = zip(*curves[::-1], strict=True)
    points, ring_ends = pack_rings(group.mode, rings)
    scene = Scene(
        group.mode, width, height, points.astype(np.float32), np.array(colours, np.float32),
        np.array(opacities, np.float32), np.array(half_widths, np.float32), background, ring_ends, gradients_of(paints),
    )  # fmt: skip
    scene.validate()
    return scene


def _in_px(element: OwnElement, scale: str) -> OwnElement:
    """Return a gradient without the transform `scale` to the unit of the paths. Raises InputError for other units."""
    given = element.attributes
    if given.get("id") == UNITS_ID and given.get("gradientUnits") == "userSpaceOnUse":
        return element
    transform = given.get("gradientTransform", "")
    if given.get("xlink:href") != f"#{UNITS_ID}":
        raise element.refused("has a gradient that is not in px")
    if not transform.startswith(scale):
        raise element.refused("has gradients in another unit than the paths")
    return replace(element, attributes=given | {"gradientTransform": transform.removeprefix(scale)})


def _background(element: OwnElement, width: int, height: int) -> tuple[float, float, float] | None:
    element.check_attributes(_BACKGROUND_ATTRIBUTES)
    given = element.attributes
    if given.get("id", BACKGROUND_ID) != BACKGROUND_ID:
        raise ValueError(f"has a <rect> called {given['id']!r}")
    if [given.get(name, "0") for name in ("x", "y", "width", "height")] != ["0", "0", str(width), str(height)]:
        raise ValueError("has a <rect> that is not the background")
    return unit_colour(hex_colour(given.get("fill", "")))


class _CurveGroup(NamedTuple):
    """The group of all curves. shift: the paths' unit is 10^-shift px. opacity: default of the curves."""

    mode: Mode
    shift: int
    opacity: str


def _group_of(element: OwnElement) -> _CurveGroup:
    given = dict(element.attributes)
    scale = _SCALE.fullmatch(given.pop("transform", "scale(1)"))
    if scale is None:
        raise ValueError("has a transform other than the scale of a precision")
    # Only groups of strokes have the fill "none".
    opacity = given.pop("stroke-opacity" if "fill" in given else "fill-opacity", "1")
    replace(element, attributes=given).check_attributes(_GROUP_ATTRIBUTES)
    for name, value in given.items():
        if value != _GROUP_ATTRIBUTES.get(name, value):
            raise ValueError(f"has {name}={value!r}")
    said = {name for name in given if name in _GROUP_ATTRIBUTES and name != "id"}
    mode = next((mode for mode, style in GROUP_STYLES.items() if style.keys() == said), None)
    if mode is None:
        raise ValueError("has a <g> that says neither closed nor open curves")
    return _CurveGroup(mode, 0 if scale[1] is None else len(scale[1]) + 1, opacity)


def _curve(element: OwnElement, group: _CurveGroup, gradients: GradientReader) -> _Curve:
    """Return the curve of an element in the group. Raises ValueError for what `write_svg` does not write."""
    closed, unit = group.mode is Mode.CLOSED, 10.0**group.shift
    if element.name == "path":
        allowed = ("fill", "fill-opacity") if closed else ("stroke", "stroke-opacity", "stroke-width")
        element.check_attributes(("d", *allowed))
        rings = _rings(element.subpaths(), group.mode, unit)
    elif closed and element.name in _SHAPES:
        element.check_attributes((*_SHAPES[element.name], "fill", "fill-opacity"))
        rings = [_points_of_shape(element) / unit]
    else:
        raise ValueError(f"has an unexpected <{element.name}> element")
    given, kind = element.attributes, "fill" if closed else "stroke"
    match = REFERENCE.fullmatch(given.get(kind, ""))
    gradient = None if match is None else _without_noise(gradients.gradient(match[1], (0.0, 0.0, 1.0, 1.0)))
    levels = hex_colour(given.get(kind, "")) if gradient is None else mean_fill(gradient)[:3]
    opacity = _at_most(given.get(f"{kind}-opacity", group.opacity), 1.0)
    width = 0.0 if closed else _at_most(given.get("stroke-width", ""), 2.0 * MAX_COORDINATE * unit)
    half_width = round(width / unit, _WIDTH_DECIMALS) / 2.0
    return rings, [level / 255 for level in levels], opacity, half_width, gradient


def _rings(subpaths: list[list[PathSegment]], mode: Mode, scale: float) -> list[np.ndarray]:
    """Return the control points (K, 2) of each subpath in px, float64. scale: units of the path per px."""
    if len(subpaths) > 1 and mode is Mode.OPEN:
        raise ValueError("has a stroke of several subpaths")
    rings = [np.array(control_points(subpath, mode)) / scale for subpath in subpaths]
    if not all((np.abs(ring) <= MAX_COORDINATE).all() for ring in rings):  # false for NaN too
        raise ValueError(f"has a point more than {MAX_COORDINATE:.0f} px from the origin")
    return rings


def control_points(subpath: list[PathSegment], mode: Mode) -> list[tuple[float, float]]:
    """Return the control points of cubics in a row, the start of a ring once. Raises ValueError for other segments."""
    closed = mode is Mode.CLOSED
    if closed and (not subpath or subpath[-1].command != "Z"):
        raise ValueError("has a closed curve whose path does not end with z")
    cubics = subpath[:-1] if closed else subpath
    if not cubics:
        raise ValueError("has path data that does not begin with one point and a cubic")
    if any(segment.command != "C" for segment in cubics):
        raise ValueError("has path data other than M, cubics and z")
    if closed and subpath[-1].start != subpath[-1].end:
        raise ValueError("has a closed curve that does not return to its start")
    points = [point for segment in cubics for point in (segment.start, *segment.handles)]
    return points if closed else [*points, cubics[-1].end]


def _points_of_shape(element: OwnElement) -> np.ndarray:
    """Return the control points (K, 2) of an ellipse, rect or polygon of `write_svg`. Raises ValueError for others."""
    given, name = element.attributes, element.name
    if name == "polygon":
        vertices = np.array([parse_number(text) for text in given.get("points", "").split(" ")])
        if vertices.size < 6 or vertices.size % 2:
            raise ValueError("has a polygon of fewer than three points")
        return shape_points("polygon", vertices[None])[0]
    x, y, a, b = (parse_number(given.get(attribute, "")) for attribute in _SHAPES[name][:4])
    if name == "rect":
        x, y, a, b = x + a / 2.0, y + b / 2.0, a / 2.0, b / 2.0
    if min(a, b) < 0.0:
        raise ValueError(f"has a <{name}> that is none of a photo")
    angle, first = angle_of(given), max(a, 1e-3)  # a first axis of no length would have no direction
    values = np.array([[x, y, first * math.cos(angle), first * math.sin(angle), b]])
    return shape_points("ellipse" if name == "ellipse" else "rectangle", values)[0]


def _without_noise(gradient: Gradient) -> Gradient:
    """Return a gradient without the noise that arithmetic adds to the coordinates of the file."""

    def rounded(*values: float) -> list[float]:
        return [round(value, _GRADIENT_DECIMALS) for value in values]

    if isinstance(gradient, LinearGradient):
        x1, y1, x2, y2 = rounded(gradient.x1, gradient.y1, gradient.x2, gradient.y2)
        return LinearGradient(x1, y1, x2, y2, gradient.stops)
    cx, cy, rx, ry, *focus = rounded(gradient.cx, gradient.cy, gradient.rx, gradient.ry, *(gradient.focus or ()))
    angle = 0.0 if rx == ry else gradient.angle
    return RadialGradient(cx, cy, rx, ry, angle, gradient.stops, (focus[0], focus[1]) if focus else None)


def _at_most(text: str, largest: float) -> float:
    value = parse_number(text)
    if not 0.0 <= value <= largest:
        raise ValueError(f"has the number {text!r}, which is not in 0..{largest:g}")
    return value
