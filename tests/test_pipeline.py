"""The way of one picture: which style it takes, and what is put out when."""

from __future__ import annotations

import time

import numpy as np
import pytest

from cubicsplat_cli import pipeline, vectorize
from cubicsplat_cli.evaluate import measurable
from cubicsplat_cli.files.convert import as_picture
from cubicsplat_cli.photo import fit
from cubicsplat_cli.pipeline import vectorize_picture
from cubicsplat_cli.progress import Stages
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings

SETTINGS = FitSettings(curves=6, steps=12, threads=1)


def flat_picture() -> np.ndarray:
    pixels = np.full((40, 48, 3), 240, np.uint8)
    pixels[8:30, 10:34] = (20, 90, 160)
    return pixels


def test_a_flat_picture_is_drawn_and_the_report_says_why():
    report = vectorize(flat_picture(), threads=1).report
    assert (report.style, report.shapes, report.primitives) == ("artwork", 2, 2)
    assert report.inks == ["#f0f0f0ff", "#145aa0ff"]
    assert "texture" in report.style_reason


def test_a_drawing_too_far_from_its_picture_gives_way_to_a_photo(monkeypatch):
    monkeypatch.setattr(pipeline, "LEAST_ARTWORK_DB", 99.0)
    noisy = flat_picture()
    noisy[10, 12] = (23, 92, 163)
    report = vectorize_picture(as_picture(noisy), Request(SETTINGS, measure=False)).report
    assert report.style == "photo"
    assert "drawn as artwork it has only" in report.style_reason
    asked = vectorize_picture(as_picture(noisy), Request(SETTINGS, style="artwork", measure=False)).report
    assert (asked.style, asked.style_reason) == ("artwork", "asked for")


@pytest.mark.parametrize("style", ["photo", "artwork"])
def test_the_svg_is_put_out_before_it_is_measured(style):
    seen = []
    done = vectorize_picture(as_picture(flat_picture()), Request(SETTINGS, style=style), on_svg=seen.append)
    (first,) = seen
    assert (first.svg, first.report.quality, first.pixels) == (done.svg, None, None)
    assert done.report.quality.svg.psnr_db is None or done.report.quality.svg.psnr_db > 8


def test_the_svg_keeps_the_size_of_a_picture_that_was_scaled_down():
    done = vectorize_picture(as_picture(flat_picture()), Request(SETTINGS, style="artwork", max_size=24))
    assert 'viewBox="0 0 48 40"' in done.svg
    assert (done.scene.width, done.scene.height) == (48, 40)
    assert done.report.quality.svg.psnr_db > 20


@pytest.mark.parametrize(("curves", "size"), [(6, (31, 26)), (600, (48, 40))])
def test_a_large_picture_is_fitted_on_a_copy_with_enough_pixels_for_its_curves(curves, size, monkeypatch):
    monkeypatch.setattr(pipeline, "LEAST_FITTED_PIXELS", 800)
    monkeypatch.setattr(pipeline, "FITTED_PIXELS_PER_CURVE", 100)
    fitted = []
    monkeypatch.setattr("cubicsplat_cli.photo.fit", lambda target, *rest: fitted.append(target) or fit(target, *rest))
    picture = as_picture(flat_picture())
    request = Request(SETTINGS.with_(curves=curves), style="photo", measure=False)
    done = vectorize_picture(picture, request)
    assert fitted[0].shape[1::-1] == size
    assert (done.scene.width, done.scene.height) == picture.size
    assert done.report.notes == ([] if size == picture.size else ["fitted on a copy of 31 x 26 pixels"])


def test_a_published_recipe_is_fitted_on_the_picture_itself(monkeypatch):
    monkeypatch.setattr(pipeline, "LEAST_FITTED_PIXELS", 800)
    monkeypatch.setattr(pipeline, "FITTED_PIXELS_PER_CURVE", 100)
    settings = FitSettings(preset="paper", curves=6, steps=2, threads=1)
    done = vectorize_picture(as_picture(flat_picture()), Request(settings, style="photo", measure=False))
    assert not [note for note in done.report.notes if "copy" in note]


def test_a_time_limit_is_one_of_everything():
    """12 megapixels, of which measuring alone once took ten times as long."""
    pixels = np.random.default_rng(3).integers(0, 255, (3000, 4000, 3), dtype=np.uint8)
    endless = FitSettings(curves=20, steps=10**6, threads=2, time_limit=3.0)
    report = vectorize_picture(as_picture(pixels), Request(endless, style="photo", max_size=200)).report
    # Wide: the machine may be busy with other things.
    assert report.timing.total_s < 9
    assert report.timing.steps > 10
    assert report.settings["time_limit"] == 3.0
    assert report.quality is not None


@pytest.mark.parametrize(("limit", "smaller"), [(1.0, True), (1000.0, False)])
def test_what_is_left_of_a_time_limit_decides_what_is_measured(limit, smaller, monkeypatch):
    """Of a picture whose reading took 100 seconds."""
    monkeypatch.setattr(measurable, "_LEAST_PIXELS", 500)
    stages = Stages(started=time.perf_counter() - 100)
    settings = FitSettings(curves=4, steps=10**6 if smaller else 20, threads=1, time_limit=limit)
    done = vectorize_picture(as_picture(flat_picture()), Request(settings, style="photo"), stages=stages)
    assert done.report.timing.total_s >= 100
    noted = [note for note in done.report.notes if "quality measured at" in note]
    assert (len(noted) == 1) == smaller
    assert (done.pixels.shape[0] < 40) == smaller
    assert 0 < done.report.timing.steps < 10**5
    assert done.report.timing.fit_s < 5


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


def test_one_colour_with_a_palette_has_its_ink():
    pixels = np.full((20, 30, 3), (200, 100, 50), np.uint8)
    done = vectorize(pixels, style="artwork", palette=((0, 0, 0), (255, 128, 0)))
    assert done.report.inks == ["#ff8000ff"]
