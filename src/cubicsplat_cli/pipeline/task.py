"""The data of the pipeline: the task, the result of a style, its figures, and the final result."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from cubicsplat_cli.artwork.settings import CUTOUT
from cubicsplat_cli.artwork.style import PHOTO, Style
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.evaluate.metrics import measurable, seconds_to_measure
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
from cubicsplat_cli.progress import FrameRecorder, OnProgress, StageTimer, log, warnings_to
from cubicsplat_cli.record import record
from cubicsplat_cli.request import DXF_TOLERANCE, Request
from cubicsplat_cli.scene import AnyScene
from cubicsplat_cli.settings import FitSettings
from cubicsplat_cli.svg.markup import data_uri, with_lengths

T = TypeVar("T")
TOO_FINE = "its lines are too fine to be drawn"  # of a drawing without a shape


class DrawingGivenUp(Exception):
    """Ends a drawing that is not worth finishing; the text says why."""


@record
class Result:
    """A vectorised picture.

    svg: the text of the file. scene: its curves, in pixels of the picture; in layers if any shape has shading. report:
    the figures. pixels: (H, W, 4) uint8 straight RGBA, the SVG drawn by an independent renderer; None if unmeasured.
    """

    svg: str
    scene: AnyScene | None
    report: Report
    pixels: np.ndarray | None = None

    def _repr_svg_(self) -> str:
        """Return the SVG, which a notebook shows."""
        return self.svg

    def data_uri(self) -> str:
        """Return the SVG as a `data:image/svg+xml,...` URI, for use between double quotes."""
        return data_uri(self.svg)

    def save(self, path: str | Path, *, dxf_tolerance: float = DXF_TOLERANCE) -> None:
        """Write the result, whole or not at all, in the format of the name's suffix.

        No suffix and .svg: an SVG. .svgz: a compressed one. .pdf, .ps, .eps, .dxf, .xml (Android's VectorDrawable):
        those formats. dxf_tolerance: px by which a DXF may be off the outlines. Parts that a format cannot hold are
        logged. Raises InputError if the file cannot be written, EngineError if a package is missing, UsageError for
        another suffix, and for the name of a raster picture, which an SVG never replaces.
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

        data, notes = exported(self.svg.encode(), form, "the SVG", tolerance=dxf_tolerance)
        for note in notes:
            log.warning("%s: %s", path, note)
        write_atomically(path, data)

    def layers(self) -> dict[str, str]:
        """Return the text of an SVG with register marks for each colour, by names such as `01-ff8800`, in the order of
        painting. Raises UsageError for a result that is no cutout: its colours lie on one another.
        """
        if self.report.style == PHOTO or self.report.settings["artwork"]["stacking"] != CUTOUT:
            raise UsageError("layers are of cutouts; make the result with stacking='cutout'")
        from cubicsplat_cli.export.layers import layers

        return layers(self.svg)


@record
class Drawn:
    """The engine's own picture of a result. scene: None if the SVG holds no shape. samples: edges per cubic. blur: px
    of the target's blur, which a drawing does not have. small: the target before it was enlarged, if it was.
    """

    scene: AnyScene | None
    samples: int
    blur: float = field(default=0.0, kw_only=True)
    small: Picture | None = field(default=None, kw_only=True)


@record
class Made(Drawn):
    """The result of a style, before it is written.

    write: returns the SVG's text for a title and a comment. paths: the number of curves or shapes. facts: the style's
    own members of the report. style: the style, and why; set by `candidates`. interrupted: a Ctrl-C ended the work
    early. may_be_photo: a photo may be nearer to the picture, so the two are compared; true of all drawings but those
    of cells and scans. of_scan: a drawing without the paper. unavoidable_error: as of `PreparedInput`. banded: as of
    `Drawing`.
    """

    write: Callable[..., str]
    paths: int
    notes: list[str] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)
    style: Style = Style(PHOTO, "")
    interrupted: bool = False
    may_be_photo: bool = False
    of_scan: bool = False
    unavoidable_error: float = 0.0
    banded: bool = False

    @cached_property
    def bytes(self) -> int:
        """The size of the SVG without a title and a comment."""
        return len(self.write(title="", comment="").encode())

    def with_note(self, note: str) -> Made:
        """Return the result with one more note."""
        return replace(self, notes=[*self.notes, note])


@record
class Measured:
    """The figures of an SVG, and its pixels, (H, W, 4) uint8 straight RGBA, drawn by an independent renderer."""

    quality: Qualities
    pixels: np.ndarray
    notes: list[str]


@record
class Task:
    """One picture and the request for it.

    source: the picture as read. picture: the same over the requested ground. target: the picture that is fitted, which
    is `picture`, or a copy of it without the remains of a removed ground, or smaller. recorder: keeps the scenes of a
    photo's fit. logged: the warnings so far. results: of `once`.
    """

    source: Picture
    picture: Picture
    target: Picture
    request: Request
    timer: StageTimer
    on_progress: OnProgress | None
    recorder: FrameRecorder | None
    title: str
    logged: list[str] = field(default_factory=list)
    results: dict[tuple[Any, ...], Any] = field(default_factory=dict)

    def once(self, make: Callable[..., T], *given: Any) -> T:
        """Return make(task, *given), which is called once for the picture."""
        key = make, *given
        if key not in self.results:
            self.results[key] = make(self, *given)
        return self.results[key]

    @cached_property
    def pixels(self) -> np.ndarray:
        """Return the target's pixels; see `Picture.target`."""
        return self.target.target()

    @cached_property
    def reference(self) -> Picture:
        """Return the picture, or the largest copy that a renderer can draw."""
        return measurable(self.picture)

    @property
    def bounded(self) -> bool:
        """True if the request limits curves, bytes, quality or time."""
        settings, request = self.request.settings, self.request
        bounds = (settings.curves, settings.time_limit, request.max_bytes, request.target_psnr)
        return any(bound is not None for bound in bounds)

    @contextmanager
    def working(self) -> Iterator[None]:
        """Count the time within as the fit's, and keep the library's warnings."""
        with warnings_to(self.logged.append), self.timer("fit"):
            yield

    def comment(self) -> str:
        """Return the line by which the command recognises its own files."""
        return provenance_comment(self.request.settings.seed, self.request.digest(), self.picture.sha256)

    def svg(self, made: Made) -> str:
        """Return the text of a result's SVG, and count the time."""
        with self.timer("write"):
            return self.text(made.write)

    def text(self, write: Callable[..., str]) -> str:
        """Return the text of an SVG in the requested size, with its checksum. write: see `Made`."""
        svg = write(title=self.title, comment=self.comment())
        if self.request.width is not None or self.request.units != "px":
            svg = with_lengths(svg, *self.request.size_text(*self.picture.size))
        return with_checksum(svg)

    def seconds_left(self) -> float:
        """Return the seconds until the time limit: infinite without one, below 0 beyond it."""
        limit = self.request.settings.time_limit
        return math.inf if limit is None else limit - self.timer.total()

    def settings(self) -> FitSettings:
        """Return the settings of a fit, which ends early enough for the work after it to keep the time limit."""
        settings, limit = self.request.settings, self.request.settings.time_limit
        return settings if limit is None else settings.with_(time_limit=min(self.seconds_to_make(), limit))

    def seconds_to_make(self) -> float:
        """Return the seconds for the fit or drawing under the time limit; infinite without one."""
        limit, left = self.request.settings.time_limit, self.seconds_left()
        if limit is None:
            return math.inf
        after = seconds_to_measure(self.picture) if self.request.measure else 0.0
        # The fit matters most: it gets a tenth of the limit and half of the remaining time at least.
        return max(left - after, 0.1 * limit, 0.5 * left, 1e-3)

    def weights(self, copy: Picture) -> np.ndarray | None:
        """Return the weights (H, W) of the pixels of a copy of the picture; None if all are equal."""
        return pixel_weights(copy, self.request.weights, self.request.focus, self.picture.size)
