"""The tools that are compared, ours and others: each makes an SVG of a picture."""

from __future__ import annotations

import importlib
import importlib.util
import io
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from PIL import Image

from cubicsplat_cli.errors import UsageError

PHOTO_CURVES = 64
DIFFVG_CURVES = 256
DIFFVG_SEGMENTS = 4
DIFFVG_STEPS = 500
_SPREAD = 0.05  # share of the picture's side that a new curve spans
_POINT_RATE, _COLOUR_RATE = 1.0, 0.01
_GRID = 2  # samples along each side of a pixel
_POTRACE_SECONDS = 600
# Of vtracer, from few large shapes to many small ones; without any it is as its authors meant it.
VTRACER_SETTINGS: dict[str, dict[str, Any]] = {
    "coarse": {"filter_speckle": 16, "color_precision": 4, "layer_difference": 48},
    "usual": {},
    "fine": {"filter_speckle": 2, "color_precision": 8, "layer_difference": 8},
    "finest": {"filter_speckle": 1, "color_precision": 8, "layer_difference": 2},
}

Given = np.ndarray | bytes  # (H, W, 4) uint8 straight RGBA, or the bytes of a file
Tool = Callable[[Given], bytes]


def pixels_of(given: Given) -> np.ndarray:
    """(H, W, 4) uint8 straight RGBA of what a tool is given."""
    return given if isinstance(given, np.ndarray) else np.array(Image.open(io.BytesIO(given)).convert("RGBA"))


def chosen_tools(names: Sequence[str], known: Sequence[str] | None = None) -> dict[str, Tool]:
    """The tools of these names, in this order. known: the names to choose from, by default all. Raises UsageError for
    another name, and for a tool that is not installed.
    """
    known = list(TOOLS) if known is None else known
    if not names or not set(names) <= set(known):
        raise UsageError(f"--tools must be of {', '.join(known)}, with commas between them, not {','.join(names)!r}")
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


def _ours(given: Given) -> bytes:
    """The artwork style as it is without options."""
    from cubicsplat_cli.artwork.vectorize import draw, prepare
    from cubicsplat_cli.files.load import as_picture
    from cubicsplat_cli.svg.drawing_writer import write_drawing

    picture = as_picture(given)
    target = picture.target()
    drawing = draw(target, prepared=prepare(target, picture.compression))
    return write_drawing(drawing, title="drawing.png", comment="benchmarks.artwork").encode()


def _photo(given: Given) -> bytes:
    """The photo style with 64 curves."""
    from cubicsplat_cli.api import vectorize

    return vectorize(given, style="photo", curves=PHOTO_CURVES, measure=False).svg.encode()


def vtracer_svg(given: Given, **settings: Any) -> bytes:
    """By VTracer. settings: as its function takes them."""
    vtracer: ModuleType = importlib.import_module("vtracer")
    svg: str = vtracer.convert_raw_image_to_svg(_encoded(pixels_of(given), "PNG"), img_format="png", **settings)
    return svg.encode()


def potrace_svg(given: Given) -> bytes:
    """By potrace, which knows black and white alone: what is darker than the middle, over white, is black."""
    pixels = pixels_of(given)
    alpha = pixels[..., 3:] / 255.0
    grey = (pixels[..., :3] * alpha + 255.0 * (1.0 - alpha)) @ np.array([0.2126, 0.7152, 0.0722])
    bitmap = _encoded(grey >= 127.5, "PPM")
    command = ["potrace", "--svg", "--output", "-", "-"]
    svg = subprocess.run(command, input=bitmap, capture_output=True, check=True, timeout=_POTRACE_SECONDS).stdout
    # It draws the black alone.
    opaque = bool((alpha == 1.0).all())
    return svg.replace(b"<g ", b'<rect width="100%" height="100%" fill="#fff"/><g ', 1) if opaque else svg


def diffvg_svg(given: Given, curves: int = DIFFVG_CURVES, *, iterations: int = DIFFVG_STEPS) -> bytes:
    """By diffvg, with so many closed curves, over white. Raises ImportError without pydiffvg.

    As in the authors' example: random places, Adam on control points and RGBA, squared error.
    """
    diffvg = importlib.import_module("pydiffvg")
    import torch

    pixels, generator = pixels_of(given), torch.Generator().manual_seed(0)
    height, width = pixels.shape[:2]
    values = torch.from_numpy(pixels.astype(np.float32) / 255.0)
    goal = values[..., :3] * values[..., 3:] + 1.0 - values[..., 3:]
    size = torch.tensor([width, height], dtype=torch.float32)
    paths, groups = [], []
    for index in range(curves):
        steps = _SPREAD * (torch.rand((3 * DIFFVG_SEGMENTS, 2), generator=generator) - 0.5)
        points = ((torch.rand(2, generator=generator) + steps.cumsum(0)) * size).requires_grad_()
        counts = torch.full((DIFFVG_SEGMENTS,), 2, dtype=torch.int32)
        paths.append(diffvg.Path(counts, points, torch.tensor(1.0), True))
        colour = torch.rand(4, generator=generator).requires_grad_()
        groups.append(diffvg.ShapeGroup(torch.tensor([index]), colour))
    points_of, colours = [path.points for path in paths], [group.fill_color for group in groups]
    rates = {"params": points_of, "lr": _POINT_RATE}, {"params": colours, "lr": _COLOUR_RATE}
    optimiser = torch.optim.Adam(rates)
    for step in range(iterations):
        optimiser.zero_grad()
        scene = diffvg.RenderFunction.serialize_scene(width, height, paths, groups)
        image = diffvg.RenderFunction.apply(width, height, _GRID, _GRID, step, None, *scene)
        over_white = image[..., :3] * image[..., 3:] + 1.0 - image[..., 3:]
        (over_white - goal).pow(2).mean().backward()
        optimiser.step()
        for colour in colours:
            colour.data.clamp_(0.0, 1.0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drawing.svg"
        diffvg.save_svg(str(path), width, height, paths, groups)
        return path.read_bytes()


def _encoded(pixels: np.ndarray, form: str) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, form)
    return buffer.getvalue()


TOOLS: dict[str, Tool] = {
    "ours": _ours, "photo": _photo, "vtracer": vtracer_svg, "potrace": potrace_svg, "diffvg": diffvg_svg
}  # fmt: skip


def settings_of_peers(names: Sequence[str]) -> dict[tuple[str, str], Tool]:
    """Other people's tools by name and setting, with every setting that they are measured at."""
    found: dict[tuple[str, str], Tool] = {}
    for name in names:
        if name == "vtracer":
            found |= {(name, setting): partial(vtracer_svg, **given) for setting, given in VTRACER_SETTINGS.items()}
        else:
            setting = "black and white" if name == "potrace" else f"{DIFFVG_CURVES} curves"
            found[name, setting] = TOOLS[name]
    return found


PEERS = ("vtracer", "potrace", "diffvg")
