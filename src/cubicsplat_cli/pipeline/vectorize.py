"""One picture through the stages: style -> fit or drawing -> SVG -> independent render -> figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from cubicsplat_cli.artwork.plain import only_ink
from cubicsplat_cli.artwork.style import ARTWORK, PHOTO, PIXEL, Style, choose_style
from cubicsplat_cli.errors import CubicSplatError, UsageError
from cubicsplat_cli.files.load import Picture, laid_over, resize_picture
from cubicsplat_cli.formatting import one_line
from cubicsplat_cli.options import listed
from cubicsplat_cli.pipeline.artwork import drawn_artwork, drawn_cells, drawn_outlines, drawn_pixels, plain
from cubicsplat_cli.pipeline.measure import measured, timed
from cubicsplat_cli.pipeline.nearer import FAR_DB, PhotoIsNearer, check_worth_finishing, level_db, photo_is_nearer
from cubicsplat_cli.pipeline.photo import fitted_photo
from cubicsplat_cli.pipeline.task import Made, Result, Task
from cubicsplat_cli.progress import FrameRecorder, Progress, Stages
from cubicsplat_cli.request import Request


def vectorize_picture(
    picture: Picture,
    request: Request | None = None,
    *,
    title: str | None = None,
    stages: Stages | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> Result:
    """Turn a loaded picture into an SVG, and measure that SVG.

    title: the SVG's title, by default the picture's source. A Ctrl-C while a photo is fitted or a drawing made ends
    that with what there is so far. Raises EngineError when the engine fails, InputError when the scene cannot be
    written.
    """
    task = task_of(picture, request or Request(), stages or Stages(), title=title, on_progress=on_progress)
    *_, made = candidates(task)
    result = task.result(made)
    if task.request.measure:
        result = measured(result, task, made)
    return replace(result, report=timed(result.report, task.stages))


def task_of(
    picture: Picture,
    request: Request,
    stages: Stages,
    *,
    title: str | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    film: FrameRecorder | None = None,
) -> Task:
    """The work on a loaded picture. film: keeps the scenes of a photo's fit."""
    with stages("read"):
        wanted = laid_over(picture, request.settings.background_colour)
        target = wanted if request.max_size is None else resize_picture(wanted, request.max_size)
    return Task(picture, wanted, target, request, stages, on_progress, film, title or picture.source)


def candidates(task: Task) -> Iterator[Made]:
    """What is made of the picture. Where the style is "auto", the result of the style that suits it comes first, and
    behind it that of the other style, if that is nearer, or what is to be said of it. Each is a finished result, to be
    kept until the next.
    """
    with task.stages("fit"):
        made = _first(task)
    yield made
    if not (made.may_be_photo or made.may_be_drawn) or task.seconds_left() <= 0.0:
        return
    with task.stages("fit"):
        better = _nearer(task, made) if made.may_be_photo else _nearer_drawing(task, made)
    if better is not made:
        yield better


def _first(task: Task) -> Made:
    """What the style that is asked for, or suits the picture, makes of it; the other style where that fails."""
    request = task.request
    ink = only_ink(task.picture)
    if ink is not None:
        return plain(ink, task)
    asked = _asked_for(request)
    if asked is not None:
        return replace(_made(task, asked), may_be_photo=False)
    style = choose_style(task.target.target())
    try:
        return _suiting(task, style)
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


def _asked_for(request: Request) -> Style | None:
    """The style that the user chose, by name or by an option that only that style has."""
    if request.style != "auto":
        return Style(request.style, "asked for")
    for name, options in ((PHOTO, request.of_photos()), (ARTWORK, request.of_artwork())):
        if options:
            return Style(name, f"asked for by {listed(options)}")
    return None


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
    return _interrupted(made) if photo.facts["interrupted"] else photo


def _nearer_drawing(task: Task, photo: Made) -> Made:
    """The drawing of a picture from which the photo is far, if that is nearer; else the photo, with a note if that is
    not known.
    """
    level = level_db(task, photo.scene, photo.samples)
    if level is None or level >= FAR_DB or photo.facts["interrupted"]:
        return photo
    style = Style(ARTWORK, f"{photo.style.reason}, but as a photo it has only {level:.1f} dB")
    try:
        made = _suiting(task, style)
        drawn = level_db(task, made.scene, made.samples, made.blur)
    except PhotoIsNearer:
        return photo
    except Exception as error:
        return replace(photo, notes=[*photo.notes, f"the photo stays, since {_failure('artwork', error)}"])
    if made.facts["interrupted"]:
        return _interrupted(photo)
    if drawn is not None and drawn <= level:
        return photo
    return replace(made, notes=[*made.notes, f"made as artwork: a photo has only {level:.1f} dB"])


def _interrupted(made: Made) -> Made:
    """A finished result that was still to be compared."""
    return replace(made, facts={**made.facts, "interrupted": True})


def _photo_instead(task: Task, drawn: Style, reason: str) -> Made:
    """The photo of a picture that looks like a drawing, with a note."""
    photo = _made(task, Style(PHOTO, f"{drawn.reason}, but {reason}"))
    return replace(photo, notes=[*photo.notes, f"made as photo: {reason}"])


def _made(task: Task, style: Style) -> Made:
    """What a style makes of the picture."""
    make = {PHOTO: fitted_photo, ARTWORK: drawn_artwork, PIXEL: drawn_pixels}[style.name]
    return replace(make(task), style=style)


def _suiting(task: Task, style: Style) -> Made:
    """The same of the style that was measured. Raises PhotoIsNearer where a drawing is not worth finishing."""
    if style.cells is not None:
        return replace(drawn_cells(task, style.cells), style=style)
    if style.name == PHOTO:
        return replace(_made(task, style), may_be_drawn=not task.bounded)
    return replace(drawn_outlines(task, lambda sketch: check_worth_finishing(task, sketch)), style=style)


def _failure(style: str, error: Exception) -> str:
    """What went wrong, in words for the user; an error that is not ours is a bug."""
    if isinstance(error, CubicSplatError):
        return f"{style} failed: {one_line(error)}"
    if isinstance(error, MemoryError):
        return f"there is not enough memory for {style}"
    return f"{style} failed ({type(error).__name__}: {one_line(error)}); this is a bug, please report it"
