"""Copies of large pictures, which a photo is fitted on."""

from __future__ import annotations

import math

from cubicsplat_cli.files.load import Picture, resize_picture
from cubicsplat_cli.settings import USUAL_CURVES, FitSettings

# The pixels for each curve of the copy on which most of a fit is done, and how much larger the sides of that are on
# which it is finished. Within 0.1 dB of a fit to the picture itself: see docs/lab/cpu.md.
ROUGH_PIXELS_PER_CURVE = 1536
FINISH_SCALE = 3


def fitted_on(picture: Picture, rough: Picture, fine: Picture) -> list[str]:
    """What the report says of copies."""
    if fine is picture and rough is picture:
        return []
    finish = "" if rough is fine else f", with the exact finish at {fine.width} x {fine.height}"
    return [f"fitted on a copy of {rough.width} x {rough.height} pixels{finish}"]


def copies_of(picture: Picture, settings: FitSettings) -> tuple[Picture, Picture]:
    """What most of a fit is done on, and what its exact finish: a large picture's copies, or the picture itself twice.

    A recipe in fractions of the canvas is a published one, and works on the picture.
    """
    if settings.recipe.length_unit == "canvas" or settings.recipe.finish == 0.0:
        return picture, picture
    rough = _with_pixels(picture, ROUGH_PIXELS_PER_CURVE * max(settings.curves, USUAL_CURVES))
    return rough, picture if rough is picture else _with_pixels(picture, FINISH_SCALE**2 * rough.width * rough.height)


def _with_pixels(picture: Picture, enough: int) -> Picture:
    """The picture, or a copy of so many pixels where it has half as many again: less would save nothing."""
    pixels = picture.width * picture.height
    if 2 * pixels <= 3 * enough:
        return picture
    return resize_picture(picture, max(1, round(max(picture.size) * math.sqrt(enough / pixels))))
