"""The data of the pipeline: the task, the result of a style, its figures, and the final result."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cubicsplat_cli._version import __version__
from cubicsplat_cli.artwork.settings import CUTOUT
from cubicsplat_cli.artwork.style import PHOTO, Style
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.evaluate.metrics import seconds_to_measure
from cubicsplat_cli.files.decode import holds_picture
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.files.marks import provenance_comment, with_checksum
from cubicsplat_cli.files.names import COMPRESSED, PLAIN, SVG_SUFFIXES, is_compressed_name
from cubicsplat_cli.files.paths import EXPORTS, format_of
from cubicsplat_cli.files.read import packed
from cubicsplat_cli.files.weights import pixel_weights
from cubicsplat_cli.files.write import write_atomically
from cubicsplat_cli.formatting import did_you_mean, printable
from cubicsplat_cli.metrics import Qualities, Report
from cubicsplat_cli.options import listed
from cubicsplat_cli.progress import FrameRecorder, Progress, StageTimer, log, warnings_to
from cubicsplat_cli.record import record
from cubicsplat_cli.request import DXF_TOLERANCE, Request
from cubicsplat_cli.scene import LayeredScene, Scene, scaled_scene
from cubicsplat_cli.settings import FitSettings
from cubicsplat_cli.svg.markup import data_uri, with_lengths

UNDECIDED = Style(PHOTO, "")
TOO_FINE = "its lines are too fine to be drawn"  # of a drawing without a shape
LEAST_FITTED = 0.1  # of a time limit is the fit's, however long the rest takes


@record
class Result:
    """A vectorised picture.

    svg: the text of the file. scene: its curves, in pixels of the picture; in layers where shapes have shading. report:
    the figures. pixels: (H, W, 4) uint8 straight RGBA, the SVG drawn by an independent renderer; None where it was not
    measured.
    """

    svg: str
    scene: Scene | LayeredScene | None
    report: Report
    pixels: np.ndarray | None = None

    def data_uri(self) -> str:
        """The SVG as a `data:image/svg+xml,...` URI, for use between double quotes."""
        return data_uri(self.svg)

    def save(self, path: str | Path, *, dxf_tolerance: float = DXF_TOLERANCE) -> None:
        """Write the SVG, whole or not at all, to a name that ends in .svg, in .svgz (compressed), or has no suffix; or
        the same in another format: .pdf, .ps, .eps, .dxf, or .xml (Android's VectorDrawable).

        dxf_tolerance: px by which a DXF may be off the outlines. What a format leaves out is logged. Raises InputError
        where the file cannot be written, EngineError where a package is missing, UsageError for another suffix, and
        where the file is a raster picture, which an SVG shall not replace.
        """
        path = Path(path)
        form = format_of(path)
        if form is None and path.suffix.lower() not in (*SVG_SUFFIXES, ""):
            endings = [PLAIN, COMPRESSED, *(f".{name}" for name in EXPORTS)]
            near = did_you_mean(path.suffix.lower(), endings)
            raise UsageError(f"{printable(str(path))}: a result's name must end in {listed(endings)}{near}")
        if holds_picture(path):
            raise UsageError(f"{printable(str(path))}: is a picture, which the SVG would replace; choose another name")
        if form is None:
            write_atomically(path, packed(self.svg, compressed=is_compressed_name(path)))
            return
        from cubicsplat_cli.export.formats import exported

        made = exported(self.svg.encode(), form, "the SVG", tolerance=dxf_tolerance)
        for note in made.notes:
            log.warning("%s: %s", path, note)
        write_atomically(path, made.data)

    def layers(self) -> dict[str, str]:
        """The text of an SVG for each colour, with register marks, by names such as `01-ff8800`, in the order in which
        they are drawn. Raises UsageError for a result that is no cutout, whose colours lie on one another.
        """
        if self.report.style == PHOTO or self.report.settings["artwork"]["stacking"] != CUTOUT:
            raise UsageError("layers are of cutouts; make the result with stacking='cutout'")
        from cubicsplat_cli.export.layers import layers

        return layers(self.svg)


@record
class Made:
    """The result of a style, before it is written.

    scene: None where the SVG holds no shape. write: gives the SVG's text for a title and a comment. samples: edges per
    cubic of the engine's own picture. paths: how many curves or shapes there are. facts: members of the report that are
    the style's. style: and why; set by `candidates`. may_be_photo: whether to ask if a photo would be nearer to the
    picture, as of all drawings but those of cells and of scans; may_be_drawn: the same of a photo. of_scan: a drawing
    without the paper. blur: px by which the target has been blurred since it was drawn, as the drawing is not; noise:
    standard deviation in levels of what was added to it.
    """

    scene: Scene | LayeredScene | None
    write: Callable[[str, str], str]
    samples: int
    paths: int
    notes: list[str] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)
    style: Style = UNDECIDED
    may_be_photo: bool = False
    may_be_drawn: bool = False
    of_scan: bool = False
    blur: float = 0.0
    noise: float = 0.0

    @property
    def interrupted(self) -> bool:
        """Whether a Ctrl-C ended the work early."""
        return bool(self.facts.get("interrupted"))


@record
class Measured:
    """The figures of an SVG, and its pixels (H, W, 4) uint8 as an independent renderer draws them."""

    quality: Qualities
    pixels: np.ndarray
    notes: list[str]


@record
class Task:
    """One picture, and what is asked of it.

    source: the picture as it came; picture: over the ground asked for; target: what is fitted, that or a smaller copy.
    recorder: keeps the scenes of a photo's fit. logged: the warnings of the work so far. quick_photos: quick fits
    to the picture that were begun, by their number of curves.
    """

    source: Picture
    picture: Picture
    target: Picture
    request: Request
    timer: StageTimer
    on_progress: Callable[[Progress], None] | None
    recorder: FrameRecorder | None
    title: str
    logged: list[str] = field(default_factory=list)
    quick_photos: dict[int, Any] = field(default_factory=dict)

    @cached_property
    def pixels(self) -> np.ndarray:
        """What is fitted; see `Picture.target`."""
        return self.target.target()

    @property
    def bounded(self) -> bool:
        """Whether the request limits curves, bytes, quality or time."""
        settings, request = self.request.settings, self.request
        bounds = (settings.curves, settings.time_limit, request.max_bytes, request.target_psnr)
        return any(each is not None for each in bounds)

    @contextmanager
    def working(self) -> Iterator[None]:
        """Within, time counts as the fit's, and warnings of the library are kept."""
        with warnings_to(self.logged.append), self.timer("fit"):
            yield

    def comment(self) -> str:
        """The line by which the command knows its own files."""
        request = self.request
        return provenance_comment(__version__, request.settings.seed, request.digest(), self.picture.sha256)

    def svg(self, made: Made) -> str:
        """The text of the SVG of what was made."""
        with self.timer("write"):
            return self.finished(made)

    def finished(self, made: Made) -> str:
        """The same, as a part of other work."""
        return self._finished(made.write(self.title, self.comment()))

    def text(self, scene: Scene, precision: int) -> str:
        """The SVG of a photo's curves, at the picture's size."""
        sized = scaled_scene(scene, *self.picture.size)
        from cubicsplat_cli.svg.scene_writer import write_svg

        shapes = self.request.settings.shapes
        written = write_svg(sized, precision=precision, title=self.title, comment=self.comment(), shapes=shapes)
        return self._finished(written)

    def _finished(self, svg: str) -> str:
        """The text of an SVG with the size that was asked for, and its checksum."""
        if self.request.width is not None or self.request.units != "px":
            svg = with_lengths(svg, *self.request.size_text(*self.picture.size))
        return with_checksum(svg)

    def seconds_left(self) -> float:
        """Until the time limit, infinite without one; below 0 beyond it."""
        limit = self.request.settings.time_limit
        return math.inf if limit is None else limit - self.timer.total()

    def settings(self) -> FitSettings:
        """Settings of a fit; under a time limit they leave time for what comes after it."""
        limit = self.request.settings.time_limit
        if limit is None:
            return self.request.settings
        return self.request.settings.with_(time_limit=min(self.seconds_to_make(), limit))

    def seconds_to_make(self) -> float:
        """For the fit or drawing, so that there is time for what comes after it; infinite without a limit."""
        limit, left = self.request.settings.time_limit, self.seconds_left()
        if limit is None:
            return math.inf
        after = seconds_to_measure(self.picture) if self.request.measure else 0.0
        # Not less than a share of what was asked for, and of what is left: a fit is what it was asked for.
        return max(left - after, LEAST_FITTED * limit, 0.5 * left, 1e-3)

    def weights(self, copy: Picture) -> np.ndarray | None:
        """Weights (H, W) of the pixels of the picture or a smaller copy; None if all are equal."""
        return pixel_weights(copy, self.request.weights, self.request.focus, self.picture.size)
