"""Photos whose colours drift without edges are none of artwork; drawings that have suffered are, in grey too."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from conftest import rest_slow
from image_files import recoded
from scipy import ndimage
from skimage import data

from cubicsplat_cli.api import vectorize
from cubicsplat_cli.artwork.input.paper import scan_of
from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.artwork.input.softness import softness
from cubicsplat_cli.artwork.style import choose_style

HEIGHT, WIDTH = 240, 320
Y, X = np.mgrid[:HEIGHT, :WIDTH] / WIDTH


def of(levels: np.ndarray) -> np.ndarray:
    """A picture, (H, W) or (H, W, 3) in levels, as the command has it."""
    rounded = np.clip(np.rint(levels), 0, 255).astype(np.float32) / np.float32(255.0)
    return rounded if rounded.ndim == 3 else np.repeat(rounded[..., None], 3, axis=2)


def grey(levels: np.ndarray) -> np.ndarray:
    return levels @ np.array([0.299, 0.587, 0.114])


def discs(seed: int, number: int, ground: float = 255.0) -> np.ndarray:
    """(H, W, 3) levels: even discs on an even ground, with smooth edges."""
    generator = np.random.default_rng(seed)
    picture = np.full((HEIGHT, WIDTH, 3), ground)
    for _ in range(number):
        x, y, radius = generator.uniform(0.0, 1.0), generator.uniform(0.0, 0.75), generator.uniform(0.05, 0.15)
        share = np.clip(0.5 + WIDTH * (radius - np.hypot(X - x, Y - y)), 0.0, 1.0)[..., None]
        picture += share * (generator.uniform(0.0, 230.0, 3) - picture)
    return picture


def sky(seed: int) -> np.ndarray:
    """(H, W, 3) levels: clouds without edges before a sky that gets lighter, with a grain of a level."""
    generator = np.random.default_rng(seed)
    clouds = sum(s * ndimage.gaussian_filter(generator.normal(size=(HEIGHT, WIDTH)), s) for s in (8.0, 16.0, 32.0))
    blue, orange = np.array([60.0, 80.0, 150.0]), np.array([240.0, 160.0, 80.0])
    even = blue + (orange - blue) * (Y / Y.max())[..., None]
    return even + 14.0 * clouds[..., None] / clouds.std() + generator.normal(size=even.shape)


def jpeg(levels: np.ndarray, quality: int = 80) -> np.ndarray:
    return recoded(levels, quality=quality).astype(float)


def out_of_focus(seed: int) -> np.ndarray:
    """(H, W, 3) levels: a scene far beyond the lens's depth of field, with a grain of a level."""
    scene = ndimage.gaussian_filter(discs(seed, 30, 90.0), (14.0, 14.0, 0.0))
    return scene + np.random.default_rng(seed).normal(size=scene.shape)


def compressed_sky(seed: int) -> np.ndarray:
    return jpeg(sky(seed))


@pytest.mark.parametrize(
    ("picture", "seed", "in_grey"),
    rest_slow(
        (sky, 1, False),
        (out_of_focus, 1, True),
        *product((sky, out_of_focus, compressed_sky), (1, 2), (False, True)),
    ),
)
def test_skies_and_scenes_out_of_focus_are_photos(picture, seed, in_grey):
    levels = picture(seed)
    style = choose_style(of(grey(levels) if in_grey else levels))
    assert style.name == "photo", style.reason


@pytest.mark.slow
@pytest.mark.parametrize("spoilt", [jpeg, np.copy])
@pytest.mark.parametrize("name", ["clock", "cell"])
def test_soft_grey_photos_are_photos(name, spoilt):
    style = choose_style(of(spoilt(getattr(data, name)().astype(float))))
    assert style.name == "photo", style.reason


def test_drawings_that_have_suffered_are_artwork_in_grey():
    drawing = grey(discs(3, 12))
    noisy = drawing + np.random.default_rng(0).normal(0.0, 4.0, drawing.shape)
    small = ndimage.zoom(drawing, 0.4, order=1)
    for picture in (drawing, noisy, jpeg(drawing), ndimage.gaussian_filter(drawing, 3.0), small):
        style = choose_style(of(picture))
        assert style.name == "artwork", style.reason


@pytest.mark.parametrize("ground_falls_by", [0.0, 60.0])
@pytest.mark.parametrize("blur", [0.0, 1.2])
def test_a_card_in_a_gradient_with_a_soft_shadow_is_artwork(ground_falls_by, blur):
    # No gradient explains a shadow on a ground that is one itself, but nothing rendered has a grain.
    box = ((Y > 0.2) & (Y < 0.55) & (X > 0.2) & (X < 0.8)).astype(float)
    shade = (1.0 - 0.3 * ndimage.gaussian_filter(box, 12.0))[..., None]
    ground = (245.0 - ground_falls_by * Y[..., None] - np.zeros(3)) * shade
    ramp = np.array([90.0, 120.0, 240.0]) * (1.0 - X)[..., None] + np.array([220.0, 70.0, 160.0]) * X[..., None]
    card = ndimage.gaussian_filter(np.where(box[..., None] > 0.0, ramp, ground), (blur, blur, 0.0))
    style = choose_style(of(card))
    assert style.name == "artwork", style.reason


def test_shares_of_what_is_even_and_what_drifts():
    everywhere = np.ones((HEIGHT, WIDTH), dtype=bool)
    halves = np.where(X < 0.5, 60.0, 200.0)[..., None] + np.zeros(3)
    found = softness(halves, everywhere)
    assert found.soft == 0.0 and found.ground + found.even > 0.95
    assert found.ground == pytest.approx(0.5, abs=0.02) and not found.drifts
    ramp = np.rint(40.0 + 180.0 * X)[..., None] + np.zeros(3)
    found = softness(ramp, everywhere)
    assert found.drift > 0.9 and not found.drifts
    waves = 120.0 + 40.0 * np.sin(9.0 * X + 3.0 * Y) * np.cos(7.0 * Y - 4.0 * X * Y)
    grain = np.random.default_rng(0).normal(size=waves.shape)
    levels = [np.repeat(np.rint(some)[..., None], 3, axis=2) for some in (waves + grain, waves)]
    grained, rendered = (softness(some, everywhere) for some in levels)
    assert grained.drifts
    assert rendered.drift > 0.9 and not rendered.drifts


@pytest.mark.slow
def test_a_picture_without_any_quiet_place_has_no_shares_and_its_result_is_said_to_be_far():
    noise = np.random.default_rng(7).integers(0, 256, (32, 32)).astype(float)
    found = softness(255.0 * of(noise), np.ones(noise.shape, dtype=bool))
    assert (found.ground, found.even, found.soft) == (0.0, 0.0, 0.0)
    # In so few px noise looks like edges everywhere, and as few curves come no nearer.
    report = vectorize(np.repeat(noise[..., None], 3, axis=2).astype(np.uint8), steps=2, threads=1).report
    assert any("the result is far from the picture" in note for note in report.notes)


def test_a_picture_on_which_the_paper_leaves_no_fill_is_no_scan():
    # Without that rule it is one, and all white: the paper follows it everywhere.
    scene = ndimage.zoom(ndimage.gaussian_filter(grey(discs(10, 30, 90.0)), 14.0), 0.4, order=1)
    assert scan_of(as_levels(of(scene))) is None
    assert choose_style(of(scene + np.random.default_rng(0).normal(size=scene.shape))).name == "photo"
