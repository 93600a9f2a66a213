"""The photo style: curves that blend, fitted to the picture, and within the request's budget, if any."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.load import Picture, enlarge_picture, resize_picture
from cubicsplat_cli.metrics import Timing
from cubicsplat_cli.photo.inputs import FitResult
from cubicsplat_cli.photo.remote import begin_fit
from cubicsplat_cli.pipeline.artwork import SAMPLES
from cubicsplat_cli.pipeline.budget import LOOKS, SHARED_OPACITY, Photo, guessed_curves, within_bytes, within_level
from cubicsplat_cli.pipeline.likeness import level_db, seen_db
from cubicsplat_cli.pipeline.task import Drawn, Made, Task
from cubicsplat_cli.scene import AnyScene, Scene
from cubicsplat_cli.settings import USUAL_CURVES, FitSettings

# Most of a fit uses a copy of so many pixels for each curve; the exact finish uses one whose sides are this many times
# as long. Both cost less than 0.1 dB: see docs/lab/cpu.md.
ROUGH_PIXELS_PER_CURVE = 1536
FINISH_SCALE = 3
# A small picture is looked at enlarged, and shapes finer than its pixels would then show as scribbles. So its fit uses
# larger copies, with at most so many pixels for each curve, and so many in all. Their sides are so many times as long
# for most of the fit, and at most so many times for the finish. More gain nothing.
ENLARGED_PIXELS_PER_CURVE, MOST_PIXELS = 1152, 768 * 512
ENLARGED, MOST_ENLARGED = 2, 4
QUICK_SIDE, QUICK_STEPS = 192, 300  # of a quick fit: its copy has as many px as a square of such a side; its steps
# Looks at a fit: a share of the steps before the finish, and by how much the level that people see rises from there to
# the end: by 4 to 18 dB from the first one on (15 pictures); later by so many times as much as since the look before.
SEEN_AT = ((0.06, 20.0, 0.0), (0.15, 20.0, 0.0), (0.3, 0.0, 1.9), (0.6, 0.0, 1.5))
BYTES_PER_CURVE, HEADER_BYTES = 170.0, 400  # of a photo at the usual precision
LEAST_BYTES = 5.0  # of a line or cubic in a file


def fitted_photo(task: Task) -> Made:
    """Fit curves that blend to the picture: as many as the request's bytes or level need."""
    request = task.request
    if (PhotoFit,) in task.results:
        return task.once(PhotoFit).finished
    if request.tiny:
        return _tiny_photo(task)
    photo, settings = _prepared(task)
    if request.max_bytes is not None:
        transparent = photo.fine.alpha is not None or settings.background == "none"
        fitted = within_bytes(request.max_bytes, _one_opacity(settings, transparent), photo)
    elif request.target_psnr is not None:
        fitted = within_level(request.target_psnr, settings, photo)
    else:
        fitted = photo.begin(settings).finish()
    return _made_of(photo, fitted)


class PhotoFit:
    """The fit of all curves of a photo without a budget, whose level can be estimated before its end."""

    def __init__(self, task: Task) -> None:
        self._photo, settings = _prepared(task)
        self._fitting = self._photo.begin(settings)
        self._levels: list[float] = []

    def early(self) -> tuple[Drawn, bool]:
        """Fit for a share of the steps, and return the curves; and False if the fit ends before."""
        goes_on = self._fitting.relax(LOOKS[0][0])
        return self._drawn(self._fitting.scene()), goes_on

    def expected(self) -> float:
        """Fit for a share of the steps, and return the level expected at the end, dB; infinite if it ends before."""
        drawn, goes_on = self.early()
        return level_db(self._photo.task, drawn) + LOOKS[0][1] if goes_on else math.inf

    def seen_if_above(self, least: float) -> float:
        """Return the level at the end as people see it; if it is not expected to be above `least`, what is expected.
        Raises the errors of a fit, and KeyboardInterrupt.
        """
        levels = self._levels
        for look, (share, rise, times) in enumerate(SEEN_AT):
            if look == len(levels):
                if not self._fitting.relax(share):
                    break
                levels.append(seen_db(self._photo.task, self._drawn(self._fitting.scene())))
            expected = levels[look] + rise + times * (levels[look] - levels[max(0, look - 1)])
            if expected <= least:
                return expected
        if self.finished.interrupted:
            raise KeyboardInterrupt
        return seen_db(self._photo.task, self._drawn(self.finished.scene))

    def _drawn(self, scene: AnyScene | None) -> Drawn:
        return Drawn(scene, self._photo.task.request.settings.finish_samples)

    @cached_property
    def finished(self) -> Made:
        """The result of the fit, which goes on to its end."""
        return _made_of(self._photo, self._fitting.finish())


def curves_of_equal_bytes(task: Task, drawing: Made) -> int:
    """Return the curves of a photo in as many bytes as a drawing takes, or fewer if it would not fit into the request's
    bytes. The bytes of large drawings are not counted.
    """
    most = max(task.request.settings.curves or 0, USUAL_CURVES)
    if drawing.facts.get("segments", 0) * LEAST_BYTES >= most * BYTES_PER_CURVE:
        return most
    if task.request.max_bytes is not None and not task.request.counts_compressed:
        most = min(most, max(1, int((task.request.max_bytes - HEADER_BYTES) / BYTES_PER_CURVE)))
    return min(max(round(drawing.bytes / BYTES_PER_CURVE), 1), most)


def quick_photo(task: Task, curves: int) -> Drawn:
    """Fit curves in few steps to a small copy of a picture. Raises the errors of a fit, and KeyboardInterrupt."""
    shorter, longer = sorted(task.target.size)
    small = resize_picture(task.target, round(QUICK_SIDE * math.sqrt(longer / shorter))).target()
    fitted = begin_fit(small, task.settings().with_(curves=curves, steps=QUICK_STEPS)).finish()
    if fitted.interrupted:
        raise KeyboardInterrupt
    return Drawn(fitted.scene, SAMPLES)


def _prepared(task: Task) -> tuple[Photo, FitSettings]:
    """Return the fits of a picture, and their settings."""
    settings = photo_settings(task)
    rough, fine = copies_of(task.target, settings)
    # An initial drawing has all its detail already.
    return Photo(task, rough if task.request.init is None else fine, fine), settings


def _made_of(photo: Photo, fitted: FitResult) -> Made:
    """Return a fit as a result, with notes on the initial drawing and on the smaller copies that were fitted."""
    picture, rough, fine, init = photo.task.target, photo.rough, photo.fine, photo.task.request.init
    notes = [] if init is None else list(init.notes)
    if rough.width < picture.width:
        finish = "" if rough is fine else f", with the exact finish at {fine.width} x {fine.height}"
        notes.append(f"fitted on a copy of {rough.width} x {rough.height} pixels{finish}")
    scene = fitted.scene.scaled(*photo.task.picture.size)
    return _result(scene, photo.writer(scene), replace(fitted, notes=[*notes, *fitted.notes]))


def _result(scene: Scene, write: Callable[..., str], fitted: FitResult) -> Made:
    facts = {
        "device": fitted.device,
        "replaced": fitted.replaced,
        "dropped": fitted.dropped,
        "history": fitted.history,
        "timing": Timing(0.0, fitted.fit_s, fitted.steps, fitted.ms_per_step),
    }
    return Made(scene, fitted.samples, write, scene.curves, fitted.notes, facts, interrupted=fitted.interrupted)


def _tiny_photo(task: Task) -> Made:
    """Fit polygons on a coarse grid, whose file holds nothing else."""
    from cubicsplat_cli.pipeline.tiny import fitted_polygons

    most = task.request.max_bytes
    assert most is not None
    polygons, fitted = fitted_polygons(most, _one_opacity(task.settings(), transparent=False), task)
    return _result(polygons.scene(*task.picture.size), lambda **_: polygons.text(), fitted)


def _one_opacity(settings: FitSettings, transparent: bool) -> FitSettings:
    """Return the settings with one opacity for all curves, unless parts must stay transparent or opaque, or fills are
    gradients, whose stops have opacities in any case.
    """
    recipe = settings.recipe
    if transparent or recipe.opaque or settings.fill != "flat":
        return settings
    return settings.with_(recipe=replace(recipe, shared_opacity=SHARED_OPACITY))


def photo_settings(task: Task) -> FitSettings:
    """Return the settings with a number of curves: of the request, the initial drawing, the bytes, or the size."""
    settings, request, init = task.settings(), task.request, task.request.init
    if request.max_bytes is not None:
        return settings.with_(curves=guessed_curves(request.max_bytes, settings.segments, request))
    usual = settings.for_size(*task.target.size)
    if init is None:
        return usual
    init.check_shape(*task.picture.size)
    if request.freeze and usual.curves <= init.scene.curves:
        text = f"the drawing's {init.scene.curves} curves are frozen"
        raise UsageError(f"{text}, so that --curves {usual.curves} leaves none to add; ask for more")
    return usual if request.freeze or settings.curves is not None else settings.with_(curves=init.scene.curves)


def copies_of(picture: Picture, settings: FitSettings) -> tuple[Picture, Picture]:
    """Return the pictures for most of a fit and for its exact finish: copies of a large one, enlarged copies of a
    small one of many curves, or the same one twice.

    A recipe whose lengths are fractions of the canvas is a published one, and works on the picture.
    """
    if settings.recipe.length_unit == "canvas" or settings.recipe.finish == 0.0:
        return picture, picture
    rough = _with_pixels(picture, ROUGH_PIXELS_PER_CURVE * max(settings.curves, USUAL_CURVES))
    if rough is not picture:
        return rough, _with_pixels(picture, FINISH_SCALE**2 * rough.width * rough.height)
    most = min(ENLARGED_PIXELS_PER_CURVE * settings.curves, MOST_PIXELS)
    factor = min(MOST_ENLARGED, math.isqrt(most // (picture.width * picture.height)))
    if factor < ENLARGED:
        return picture, picture
    rough = enlarge_picture(picture, ENLARGED)
    return rough, rough if factor == ENLARGED else enlarge_picture(picture, factor)


def _with_pixels(picture: Picture, enough: int) -> Picture:
    """Return the picture, or a copy of `enough` pixels if it has more than 1.5 times as many."""
    pixels = picture.width * picture.height
    if 2 * pixels <= 3 * enough:
        return picture
    return resize_picture(picture, max(1, round(max(picture.size) * math.sqrt(enough / pixels))))
