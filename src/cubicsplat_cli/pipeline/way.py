"""The way of one picture through the stages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from cubicsplat_cli.artwork.plain import only_ink
from cubicsplat_cli.artwork.style import ARTWORK, PHOTO, Style, choose_style
from cubicsplat_cli.evaluate.layers import of_scene
from cubicsplat_cli.evaluate.metrics import psnr_db
from cubicsplat_cli.files.load import Picture, laid_over, resize_picture
from cubicsplat_cli.files.marks import sha256_of, with_checksum
from cubicsplat_cli.film import Film
from cubicsplat_cli.pipeline.artwork import drawn_artwork, plain
from cubicsplat_cli.pipeline.measure import measured, timed
from cubicsplat_cli.pipeline.photo import fitted_photo
from cubicsplat_cli.pipeline.task import Made, Result, Task
from cubicsplat_cli.progress import Progress, Stages, nothing
from cubicsplat_cli.report import Input, Output, Report, Timing
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import listed
from cubicsplat_cli.svg.drawing import drawn_elements

_STYLES = {PHOTO: fitted_photo, ARTWORK: drawn_artwork}


def vectorize_picture(
    picture: Picture,
    request: Request | None = None,
    *,
    title: str | None = None,
    stages: Stages | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    on_svg: Callable[[Result], None] = nothing,
    film: Film | None = None,
) -> Result:
    """Turn a loaded picture into an SVG, and measure that SVG.

    title: the SVG's title, by default the picture's source. on_svg: gets the result before it is measured, so that the
    SVG is safe by then. film: keeps the fit's scenes, or those of a drawing as it is laid down. A Ctrl-C during the fit
    of a photo ends it with the best scene so far. Raises EngineError when the engine fails, InputError when the scene
    cannot be written.
    """
    request, stages = request or Request(), stages or Stages()
    with stages("read"):
        wanted = laid_over(picture, request.settings.background_colour)
        target = wanted if request.max_size is None else resize_picture(wanted, request.max_size)
    task = Task(wanted, target, request, stages, on_progress, film, title or picture.source)
    with stages("fit"):
        style, made = _styled(task)
        if film is not None and made.scene is not None and (style.name == ARTWORK or made.paths == 0):
            from cubicsplat_cli.artwork.film import film_shapes

            film_shapes(film, made.scene, target, request.settings.threads)
    with stages("write"):
        svg = with_checksum(made.write(task.title, task.comment()))
        result = Result(svg, made.scene, _report(picture, target, style, made, svg, request, stages))
        on_svg(result)
    if request.measure:
        result = measured(result, task, made.samples)
    return replace(result, report=timed(result.report, stages))


def _styled(task: Task) -> tuple[Style, Made]:
    """What the style asked for made of the picture; or the one that suits it, unless a drawing is too far from it."""
    request, target = task.request, task.target
    ink = only_ink(task.picture)
    if ink is not None:
        return plain(ink, task)
    if request.style == "auto" and (asked := request.of_photos()):
        return Style(PHOTO, f"asked for by {listed(asked)}"), fitted_photo(task)
    if request.style == "auto" and (asked := request.of_artwork()):
        return Style(ARTWORK, f"asked for by {listed(asked)}"), drawn_artwork(task)
    if request.style != "auto":
        return Style(request.style, "asked for"), _STYLES[request.style](task)
    style = choose_style(target.target())
    made = _STYLES[style.name](task)
    if style.name == PHOTO:
        return style, made
    threads = request.settings.threads
    level = psnr_db(target, of_scene(made.scene, target.width, target.height, made.samples, threads), threads)
    if level is None or level >= made.least_db:
        return style, made
    reason = f"{style.reason}, but drawn as artwork it has only {level:.1f} dB"
    return Style(PHOTO, reason), fitted_photo(task)


def _report(
    picture: Picture, target: Picture, style: Style, made: Made, svg: str, request: Request, stages: Stages
) -> Report:
    data = svg.encode()
    usual: dict[str, Any] = {"device": {"name": "cpu"}, "timing": Timing(0.0, stages.seconds["fit"])}
    return Report(
        input=Input(picture.source, picture.sha256, *picture.size, picture.alpha is not None),
        output=Output(drawn_elements(svg) if "shapes" in made.facts else made.paths, len(data), sha256_of(data)),
        settings=request.deciding(),
        settings_hash=request.digest(),
        style=style.name,
        style_reason=style.reason,
        notes=[*target.notes, *made.notes],
        **(usual | made.facts),
    )
