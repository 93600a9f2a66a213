"""picture -> style -> fit or drawing -> SVG -> independent render -> figures: the whole way for one picture, and the
only one there is.

Writes no files but by `Result.save`: the library and the jobs of the command say where results go.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cubicsplat_cli._version import __version__
from cubicsplat_cli.artwork.plain import only_ink, plain_drawing
from cubicsplat_cli.artwork.settings import CUTOUT
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.artwork.style import ARTWORK, PHOTO, Style, choose_style
from cubicsplat_cli.budget import SPARE, SPARE_COMPRESSED, Means, Within, within_bytes, within_level
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.evaluate.layers import of_pixels, of_scene
from cubicsplat_cli.evaluate.measurable import measurable, seconds_to_measure
from cubicsplat_cli.evaluate.metrics import measure, psnr_db, weighted_psnr_db
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.atomic import write_atomically
from cubicsplat_cli.files.load import Picture, laid_over, resize_picture
from cubicsplat_cli.files.marks import provenance_comment, sha256_of, with_checksum
from cubicsplat_cli.files.names import is_compressed_name
from cubicsplat_cli.files.read import packed
from cubicsplat_cli.files.weights import pixel_weights
from cubicsplat_cli.film import Film
from cubicsplat_cli.paint import Ink
from cubicsplat_cli.progress import Progress, Stages, nothing
from cubicsplat_cli.report import FileQuality, Input, Output, OwnQuality, Qualities, Report, Timing, gap_db
from cubicsplat_cli.request import PHOTO_PRECISION, Request
from cubicsplat_cli.scene import Scene, scaled_scene
from cubicsplat_cli.settings import USUAL_CURVES, FitSettings, Mode, listed
from cubicsplat_cli.svg import write_drawing, write_svg
from cubicsplat_cli.svg.drawing import suggested_precision

if TYPE_CHECKING:
    from cubicsplat_cli.photo import FitResult

ARTWORK_SAMPLES = 48  # edges per cubic of the engine's own picture
# A drawing that is further from the picture has lost something that people see.
LEAST_ARTWORK_DB = 28.0
# The same of pictures with noise, artefacts or blur, which a drawing has not.
LEAST_THROUGH_DB = 18.0
# Large pictures: the pixels for each curve of the copy on which most of a fit is done, and how much larger the sides of
# that are on which it is finished. Within 0.1 dB of a fit to the picture itself: see docs/performance.md.
ROUGH_PIXELS_PER_CURVE = 768
FINISH_SCALE = 2
_LEAST_FITTED = 0.1  # of a time limit is the fit's, however long the rest takes


@dataclass(frozen=True, eq=False)
class Result:
    """A vectorised picture.

    svg: the text of the file. scene: its curves, in pixels of the picture. report: the figures. pixels: (H, W, 4) uint8
    straight RGBA, the SVG drawn by an independent renderer; None where it was not measured.
    """

    svg: str
    scene: Scene | None
    report: Report
    pixels: np.ndarray | None = None

    def save(self, path: str | Path) -> None:
        """Write the SVG, whole or not at all; compressed where the name ends in .svgz.

        Raises InputError where the file cannot be written.
        """
        write_atomically(Path(path), packed(self.svg, compressed=is_compressed_name(Path(path))))


@dataclass(frozen=True, eq=False)
class Made:
    """What a style made of a picture.

    scene: None where the SVG holds no shape. write: gives the SVG's text for a title and a comment. samples: edges per
    cubic of the engine's own picture. paths: how many curves or shapes there are. facts: members of the report that are
    the style's. least_db: PSNR against its picture below which a drawing is too far from it.
    """

    scene: Scene | None
    write: Callable[[str, str], str]
    samples: int
    paths: int
    notes: list[str] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)
    least_db: float = LEAST_ARTWORK_DB


@dataclass(frozen=True, eq=False)
class _Task:
    """One picture, over the ground asked for, and what is asked of it. target: what is fitted, it or a smaller copy."""

    picture: Picture
    target: Picture
    request: Request
    stages: Stages
    on_progress: Callable[[Progress], None] | None
    film: Film | None
    title: str

    def text(self, scene: Scene, precision: int) -> str:
        """The SVG of a photo's curves, at the picture's size."""
        request, picture = self.request, self.picture
        comment = provenance_comment(__version__, request.settings.seed, request.digest(), picture.sha256)
        sized = scaled_scene(scene, *picture.size)
        return with_checksum(write_svg(sized, precision=precision, title=self.title, comment=comment))

    def seconds_left(self) -> float:
        """Until the time limit, infinite without one; below 0 beyond it."""
        limit = self.request.settings.time_limit
        return math.inf if limit is None else limit - self.stages.total()

    def settings(self) -> FitSettings:
        """Of a fit that leaves time for what comes after it, where there is a limit."""
        settings, left = self.request.settings, self.seconds_left()
        if settings.time_limit is None:
            return settings
        after = seconds_to_measure(self.picture) if self.request.measure else 0.0
        # Not less than a share of what was asked for, and of what is left: a fit is what it was asked for.
        most = max(left - after, _LEAST_FITTED * settings.time_limit, 0.5 * left, 1e-3)
        return settings.with_(time_limit=min(most, settings.time_limit))

    def weights(self, copy: Picture) -> np.ndarray | None:
        """How much each pixel of the picture, or of a smaller copy of it, matters; None: all alike."""
        return pixel_weights(copy, self.request.weights, self.request.focus, self.picture.size)


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
    task = _Task(wanted, target, request, stages, on_progress, film, title or picture.source)
    with stages("fit"):
        style, made = _styled(task)
        if film is not None and made.scene is not None and (style.name == ARTWORK or made.paths == 0):
            from cubicsplat_cli.artwork.film import film_shapes

            film_shapes(film, made.scene, target, request.settings.threads)
    with stages("write"):
        comment = provenance_comment(__version__, request.settings.seed, request.digest(), picture.sha256)
        svg = with_checksum(made.write(title or picture.source, comment))
        result = Result(svg, made.scene, _report(picture, target, style, made, svg, request, stages))
        on_svg(result)
    if request.measure:
        result = _measured(result, task, made.samples)
    return replace(result, report=timed(result.report, stages))


def _styled(task: _Task) -> tuple[Style, Made]:
    """What the style asked for made of the picture; or the one that suits it, unless a drawing is too far from it."""
    request, target = task.request, task.target
    ink = only_ink(task.picture)
    if ink is not None:
        return _plain(ink, task)
    if request.style == "auto" and (asked := request.of_photos()):
        return Style(PHOTO, f"asked for by {listed(asked)}"), _photo(task)
    if request.style == "auto" and (asked := request.of_artwork()):
        return Style(ARTWORK, f"asked for by {listed(asked)}"), _artwork(task)
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
    return Style(PHOTO, reason), _photo(task)


def _photo(task: _Task) -> Made:
    """Curves that blend, fitted to the picture."""
    from cubicsplat_cli.photo import Guide, fit

    request, settings = task.request, _with_curves(task)
    start = None if request.init is None else request.init.scene
    rough, fine = _copies(task.target, settings)
    # A drawing to begin with is as fine as it is.
    begun = None if rough is fine or start is not None else (rough.target(), Guide(task.weights(rough)))
    guide = Guide(task.weights(fine), start, request.freeze)
    pixels = fine.target()

    def fit_from(chosen: FitSettings, before: Scene | None) -> FitResult:
        if before is None:
            return fit(pixels, chosen, task.on_progress, task.film, guide, begun)
        return fit(pixels, chosen, task.on_progress, task.film, replace(guide, start=before))

    within = _within(task, fine, settings, guide.weights, fit_from)
    fitted = within.fitted
    notes = [] if request.init is None else list(request.init.notes)
    notes += _fitted_on(task.target, rough if begun else fine, fine)
    scene = scaled_scene(fitted.scene, *task.picture.size)
    return Made(
        scene,
        lambda title, comment: write_svg(scene, precision=within.precision, title=title, comment=comment),
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
    task: _Task, target: Picture, settings: FitSettings, weights: np.ndarray | None,
    fit_from: Callable[[FitSettings, Scene | None], FitResult],
) -> Within:  # fmt: skip
    """One fit, or those that meet the budget that was asked for."""
    from cubicsplat_cli.raster.worth import worth_of

    request, threads = task.request, settings.threads
    precision = PHOTO_PRECISION if request.precision is None else request.precision
    if request.max_bytes is None and request.target_psnr is None:
        return Within(fit_from(settings, None), precision, [])
    reference = measurable(task.picture, math.inf)

    def level(scene: Scene, decimals: int) -> float:
        drawn = rerender(task.text(scene, decimals).encode(), reference.width, reference.height)
        found = psnr_db(reference, of_pixels(drawn.pixels), threads)
        return math.inf if found is None else found

    means = Means(
        fit_from,
        lambda scene, decimals: len(packed(task.text(scene, decimals), compressed=request.compress)),
        level,
        lambda scene: worth_of(scene, target.target(), weights, settings.finish_samples, threads)[1],
    )
    if request.max_bytes is not None:
        spare = SPARE_COMPRESSED if request.compress else SPARE
        return within_bytes(request.max_bytes, settings, request.precision, means, spare)
    assert request.target_psnr is not None
    return within_level(request.target_psnr, settings, precision, means)


def _with_curves(task: _Task) -> FitSettings:
    """The settings with as many curves as were asked for, as the drawing has that the fit begins with, or as suit."""
    settings, init = task.settings(), task.request.init
    if init is None:
        return settings.for_size(*task.target.size)
    init.check_shape(*task.picture.size)
    usual = settings.for_size(*task.target.size)
    if task.request.freeze:
        if usual.curves <= init.scene.curves:
            raise UsageError(
                f"the drawing's {init.scene.curves} curves are frozen, so that --curves {usual.curves} leaves "
                "none to add; ask for more"
            )
        return usual
    return usual if settings.curves is not None else settings.with_(curves=init.scene.curves)


def _fitted_on(picture: Picture, rough: Picture, fine: Picture) -> list[str]:
    """What the report says of copies."""
    if fine is picture and rough is picture:
        return []
    finish = "" if rough is fine else f", with the exact finish at {fine.width} x {fine.height}"
    return [f"fitted on a copy of {rough.width} x {rough.height} pixels{finish}"]


def _copies(picture: Picture, settings: FitSettings) -> tuple[Picture, Picture]:
    """What most of a fit is done on, and what its exact finish: a large picture's copies, or twice the picture itself.

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


def _artwork(task: _Task) -> Made:
    """Few opaque shapes with exact outlines."""
    from cubicsplat_cli.artwork.input.intake import taken_in
    from cubicsplat_cli.artwork.shapes import scaled_drawing
    from cubicsplat_cli.artwork.vectorize import draw

    chosen = replace(task.request.artwork, curves=task.request.settings.curves)
    target = task.target.target()
    intake = taken_in(target)
    drawing = draw(target, chosen, intake)
    if task.request.settings.mode is Mode.OPEN:
        from cubicsplat_cli.artwork.strokes.find import with_strokes

        drawing = with_strokes(drawing, chosen.detail)
    drawing = scaled_drawing(drawing, *task.picture.size)
    if chosen.stacking == CUTOUT:
        from cubicsplat_cli.artwork.planar.cutout import cut_out

        precision = task.request.precision
        drawing = cut_out(drawing, suggested_precision(*task.picture.size) if precision is None else precision)
    least = LEAST_ARTWORK_DB if intake.condition.clean and intake.times == 1 else LEAST_THROUGH_DB
    return replace(_drawn(drawing, task.request), notes=intake.notes, least_db=least)


def _plain(ink: Ink, task: _Task) -> tuple[Style, Made]:
    """A picture of one colour: its ground and no curve, in either style."""
    request = task.request
    drawing = plain_drawing(ink, *task.picture.size)
    style = Style(ARTWORK, "of one colour") if request.style == "auto" else Style(request.style, "asked for")
    if style.name == ARTWORK:
        if request.artwork.palette:
            from cubicsplat_cli.artwork.vectorize import in_palette

            drawing = in_palette(drawing, request.artwork.palette)
        return style, _drawn(drawing, request)
    return style, replace(_drawn(drawing, request), paths=0, facts={})


def _drawn(drawing: Drawing, request: Request) -> Made:
    from cubicsplat_cli.artwork.geometry.outlines import Ring
    from cubicsplat_cli.artwork.geometry.stroke import Chain
    from cubicsplat_cli.artwork.scene import scene_of

    outlines = [o for s in drawing.shapes for o in (s.outlines if s.stroke is None else (s.stroke.path,))]
    facts = {
        "shapes": len(drawing.shapes),
        "segments": drawing.segments,
        "primitives": sum(not isinstance(outline, (Ring, Chain)) for outline in outlines),
        "gradients": len(drawing.gradients),
        "strokes": sum(shape.stroke is not None for shape in drawing.shapes),
        "inks": ["#{:02x}{:02x}{:02x}{:02x}".format(*ink) for ink in drawing.inks],
    }
    return Made(
        scene_of(drawing) if drawing.shapes else None,
        lambda title, comment: write_drawing(drawing, precision=request.precision, title=title, comment=comment),
        ARTWORK_SAMPLES,
        len(drawing.shapes),
        facts=facts,
    )


_STYLES = {PHOTO: _photo, ARTWORK: _artwork}


def _report(
    picture: Picture, target: Picture, style: Style, made: Made, svg: str, request: Request, stages: Stages
) -> Report:
    data = svg.encode()
    usual: dict[str, Any] = {"device": {"name": "cpu"}, "timing": Timing(0.0, stages.seconds["fit"])}
    return Report(
        input=Input(picture.source, picture.sha256, *picture.size, picture.alpha is not None),
        output=Output(made.paths, len(data), sha256_of(data)),
        settings=request.deciding(),
        settings_hash=request.digest(),
        style=style.name,
        style_reason=style.reason,
        notes=[*target.notes, *made.notes],
        **(usual | made.facts),
    )


def _measured(result: Result, task: _Task, samples: int) -> Result:
    """Draw the SVG's bytes with an independent renderer, and compare that and the engine's picture with the input."""
    stages, threads = task.stages, task.request.settings.threads
    with stages("measure"):
        reference = measurable(task.picture, task.seconds_left())
    with stages("draw"):
        drawn = rerender(result.svg.encode(), reference.width, reference.height)
    with stages("measure"):
        own = of_scene(result.scene, reference.width, reference.height, samples, threads)
        (file, surrogate), agreement = measure(reference, [of_pixels(drawn.pixels), own], threads)
        quality = Qualities(
            FileQuality(**vars(file), renderer=drawn.renderer),
            OwnQuality(**vars(surrogate), samples=samples),
            agreement,
            gap_db(file, surrogate),
        )
        weights = task.weights(reference)
        if weights is not None:
            level = weighted_psnr_db(reference, of_pixels(drawn.pixels), weights)
            quality = replace(quality, weighted_psnr_db=level)
    notes = [] if drawn.note is None else [drawn.note]
    if (reference.width, reference.height) != task.picture.size:
        notes.append(f"quality measured at {reference.width} x {reference.height} pixels")
    report = replace(result.report, quality=quality, notes=[*result.report.notes, *notes])
    return replace(result, report=report, pixels=drawn.pixels)


def timed(report: Report, stages: Stages) -> Report:
    """The report with the seconds of the stages so far."""
    seconds = stages.seconds
    timing = replace(
        report.timing,
        total_s=stages.total(),
        read_s=seconds.get("read"),
        write_s=seconds.get("write"),
        draw_s=seconds.get("draw"),
        measure_s=seconds.get("measure"),
    )
    return replace(report, timing=timing)
