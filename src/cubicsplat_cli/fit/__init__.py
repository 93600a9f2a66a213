"""Fitting a scene to a picture."""

from cubicsplat_cli.fit.trainer import FitResult, Progress, fit
from cubicsplat_cli.settings import FitSettings, Recipe

__all__ = ["FitResult", "FitSettings", "Progress", "Recipe", "fit"]
