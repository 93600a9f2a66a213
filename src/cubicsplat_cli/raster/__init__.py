"""Drawing scenes: one differentiable operator over the engines."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cubicsplat_cli.raster.engines import describe, render_scene
from cubicsplat_cli.raster.settings import RasterSettings

if TYPE_CHECKING:
    from cubicsplat_cli.raster.operator import render

__all__ = ["RasterSettings", "describe", "render", "render_scene"]


def __getattr__(name: str) -> Any:
    if name == "render":
        # The operator is torch's, which nothing else here needs.
        from cubicsplat_cli.raster.operator import render

        return render
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
