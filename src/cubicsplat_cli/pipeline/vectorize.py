"""One picture through the stages: style -> fit or drawing -> SVG -> independent render -> figures."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from PIL import Image

from cubicsplat_cli.artwork.input.matte import without_matte
from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.artwork.style import PHOTO
from cubicsplat_cli.evaluate.images import of_pixels, of_scene
from cubicsplat_cli.evaluate.metrics import measurable, measure, weighted_psnr_db
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.load import Picture, laid_over, resize_picture, with_levels
from cubicsplat_cli.files.marks import PROGRAM, sha256_of
from cubicsplat_cli.files.read import packed
from cubicsplat_cli.metrics import FileQuality, Input, Output, OwnQuality, Qualities, Report, Timing, gap_db, plain
from cubicsplat_cli.pipeline.choose import FAR_DB, candidates
from cubicsplat_cli.pipeline.task import Made, Measured, Result, Task
from cubicsplat_cli.progress import FrameRecorder, OnProgress, StageTimer
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.request import KEEP, Request
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import with_channels
from cubicsplat_cli.svg.drawing_writer import drawn_elements

SCORES_SIDE = 256  # px, as Geometrize works on
COLORS, COLORS_SIDE = 5, 96  # the most dominant colours, and px of the copy that they are taken from


def vectorize_picture(
    picture: Picture,
    request: Request | None = None,
    *,
    title: str | None = None,
    timer: StageTimer | None = None,
    on_progress: OnProgress | None = None,
) -> Result:
    """Turn a loaded picture into an SVG, and measure that SVG.

    title: the SVG's title, by default the picture's source. A Ctrl-C during the fit or the drawing ends it with the
    result so far. Raises EngineError if the engine fails, InputError if the scene cannot be written.
    """
    task = task_of(picture, request or Request(), timer or StageTimer(), title=title, on_progress=on_progress)
    *_, made = candidates(task)
    svg = task.svg(made)
    figures = measured(task, made, svg) if task.request.measure else None
    report = report_of(task, made, figures, output_of(task, made, svg, svg.encode()))
    return Result(svg, made.scene, report, None if figures is None else figures.pixels)


def task_of(
    picture: Picture,
    request: Request,
    timer: StageTimer,
    *,
    title: str | None = None,
    on_progress: OnProgress | None = None,
    recorder: FrameRecorder | None = None,
) -> Task:
    """Return the task for a loaded picture. recorder: keeps the scenes of a photo's fit."""
    with timer("read"):
        grounded = laid_over(picture, request.settings.background_colour)
        target = _without_matte(grounded)
        target = target if request.max_size is None else resize_picture(target, request.max_size)
    return Task(picture, grounded, target, request, timer, on_progress, recorder, title or picture.source)


def _without_matte(picture: Picture) -> Picture:
    """Return a picture without the remains of a removed ground at its edges, and with a note on them, if any."""
    if picture.alpha is None:
        return picture
    levels, ground = without_matte(as_levels(picture.target()))
    if not ground:
        return picture
    bare = with_levels(picture, levels)
    note = f"made without the remains of a {ground} ground at its edges"
    return replace(bare, compression=picture.compression, notes=(*picture.notes, note))


def measured(task: Task, made: Made, svg: str) -> Measured:
    """Compare the picture with the SVG, drawn by an independent renderer, and with the engine's picture."""
    timer, threads = task.timer, task.request.settings.threads
    with timer("measure"):
        reference = measurable(task.picture, task.seconds_left())
    sides = reference.width, reference.height
    with timer("draw"):
        drawn = rerender(svg.encode(), *sides)
    with timer("measure"):
        own, svg_pixels = of_scene(made.scene, *sides, made.samples, threads), of_pixels(drawn.pixels)
        (file, surrogate), agreement = measure(reference, [svg_pixels, own], threads)
        weights = task.weights(reference)
        quality = Qualities(
            FileQuality(**vars(file), renderer=drawn.renderer),
            OwnQuality(**vars(surrogate), samples=made.samples),
            agreement,
            gap_db(file, surrogate),
            None if weights is None else weighted_psnr_db(reference, svg_pixels, weights),
        )
    notes = [] if drawn.note is None else [drawn.note]
    if sides != task.picture.size:
        notes.append(f"quality measured at {sides[0]} x {sides[1]} pixels")
    level = quality.svg.psnr_db if quality.weighted_psnr_db is None else quality.weighted_psnr_db
    if level is not None and level < FAR_DB and _may_be_nearer(task, made):
        more = "more --curves bring it nearer" if made.style.name == PHOTO else "--style photo may be nearer"
        notes.append(f"the result is far from the picture, {level:.1f} dB; {more}")
    return Measured(quality, drawn.pixels, notes)


def _may_be_nearer(task: Task, made: Made) -> bool:
    """True if no option keeps the result from the picture, such as few curves or colours, or another ground."""
    own_colours = task.request.artwork.free_fills and task.request.ground == KEEP
    return not task.bounded and (made.style.name == PHOTO or (own_colours and not made.of_scan))


def dominant_colors(picture: Picture) -> list[dict[str, Any]]:
    """Return at most COLORS colours of a picture's opaque pixels, the most frequent first: each as `hex`, with its
    `share` of those pixels. They are found by median cut and k-means on a small copy.
    """
    small = resize_picture(picture, COLORS_SIDE)
    pixels = small.rgb.reshape(-1, 3) if small.alpha is None else small.rgb[small.alpha >= 0.5]
    if not len(pixels):
        return []
    image = Image.fromarray(np.rint(255.0 * pixels[None]).astype(np.uint8))
    image = image.quantize(COLORS, method=Image.Quantize.MEDIANCUT, kmeans=1)
    palette = bytes(image.getpalette() or ()).hex()
    return [
        {"hex": f"#{palette[6 * index : 6 * index + 6]}", "share": round(count / len(pixels), 3)}
        for index, count in sorted(enumerate(image.histogram()), key=lambda color: -color[1])
        if count
    ]


def geometrized(task: Task, made: Made, output: Output) -> str | None:
    """Return the shapes of a photo as Geometrize lists them; None for a picture of one colour."""
    if not isinstance(made.scene, Scene) or "history" not in made.facts:
        return None
    from cubicsplat_cli.svg.scene_writer import geometrize_list

    marks = {"program": PROGRAM, "svg_sha256": output.svg_sha256}
    return geometrize_list(task.request.settings.shapes, made.scene, scores_of(task, made.scene), marks)


def scores_of(task: Task, scene: Scene) -> list[float]:
    """Return the N + 1 root mean square errors, in [0, 1], of the background alone, and after each curve from the back
    to the front, on a copy of at most SCORES_SIDE px.
    """
    target = resize_picture(task.picture, SCORES_SIDE)
    sized = scene.scaled(target.width, target.height)
    goal = with_channels(target.target(), sized.channels)
    ground = np.zeros(4, np.float32) if sized.background is None else np.array(sized.background, np.float32)
    drawn: np.ndarray = np.broadcast_to(ground, goal.shape)
    scores = [float(np.sqrt(np.square(drawn - goal).mean()))]
    for curve in reversed(range(sized.curves)):
        alone = replace(sized.chosen(slice(curve, curve + 1)), background=None)
        layer = render_scene(alone, threads=task.request.settings.threads)
        drawn = layer[..., : goal.shape[2]] + (1.0 - layer[..., 3:]) * drawn
        scores.append(float(np.sqrt(np.square(drawn - goal).mean())))
    return scores


def output_of(task: Task, made: Made, text: str, data: bytes, **files: Any) -> Output:
    """Return the report's member `output`. text: the SVG. data: its file, maybe compressed. files: more members."""
    paths = drawn_elements(text) if "shapes" in made.facts else made.paths
    compressed = len(packed(text, compressed=True)) if task.request.counts_compressed else None
    return Output(paths, len(data), sha256_of(data), compressed_bytes=compressed, **files)


def report_of(task: Task, made: Made, figures: Measured | None, output: Output, *, path: str | None = None) -> Report:
    """Return the figures of a finished result, with the seconds so far. path: the user's name for the picture."""
    source, request, seconds = task.source, task.request, task.timer.seconds
    facts = {"device": {"name": "cpu"}, "timing": Timing(0.0, seconds["fit"]), **made.facts}
    stages = {f"{name}_s": seconds.get(name) for name in ("read", "write", "draw", "measure")}
    # Rounded here, so that the page and the summary, which round it further, agree with the written report.
    timing = replace(facts.pop("timing"), total_s=plain(task.timer.total(), "total_s"), **stages)
    return Report(
        input=Input(path or source.source, source.sha256, *source.size, source.alpha is not None),
        output=output,
        settings=request.deciding(),
        settings_hash=request.digest(),
        style=made.style.name,
        style_reason=made.style.reason,
        colors=dominant_colors(task.target),
        notes=[*task.target.notes, *made.notes, *task.logged, *([] if figures is None else figures.notes)],
        quality=None if figures is None else figures.quality,
        timing=timing,
        interrupted=made.interrupted,
        **facts,
    )
