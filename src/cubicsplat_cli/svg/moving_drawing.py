"""The drawing of a flat clip as an SVG in which SMIL shows, hides and moves shapes; and its frames as still SVGs."""

from __future__ import annotations

import math
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.artwork.geometry.steps import suggested_precision
from cubicsplat_cli.artwork.moving import MovingDrawing
from cubicsplat_cli.svg.drawing_writer import write_drawing
from cubicsplat_cli.svg.elements import SVG
from cubicsplat_cli.svg.markup import document, format_number
from cubicsplat_cli.svg.moving_file import repeated

_DISPLAY, _MOVE = "display", "transform"
_OF_A_FRAME = 0.01  # by which a change may be early or late


def write_moving_drawing(
    moving: MovingDrawing,
    begins: np.ndarray,
    duration: float,
    *,
    title: str = "",
    comment: str = "",
    plays: int = 0,
) -> str:
    """The SVG text. begins: (F,) s from the start. duration: s. plays: 0 for ever.

    Each shape is one element, in the order of all shapes; it is where it was drawn first, and shown and moved by
    animations that change it at once. Viewers that know none show the first frame.
    """
    drawing = moving.drawing
    precision = suggested_precision(drawing.width, drawing.height)
    named = tuple(replace(shape, name=f"s{index}", group="") for index, shape in enumerate(drawing.shapes))
    # Each shape shall be an element of its own, whatever its colour.
    text = write_drawing(
        replace(drawing, shapes=named, abutting=True), precision=precision, title=title, comment=comment
    )
    ElementTree.register_namespace("", SVG[1:-1])
    root = ElementTree.fromstring(text, ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True)))
    shortest = float(np.diff(np.append(begins, duration)).min())
    decimals = max(1, math.ceil(math.log10(0.5 * duration / (_OF_A_FRAME * shortest))))
    keys = np.rint(begins / duration * 10**decimals).astype(int).tolist()
    ending = repeated(duration, plays)
    for index in range(len(named)):
        element = root.find(f".//*[@id='s{index}']")
        if element is None:  # smaller than the grid
            continue
        del element.attrib["id"]
        shown = ["inline" if each else "none" for each in moving.shown[:, index]]
        moves = _offsets(moving, index, precision)
        if shown[0] == "none":
            element.set(_DISPLAY, "none")
        tracks = [("animate", {"attributeName": _DISPLAY}, shown)]
        tracks.append(("animateTransform", {"attributeName": _MOVE, "type": "translate"}, moves))
        if len(set(moves)) > 1 and _MOVE in element.attrib:
            element = _wrapped(root, element)
        for tag, attributes, values in tracks:
            changes = [0, *(place for place in range(1, len(values)) if values[place] != values[place - 1])]
            if len(changes) > 1:
                times = ";".join(format_number(keys[place], decimals) for place in changes)
                said = {**attributes, "calcMode": "discrete", "values": ";".join(values[place] for place in changes)}
                ElementTree.SubElement(element, tag, {**said, "keyTimes": times, **ending})
    return document(root).replace(" />", "/>")


def _offsets(moving: MovingDrawing, index: int, precision: int) -> list[str]:
    """The translation of a shape at each frame as text; while it is hidden that of the frame before, or after."""
    frames = np.flatnonzero(moving.shown[:, index])
    latest = frames[np.clip(np.searchsorted(frames, np.arange(len(moving.shown)), side="right") - 1, 0, None)]
    steps = np.rint(moving.offsets[latest, index] * 10**precision).astype(int)
    return [" ".join(format_number(value, precision) for value in step) for step in steps.tolist()]


def _wrapped(root: ElementTree.Element, element: ElementTree.Element) -> ElementTree.Element:
    """A group around an element that has a transform of its own; what moves and hides is the group."""
    group = ElementTree.Element("g")
    if _DISPLAY in element.attrib:
        group.set(_DISPLAY, element.attrib.pop(_DISPLAY))
    root[[*root].index(element)] = group
    group.append(element)
    return group


def still(text: str, seconds: float) -> str:
    """The SVG that a file of `write_moving_drawing` shows at a time, s, without animations and hidden elements."""
    ElementTree.register_namespace("", SVG[1:-1])
    root = ElementTree.fromstring(text)
    for parent in [*root.iter()]:
        for element in [*parent]:
            for animation in [each for each in element if each.tag.startswith(f"{SVG}animate")]:
                value = _value(animation, seconds)
                name = animation.attrib["attributeName"]
                element.set(name, value if name == _DISPLAY else f"translate({value})")
                element.remove(animation)
            if element.get(_DISPLAY) == "none":
                parent.remove(element)
            elif _DISPLAY in element.attrib:
                del element.attrib[_DISPLAY]
    return ElementTree.tostring(root, encoding="unicode")


def _value(animation: ElementTree.Element, seconds: float) -> str:
    share = seconds / float(animation.attrib["dur"].removesuffix("s"))
    keys = [float(key) for key in animation.attrib["keyTimes"].split(";")]
    latest = max(place for place, key in enumerate(keys) if key <= share + 1e-9)
    return animation.attrib["values"].split(";")[latest]
