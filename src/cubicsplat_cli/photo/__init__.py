"""Fitting a scene to a picture: the photo style."""

from cubicsplat_cli.photo.fitting import fit
from cubicsplat_cli.photo.guide import Guide
from cubicsplat_cli.photo.resizing import Resizing
from cubicsplat_cli.photo.result import FitResult

__all__ = ["FitResult", "Guide", "Resizing", "fit"]
