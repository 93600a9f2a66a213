"""The photo style: curves that blend, fitted to the picture, within a budget where one is given."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.load import Picture, resize_picture
from cubicsplat_cli.metrics import Timing
from cubicsplat_cli.pipeline.budget import (
    COMPRESSED,
    LOOKS,
    SHARED_OPACITY,
    Photo,
    file_precision,
    guessed_curves,
    within_bytes,
    within_level,
)
from cubicsplat_cli.pipeline.likeness import level_db
from cubicsplat_cli.pipeline.task import Made, Task
from cubicsplat_cli.scene import Scene, scaled_scene
from cubicsplat_cli.settings import USUAL_CURVES, FitSettings

if TYPE_CHECKING:
    from cubicsplat_cli.photo.inputs import FitResult

# The pixels for each curve of the copy on which most of a fit is done, and how much larger the sides of that are on
# which it is finished. Within 0.1 dB of a fit to the picture itself: see docs/lab/cpu.md.
ROUGH_PIXELS_PER_CURVE = 1536
FINISH_SCALE = 3
# Px of the longer side of the copy of a quick fit, and its steps; at which shares of these before the finish its level
# is looked at, and by how many dB it rises from there to the end at most, as it does for airbrush: by half for photos.
QUICK_SIDE, QUICK_STEPS = 192, 300
QUICK_LOOKS = ((0.15, 11.0), (0.4, 6.0), (0.65, 3.0), (1.0, 0.0))
FEWEST = 8  # curves of a quick fit; it has no more than the photo would
BYTES_PER_CURVE = 170.0  # at the usual precision
LEAST_BYTES = 5.0  # of a line or cubic in a file


def fitted_photo(task: Task) -> Made:
    """Curves that blend, fitted to the picture."""
    if task.request.tiny:
        return _tiny_photo(task)
    photo, settings = _prepared(task)
    return _made_of(photo, _within(photo, settings))


class PhotoFit:
    """The fit of a photo that no bytes or level bound, which can be looked at early on."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._photo, settings = _prepared(task)
        self._fitting = self._photo.begin(settings)

    def early(self) -> tuple[Scene, float] | None:
        """The curves early in the fit, and by how many dB their level usually rises from there to the end; None where
        the fit was ended before.
        """
        share, rise = LOOKS[0]
        return (self._fitting.scene(), rise) if self._fitting.relax(share) else None

    def most(self, least: float) -> float | None:
        """The level that the fit has at most at its end, dB, as soon as that is known to be `least` or less; else None,
        with most of what goes before the exact finish done.
        """
        for share, rise in QUICK_LOOKS[1:-1]:
            if not self._fitting.relax(share):
                return None
            level = level_db(self._task, self._fitting.scene(), self._task.request.settings.finish_samples)
            if level + rise <= least:
                return level + rise
        return None

    def finished(self) -> Made:
        """The result of the whole fit."""
        return _made_of(self._photo, self._fitting.finish())


def curves_of_equal_bytes(task: Task, drawing: Made) -> int:
    """The curves of a photo that takes as many bytes as a drawing; those of large drawings are not counted."""
    most = task.request.settings.curves or USUAL_CURVES
    if drawing.facts.get("segments", 0) * LEAST_BYTES >= most * BYTES_PER_CURVE:
        return most
    size = len(drawing.write(task.title, task.comment()).encode())
    return round(min(max(size / BYTES_PER_CURVE, FEWEST), most))


def is_smaller(task: Task, drawing: Made) -> bool:
    """Whether a drawing takes fewer bytes than the photo would."""
    return curves_of_equal_bytes(task, drawing) < _with_curves(task).curves


class QuickPhoto:
    """A fit of so many curves in few steps to a small copy of a picture, done as far as its level matters.

    level_of: the level of a scene, dB; infinite where it is the picture.
    """

    def __init__(self, task: Task, curves: int, level_of: Callable[[Scene], float]) -> None:
        self._level_of, self._looks, self._most = level_of, list(QUICK_LOOKS), math.inf
        from cubicsplat_cli.photo.loop import FitLoop  # which most drawings do not come to

        small = resize_picture(task.target, QUICK_SIDE).target()
        self._fitting = FitLoop(small, task.settings().with_(curves=curves, steps=QUICK_STEPS))

    def beyond(self, least: float) -> float | None:
        """Its level, dB, infinite where it is the picture; None where that is `least` or less, which may be plain long
        before its end. Raises what a fit raises, and KeyboardInterrupt.
        """
        while self._looks and self._most > least:
            share, rise = self._looks.pop(0)
            scene = self._fitting.scene() if rise and self._fitting.relax(share) else self._end()
            self._most = self._level_of(scene) + rise
        return self._most if self._most > least else None

    def _end(self) -> Scene:
        self._looks.clear()
        fitted = self._fitting.finish()
        if fitted.interrupted:
            raise KeyboardInterrupt
        return fitted.scene


def _prepared(task: Task) -> tuple[Photo, FitSettings]:
    """The fits of a picture, and their settings."""
    settings = _with_curves(task)
    rough, fine = copies_of(task.target, settings)
    # A drawing to begin with is as fine as it is.
    return Photo(task, fine if task.request.init is not None else rough, fine), settings


def _made_of(photo: Photo, fitted: FitResult) -> Made:
    from cubicsplat_cli.svg.scene_writer import write_svg

    task, request = photo.task, photo.task.request
    notes = [] if request.init is None else list(request.init.notes)
    notes += fitted_on(task.target, photo.rough, photo.fine)
    scene = scaled_scene(fitted.scene, *task.picture.size)
    form: dict[str, Any] = {"precision": file_precision(request), "shapes": request.settings.shapes}
    return Made(
        scene,
        lambda title, comment: write_svg(scene, title=title, comment=comment, **form),
        fitted.samples,
        scene.curves,
        [*notes, *fitted.notes],
        _facts(fitted),
    )


def _facts(fitted: FitResult) -> dict[str, Any]:
    """The members of the report that are the fit's."""
    return {
        "device": fitted.device,
        "replaced": fitted.replaced,
        "dropped": fitted.dropped,
        "interrupted": fitted.interrupted,
        "history": fitted.history,
        "timing": Timing(0.0, fitted.fit_s, fitted.steps, fitted.ms_per_step),
    }


def _tiny_photo(task: Task) -> Made:
    """Polygons on a coarse grid, whose file says nothing but them."""
    from cubicsplat_cli.pipeline.tiny import fitted_polygons

    most = task.request.max_bytes
    assert most is not None
    polygons, fitted = fitted_polygons(most, _one_opacity(task.settings(), transparent=False), task)
    scene = polygons.scene(*task.picture.size)
    return Made(scene, lambda _title, _comment: polygons.text(), 1, scene.curves, fitted.notes, _facts(fitted))


def _within(photo: Photo, settings: FitSettings) -> FitResult:
    """One fit, or those that meet the budget that was asked for."""
    request = photo.task.request
    if request.max_bytes is not None:
        transparent = photo.fine.alpha is not None or settings.background == "none"
        return within_bytes(request.max_bytes, _one_opacity(settings, transparent), photo)
    if request.target_psnr is not None:
        return within_level(request.target_psnr, settings, photo)
    return photo.begin(settings).finish()


def _one_opacity(settings: FitSettings, transparent: bool) -> FitSettings:
    """The settings with one opacity for all curves, unless something shall stay transparent or opaque, or gradients are
    asked for, which say theirs anyway.
    """
    recipe = settings.recipe
    if transparent or recipe.opaque or settings.fill != "flat":
        return settings
    return settings.with_(recipe=replace(recipe, shared_opacity=SHARED_OPACITY))


def _with_curves(task: Task) -> FitSettings:
    """The settings with as many curves as were asked for, as the drawing has that the fit begins with, as the bytes are
    for, or as suit the picture.
    """
    settings, request, init = task.settings(), task.request, task.request.init
    if request.max_bytes is not None:
        most = request.max_bytes / (COMPRESSED if request.counts_compressed else 1.0)
        return settings.with_(curves=guessed_curves(most, settings.segments, file_precision(request)))
    if init is None:
        return settings.for_size(*task.target.size)
    init.check_shape(*task.picture.size)
    usual = settings.for_size(*task.target.size)
    if request.freeze:
        if usual.curves <= init.scene.curves:
            raise UsageError(
                f"the drawing's {init.scene.curves} curves are frozen, so that --curves {usual.curves} leaves "
                "none to add; ask for more"
            )
        return usual
    return usual if settings.curves is not None else settings.with_(curves=init.scene.curves)


def fitted_on(picture: Picture, rough: Picture, fine: Picture) -> list[str]:
    """Notes of the report about copies."""
    if fine is picture and rough is picture:
        return []
    finish = "" if rough is fine else f", with the exact finish at {fine.width} x {fine.height}"
    return [f"fitted on a copy of {rough.width} x {rough.height} pixels{finish}"]


def copies_of(picture: Picture, settings: FitSettings) -> tuple[Picture, Picture]:
    """Return the pictures for most of a fit and for its exact finish: copies of a large one, or the same one twice.

    A recipe in fractions of the canvas is a published one, and works on the picture.
    """
    if settings.recipe.length_unit == "canvas" or settings.recipe.finish == 0.0:
        return picture, picture
    rough = _with_pixels(picture, ROUGH_PIXELS_PER_CURVE * max(settings.curves, USUAL_CURVES))
    return rough, picture if rough is picture else _with_pixels(picture, FINISH_SCALE**2 * rough.width * rough.height)


def _with_pixels(picture: Picture, enough: int) -> Picture:
    """The picture, or a copy of so many pixels where it has half as many again: less would save nothing."""
    pixels = picture.width * picture.height
    if 2 * pixels <= 3 * enough:
        return picture
    return resize_picture(picture, max(1, round(max(picture.size) * math.sqrt(enough / pixels))))
