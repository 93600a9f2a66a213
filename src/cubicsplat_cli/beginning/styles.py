"""What a shape looks like: attributes, `style=`, and style sheets whose rules name a class, an id or an element."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from xml.etree import ElementTree

_RULE = re.compile(r"([^{}]+)\{([^{}]*)\}")
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_SELECTOR = re.compile(r"([\w-]+|\*)?(?:([.#])([\w-]+))?")
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(px|in|cm|mm|Q|pt|pc|em|ex|%)?\s*")
# px of each unit (CSS has 96 to the inch; text of 16 px).
_UNITS = {
    "in": 96.0,
    "cm": 96 / 2.54,
    "mm": 96 / 25.4,
    "Q": 24 / 25.4,
    "pt": 96 / 72,
    "pc": 16.0,
    "em": 16.0,
    "ex": 8.0,
}
INHERITED = {
    "fill": "black", "fill-opacity": "1", "fill-rule": "nonzero", "stroke": "none", "stroke-width": "1",
    "stroke-opacity": "1", "stroke-linecap": "butt", "stroke-linejoin": "miter", "stroke-miterlimit": "4",
    "stroke-dasharray": "none", "color": "black", "visibility": "visible",
}  # fmt: skip
_OWN = ("opacity", "display", "clip-path", "mask", "filter")
PROPERTIES = (*INHERITED, *_OWN)
Rgba = tuple[float, float, float, float]


class Sheet:
    """The rules of all style sheets of a document; of those that say more than one name, how many there are."""

    def __init__(self, root: ElementTree.Element, left_out: Counter[str]) -> None:
        self._rules: list[tuple[int, str, str, str, dict[str, str]]] = []
        for element in root.iter():
            if element.tag.rpartition("}")[2] == "style":
                self._read(_COMMENT.sub("", "".join(element.itertext())), left_out)
        self._rules.sort(key=lambda rule: rule[0])

    def _read(self, text: str, left_out: Counter[str]) -> None:
        for selectors, body in _RULE.findall(text):
            for selector in selectors.split(","):
                match = _SELECTOR.fullmatch(selector.strip())
                if match is None or not match[0]:
                    left_out["style rule"] += 1
                    continue
                strength = {".": 1, "#": 2}.get(match[2], 0)
                self._rules.append((strength, match[1] or "*", match[2] or "", match[3] or "", declarations(body)))

    def of(self, name: str, attributes: Mapping[str, str]) -> dict[str, str]:
        """What the rules say of an element."""
        classes = attributes.get("class", "").split()
        found: dict[str, str] = {}
        for _, element, kind, value, said in self._rules:
            named = not kind or (value in classes if kind == "." else value == attributes.get("id"))
            if named and element in ("*", name):
                found |= said
        return found


def declarations(text: str) -> dict[str, str]:
    """`fill: red; stroke: none` as values by name."""
    pairs = (part.partition(":") for part in text.split(";"))
    return {name.strip(): value.replace("!important", "").strip() for name, _, value in pairs if value.strip()}


def length(text: str, whole: float) -> float:
    """A length in px; a share is of `whole`. Raises ValueError for what is none."""
    match = _NUMBER.fullmatch(text)
    if match is None or not math.isfinite(float(match[1])):
        raise ValueError(f"{text!r} is no length")
    return float(match[1]) * (whole / 100.0 if match[2] == "%" else _UNITS.get(match[2], 1.0))


def share(text: str) -> float:
    """A number or a percentage, cut to 0..1; ValueError for what is neither."""
    value = length(text, 1.0)
    return min(1.0, max(0.0, value))


def colour(text: str, current: str) -> Rgba | None:
    """sRGB and opacity in 0..1; None for no paint. Raises ValueError for what is no colour."""
    from PIL import ImageColor

    lowered = text.strip().lower()
    if lowered == "currentcolor":
        return colour("black" if current.strip().lower() == "currentcolor" else current, "black")
    if lowered in ("none", "transparent", "context-fill", "context-stroke"):
        return None
    match = re.fullmatch(r"(rgb|hsl)a?\(([^)]*)\)", lowered)
    opacity = 1.0
    if match is not None:
        parts = match[2].replace(",", " ").replace("/", " ").split()
        opacity = share(parts[3]) if len(parts) > 3 else 1.0
        lowered = f"{match[1]}({','.join(parts[:3])})"
    channels = ImageColor.getrgb(lowered)
    if len(channels) > 3:
        opacity = channels[3] / 255.0
    return channels[0] / 255.0, channels[1] / 255.0, channels[2] / 255.0, opacity
