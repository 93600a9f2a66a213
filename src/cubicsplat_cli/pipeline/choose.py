"""Choose between photo and drawing: propose a result of one style, compare it with the other, keep the nearer.

1. `_first` makes the style that is requested, or that `choose_style` measures; in doubt, the drawing. A photo that will
   stay far from its picture is doubtful too. A drawing ends early if a photo or a shaded drawing is nearer
   (`check_worth_finishing`, `_check_beside_photo`).
2. `candidates` yields this result; if that is a drawing, and the photo is nearer, then the photo (`_nearer_photo`).
3. Wherever a photo would be made, a shaded drawing is made instead if no photo of as many bytes is nearer in colour
   (`_shaded_or_photo`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial

from cubicsplat_cli.artwork.style import ARTWORK, PHOTO, PIXEL, Style, choose_style, only_fill
from cubicsplat_cli.errors import CubicSplatError, UsageError
from cubicsplat_cli.evaluate.metrics import decibels
from cubicsplat_cli.formatting import counted, one_line
from cubicsplat_cli.options import listed
from cubicsplat_cli.photo.remote import require_gpu
from cubicsplat_cli.pipeline.artwork import drawn_artwork, drawn_cells, drawn_outlines, drawn_pixels, result_of_one_fill
from cubicsplat_cli.pipeline.likeness import delta_e, seen_db
from cubicsplat_cli.pipeline.pages import drawn_page, page_in
from cubicsplat_cli.pipeline.photo import (
    BYTES_PER_CURVE,
    PhotoFit,
    curves_of_equal_bytes,
    fitted_photo,
    photo_settings,
    quick_photo,
)
from cubicsplat_cli.pipeline.task import TOO_FINE, DrawingGivenUp, Made, Task
from cubicsplat_cli.scene import LayeredScene

ENOUGH_DB = 40.0  # of a drawing that has lost nothing that people see
FAR_DB = 22.0  # a mean error of 8 % of full scale, plain to see
# Shapes can be edited, so only plainly better curves replace them. A quick photo is so far behind a finished one.
MARGIN_DB, QUICK_BEHIND_DB = 1.0, 2.0
QUICK_OFF = 0.6  # the least share of a quick photo's mean CIEDE2000 that a finished one has, of seven pictures
# What its details add to most sketches, and to 11 of 12. A quick photo, too low itself, needs no more than the first.
SKETCH_DB, NEARLY_ALL_DB = 6.0, 9.5
LOST_DB = 32.0  # of a drawing that has lost much of what people see: a mean error of 2.5 % of full scale


# The function of each style. A new one needs a line here, a name in `request.STYLES`, and its file in this package.
MAKERS = {PHOTO: fitted_photo, ARTWORK: drawn_artwork, PIXEL: drawn_pixels}


def candidates(task: Task, style: Style | None = None) -> Iterator[Made]:
    """Yield one or two finished results; the second replaces the first.

    The second comes only with the style "auto": it is a photo that is nearer than the drawing, or the drawing with a
    note on a comparison that failed. style: the result of `choose_style` for the target, if known.
    """
    with task.working():
        made = _first(task, style)
    yield made
    if made.interrupted or not made.may_be_photo or task.seconds_left() <= 0.0:
        return
    with task.working():
        better = _nearer_photo(task, made)
    if better is not made:
        yield better


def _first(task: Task, style: Style | None) -> Made:
    """Make the result of the requested or measured style; if that fails, of the other style."""
    if task.request.settings.device == "cuda":
        require_gpu()  # a drawing would not need one
    if (fill := only_fill(task.picture)) is not None:
        return result_of_one_fill(fill, task)
    if (requested := _requested_style(task)) is not None:
        page, _ = _page(task)
        made = _made(task, requested) if page is None else replace(page, style=requested)
        return replace(made, may_be_photo=False)
    style = style or choose_style(task.pixels, lossy=task.target.compression is not None)
    try:
        if style.cells is not None:
            return replace(drawn_cells(task, style.cells), style=style)
        page, better_drawn = _page(task)
        if page is not None:
            return page
        check = partial(check_worth_finishing, task, or_shaded=True)
        free, far = not task.bounded and task.recorder is None, None  # of what only a photo has
        if style.name == PHOTO and free and not (style.doubtful or better_drawn):
            if (shaded := _shaded_instead(task, style, "no photo of as many bytes is nearer")) is not None:
                return shaded
            if (expected := task.once(PhotoFit).expected()) < FAR_DB:
                far = f"as a photo it has only {expected:.1f} dB"
                style = replace(style, reason=f"{style.reason}, but {far}")
        if free and (style.doubtful or better_drawn or far):
            style, check = replace(style, name=ARTWORK), partial(_check_beside_photo, task)
        if style.name == PHOTO:
            return _made(task, style)
        made = replace(drawn_outlines(task, check), style=style)
        return made.with_note(f"made as artwork: {far}") if far else made
    except DrawingGivenUp as reason:
        return _shaded_or_photo(task, style, str(reason))
    except UsageError:
        raise
    except Exception as error:
        failed = error.with_traceback(None)  # the traceback would keep all arrays in memory
    other = Style(ARTWORK if style.name == PHOTO else PHOTO, f"{style.reason}, but as {style.name} it failed")
    try:
        made = _made(task, other)
    except Exception:
        raise failed from None
    return made.with_note(f"made as {other.name}, since {_failure(style.name, failed)}")


def _page(task: Task) -> tuple[Made | None, bool]:
    """Return the drawing of a page with its photographs, None if the picture is no page, or not worth drawing; and
    whether a part that looks like a photograph is nearer as a drawing.
    """
    suits = list[bool]()

    def suits_photo(part: Task) -> bool:
        suits.append(_suits_photo(part))
        return suits[-1]

    made, page = None, page_in(task, suits_photo)
    if page is not None:
        with suppress(DrawingGivenUp):
            made = drawn_page(task, page, partial(check_worth_finishing, quick=True))
            made = replace(made, style=Style(ARTWORK, f"{page.reason}, off {counted(len(page.parts), 'photograph')}"))
    return made, not all(suits)


def _suits_photo(task: Task) -> bool:
    """True if a photo suits a sample of a picture better than a drawing."""
    try:
        drawing = drawn_outlines(task, partial(check_worth_finishing, task, quick=True), of_few=True)
        if drawing.interrupted:
            raise KeyboardInterrupt
        # Of so few pixels a quick photo is hardly behind a finished one.
        return photo_is_nearer(task, drawing, QUICK_BEHIND_DB, quick=True) is not None
    except DrawingGivenUp:
        return True


def _requested_style(task: Task) -> Style | None:
    """Return the style that is requested by name or by an option of one style."""
    if (name := task.request.style) != "auto":
        return Style(name, "asked for")
    if photo := task.request.of_photos():
        return Style(PHOTO, f"asked for by {listed(photo)}")
    drawn = task.request.of_artwork()
    return Style(ARTWORK, f"asked for by {listed(drawn)}") if drawn else None


def _made(task: Task, style: Style) -> Made:
    """Make the result of a style."""
    make = _drawn_or_shaded if style.name == ARTWORK and task.request.may_shade else MAKERS[style.name]
    return replace(make(task), style=style)


def _drawn_or_shaded(task: Task) -> Made:
    """Make a drawing; or a shaded one, if that is plainly nearer than the drawing, or than its sketch may become."""

    def is_nearer(drawing: Made, rise_db: float = 0.0) -> bool:
        return _shading_is_nearer(task, _shaded, drawing, seen_db(task, drawing, _enough_db(drawing)) + rise_db)

    def check(sketch: Made) -> None:
        if is_nearer(sketch, SKETCH_DB):
            raise DrawingGivenUp
        _check_stop(task)

    with suppress(DrawingGivenUp):
        drawing = drawn_artwork(task, check)
        if not is_nearer(drawing):
            return drawing
    shaded = task.once(_shaded)
    assert shaded is not None
    return shaded


def _shaded(task: Task) -> Made | None:
    """Return the shaded drawing of a picture, if any."""
    from cubicsplat_cli.pipeline.shaded import shaded_drawing  # few pictures need it

    return shaded_drawing(task)


def _check_stop(task: Task) -> None:
    """Raise KeyboardInterrupt, which ends a drawing, if one ended the shaded drawing."""
    made = task.results.get((_shaded,))
    if made is not None and made.interrupted:
        raise KeyboardInterrupt


def _shading_is_nearer(task: Task, shaded: Callable[[Task], Made | None], drawing: Made, drawn_db: float) -> bool:
    """True if a shaded drawing is plainly nearer than a drawing of a level. shaded: makes it, or None."""
    if math.isinf(drawn_db) or not drawing.may_be_photo or drawing.interrupted:
        return False
    from cubicsplat_cli.pipeline.shaded import most_shaded_db

    least_db = drawn_db + MARGIN_DB
    if task.once(most_shaded_db) <= least_db:
        return False
    made = task.once(shaded)
    return made is not None and seen_db(task, made) > least_db


def _shaded_or_photo(task: Task, drawn: Style, reason: str) -> Made:
    """Make the shaded drawing of a picture whose drawing is too far from it, or the photo if that is nearer."""
    photo = Style(PHOTO, f"{drawn.reason}, but {reason}")
    return _shaded_instead(task, drawn, reason) or _made(task, photo).with_note(f"made as photo: {reason}")


def _shaded_instead(task: Task, style: Style, reason: str) -> Made | None:
    """Make the shaded drawing of a picture, with a note; None if a photo of as many bytes is nearer in colour."""
    shaded = task.once(_nearest_shaded)
    if shaded is None:
        return None
    made = replace(shaded, style=Style(ARTWORK, f"{style.reason}, shaded within its outlines"), may_be_photo=False)
    return made.with_note(f"shaded within its outlines: {reason}")


def _nearest_shaded(task: Task) -> Made | None:
    """Return the shaded drawing of a picture, if any; None if a photo of as many bytes is nearer in colour."""
    shaded = task.once(_shaded)
    if shaded is None or shaded.interrupted:
        return shaded
    fit = task.once(quick_photo, min(curves_of_equal_bytes(task, shaded), photo_settings(task).curves))
    off = delta_e(task, shaded)
    return shaded if QUICK_OFF * delta_e(task, fit) >= off else None


def _nearer_photo(task: Task, drawing: Made) -> Made:
    """Return the photo of a picture if it is nearer than the drawing; else the drawing, with a note on a failure."""
    try:
        # Most bytes of a page with photographs are those of their curves.
        page = isinstance(drawing.scene, LayeredScene)
        reason = photo_is_nearer(task, drawing, quick=page, or_shaded=not page)
        if reason is None:
            return drawing
        photo = _shaded_or_photo(task, drawing.style, reason)
        if drawing.facts["shapes"] and not photo.interrupted and _off(task, drawing) <= delta_e(task, photo):
            return drawing
    except Exception as error:
        return drawing.with_note(f"the drawing stays, since {_failure('photo', error)}")
    except KeyboardInterrupt:
        return replace(drawing, interrupted=True)
    return replace(drawing, interrupted=True) if photo.interrupted else photo


def _check_beside_photo(task: Task, sketch: Made) -> None:
    """Raise DrawingGivenUp if a sketch is farther in colour than an early look at the photo's fit: both come nearer."""
    photo, goes_on = task.once(PhotoFit).early()
    if not goes_on or _off(task, sketch) >= delta_e(task, photo):
        raise DrawingGivenUp("an early look at a photo is as near as the drawing's sketch")


def _failure(style: str, error: Exception) -> str:
    """Describe an error to the user; an unexpected one is a bug."""
    if isinstance(error, CubicSplatError):
        return f"{style} failed: {one_line(error)}"
    if isinstance(error, MemoryError):
        return f"there is not enough memory for {style}"
    return f"{style} failed ({type(error).__name__}: {one_line(error)}); this is a bug, please report it"


def _enough_db(drawing: Made) -> float:
    """Return the level of a drawing that has lost nothing, or nothing but noise or steps of its picture; infinite if
    it has lost the softness of shading.
    """
    if drawing.banded:
        return math.inf
    error = drawing.unavoidable_error / 255.0
    return min(ENOUGH_DB, decibels(error**2) - MARGIN_DB) if error else ENOUGH_DB


def _off(task: Task, drawing: Made) -> float:
    """Return the mean CIEDE2000 of a drawing, comparable with that of a photo; see `_gain_of_bytes`."""
    return delta_e(task, drawing) * _gain_of_bytes(task, drawing)


def _gain_of_bytes(task: Task, drawing: Made) -> float:
    """Return by how many times a photo of as many bytes as a drawing is nearer than the photo, if that has fewer.

    The error falls by the cube root of the ratio: 64 times as many curves gain 11.9 dB (docs/quality.md).
    """
    return float(max(1.0, drawing.bytes / (BYTES_PER_CURVE * _usual_curves(task))) ** (1.0 / 3.0))


def check_worth_finishing(task: Task, sketch: Made, *, quick: bool = False, or_shaded: bool = False) -> None:
    """Raise DrawingGivenUp if a photo is nearer than the drawing can become. All else is as of `photo_is_nearer`."""
    if reason := photo_is_nearer(task, sketch, SKETCH_DB, quick=quick, or_shaded=or_shaded):
        raise DrawingGivenUp(reason)
    _check_stop(task)


def photo_is_nearer(
    task: Task, drawing: Made, rise_db: float = 0.0, *, quick: bool = False, or_shaded: bool = False
) -> str | None:
    """Return why a photo suits the picture better than its drawing; None if it does not.

    rise_db: by how much the level of the drawing may still rise. quick: compare it with a quick photo even if the whole
    one has no more bytes. or_shaded: a shaded drawing counts too. Raises the errors of a fit, and KeyboardInterrupt.
    """
    if not drawing.facts["shapes"]:
        return TOO_FINE
    drawn_db = seen_db(task, drawing, _enough_db(drawing))
    if math.isinf(drawn_db):
        return None
    curves, all_curves = curves_of_equal_bytes(task, drawing), photo_settings(task).curves
    if not (quick or drawing.banded) and curves < _usual_curves(task):
        # A quick photo repeats few artefacts of a lossy file.
        off = delta_e(task, drawing)
        if off <= delta_e(task, task.once(quick_photo, all_curves)):
            return None
    curves = min(curves, task.request.settings.curves or curves)
    if or_shaded and _shading_is_nearer(task, _nearest_shaded, drawing, drawn_db + rise_db):
        return "its areas are shaded"
    if drawn_db + rise_db < LOST_DB and task.request.max_bytes is None:
        curves = max(curves, all_curves)  # to have few bytes is no merit where much is lost
    if curves >= all_curves and not (quick or task.bounded or task.recorder is not None):
        ahead_db = NEARLY_ALL_DB if rise_db else -20.0 * math.log10(_gain_of_bytes(task, drawing))
        least_db = drawn_db + ahead_db + MARGIN_DB
        photo_db = task.once(PhotoFit).seen_if_above(least_db)
        return f"a photo has {photo_db:.1f} dB, drawn it has {drawn_db:.1f} dB" if photo_db > least_db else None
    photo_db = seen_db(task, task.once(quick_photo, curves))
    if photo_db <= drawn_db + rise_db + MARGIN_DB - QUICK_BEHIND_DB:
        return None
    near = "is identical" if math.isinf(photo_db) else f"has {photo_db:.1f} dB"
    return f"a quick photo of {curves} curves {near}, drawn it has {drawn_db:.1f} dB, as pixels and as tones"


def _usual_curves(task: Task) -> int:
    """Return the curves of the photo, or the usual ones of its size if those are more."""
    return max(photo_settings(task).curves, task.settings().with_(curves=None).for_size(*task.target.size).curves)
