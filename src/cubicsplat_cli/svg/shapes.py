"""Ellipses, rectangles and polygons of a photo as SVG elements, back from these, and as the list of Geometrize."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import as_numpy
from cubicsplat_cli.scene.shapes import lengths, nearest_shape, shape_points
from cubicsplat_cli.svg.markup import format_number
from cubicsplat_cli.svg.values import parse_number

ANGLE_DECIMALS = 2
# The attributes of each element beside its fill.
ATTRIBUTES = {
    "ellipse": ("cx", "cy", "rx", "ry", "transform"),
    "rect": ("x", "y", "width", "height", "transform"),
    "polygon": ("points",),
}
_TAGS = {"ellipse": "ellipse", "rectangle": "rect"}
_ROTATION = re.compile(r"rotate\((-?[\d.]+) [-\d.]+ [-\d.]+\)")
# The numbers that Geometrize gives to kinds of shapes.
_BACKGROUND_TYPE, GEOMETRIZE_TYPES = 0, {"rectangle": 1, "triangle": 2, "ellipse": 4}


def shape_element(kind: str, points: np.ndarray) -> tuple[str, dict[str, str]]:
    """The tag and the attributes of a shape with control points (K, 2), in whole units of the file."""
    if kind not in _TAGS:
        return "polygon", {"points": " ".join(map(str, np.rint(points[::3]).astype(int).ravel().tolist()))}
    (x, y), (a, b), degrees = _framed(kind, points)
    middle, half = (round(x), round(y)), (round(a), round(b))
    if kind == "ellipse":
        names = dict(zip(("cx", "cy", "rx", "ry"), (*middle, *half), strict=True))
    else:
        low = middle[0] - half[0], middle[1] - half[1]
        names = dict(zip(("x", "y", "width", "height"), (*low, 2 * half[0], 2 * half[1]), strict=True))
    attributes = {name: str(value) for name, value in names.items()}
    angle = format_number(round(degrees * 10**ANGLE_DECIMALS), ANGLE_DECIMALS)
    if angle != "0":
        attributes["transform"] = f"rotate({angle} {middle[0]} {middle[1]})"
    return _TAGS[kind], attributes


def points_of_element(tag: str, attributes: Mapping[str, str]) -> np.ndarray:
    """The control points (K, 2) of an element that `shape_element` gave. Raises ValueError for any other."""
    if tag == "polygon":
        vertices = np.array([parse_number(text) for text in attributes.get("points", "").split(" ")])
        if vertices.size < 6 or vertices.size % 2:
            raise ValueError("has a polygon of fewer than three points")
        return shape_points("polygon", vertices[None])[0]
    one, two, three, four = (parse_number(attributes.get(name, "")) for name in ATTRIBUTES[tag][:4])
    kind, middle, half = "ellipse", (one, two), (three, four)
    if tag == "rect":
        kind, middle, half = "rectangle", (one + three / 2.0, two + four / 2.0), (three / 2.0, four / 2.0)
    rotation = _ROTATION.fullmatch(attributes.get("transform", "rotate(0 0 0)"))
    if rotation is None or min(half) < 0.0:
        raise ValueError(f"has a <{tag}> that is none of a photo")
    turn = math.radians(float(rotation[1]))
    # A first axis of no length would have no direction.
    first = max(half[0], 1e-3)
    return shape_points(kind, np.array([[*middle, first * math.cos(turn), first * math.sin(turn), half[1]]]))[0]


def _framed(kind: str, points: np.ndarray) -> tuple[tuple[float, float], tuple[float, float], float]:
    """Middle, half axes, and degrees of the first one in [0, 180), clockwise as seen."""
    values = nearest_shape(kind, points[None].astype(np.float64))
    x, y, across, down, second = values[0].tolist()
    return (x, y), (float(lengths(values)[0, 0]), abs(second)), math.degrees(math.atan2(down, across)) % 180.0


def geometrize_list(kind: str, scene: Scene, scores: list[float], marks: Mapping[str, str]) -> str:
    """A scene as the JSON list that Geometrize reads: `type`, `data`, `color` (8-bit RGBA) and `score`, from back to
    front, the background first, which also has the marks. Coordinates are whole px, angles whole degrees.

    scores: (N + 1,) of the pictures up to each shape, the background's first.
    """
    color = _colour(scene.background or (0.0, 0.0, 0.0), float(scene.background is not None))
    ground = {"type": _BACKGROUND_TYPE, "data": [0, 0, scene.width, scene.height], "color": color}
    shapes = ({"type": GEOMETRIZE_TYPES[kind], **shape} for shape in _geometrize_shapes(kind, scene))
    items = [{**item, "score": round(score, 6)} for item, score in zip((ground, *shapes), scores, strict=True)]
    return "[\n" + ",\n".join(map(json.dumps, ({**items[0], **marks}, *items[1:]))) + "\n]\n"


def _geometrize_shapes(kind: str, scene: Scene) -> Iterator[dict[str, Any]]:
    points, colours, opacities = (as_numpy(a)[::-1] for a in (scene.points, scene.colours, scene.opacities))
    for each, colour, opacity in zip(points, colours.tolist(), opacities.tolist(), strict=True):
        if kind == "triangle":
            data = np.rint(each[::3]).astype(int).ravel().tolist()
        else:
            (x, y), (a, b), degrees = _framed(kind, each)
            box = (x - a, y - b, x + a, y + b) if kind == "rectangle" else (x, y, a, b)
            data = [round(value) for value in (*box, degrees)]
        yield {"data": data, "color": _colour(colour, opacity)}


def _colour(colour: Any, opacity: float) -> list[int]:
    return [round(255.0 * value) for value in (*colour, opacity)]
