"""The tools that are compared: each makes an SVG of a picture."""

from __future__ import annotations

import importlib
from collections.abc import Callable

import numpy as np

from cubicsplat_cli.errors import UsageError

PHOTO_CURVES = 64

Tool = Callable[[np.ndarray], bytes]


def chosen_tools(names: list[str]) -> dict[str, Tool]:
    """The tools of these names, in this order.

    Raises UsageError for a name that is none, and for a tool whose package is not installed.
    """
    if not names or not set(names) <= set(TOOLS):
        raise UsageError(f"--tools must be of {', '.join(TOOLS)}, with commas between them, not {','.join(names)!r}")
    if "vtracer" in names:
        _vtracer()
    return {name: TOOLS[name] for name in dict.fromkeys(names)}


def _ours(pixels: np.ndarray) -> bytes:
    """The artwork style as it is without options."""
    from cubicsplat_cli.artwork.vectorize import draw
    from cubicsplat_cli.files.convert import as_picture
    from cubicsplat_cli.svg.drawing import write_drawing

    drawing = draw(as_picture(pixels).target())
    return write_drawing(drawing, title="drawing.png", comment="bench artwork").encode()


def _photo(pixels: np.ndarray) -> bytes:
    """The photo style with 64 curves."""
    from cubicsplat_cli.api import vectorize

    return vectorize(pixels, style="photo", curves=PHOTO_CURVES, measure=False).svg.encode()


def _vtracer_svg(pixels: np.ndarray) -> bytes:
    """VTracer as it is without options."""
    height, width = pixels.shape[:2]
    rgba = [tuple(colour) for colour in pixels.reshape(-1, 4).tolist()]
    return _vtracer().convert_pixels_to_svg(rgba, (width, height)).encode()


def _vtracer():  # type: ignore[no-untyped-def]
    try:
        return importlib.import_module("vtracer")
    except ImportError as error:
        raise UsageError(
            f"vtracer cannot be imported ({error}); pip install vtracer, or leave it out of --tools"
        ) from error


TOOLS: dict[str, Tool] = {"ours": _ours, "photo": _photo, "vtracer": _vtracer_svg}
