"""The photo style: curves that blend, fitted to the picture, within a budget where one is given."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.evaluate.images import of_pixels
from cubicsplat_cli.evaluate.metrics import measurable, psnr_db
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.files.read import packed
from cubicsplat_cli.pipeline.budget import (
    BYTES_PRECISION,
    COMPRESSED,
    SHARED_OPACITY,
    Means,
    Within,
    guessed_curves,
    within_bytes,
    within_level,
)
from cubicsplat_cli.pipeline.copies import copies_of, fitted_on
from cubicsplat_cli.pipeline.task import Made, Task
from cubicsplat_cli.report import Timing
from cubicsplat_cli.request import PHOTO_PRECISION, Request
from cubicsplat_cli.scene import Scene, scaled_scene
from cubicsplat_cli.settings import FitSettings
from cubicsplat_cli.svg import write_svg

if TYPE_CHECKING:
    from cubicsplat_cli.photo import FitResult, Resizing


def fitted_photo(task: Task) -> Made:
    """Curves that blend, fitted to the picture."""
    from cubicsplat_cli.photo import Guide, fit

    request, settings = task.request, _with_curves(task)
    start = None if request.init is None else request.init.scene
    rough, fine = copies_of(task.target, settings)
    # A drawing to begin with is as fine as it is.
    begun = None if rough is fine or start is not None else (rough.target(), Guide(task.weights(rough)))
    guide = Guide(task.weights(fine), start, request.freeze)
    pixels = fine.target()

    def fit_from(chosen: FitSettings, resizings: Sequence[Resizing], before: Scene | None) -> FitResult:
        if before is None:
            return fit(pixels, chosen, task.on_progress, task.film, guide, begun, resizings)
        return fit(pixels, chosen, task.on_progress, task.film, replace(guide, start=before))

    within = _within(task, fine, settings, guide.weights, fit_from)
    fitted = within.fitted
    notes = [] if request.init is None else list(request.init.notes)
    notes += fitted_on(task.target, rough if begun else fine, fine)
    scene = scaled_scene(fitted.scene, *task.picture.size)
    return Made(
        scene,
        lambda title, comment: write_svg(scene, precision=_precision(request), title=title, comment=comment),
        fitted.samples,
        scene.curves,
        [*notes, *fitted.notes, *within.notes],
        {
            "device": fitted.device,
            "replaced": fitted.replaced,
            "dropped": fitted.dropped,
            "interrupted": fitted.interrupted,
            "history": fitted.history,
            "timing": Timing(0.0, fitted.fit_s, fitted.steps, fitted.ms_per_step),
        },
    )


def _within(
    task: Task, target: Picture, settings: FitSettings, weights: np.ndarray | None,
    fit_from: Callable[[FitSettings, Sequence[Resizing], Scene | None], FitResult],
) -> Within:  # fmt: skip
    """One fit, or those that meet the budget that was asked for."""
    from cubicsplat_cli.raster.worth import worth_of

    request, threads = task.request, settings.threads
    precision = _precision(request)
    if request.max_bytes is None and request.target_psnr is None:
        return Within(fit_from(settings, (), None), [])
    reference = measurable(task.picture, math.inf)

    def level(scene: Scene) -> float:
        drawn = rerender(task.text(scene, precision).encode(), reference.width, reference.height)
        found = psnr_db(reference, of_pixels(drawn.pixels), threads)
        return math.inf if found is None else found

    means = Means(
        fit_from,
        lambda scene: len(packed(task.text(scene, precision), compressed=request.compress)),
        level,
        lambda scene: worth_of(scene, target.target(), weights, settings.finish_samples, threads),
    )
    if request.max_bytes is not None:
        return within_bytes(request.max_bytes, _one_opacity(settings, target), precision, means)
    assert request.target_psnr is not None
    return within_level(request.target_psnr, settings, means, target.width * target.height)


def _precision(request: Request) -> int:
    """The decimals of the file."""
    usual = PHOTO_PRECISION if request.max_bytes is None else BYTES_PRECISION
    return usual if request.precision is None else request.precision


def _one_opacity(settings: FitSettings, target: Picture) -> FitSettings:
    """The settings with one opacity for all curves, unless something shall stay transparent or opaque, or gradients are
    asked for, which say theirs anyway.
    """
    recipe = settings.recipe
    if target.alpha is not None or settings.background == "none" or recipe.opaque or settings.fill != "flat":
        return settings
    return settings.with_(recipe=replace(recipe, shared_opacity=SHARED_OPACITY))


def _with_curves(task: Task) -> FitSettings:
    """The settings with as many curves as were asked for, as the drawing has that the fit begins with, as the bytes are
    for, or as suit the picture.
    """
    settings, request, init = task.settings(), task.request, task.request.init
    if request.max_bytes is not None:
        most = request.max_bytes / (COMPRESSED if request.compress else 1.0)
        return settings.with_(curves=guessed_curves(most, settings.segments, _precision(request)))
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
