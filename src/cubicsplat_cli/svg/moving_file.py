"""Animated SVGs: moving curves, and drawings whose shapes are shown, hidden and moved.

SMIL animates them, without a script; viewers that do not know it show the first frame.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.artwork.geometry.steps import suggested_precision
from cubicsplat_cli.artwork.moving import MovingDrawing
from cubicsplat_cli.motion.tracks import OPACITY_DECIMALS
from cubicsplat_cli.settings import Mode, width_decimals
from cubicsplat_cli.svg.drawing_writer import elements_of
from cubicsplat_cli.svg.elements import SVG
from cubicsplat_cli.svg.markup import empty_document, format_number, joined, short_colour, titled
from cubicsplat_cli.svg.moving import COLOUR, OFFSET, OPACITY, SHAPE, TIME_DECIMALS, WIDTH, GridClip, GridTrack
from cubicsplat_cli.svg.scene_writer import BACKGROUND_ID, GROUP_STYLES, path_values

Attributes = dict[str, str]
_DISPLAY, _MOVE = "display", "transform"
_SHOWN, _MOVED = {"attributeName": _DISPLAY}, {"attributeName": _MOVE, "type": "translate"}
_OF_A_FRAME = 0.01  # by which a change of a drawing may be early or late


def write_clip(clip: GridClip, *, title: str = "", comment: str = "", plays: int = 0) -> str:
    """Return the SVG text of a clip: a path for each curve, back to front, that holds what changes.

    plays: how often the clip is shown, 0 for ever; it ends with its last frame. Values are linear between knots. Each
    group of frames between cuts is a <g> that is displayed in its time.
    """
    root = empty_document(clip.width, clip.height)
    if clip.background is not None:
        box = {"id": BACKGROUND_ID, "width": str(clip.width), "height": str(clip.height)}
        ElementTree.SubElement(root, "rect", {**box, "fill": short_colour(*clip.background)})
    scale = {"transform": f"scale({format_number(1, clip.precision)})"} if clip.precision else {}
    shared = GROUP_STYLES[clip.mode] | scale
    begins = ["0", *(format_number(round(group.end / clip.key_s), clip.key_decimals) for group in clip.groups[:-1])]
    for index, group in enumerate(clip.groups):
        parent = ElementTree.SubElement(root, "g", shared | ({_DISPLAY: "none"} if index else {}))
        shown = ["inline" if number == index else "none" for number in range(len(clip.groups))]
        _add_steps(parent, _SHOWN, shown, begins, _repeated(clip.duration, plays))
        # A later group began its last round before the clip did, so it has one more.
        later = group.begin > 0.0
        timing = {"begin": _seconds(group.begin - clip.duration)} if later else {}
        timing |= _repeated(clip.duration, plays + 1 if later and plays else plays)
        parent.extend(_path(clip, curve, timing, still=index == 0) for curve in reversed(group.curves))
    return titled(root, title, comment).replace(" />", "/>")


def _seconds(value: float) -> str:
    return format_number(round(value * 10**TIME_DECIMALS), TIME_DECIMALS) + "s"


def _repeated(duration: float, plays: int) -> dict[str, str]:
    """Return the attributes of duration and repetition; what ends stays as it is then. plays: 0 for ever."""
    count = {} if plays == 1 else {"repeatCount": str(plays or "indefinite")}
    return {"dur": _seconds(duration), **count, **({"fill": "freeze"} if plays else {})}


def _add_animation(
    element: ElementTree.Element, target: Attributes, values: Sequence[str], times: Sequence[str], timing: Attributes
) -> None:
    """Add an animation of an attribute. times: of the values, in shares of the duration; empty: evenly spaced."""
    keys = {"keyTimes": ";".join(times)} if times else {}
    tag = "animateTransform" if "type" in target else "animate"
    ElementTree.SubElement(element, tag, {**target, "values": ";".join(values), **keys, **timing})


def _add_steps(
    element: ElementTree.Element, target: Attributes, values: Sequence[str], times: Sequence[str], timing: Attributes
) -> None:
    """Add an animation that changes an attribute at once where a value differs from the one before, if any does."""
    changes = [0, *(place for place in range(1, len(values)) if values[place] != values[place - 1])]
    if len(changes) > 1:
        chosen, begins = ([texts[place] for place in changes] for texts in (values, times))
        _add_animation(element, {**target, "calcMode": "discrete"}, chosen, begins, timing)


def _path(clip: GridClip, curve: dict[str, GridTrack], timing: dict[str, str], *, still: bool) -> ElementTree.Element:
    """Return one curve. still: whether it belongs to the first frame, which viewers without animation show."""
    paint = "fill" if clip.mode is Mode.CLOSED else "stroke"
    shapes = curve[SHAPE].values.reshape(len(curve[SHAPE].keys), -1, 2)
    texts = {
        paint: (COLOUR, [short_colour(*colour) for colour in curve[COLOUR].values.tolist()]),
        f"{paint}-opacity": (OPACITY, _numbers(curve[OPACITY], OPACITY_DECIMALS)),
        "d": (SHAPE, path_values(shapes.tolist(), closed=clip.mode is Mode.CLOSED)),
    }
    if clip.mode is Mode.OPEN:
        texts["stroke-width"] = (WIDTH, _numbers(curve[WIDTH], width_decimals(clip.precision) - clip.precision))
    element = ElementTree.Element("path")
    for name, (_, values) in texts.items():
        if still if len(values) > 1 else not (name.endswith("-opacity") and values == ["1"]):
            element.set(name, values[0])
    texts[_MOVE] = (OFFSET, [joined(offset) for offset in curve[OFFSET].values.tolist()])
    for name, (track, values) in texts.items():
        if len(values) > 1:
            keys, even = curve[track].times(clip.whole)
            values += values[-1:] * (len(keys) - len(values))
            times = [] if even else [format_number(key, clip.key_decimals) for key in keys.tolist()]
            _add_animation(element, _MOVED if name == _MOVE else {"attributeName": name}, values, times, timing)
    return element


def _numbers(track: GridTrack, decimals: int) -> list[str]:
    return [format_number(value, decimals) for value in track.values[:, 0].tolist()]


def write_moving_drawing(
    moving: MovingDrawing, begins: np.ndarray, duration: float, *, title: str = "", comment: str = "", plays: int = 0
) -> str:
    """Return the SVG text of a moving drawing. begins: (F,) of the frames, s from the start. plays: 0 for ever.

    Each shape is one element, in the order of the drawing, at its first place. Animations show, hide and move it.
    """
    drawing = moving.drawing
    precision = suggested_precision(drawing.width, drawing.height)
    named = tuple(replace(shape, name=f"s{index}", group="") for index, shape in enumerate(drawing.shapes))
    # Shapes that abut get an element each, whatever their colour.
    still = replace(drawing, shapes=named, abutting=True)
    root = elements_of(still, precision)
    shortest = float(np.diff(np.append(begins, duration)).min())
    decimals = max(1, math.ceil(math.log10(0.5 * duration / (_OF_A_FRAME * shortest))))
    keys = np.rint(begins / duration * 10**decimals).astype(int).tolist()
    times = [format_number(key, decimals) for key in keys]
    ending = _repeated(duration, plays)
    for index in range(len(named)):
        element = root.find(f".//*[@id='s{index}']")
        if element is None:  # smaller than the grid
            continue
        del element.attrib["id"]
        shown = ["inline" if each else "none" for each in moving.shown[:, index]]
        moves = _offsets(moving, index, precision)
        if len(set(moves)) > 1 and _MOVE in element.attrib:
            # Its own transform stays with it; a group around it moves and hides.
            inner, element = element, ElementTree.Element("g")
            root[[*root].index(inner)] = element
            element.append(inner)
        if shown[0] == "none":
            element.set(_DISPLAY, "none")
        for attributes, values in ((_SHOWN, shown), (_MOVED, moves)):
            _add_steps(element, attributes, values, times, ending)
    return titled(root, title, comment).replace(" />", "/>")


def _offsets(moving: MovingDrawing, index: int, precision: int) -> list[str]:
    """Return the translation of a shape at each frame; a hidden shape has that of the frame before, or after."""
    frames = np.flatnonzero(moving.shown[:, index])
    latest = frames[np.clip(np.searchsorted(frames, np.arange(len(moving.shown)), side="right") - 1, 0, None)]
    steps = np.rint(moving.offsets[latest, index] * 10**precision).astype(int)
    return [" ".join(format_number(value, precision) for value in step) for step in steps.tolist()]


def still(text: str, seconds: float) -> str:
    """Return the SVG that a file of `write_moving_drawing` shows at a time, s, without what is hidden or animates."""
    root = ElementTree.fromstring(text)
    for parent in [*root.iter()]:
        for element in [*parent]:
            for animation in [each for each in element if each.tag.startswith(f"{SVG}animate")]:
                given = animation.attrib
                share = seconds / float(given["dur"].removesuffix("s"))
                latest = bisect_right([*map(float, given["keyTimes"].split(";"))], share + 1e-9) - 1
                value, name = given["values"].split(";")[latest], given["attributeName"]
                element.set(name, value if name == _DISPLAY else f"translate({value})")
                element.remove(animation)
            if element.attrib.pop(_DISPLAY, "") == "none":
                parent.remove(element)
    return ElementTree.tostring(root, encoding="unicode")
