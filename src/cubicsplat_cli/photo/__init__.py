"""Fitting a scene to a picture: the photo style."""

from cubicsplat_cli.photo.guide import Guide
from cubicsplat_cli.photo.trainer import FitResult, fit

__all__ = ["FitResult", "Guide", "fit"]
