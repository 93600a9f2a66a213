"""Fitting a scene to a picture."""

from .presets import FitSettings, Recipe
from .trainer import FitResult, Progress, fit

__all__ = ["FitResult", "FitSettings", "Progress", "Recipe", "fit"]
