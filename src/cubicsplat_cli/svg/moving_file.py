"""Animated SVGs: moving curves, and drawings whose shapes are shown, hidden and moved.

SMIL animates them, without a script; viewers that do not know it show the first frame. Files of curves are read back,
any other file is refused with one line. Of drawings each frame can be had as a still SVG.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from decimal import Decimal
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.artwork.geometry.steps import suggested_precision
from cubicsplat_cli.artwork.moving import MovingDrawing
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.motion.tracks import OPACITY_DECIMALS
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.drawing_writer import write_drawing
from cubicsplat_cli.svg.elements import SVG
from cubicsplat_cli.svg.markup import document, empty_document, format_number, joined, short_colour
from cubicsplat_cli.svg.moving import (
    COLOUR,
    OFFSET,
    OPACITY,
    SHAPE,
    TIME_DECIMALS,
    WIDTH,
    GridClip,
    GridGroup,
    GridTrack,
)
from cubicsplat_cli.svg.paths import subpaths
from cubicsplat_cli.svg.scene_reader import control_points
from cubicsplat_cli.svg.scene_writer import BACKGROUND_ID, path_values
from cubicsplat_cli.svg.values import NUMBERS, hex_colour

_KEY_DECIMALS = 12  # of times that are read; evenly spaced knots are written without times
_SCALE = re.compile(r"scale\(\.(0{0,5})1\)")
_DISPLAY, _MOVE = "display", "transform"
_SHOWN, _MOVED = {"attributeName": _DISPLAY}, {"attributeName": _MOVE, "type": "translate"}
_OF_A_FRAME = 0.01  # by which a change of a drawing may be early or late


def write_clip(clip: GridClip, *, title: str = "", comment: str = "", plays: int = 0) -> str:
    """Return the SVG text of a clip: a path for each curve, back to front, that holds what changes.

    plays: how often the clip is shown, 0 for ever; it ends with its last frame. Values are linear between knots. Each
    group of frames between cuts is a <g> that is displayed in its time.
    """
    root = empty_document(clip.width, clip.height, title, comment)
    if clip.background is not None:
        box = {"id": BACKGROUND_ID, "width": str(clip.width), "height": str(clip.height)}
        ElementTree.SubElement(root, "rect", {**box, "fill": short_colour(*clip.background)})
    shared = {"fill-rule": "nonzero"}
    if clip.mode is Mode.OPEN:
        shared = {"fill": "none", "stroke-linecap": "round", "stroke-linejoin": "round"}
    if clip.precision:
        shared["transform"] = f"scale({format_number(1, clip.precision)})"
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
    return document(root).replace(" />", "/>")


def _seconds(value: float) -> str:
    return format_number(round(value * 10**TIME_DECIMALS), TIME_DECIMALS) + "s"


def _repeated(duration: float, plays: int) -> dict[str, str]:
    """Return the attributes of duration and repetition; what ends stays as it is then. plays: 0 for ever."""
    count = {} if plays == 1 else {"repeatCount": str(plays or "indefinite")}
    return {"dur": _seconds(duration), **count, **({"fill": "freeze"} if plays else {})}


Attributes = dict[str, str]


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
        texts["stroke-width"] = (WIDTH, _numbers(curve[WIDTH], clip.width_decimals - clip.precision))
    element = ElementTree.Element("path")
    for name, (_, values) in texts.items():
        if still if len(values) > 1 else not (name.endswith("-opacity") and values == ["1"]):
            element.set(name, values[0])
    texts[_MOVE] = (OFFSET, [joined(offset) for offset in curve[OFFSET].values.tolist()])
    for name, (track, values) in texts.items():
        if len(values) > 1:
            keys, whole = curve[track].keys.tolist(), 10**clip.key_decimals
            if keys[-1] < whole:
                # A path of values ends when its round does.
                keys, values = [*keys, whole], [*values, values[-1]]
            even = keys == np.rint(np.linspace(0, whole, len(keys))).astype(int).tolist()
            times = [] if even else [format_number(key, clip.key_decimals) for key in keys]
            _add_animation(element, _MOVED if name == _MOVE else {"attributeName": name}, values, times, timing)
    return element


def _numbers(track: GridTrack, decimals: int) -> list[str]:
    return [format_number(value, decimals) for value in track.values[:, 0].tolist()]


def read_clip(text: str) -> GridClip:
    """Return the clip of a file that `write_clip` wrote. Raises InputError for anything else."""
    try:
        return _clip(ElementTree.fromstring(text.encode()))
    except (ElementTree.ParseError, ValueError, KeyError, IndexError, ArithmeticError, TypeError) as error:
        raise InputError(f"this SVG is no clip that cubicsplat wrote, or was edited: {error}") from error


def _clip(root: ElementTree.Element) -> GridClip:
    groups = root.findall(f"{SVG}g")
    scale = _SCALE.fullmatch(groups[0].get("transform", ""))
    precision = 0 if scale is None else len(scale[1]) + 1
    mode = Mode.OPEN if groups[0].get("fill") == "none" else Mode.CLOSED
    animated = [*root.iter(f"{SVG}animate"), *root.iter(f"{SVG}animateTransform")]
    durations = {Decimal(each.attrib["dur"].removesuffix("s")) for each in animated}
    if len(durations) > 1:
        raise ValueError("its animations last different times")
    duration = float(durations.pop()) if durations else 1.0  # where nothing changes, it does not matter
    background = root.find(f"{SVG}rect")
    colour = None if background is None else hex_colour(background.attrib["fill"])
    clip = GridClip(
        mode, int(root.attrib["width"]), int(root.attrib["height"]), precision, colour, duration, _KEY_DECIMALS, []
    )
    for group in groups:
        begin, end = _times(group, clip)
        curves = [_curve(path, clip) for path in group.findall(f"{SVG}path")]
        clip.groups.append(GridGroup(begin, end, curves[::-1]))
    return clip


def _times(group: ElementTree.Element, clip: GridClip) -> tuple[float, float]:
    """Return the start and end of the display of a group, s."""
    display = group.find(f"{SVG}animate")
    if display is None:
        return 0.0, clip.duration
    keys = [float(key) * clip.duration for key in display.attrib["keyTimes"].split(";")]
    shown = display.attrib["values"].split(";").index("inline")
    return keys[shown], keys[shown + 1] if shown + 1 < len(keys) else clip.duration


def _curve(path: ElementTree.Element, clip: GridClip) -> dict[str, GridTrack]:
    moving = {each.attrib["attributeName"]: each for each in path}
    paint = "fill" if clip.mode is Mode.CLOSED else "stroke"
    width_decimals = clip.width_decimals - clip.precision

    def track(name: str, usual: str, read: object) -> GridTrack:
        element = moving.get(name)
        texts = [path.get(name, usual)] if element is None else element.attrib["values"].split(";")
        values = np.array([read(text) for text in texts], dtype=np.int64)  # type: ignore[operator]
        keys = [0] if element is None else _keys(element, len(texts), clip)
        return GridTrack(np.array(keys, np.int64), values)

    return {
        SHAPE: track("d", "", lambda text: _points(text, clip.mode)),
        OFFSET: track("transform", "0 0", lambda text: [int(value) for value in NUMBERS.findall(text)]),
        COLOUR: track(paint, "", hex_colour),
        OPACITY: track(f"{paint}-opacity", "1", lambda text: [_whole(text, OPACITY_DECIMALS)]),
        WIDTH: track("stroke-width", "0", lambda text: [_whole(text, width_decimals)]),
    }


def _keys(element: ElementTree.Element, count: int, clip: GridClip) -> list[int]:
    if "keyTimes" not in element.attrib:
        return np.rint(np.linspace(0, 10**clip.key_decimals, count)).astype(int).tolist()
    return [_whole(key, clip.key_decimals) for key in element.attrib["keyTimes"].split(";")]


def _whole(text: str, decimals: int) -> int:
    return int(Decimal(text).scaleb(decimals).to_integral_value())


def _points(d: str, mode: Mode) -> list[int]:
    """Return the coordinates of the control points of a path of one ring of cubics."""
    (ring,) = subpaths(d)
    return [int(value) for point in control_points(ring, mode) for value in point]


def write_moving_drawing(
    moving: MovingDrawing,
    begins: np.ndarray,
    duration: float,
    *,
    title: str = "",
    comment: str = "",
    plays: int = 0,
) -> str:
    """Return the SVG text of a moving drawing. begins: (F,) of the frames, s from the start. plays: 0 for ever.

    Each shape is one element, in the order of the drawing, at its first place. Animations show, hide and move it at
    once.
    """
    drawing = moving.drawing
    precision = suggested_precision(drawing.width, drawing.height)
    named = tuple(replace(shape, name=f"s{index}", group="") for index, shape in enumerate(drawing.shapes))
    # Shapes that abut get an element each, whatever their colour.
    text = write_drawing(
        replace(drawing, shapes=named, abutting=True), precision=precision, title=title, comment=comment
    )
    root = ElementTree.fromstring(text, ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True)))
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
        if shown[0] == "none":
            element.set(_DISPLAY, "none")
        if len(set(moves)) > 1 and _MOVE in element.attrib:
            element = _wrapped(root, element)
        for attributes, values in ((_SHOWN, shown), (_MOVED, moves)):
            _add_steps(element, attributes, values, times, ending)
    return document(root).replace(" />", "/>")


def _offsets(moving: MovingDrawing, index: int, precision: int) -> list[str]:
    """Return the translation of a shape at each frame; a hidden shape has that of the frame before, or after."""
    frames = np.flatnonzero(moving.shown[:, index])
    latest = frames[np.clip(np.searchsorted(frames, np.arange(len(moving.shown)), side="right") - 1, 0, None)]
    steps = np.rint(moving.offsets[latest, index] * 10**precision).astype(int)
    return [" ".join(format_number(value, precision) for value in step) for step in steps.tolist()]


def _wrapped(root: ElementTree.Element, element: ElementTree.Element) -> ElementTree.Element:
    """Return a group around an element that has a transform of its own; the group moves and hides."""
    group = ElementTree.Element("g")
    if _DISPLAY in element.attrib:
        group.set(_DISPLAY, element.attrib.pop(_DISPLAY))
    root[[*root].index(element)] = group
    group.append(element)
    return group


def still(text: str, seconds: float) -> str:
    """Return the SVG that a file of `write_moving_drawing` shows at a time, s, without what is hidden or animates."""
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
    """Return the value of an animation in steps at a time, s."""
    share = seconds / float(animation.attrib["dur"].removesuffix("s"))
    keys = [float(key) for key in animation.attrib["keyTimes"].split(";")]
    latest = max(place for place, key in enumerate(keys) if key <= share + 1e-9)
    return animation.attrib["values"].split(";")[latest]
