"""Fitting a scene to a picture: the photo style."""

from cubicsplat_cli.photo.fitting import fit
from cubicsplat_cli.photo.inputs import FitInputs, FitResult, Resizing

__all__ = ["FitInputs", "FitResult", "Resizing", "fit"]
