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
    from cubicsplat_cli.photo import FitResult, fit
    from cubicsplat_cli.pipeline import Result
    from cubicsplat_cli.pipeline.animation import Animation
    from cubicsplat_cli.progress import Progress
    from cubicsplat_cli.raster import RasterSettings, render, render_scene
    from cubicsplat_cli.scene import Scene
    from cubicsplat_cli.scene.gradients import Gradients
    from cubicsplat_cli.settings import FitSettings, Mode, Recipe
    from cubicsplat_cli.svg import read_svg, write_svg

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
    "photo": ("FitResult", "fit"),
    "pipeline": ("Result",),
    "pipeline.animation": ("Animation",),
    "progress": ("Progress",),
    "raster": ("RasterSettings", "render", "render_scene"),
    "metrics": ("Quality", "Report"),
    "scene": ("Scene",),
    "settings": ("FitSettings", "Mode", "Recipe"),
    "svg": ("read_svg", "write_svg"),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOME.items():
        if name in names:
            return getattr(importlib.import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
