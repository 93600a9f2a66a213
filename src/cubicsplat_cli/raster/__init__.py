"""Drawing scenes: one differentiable operator over the engines, and the readable reference."""

from cubicsplat_cli.raster.draw import describe, render_scene
from cubicsplat_cli.raster.operator import render
from cubicsplat_cli.raster.settings import RasterSettings

__all__ = ["RasterSettings", "describe", "render", "render_scene"]
