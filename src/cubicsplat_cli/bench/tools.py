"""The tools that are compared: each makes an SVG of a picture."""

from __future__ import annotations

import importlib
import importlib.util
import io
import shutil
import subprocess
from collections.abc import Callable, Sequence
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np
from PIL import Image

from cubicsplat_cli.errors import UsageError

PHOTO_CURVES = 64
DIFFVG_CURVES = 256
_POTRACE_SECONDS = 600
# Of vtracer, from few large shapes to many small ones; without any it is as its authors meant it.
VTRACER_SETTINGS: dict[str, dict[str, Any]] = {
    "coarse": {"filter_speckle": 16, "color_precision": 4, "layer_difference": 48},
    "usual": {},
    "fine": {"filter_speckle": 2, "color_precision": 8, "layer_difference": 8},
    "finest": {"filter_speckle": 1, "color_precision": 8, "layer_difference": 2},
}

Tool = Callable[[np.ndarray], bytes]


def chosen_tools(names: Sequence[str]) -> dict[str, Tool]:
    """The tools of these names, in this order; `photo` is the style for photos, `ours` the one for artwork.

    Raises UsageError for a name that is none, and for a tool that is not installed.
    """
    if not names or not set(names) <= set(TOOLS):
        raise UsageError(f"--tools must be of {', '.join(TOOLS)}, with commas between them, not {','.join(names)!r}")
    for name in names:
        if (missing := missing_piece(name)) is not None:
            raise UsageError(f"{missing}, or leave it out of --tools")
    return {name: TOOLS[name] for name in dict.fromkeys(names)}


def missing_piece(name: str) -> str | None:
    """What a tool lacks here, and how to get it; None where it can run."""
    if name == "vtracer" and importlib.util.find_spec("vtracer") is None:
        return "vtracer cannot be imported; pip install vtracer"
    if name == "potrace" and shutil.which("potrace") is None:
        return "there is no potrace; apt-get install potrace"
    if name == "diffvg" and importlib.util.find_spec("pydiffvg") is None:
        return "pydiffvg cannot be imported; build it from its authors' repository"
    return None


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


def vtracer_svg(pixels: np.ndarray, **settings: Any) -> bytes:
    """By VTracer. pixels: (H, W, 4) uint8, straight. settings: as its function takes them."""
    vtracer: ModuleType = importlib.import_module("vtracer")
    svg: str = vtracer.convert_raw_image_to_svg(_encoded(pixels, "PNG"), img_format="png", **settings)
    return svg.encode()


def potrace_svg(pixels: np.ndarray) -> bytes:
    """By potrace, which knows black and white alone: what is darker than the middle, over white, is black."""
    alpha = pixels[..., 3:] / 255.0
    grey = (pixels[..., :3] * alpha + 255.0 * (1.0 - alpha)) @ np.array([0.2126, 0.7152, 0.0722])
    bitmap = _encoded(grey >= 127.5, "PPM")
    command = ["potrace", "--svg", "--output", "-", "-"]
    svg = subprocess.run(command, input=bitmap, capture_output=True, check=True, timeout=_POTRACE_SECONDS).stdout
    # It draws the black alone.
    opaque = bool((alpha == 1.0).all())
    return svg.replace(b"<g ", b'<rect width="100%" height="100%" fill="#fff"/><g ', 1) if opaque else svg


def _diffvg(pixels: np.ndarray) -> bytes:
    """By diffvg, with 256 curves."""
    from cubicsplat_cli.bench.diffvg import diffvg_svg

    return diffvg_svg(pixels, DIFFVG_CURVES)


def _encoded(pixels: np.ndarray, form: str) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, form)
    return buffer.getvalue()


TOOLS: dict[str, Tool] = {
    "ours": _ours,
    "photo": _photo,
    "vtracer": vtracer_svg,
    "potrace": potrace_svg,
    "diffvg": _diffvg,
}


def peers(names: Sequence[str]) -> dict[tuple[str, str], Tool]:
    """Those of other people, by name and setting, with every setting that they are measured at."""
    found: dict[tuple[str, str], Tool] = {}
    for name in names:
        if name == "vtracer":
            found |= {(name, setting): partial(vtracer_svg, **given) for setting, given in VTRACER_SETTINGS.items()}
        else:
            setting = "black and white" if name == "potrace" else f"{DIFFVG_CURVES} curves"
            found[name, setting] = TOOLS[name]
    return found


PEERS = ("vtracer", "potrace", "diffvg")
