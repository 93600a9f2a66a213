"""Fitting a scene to a picture: the photo style."""

from cubicsplat_cli.photo.trainer import FitResult, fit

__all__ = ["FitResult", "fit"]
