"""The fit of a clip: group after group of its frames, each by following the picture, choosing knots and a joint fit."""

from __future__ import annotations

import itertools
import math
import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from PIL import Image

from cubicsplat_cli.formatting import hex_text
from cubicsplat_cli.motion.following import follow
from cubicsplat_cli.motion.knots import choose, curve_bytes, sensitivity, split_offsets
from cubicsplat_cli.motion.tracks import TRACKS, JointFit, Tracks, grid_of
from cubicsplat_cli.photo.initial import choose_background
from cubicsplat_cli.photo.loop import FitLoop
from cubicsplat_cli.progress import Stopped, work
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.engine import Pass
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.record import record
from cubicsplat_cli.scene import Scene, points_from_segments
from cubicsplat_cli.scene.arrays import with_channels
from cubicsplat_cli.settings import FitSettings

# Shares of the steps that the fit of one picture takes: those that follow it from frame to frame, and the epochs of the
# joint fit, in each of which every frame has one step.
FOLLOWING, EPOCHS = 1 / 16, 0.24
MEMORY = 1 << 28  # bytes of a group's pictures
MOST_FRAMES = 120  # of a group: knots are chosen in a time that grows with their square
EDGES, TOLERANCE = 24, 0.07  # of a cubic's polyline, and px: with 0.1, a tenth of a dB is lost in finer renderers
RELAXED_TOLERANCE = 0.5  # in widths of the soft edge, within which the polylines stay before the exact steps
BEFORE_DEADLINE = 0.9  # of the time that is left
FOLLOWING_SHARE = 0.3  # of the time that a group takes
LEAST_STEPS, LEAST_EPOCHS = 8, 10
MEASURED_STEPS = 4
OVERHEAD = 2.0  # times the first steps: later ones are exact, or move curves to other places
RATE = 0.15  # of the joint fit, in step sizes of the start of a fit
# Of the bytes of pictures of the frames, after gzip: the part that a clip is promised to take at most.
MOST_SHARE = 0.25
SEEN = 0.004  # an opacity that 8-bit renderers show
# Of scene cuts:
BLOCKS = 12  # along the longer side: means of blocks move little where a camera pans
LEAST_JUMP = 0.06  # of the range of values, between the blocks of two frames: no cut is smaller
JUMP = 3.0  # times the largest difference of the frames before
REMEMBERED = 8  # differences


def fit_clip(
    frames: Iterable[tuple[np.ndarray, float, float]],
    settings: FitSettings,
    count: int | None = None,
    *,
    precision: int = 1,
    bytes_per_second: float = math.inf,
) -> list[Tracks]:
    """Fits moving curves to the frames of a clip, in groups with a scene cut or a bound on memory between two.

    frames: pictures (H, W, 3), or (H, W, 4) premultiplied RGBA, float32 in [0, 1], all of one size, each with the
    seconds at which it begins and ends; they are read as they are needed, and at most `MEMORY` bytes of them kept.
    settings: of the fit of a picture; its number of curves is that which a frame shows, its steps are those of the
    first frame, and all else follows from them. The work is done on the CPU. count: of the frames, for progress.
    precision: decimals of coordinates in the file. bytes_per_second: about what the file may take after gzip.

    A stop (Ctrl-C, `work()`'s deadline) ends the fit with the frames so far. Raises EngineError if the engine fails.
    """
    channels = 4 if settings.background == "none" else 3
    taken = (
        (np.ascontiguousarray(with_channels(picture, channels), np.float32), begin, end)
        for picture, begin, end in frames
    )
    head = next(taken)
    fit = ClipFit(head[0], settings, precision, bytes_per_second, count)
    found: list[Tracks] = []
    for group in groups(itertools.chain([head], taken), fit.most_frames):
        last = None if group.after_cut else found[-1].at(found[-1].frames - 1, found[-1].lines())[0]
        tracks = fit.group(group, last)
        if tracks is not None:
            found.append(tracks)
        if work().stopped:
            break
    if not found:
        raise Stopped
    return found


@record
class Effort:
    """first: steps of a group's first frame. following: of each other one. epochs: of the joint fit. first_s,
    following_s: seconds that the first frame, and each other one, may take to be followed.
    """

    first: int
    following: int
    epochs: int
    first_s: float | None = None
    following_s: float = math.inf


class ClipFit:
    """The state that the fits of all groups of a clip share. picture: the first; the rest as in `fit_clip`."""

    def __init__(
        self, picture: np.ndarray, settings: FitSettings, precision: int, bytes_per_second: float, count: int | None
    ) -> None:
        height, width, _ = picture.shape
        settings = settings.for_size(width, height)
        background = choose_background(picture, settings)
        if background is not None:
            settings = settings.with_(background=hex_text(round(255.0 * value) for value in background))
        recipe = settings.recipe
        recipe = replace(recipe, tolerance=max(recipe.tolerance, RELAXED_TOLERANCE * recipe.edge_end))
        # The deadline is that of the work, for all frames together.
        self.settings = settings.with_(device="cpu", time_limit=None, recipe=recipe)
        self.engine = CpuEngine(settings.threads or work().threads)
        self.picture = picture
        self.generator = np.random.default_rng(settings.seed)
        self.bytes_per_second, self.count, self.done = bytes_per_second, count, 0
        self.unit = recipe.unit(width, height, settings.curves or 1)
        self.relaxed = RasterSettings("relaxed", recipe.edge_end, settings.samples, recipe.tolerance)
        self.raster = RasterSettings("exact", recipe.finish_edge_width, EDGES, TOLERANCE)
        self.grid = grid_of(points_from_segments(settings.mode, settings.segments), precision)
        by_curves = math.sqrt(MEMORY / (8 * len(TRACKS) * settings.curves))
        self.most_frames = max(2, min(MOST_FRAMES, MEMORY // picture.nbytes, int(by_curves)))

    def group(self, group: FrameGroup, start: Scene | None) -> Tracks | None:
        """The curves of a group's frames, of fewer where the work is stopped, or None if that was right away.

        start: the curves of the frame before, if this group goes on with it.
        """
        frames = len(group.pictures)
        if start is not None:
            seen = np.flatnonzero(start.opacities > SEEN)
            start = start.chosen(seen) if len(seen) else None
        effort = self._effort(frames, fresh=start is None)
        settings = self.settings.with_(steps=effort.first, time_limit=effort.first_s)

        def on_frame(index: int) -> None:
            self._tell(f"frame {self.done + index + 1}", FOLLOWING_SHARE * index)

        scenes = follow(group.pictures, settings, start, effort.following, effort.following_s, self.engine, on_frame)
        if not scenes:
            return None
        end = group.end if len(scenes) == frames else group.times[len(scenes)]
        tracks = Tracks.on_every_frame(scenes, np.array(group.times[: len(scenes)]), end)
        if len(scenes) > 1:
            tracks = self._joint(tracks, group.pictures[: len(scenes)], effort.epochs)
        self.done += len(scenes)
        return tracks.on_grid(self.grid)

    def _joint(self, tracks: Tracks, pictures: list[np.ndarray], epochs: int) -> Tracks:
        """The tracks with fewer knots, fitted to all frames at once, with numbers as the file has them."""
        tracks = self._thinned(tracks, pictures)
        fit = JointFit(tracks, pictures, self.engine, self.relaxed, self.grid)
        recipe = self.settings.recipe
        rates = RATE * recipe.rate_points * self.unit, RATE * recipe.rate_colours

        def on_epoch(share: float) -> None:
            self._tell("moving curves", (FOLLOWING_SHARE + (1.0 - FOLLOWING_SHARE) * share) * len(pictures))

        with work().stoppable():
            fit.run(epochs, rates, self.generator, self.raster, recipe.finish, on_epoch)
        return tracks

    def _thinned(self, tracks: Tracks, pictures: list[np.ndarray]) -> Tracks:
        lines = tracks.lines()
        scenes = (tracks.at(frame, lines)[0] for frame in range(len(pictures)))
        loss = sum(self.engine.loss(scene, self.raster, Pass(p)) for scene, p in zip(scenes, pictures, strict=True))
        weights = sensitivity(tracks, self.engine, self.raster, self.generator)
        split_offsets(tracks, weights)
        there = tracks.by_name["opacities"].values[..., 0] > SEEN
        seconds = tracks.end - float(tracks.times[0])
        # In a short clip too every curve may move.
        shown = max(MOST_SHARE * tracks.frames * self.settings.curves, 2.0 * there.shape[1])
        most = min(self.bytes_per_second * seconds, shown * curve_bytes(tracks))
        return choose(tracks, weights, there, loss, most)

    def _effort(self, frames: int, *, fresh: bool) -> Effort:
        """Steps and epochs for a group; fewer, but never none, where the deadline asks for it."""
        steps = self.settings.steps
        wanted = steps, max(LEAST_STEPS, round(FOLLOWING * steps)), max(LEAST_EPOCHS, round(EPOCHS * steps))
        left = (work().deadline - time.perf_counter()) * BEFORE_DEADLINE
        if left == math.inf:
            return Effort(*wanted)
        of_group = frames / max(frames, (self.count or frames) - self.done)
        step_s = self._step_seconds
        allowed = max(left, 0.0) * of_group / step_s
        share = min(1.0, allowed / (frames * sum(wanted[1:]) + fresh * steps))
        first, following, epochs = (max(1, round(share * value)) for value in wanted)
        return Effort(first, following, epochs, first * step_s, following * step_s)

    @cached_property
    def _step_seconds(self) -> float:
        """Of a step of one frame, about: those of the first steps of a fit."""
        loop = FitLoop(self.picture.copy(), self.settings, opened=lambda *_, **__: self.engine)
        began = time.perf_counter()
        for _ in range(MEASURED_STEPS):
            loop.advance()
        return OVERHEAD * (time.perf_counter() - began) / MEASURED_STEPS

    def _tell(self, stage: str, frames: float) -> None:
        work().at(stage, min(1.0, (self.done + frames) / self.count) if self.count else 0.0)


@dataclass(eq=False)
class FrameGroup:
    """pictures: (H, W, C) float32. times: when each begins, s. end: of the last, s. after_cut: it is after a cut."""

    after_cut: bool
    pictures: list[np.ndarray] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    end: float = 0.0


def groups(frames: Iterable[tuple[np.ndarray, float, float]], most: int) -> Iterator[FrameGroup]:
    """Groups of at most so many frames. frames: pictures (H, W, C), and the seconds of their begin and end."""
    recent: deque[float] = deque(maxlen=REMEMBERED)
    group, before = FrameGroup(after_cut=True), None
    for picture, begin, end in frames:
        blocks = _blocks(picture)
        jump = 0.0 if before is None else float(np.abs(blocks - before).mean())
        cut = jump > max(LEAST_JUMP, JUMP * max(recent, default=0.0))
        if cut or len(group.pictures) == most:
            yield group
            group = FrameGroup(after_cut=cut)
        recent.append(jump)
        if cut:
            recent.clear()
        before = blocks
        group.pictures.append(picture)
        group.times.append(begin)
        group.end = end
    if group.pictures:
        yield group


def _blocks(picture: np.ndarray) -> np.ndarray:
    """Means of about square blocks, `BLOCKS` along the longer side."""
    side = -(-max(picture.shape[:2]) // BLOCKS)
    planes = (Image.fromarray(np.ascontiguousarray(plane)) for plane in np.moveaxis(picture, 2, 0))
    return np.stack([np.asarray(plane.reduce(side)) for plane in planes], axis=2)
