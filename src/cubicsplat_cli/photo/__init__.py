"""Fitting a scene to a picture: the photo style."""

from cubicsplat_cli.photo.fitting import Fitting, fit
from cubicsplat_cli.photo.inputs import FitInputs, FitResult

__all__ = ["FitInputs", "FitResult", "Fitting", "fit"]
