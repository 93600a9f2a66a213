"""The figures of a result: its SVG in an independent renderer, and the seconds of the stages."""

from __future__ import annotations

from dataclasses import replace

from cubicsplat_cli.artwork.style import PHOTO
from cubicsplat_cli.evaluate.images import of_pixels, of_scene
from cubicsplat_cli.evaluate.metrics import measurable, measure, weighted_psnr_db
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.pipeline.nearer import FAR_DB
from cubicsplat_cli.pipeline.task import Made, Result, Task
from cubicsplat_cli.progress import Stages
from cubicsplat_cli.report import FileQuality, OwnQuality, Qualities, Report, gap_db


def measured(result: Result, task: Task, made: Made) -> Result:
    """Draw the SVG's bytes with an independent renderer, and compare that and the engine's picture with the input."""
    stages, threads = task.stages, task.request.settings.threads
    with stages("measure"):
        reference = measurable(task.picture, task.seconds_left())
    with stages("draw"):
        drawn = rerender(result.svg.encode(), reference.width, reference.height)
    with stages("measure"):
        own = of_scene(made.scene, reference.width, reference.height, made.samples, threads)
        (file, surrogate), agreement = measure(reference, [of_pixels(drawn.pixels), own], threads)
        quality = Qualities(
            FileQuality(**vars(file), renderer=drawn.renderer),
            OwnQuality(**vars(surrogate), samples=made.samples),
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
    if quality.svg.psnr_db is not None and quality.svg.psnr_db < FAR_DB and _may_be_nearer(task, made):
        more = "more --curves bring it nearer" if made.style.name == PHOTO else "--style photo may be nearer"
        notes.append(f"the result is far from the picture, {quality.svg.psnr_db:.1f} dB; {more}")
    report = replace(result.report, quality=quality, notes=[*result.report.notes, *notes])
    return replace(result, report=report, pixels=drawn.pixels)


def _may_be_nearer(task: Task, made: Made) -> bool:
    """Whether a result is to be as near to its picture as it can be: nobody asked for few curves or colours."""
    as_it_is = made.style.name == PHOTO or (task.request.artwork.free_inks and not made.of_scan)
    return as_it_is and not task.bounded


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
