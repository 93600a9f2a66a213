"""The data of `animate`: one clip and what is asked of it; and the result, a clip as curves that move, or as a drawing
whose shapes do, with its files.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from cubicsplat_cli._version import __version__
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
from cubicsplat_cli.progress import Progress, StageTimer
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.record import record
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.svg.moving import GridClip
from cubicsplat_cli.svg.moving_file import read_clip, still
from cubicsplat_cli.svg.scene_reader import quantise_scene
from cubicsplat_cli.svg.scene_writer import write_svg

# Seconds that one frame takes to become the next. What is shown for much longer stands still before it changes.
CHANGE_S = 0.2
_LONG = 1.5  # times CHANGE_S
AFTER_FIT = 0.1  # of a time limit, for writing and measuring
STILL_PRECISION = 2  # decimals of frames that lie between knots
TIMES = "frames.json"


@record
class ClipTask:
    """One clip, and what is asked of it."""

    source: ClipSource
    request: ClipRequest
    title: str
    timer: StageTimer
    on_progress: Callable[[Progress], None] | None = None

    @cached_property
    def comment(self) -> str:
        """The line by which the command knows its own files."""
        seed, digest = self.request.settings.seed, self.request.digest()
        return provenance_comment(__version__, seed, digest, self.source.sha256)

    @cached_property
    def transparent(self) -> bool:
        """Whether what is fitted has transparency."""
        return self.source.transparent and self.request.settings.background_colour is None

    @property
    def deadline(self) -> float:
        """The time at which the fit must end, by `time.perf_counter`."""
        limit = self.request.settings.time_limit
        return math.inf if limit is None else time.perf_counter() + (1.0 - AFTER_FIT) * limit - self.timer.total()

    def frames(self) -> Iterator[Frame]:
        """The frames over the ground that is asked for."""
        for frame in self.source.frames():
            yield replace(frame, picture=laid_over(frame.picture, self.request.settings.background_colour))

    def held_frames(self) -> Iterator[Frame]:
        """The frames, those that are shown for long twice: when they begin, and before they change."""
        for frame in self.frames():
            if frame.end - frame.begin > _LONG * CHANGE_S:
                middle = frame.end - CHANGE_S
                yield replace(frame, end=middle)
                frame = replace(frame, begin=middle)
            yield frame

    def played(self, style: str) -> Iterator[Frame]:
        """The frames that an animation of a style has."""
        return self.frames() if style == ARTWORK else self.held_frames()

    def pixels(self, frame: Frame) -> np.ndarray:
        """The target of the fit: (H, W, 3), or premultiplied (H, W, 4) where any frame is transparent; float32."""
        return frame.picture.premultiplied() if self.transparent else frame.picture.rgb


@record
class Animation(ABC):
    """A clip that moves.

    svg: the text of the SVG that SMIL animates. begins: (F,) when each frame begins, s from the start. exact: (F,) a
    time within it at which it is as it was made. duration: s. plays: how often it is shown, 0 for ever. notes: what the
    user should know. report: the figures; None before they are measured.
    """

    svg: str
    begins: np.ndarray
    exact: np.ndarray
    duration: float
    plays: int
    title: str
    comment: str
    notes: tuple[str, ...] = field(default=(), kw_only=True)
    report: ClipReport | None = field(default=None, kw_only=True)

    @property
    @abstractmethod
    def counts(self) -> tuple[int, int, int]:
        """Groups of frames, curves or shapes in all of them, and knots or changes that are written."""

    @abstractmethod
    def pictures(self, form: str, threads: int | None = None) -> Iterator[ImageSource]:
        """The pictures of the frames, drawn from the file of a format."""

    @abstractmethod
    def stills(self) -> Iterator[str]:
        """The text of an SVG of each frame."""

    @abstractmethod
    def lottie(self) -> str:
        """The same as Lottie JSON. Raises UsageError for a drawing."""

    def frames(self) -> dict[str, str]:
        """An SVG of each frame by the name of its file, and the JSON of their times."""
        texts = {f"{index + 1:04d}.svg": text for index, text in enumerate(self.stills())}
        shown = zip(texts, self.begins.tolist(), [*self.begins[1:].tolist(), self.duration], strict=True)
        times = [{"file": name, "begin_s": begin, "duration_s": end - begin} for name, begin, end in shown]
        return {**texts, TIMES: to_json({**head(), "plays": self.plays, "frames": times})}

    def files(self, form: str) -> dict[str, bytes]:
        """The files of a format: of frames by their names, else one without a name."""
        texts = {"": self.svg} if form == SMIL else {"": self.lottie()} if form == LOTTIE else self.frames()
        return {name: text.encode() for name, text in texts.items()}

    def save(self, path: str | Path) -> None:
        """Write it: to a name that ends in .json as Lottie, to a folder that exists as frames, else as SVG."""
        path = Path(path)
        form = FRAMES if path.is_dir() else LOTTIE if path.suffix.lower() == ".json" else SMIL
        for name, data in self.files(form).items():
            write_atomically(path / name if name else path, data)


@record
class CurvesAnimation(Animation):
    """Curves that blend and move. clip: the numbers of the file."""

    clip: GridClip

    @property
    def counts(self) -> tuple[int, int, int]:
        groups = self.clip.groups
        return len(groups), sum(len(group.curves) for group in groups), self.clip.knots

    def scenes(self, form: str = SMIL) -> Iterator[Scene]:
        """The scene that each frame shows, as the file of a format says it."""
        clip = read_clip(self.svg) if form == SMIL else self.clip
        # The file rounds the time at which a group begins, to either side of its first frame's.
        firsts = [int(np.abs(self.begins - group.begin).argmin()) for group in self.clip.groups[1:]]
        for group, exact in zip(clip.groups, np.split(self.exact, firsts), strict=True):
            for scene in clip.scenes(group, exact):
                yield quantise_scene(scene, self._still_precision) if form == FRAMES else scene

    @property
    def _still_precision(self) -> int:
        return max(STILL_PRECISION, self.clip.precision)

    def pictures(self, form: str, threads: int | None = None) -> Iterator[ImageSource]:
        return (of_values(render_scene(scene, threads=threads)) for scene in self.scenes(form))

    def stills(self) -> Iterator[str]:
        for scene in self.scenes(FRAMES):
            yield write_svg(scene, precision=self._still_precision, title=self.title, comment=self.comment)

    def lottie(self) -> str:
        return lottie(self.clip, fps=len(self.begins) / self.duration, title=self.title)


@record
class DrawnAnimation(Animation):
    """Opaque shapes that stand still, move as a whole, or are shown in some frames."""

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
