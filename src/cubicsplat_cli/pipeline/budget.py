"""The most curves that fit into a number of bytes, or the fewest that reach a PSNR, within one fit.

The fit starts with a guess. At some steps a trial SVG is written or rendered: its size tells the bytes of a curve, its
PSNR the missing dB. Then the least important curves are removed, or new ones added. Nearly all surplus curves go before
the exact finish, so that the finish optimises the curves of the file.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.files.read import packed
from cubicsplat_cli.photo.inputs import FitInputs, FitResult
from cubicsplat_cli.photo.remote import RemoteFit, begin_fit
from cubicsplat_cli.pipeline.likeness import file_db
from cubicsplat_cli.pipeline.task import Task
from cubicsplat_cli.record import record
from cubicsplat_cli.request import PHOTO_PRECISION, Request
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import LEAST_PIXELS_PER_CURVE, FitSettings

if TYPE_CHECKING:
    from cubicsplat_cli.photo.loop import FitLoop

# All measured on Kodak photos, docs/lab/photos.md.
BYTES_PRECISION = 1  # decimals; at equal bytes none or two are worse
SHARED_OPACITY = 0.78  # at first, under a limit of bytes: an opacity of its own would take 20 of a curve's 105 bytes
COMPRESSED = 0.45  # share of a file that gzip leaves
MIDWAY = 0.3  # of the steps before the exact finish
SPARE, SPARE_AT_FINISH = 1.15, 1.01  # times the sufficient curves, before the finish and from then on
# The shares of the steps before the finish at which the level is measured, and by how many dB it then rises to the end.
LOOKS = ((0.15, 3.9), (0.4, 2.0), (0.65, 1.0), (0.9, 0.55))
DB_PER_DOUBLING = 1.4
BEGINNING = 256  # curves of a fit that is to reach a level
AIM = 0.35  # dB above the requested level: at the last look the rise is uncertain by 0.16 dB (standard deviation)
MOST_GROWTH = 8.0  # times the curves, at one look
# Further fits after the first; their share of its steps; the least growth of the curves: less would gain nothing.
ROUNDS, ROUND_SHARE, LEAST_GROWTH = 2, 0.5, 1.3


@record
class Photo:
    """The fits of one picture. rough: it, or a copy of another size, for most of a fit. fine: for the exact finish."""

    task: Task
    rough: Picture
    fine: Picture

    @cached_property
    def inputs(self) -> FitInputs:
        """Return the inputs of fits to the fine picture."""
        request = self.task.request
        start = None if request.init is None else request.init.scene
        return FitInputs(self.task.weights(self.fine), start, request.freeze)

    def begin(self, settings: FitSettings, start: Scene | None = None) -> FitLoop | RemoteFit:
        """Begin a fit that runs in parts; from the curves of a scene on, if given, to the fine picture alone."""
        task, inputs = self.task, self.inputs
        if start is not None:
            inputs = replace(inputs, start=start)
        elif self.rough is not self.fine:
            inputs = replace(inputs, rough=(self.rough.target(), FitInputs(task.weights(self.rough))))
        return begin_fit(self.fine.target(), settings, inputs, task.on_progress, task.recorder)

    def writer(self, scene: Scene) -> Callable[..., str]:
        """Return a function that writes the SVG of a scene, at the picture's size, for a title and a comment."""
        from cubicsplat_cli.svg.scene_writer import write_svg

        request, sized = self.task.request, scene.scaled(*self.task.picture.size)
        return partial(write_svg, sized, precision=file_precision(request), shapes=request.settings.shapes)

    def size(self, scene: Scene) -> int:
        """Return the bytes of a scene's file."""
        return len(packed(self.task.text(self.writer(scene)), compressed=self.task.request.counts_compressed))

    def level(self, scene: Scene) -> float:
        """Return the PSNR of a scene's file in dB."""
        return file_db(self.task, self.task.text(self.writer(scene)))

    def importance(self, scene: Scene) -> tuple[float, np.ndarray]:
        """Return the loss, and (N,) by how much it would rise without each curve."""
        from cubicsplat_cli.raster.engines import leave_one_out_importance

        settings, target = self.task.request.settings, self.fine.target()
        sized = scene.scaled(*target.shape[1::-1])  # of a fit that ended early, it has the rough one's size
        return leave_one_out_importance(sized, target, self.inputs.weights, settings.finish_samples, settings.threads)


def within_bytes(most: int, settings: FitSettings, photo: Photo) -> FitResult:
    """Fit the best picture in `most` bytes. settings: of about as many curves. Raises InputError if not one fits."""
    fitting = photo.begin(settings)
    for share, spare in ((MIDWAY, SPARE), (1.0, SPARE_AT_FINISH)):
        if not fitting.relax(share):
            break
        scene = fitting.scene()
        order, count = _fitting_curves(scene, fitting.importance(), most, photo)
        target = max(1, math.ceil(spare * count))
        kept = order[:target]
        # New curves come midway only: the finish is too short for them.
        fitting.resize(kept, target if share < 1.0 else len(kept))
    fitted = fitting.finish()
    scene = fitted.scene
    if photo.size(scene) <= most:
        return fitted
    order, _ = _fitting_curves(scene, photo.importance(scene)[1], most, photo)
    count = bisect_right(range(1, scene.curves + 1), most, key=lambda n: photo.size(_kept(scene, order, n)))
    return _trimmed(fitted, order, count)


def file_precision(request: Request) -> int:
    """Return the decimals of a photo's file."""
    usual = PHOTO_PRECISION if request.max_bytes is None else BYTES_PRECISION
    return usual if request.precision is None else request.precision


def _fitting_curves(scene: Scene, importance: np.ndarray, most: int, photo: Photo) -> tuple[np.ndarray, float]:
    """Return the curves by their use for a byte, the best first, and how many the file holds, maybe more than all."""
    from cubicsplat_cli.svg.scene_writer import bytes_by_curve

    use = importance.astype(np.float64) / bytes_by_curve(scene, file_precision(photo.task.request))
    order = np.argsort(-use, kind="stable")
    size, head = photo.size(scene), photo.size(scene.chosen(order[:1]))
    if head > most:
        raise InputError(f"not even one curve fits into {most} bytes; allow at least {head}")
    bytes_per_curve = max(1.0, (size - head) / max(1, scene.curves - 1))
    return order, 1 + (most - head) / bytes_per_curve


def within_level(least: float, settings: FitSettings, photo: Photo) -> FitResult:
    """Fit the fewest curves whose file has `least` dB; a note gives the level if that is out of reach."""
    pixels = min(picture.width * picture.height for picture in (photo.task.target, photo.fine))
    limit = max(1, min(1_000_000, pixels // LEAST_PIXELS_PER_CURVE))
    fitting = photo.begin(settings.with_(curves=min(limit, BEGINNING)))
    for share, rise in LOOKS:
        if not fitting.relax(share):
            break
        scene = fitting.scene()
        target = _grown(scene.curves, least + AIM - photo.level(scene) - rise, limit)
        fitting.resize(np.argsort(-fitting.importance(), kind="stable")[:target], target)
    fitted = fitting.finish()
    level = photo.level(fitted.scene)
    for number in range(ROUNDS):
        if level >= least or fitted.interrupted or settings.time_limit is not None:
            break
        more = settings.with_(
            steps=max(1, round(ROUND_SHARE * settings.steps)),
            curves=_grown(math.ceil(LEAST_GROWTH * fitted.scene.curves), least - level, limit),
            seed=(settings.seed + 1 + number) % 2**31,
        )
        fitted = _joined(fitted, photo.begin(more, fitted.scene).finish())
        level = photo.level(fitted.scene)
    if level < least:
        hint = "more --steps" if settings.time_limit is None else "a longer --time-limit"
        note = f"reached {level:.2f} dB of the {least:g} dB asked for; allow {hint}"
        return replace(fitted, notes=[*fitted.notes, note])
    scene = fitted.scene
    order, counts = np.argsort(-photo.importance(scene)[1], kind="stable"), range(scene.curves - 1, 0, -1)
    spared = bisect_left(counts, True, key=lambda count: photo.level(_kept(scene, order, count)) < least)
    return _trimmed(fitted, order, scene.curves - spared)


def _grown(curves: int, missing: float, limit: int) -> int:
    """Return the number of curves that give `missing` dB more than these, at most `limit`."""
    factor = min(MOST_GROWTH, 2.0 ** (missing / DB_PER_DOUBLING))
    return max(1, min(limit, math.ceil(factor * curves)))


def guessed_curves(most: int, segments: int, request: Request) -> int:
    """Return about how many curves of so many segments a file of `most` bytes holds, and a few more."""
    whole = most / (COMPRESSED if request.counts_compressed else 1.0)
    return max(1, min(1_000_000, int(SPARE * whole / (28 + (3.0 + file_precision(request)) * (2 + 6 * segments)))))


def _kept(scene: Scene, order: np.ndarray, count: int) -> Scene:
    """Return the first `count` curves of an order, arranged as in the scene."""
    return scene.chosen(np.sort(order[:count]))


def _trimmed(fitted: FitResult, order: np.ndarray, count: int) -> FitResult:
    dropped = fitted.dropped + fitted.scene.curves - count
    return replace(fitted, scene=_kept(fitted.scene, order, count), dropped=dropped)


def _joined(first: FitResult, second: FitResult) -> FitResult:
    """Return two successive fits as one."""
    steps, seconds = first.steps + second.steps, first.fit_s + second.fit_s
    later = [
        {**entry, "step": entry["step"] + first.steps, "seconds": round(entry["seconds"] + first.fit_s, 3)}
        for entry in second.history
    ]
    return replace(
        second, steps=steps, fit_s=seconds, ms_per_step=1e3 * seconds / max(1, steps), history=[*first.history, *later],
        replaced=first.replaced + second.replaced, notes=list(dict.fromkeys([*first.notes, *second.notes])),
    )  # fmt: skip
