"""cubicsplat: an image becomes an SVG of N cubic Bezier shapes, fitted through a differentiable renderer.

    import cubicsplat_cli as cubicsplat

    result = cubicsplat.vectorize("photo.png", curves=256)
    result.save("photo.svg")

The names below are all there is to the public interface (docs/python.md); each is imported when it is first used, so
that `cubicsplat --help` stays fast.
"""

from __future__ import annotations

import importlib
import logging
from typing import TYPE_CHECKING, Any

from cubicsplat_cli._version import __version__

if TYPE_CHECKING:
    from cubicsplat_cli.api import animate, compare, vectorize
    from cubicsplat_cli.errors import CubicSplatError, EngineError, InputError, UsageError
    from cubicsplat_cli.files.load import Picture, load_picture
    from cubicsplat_cli.metrics import Quality, Report
    from cubicsplat_cli.photo.inputs import FitResult
    from cubicsplat_cli.photo.loop import fit
    from cubicsplat_cli.pipeline.animation import Animation
    from cubicsplat_cli.pipeline.task import Result
    from cubicsplat_cli.progress import Progress
    from cubicsplat_cli.raster.engines import render_scene
    from cubicsplat_cli.raster.operator import render
    from cubicsplat_cli.raster.settings import RasterSettings
    from cubicsplat_cli.scene import Scene
    from cubicsplat_cli.scene.gradients import Gradients
    from cubicsplat_cli.settings import FitSettings, Mode, Recipe
    from cubicsplat_cli.svg.scene_reader import read_svg
    from cubicsplat_cli.svg.scene_writer import write_svg

# Programs decide themselves whether they show the log.
logging.getLogger("cubicsplat").addHandler(logging.NullHandler())

__all__ = [
    "Animation", "CubicSplatError", "EngineError", "FitResult", "FitSettings", "Gradients", "InputError", "Mode",
    "Picture", "Progress", "Quality", "RasterSettings", "Recipe", "Report", "Result", "Scene", "UsageError",
    "__version__", "animate", "compare", "fit", "load_picture", "read_svg", "render", "render_scene", "vectorize",
    "write_svg",
]  # fmt: skip

_HOME = {
    "api": ("animate", "compare", "vectorize"),
    "errors": ("CubicSplatError", "EngineError", "InputError", "UsageError"),
    "files.load": ("Picture", "load_picture"),
    "scene.gradients": ("Gradients",),
    "photo.loop": ("fit",),
    "photo.inputs": ("FitResult",),
    "pipeline.animation": ("Animation",),
    "pipeline.task": ("Result",),
    "progress": ("Progress",),
    "raster.engines": ("render_scene",),
    "raster.operator": ("render",),
    "raster.settings": ("RasterSettings",),
    "metrics": ("Quality", "Report"),
    "scene": ("Scene",),
    "settings": ("FitSettings", "Mode", "Recipe"),
    "svg.scene_reader": ("read_svg",),
    "svg.scene_writer": ("write_svg",),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOME.items():
        if name in names:
            return getattr(importlib.import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
