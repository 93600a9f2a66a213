"""Halos of sharpened pictures: found where they are, and taken off; and unsharp masks, undone."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageDraw, ImageFilter, ImageFont

from cubicsplat_cli import vectorize
from cubicsplat_cli.artwork.channels import light_of_srgb
from cubicsplat_cli.artwork.input.linear_light import without_linear_light
from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.artwork.input.sharpening import UnsharpMask, unsharp_mask, without_halos
from cubicsplat_cli.evaluate.rerender import rerender

TIMES, SIDE = 6, 120
NOTE = "drawn without the halos that sharpening left at its edges"


def icon(*, ground: str = "#dddddd", gradient: bool = False) -> Image.Image:
    """Draw a rounded square with a ring in it, several times as large."""
    side = TIMES * SIDE
    along = np.linspace(0.0, 1.0, side)[:, None, None] * gradient
    fill = (1.0 - along) * [90, 60, 220] + along * [220, 80, 160]
    square = Image.fromarray(np.broadcast_to(fill, (side, side, 3)).astype(np.uint8))
    ImageDraw.Draw(square).ellipse([200, 200, 520, 520], outline="#e8e8e8", width=50)
    mask = Image.new("L", square.size, 0)
    ImageDraw.Draw(mask).rounded_rectangle([40, 40, side - 41, side - 41], 130, fill=255)
    image = Image.new("RGB", square.size, ground)
    image.paste(square, mask=mask)
    return image


def reduced(image: Image.Image, resampling: Image.Resampling) -> np.ndarray:
    """Return the levels of a picture at its size."""
    return levels_of(image.resize((SIDE, SIDE), resampling))


def levels_of(image: Image.Image) -> np.ndarray:
    return as_levels(np.asarray(image, np.float32) / np.float32(255.0))


def as_jpeg(image: Image.Image, quality: int = 85) -> Image.Image:
    """Return a picture as a JPEG keeps it."""
    file = io.BytesIO()
    image.save(file, "JPEG", quality=quality)
    return Image.open(file).convert("RGB")


@pytest.mark.parametrize("resampling", [Image.Resampling.LANCZOS, Image.Resampling.BICUBIC])
@pytest.mark.parametrize("gradient", [False, True])
def test_without_halos_a_picture_is_nearer_to_the_areas_that_shapes_cover(resampling, gradient):
    image = icon(gradient=gradient)
    areas, sharp = reduced(image, Image.Resampling.BOX), reduced(image, resampling)
    before, after = (np.square(levels - areas).mean() ** 0.5 for levels in (sharp, without_halos(sharp)))
    assert after < 0.8 * before


def in_light(image: Image.Image, resampling: Image.Resampling) -> np.ndarray:
    """Return the levels of a picture that was made as small as `reduced` makes it, as linear light."""
    planes = [Image.fromarray(plane) for plane in light_of_srgb(np.asarray(image, np.float32) / 255.0).T]
    small = np.stack([np.asarray(plane.resize((SIDE, SIDE), resampling)).T for plane in planes], axis=2)
    values = np.arange(256)
    nearest = np.searchsorted(light_of_srgb((values[1:] - 0.5) / 255.0), small)
    return as_levels(values[nearest] / np.float32(255.0))


@pytest.mark.parametrize("resampling", [Image.Resampling.LANCZOS, Image.Resampling.BICUBIC])
@pytest.mark.parametrize("ground", ["#dddddd", "white"])
def test_halos_of_linear_light_are_taken_off_as_light(resampling, ground):
    image = icon(ground=ground)
    areas, sharp = reduced(image, Image.Resampling.BOX), in_light(image, resampling)
    found = without_halos(sharp)
    before, after = (np.square(levels - areas).mean() ** 0.5 for levels in (sharp, without_linear_light(found)))
    assert after < 0.35 * before
    of_values = without_halos(reduced(image, resampling))
    assert without_linear_light(of_values) is of_values


@pytest.mark.parametrize(("radius", "percent"), [(1.0, 30), (1.0, 100), (1.3, 70), (2.0, 150), (3.0, 60)])
@pytest.mark.parametrize("ground", ["#dddddd", "white"])
def test_an_unsharp_mask_is_told_by_its_amount_and_radius(radius, percent, ground):
    plain = icon(ground=ground).resize((SIDE, SIDE), Image.Resampling.BOX)
    sharp = levels_of(plain.filter(ImageFilter.UnsharpMask(radius, percent, 0)))
    mask = unsharp_mask(sharp)
    assert mask.radius == pytest.approx(radius, rel=0.15)
    assert mask.amount == pytest.approx(percent / 100, rel=0.15)
    before, after = (np.square(levels - levels_of(plain)).mean() ** 0.5 for levels in (sharp, mask.undone(sharp)))
    assert after < 0.4 * before


@pytest.mark.parametrize(("radius", "percent"), [(1.0, 100), (1.3, 70), (2.0, 150)])
@pytest.mark.parametrize("ground", ["#dddddd", "white"])
@pytest.mark.parametrize("told", [True, False])
def test_an_unsharp_mask_under_a_jpeg_is_told_by_the_profiles_of_edges(radius, percent, ground, told):
    plain = icon(ground=ground).resize((SIDE, SIDE), Image.Resampling.BOX)
    compressed = levels_of(as_jpeg(plain))
    assert unsharp_mask(compressed, lossy=told) is None
    sharp = levels_of(as_jpeg(plain.filter(ImageFilter.UnsharpMask(radius, percent, 0))))
    undone = unsharp_mask(sharp, lossy=told).undone(sharp)
    least, before, after = (np.square(p - levels_of(plain)).mean() ** 0.5 for p in (compressed, sharp, undone))
    assert after < 1.3 * least < 0.85 * before


@given(amount=st.floats(0.1, 1.5), radius=st.floats(0.5, 4.0), seed=st.integers(0, 99))
def test_what_is_sharpened_again_is_the_sharpened_picture(amount, radius, seed):
    tiles = np.random.default_rng(seed).uniform(80, 170, (4, 4, 4)).repeat(8, axis=0).repeat(8, axis=1)
    mask = UnsharpMask(amount, radius)
    sharp = mask.of(tiles.astype(np.float32))
    assert mask.of(mask.undone(sharp)) == pytest.approx(sharp, abs=2.0)


@pytest.mark.parametrize("resampling", ["BOX", "BILINEAR", "HAMMING", "BICUBIC", "LANCZOS"])
def test_a_reduced_picture_has_no_unsharp_mask(resampling):
    for image in (icon(), icon(ground="white"), icon(gradient=True)):
        assert unsharp_mask(reduced(image, Image.Resampling[resampling])) is None


def test_a_translucent_picture_or_noise_has_no_unsharp_mask():
    noise = np.random.default_rng(1).uniform(0, 255, (40, 40, 4)).astype(np.float32)
    assert unsharp_mask(noise) is None
    noise[..., 3] = 255.0
    for picture in (noise, noise[:9], noise[:1, :1], np.full_like(noise, 255.0)):
        assert unsharp_mask(picture) is None
        assert unsharp_mask(picture, lossy=True) is None


@pytest.mark.parametrize("saved", [lambda image: image, as_jpeg])
def test_a_sharpened_picture_has_the_shapes_of_the_plain_one(saved):
    plain = icon().resize((SIDE, SIDE), Image.Resampling.BOX)
    sharp = saved(plain.filter(ImageFilter.UnsharpMask(2.0, 150, 2)))
    reports = [vectorize(np.asarray(image), threads=1).report for image in (plain, sharp)]
    assert reports[0].shapes == reports[1].shapes
    assert NOTE in " ".join(reports[1].notes)


def test_halos_of_one_side_suffice():
    levels = reduced(icon(ground="white"), Image.Resampling.LANCZOS)
    assert without_halos(levels) is not levels


@pytest.mark.parametrize("resampling", [Image.Resampling.BOX, Image.Resampling.BILINEAR, Image.Resampling.HAMMING])
def test_other_pictures_stay_as_they_are(resampling):
    levels = reduced(icon(), resampling)
    assert without_halos(levels) is levels
    blurred = reduced(icon().filter(ImageFilter.GaussianBlur(6)), Image.Resampling.BOX)
    assert without_halos(blurred) is blurred
    noise = np.random.default_rng(1).uniform(0, 255, (40, 40, 4)).astype(np.float32)
    for picture in (noise, noise[:9], noise[:1, :1], np.zeros_like(noise)):
        assert without_halos(picture) is picture


def test_a_steep_gradient_stays():
    along = np.linspace((30, 0, 90), (250, 0, 90), TIMES * SIDE).astype(np.uint8)
    image = Image.fromarray(np.broadcast_to(along, (TIMES * SIDE, *along.shape)).copy())
    ImageDraw.Draw(image).polygon([(120, 120), (600, 180), (120, 600)], "#f4f4f4")
    levels = reduced(image, Image.Resampling.LANCZOS)
    assert without_halos(levels) is levels


def test_a_line_between_two_areas_stays():
    image = icon()
    ImageDraw.Draw(image).rectangle([20, 20, 699, 28], fill="#ffffff")  # a line of one px, far lighter than a halo
    levels = reduced(image, Image.Resampling.LANCZOS)
    found = without_halos(levels)
    assert found is not levels
    assert np.abs(found - levels)[3:5, 20:100].max() == 0.0


def test_dark_outlines_are_no_halos():
    image = Image.new("RGB", (240, 120), "white")
    for row, column in np.ndindex(2, 4):
        x, y = 12 + 58 * column, 12 + 54 * row
        ImageDraw.Draw(image).rectangle([x, y, x + 40, y + 40], fill="#808080", outline="black", width=2)
    levels = levels_of(image)
    assert without_halos(levels) is levels


def test_a_sharpened_gradient_is_one_shape():
    small = icon(gradient=True).resize((SIDE, SIDE), Image.Resampling.LANCZOS)
    report = vectorize(np.asarray(small), style="artwork", threads=1).report
    assert NOTE in " ".join(report.notes)
    assert report.quality.svg.psnr_db > 42.0


def test_small_letters_of_a_reduced_picture_keep_their_dots():
    image = Image.new("RGB", (2 * TIMES * SIDE, TIMES * SIDE), "#dddddd")
    image.paste(icon())
    for row in range(6):
        place = TIMES * (SIDE + 5), TIMES * (10 + 18 * row)
        ImageDraw.Draw(image).text(place, "Senior, trains. If", fill="#5f5f73", font=ImageFont.load_default(56))
    small = image.resize((2 * SIDE, SIDE), Image.Resampling.LANCZOS)
    result = vectorize(np.asarray(small), style="artwork", threads=1)
    assert NOTE in " ".join(result.report.notes)
    drawn = rerender(result.svg.encode(), 2 * SIDE, SIDE, renderer="resvg").pixels[..., :3].astype(float)
    assert np.abs(drawn - np.asarray(small, float)).max() < 80.0


def test_an_outline_between_two_fills_is_no_halo():
    large = Image.new("RGB", (160 * TIMES, 160 * TIMES), "white")
    corners = [(x * TIMES, y * TIMES) for x, y in ((80, 15), (140, 130), (20, 120))]
    pen = ImageDraw.Draw(large)
    pen.polygon(corners, "#ffd23c")
    pen.line([*corners, corners[0]], "#1a1a1a", 2 * TIMES)
    levels = levels_of(large.resize((160, 160), Image.Resampling.BOX))
    assert without_halos(levels) is levels
