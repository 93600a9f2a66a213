"""The photo style: curves that blend, fitted to the picture, within a budget where one is given."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.evaluate.images import of_pixels
from cubicsplat_cli.evaluate.metrics import measurable, psnr_db
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.load import Picture, resize_picture
from cubicsplat_cli.files.read import packed
from cubicsplat_cli.metrics import Timing
from cubicsplat_cli.pipeline.budget import (
    BYTES_PRECISION,
    COMPRESSED,
    LOOKS,
    SHARED_OPACITY,
    Within,
    guessed_curves,
    within_bytes,
    within_level,
)
from cubicsplat_cli.pipeline.task import Made, Task
from cubicsplat_cli.progress import nothing
from cubicsplat_cli.request import PHOTO_PRECISION, Request
from cubicsplat_cli.scene import Scene, scaled_scene
from cubicsplat_cli.settings import USUAL_CURVES, FitSettings
from cubicsplat_cli.svg import write_svg

if TYPE_CHECKING:
    from cubicsplat_cli.photo import FitInputs, FitResult, Fitting


# The pixels for each curve of the copy on which most of a fit is done, and how much larger the sides of that are on
# which it is finished. Within 0.1 dB of a fit to the picture itself: see docs/lab/cpu.md.
ROUGH_PIXELS_PER_CURVE = 1536
FINISH_SCALE = 3


def fitted_photo(task: Task, on_look: Callable[[Scene, float], None] = nothing) -> Made:
    """Curves that blend, fitted to the picture.

    on_look: given the curves early in a fit that no bytes or level bound, and by how many dB their level usually rises
    from there to the end; what it raises ends the fit.
    """
    request, settings = task.request, _with_curves(task)
    rough, fine = copies_of(task.target, settings)
    # A drawing to begin with is as fine as it is.
    photo = Photo(task, fine if request.init is not None else rough, fine)
    within = _within(photo, settings, on_look)
    fitted = within.fitted
    notes = [] if request.init is None else list(request.init.notes)
    notes += fitted_on(task.target, photo.rough, fine)
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


@dataclass(frozen=True, eq=False)
class Photo:
    """The fits of one picture, and the files of their scenes.

    rough, fine: what most of a fit is done on, and what its exact finish.
    """

    task: Task
    rough: Picture
    fine: Picture

    @cached_property
    def inputs(self) -> FitInputs:
        """The inputs of fits to the fine picture."""
        from cubicsplat_cli.photo import FitInputs

        request = self.task.request
        start = None if request.init is None else request.init.scene
        return FitInputs(self.task.weights(self.fine), start, request.freeze)

    def begin(self, settings: FitSettings) -> Fitting:
        """A fit in parts."""
        from cubicsplat_cli.photo import FitInputs, Fitting

        task, rough = self.task, None
        if self.rough is not self.fine:
            rough = self.rough.target(), FitInputs(task.weights(self.rough))
        return Fitting(self.fine.target(), settings, task.on_progress, task.recorder, self.inputs, rough)

    def refine(self, scene: Scene, settings: FitSettings) -> FitResult:
        """A fit that begins with a scene."""
        from cubicsplat_cli.photo import fit

        task, inputs = self.task, replace(self.inputs, start=scene)
        return fit(self.fine.target(), settings, task.on_progress, task.recorder, inputs)

    def size(self, scene: Scene) -> int:
        """Bytes of the file."""
        request = self.task.request
        return len(packed(self.task.text(scene, _precision(request)), compressed=request.compress))

    @cached_property
    def _reference(self) -> Picture:
        return measurable(self.task.picture, math.inf)

    def level(self, scene: Scene) -> float:
        """PSNR of the file in dB."""
        request, reference = self.task.request, self._reference
        text = self.task.text(scene, _precision(request))
        drawn = rerender(text.encode(), reference.width, reference.height)
        level = psnr_db(reference, of_pixels(drawn.pixels), request.settings.threads)
        return math.inf if level is None else level

    def importance(self, scene: Scene) -> tuple[float, np.ndarray]:
        """The loss, and (N,) by how much it would rise without each curve."""
        from cubicsplat_cli.raster.draw import leave_one_out_importance

        settings, weights = self.task.request.settings, self.inputs.weights
        return leave_one_out_importance(scene, self.fine.target(), weights, settings.finish_samples, settings.threads)


def _within(photo: Photo, settings: FitSettings, on_look: Callable[[Scene, float], None]) -> Within:
    """One fit, or those that meet the budget that was asked for."""
    request, target = photo.task.request, photo.fine
    if request.max_bytes is not None:
        return within_bytes(request.max_bytes, _one_opacity(settings, target), _precision(request), photo)
    if request.target_psnr is not None:
        return within_level(request.target_psnr, settings, photo, target.width * target.height)
    fitting, (share, rise) = photo.begin(settings), LOOKS[0]
    if on_look is not nothing and fitting.relax(share):
        on_look(fitting.scene(), rise)
    return Within(fitting.finish(), [])


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
