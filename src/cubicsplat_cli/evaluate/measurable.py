"""Pictures too large to measure as they are, or in the time that is left."""

from __future__ import annotations

import math

from cubicsplat_cli.evaluate.rerender import MAX_SIDE
from cubicsplat_cli.files.load import Picture, resize_picture

# A drawing of so many takes 4 bytes each, the picture 12.
MAX_MEASURED_PIXELS = 2**25
# What drawing, measuring and writing the PNG may take on a slow machine: measured 0.15 s a megapixel on two cores of
# 2.5 GHz; importing the renderer. A smaller copy is made of every pixel.
_SECONDS_PER_PIXEL, _SECONDS_BEFORE, _SECONDS_PER_COPIED = 0.3e-6, 0.3, 0.05e-6
# Takes no time to speak of, so it is measured whatever time is left.
_LEAST_PIXELS = 2**18


def seconds_to_measure(picture: Picture) -> float:
    """What drawing and measuring an SVG of the picture takes, at the most."""
    return _SECONDS_BEFORE + _SECONDS_PER_PIXEL * min(picture.width * picture.height, MAX_MEASURED_PIXELS)


def measurable(picture: Picture, seconds: float = math.inf) -> Picture:
    """The picture, scaled down where no renderer could draw it, or where memory or so many seconds do not suffice."""
    longer, shorter = max(picture.width, picture.height), min(picture.width, picture.height)
    pixels, most = longer * shorter, MAX_MEASURED_PIXELS
    if seconds < seconds_to_measure(picture):
        spent = _SECONDS_BEFORE + _SECONDS_PER_COPIED * pixels
        most = min(most, max(_LEAST_PIXELS, math.floor((seconds - spent) / _SECONDS_PER_PIXEL)))
    limit = min(MAX_SIDE, longer)
    if pixels > most:
        limit = min(limit, math.floor(longer * math.sqrt(most / pixels)))
    return resize_picture(picture, max(1, limit))
