"""picture -> fit -> SVG -> independent render -> figures: the whole way for one picture, the only one there is.

Writes no files but by `Result.save`: the library and the jobs of the command say where results go.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cubicsplat_cli._version import __version__
from cubicsplat_cli.evaluate.measurable import measurable
from cubicsplat_cli.evaluate.metrics import agreement_db, compare, compare_premultiplied
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.atomic import write_atomically
from cubicsplat_cli.files.load import Picture, resize_picture
from cubicsplat_cli.files.marks import provenance_comment, settings_hash, sha256_of
from cubicsplat_cli.files.names import is_compressed_name
from cubicsplat_cli.files.read import packed
from cubicsplat_cli.photo import FitResult, fit
from cubicsplat_cli.progress import Progress, Stages, nothing
from cubicsplat_cli.raster import render_scene
from cubicsplat_cli.report import FileQuality, Input, Output, OwnQuality, Qualities, Report, Timing, gap_db
from cubicsplat_cli.scene import Scene, scaled_scene
from cubicsplat_cli.settings import FitSettings, deciding
from cubicsplat_cli.svg import write_svg


@dataclass(frozen=True, eq=False)
class Result:
    """A vectorised picture.

    svg: the text of the file. scene: its curves, in pixels of the picture. report: the figures. pixels: (H, W, 4) uint8
    straight RGBA, the SVG drawn by an independent renderer; None where it was not measured.
    """

    svg: str
    scene: Scene
    report: Report
    pixels: np.ndarray | None = None

    def save(self, path: str | Path) -> None:
        """Write the SVG, whole or not at all; compressed where the name ends in .svgz.

        Raises InputError where the file cannot be written.
        """
        write_atomically(Path(path), packed(self.svg, compressed=is_compressed_name(Path(path))))


def vectorize_picture(
    picture: Picture,
    settings: FitSettings,
    *,
    precision: int = 2,
    title: str | None = None,
    max_size: int | None = None,
    measure: bool = True,
    stages: Stages | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    on_svg: Callable[[Result], None] = nothing,
) -> Result:
    """Turn a loaded picture into an SVG, and measure that SVG.

    precision: decimals of the coordinates, 0..6. title: the SVG's title, by default the picture's source. max_size:
    fit a copy scaled down to at most so many pixels a side; the SVG keeps the picture's size. on_svg: gets the result
    before it is measured, so that the SVG is safe by then. A Ctrl-C during the fit ends it with the best scene so far.
    Raises UsageError for bad settings, EngineError when the engine fails, InputError when the scene cannot be written.
    """
    stages = stages or Stages()
    target = picture if max_size is None else resize_picture(picture, max_size)
    with stages("fit"):
        fitted = fit(target.target(), settings, on_progress)
    with stages("write"):
        scene = scaled_scene(fitted.scene, picture.width, picture.height)
        chosen = deciding(settings, precision=precision, max_size=max_size)
        comment = provenance_comment(__version__, settings.seed, settings_hash(chosen), picture.sha256)
        svg = write_svg(scene, precision=precision, title=title or picture.source, comment=comment)
        report = _unmeasured(picture, fitted, scene, svg, chosen)
        result = Result(svg, scene, replace(report, notes=[*target.notes, *fitted.notes]))
        on_svg(result)
    if measure:
        result = _measured(result, picture, fitted.samples, settings.threads, stages)
    return replace(result, report=replace(result.report, timing=_timing(stages, fitted)))


def _unmeasured(picture: Picture, fitted: FitResult, scene: Scene, svg: str, settings: dict[str, object]) -> Report:
    data = svg.encode()
    return Report(
        input=Input(picture.source, picture.sha256, picture.width, picture.height, picture.alpha is not None),
        output=Output(paths=scene.curves, bytes=len(data), svg_sha256=sha256_of(data)),
        settings=settings,
        settings_hash=settings_hash(settings),
        device=fitted.device,
        timing=Timing(0.0, fitted.fit_s, fitted.steps, fitted.ms_per_step),
        replaced=fitted.replaced,
        dropped=fitted.dropped,
        interrupted=fitted.interrupted,
        history=fitted.history,
    )


def _measured(result: Result, picture: Picture, samples: int, threads: int | None, stages: Stages) -> Result:
    """Draw the SVG's bytes with an independent renderer, and compare that and the engine's picture with the input."""
    reference = measurable(picture)
    with stages("draw"):
        drawn = rerender(result.svg.encode(), reference.width, reference.height)
    with stages("measure"):
        scene = scaled_scene(result.scene, reference.width, reference.height)
        own = render_scene(scene, coverage="exact", samples=samples, threads=threads)
        file, surrogate = compare(reference, drawn.pixels), compare_premultiplied(reference, own)
        quality = Qualities(
            FileQuality(**vars(file), renderer=drawn.renderer),
            OwnQuality(**vars(surrogate), samples=samples),
            agreement_db(own, drawn.pixels),
            gap_db(file, surrogate),
        )
    notes = [] if drawn.note is None else [drawn.note]
    if reference is not picture:
        notes.append(f"quality measured at {reference.width} x {reference.height} pixels")
    report = replace(result.report, quality=quality, notes=[*result.report.notes, *notes])
    return replace(result, report=report, pixels=drawn.pixels)


def _timing(stages: Stages, fitted: FitResult) -> Timing:
    seconds = {f"{name}_s": value for name, value in stages.seconds.items() if name != "fit"}
    return Timing(stages.total(), fitted.fit_s, fitted.steps, fitted.ms_per_step, **seconds)
