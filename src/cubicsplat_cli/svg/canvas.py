"""The canvas that the root element of our files declares."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from cubicsplat_cli.errors import InputError

_PIXELS = re.compile(r"[1-9]\d{0,6}")


def canvas_size(attributes: Mapping[str, str], foreign: Callable[[str], InputError]) -> tuple[int, int]:
    """Width and height in px. Raises what `foreign` makes of the reason where the file is none of ours."""
    width, height = attributes.get("width", ""), attributes.get("height", "")
    if not (_PIXELS.fullmatch(width) and _PIXELS.fullmatch(height)):
        raise foreign("needs width and height in whole pixels")
    if attributes.get("viewBox") != f"0 0 {width} {height}":
        raise foreign("needs a viewBox equal to its width and height")
    return int(width), int(height)
