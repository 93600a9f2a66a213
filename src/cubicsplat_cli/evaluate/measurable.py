"""Pictures too large to measure as they are."""

from __future__ import annotations

import math

from cubicsplat_cli.evaluate.rerender import MAX_SIDE
from cubicsplat_cli.files.load import Picture, resize_picture

# SSIM takes some 50 bytes a pixel: with this many, under 2 GB.
MAX_MEASURED_PIXELS = 2**25


def measurable(picture: Picture) -> Picture:
    """The picture, scaled down where no renderer could draw it or measuring it would take too much memory."""
    longer, shorter = max(picture.width, picture.height), min(picture.width, picture.height)
    limit = min(MAX_SIDE, longer)
    if longer * shorter > MAX_MEASURED_PIXELS:
        limit = min(limit, math.floor(longer * math.sqrt(MAX_MEASURED_PIXELS / (longer * shorter))))
    return resize_picture(picture, limit)
