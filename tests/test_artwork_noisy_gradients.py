"""Gradients in pictures that have suffered from noise or JPEG: found where there are some, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import rest_slow
from image_files import recoded

from cubicsplat_cli.artwork.gradients.bands import banded_areas
from cubicsplat_cli.artwork.gradients.flattening import Flattened
from cubicsplat_cli.artwork.gradients.noisy import plane_areas, without_noisy_gradients
from cubicsplat_cli.artwork.input.condition import Condition, condition_of
from cubicsplat_cli.artwork.input.restore import restored
from cubicsplat_cli.artwork.regions.regions import FlatPicture
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.scene.paint import LinearGradient, RadialGradient, painted

SIDE, FINE = 192, 4
RED, GOLD, PALE, BLUE = (230.0, 60.0, 40.0), (250.0, 210.0, 60.0), (240.0, 240.0, 255.0), (60.0, 120.0, 200.0)


def ramp(t: np.ndarray, first: tuple[float, ...], last: tuple[float, ...]) -> np.ndarray:
    t = np.clip(t, 0.0, 1.0)[..., None]
    return (1.0 - t) * np.array(first) + t * np.array(last)


def drawing(shaded: bool = True) -> np.ndarray:
    """(SIDE, SIDE, 3) levels: on white a disc, from red to gold along x, one that is radial, and an even square."""
    y, x = (np.mgrid[: SIDE * FINE, : SIDE * FINE] + 0.5) / FINE
    image = np.full((*x.shape, 3), 255.0)
    disc, other = np.hypot(x - 60, y - 65) < 52, np.hypot(x - 148, y - 60)
    image = np.where(disc[..., None], ramp((x - 8) / 104, RED, GOLD) if shaded else RED, image)
    image = np.where((other < 36)[..., None], ramp(other / 36, PALE, BLUE) if shaded else BLUE, image)
    image = np.where(((x > 70) & (x < 180) & (y > 110) & (y < 180))[..., None], (40.0, 90.0, 170.0), image)
    return image.reshape(SIDE, FINE, SIDE, FINE, 3).mean(axis=(1, 3))


def suffered(image: np.ndarray, kind: str) -> np.ndarray:
    """(H, W, 4) levels."""
    if kind == "jpeg":
        image = recoded(image, quality=80, subsampling=2).astype(float)
    else:
        image = np.clip(np.rint(image + np.random.default_rng(0).normal(0.0, 4.0, image.shape)), 0, 255)
    return np.dstack([image, np.full(image.shape[:2], 255.0)]).astype(np.float32)


def flat(levels: np.ndarray) -> Flattened:
    condition = condition_of(levels)
    assert condition.noise > 0.0
    return without_noisy_gradients(levels, condition)


@pytest.mark.parametrize("kind", rest_slow("jpeg", "noise"))
def test_a_linear_and_a_radial_gradient_are_found(kind):
    gradients = [gradient for (gradient,) in flat(suffered(drawing(), kind)).gradients]
    assert len(gradients) == 2
    (linear,) = (g for g in gradients if isinstance(g, LinearGradient))
    (radial,) = (g for g in gradients if isinstance(g, RadialGradient))
    assert len(linear.stops) == len(radial.stops) == 2
    assert abs(linear.y2 - linear.y1) < 0.02 * abs(linear.x2 - linear.x1)
    assert (radial.cx, radial.cy) == pytest.approx((148.0, 60.0), abs=0.3)
    assert np.abs(np.array(radial.stops[0].colour[:3]) - PALE).max() <= 6


@pytest.mark.parametrize("kind", ["jpeg", "noise"])
def test_none_are_found_in_a_flat_drawing(kind):
    levels = suffered(drawing(shaded=False), kind)
    found = flat(levels)
    assert found.gradients == () and found.levels is levels


def test_two_fills_that_noise_hides_the_edge_of_are_no_gradient():
    image = np.full((SIDE, SIDE, 3), 120.0)
    image[:, SIDE // 2 :] = 136.0
    assert flat(suffered(image, "noise")).gradients == ()


@pytest.mark.slow
def test_a_drawing_of_a_jpeg_has_its_gradients_unless_the_fills_are_chosen():
    target = suffered(drawing(), "jpeg") / np.float32(255.0)
    assert len(draw(target).gradients) == 2
    assert draw(target, ArtworkSettings(colors=5)).gradients == ()


def test_the_tips_of_a_gradient_are_its_own():
    y, x = (np.mgrid[: SIDE * FINE, : SIDE * FINE] + 0.5) / FINE
    # Thirteen rays, each 32 px long and ever thinner, around a disc.
    angle, far = np.arctan2(y - 96, x - 96), np.hypot(y - 96, x - 96)
    inside = far < 60.0 + 32.0 * np.abs(np.cos(6.5 * angle)) ** 3
    image = np.where(inside[..., None], ramp((x - 10) / 172, RED, GOLD), 255.0)
    share = inside.reshape(SIDE, FINE, SIDE, FINE).mean(axis=(1, 3))
    found = flat(suffered(image.reshape(SIDE, FINE, SIDE, FINE, 3).mean(axis=(1, 3)), "jpeg"))
    assert len(found.gradients) == 1
    own = (found.levels == found.fills[0]).all(axis=-1)
    assert own[share == 1.0].mean() > 0.9 and not own[share == 0.0].any()


def test_a_gradient_that_windows_show_in_pieces_is_one():
    y, x = (np.mgrid[: 160 * FINE, : 120 * FINE] + 0.5) / FINE
    inside = (np.hypot((x - 60) / 46, (y - 80) / 66) < 1.0) & (np.hypot((x - 60) / 16, (y - 80) / 36) > 1.0)
    image = np.where(inside[..., None], ramp((y - 14) / 132, BLUE, PALE), 34.0)
    lossy = recoded(image.reshape(160, FINE, 120, FINE, 3).mean(axis=(1, 3)), quality=60, subsampling=2)
    levels = np.dstack([lossy, np.full(lossy.shape[:2], 255)]).astype(np.float32)
    condition = condition_of(levels, lossy=True)
    assert len({id(area.shade) for area in plane_areas(levels, condition)}) == 3
    assert len(without_noisy_gradients(levels, condition).gradients) == 1


def restored_bars(*, shaded: bool, last: tuple[float, ...] = GOLD) -> tuple[np.ndarray, FlatPicture, Condition]:
    """The levels of six bars of 20 px as a JPEG, how they were restored, and their condition: from red to gold, or
    another colour, downwards, or half in either.
    """
    y, x = np.mgrid[:SIDE, :SIDE]
    inside = (x % 31 >= 8) & (x % 31 < 28) & (y >= 8) & (y < 184)
    share = (y - 8) / 176 if shaded else (y >= 96).astype(float)
    levels = suffered(np.where(inside[..., None], ramp(share, RED, last), 255.0), "jpeg")
    condition = condition_of(levels, lossy=True)
    assert without_noisy_gradients(levels, condition).gradients == ()
    return levels, restored(levels, condition), condition


def test_bands_in_narrow_bars_are_one_gradient():
    levels, even, condition = restored_bars(shaded=True)
    areas = banded_areas(levels, even, Flattened(levels), condition)
    assert len(areas) == 6 and len({id(area.shade) for area in areas}) == 1
    ((gradient,),) = without_noisy_gradients(levels, condition, areas).gradients
    assert isinstance(gradient, LinearGradient)
    y = np.linspace(20.0, 170.0, 16)
    off = 255.0 * painted(gradient, np.full(16, 96.0), y)[:, :3] - ramp((y - 8.5) / 176, RED, GOLD)
    assert np.abs(off).max() < 4.0


def test_a_gradient_that_was_restored_as_one_fill_is_found():
    last = (236.0, 72.0, 52.0)
    levels, even, condition = restored_bars(shaded=True, last=last)
    assert even.palette is not None and len(even.palette) == 2
    areas = banded_areas(levels, even, Flattened(levels), condition)
    assert len(areas) == 6 and len({id(area.shade) for area in areas}) == 1
    y = np.linspace(20.0, 170.0, 16)
    off = areas[0].shade.at(np.full(16, 96.0), y)[:, :3] - ramp((y - 8.5) / 176, RED, last)
    assert np.abs(off).max() < 2.0


def test_near_fills_that_were_restored_as_one_are_no_gradient():
    near = np.array([(216.0, 205.0, 201.0), (205.0, 197.0, 194.0)])
    y, x = np.mgrid[:SIDE, :SIDE]
    inside = (x % 31 >= 8) & (x % 31 < 28) & (y >= 8) & (y < 184)
    levels = suffered(np.where(inside[..., None], near[x // 31 % 2], 255.0), "jpeg")
    palette = np.array([[255.0] * 4, [*near.mean(axis=0), 255.0]])
    even = FlatPicture(palette[inside.astype(int)].astype(np.float32), palette, inside.astype(np.int32))
    assert banded_areas(levels, even, Flattened(levels), condition_of(levels, lossy=True)) == []


def test_fills_with_a_step_between_them_are_no_bands():
    levels, even, condition = restored_bars(shaded=False)
    assert banded_areas(levels, even, Flattened(levels), condition) == []


def test_an_even_fill_has_no_gradient():
    levels, even, condition = restored_bars(shaded=True, last=RED)
    assert banded_areas(levels, even, Flattened(levels), condition) == []
