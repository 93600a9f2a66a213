"""cubicsplat: an image becomes an SVG of N cubic Bezier shapes, fitted through a differentiable renderer.

The names below are imported on first use, so that `cubicsplat --help` stays fast.
"""

from __future__ import annotations

import importlib
from typing import Any

from cubicsplat_cli._version import __version__

_HOME = {
    "FitSettings": "cubicsplat_cli.fit",
    "Mode": "cubicsplat_cli.scene",
    "Scene": "cubicsplat_cli.scene",
    "load_picture": "cubicsplat_cli.files.load",
    "read_svg": "cubicsplat_cli.svg",
    "render_scene": "cubicsplat_cli.raster",
    "vectorize": "cubicsplat_cli.jobs.pipeline",
    "write_svg": "cubicsplat_cli.svg",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
