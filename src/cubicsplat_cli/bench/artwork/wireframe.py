"""The outlines of an SVG made visible: its curves as thin lines, with their anchors and handles."""

from __future__ import annotations

import math
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.bench.artwork.document import Document, local_name
from cubicsplat_cli.svg.pathparse import Piece, pieces
from cubicsplat_cli.svg.transforms import transform_matrix

_PRIMITIVES = {"circle", "ellipse", "rect", "line", "polygon", "polyline"}
_GEOMETRY = {"d", "points", "cx", "cy", "r", "rx", "ry", "x", "y", "width", "height", "x1", "y1", "x2", "y2"}
_CURVE, _PRIMITIVE, _HANDLE, _ANCHOR = "#1747d1", "#0a8f3c", "#e08a00", "#d11717"


def wireframe(document: Document, pixel: float) -> bytes:
    """An SVG of the document's size with all its outlines; primitives in green, handles in orange, anchors in red.

    pixel: length of one px of the picture that will be drawn, in px of the document's canvas.
    """
    unit = document.unit * pixel
    root = ElementTree.Element(document.root.tag, dict(document.root.attrib))
    for name in ("style", "fill", "stroke", "opacity"):
        root.attrib.pop(name, None)
    marks: list[ElementTree.Element] = []
    waiting = [(child, np.eye(3)) for child in document.root]
    while waiting:
        element, matrix = waiting.pop(0)
        matrix = matrix @ transform_matrix(element.get("transform", ""))
        waiting = [(child, matrix) for child in element] + waiting
        name = local_name(element)
        if name == "path" or name in _PRIMITIVES:
            root.append(_outline(element, matrix, unit))
        if name == "path":
            marks += _marks(pieces(element.get("d", "")), matrix, unit)
    root.extend(marks)
    return ElementTree.tostring(root)


def _outline(element: ElementTree.Element, matrix: np.ndarray, unit: float) -> ElementTree.Element:
    scale = math.sqrt(abs(np.linalg.det(matrix[:2, :2]))) or 1.0
    geometry = {name: value for name, value in element.attrib.items() if name in _GEOMETRY}
    colour = _PRIMITIVE if local_name(element) in _PRIMITIVES else _CURVE
    shown = {
        "fill": "none",
        "stroke": colour,
        "stroke-width": f"{unit / scale:.6g}",
        "transform": "matrix({})".format(" ".join(f"{value:.9g}" for value in matrix[:2].T.ravel())),
    }
    return ElementTree.Element(element.tag, geometry | shown)


def _marks(found: list[Piece], matrix: np.ndarray, unit: float) -> list[ElementTree.Element]:
    """Lines to the handles with a dot each, and a square at every anchor."""
    lines, dots, squares = [], [], []
    for piece in found:
        start, end, *handles = (_mapped(matrix, point) for point in (piece.start, piece.end, *piece.handles))
        squares.append(_square(end, 1.8 * unit))
        for handle, anchor in zip(handles, (start, end) if len(handles) == 2 else (start,), strict=False):
            lines.append(f"M{anchor[0]:.6g} {anchor[1]:.6g}L{handle[0]:.6g} {handle[1]:.6g}")
            dots.append(_square(handle, unit))
    return [
        _path("".join(lines), fill="none", stroke=_HANDLE, **{"stroke-width": f"{0.6 * unit:.6g}"}),
        _path("".join(dots), fill=_HANDLE),
        _path("".join(squares), fill=_ANCHOR),
    ]


def _square(middle: tuple[float, float], half: float) -> str:
    x, y = middle
    return f"M{x - half:.6g} {y - half:.6g}h{2 * half:.6g}v{2 * half:.6g}h{-2 * half:.6g}z"


def _path(d: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.Element("{http://www.w3.org/2000/svg}path", {"d": d, **attributes})


def _mapped(matrix: np.ndarray, point: tuple[float, float]) -> tuple[float, float]:
    x, y, _ = matrix @ (*point, 1.0)
    return float(x), float(y)
