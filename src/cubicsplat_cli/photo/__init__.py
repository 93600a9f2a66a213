"""Fitting a scene to a picture: the photo style."""

from cubicsplat_cli.photo.guide import Guide
from cubicsplat_cli.photo.resizing import Resizing
from cubicsplat_cli.photo.trainer import FitResult, fit

__all__ = ["FitResult", "Guide", "Resizing", "fit"]
