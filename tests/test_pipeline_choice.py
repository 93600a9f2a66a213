"""The choice between photo and drawing, and what is put out when."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageFilter
from test_pipeline import SETTINGS, disc, flat_picture

from cubicsplat_cli import vectorize
from cubicsplat_cli.artwork import vectorize as drawing
from cubicsplat_cli.artwork.geometry.outlines import Rectangle
from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.artwork.style import Style
from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.files.convert import as_picture
from cubicsplat_cli.files.names import Outputs
from cubicsplat_cli.files.write import encode_png
from cubicsplat_cli.jobs.plan import Job
from cubicsplat_cli.jobs.run import run_job
from cubicsplat_cli.jobs.sinks import MemorySink
from cubicsplat_cli.photo.loop import FitLoop
from cubicsplat_cli.pipeline import candidates, choose, task_of
from cubicsplat_cli.pipeline import photo as photo_style
from cubicsplat_cli.pipeline.artwork import SAMPLES, drawn_outlines
from cubicsplat_cli.pipeline.likeness import Likeness, level_db, seen_db
from cubicsplat_cli.pipeline.photo import QuickPhoto
from cubicsplat_cli.pipeline.task import Made, Task
from cubicsplat_cli.progress import FrameRecorder, Observer, StageTimer
from cubicsplat_cli.request import Request
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import FitSettings


def blotches() -> np.ndarray:
    """Soft colours without a shape, with a flat sign in front."""
    y, x = np.mgrid[0:18, 0:24]
    waves = [np.sin(x / 9 + k) * np.cos(y / 7 - k) + np.sin((x + y) / (5 + k)) for k in range(3)]
    pixels = (127 + 60 * np.stack(waves, axis=-1)).clip(0, 255).astype(np.uint8)
    pixels[2:10, 3:15] = (20, 90, 160)
    return pixels


@pytest.fixture
def taken_for(monkeypatch):
    """Makes every picture suit a style: that, and the reason."""

    def take(style: str, reason: str) -> None:
        monkeypatch.setattr(choose, "choose_style", lambda _target: Style(style, reason))

    return take


def test_a_drawing_that_a_quick_photo_outdoes_gives_way_to_a_photo(monkeypatch, taken_for):
    taken_for("artwork", "flat")
    task = task_of(as_picture(blotches()), Request(FitSettings(curves=4, steps=60, threads=1)), StageTimer())
    first, second = candidates(task)
    assert (first.style.name, second.style.name) == ("artwork", "photo")
    assert "flat, but a quick photo of 4 curves" in second.style.reason
    monkeypatch.setattr(drawing, "MANY", 1)
    (early,) = candidates(task)
    assert (early.style.name, early.style.reason[:20]) == ("photo", second.style.reason[:20])
    asked = Request(SETTINGS, style="artwork", measure=False)
    assert [made.style.name for made in candidates(task_of(as_picture(blotches()), asked, StageTimer()))] == ["artwork"]


@pytest.mark.parametrize("svg", [None, Path("x.svg")])
def test_a_drawing_is_safe_while_the_photo_is_made_but_standard_output_gets_one_svg(svg, taken_for):
    class Puts(MemorySink):
        def put(self, kind: str, data: bytes) -> None:
            puts.append((kind, data))

    puts: list[tuple[str, bytes]] = []
    taken_for("artwork", "flat")
    data = encode_png(np.dstack([blotches(), np.full((18, 24), 255, np.uint8)]))
    job = Job("-", None, Outputs(svg, None, None), data=data)
    outcome = run_job(job, Request(FitSettings(curves=4, steps=60, threads=1)), sink=Puts(), observer=Observer())
    assert [kind for kind, _ in puts] == ["svg"] * (1 if svg is None else 2) + ["metrics"]
    assert outcome.report.style == "photo"
    assert outcome.report.output.svg_sha256 == hashlib.sha256(puts[-2][1]).hexdigest()


def test_ctrl_c_during_the_comparison_keeps_the_drawing(monkeypatch, taken_for):
    def interrupted(_loop) -> None:
        raise KeyboardInterrupt

    taken_for("artwork", "flat")
    monkeypatch.setattr(FitLoop, "advance", interrupted)
    task = task_of(as_picture(blotches()), Request(FitSettings(curves=4, steps=60, threads=1)), StageTimer())
    first, last = candidates(task)
    assert [made.interrupted for made in (first, last)] == [False, True]
    assert first.scene is last.scene


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


def test_a_photo_that_will_be_far_from_its_picture_is_not_fitted_to_the_end(taken_for, monkeypatch):
    taken_for("photo", "measured")
    monkeypatch.setattr(FitLoop, "finish", fails)
    (only,) = candidates(small_text())
    assert only.style.name == "artwork" and "measured, but as a photo it has only" in only.style.reason
    assert any("made as artwork" in note for note in only.notes)


@pytest.mark.parametrize("worse", ["worse", "failed"])
def test_a_photo_is_fitted_to_the_end_where_the_drawing_is_not_nearer(worse, taken_for, monkeypatch):
    taken_for("photo", "measured")
    level = choose.level_db
    calls = []

    def drawn(task: Task, *given: Any) -> Made:
        calls.append(task)
        return drawn_outlines(task, *given) if worse == "worse" else fails()

    def of_paths(task: Task, scene: Scene, samples: int, blur: float = 0.0) -> float | None:
        return 3.0 if samples == SAMPLES else level(task, scene, samples, blur)

    monkeypatch.setattr(choose, "drawn_outlines", drawn)
    monkeypatch.setattr(choose, "level_db", of_paths)
    (only,) = candidates(small_text())
    assert only.style.name == "photo" and len(calls) == 1
    assert any("the photo stays, since artwork failed" in note for note in only.notes) == (worse == "failed")


def test_a_photo_far_from_its_picture_gives_way_to_a_drawing_that_is_nearer(taken_for):
    taken_for("photo", "measured")
    # What the fit is to show is fitted to the end.
    first, second = candidates(replace(small_text(), recorder=FrameRecorder(2)))
    assert (first.style.name, second.style.name) == ("photo", "artwork")
    assert "measured, but as a photo it has only" in second.style.reason
    few = replace(small_text(), request=Request(FitSettings(curves=12, steps=20, threads=1)))
    assert len(list(candidates(few))) == 1


@pytest.mark.parametrize(
    ("doubtful", "sketch_db", "made"), [(True, 2.0, "artwork"), (True, -100.0, "photo"), (False, 2.0, "photo")]
)
def test_where_the_style_is_doubtful_a_drawing_is_tried(doubtful, sketch_db, made, monkeypatch):
    monkeypatch.setattr(choose, "choose_style", lambda _target: Style("photo", "measured", doubtful=doubtful))
    monkeypatch.setattr(choose, "FAR_DB", 0.0)
    monkeypatch.setattr(choose, "SKETCH_DB", sketch_db)
    monkeypatch.setattr(drawing, "MANY", 0)
    (only,) = candidates(task_of(as_picture(flat_picture()), Request(FitSettings(steps=20, threads=1)), StageTimer()))
    assert only.style.name == made


def test_where_the_style_is_doubtful_the_photo_may_end_above_what_an_early_look_tells(monkeypatch):
    monkeypatch.setattr(choose, "choose_style", lambda _target: Style("photo", "measured", doubtful=True))
    monkeypatch.setattr(choose, "FAR_DB", -100.0)
    monkeypatch.setattr(photo_style, "LOOKS", [(0.15, -40.0)])
    (only,) = candidates(task_of(as_picture(blotches()), Request(FitSettings(steps=200, threads=1)), StageTimer()))
    assert only.style.name == "photo"


def test_a_photo_is_not_fitted_to_the_end_where_a_later_look_tells_that_the_drawing_is_nearer(monkeypatch):
    monkeypatch.setattr(choose, "choose_style", lambda _target: Style("photo", "measured", doubtful=True))
    monkeypatch.setattr(choose, "FAR_DB", -100.0)
    monkeypatch.setattr(choose, "ENOUGH_DB", math.inf)
    monkeypatch.setattr(FitLoop, "finish", fails)
    (only,) = candidates(task_of(as_picture(flat_picture()), Request(FitSettings(steps=40, threads=1)), StageTimer()))
    assert only.style.name == "artwork" and any("a photo has only" in note for note in only.notes)


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
    for row, scene in ((lines, moved), (ramp, bands)):
        pixels = np.repeat(np.repeat(row.astype(np.uint8)[None, :, None], 64, axis=0), 3, axis=2)
        task = task_of(as_picture(pixels), Request(FitSettings(threads=1)), StageTimer())
        levels.append((level_db(task, scene, 1), seen_db(task, scene, 1)))
    (edges, edges_seen), (tones, tones_seen) = levels
    assert edges < tones - 2.0 and edges_seen > tones_seen + 2.0


def test_the_sketch_of_a_blurred_picture_is_compared_blurred(monkeypatch):
    monkeypatch.setattr(drawing, "MANY", 0)
    blurred = Image.fromarray(disc()).filter(ImageFilter.GaussianBlur(2.0))
    sketches = []
    made = drawn_outlines(task_of(as_picture(np.asarray(blurred)), Request(), StageTimer()), sketches.append)
    assert made.blur > 0.5
    assert [sketch.blur for sketch in sketches] == [made.blur]


@pytest.mark.parametrize("level", [0.0, 60.0])
def test_a_quick_photo_is_fitted_only_as_far_as_its_level_matters(level, monkeypatch):
    shares = []
    relax = FitLoop.relax
    monkeypatch.setattr(FitLoop, "relax", lambda loop, share=1.0: shares.append(share) or relax(loop, share))
    task = task_of(as_picture(blotches()), Request(FitSettings(threads=1)), StageTimer())
    quick = QuickPhoto(task, 4, lambda scene: level_db(task, scene, 48))
    found = quick.beyond(level)
    # At 60 dB it is plain at the first look that four curves will not get there; then nothing more is done.
    assert (found is None) == (level == 60.0)
    assert shares == ([0.15] if level == 60.0 else [0.15, 0.4, 0.65])
    assert quick.beyond(level) == found
    assert len(shares) == (1 if level == 60.0 else 3)


@pytest.mark.parametrize(("drawn", "beyond"), [(30.0, 31.0), (21.0, 22.0), (11.5, 11.16)])
def test_outlines_may_bring_a_sketch_nearer_by_so_many_decibels_or_so_much_of_its_error(drawn, beyond, monkeypatch):
    asked = []
    monkeypatch.setattr(Likeness, "pixels_db", lambda _: drawn)
    monkeypatch.setattr(Likeness, "seen_db", lambda *_: drawn)
    monkeypatch.setattr(QuickPhoto, "beyond", lambda _, least: asked.append(least))
    task = task_of(as_picture(disc()), Request(FitSettings(threads=1)), StageTimer())
    choose.check_worth_finishing(task, drawn_outlines(task))
    assert asked == [pytest.approx(beyond, abs=0.02)]


def fails(*_) -> None:
    raise EngineError("it is broken")


@pytest.mark.parametrize(("broken", "other"), [("artwork", "photo"), ("photo", "artwork")])
def test_where_a_style_fails_the_other_one_is_made_and_says_so(broken, other, monkeypatch, taken_for):
    monkeypatch.setattr(choose, "drawn_outlines", fails if broken == "artwork" else choose.drawn_outlines)
    monkeypatch.setattr(choose, "PhotoFit", fails if broken == "photo" else choose.PhotoFit)
    monkeypatch.setitem(choose.MAKERS, broken, fails)
    taken_for(broken, "measured")
    report = vectorize(flat_picture(), threads=1, steps=5).report
    assert (report.style, report.style_reason) == (other, f"measured, but as {broken} it failed")
    assert f"made as {other}, since {broken} failed: it is broken" in report.notes
    with pytest.raises(EngineError, match="it is broken"):
        vectorize(flat_picture(), style=broken)


@pytest.mark.parametrize("error", [MemoryError(), ZeroDivisionError("by nothing")])
def test_a_finished_drawing_stays_where_the_photo_fails(error, monkeypatch):
    def fail(*_) -> None:
        raise error

    monkeypatch.setattr(choose, "photo_is_nearer", fail)
    report = vectorize(flat_picture(), threads=1).report
    assert report.style == "artwork"
    assert any("the drawing stays" in note and ("memory" in note or "bug" in note) for note in report.notes)
