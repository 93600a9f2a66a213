"""How the pixels of small pictures differ."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from image_files import by_resvg, recoded
from PIL import Image
from skimage import data

from cubicsplat_cli.artwork.input.evenness import contrasts
from cubicsplat_cli.artwork.style import choose_style

SAMPLES = Path(__file__).resolve().parents[1] / "samples" / "artwork"


def icon(name: str, size: int) -> Image.Image:
    return by_resvg(SAMPLES / f"{name}.svg", size, "white").convert("RGB")


def noisy(picture: Image.Image, sigma: float) -> np.ndarray:
    levels = np.asarray(picture, float) + np.random.default_rng(0).normal(0.0, sigma, (*picture.size[::-1], 3))
    return np.clip(np.rint(levels), 0, 255).astype(np.float32)


def test_edges_and_noise_are_told_apart():
    levels = np.zeros((40, 40, 3), np.float32)
    levels[:, 20:] = 180.0
    levels += np.random.default_rng(1).normal(0.0, 4.0, levels.shape)
    found = contrasts(levels)
    # Three pairs in 37 of a row lie across the edge, and none of a column.
    assert found.edges == pytest.approx(3 / 74, abs=0.01)
    assert found.saved > 0.5
    scale = np.random.default_rng(2).exponential(12.0, (40, 40, 1)).cumsum(axis=0) % 200.0
    assert contrasts(np.repeat(scale, 3, axis=2)).saved < 0.0


def test_nothing_tells_where_nothing_differs():
    assert contrasts(np.full((5, 9, 3), 7.0, np.float32)) is None
    assert contrasts(np.zeros((2, 2, 3), np.float32)) is None


@pytest.mark.parametrize("size", [24, 32, 48, 64])
@pytest.mark.parametrize("name", ["bird", "fish", "letters", "flag"])
def test_small_icons_with_noise_are_artwork(name, size):
    for sigma in (2.0, 5.0):
        style = choose_style(noisy(icon(name, size), sigma) / 255)
        assert style.name == "artwork", f"{sigma}: {style.reason}"


@pytest.mark.parametrize("size", [32, 48, 64])
@pytest.mark.parametrize("name", ["bird", "letters", "flag"])
def test_small_icons_as_jpeg_are_artwork(name, size):
    style = choose_style(recoded(icon(name, size), quality=85).astype(np.float32) / 255)
    assert style.name == "artwork", style.reason


@pytest.mark.parametrize("size", [24, 32, 48, 64])
@pytest.mark.parametrize("name", ["coffee", "chelsea", "rocket"])
def test_small_photos_with_noise_or_as_jpeg_are_photos(name, size):
    picture = Image.fromarray(getattr(data, name)())
    picture.thumbnail((size, size), Image.Resampling.LANCZOS)
    for levels in (noisy(picture, 4.0), recoded(picture, quality=85).astype(np.float32)):
        style = choose_style(levels / 255)
        assert style.name == "photo", style.reason
