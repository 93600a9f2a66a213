"""Animated SVGs of curves, read back: what a viewer makes of the files of `write_clip`."""

from __future__ import annotations

import re
from decimal import Decimal
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.motion.tracks import OPACITY_DECIMALS
from cubicsplat_cli.settings import Mode, width_decimals
from cubicsplat_cli.svg.elements import SVG
from cubicsplat_cli.svg.moving import COLOUR, OFFSET, OPACITY, SHAPE, WIDTH, GridClip, GridGroup, GridTrack
from cubicsplat_cli.svg.paths import subpaths
from cubicsplat_cli.svg.scene_reader import control_points
from cubicsplat_cli.svg.values import NUMBERS, hex_colour

_KEY_DECIMALS = 12  # of times that are read; evenly spaced knots are written without times
_SCALE = re.compile(r"scale\(\.(0{0,5})1\)")


def read_clip(text: str) -> GridClip:
    """The clip of a file that `write_clip` wrote."""
    root = ElementTree.fromstring(text.encode())
    groups = root.findall(f"{SVG}g")
    scale = _SCALE.fullmatch(groups[0].get("transform", ""))
    precision = 0 if scale is None else len(scale[1]) + 1
    mode = Mode.OPEN if groups[0].get("fill") == "none" else Mode.CLOSED
    animated = [*root.iter(f"{SVG}animate"), *root.iter(f"{SVG}animateTransform")]
    durations = {Decimal(each.attrib["dur"].removesuffix("s")) for each in animated}
    assert len(durations) < 2, "all animations last as long as the clip"
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
    """The start and end of the display of a group, s."""
    display = group.find(f"{SVG}animate")
    if display is None:
        return 0.0, clip.duration
    keys = [float(key) * clip.duration for key in display.attrib["keyTimes"].split(";")]
    shown = display.attrib["values"].split(";").index("inline")
    return keys[shown], keys[shown + 1] if shown + 1 < len(keys) else clip.duration


def _curve(path: ElementTree.Element, clip: GridClip) -> dict[str, GridTrack]:
    moving = {each.attrib["attributeName"]: each for each in path}
    paint = "fill" if clip.mode is Mode.CLOSED else "stroke"
    decimals = width_decimals(clip.precision) - clip.precision

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
        WIDTH: track("stroke-width", "0", lambda text: [_whole(text, decimals)]),
    }


def _keys(element: ElementTree.Element, count: int, clip: GridClip) -> list[int]:
    if "keyTimes" not in element.attrib:
        return np.rint(np.linspace(0, 10**clip.key_decimals, count)).astype(int).tolist()
    return [_whole(key, clip.key_decimals) for key in element.attrib["keyTimes"].split(";")]


def _whole(text: str, decimals: int) -> int:
    return int(Decimal(text).scaleb(decimals).to_integral_value())


def _points(d: str, mode: Mode) -> list[int]:
    """The coordinates of the control points of a path of one ring of cubics."""
    (ring,) = subpaths(d)
    return [int(value) for point in control_points(ring, mode) for value in point]
