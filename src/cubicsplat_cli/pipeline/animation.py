"""The data of `animate`: a clip with the request for it, and the result, moving curves or shapes, with its files."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from cubicsplat_cli.artwork.moving import MovingDrawing
from cubicsplat_cli.artwork.style import ARTWORK
from cubicsplat_cli.clip_request import FRAMES, LOTTIE, SMIL, ClipReport, ClipRequest
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.evaluate.images import ImageSource, of_pixels, of_values
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.export.lottie import lottie
from cubicsplat_cli.files.clips import ClipSource, Frame
from cubicsplat_cli.files.load import laid_over
from cubicsplat_cli.files.marks import provenance_comment
from cubicsplat_cli.files.write import write_atomically
from cubicsplat_cli.metrics import head, to_json
from cubicsplat_cli.progress import OnProgress, StageTimer
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.record import record
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.svg.moving import GridClip
from cubicsplat_cli.svg.moving_file import still
from cubicsplat_cli.svg.scene_reader import quantise_scene
from cubicsplat_cli.svg.scene_writer import write_svg

CHANGE_S = 0.2  # seconds from one frame to the next; a frame that is shown for much longer stands still before


@record
class ClipTask:
    """One clip and the request for it."""

    source: ClipSource
    request: ClipRequest
    title: str
    timer: StageTimer
    on_progress: OnProgress | None = None

    @cached_property
    def comment(self) -> str:
        """Return the line by which the command recognises its own files."""
        return provenance_comment(self.request.settings.seed, self.request.digest(), self.source.sha256)

    @property
    def deadline(self) -> float:
        """Return the time at which the fit must end, by `time.perf_counter`."""
        limit = self.request.settings.time_limit
        # A tenth of the limit is for writing and measuring.
        return math.inf if limit is None else time.perf_counter() + 0.9 * limit - self.timer.total()

    @property
    def format(self) -> str:
        """Return the format of the result."""
        return self.request.format or SMIL

    def frames(self) -> Iterator[Frame]:
        """Yield the frames over the requested ground."""
        for frame in self.source.frames():
            yield replace(frame, picture=laid_over(frame.picture, self.request.settings.background_colour))

    def held_frames(self) -> Iterator[Frame]:
        """Yield the frames; those that are shown for long twice, for their beginning and their end."""
        for frame in self.frames():
            if frame.end - frame.begin > 1.5 * CHANGE_S:
                middle = frame.end - CHANGE_S
                yield replace(frame, end=middle)
                frame = replace(frame, begin=middle)
            yield frame

    def played(self, style: str) -> Iterator[Frame]:
        """Return the frames of an animation in a style."""
        return self.frames() if style == ARTWORK else self.held_frames()

    def pixels(self, frame: Frame) -> np.ndarray:
        """Return a frame's target: (H, W, 3), or premultiplied (H, W, 4) if any frame has transparency; float32."""
        transparent = self.source.transparent and self.request.settings.background_colour is None
        return frame.picture.premultiplied() if transparent else frame.picture.rgb


@record
class Animation(ABC):
    """A clip as an animation.

    svg: the text of the SVG that SMIL animates. begins: (F,) the beginning of each frame, s. exact: (F,) a time within
    each frame at which the animation shows it as it was fitted, s. duration: s. plays: the number of times that it is
    shown, 0 for endlessly. notes: sentences for the user. report: the figures; None before they are measured.
    """

    svg: str
    begins: np.ndarray
    exact: np.ndarray
    duration: float
    plays: int
    notes: tuple[str, ...] = field(default=(), kw_only=True)
    report: ClipReport | None = field(default=None, kw_only=True)

    def _repr_svg_(self) -> str:
        """Return the SVG, which a notebook plays."""
        return self.svg

    @property
    @abstractmethod
    def counts(self) -> tuple[int, int, int]:
        """Return the numbers of groups of frames, of curves or shapes in all, and of written knots or changes."""

    @abstractmethod
    def pictures(self, form: str, threads: int | None = None) -> Iterator[ImageSource]:
        """Yield the pictures of the frames, drawn from the file of a format."""

    @abstractmethod
    def stills(self) -> Iterator[str]:
        """Yield the text of an SVG of each frame."""

    @abstractmethod
    def lottie(self) -> str:
        """Return the animation as Lottie JSON. Raises UsageError for a drawing."""

    def frames(self) -> dict[str, str]:
        """Return an SVG of each frame by the name of its file, and the JSON of their times."""
        texts = {f"{index + 1:04d}.svg": text for index, text in enumerate(self.stills())}
        shown = zip(texts, self.begins.tolist(), [*self.begins[1:].tolist(), self.duration], strict=True)
        times = [{"file": name, "begin_s": begin, "duration_s": end - begin} for name, begin, end in shown]
        return {**texts, "frames.json": to_json({**head(), "plays": self.plays, "frames": times})}

    def files(self, form: str) -> dict[str, bytes]:
        """Return the files of a format by their names; the only file of a format has no name."""
        texts = {"": self.svg} if form == SMIL else {"": self.lottie()} if form == LOTTIE else self.frames()
        return {name: text.encode() for name, text in texts.items()}

    def save(self, path: str | Path) -> None:
        """Write the animation: as Lottie to a name that ends in .json, as frames to an existing folder, else as SVG."""
        path = Path(path)
        form = FRAMES if path.is_dir() else LOTTIE if path.suffix.lower() == ".json" else SMIL
        for name, data in self.files(form).items():
            write_atomically(path / name if name else path, data)


@record
class CurvesAnimation(Animation):
    """Moving curves that blend. clip: the numbers of the file."""

    title: str
    comment: str
    clip: GridClip

    @property
    def counts(self) -> tuple[int, int, int]:
        groups = self.clip.groups
        return len(groups), sum(len(group.curves) for group in groups), self.clip.knots

    def scenes(self, form: str = SMIL) -> Iterator[Scene]:
        """Yield the scene of each frame, as the file of a format holds it."""
        # The file rounds the beginning of a group, which may then lie before or after its first frame's.
        firsts = [int(np.abs(self.begins - group.begin).argmin()) for group in self.clip.groups[1:]]
        for group, exact in zip(self.clip.groups, np.split(self.exact, firsts), strict=True):
            for scene in self.clip.scenes(group, exact):
                yield quantise_scene(scene, self._still_precision) if form == FRAMES else scene

    @property
    def _still_precision(self) -> int:
        return max(2, self.clip.precision)  # frames between knots need 2 decimals

    def pictures(self, form: str, threads: int | None = None) -> Iterator[ImageSource]:
        return (of_values(render_scene(scene, threads=threads)) for scene in self.scenes(form))

    def stills(self) -> Iterator[str]:
        for scene in self.scenes(FRAMES):
            yield write_svg(scene, precision=self._still_precision, title=self.title, comment=self.comment)

    def lottie(self) -> str:
        return lottie(self.clip, fps=len(self.begins) / self.duration, title=self.title)


@record
class DrawnAnimation(Animation):
    """Opaque shapes that stand still, move as a whole, or are shown in some frames only."""

    moving: MovingDrawing

    @property
    def counts(self) -> tuple[int, int, int]:
        return 1, len(self.moving.drawing.shapes), self.svg.count("<animate")

    def pictures(self, form: str, threads: int | None = None) -> Iterator[ImageSource]:
        width, height = self.moving.drawing.width, self.moving.drawing.height
        return (of_pixels(rerender(text.encode(), width, height).pixels) for text in self.stills())

    def stills(self) -> Iterator[str]:
        return (still(self.svg, seconds) for seconds in self.exact.tolist())

    def lottie(self) -> str:
        raise UsageError("of drawings cannot be written yet; use --style photo, or write an SVG", "format")
