"""Animations: frames spread by quality, bounded in number and memory, in files that are known as ours."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import rest_slow, smooth_pixels
from PIL import Image

from cubicsplat_cli import vectorize
from cubicsplat_cli.progress import FrameRecorder
from cubicsplat_cli.scene import Scene

FIT = ("--style", "photo", "--curves", 12, "--steps", 80, "--threads", 1)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return vectorize(smooth_pixels(24, 20), style="photo", curves=4, steps=2, threads=1, measure=False).scene


def numbered(scene: Scene, number: int) -> Scene:
    return replace(scene, width=number + 1)


def test_frames_are_spread_by_quality_and_not_by_time(scene):
    film = FrameRecorder(10)
    # Quick at first, as fits are: half of the way in a hundredth of the steps.
    levels = 20.0 + 10.0 * (1.0 - np.exp(-(np.linspace(0.0, 8.0, 4000) ** 0.5)))
    for step, level in enumerate(levels):
        if film.due(level):
            film.keep(level, numbered(scene, step))
    frames = film.scenes(scene)
    assert 8 <= len(frames) <= 10
    assert frames[-1] is scene
    reached = np.diff([levels[frame.width - 1] for frame in frames[:-1]])
    assert reached.max() < 2.2 * reached.min()


def test_no_more_is_kept_than_memory_may_hold(scene):
    values = sum(t.size for t in (scene.points, scene.colours, scene.opacities, scene.half_widths))
    film = FrameRecorder(48, most_bytes=4 * values * 12)
    for step in range(3000):
        if film.due(0.01 * step):
            film.keep(0.01 * step, numbered(scene, step))
            assert len(film._kept) <= 12
    assert len(film.scenes(scene)) >= 6


def test_few_frames_are_all_shown(scene):
    film = FrameRecorder(48)
    assert film.scenes(scene) == [scene]
    for level in (1.0, 2.0, 9.0):
        film.keep(level, scene)
    assert len(film.scenes(scene)) == 4


@pytest.mark.parametrize("form", rest_slow("webp", "gif"))
def test_the_command_writes_the_fit_as_it_develops(run_cli, photo, form):
    out, plain = photo.with_name(f"a.{form}"), photo.with_name("plain.svg")
    run_cli("vectorize", photo, *FIT, "-o", plain)
    run_cli("vectorize", photo, *FIT, "--animation", out)
    # To watch a fit does not change it.
    assert photo.with_suffix(".svg").read_text().split("-->")[1] == plain.read_text().split("-->")[1]
    goal = np.asarray(Image.open(photo).convert("RGB")).astype(float)
    with Image.open(out) as image:
        assert (image.format, image.size) == (form.upper(), (40, 28))
        assert image.n_frames > 5
        errors = []
        for index in (0, image.n_frames // 2, image.n_frames - 1):
            image.seek(index)
            errors.append(((np.asarray(image.convert("RGB")) - goal) ** 2).mean())
    assert errors[0] > errors[1] > errors[2]
    made = out.stat().st_mtime_ns
    assert b"unchanged" in run_cli("vectorize", photo, *FIT, "--animation", out).stderr
    assert out.stat().st_mtime_ns == made
    # Of another SVG it is another animation, even where that SVG is there already.
    run_cli("vectorize", photo, *FIT, "--seed", 4)
    assert b"unchanged" not in run_cli("vectorize", photo, *FIT, "--seed", 4, "--animation", out).stderr


def test_artwork_is_shown_as_it_is_laid_down(run_cli, tmp_path):
    pixels = np.full((24, 40, 3), 255, np.uint8)
    pixels[4:20, 4:16], pixels[8:16, 22:34] = (200, 30, 30), (30, 60, 160)
    Image.fromarray(pixels).save(tmp_path / "flat.png")
    run_cli(
        "vectorize", tmp_path / "flat.png", "--style", "artwork", "--threads", 1, "--animation", tmp_path / "a.webp"
    )
    with Image.open(tmp_path / "a.webp") as image:
        assert image.n_frames == 3


@pytest.mark.parametrize(
    ("more", "words"),
    [(("--animation", "a.mp4"), "must end in .webp or .gif"), (("b.png", "--animation", "a.gif"), "of one picture")],
)
def test_what_cannot_be_is_said_before_the_work(run_cli, photo, more, words):
    run_cli("vectorize", photo, *more, code=2, error=words)


def test_the_animation_of_somebody_else_is_kept(run_cli, photo):
    mine = photo.with_name("mine.gif")
    Image.fromarray(smooth_pixels(8, 8)).save(mine)
    before = mine.read_bytes()
    run_cli("vectorize", photo, *FIT, "--animation", mine, code=2)
    assert mine.read_bytes() == before
    assert not Path(photo.with_suffix(".svg")).exists()
