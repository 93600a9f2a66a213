"""Drawings as VectorDrawable, the XML of Android's icons (API 24 and later for gradients and even-odd fills)."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring, thirds
from cubicsplat_cli.artwork.geometry.steps import suggested_precision
from cubicsplat_cli.formatting import hex_text
from cubicsplat_cli.scene.paint import Gradient, LinearGradient, RadialGradient
from cubicsplat_cli.svg.drawing_paths import PathText, add_pieces
from cubicsplat_cli.svg.markup import comment_text
from cubicsplat_cli.svg.painted import Paint, PaintedShape, PaintedShapes
from cubicsplat_cli.svg.paths import Subpath, groups_apart

MOST_CHARACTERS = 32_767  # of one attribute, the limit of Android's resource compiler
_MOST_SPLIT = 10_000  # subpaths, since they are compared in pairs
_NAME = re.compile(r"[\w-]+")  # Android might read other text as a reference
_NAMESPACES = {
    "xmlns:android": "http://schemas.android.com/apk/res/android", "xmlns:aapt": "http://schemas.android.com/aapt",
}  # fmt: skip
Element = ElementTree.Element


def vector_drawable(drawing: PaintedShapes, mark: str) -> bytes:
    """Return the file, one dp per px. mark: text of its first comment. `drawing.left_out` counts what it lacks."""
    width, height = _number(drawing.width), _number(drawing.height)
    sizes = {"width": f"{width}dp", "height": f"{height}dp", "viewportWidth": width, "viewportHeight": height}
    root = Element("vector", {**_NAMESPACES, **_named(sizes)})
    precision = suggested_precision(math.ceil(drawing.width), math.ceil(drawing.height))
    for shape in (part for whole in drawing.shapes for part in _parts(whole)):
        drawing.left_out["ellipse of a stroke's gradient"] += _is_elliptical(shape.stroke)
        drawing.left_out["focus of a gradient"] += _has_focus(shape.fill) + _has_focus(shape.stroke)
        elements = [_element(shape, shape.lines, precision)]
        if elements[0] is None and len(shape.lines) <= _MOST_SPLIT:
            groups = groups_apart([line.cubics for line in shape.lines])
            elements = [_element(shape, [shape.lines[index] for index in group], precision) for group in groups]
        root.extend(element for element in elements if element is not None)
        drawing.left_out[f"path of more than {MOST_CHARACTERS} characters"] += elements.count(None)
    ElementTree.indent(root, " ")
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n<!--{comment_text(mark)}-->\n{text}\n'.encode()


def _is_elliptical(paint: Paint | None) -> bool:
    return isinstance(paint, RadialGradient) and abs(paint.rx - paint.ry) > 1e-3 * paint.rx


def _has_focus(paint: Paint | None) -> bool:
    return isinstance(paint, RadialGradient) and paint.focus is not None


def _parts(shape: PaintedShape) -> list[PaintedShape]:
    """Return the shape, or its fill and its stroke apart if the fill needs a group, which would bend the stroke."""
    if shape.stroke is None or not _is_elliptical(shape.fill):
        return [shape]
    return [replace(shape, stroke=None), replace(shape, fill=None)]


def _element(shape: PaintedShape, lines: list[Subpath], precision: int) -> Element | None:
    """Return a path, within a group if its gradient is elliptical, and circular there; None if its data is too long."""
    attributes = {"name": shape.name} if _NAME.fullmatch(shape.name) else {}
    if shape.fill is not None and shape.even_odd:
        attributes["fillType"] = "evenOdd"
    if shape.stroke is not None:
        attributes |= {"strokeWidth": _number(shape.width), "strokeLineCap": shape.cap, "strokeLineJoin": shape.join}
        attributes["strokeMiterLimit"] = _number(shape.limit)
    fill, frame = shape.fill, None
    if isinstance(fill, RadialGradient) and _is_elliptical(fill):
        frame, fill = fill, RadialGradient(0.0, 0.0, fill.rx, fill.rx, 0.0, fill.stops)
        squeeze = np.vstack([frame.matrix(), [0.0, 0.0, 1.0]]) @ np.diag([1.0 / frame.rx, 1.0 / frame.rx, 1.0])
        lines = [line.mapped(np.linalg.inv(squeeze)) for line in lines]
    data = _path_data(lines, precision)
    if len(data) > MOST_CHARACTERS:
        return None
    path = Element("path", {"android:pathData": data, **_named(attributes)})
    for name, paint in (("fill", fill), ("stroke", shape.stroke)):
        _add_paint(path, name, paint)
    if frame is None:
        return path
    turn = {"translateX": frame.cx, "translateY": frame.cy, "rotation": math.degrees(frame.angle)}
    turn["scaleY"] = frame.ry / frame.rx
    group = Element("group", _named({name: _number(value) for name, value in turn.items()}))
    group.append(path)
    return group


def _add_paint(path: Element, name: str, paint: Paint | None) -> None:
    if isinstance(paint, tuple):
        path.set(f"android:{name}Color", hex_text(round(255.0 * part) for part in paint[:3]).upper())
        if paint[3] < 1.0:
            path.set(f"android:{name}Alpha", _number(paint[3]))
    elif paint is not None:
        ElementTree.SubElement(path, "aapt:attr", {"name": f"android:{name}Color"}).append(_gradient(paint))


def _gradient(gradient: Gradient) -> Element:
    if isinstance(gradient, LinearGradient):
        places = {"startX": gradient.x1, "startY": gradient.y1, "endX": gradient.x2, "endY": gradient.y2}
    else:
        radius = math.sqrt(gradient.rx * gradient.ry)
        places = {"centerX": gradient.cx, "centerY": gradient.cy, "gradientRadius": radius}
    kind = "linear" if isinstance(gradient, LinearGradient) else "radial"
    element = Element("gradient", _named({"type": kind, **{name: _number(value) for name, value in places.items()}}))
    for stop in gradient.stops:
        *colour, alpha = stop.colour
        values = {"offset": _number(stop.offset), "color": hex_text((alpha, *colour)).upper()}
        ElementTree.SubElement(element, "item", _named(values))
    return element


def _path_data(subpaths: list[Subpath], precision: int) -> str:
    """Return path data in steps of 10^-precision px; it ends early once it is too long.

    It has no arcs, because Android cannot read their short form.
    """
    path = PathText(precision)
    for line in subpaths:
        if len(path.text) > MOST_CHARACTERS:
            break
        cubics = line.cubics
        off = np.abs(cubics[:, 1:3] - thirds(cubics[:, 0], cubics[:, 3]))
        lines = (off < 0.1**precision / 2.0).all(axis=(1, 2))
        steps = np.rint(cubics * 10.0**precision).astype(np.int64)
        anchors = np.concatenate([steps[:, 0], steps[-1:, 3]])
        ends = [*range(1, len(anchors))]
        if line.closed and np.array_equal(anchors[-1], anchors[0]):
            ends[-1] = 0
        add_pieces(path, Ring(anchors, steps[:, 1:3], lines, np.zeros(len(anchors), bool)), ends, 0)
        if line.closed:
            path.close()
    return path.text


def _named(values: dict[str, str]) -> dict[str, str]:
    return {f"android:{name}": value for name, value in values.items()}


def _number(value: float) -> str:
    """Return decimal text with a digit before the point, as in Android's files."""
    return f"{value:.6f}".rstrip("0").rstrip(".")
