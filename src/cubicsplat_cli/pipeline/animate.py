"""One clip through the stages: frames -> fit or drawings -> animated SVG, Lottie or frames -> figures."""

from __future__ import annotations

import gzip
import math
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from cubicsplat_cli.artwork.moving import moving_drawing
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.artwork.style import ARTWORK, PHOTO, Style, choose_style
from cubicsplat_cli.clip_request import AUTO, LOTTIE, ClipInput, ClipOutput, ClipQuality, ClipReport
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.metrics import psnr_db
from cubicsplat_cli.files.clips import Frame
from cubicsplat_cli.files.marks import sha256_of, with_checksum
from cubicsplat_cli.formatting import counted, mean
from cubicsplat_cli.motion.fitting import fit_clip
from cubicsplat_cli.motion.tracks import Tracks
from cubicsplat_cli.options import GzipBytes
from cubicsplat_cli.pipeline.animation import Animation, ClipTask, CurvesAnimation, DrawnAnimation
from cubicsplat_cli.progress import OnProgress, Progress, StageTimer, Stopped, Work, nothing, under_way
from cubicsplat_cli.request import NONE, Request
from cubicsplat_cli.settings import FitSettings, cpu_count
from cubicsplat_cli.svg.moving import shown_at, to_grid_clip
from cubicsplat_cli.svg.moving_file import write_clip, write_moving_drawing

# A budget of bytes after gzip: the most fits; the share of the bytes for still curves, at first; the bytes of a curve,
# with those that come and go in its place; the share of a file that gzip leaves.
FITS, STANDING, CURVE_BYTES, COMPRESSED = 4, 0.3, 100.0, 0.36
# Steps of the grid by which paths may be off when knots are removed to save bytes, and after the last fit; the number
# of values up to these; the share of the bytes that a further fit aims at; the most curves, as a multiple of the usual
# number; the share of the bytes from which on no further fit is made.
MOST_OFF, LAST_OFF, OFFS, AGAIN, DENSE, FULL = 2.0, 20.0, 65, 0.9, 4, 0.8


def animate_clip(task: ClipTask, write: Callable[[Animation], None] = nothing) -> Animation:
    """Make an animation of a clip, and measure its file.

    write: is given the animation before it is measured. A Ctrl-C ends the work with the frames so far. Raises
    EngineError if the engine fails, and the errors of reading the clip's frames.
    """
    with task.timer("fit"):
        style = style_of(task)
        work = Work(task.on_progress, task.deadline, task.request.settings.threads or cpu_count())
        animation = drawn_clip(task, work) if style.name == ARTWORK else fitted_clip(task, work)
    with task.timer("write"):
        write(animation)
    with task.timer("measure"):
        quality, end = _quality(animation, task, task.played(style.name))
    return replace(animation, report=_report(animation, task, style, quality, end, interrupted=work.interrupted))


def style_of(task: ClipTask) -> Style:
    """Return the requested style, or the one that suits the first frame: a drawing, unless a photo of it is nearer.

    A photo is not tried if all pixels are either opaque or clear, as in a GIF: the error at such edges would decide.
    """
    if task.request.style != AUTO:
        return Style(task.request.style, "asked for")
    if task.request.format == LOTTIE or task.request.max_bytes is not None:
        return Style(PHOTO, "asked for by the format" if task.request.format == LOTTIE else "asked for by max_bytes")
    first = next(task.frames()).picture
    target = first.target()
    style = choose_style(target)
    if style.name == PHOTO:
        return style
    if style.name != ARTWORK or (target.shape[2] == 4 and np.unique(target[..., 3]).tolist() == [0.0, 1.0]):
        return Style(ARTWORK, style.reason)
    from cubicsplat_cli.pipeline.choose import candidates
    from cubicsplat_cli.pipeline.vectorize import task_of

    settings, limit = task.request.settings, task.request.settings.time_limit
    limited = settings.with_(curves=None, time_limit=None if limit is None else 0.25 * limit)
    alone = Request(limited, measure=False, photo_parts=NONE)  # photographs in a page would not move
    *_, made = candidates(task_of(first, alone, StageTimer()), style)
    if made.interrupted:
        raise KeyboardInterrupt
    return made.style


def _fit(task: ClipTask, work: Work, settings: FitSettings, bytes_per_second: float = math.inf) -> list[Tracks]:
    frames = ((task.pixels(frame), frame.begin, frame.end) for frame in task.held_frames())
    precision = task.request.precision
    try:
        with under_way(work):
            return fit_clip(frames, settings, task.source.count, precision=precision, bytes_per_second=bytes_per_second)
    except Stopped:
        if work.interrupted:
            raise KeyboardInterrupt from None
        raise InputError("the time limit was up before the first frame was fitted; allow more") from None


def _animation(clip: list[Tracks], task: ClipTask, off: float = 0.5) -> CurvesAnimation:
    """Return the animation of a fitted clip. off: see `to_grid_clip`."""
    grid, plays = to_grid_clip(clip, task.request.precision, off), task.request.plays(task.source.plays)
    svg = with_checksum(write_clip(grid, title=task.title, comment=task.comment, plays=plays))
    start = float(clip[0].times[0])
    begins = np.concatenate([group.times for group in clip]) - start
    exact = np.concatenate([shown_at(group) for group in clip]) - start
    return CurvesAnimation(svg, begins, exact, grid.duration, plays, task.title, task.comment, grid)


def fitted_clip(task: ClipTask, work: Work) -> Animation:
    """Fit moving curves to the frames, as near as they come within the request's bytes, if any.

    The first fit has so few curves that most of the bytes are left to their motion. A file that is too large loses the
    least important knots. If that would show, or if bytes are left, another fit has fewer or more curves. Raises
    InputError if even a few curves are too many.
    """
    most = task.request.max_bytes
    if most is None:
        return _animation(_fit(task, work, task.request.settings), task)
    seconds = deque(task.held_frames(), maxlen=1)[0].end
    room = most * (1.0 if isinstance(most, GzipBytes) else COMPRESSED)
    dense = DENSE * task.request.settings.for_size(task.source.width, task.source.height).curves
    within: list[tuple[float, Animation]] = []
    for turn in range(FITS):
        curves = max(1, min(dense, round(STANDING * room / CURVE_BYTES)))
        clip = _fit(task, work, task.request.settings.with_(curves=curves), room / seconds)
        animation = _animation(clip, task)
        size, last = _size(animation, task), turn == FITS - 1 or work.stopped
        made = animation if size <= most else _thinned(most, clip, task, LAST_OFF if last and not within else MOST_OFF)
        if made is not None:
            level = _quality(made, task, task.held_frames())[0].psnr_db
            within.append((math.inf if level is None else level, made))
        if (size > FULL * most and made is not None) or curves == dense or work.stopped:
            break
        room *= AGAIN * most / size
    if within:
        return max(within, key=lambda candidate: candidate[0])[1]
    if work.stopped:
        return replace(animation, notes=(f"stopped before it fitted into {most:d} bytes",))
    raise InputError(f"{counted(curves, 'curve')} need more than {most:d} bytes; allow more, or take fewer frames")


def _thinned(most: int, clip: list[Tracks], task: ClipTask, most_off: float) -> Animation | None:
    """Return the animation with as many knots as the bytes hold; None if paths would be off by more than `most_off`."""
    offs = np.geomspace(0.5, most_off, OFFS)[1:-1].tolist()
    place = bisect_left(offs, True, key=lambda off: _size(_animation(clip, task, off), task) <= most)
    return _animation(clip, task, offs[place]) if place < len(offs) else None


def _size(animation: Animation, task: ClipTask) -> int:
    """Return the bytes of all files, after gzip if the request counts these."""
    packed = isinstance(task.request.max_bytes, GzipBytes)
    return sum(len(gzip.compress(data, mtime=0) if packed else data) for data in animation.files(task.format).values())


def drawn_clip(task: ClipTask, work: Work) -> Animation:
    """Draw the frames as shapes that stand still, move, or are shown in some frames only."""
    spans: list[tuple[float, float]] = []
    moving = moving_drawing(_drawings(task, work, spans))
    plays, (starts, ends) = task.request.plays(task.source.plays), np.array(spans).T
    duration, middles = spans[-1][1], (starts + ends) / 2.0
    text = write_moving_drawing(moving, starts, duration, title=task.title, comment=task.comment, plays=plays)
    return DrawnAnimation(with_checksum(text), starts, middles, duration, plays, moving)


def _drawings(task: ClipTask, work: Work, spans: list[tuple[float, float]]) -> Iterator[Drawing]:
    """Yield the drawing of each frame until the work is stopped; the first one in any case. spans: gets their times."""
    from cubicsplat_cli.artwork.vectorize import draw

    chosen, before = ArtworkSettings(strokes=False, curves=task.request.settings.curves), None
    for index, frame in enumerate(task.frames()):
        target = frame.picture.target()
        if before is None or not np.array_equal(before[0], target):
            one = Work(_of_frame(task, index), work.deadline, work.threads)
            with under_way(one):
                drawing = draw(target, chosen)
            work.interrupted |= one.interrupted
            work.stopped |= one.stopped
            if work.stopped and before is not None:
                return
            before = target, drawing
        spans.append((frame.begin, frame.end))
        yield before[1]
        if work.stopped:
            return


def _of_frame(task: ClipTask, index: int) -> OnProgress:
    """Return a function that reports the progress of a frame's drawing as progress of the clip."""
    count, tell = task.source.count or 0, task.on_progress or nothing

    def report(progress: Progress) -> None:
        share = (index + progress.share) / count if count else 0.0
        tell(replace(progress, share=share, seconds_left=math.inf, stage=f"frame {index + 1}, {progress.stage}"))

    return report


def _quality(animation: Animation, task: ClipTask, frames: Iterator[Frame]) -> tuple[ClipQuality, float]:
    """Return the quality of each frame as the file plays it, and the end of the last frame, s."""
    threads, exact = task.request.settings.threads, animation.exact.tolist()
    frames, pictures = islice(frames, len(exact)), animation.pictures(task.format, threads)
    levels: list[dict[str, float | None]] = []
    end = 0.0
    for at, frame, picture in zip(exact, frames, pictures, strict=True):
        levels.append({"time_s": at, "psnr_db": psnr_db(frame.picture, picture, threads)})
        end = frame.end
    finite = [level["psnr_db"] for level in levels if level["psnr_db"] is not None]
    return ClipQuality(mean(finite), min(finite, default=None), levels), end


def _report(
    animation: Animation, task: ClipTask, style: Style, quality: ClipQuality, end: float, *, interrupted: bool
) -> ClipReport:
    source, seconds, count = task.source, task.timer.seconds, len(quality.frames)
    files = list(animation.files(task.format).values())
    data, compressed = b"".join(files), sum(len(gzip.compress(file, mtime=0)) for file in files)
    return ClipReport(
        ClipInput(
            source.name, source.sha256, source.width, source.height, source.transparent, count, end, source.plays
        ),
        ClipOutput(task.format, len(data), compressed, sha256_of(data), *animation.counts),
        task.request.deciding(),
        task.request.digest(),
        style.name,
        style.reason,
        {"name": "cpu"},
        {"total_s": task.timer.total(), "fit_s": seconds["fit"], "frame_s": seconds["fit"] / count},
        quality,
        interrupted,
        [*animation.notes],
    )
