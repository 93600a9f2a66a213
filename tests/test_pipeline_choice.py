"""The choice between photo and drawing, and what is put out when."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ctrl_c, ctrl_c_when
from image_files import encode
from PIL import Image, ImageDraw, ImageFilter
from scipy import ndimage
from test_pipeline import SETTINGS, disc, flat_picture

from cubicsplat_cli import vectorize
from cubicsplat_cli.artwork.geometry.outlines import Circle, Rectangle
from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.artwork.shapes import Drawing, Shape, ground_shape
from cubicsplat_cli.artwork.style import Style
from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.evaluate.metrics import decibels
from cubicsplat_cli.files.load import as_picture, load_picture
from cubicsplat_cli.files.names import Outputs
from cubicsplat_cli.files.write import encode_png
from cubicsplat_cli.jobs.plan import Job
from cubicsplat_cli.jobs.results import Sink
from cubicsplat_cli.jobs.run import run_job
from cubicsplat_cli.photo.loop import FitLoop
from cubicsplat_cli.pipeline import choose
from cubicsplat_cli.pipeline.artwork import drawn_artwork, drawn_outlines
from cubicsplat_cli.pipeline.choose import (
    ENOUGH_DB,
    candidates,
    photo_is_nearer,
)
from cubicsplat_cli.pipeline.likeness import compared_copies, delta_e, level_db, seen_db
from cubicsplat_cli.pipeline.photo import BYTES_PER_CURVE, PhotoFit, curves_of_equal_bytes, photo_settings, quick_photo
from cubicsplat_cli.pipeline.shaded import most_shaded_db, shaded_drawing
from cubicsplat_cli.pipeline.task import Drawn, Made, Task
from cubicsplat_cli.pipeline.vectorize import task_of
from cubicsplat_cli.progress import FrameRecorder, Observer, Progress, StageTimer
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.request import Request
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import FitSettings

FLAT, MEASURED = Style("artwork", "flat"), Style("photo", "measured")


def waves(height: int, width: int) -> np.ndarray:
    """Soft colours without a shape."""
    y, x = np.mgrid[0:height, 0:width]
    waves = [np.sin(x / 9 + k) * np.cos(y / 7 - k) + np.sin((x + y) / (5 + k)) for k in range(3)]
    return (127 + 60 * np.stack(waves, axis=-1)).clip(0, 255).astype(np.uint8)


def blotches() -> np.ndarray:
    """The same with a flat sign in front."""
    pixels = waves(18, 24)
    pixels[2:10, 3:15] = (20, 90, 160)
    return pixels


def strands() -> np.ndarray:
    """Soft strands of hair, without a flat colour."""
    y, x = np.mgrid[0:96, 0:96]
    phase = (x + 2 * np.sin(y / 17)) / 2.2
    colours = [150 + 90 * np.sin(phase), 90 + 60 * np.sin(phase + 0.5) + 0.3 * y, 70 + 50 * np.sin(phase * 0.76)]
    return np.stack(colours, axis=-1).clip(0, 255).astype(np.uint8)


def mottled() -> np.ndarray:
    """Soft blots of all colours."""
    noise = ndimage.gaussian_filter(np.random.default_rng(0).normal(0.0, 200.0, (64, 64, 3)), (1.5, 1.5, 0.0))
    return (128.0 + noise).clip(0, 255).astype(np.uint8)


def speckled(levels: float) -> np.ndarray:
    """A rectangle under grey noise of so many levels (standard deviation)."""
    noise = np.random.default_rng(1).normal(0.0, levels, (40, 48, 1))
    return np.clip(flat_picture() + noise, 0, 255).astype(np.uint8)


def task_for(pixels: np.ndarray, **settings: Any) -> Task:
    return task_of(as_picture(pixels), Request(FitSettings(threads=1, **settings)), StageTimer())


def test_a_drawing_that_a_quick_photo_outdoes_gives_way_to_a_photo():
    first, second = candidates(task_for(blotches(), curves=12, steps=60), FLAT)
    assert (first.style.name, second.style.name) == ("artwork", "photo")
    assert "flat, but a quick photo of 12 curves" in second.style.reason
    asked = Request(SETTINGS, style="artwork", measure=False)
    assert [made.style.name for made in candidates(task_of(as_picture(blotches()), asked, StageTimer()))] == ["artwork"]


def test_a_photo_that_is_farther_in_colour_does_not_replace_a_drawing():
    """Even where much of it is lost."""
    task = task_for(blotches(), curves=4, steps=60)
    (drawing,) = candidates(task, FLAT)
    photo = task.once(PhotoFit).finished
    assert seen_db(task, drawing) < 32.0
    assert delta_e(task, drawing) < delta_e(task, photo)


def test_a_drawing_of_many_pieces_gives_way_before_it_is_finished():
    task = task_for(strands(), steps=400)
    (early,) = candidates(task, FLAT)
    assert early.style.name == "photo" and "flat, but a photo has" in early.style.reason
    assert early.scene is task.once(PhotoFit).finished.scene  # which is not fitted twice


def test_a_photo_that_is_expected_to_stay_behind_is_not_fitted_to_the_end():
    seen = list[Progress]()
    fit = replace(task_for(strands(), steps=100), on_progress=seen.append).once(PhotoFit)
    possible = fit.seen_if_above(60.0)
    assert 40.0 < possible < 60.0 and all(progress.step <= 4 for progress in seen)
    expected = fit.seen_if_above(40.0)
    assert expected < 40.0 and all(progress.step <= 20 for progress in seen)
    assert fit.seen_if_above(20.0) == fit.seen_if_above(19.0) not in (possible, expected)
    assert seen[-1].step == 100


@pytest.mark.parametrize("svg", [None, Path("x.svg")])
def test_a_drawing_is_safe_while_the_photo_is_made_but_standard_output_gets_one_svg(svg):
    class Puts(Sink):
        def put(self, kind: str, data: bytes) -> None:
            puts.append((kind, data))

    puts: list[tuple[str, bytes]] = []
    pixels = np.dstack([blotches(), np.full((18, 24), 255, np.uint8)])
    pixels[:, :16, :3] = (20, 90, 160)
    job = Job("-", None, Outputs(svg, None, None), data=encode_png(pixels))
    outcome = run_job(job, Request(FitSettings(curves=4, steps=60, threads=1)), sink=Puts(), observer=Observer())
    assert [kind for kind, _ in puts] == ["svg"] * (1 if svg is None else 2) + ["metrics"]
    assert outcome.report.style == "photo"
    assert outcome.report.output.svg_sha256 == hashlib.sha256(puts[-2][1]).hexdigest()


@pytest.mark.parametrize("during", ["comparison", "photo"])
def test_ctrl_c_keeps_the_drawing(during, monkeypatch):
    told = ctrl_c_when(lambda progress: progress.steps)  # those of a photo's fit, which a quick one does not tell
    if during == "comparison":
        monkeypatch.setattr(FitLoop, "advance", ctrl_c)
    first, last = candidates(replace(task_for(blotches(), curves=8, steps=60), on_progress=told), FLAT)
    assert [made.interrupted for made in (first, last)] == [False, True]
    assert first.scene is last.scene


def test_ctrl_c_in_a_drawing_ends_all():
    """A photo that may be nearer is not fitted any more; without the drawing, there is no result."""
    told: list[Progress] = []

    def stop(progress: Progress) -> None:
        told.append(progress)
        if progress.stage == "fitting outlines":
            raise KeyboardInterrupt

    (made,) = candidates(replace(task_for(blotches(), steps=60), on_progress=stop), FLAT)
    assert made.interrupted
    with pytest.raises(KeyboardInterrupt):
        next(candidates(replace(task_for(strands(), steps=400), on_progress=stop), FLAT))
    assert not any(progress.step for progress in told)


def test_a_result_far_from_its_picture_says_so_in_its_report_alone(capfd):
    texture = np.random.default_rng(2).integers(0, 255, (40, 48, 3), dtype=np.uint8)
    report = vectorize(texture, style="photo", steps=3, threads=1).report
    assert any("far from the picture" in note and "--curves" in note for note in report.notes)
    assert not any("far" in note for note in vectorize(disc(), threads=1).report.notes)
    assert capfd.readouterr() == ("", "")


def test_a_drawing_that_is_near_its_picture_stays():
    noisy = np.clip(disc() + np.random.default_rng(1).normal(0, 5, (80, 96, 3)), 0, 255).astype(np.uint8)
    assert vectorize(noisy, threads=1, measure=False).report.style == "artwork"


def test_lines_too_fine_for_shapes_become_a_photo():
    """A mesh of hairlines over nothing, of which no pixel has half."""
    y, x = np.mgrid[0:60, 0:60]
    mesh = np.where(np.abs(np.hypot(x - 30, y - 30) - 20) < 5, 90 * np.abs(np.sin(1.3 * x) * np.sin(1.7 * y)), 0)
    lines = np.dstack([np.zeros((60, 60, 3)), mesh]).astype(np.uint8)
    made = vectorize(lines, threads=1, measure=False)
    assert made.report.style == "photo" and any("too fine" in note for note in made.report.notes)
    drawn = vectorize(lines, style="artwork", threads=1, measure=False)
    assert drawn.report.style == "artwork" and any("no shapes" in note for note in drawn.report.notes)


def small_text() -> Task:
    y, x = np.mgrid[0:64, 0:96]
    letters = np.where(((x // 2 + y // 3 * 7) * 2654435761 >> 7) % 3 == 0, 20, 235).astype(np.uint8)
    text = np.dstack([letters] * 3)
    text[:20] = 235
    return task_of(as_picture(text), Request(FitSettings(steps=20, threads=1)), StageTimer())


def is_finished(told: list[Progress]) -> bool:
    """Whether a photo was fitted to its end."""
    return any(progress.step == progress.steps > 0 for progress in told)


def only_made(task: Task, style: Style) -> tuple[Made, list[Progress]]:
    told: list[Progress] = []
    (only,) = candidates(replace(task, on_progress=told.append), style)
    return only, told


def test_a_photo_that_will_be_far_from_its_picture_is_not_fitted_to_the_end():
    only, told = only_made(small_text(), MEASURED)
    assert only.style.name == "artwork" and "measured, but as a photo it has only" in only.style.reason
    assert any("made as artwork" in note for note in only.notes)
    assert not is_finished(told)


def test_a_photo_is_fitted_to_the_end_where_the_drawing_fails(monkeypatch):
    monkeypatch.setattr(choose, "drawn_outlines", fails)
    only, told = only_made(small_text(), MEASURED)
    assert only.style.name == "photo" and is_finished(told)
    assert "made as photo, since artwork failed: it is broken" in only.notes


def graded() -> np.ndarray:
    """A disc with a radial gradient on white."""
    y, x = np.mgrid[:128, :128].astype(float)
    t = np.minimum(np.hypot(x - 50, y - 45) / 60, 1.0)[..., None]
    share = np.clip(50.0 - np.hypot(x - 63.5, y - 63.5), 0.0, 1.0)[..., None]
    return np.rint(255 + share * ((1.0 - t) * [250, 220, 120] + t * [150, 30, 60] - 255)).astype(np.uint8)


def test_what_may_be_a_photo_is_drawn_first(monkeypatch):
    task, doubtful = task_for(graded(), steps=60), replace(MEASURED, doubtful=True)
    only, told = only_made(task, doubtful)
    assert (only.style.name, only.facts["shapes"], is_finished(told)) == ("artwork", 2, False)
    assert (choose._shaded,) not in task.results
    shaded = task.once(choose._shaded)
    assert shaded is not None and curves_of_equal_bytes(task, only) <= curves_of_equal_bytes(task, shaded)
    assert delta_e(task, only) <= delta_e(task, shaded)
    monkeypatch.setattr(choose, "_nearest_shaded", lambda _: shaded)
    certain, _ = only_made(task, MEASURED)
    assert "shaded within its outlines: no photo of as many bytes is nearer" in certain.notes
    monkeypatch.setattr(choose, "drawn_outlines", fails)
    fitted, _ = only_made(task, doubtful)
    assert fitted.style.name == "photo" and "made as photo, since artwork failed: it is broken" in fitted.notes


def test_shading_is_not_made_where_a_drawing_is_nearer_than_it_can_be(monkeypatch):
    task = task_for(graded(), steps=60)
    made = shaded_drawing(task)
    assert seen_db(task, made) < most_shaded_db(task) < 70.0
    even = task_for(np.full((96, 96, 3), 200, np.uint8))
    assert most_shaded_db(even) == -math.inf
    monkeypatch.setattr("cubicsplat_cli.pipeline.shaded.shade_objects", fails)
    blank, task = drawn_outlines(task_for(np.full((96, 96, 3), 200, np.uint8))), task_for(graded(), steps=60)
    blank = replace(blank, facts=blank.facts | {"shapes": 1}, may_be_photo=True)
    assert photo_is_nearer(task, blank, 60.0, or_shaded=True) is None
    with pytest.raises(EngineError, match="it is broken"):
        photo_is_nearer(task, blank, or_shaded=True)


def test_a_photo_far_from_its_picture_stays_where_its_fit_is_to_be_seen_or_is_bounded():
    filmed = replace(small_text(), recorder=FrameRecorder(2))
    few = replace(small_text(), request=Request(FitSettings(curves=12, steps=20, threads=1)))
    assert [[made.style.name for made in candidates(task, MEASURED)] for task in (filmed, few)] == [["photo"]] * 2


@pytest.mark.parametrize(("doubtful", "made"), [(True, "artwork"), (False, "photo")])
def test_where_the_style_is_doubtful_a_drawing_is_tried(doubtful, made):
    only, told = only_made(task_for(speckled(2.0), steps=30), replace(MEASURED, doubtful=doubtful))
    assert only.style.name == made
    assert any(progress.stage == "finding regions" for progress in told) == doubtful


@pytest.mark.parametrize(("off", "finished"), [((0.4, 0.9), True), ((0.4, 0.45), False)])
def test_a_doubtful_sketch_of_more_bytes_than_a_photo_must_be_nearer_in_its_colours(off, finished, monkeypatch):
    """Of twice as many bytes, by a quarter."""
    figures = cycle(off)
    monkeypatch.setattr(choose, "delta_e", lambda *_: next(figures))
    task, told = task_for(mottled(), steps=20), list[Progress]()
    next(candidates(replace(task, on_progress=told.append), replace(MEASURED, doubtful=True)))
    assert ("regularising" in {progress.stage for progress in told}) == finished


def test_a_doubtful_drawing_is_given_up_where_its_sketch_is_no_nearer_than_an_early_look_at_the_photo():
    only, told = only_made(task_for(mottled(), steps=300), replace(MEASURED, doubtful=True))
    assert only.style.name == "photo" and is_finished(told)
    stages = {progress.stage for progress in told}
    assert "fitting outlines" in stages and "regularising" not in stages


def test_where_the_style_is_doubtful_a_photo_may_replace_the_drawing():
    told: list[Progress] = []
    task = replace(task_for(blotches(), steps=200), on_progress=told.append)
    drawn, photo = candidates(task, replace(MEASURED, doubtful=True))
    assert (drawn.style.name, photo.style.name) == ("artwork", "photo") and is_finished(told)


def test_a_photo_is_not_fitted_to_the_end_where_a_quick_one_is_no_nearer_than_the_drawing():
    only, told = only_made(task_for(speckled(2.6), steps=60), replace(MEASURED, doubtful=True))
    assert only.style.name == "artwork" and not is_finished(told)


@pytest.mark.parametrize(("curves", "smaller"), [(None, True), (2, False)])
def test_only_a_drawing_of_fewer_bytes_replaces_a_photo_at_sight(curves, smaller):
    task = task_for(speckled(2.0), curves=curves)
    with task.working():
        assert (curves_of_equal_bytes(task, drawn_artwork(task)) < photo_settings(task).curves) == smaller


def test_shading_that_is_missing_counts_more_than_edges_that_are_a_little_off():
    def stripes(edges: np.ndarray, levels: list[int]) -> Scene:
        shapes = [
            Shape((level, level, level, 255), (Rectangle(x, 0.0, 64.0 - x, 64.0),), "stripe")
            for x, level in zip(edges.tolist(), levels, strict=True)
        ]
        return scene_of(Drawing(64, 64, tuple(shapes)))

    places = np.arange(64)
    lines, ramp = np.where(places % 4 < 2, 40, 220), np.rint(60.0 + 2.0 * (places + 0.5))
    moved = stripes(np.maximum(np.arange(0.0, 64.0, 2.0) + 0.2 * (np.arange(32) > 0), 0.0), [40, 220] * 16)
    bands = stripes(np.array([0.0, 32.0]), [92, 156])
    levels = []
    faint_bands = stripes(np.arange(0.0, 64.0, 16.0), [64, 72, 80, 88])
    for row, scene in ((lines, moved), (ramp, bands), (np.rint(60.0 + 0.5 * places), faint_bands)):
        pixels = np.repeat(np.repeat(row.astype(np.uint8)[None, :, None], 64, axis=0), 3, axis=2)
        task = task_of(as_picture(pixels), Request(FitSettings(threads=1)), StageTimer())
        levels.append((level_db(task, Drawn(scene, 1)), seen_db(task, Drawn(scene, 1), ENOUGH_DB)))
    (edges, edges_seen), (tones, tones_seen), (faint, faint_seen) = levels
    assert edges < tones - 2.0 and edges_seen > tones_seen + 2.0
    assert faint > ENOUGH_DB and math.isfinite(faint_seen), "bands are seen at a level at which nobody sees edges"


def lossy_task(pixels: np.ndarray, file_format: str = "JPEG") -> Task:
    read = load_picture(encode(Image.fromarray(pixels), file_format, quality=75))
    return task_of(read, Request(FitSettings(threads=1)), StageTimer())


@pytest.mark.parametrize(("file_format", "rise_db"), [("JPEG", 10.0), ("WEBP", 4.0)])
def test_the_artefacts_of_a_lossy_file_are_no_errors_of_its_drawing(file_format, rise_db):
    disc_shape = Shape((0, 90, 200, 255), (Circle(32.0, 32.0, 20.0),), "disc")
    scene = scene_of(Drawing(64, 64, (ground_shape((250, 240, 230, 255), 64, 64), disc_shape)))
    task = lossy_task(np.rint(255.0 * render_scene(scene)[..., :3]).astype(np.uint8), file_format)
    plain = replace(task, target=replace(task.target, compression=None), results={})
    assert level_db(task, Drawn(scene, 24)) > level_db(plain, Drawn(scene, 24)) + rise_db
    (made,) = candidates(replace(task, request=Request(replace(SETTINGS, curves=8, steps=60), style="photo")))
    photo = Drawn(made.scene, 24)
    assert level_db(task, photo) > level_db(plain, photo), "an opaque picture has no opacity"


def test_a_drawing_through_the_steps_of_edges_without_anti_aliasing_has_lost_nothing():
    y, x = np.mgrid[0:76, 0:76] - 37.4
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    shown = (radius < 37.0) & (radius > 13.0) & ~((np.abs(radius - 32.0) < 1.3) & (angle < -1.6))
    shown &= ~((np.abs(radius - 19.0) < 1.3) & (np.abs(angle - 0.9) < 0.7))
    task = task_for(np.repeat(np.where(shown, 0, 255).astype(np.uint8)[..., None], 3, axis=2))
    (made,) = candidates(task)
    assert made.style.name == "artwork" and made.facts["shapes"] <= 6
    level = decibels((made.unavoidable_error / 255.0) ** 2)
    assert level - 1.0 < level_db(task, made) < level + 4.0


def test_the_colour_fringes_of_text_for_an_lcd_are_no_errors_of_its_drawing():
    fine = Image.new("L", (3 * 180, 40), 255)
    for k in range(9):
        ImageDraw.Draw(fine).ellipse([54 * k + 20, 8, 54 * k + 60, 30], outline=30, width=5)
    filtered = ndimage.uniform_filter1d(np.asarray(fine).astype(float), 3, axis=1)
    task = task_for(np.rint(filtered).reshape(40, 180, 3).astype(np.uint8))
    made = drawn_outlines(task)
    copies = task.once(compared_copies)
    assert len(copies) == 2
    plain = replace(task, target=copies[1], results={})
    level, of_plain = (level_db(each, made) for each in (task, plain))
    of_fringes = decibels(float(np.square(render_scene(made.scene)[..., :3] - task.pixels).mean()))
    assert level == of_plain > of_fringes + 5.0


@pytest.mark.slow
def test_a_logo_of_radial_gradients_is_drawn_of_its_jpeg():
    y, x = np.mgrid[0:400, 0:400] - 199.5
    reach = np.clip(np.hypot(x + 60.0, y - 200.0) / 420.0, 0.0, 1.0)[..., None]
    shade = (1.0 - reach) * (255.0, 220.0, 85.0) + reach * (200.0, 55.0, 171.0)
    ring = np.clip(110.0 - np.hypot(x, y), 0.0, 1.0) - np.clip(80.0 - np.hypot(x, y), 0.0, 1.0)
    square = np.clip(160.0 - np.maximum(np.abs(x), np.abs(y)), 0.0, 1.0)
    cover = np.clip(square - ring, 0.0, 1.0)[..., None]
    (made,) = candidates(lossy_task(np.rint(cover * shade + (1.0 - cover) * 255.0).astype(np.uint8)))
    assert made.style.name == "artwork" and made.facts["shapes"] <= 6


@pytest.mark.slow
@pytest.mark.parametrize("filtered", ["BILINEAR", "BICUBIC"])
def test_the_drawing_of_an_enlarged_picture_is_compared_with_the_small_one(filtered):
    pixels = np.asarray(Image.fromarray(flat_picture()).resize((96, 80), Image.Resampling[filtered]))
    task = task_of(as_picture(pixels), Request(FitSettings(threads=1)), StageTimer())
    drawing = drawn_outlines(task)
    assert drawing.small is not None and drawing.small.size == (48, 40)
    large = replace(drawing, small=None)
    # The enlarged edges are off the drawing's, and so they are in its blurred copy.
    assert level_db(task, drawing) > level_db(task, large) + 5.0
    assert delta_e(task, drawing) < delta_e(task, large)


def test_the_sketch_of_a_blurred_picture_is_compared_blurred():
    class Seen(Exception):
        pass

    def see(sketch: Made) -> None:
        assert sketch.facts["segments"] > 1000 and sketch.blur > 0.5
        raise Seen

    y, x = np.mgrid[0:272, 0:272] % 16 - 7.5
    cover = np.clip(5.5 - np.hypot(x, y), 0.0, 1.0)[..., None]
    dots = np.rint(240.0 + cover * (np.array([20, 90, 160]) - 240.0)).astype(np.uint8)
    blurred = Image.fromarray(dots).filter(ImageFilter.GaussianBlur(2.0))
    with pytest.raises(Seen):
        drawn_outlines(task_of(as_picture(np.asarray(blurred)), Request(), StageTimer()), see)


def soft_ball() -> np.ndarray:
    """A ball with soft shading, on nothing."""
    y, x = np.mgrid[0:64, 0:64] - 31.5
    alpha = np.rint(255 * np.clip(28.0 - np.hypot(x, y), 0.0, 1.0))
    ball = np.dstack([200 + 0.05 * x * y, 120 + 0.08 * (x**2 - y**2), 40 + 0.05 * y**2, alpha])
    return np.rint(np.clip(ball, 0, 255)).astype(np.uint8)


def test_soft_shading_of_few_pixels_is_nearer_as_a_photo():
    task = task_for(soft_ball(), curves=48)
    drawing = drawn_outlines(task)
    assert "a quick photo of" in str(photo_is_nearer(task, drawing))


@pytest.mark.parametrize(("off", "style"), [((0.4, 0.5), "artwork"), ((0.5, 0.4), "photo")])
def test_a_photo_must_be_nearer_in_its_colours_too(off, style, monkeypatch):
    figures = iter(2 * off)  # beside a quick photo, and the finished one
    monkeypatch.setattr(choose, "delta_e", lambda *_: next(figures))
    *_, made = candidates(task_for(soft_ball(), curves=48, steps=60), FLAT)
    assert made.style.name == style


def test_a_photo_is_nearer_if_it_is_beyond_what_the_drawing_may_rise_to():
    task = task_for(blotches(), curves=8)
    drawing = drawn_outlines(task)
    assert "a quick photo of 8 curves has" in str(photo_is_nearer(task, drawing))
    photo = seen_db(task, task.once(quick_photo, 8))
    lead = photo - seen_db(task, replace(drawing, small=None))
    assert photo_is_nearer(task, drawing, lead + 0.9) is not None
    assert photo_is_nearer(task, drawing, lead + 1.1) is None


@pytest.mark.parametrize(("times", "nearer"), [(1, False), (64, True)])
def test_a_drawing_of_many_bytes_is_compared_with_a_photo_of_as_many(times, nearer, monkeypatch):
    """64 times the bytes are 12 dB."""
    task = task_for(blotches(), steps=40)
    level = seen_db(task, Drawn(task.once(PhotoFit).finished.scene, 8))
    monkeypatch.setattr(choose, "seen_db", lambda *_: level + 6.0)
    text = "x" * round(times * BYTES_PER_CURVE * photo_settings(task).curves)
    drawing = replace(drawn_outlines(task), write=lambda **_: text)
    assert (photo_is_nearer(task, drawing) is not None) == nearer


def quick_curves(task: Task) -> list[int]:
    return [key[1] for key in task.results if key[0] is quick_photo]


def test_only_a_drawing_that_has_lost_much_is_compared_with_a_photo_of_more_bytes():
    task = task_for(blotches(), curves=16)
    drawing = drawn_outlines(task)
    assert photo_is_nearer(task, drawing) is not None and quick_curves(task) == [16]
    few = curves_of_equal_bytes(task, drawing)
    assert photo_is_nearer(task, drawing, 10.0) is None and quick_curves(task) == [16, few] and few < 16


def fails(*_) -> None:
    raise EngineError("it is broken")


@pytest.mark.parametrize(("broken", "other"), [("artwork", "photo"), ("photo", "artwork")])
def test_where_a_style_fails_the_other_one_is_made_and_says_so(broken, other, monkeypatch):
    monkeypatch.setattr(choose, "drawn_outlines", fails if broken == "artwork" else choose.drawn_outlines)
    monkeypatch.setitem(choose.MAKERS, broken, fails)
    (made,) = candidates(task_for(flat_picture(), steps=5, curves=4), Style(broken, "measured"))
    assert (made.style.name, made.style.reason) == (other, f"measured, but as {broken} it failed")
    assert f"made as {other}, since {broken} failed: it is broken" in made.notes
    with pytest.raises(EngineError, match="it is broken"):
        vectorize(flat_picture(), style=broken)


@pytest.mark.parametrize("error", [MemoryError(), ZeroDivisionError("by nothing")])
def test_a_finished_drawing_stays_where_the_photo_fails(error, monkeypatch):
    def fail(*_) -> None:
        raise error

    monkeypatch.setattr(choose, "quick_photo", fail)
    *_, made = candidates(task_for(blotches(), curves=4), FLAT)
    assert made.style.name == "artwork"
    assert any("the drawing stays" in note and ("memory" in note or "bug" in note) for note in made.notes)
