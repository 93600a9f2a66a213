"""One picture from end to end: interrupts, sizes, time, single colours."""

from __future__ import annotations

import gzip
import time
from itertools import product

import numpy as np
import pytest
import torch
from conftest import rest_slow
from PIL import Image

from cubicsplat_cli import UsageError, vectorize
from cubicsplat_cli.evaluate import metrics as measuring
from cubicsplat_cli.evaluate.metrics import decibels
from cubicsplat_cli.files.load import as_picture, resize_picture
from cubicsplat_cli.photo.inputs import FitInputs
from cubicsplat_cli.photo.loop import FitLoop
from cubicsplat_cli.pipeline import photo as photo_style
from cubicsplat_cli.pipeline.choose import candidates
from cubicsplat_cli.pipeline.vectorize import measured, task_of, vectorize_picture
from cubicsplat_cli.progress import COMMAND_BEGAN, Progress, StageTimer, Work
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings

SETTINGS = FitSettings(curves=6, steps=12, threads=1)


def flat_picture() -> np.ndarray:
    pixels = np.full((40, 48, 3), 240, np.uint8)
    pixels[8:30, 10:34] = (20, 90, 160)
    return pixels


def disc() -> np.ndarray:
    y, x = np.mgrid[0:80, 0:96] + 0.5
    cover = np.clip(30.5 - np.hypot(x - 50.0, y - 41.0), 0.0, 1.0)[..., None]
    return np.rint(240.0 + cover * (np.array([20, 90, 160]) - 240.0)).astype(np.uint8)


def test_a_flat_picture_is_drawn_and_the_report_says_why():
    report = vectorize(flat_picture(), threads=1).report
    assert (report.style, report.shapes, report.primitives) == ("artwork", 2, 2)
    assert report.inks == ["#f0f0f0ff", "#145aa0ff"]
    assert "edges between" in report.style_reason


@pytest.mark.parametrize(
    ("share", "stop"),
    rest_slow(
        *((0.0, "limit"), (0.08, "interrupt"), (0.25, "limit"), (0.45, "interrupt"), (0.85, "limit")),
        *product((0.0, 0.08, 0.13, 0.18, 0.25, 0.45, 0.55, 0.75, 0.85), ("interrupt", "limit")),
        fast=5,
    ),
)
def test_a_drawing_that_is_stopped_is_finished_with_what_there_is(share, stop, monkeypatch):
    said = []

    def on_progress(at: Progress) -> None:
        said.append((at.share, at.stage))
        if at.share >= share and stop == "interrupt":
            raise KeyboardInterrupt

    def at(self: Work, stage: str = "", part: float = 0.0) -> None:
        if part >= share and stop == "limit" and self.on_progress is not None:
            self.deadline = 0.0
        tell(self, stage, part)

    tell = Work.at
    monkeypatch.setattr(Work, "at", at)
    result = vectorize(disc(), style="artwork", threads=1, on_progress=on_progress)
    assert result.report.interrupted is (stop == "interrupt")
    assert (stop == "limit") == any("time limit" in note for note in result.report.notes)
    assert result.report.shapes == 2
    assert result.report.quality.svg.psnr_db is None or result.report.quality.svg.psnr_db > 25
    assert [share for share, _ in said] == sorted(share for share, _ in said)


def test_a_drawing_tells_how_far_it_is():
    said = []
    vectorize(flat_picture(), style="artwork", threads=1, measure=False, on_progress=said.append)
    assert {"looking at the picture", "finding regions", "fitting outlines", "regularising"} <= {s.stage for s in said}
    assert all(0.0 <= at.share < 1.0 and at.psnr_db is None for at in said)


def test_a_result_is_saved_as_an_svg_and_never_over_a_picture(tmp_path):
    result = vectorize(np.full((8, 8, 3), 200, np.uint8), measure=False)
    pictures = [tmp_path / name for name in ("a.png", "b.svg", "c", "d.jpg")]
    for path in pictures:
        Image.new("RGB", (3, 3)).save(path, "JPEG")
    for path in (*pictures, tmp_path / "new.png", tmp_path / "new.txt"):
        before = path.read_bytes() if path.exists() else None
        with pytest.raises(UsageError, match=r"must end in \.svg|is a picture"):
            result.save(path)
        assert (path.read_bytes() if path.exists() else None) == before
    for name in ("x.svg", "X.SVG", "none", "x.svg"):
        result.save(str(tmp_path / name))
        assert (tmp_path / name).read_text() == result.svg
    result.save(tmp_path / "x.svgz")
    assert gzip.decompress((tmp_path / "x.svgz").read_bytes()).decode() == result.svg


@pytest.mark.parametrize("style", ["photo", "artwork"])
def test_the_svg_is_there_before_it_is_measured(style):
    task = task_of(as_picture(flat_picture()), Request(SETTINGS, style=style), StageTimer())
    (made,) = candidates(task)
    svg = task.svg(made)
    assert svg.endswith("</svg>\n")
    found = measured(task, made, svg)
    assert found.pixels.shape == (40, 48, 4)
    assert found.quality.svg.psnr_db is None or found.quality.svg.psnr_db > 8


def test_the_svg_keeps_the_size_of_a_picture_that_was_scaled_down():
    done = vectorize_picture(as_picture(flat_picture()), Request(SETTINGS, style="artwork", max_size=24))
    assert 'viewBox="0 0 48 40"' in done.svg
    assert (done.scene.width, done.scene.height) == (48, 40)
    quality = done.report.quality.svg
    assert quality.identical or quality.psnr_db > 20


@pytest.fixture
def fitted(monkeypatch):
    """Of each fit the sizes of its pictures: the one on which it ends, and the one on which it begins, if any.

    Copies of 120 pixels, and 480 for the finish, are enough for up to 4 curves.
    """
    monkeypatch.setattr(photo_style, "USUAL_CURVES", 4)
    monkeypatch.setattr(photo_style, "ROUGH_PIXELS_PER_CURVE", 30)
    monkeypatch.setattr(photo_style, "FINISH_SCALE", 2)
    sizes = []

    class Noted(FitLoop):
        def __init__(self, target, settings, inputs, *given):
            sizes.append((target.shape[1::-1], None if inputs.rough is None else inputs.rough[0].shape[1::-1]))
            super().__init__(target, settings, inputs, *given)

    monkeypatch.setattr("cubicsplat_cli.photo.loop.FitLoop", Noted)
    return sizes


def test_a_picture_is_fitted_on_copies_with_enough_pixels_for_its_curves(fitted):
    picture = as_picture(flat_picture())
    levels = {}
    for curves in (6, 200):
        settings = SETTINGS.with_(curves=curves, steps=60)
        done = vectorize_picture(picture, Request(settings, style="photo"))
        assert (done.scene.width, done.scene.height) == picture.size
        levels[curves] = done.report.quality.svg.psnr_db, done.report.notes
    assert fitted == [((29, 24), (15, 12)), ((192, 160), (96, 80))]
    assert levels[6][1] == ["fitted on a copy of 15 x 12 pixels, with the exact finish at 29 x 24"]
    assert levels[200][1] == []
    assert levels[6][0] > 25.0


@pytest.mark.parametrize(
    ("side", "curves", "rough", "fine"),
    [
        (40, 23, 80, 160),
        (40, 22, 80, 120),
        (40, 5, 40, 40),
        (156, 400, 312, 624),
        (157, 400, 314, 471),
        (313, 400, 626, 626),
        (314, 400, 314, 314),
    ],
)
def test_a_small_picture_of_many_curves_is_fitted_on_enlarged_copies(side, curves, rough, fine):
    picture = as_picture(np.random.default_rng(5).integers(0, 255, (side, side, 3), dtype=np.uint8))
    settings = SETTINGS.with_(curves=curves, steps=1)
    assert [copy.size for copy in photo_style.copies_of(picture, settings)] == [(rough, rough), (fine, fine)]
    done = vectorize_picture(picture, Request(settings, style="photo", measure=False))
    assert (done.scene.width, done.scene.height) == (side, side)
    assert done.report.notes == []


def test_a_small_picture_shows_no_scribbles_when_it_is_enlarged(monkeypatch):
    """Rings as fine as its pixels, whose fit to the pixels themselves has shapes between them."""
    y, x = np.mgrid[0:128, 0:128] + 0.5
    rings = np.cos(np.hypot(x - 60, y - 70) ** 1.5 / 70)
    truth = np.stack([128 + 90 * rings, 140 + 60 * np.cos(x / 30), 110 + 70 * np.sin(y / 25)], -1)
    small = np.rint(truth.reshape(32, 4, 32, 4, 3).mean(axis=(1, 3))).astype(np.uint8)

    def level() -> float:
        made = vectorize(small, style="photo", steps=300, threads=1, measure=False)
        drawn = render_scene(made.scene.scaled(128, 128), threads=1)[..., :3]
        return decibels(float(np.square(drawn - truth / 255).mean()))

    enlarged = level()
    monkeypatch.setattr(photo_style, "MOST_ENLARGED", 1)
    assert enlarged > level() + 1.0


def test_a_fit_that_goes_on_at_another_size_is_where_it_was():
    y, x = np.mgrid[0:40, 0:48] + 0.5
    waves = np.stack([np.sin(x / 9), np.cos(y / 8), np.sin((x + y) / 12)], -1)
    picture = as_picture((127.5 + 120 * waves).astype(np.uint8))
    small, large = (torch.from_numpy(resize_picture(picture, size).target()) for size in (24, 48))
    settings = SETTINGS.with_(steps=60)
    loop = FitLoop(small, settings)
    assert loop.relax()
    before, points = loop.evaluator.loss(loop.state.curves), loop.state.curves.points.clone()
    loop.go_over_to(large, FitInputs())
    assert loop.step == 51
    assert loop.evaluator.loss(loop.state.curves) == pytest.approx(4 * before, rel=0.3)
    assert torch.allclose(loop.state.curves.points, 2 * points)


def test_a_published_recipe_is_fitted_on_the_picture_itself(fitted):
    settings = FitSettings(preset="paper", curves=4, steps=2, threads=1)
    vectorize_picture(as_picture(flat_picture()), Request(settings, style="photo", measure=False))
    assert fitted == [((48, 40), None)]


def test_a_time_limit_is_one_of_everything():
    """Megapixels, of which measuring alone once took ten times as long."""
    pixels = np.random.default_rng(3).integers(0, 255, (1500, 2000, 3), dtype=np.uint8)
    endless = FitSettings(curves=20, steps=10**6, threads=2, time_limit=0.5)
    report = vectorize_picture(as_picture(pixels), Request(endless, style="photo", max_size=200)).report
    # Wide: the machine may be busy with other things.
    assert report.timing.total_s < 20
    assert 0 < report.timing.steps < 10**6
    assert report.settings["time_limit"] == 0.5
    assert report.quality is not None


def test_a_picture_among_others_takes_its_own_time_not_the_commands():
    """As the benches fit them, one after the other in one process."""
    began = COMMAND_BEGAN.set(time.perf_counter() - 1000)
    try:
        done = vectorize_picture(as_picture(flat_picture()), Request(SETTINGS.with_(curves=4, steps=2), style="photo"))
    finally:
        COMMAND_BEGAN.reset(began)
    assert 0 < done.report.timing.total_s < 500


@pytest.mark.parametrize(("limit", "smaller"), [(1.0, True), (1000.0, False)])
def test_what_is_left_of_a_time_limit_decides_what_is_measured(limit, smaller, monkeypatch):
    """Of a picture whose reading took 100 seconds."""
    monkeypatch.setattr(measuring, "LEAST_PIXELS", 500)
    timer = StageTimer(started=time.perf_counter() - 100)
    settings = FitSettings(curves=4, steps=10**6 if smaller else 20, threads=1, time_limit=limit)
    done = vectorize_picture(as_picture(flat_picture()), Request(settings, style="photo"), timer=timer)
    assert done.report.timing.total_s >= 100
    noted = [note for note in done.report.notes if "quality measured at" in note]
    assert (len(noted) == 1) == smaller
    assert (done.pixels.shape[0] < 40) == smaller
    assert 0 < done.report.timing.steps < 10**5
    assert done.report.timing.fit_s < 60


def test_nothing_but_transparency_gives_no_shape():
    done = vectorize(np.zeros((10, 12, 4), np.uint8))
    assert (done.scene, done.report.output.paths, done.report.style) == (None, 0, "artwork")
    assert done.report.quality.svg.identical


@pytest.mark.parametrize(
    ("colour", "style", "paths", "made"),
    [
        ((200, 100, 50), "photo", 0, '<rect id="background" width="30" height="20" fill="#c86432"/>'),
        ((200, 100, 50), "artwork", 1, '<rect id="background" width="30" height="20" fill="#c86432"/>'),
        (
            (200, 100, 50, 102),
            "photo",
            0,
            '<rect id="background" width="30" height="20" fill="#c86432" fill-opacity=".4"/>',
        ),
        ((9, 9, 9, 0), "photo", 0, None),
    ],
)
def test_one_colour_is_a_ground_and_no_path(colour, style, paths, made):
    """Whatever is asked for: there is nothing to fit."""
    pixels = np.full((20, 30, len(colour)), colour, np.uint8)
    done = vectorize(pixels, style=style, curves=9, steps=10**6, background="auto")
    assert "<path" not in done.svg
    assert (made in done.svg) if made else ("<rect" not in done.svg)
    report = done.report
    assert (report.style, report.output.paths, report.timing.steps) == (style, paths, 0)
    assert report.quality.svg.identical or report.quality.svg.psnr_db > 60
    assert report.quality.surrogate.identical or report.quality.surrogate.psnr_db > 60


def test_one_colour_with_a_palette_has_its_fill():
    pixels = np.full((20, 30, 3), (200, 100, 50), np.uint8)
    done = vectorize(pixels, style="artwork", palette=((0, 0, 0), (255, 128, 0)))
    assert done.report.inks == ["#ff8000ff"]
