"""A clip as one SVG 1.1 document that SMIL animates: no script, and its first frame for viewers that stand still."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from cubicsplat_cli.scene.moving import OPACITY_DECIMALS
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.markup import comment_text, format_number, joined, short_colour, xml_text
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
from cubicsplat_cli.svg.scene_writer import BACKGROUND_ID

_ESCAPED = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})


def write_clip(clip: GridClip, *, title: str = "", comment: str = "", plays: int = 0) -> str:
    """The SVG text of a clip: a path for each curve, back to front, and in it what changes.

    Nothing is written of what does not. plays: how often the clip is shown, 0 for ever; it ends with its last frame.
    Values are linear between knots. A group of frames after a cut is a <g> that is displayed in its time.
    """
    size = f'width="{clip.width}" height="{clip.height}"'
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {clip.width} {clip.height}">',
        f"<!--{comment_text(comment)}-->",
        f"<title>{xml_text(title).translate(_ESCAPED)}</title>",
    ]
    if clip.background is not None:
        lines.append(f'<rect id="{BACKGROUND_ID}" {size} fill="{short_colour(*clip.background)}"/>')
    for index, group in enumerate(clip.groups):
        lines += _group(clip, group, index, plays)
    return "\n".join([*lines, "</svg>", ""])


def _group(clip: GridClip, group: GridGroup, index: int, plays: int) -> Iterator[str]:
    paint = ' fill-rule="nonzero"'
    if clip.mode is Mode.OPEN:
        paint = ' fill="none" stroke-linecap="round" stroke-linejoin="round"'
    scale = f' transform="scale({format_number(1, clip.precision)})"' if clip.precision else ""
    hidden = ' display="none"' if index else ""
    yield f"<g{paint}{scale}{hidden}>"
    if len(clip.groups) > 1:
        yield _display(clip, index, plays)
    timing = _Timing(clip, group, plays)
    for curve in reversed(group.curves):
        yield _path(clip, curve, timing, still=index == 0)
    yield "</g>"


def _display(clip: GridClip, index: int, plays: int) -> str:
    """The element that shows a group in its time and hides it in that of the others."""
    ends = [round(group.end / clip.key_s) for group in clip.groups[:-1]]
    keys, values = [0], ["none" if index else "inline"]
    if index:
        keys, values = [*keys, ends[index - 1]], [*values, "inline"]
    if index < len(ends):
        keys, values = [*keys, ends[index]], [*values, "none"]
    times = ";".join(format_number(key, clip.key_decimals) for key in keys)
    return (
        f'<animate attributeName="display" calcMode="discrete" values="{";".join(values)}" keyTimes="{times}"'
        f"{_attributes(repeated(clip.duration, plays))}/>"
    )


def _seconds(value: float) -> str:
    return format_number(round(value * 10**TIME_DECIMALS), TIME_DECIMALS) + "s"


def repeated(duration: float, plays: int) -> dict[str, str]:
    """The attributes of duration and repetition; what ends stays as it is then. plays: 0 for ever."""
    count = {} if plays == 1 else {"repeatCount": str(plays or "indefinite")}
    return {"dur": _seconds(duration), **count, **({"fill": "freeze"} if plays else {})}


def _attributes(attributes: dict[str, str]) -> str:
    return "".join(f' {name}="{value}"' for name, value in attributes.items())


class _Timing:
    """The times of the knots of a group, as attributes."""

    def __init__(self, clip: GridClip, group: GridGroup, plays: int) -> None:
        self._clip, self._whole = clip, 10**clip.key_decimals
        # What belongs to a later group began its last round before the clip did, and so has one more.
        later = group.begin > 0.0
        self._begin = f' begin="{_seconds(group.begin - clip.duration)}"' if later else ""
        self._repeated = _attributes(repeated(clip.duration, plays + 1 if later and plays else plays))

    def attributes(self, track: GridTrack, values: Sequence[str]) -> str:
        """` values="..." keyTimes="..." begin="..." dur="..." ...`."""
        keys, texts = track.keys.tolist(), [*values]
        if keys[-1] < self._whole:
            # A path of values ends when its round does.
            keys, texts = [*keys, self._whole], [*texts, texts[-1]]
        even = np.rint(np.linspace(0, self._whole, len(keys))).astype(int).tolist()
        times = "" if keys == even else ";".join(format_number(key, self._clip.key_decimals) for key in keys)
        return f' values="{";".join(texts)}"' + (f' keyTimes="{times}"' if times else "") + self._begin + self._repeated


def _path(clip: GridClip, curve: dict[str, GridTrack], timing: _Timing, *, still: bool) -> str:
    """One curve. still: whether it belongs to the first frame, which viewers show that know no animation."""
    paint = "fill" if clip.mode is Mode.CLOSED else "stroke"
    texts = {
        paint: (COLOUR, [short_colour(*colour) for colour in curve[COLOUR].values.tolist()]),
        f"{paint}-opacity": (OPACITY, _numbers(curve[OPACITY], OPACITY_DECIMALS)),
        "d": (SHAPE, path_values(curve[SHAPE].values, closed=clip.mode is Mode.CLOSED)),
    }
    if clip.mode is Mode.OPEN:
        texts["stroke-width"] = (WIDTH, _numbers(curve[WIDTH], clip.width_decimals - clip.precision))
    attributes, children = "", ""
    for name, (track, values) in texts.items():
        moves = len(values) > 1
        if (still or not moves) and not (name.endswith("-opacity") and values[0] == "1" and not moves):
            attributes += f' {name}="{values[0]}"'
        if moves:
            children += f'<animate attributeName="{name}"{timing.attributes(curve[track], values)}/>'
    if len(curve[OFFSET].keys) > 1:
        moved = timing.attributes(curve[OFFSET], [joined(offset) for offset in curve[OFFSET].values.tolist()])
        children += f'<animateTransform attributeName="transform" type="translate"{moved}/>'
    return f"<path{attributes}>{children}</path>" if children else f"<path{attributes}/>"


def _numbers(track: GridTrack, decimals: int) -> list[str]:
    return [format_number(value, decimals) for value in track.values[:, 0].tolist()]


def path_values(points: np.ndarray, *, closed: bool) -> list[str]:
    """Path data of one curve at its knots, (k, 2 K) int64, all of one structure, as SMIL needs to go from one to the
    next: each segment is relative in all of them, or in none, whichever is shorter.
    """
    points = points.reshape(len(points), -1, 2)
    segments = points.shape[1] // 3
    texts = ["M" + joined(start) for start in points[:, 0].tolist()]
    before = ""
    for segment in range(segments):
        ends = (3 * segment + np.array([1, 2, 3])) % points.shape[1] if closed else 3 * segment + np.array([1, 2, 3])
        absolute = points[:, ends]
        relative = absolute - points[:, 3 * segment, None]
        forms = {
            "c": [joined(numbers) for numbers in relative.reshape(len(points), -1).tolist()],
            "C": [joined(numbers) for numbers in absolute.reshape(len(points), -1).tolist()],
        }
        sizes = {letter: sum(map(len, form)) - (letter == before) for letter, form in forms.items()}
        letter = min(sizes, key=lambda each: sizes[each])
        for index, numbers in enumerate(forms[letter]):
            separator = letter if letter != before else "" if numbers[0] == "-" else " "
            texts[index] += separator + numbers
        before = letter
    return [text + ("z" if closed else "") for text in texts]
