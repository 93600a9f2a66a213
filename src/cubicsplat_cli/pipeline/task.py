"""What goes through the stages: the task, what a style makes of it, and the result."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cubicsplat_cli._version import __version__
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.evaluate.measurable import seconds_to_measure
from cubicsplat_cli.files.atomic import write_atomically
from cubicsplat_cli.files.formats import holds_picture
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.files.marks import provenance_comment, with_checksum
from cubicsplat_cli.files.names import SVG_SUFFIXES, is_compressed_name
from cubicsplat_cli.files.read import packed
from cubicsplat_cli.files.weights import pixel_weights
from cubicsplat_cli.film import Film
from cubicsplat_cli.progress import Progress, Stages
from cubicsplat_cli.report import Report
from cubicsplat_cli.request import Request
from cubicsplat_cli.scene import Scene, scaled_scene
from cubicsplat_cli.settings import FitSettings
from cubicsplat_cli.svg import write_svg
from cubicsplat_cli.words import printable

LEAST_FITTED = 0.1  # of a time limit is the fit's, however long the rest takes


@dataclass(frozen=True, eq=False)
class Result:
    """A vectorised picture.

    svg: the text of the file. scene: its curves, in pixels of the picture. report: the figures. pixels: (H, W, 4) uint8
    straight RGBA, the SVG drawn by an independent renderer; None where it was not measured.
    """

    svg: str
    scene: Scene | None
    report: Report
    pixels: np.ndarray | None = None

    def save(self, path: str | Path) -> None:
        """Write the SVG, whole or not at all, to a name that ends in .svg, in .svgz (compressed), or has no suffix.

        Raises InputError where the file cannot be written, UsageError for another suffix, and where the file is a
        raster picture, which an SVG shall not replace.
        """
        path = Path(path)
        if path.suffix.lower() not in (*SVG_SUFFIXES, ""):
            raise UsageError(f"{printable(str(path))}: an SVG's name must end in .svg or .svgz; choose another")
        if holds_picture(path):
            raise UsageError(f"{printable(str(path))}: is a picture, which the SVG would replace; choose another name")
        write_atomically(path, packed(self.svg, compressed=is_compressed_name(path)))


@dataclass(frozen=True, eq=False)
class Made:
    """What a style made of a picture.

    scene: None where the SVG holds no shape. write: gives the SVG's text for a title and a comment. samples: edges per
    cubic of the engine's own picture. paths: how many curves or shapes there are. facts: members of the report that are
    the style's. least_db: PSNR against its picture below which a drawing is too far from it.
    """

    scene: Scene | None
    write: Callable[[str, str], str]
    samples: int
    paths: int
    notes: list[str] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)
    least_db: float = -math.inf


@dataclass(frozen=True, eq=False)
class Task:
    """One picture, over the ground asked for, and what is asked of it. target: what is fitted, it or a smaller copy."""

    picture: Picture
    target: Picture
    request: Request
    stages: Stages
    on_progress: Callable[[Progress], None] | None
    film: Film | None
    title: str

    def comment(self) -> str:
        """The line by which the command knows its own files."""
        request = self.request
        return provenance_comment(__version__, request.settings.seed, request.digest(), self.picture.sha256)

    def text(self, scene: Scene, precision: int) -> str:
        """The SVG of a photo's curves, at the picture's size."""
        sized = scaled_scene(scene, *self.picture.size)
        return with_checksum(write_svg(sized, precision=precision, title=self.title, comment=self.comment()))

    def seconds_left(self) -> float:
        """Until the time limit, infinite without one; below 0 beyond it."""
        limit = self.request.settings.time_limit
        return math.inf if limit is None else limit - self.stages.total()

    def settings(self) -> FitSettings:
        """Of a fit that leaves time for what comes after it, where there is a limit."""
        settings, left = self.request.settings, self.seconds_left()
        if settings.time_limit is None:
            return settings
        after = seconds_to_measure(self.picture) if self.request.measure else 0.0
        # Not less than a share of what was asked for, and of what is left: a fit is what it was asked for.
        most = max(left - after, LEAST_FITTED * settings.time_limit, 0.5 * left, 1e-3)
        return settings.with_(time_limit=min(most, settings.time_limit))

    def weights(self, copy: Picture) -> np.ndarray | None:
        """How much each pixel of the picture, or of a smaller copy of it, matters; None: all alike."""
        return pixel_weights(copy, self.request.weights, self.request.focus, self.picture.size)
