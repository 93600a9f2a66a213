"""Choose between photo and drawing: by request, by measurement, and by comparing both results with the picture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import cast

from cubicsplat_cli.artwork.style import ARTWORK, PHOTO, PIXEL, Style, choose_style, only_fill
from cubicsplat_cli.errors import CubicSplatError, UsageError
from cubicsplat_cli.evaluate.metrics import decibels
from cubicsplat_cli.formatting import counted, one_line
from cubicsplat_cli.options import listed
from cubicsplat_cli.pipeline.artwork import drawn_artwork, drawn_cells, drawn_outlines, drawn_pixels, result_of_one_fill
from cubicsplat_cli.pipeline.likeness import level_db, seen_db
from cubicsplat_cli.pipeline.pages import PartIsLost, drawn_page, page_in
from cubicsplat_cli.pipeline.photo import PhotoFit, QuickPhoto, curves_of_equal_bytes, fitted_photo, is_smaller
from cubicsplat_cli.pipeline.task import TOO_FINE, Made, Task

ENOUGH_DB = 40.0  # of a drawing that has lost nothing that people see
FAR_DB = 22.0  # a mean error of 8 % of full scale, plain to see
# Shapes can be edited, so the curves must be better by what is plain to see. A quick photo is behind one that is fitted
# to its end by so much at least.
MARGIN_DB, QUICK_BEHIND_DB = 1.0, 2.0
SKETCH_DB = 6.0  # by which a drawing is nearer whose details are found too, at most


# What makes each style. A further one needs a line here, a name in `request.STYLES`, and its file in this package.
MAKERS = {PHOTO: fitted_photo, ARTWORK: drawn_artwork, PIXEL: drawn_pixels}


class PhotoIsNearer(Exception):
    """A drawing is not worth finishing; the text says why, as `photo_is_nearer` does."""


class ShadedIsNearer(Exception):
    """A drawing is not worth finishing; the argument is the shaded one instead."""


def candidates(task: Task, style: Style | None = None) -> Iterator[Made]:
    """Yield finished results, each to replace the one before. With the style "auto", the result of the style that suits
    the picture comes first. A second one follows if the other style is nearer, or if there is a note on the comparison.

    style: what `choose_style` says of the target, where that is known.
    """
    with task.working():
        made = _first(task, style)
    yield made
    if not (made.may_be_photo or made.may_be_drawn) or task.seconds_left() <= 0.0:
        return
    with task.working():
        better = _nearer(task, made) if made.may_be_photo else _nearer_drawing(task, made)
    if better is not made:
        yield better


def _first(task: Task, style: Style | None) -> Made:
    """The result of the style that is asked for or suits the picture; if that fails, of the other style."""
    if task.request.settings.device == "cuda":
        from cubicsplat_cli.raster.cuda.driver import require_gpu

        require_gpu()  # which a drawing would not ask for
    if (fill := only_fill(task.picture)) is not None:
        return result_of_one_fill(fill, task)
    if (asked := _asked_for(task)) is not None:
        page = _page(task)
        made = _made(task, asked) if page is None else replace(page, style=asked)
        return replace(made, may_be_photo=False)
    style = style or choose_style(task.pixels)
    try:
        return (None if style.cells else _page(task)) or _suiting(task, style)
    except PhotoIsNearer as nearer:
        return _photo_instead(task, style, str(nearer))
    except UsageError:
        raise
    except Exception as error:
        failed = error.with_traceback(None)  # which would keep all that was in memory
    other = Style(ARTWORK if style.name == PHOTO else PHOTO, f"{style.reason}, but as {style.name} it failed")
    try:
        made = _made(task, other)
    except Exception:
        raise failed from None
    return replace(made, notes=[*made.notes, f"made as {other.name}, since {_failure(style.name, failed)}"])


def _page(task: Task) -> Made | None:
    """The drawing of a page with its photographs; None where the picture is none that is worth drawing."""
    if (page := page_in(task)) is None:
        return None
    try:
        made = drawn_page(task, page, check_worth_finishing)
    except (PhotoIsNearer, PartIsLost):
        return None
    return replace(made, style=Style(ARTWORK, f"{page.reason}, off {counted(len(page.parts), 'photograph')}"))


def _asked_for(task: Task) -> Style | None:
    """The style that the user chose, by name or an option that only that style has; by shading where there is any."""
    if (name := task.request.style) != "auto":
        return Style(name, "asked for")
    if photo := task.request.of_photos():
        return Style(PHOTO, f"asked for by {listed(photo)}")
    if (drawn := task.request.of_artwork()) == ["shading"]:
        from cubicsplat_cli.pipeline.shaded import shaded_objects

        drawn = drawn if shaded_objects(task.pixels) is not None else []
    return Style(ARTWORK, f"asked for by {listed(drawn)}") if drawn else None


def _nearer(task: Task, made: Made) -> Made:
    """The photo of a picture to which that is nearer than the drawing; else the drawing, with a note if that is not
    known.
    """
    try:
        reason = photo_is_nearer(task, made)
        if reason is None:
            return made
        photo = _photo_instead(task, made.style, reason)
    except Exception as error:
        return replace(made, notes=[*made.notes, f"the drawing stays, since {_failure('photo', error)}"])
    except KeyboardInterrupt:
        return _interrupted(made)
    return _interrupted(made) if photo.interrupted else photo


def _nearer_drawing(task: Task, photo: Made) -> Made:
    """The drawing of a picture from which the photo is far, if that is nearer; else the photo, with a note if that is
    not known.
    """
    level = _level_db(task, photo)
    if level >= FAR_DB or photo.interrupted:
        return photo
    return _nearer_of(task, photo, _drawing_of(task, photo.style, level, SKETCH_DB))


def _photo_or_drawing(task: Task, style: Style) -> Made:
    """The photo of a picture; or its drawing, where the style is doubtful or the photo will be far from the picture, as
    an early look at the fit tells, and the drawing is nearer by more than a look may err.
    """
    if task.bounded or task.recorder is not None:
        return replace(_made(task, style), may_be_drawn=not task.bounded)
    fit = PhotoFit(task)
    scene, rise = fit.early() or (None, 0.0)
    expected = level_db(task, scene, task.request.settings.finish_samples) + rise
    if math.isinf(expected) or (expected >= FAR_DB and not style.doubtful):
        return replace(fit.finished(), style=style, may_be_drawn=True)
    # What a look tells may rise as far as a sketch.
    drawing = _drawing_of(task, style, expected, 0.0)
    if isinstance(drawing, Made):
        own = _level_db(task, drawing)
        # The photo may end far above what a look tells, in fewer bytes than many shapes take.
        decisive = expected < FAR_DB or is_smaller(task, drawing)
        if drawing.interrupted or (decisive and own > decisive_db(expected)):
            return _instead(drawing, expected)
        most = fit.most(own) if decisive else None
        if most is not None:
            return _instead(drawing, most)
    return _nearer_of(task, replace(fit.finished(), style=style), drawing)


def decisive_db(expected: float) -> float:
    """The level from which on a drawing replaces a photo that an early look expects to end with so many dB."""
    # Of few colours a photo often ends far above what an early look tells.
    return expected + MARGIN_DB if expected < FAR_DB else ENOUGH_DB


def _drawing_of(task: Task, style: Style, level: float, rise_db: float) -> Made | Exception | None:
    """The drawing of a picture that as a photo has a level, in dB; the error with which it fails, or None where its
    sketch is not as near and would not be if it rose by so many dB.
    """

    def check(sketch: Made) -> None:
        if _level_db(task, sketch) <= level - rise_db:
            raise PhotoIsNearer(f"it has {level:.1f} dB")

    try:
        drawing = drawn_outlines(task, check)
        return replace(drawing, style=Style(ARTWORK, f"{style.reason}, but as a photo it has only {level:.1f} dB"))
    except PhotoIsNearer:
        return None
    except Exception as error:
        return error


def _nearer_of(task: Task, photo: Made, drawing: Made | Exception | None) -> Made:
    """The drawing of a picture if it is nearer than the photo; else the photo, with a note if that is not known."""
    if isinstance(drawing, Exception):
        return replace(photo, notes=[*photo.notes, f"the photo stays, since {_failure('artwork', drawing)}"])
    if drawing is None:
        return photo
    if drawing.interrupted:
        return _interrupted(photo)
    level = _level_db(task, photo)
    return _instead(drawing, level) if _level_db(task, drawing) > level else photo


def _instead(drawing: Made, level: float) -> Made:
    """A drawing in place of a photo of so many dB, with which it need not be compared again."""
    notes = [*drawing.notes, f"made as artwork: a photo has only {level:.1f} dB"]
    return replace(drawing, notes=notes, may_be_photo=False)


def _interrupted(made: Made) -> Made:
    """A finished result that was still to be compared."""
    return replace(made, facts={**made.facts, "interrupted": True})


def _photo_instead(task: Task, drawn: Style, reason: str) -> Made:
    """The photo of a picture that looks like a drawing, with a note."""
    photo = _made(task, Style(PHOTO, f"{drawn.reason}, but {reason}"))
    return replace(photo, notes=[*photo.notes, f"made as photo: {reason}"])


def _made(task: Task, style: Style) -> Made:
    """The result of a style."""
    make = _drawn_or_shaded if style.name == ARTWORK and task.request.may_shade else MAKERS[style.name]
    return replace(make(task), style=style)


def _drawn_or_shaded(task: Task) -> Made:
    """A drawing; or a shaded one, where that is plainly nearer than it is, or than its sketch may become."""
    from cubicsplat_cli.pipeline.shaded import drawn_shaded, shaded_objects  # which few pictures need

    shaded = cache(lambda: None if (objects := shaded_objects(task.pixels)) is None else drawn_shaded(task, objects))

    def check(drawing: Made, rise_db: float = SKETCH_DB) -> None:
        drawn_db = _seen_db(task, drawing, _enough_db(drawing))
        made = None if math.isinf(drawn_db) or not drawing.may_be_photo or drawing.interrupted else shaded()
        if made is not None and _seen_db(task, made) > drawn_db + rise_db + MARGIN_DB:
            raise ShadedIsNearer(made)
        if made is not None and made.interrupted and rise_db:
            raise KeyboardInterrupt  # which ends the drawing too

    try:
        check(drawing := drawn_artwork(task, check), 0.0)
    except ShadedIsNearer as nearer:
        return cast("Made", nearer.args[0])
    return drawing


def _enough_db(drawing: Made) -> float:
    """Level of a drawing that has lost nothing, or nothing but the noise of its picture."""
    return min(ENOUGH_DB, decibels((drawing.noise / 255.0) ** 2) - MARGIN_DB) if drawing.noise else ENOUGH_DB


def _level_db(task: Task, made: Made) -> float:
    """The level of a result; see `likeness.level_db`."""
    return level_db(task, made.scene, made.samples, made.blur)


def _seen_db(task: Task, made: Made, enough_db: float = math.inf) -> float:
    """The level of a result as people see it; see `likeness.seen_db`."""
    return seen_db(task, made.scene, made.samples, made.blur, enough_db)


def _suiting(task: Task, style: Style) -> Made:
    """The same of the style that was measured. Raises PhotoIsNearer where a drawing is not worth finishing."""
    if style.cells is not None:
        return replace(drawn_cells(task, style.cells), style=style)
    if style.name == PHOTO:
        return _photo_or_drawing(task, style)
    return replace(drawn_outlines(task, lambda sketch: check_worth_finishing(task, sketch)), style=style)


def _failure(style: str, error: Exception) -> str:
    """Describe an error to the user; one that is not ours is a bug."""
    if isinstance(error, CubicSplatError):
        return f"{style} failed: {one_line(error)}"
    if isinstance(error, MemoryError):
        return f"there is not enough memory for {style}"
    return f"{style} failed ({type(error).__name__}: {one_line(error)}); this is a bug, please report it"


def check_worth_finishing(task: Task, sketch: Made) -> None:
    """Raises PhotoIsNearer where not even its details would bring a drawing near enough, and what a fit raises."""
    reason = photo_is_nearer(task, sketch, SKETCH_DB)
    if reason is not None:
        raise PhotoIsNearer(reason)


def photo_is_nearer(task: Task, made: Made, rise_db: float = 0.0) -> str | None:
    """Why the photo style suits the picture better than its drawing does; None where it does not.

    rise_db: by which the level of the drawing may still rise. Raises what a fit raises, and KeyboardInterrupt.
    """
    if not made.facts["shapes"]:
        return TOO_FINE
    drawn = _seen_db(task, made, _enough_db(made))
    if math.isinf(drawn):
        return None
    curves = curves_of_equal_bytes(task, made)
    if curves not in task.quick_photos:
        task.quick_photos[curves] = QuickPhoto(task, curves, lambda scene: seen_db(task, scene, made.samples))
    fitted = task.quick_photos[curves].beyond(drawn + rise_db + MARGIN_DB - QUICK_BEHIND_DB)
    if fitted is None:
        return None
    near = "is identical" if math.isinf(fitted) else f"has {fitted:.1f} dB"
    return f"a quick photo of {curves} curves {near}, drawn it has {drawn:.1f} dB, as pixels and as tones"
