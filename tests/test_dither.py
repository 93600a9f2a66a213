"""Dither by error diffusion, its dots and what they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from image_files import by_resvg
from PIL import Image, ImageDraw

from cubicsplat_cli.api import vectorize
from cubicsplat_cli.artwork.input.dither import banded, dithered, without_dither
from cubicsplat_cli.raster.unmix import dither_dots, guided_means

SIZE = 160


def meant(*, opaque: bool = True) -> Image.Image:
    """A disc on a gradient, or on nothing."""
    ramp = np.linspace(0.0, 1.0, SIZE)[:, None, None] * [60.0, 20.0, -70.0] + [90.0, 160.0, 230.0]
    ground = Image.fromarray(np.rint(np.broadcast_to(ramp, (SIZE, SIZE, 3))).astype(np.uint8)).convert("RGBA")
    picture = ground if opaque else Image.new("RGBA", (SIZE, SIZE))
    ImageDraw.Draw(picture).ellipse((40, 40, 120, 120), fill=(230, 120, 30, 255))
    return picture


def diffused(picture: Image.Image) -> Image.Image:
    """The picture in the 216 colours of old browsers, with its opacity."""
    found = picture.convert("RGB").convert("P").convert("RGBA")
    found.putalpha(picture.getchannel("A"))
    return found


def levels(picture: Image.Image) -> np.ndarray:
    return np.asarray(picture.convert("RGB"), dtype=np.float32)


@pytest.mark.parametrize("opaque", [True, False])
def test_dots_are_drawn_as_the_colours_that_they_stand_for(opaque):
    picture = meant(opaque=opaque)
    done = vectorize(diffused(picture), measure=False)
    assert done.report.style == "artwork" and done.report.shapes <= 3
    assert "drawn in the colours that its palette stands for" in done.report.notes
    shown = np.asarray(picture)[..., 3] == 255
    assert np.abs(levels(by_resvg(done.svg)) - levels(picture))[shown].mean() < 3.0
    assert np.abs(levels(diffused(picture)) - levels(picture))[shown].mean() > 12.0


def leaf(slope: float, colours: int | None = None) -> Image.Image:
    """A disc whose colours change by so many levels a px, in a palette of so many colours."""
    y, x = np.mgrid[:SIZE, :SIZE]
    t = slope * (0.8 * x + 0.6 * y)[..., None]
    ramp = np.clip(np.concatenate([20 + t, 60 + 0.4 * t, 250 - 0.7 * t], axis=2), 0, 255)
    mask = Image.new("L", (4 * SIZE, 4 * SIZE))
    ImageDraw.Draw(mask).ellipse((40, 40, 600, 600), fill=255)
    picture = Image.new("RGB", (SIZE, SIZE), "white")
    picture.paste(Image.fromarray(np.rint(ramp).astype(np.uint8)), mask=mask.resize((SIZE, SIZE), Image.Resampling.BOX))
    return picture if colours is None else picture.quantize(colours, dither=Image.Dither.NONE).convert("RGB")


@pytest.mark.parametrize(("slope", "colours"), [(0.35, 24), (0.35, 32), (0.6, 48)])
def test_bands_of_a_palette_are_drawn_as_the_gradient_that_they_stand_for(slope, colours):
    given, picture = leaf(slope, colours), leaf(slope)
    assert banded(levels(given))
    done = vectorize(given, style="artwork", measure=False, threads=1)
    assert done.report.shapes == 2 and done.svg.count("<linearGradient") == 1  # on the white ground
    assert "drawn in the colours that its palette stands for" in done.report.notes
    off = np.abs(levels(by_resvg(done.svg)) - levels(picture))[40:120, 40:120].mean()
    assert off < 0.7 * np.abs(levels(given) - levels(picture))[40:120, 40:120].mean()


@pytest.mark.parametrize("slope", [0.1, 0.4, 1.0, 1.8, 3.0])
def test_gradients_as_they_are_drawn_have_no_bands(slope):
    assert not banded(levels(leaf(slope)))
    y, x = np.mgrid[:SIZE, :SIZE]
    for ramp in (y, x, np.hypot(x - 80, y - 80), np.minimum(y, 80)):
        grey = np.rint(np.clip(slope * ramp, 0, 255))[..., None].astype(np.float32)
        assert not banded(np.repeat(grey, 3, axis=2))
    assert not banded(levels(leaf(slope))[:2]) and not banded(np.zeros((1, 1, 4), np.float32))


def test_only_places_with_dither_change_and_keep_their_mean():
    picture = meant()
    ImageDraw.Draw(picture).rectangle((0, 120, SIZE, SIZE), fill=(51, 102, 153, 255))  # one of the 216
    found = levels(diffused(picture))
    even, noise = without_dither(found)
    where = (even != found).any(axis=2)
    assert where[:100].mean() > 0.9 and not where[130:].any() and noise > 0
    inner = np.s_[60:100, 60:100]
    assert np.abs(even[inner] - levels(picture)[inner]).max() < 12.0
    assert np.abs(even[inner].mean((0, 1)) - found[inner].mean((0, 1))).max() < 1.0


def test_what_only_looks_like_dither_stays():
    y, x = np.mgrid[:96, :96]
    bayer = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]]) / 16.0
    ordered = np.where(x / 96.0 > bayer[y % 4, x % 4], 200.0, 40.0)
    slanting = np.where((x + y) % 7 == 0, 200.0, 40.0)
    few = np.full((96, 96), 40.0)
    few[4::32, 4::32] = 200.0
    noise = np.random.default_rng(0).integers(0, 256, (96, 96, 3)).astype(np.float32)
    for picture in (ordered, slanting, few):
        picture = np.repeat(picture[..., None], 3, axis=2).astype(np.float32)
        assert dithered(picture) is None and without_dither(picture)[0] is picture
    assert dithered(noise) is None


def test_text_beside_a_little_dither_stays_sharp():
    window = Image.new("RGB", (SIZE, SIZE), "white")
    for row in range(4, SIZE, 16):
        ImageDraw.Draw(window).text((4, row), "files: 1.5 million...", fill="black")
    window.paste(diffused(meant()).crop((0, 0, 32, 32)), (120, 120))
    found = levels(window)
    even, noise = without_dither(found)
    apart = np.ones((SIZE, SIZE), dtype=bool)
    apart[112:, 112:] = False
    assert noise == 0 and (even[apart] == found[apart]).all() and (even != found)[120:152, 120:152].any()


def test_text_on_a_dithered_ground_stays_sharp():
    page = Image.new("RGB", (SIZE, SIZE), (203, 203, 203))
    for row in range(4, SIZE, 24):
        ImageDraw.Draw(page).text((4, row), "files: 1.5 million...", fill="black")
    palette = Image.new("P", (1, 1))
    palette.putpalette([0, 0, 0, 198, 198, 198, 206, 206, 206])
    found = levels(page.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG))
    even, _ = without_dither(found)
    dark = found[..., 0] == 0
    assert dark.any() and even[dark].max() < 25.0
    assert np.abs(even - 203.0)[~dark].mean() < 0.5 * np.abs(found - 203.0)[~dark].mean()


def test_dotted_lines_that_cross_are_no_dither():
    page = np.full((SIZE, SIZE, 3), 255.0, dtype=np.float32)
    for place in (20, 70, 120):
        page[place, 20:121:2] = page[20:121:2, place] = 0.0
    assert dithered(page) is None


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 9), st.sampled_from([1, 3, 4]))
def test_dots_differ_from_four_like_neighbours(seed, height, width, channels):
    picture = np.random.default_rng(seed).integers(0, 3, (height, width, channels)).astype(np.float32)
    dots = np.zeros((height, width), dtype=bool)
    for y, x, c in np.ndindex(max(height - 2, 0), max(width - 2, 0), channels):
        around = picture[y : y + 3, x : x + 3, c]
        sides = {around[0, 1], around[1, 0], around[1, 2], around[2, 1]}
        corners = tuple(around[::2, ::2].ravel() == around[1, 1])
        line = corners in ((True, False, False, True), (False, True, True, False))
        dots[y + 1, x + 1] |= len(sides) == 1 and abs(around[1, 1] - sides.pop()) >= 2 and not line
    assert (dither_dots(picture, 2.0) == dots).all()


@pytest.mark.parametrize("shape", [(1, 1, 3), (9, 14, 4)])
def test_guided_means_are_weighted_by_distance_and_guide(shape):
    chance = np.random.default_rng(0)
    picture, guide = (chance.uniform(0.0, 255.0, shape).astype(np.float32) for _ in range(2))
    where = chance.random(shape[:2]) < 0.7
    found = guided_means(picture, guide, where, 1.2, 90.0)
    at = np.stack(np.mgrid[: shape[0], : shape[1]], axis=-1)
    for y, x in np.ndindex(*shape[:2]):
        off = at - [y, x]
        weights = np.exp(-0.5 * (off**2).sum(-1) / 1.2**2 - 0.5 * ((guide - guide[y, x]) ** 2).sum(-1) / 90.0**2)
        weights *= np.abs(off).max(-1) <= 3
        mean = (weights[..., None] * picture).sum((0, 1)) / weights.sum()
        np.testing.assert_allclose(found[y, x], mean if where[y, x] else picture[y, x], rtol=1e-4)
