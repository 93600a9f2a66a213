"""Which style suits a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage
from skimage import data

from cubicsplat_cli.artwork import style
from cubicsplat_cli.artwork.input.evenness import covered, evenness
from cubicsplat_cli.artwork.style import choose_style
from cubicsplat_cli.files.load import load_picture

SAMPLES = Path(__file__).resolve().parents[1] / "samples"


@pytest.mark.parametrize(
    ("name", "style"),
    [("chelsea.png", "photo"), ("astronaut.jpg", "photo"), ("logo.png", "artwork"), ("landscape.png", "artwork")],
)
def test_the_samples_get_their_styles(name, style):
    assert choose_style(load_picture(SAMPLES / name).target()).name == style


def test_a_photo_of_much_darkness_is_a_photo():
    moon = np.repeat(data.moon()[..., None], 3, axis=2).astype(np.float32) / 255
    style = choose_style(moon)
    assert style.name == "photo", style.reason


def test_a_photo_with_an_even_sky_is_a_photo():
    rocket = data.rocket().astype(np.float32)
    assert evenness(rocket, np.ones(rocket.shape[:2], dtype=bool)) > style.LEAST_EVEN
    assert choose_style(rocket / 255).name == "photo"


def test_a_few_colours_cover_a_drawing_that_has_suffered():
    drawing = np.zeros((60, 60, 3), np.float32)
    drawing[:30, :30], drawing[30:, 30:] = (200.0, 40.0, 40.0), (40.0, 40.0, 200.0)
    noisy = np.rint(drawing + np.random.default_rng(4).normal(0.0, 4.0, drawing.shape)).clip(0, 255)
    # What is left are the edges between the four areas, 4 px wide.
    assert covered(noisy, np.ones((60, 60), dtype=bool)) > 0.85
    assert covered(np.random.default_rng(5).random((60, 60, 3)) * 255, np.ones((60, 60), dtype=bool)) < 0.8
    assert covered(np.zeros((4, 60, 3)), np.ones((4, 60), dtype=bool)) == 0.0


def test_noise_is_a_photo_and_an_even_picture_artwork():
    noise = np.random.default_rng(0).random((64, 64, 3)).astype(np.float32)
    style = choose_style(noise)
    assert style.name == "photo"
    assert style.reason.startswith("100 % texture")
    assert choose_style(np.full((1, 1, 3), 0.5, np.float32)).name == "artwork"


def test_what_is_clear_does_not_count():
    picture = np.zeros((64, 64, 4), np.float32)
    assert choose_style(picture).name == "artwork"
    picture[:20, :20] = np.random.default_rng(1).random((20, 20, 1)).astype(np.float32)
    assert choose_style(picture).name == "photo"


@pytest.mark.parametrize("sides", [(1, 300), (2, 300), (6, 300), (4, 100)])
def test_a_picture_narrower_than_a_block_has_a_style(sides):
    noise = np.random.default_rng(6).random((*sides, 3)).astype(np.float32)
    halves = np.zeros((*sides, 3), np.float32)
    halves[:, sides[1] // 2 :] = 1.0
    for turned in (False, True):
        assert choose_style(noise.swapaxes(0, 1) if turned else noise).name == "photo"
        assert choose_style(halves.swapaxes(0, 1) if turned else halves).name == "artwork"


def test_of_a_large_picture_bands_are_looked_at():
    large = np.zeros((3000, 1200, 3), np.float32)
    large[1400:] = np.random.default_rng(2).random((1600, 1200, 3)).astype(np.float32)
    assert choose_style(large).name == "photo"
    large[200:] = 1.0
    assert choose_style(large).name == "artwork"


@pytest.mark.parametrize("shape", [(1, 1), (2, 9), (40, 31), (70, 90), (300, 260)])
def test_texture_is_what_scipy_calls_the_opening_of_uneven_places(shape):
    levels = np.random.default_rng(3).integers(0, 4, (*shape, 3)).astype(np.float32)
    levels[: shape[0] // 2] *= 2.0
    block = min(7 if max(shape) >= 256 else 5 if max(shape) >= 64 else 3, *shape)
    spread = ndimage.maximum_filter(levels, (3, 3, 1)) - ndimage.minimum_filter(levels, (3, 3, 1))
    want = ndimage.binary_opening(spread.max(-1) > style.FLAT_LEVELS, np.ones((block, block))).mean()
    assert style._texture(levels, np.ones(shape, dtype=bool)) == pytest.approx(want, abs=1e-12)
    assert want > 0 or max(shape) == 1
