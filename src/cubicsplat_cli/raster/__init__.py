"""Drawing scenes: one differentiable operator over the engines, and the readable reference."""

from .draw import describe, render_scene
from .operator import render
from .settings import RasterSettings

__all__ = ["RasterSettings", "describe", "render", "render_scene"]
