"""One clip, and what is asked of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from cubicsplat_cli._version import __version__
from cubicsplat_cli.artwork.style import ARTWORK
from cubicsplat_cli.clip_request import ClipRequest
from cubicsplat_cli.files.clips import ClipSource, Frame
from cubicsplat_cli.files.load import laid_over
from cubicsplat_cli.files.marks import provenance_comment
from cubicsplat_cli.progress import Progress, StageTimer
from cubicsplat_cli.records import dataclass

# Seconds that one frame takes to become the next. What is shown for much longer stands still before it changes.
CHANGE_S = 0.2
_LONG = 1.5  # times CHANGE_S
AFTER_FIT = 0.1  # of a time limit, for writing and measuring


@dataclass(frozen=True, eq=False)
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
