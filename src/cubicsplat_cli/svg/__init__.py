"""The SVG side: writing a scene or a drawing as plain SVG 1.1 and reading our own files back.

Each name is imported when it is first used: a drawing needs few of them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cubicsplat_cli.svg.drawing_reader import read_drawing
    from cubicsplat_cli.svg.drawing_writer import write_drawing
    from cubicsplat_cli.svg.mosaic_writer import write_mosaic
    from cubicsplat_cli.svg.quantise import quantise_scene
    from cubicsplat_cli.svg.scene_reader import read_svg
    from cubicsplat_cli.svg.scene_writer import write_svg

__all__ = ["quantise_scene", "read_drawing", "read_svg", "write_drawing", "write_mosaic", "write_svg"]

_HOME = {
    "drawing_reader": ("read_drawing",),
    "drawing_writer": ("write_drawing",),
    "mosaic_writer": ("write_mosaic",),
    "quantise": ("quantise_scene",),
    "scene_reader": ("read_svg",),
    "scene_writer": ("write_svg",),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOME.items():
        if name in names:
            return getattr(importlib.import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
