"""Which style suits a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from image_files import by_resvg, encode, recoded
from PIL import Image
from scipy import ndimage
from skimage import data

from cubicsplat_cli import UsageError, vectorize
from cubicsplat_cli.artwork import style
from cubicsplat_cli.artwork.channels import in_blocks
from cubicsplat_cli.artwork.input.evenness import evenness
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.style import choose_style
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings

SAMPLES = Path(__file__).resolve().parents[1] / "samples"


@pytest.mark.parametrize(
    ("name", "style"),
    [("chelsea.png", "photo"), ("astronaut.jpg", "photo"), ("logo.png", "artwork"), ("landscape.png", "artwork")],
)
def test_the_samples_get_their_styles(name, style):
    assert choose_style(load_picture(SAMPLES / name).target()).name == style


def test_a_drawing_whose_colours_are_a_little_off_is_doubtful_and_a_photo_is_not():
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:240, 0:320]
    pixels = np.full((240, 320, 3), 230.0)
    for _ in range(30):
        left, top, radius = rng.uniform((0, 0, 10), (320, 240, 40))
        pixels[np.hypot(x - left, y - top) < radius] = rng.integers(20, 230, 3)
    pixels += rng.integers(-2, 3, pixels.shape)
    drawn = choose_style(pixels.astype(np.float32) / 255)
    assert drawn.name == "artwork" or drawn.doubtful, drawn.reason
    assert not choose_style(load_picture(SAMPLES / "chelsea.png").target()).doubtful


def test_a_small_logo_in_a_jpeg_is_drawn():
    y, x = (np.mgrid[:896, :896] + 0.5) / 896 - 0.5
    logo = np.full((896, 896, 3), 255.0)
    logo[np.hypot(x, y) < 0.49] = 32, 197, 202
    logo[(np.abs(np.hypot(x, y) - 0.2) < 0.05) & (np.abs(x - y) > 0.08)] = 255
    for side in (-1, 1):
        logo[np.hypot(x - side * 0.27, y + side * 0.25) < 0.07] = 255
    small = np.rint(logo.reshape(112, 8, 112, 8, 3).mean(axis=(1, 3))).astype(np.uint8)
    found = choose_style(recoded(small, quality=60).astype(np.float32) / 255, lossy=True)
    assert (found.name, found.doubtful) == ("photo", True)
    fitted = vectorize(encode(Image.fromarray(small), "JPEG", quality=60), threads=1)
    assert (fitted.report.style, len(fitted.svg) < 2000) == ("artwork", True)


def test_steep_gradients_in_a_jpeg_may_be_a_drawing():
    y, x = np.mgrid[:240, :240]
    share = ((0.8 * x + 0.6 * y) % 64.0 / 64.0)[..., None]
    stripes = np.rint((1.0 - share) * [255, 250, 230] + share * [200, 60, 0]).astype(np.uint8)
    found = choose_style(recoded(stripes, quality=75).astype(np.float32) / 255, lossy=True)
    assert found.name == "photo" and found.doubtful, found.reason
    cat = np.rint(255.0 * load_picture(SAMPLES / "chelsea.png").target()).astype(np.uint8)
    assert not choose_style(recoded(cat, quality=75).astype(np.float32) / 255, lossy=True).doubtful


def test_a_window_with_a_soft_shadow_is_doubtful():
    rng = np.random.default_rng(1)
    shadow = np.zeros((500, 700))
    shadow[90:-90, 90:-90] = 153.0
    levels = np.zeros((500, 700, 4))
    levels[..., 3] = ndimage.gaussian_filter(shadow, 40.0)
    levels += rng.normal(0.0, 1.0, levels.shape) * (levels[..., 3:] > 0.0)
    levels[70:-110, 90:-90] = (0.0, 0.0, 0.0, 255.0)
    for row in range(100, 376, 40):
        levels[row : row + 8, 100 : 100 + rng.integers(60, 490) : 3, :3] = 178.0
    levels = np.clip(np.rint(levels), 0.0, 255.0)
    found = choose_style(np.minimum(levels, levels[..., 3:]).astype(np.float32) / 255)
    assert found.name == "artwork" or found.doubtful, found.reason


@pytest.mark.slow
def test_a_photo_of_much_darkness_is_a_photo():
    moon = np.repeat(data.moon()[..., None], 3, axis=2).astype(np.float32) / 255
    style = choose_style(moon)
    assert style.name == "photo", style.reason


def test_a_photo_with_an_even_sky_is_a_photo():
    assert choose_style(data.rocket().astype(np.float32) / 255).name == "photo"


def test_noise_in_colour_and_stars_make_no_drawing_of_a_photo():
    camera = np.repeat(data.camera()[::2, ::2, None], 3, axis=2).astype(np.float32)
    noisy = camera + np.random.default_rng(8).normal(0.0, 6.0, camera.shape)
    for picture in (noisy, data.hubble_deep_field()[:400, :500].astype(np.float32)):
        style = choose_style(np.clip(np.rint(picture), 0, 255).astype(np.float32) / 255)
        assert style.name == "photo", style.reason


def test_dots_that_stand_for_greys_are_a_photo():
    with Image.fromarray(data.camera()).resize((300, 300)).convert("1") as dots:
        levels = np.repeat(np.asarray(dots, np.float32)[..., None], 3, axis=2)
    style = choose_style(levels)
    assert style.name == "photo", style.reason


def test_a_photo_on_a_white_page_is_a_photo():
    page = np.ones((600, 600, 3), np.float32)
    page[40:296, 40:340] = load_picture(SAMPLES / "chelsea.png").target()[:256, :300, :3]
    style = choose_style(page)
    assert style.name == "photo", style.reason


@pytest.mark.parametrize("size", [16, 24, 32, 48, 64, 128])
@pytest.mark.parametrize("ground", [None, "#fff", "#fc3"])
def test_icons_of_a_few_px_are_artwork(size, ground):
    for name in ("bird", "fish", "badge", "letters"):
        icon = by_resvg(SAMPLES / "artwork" / f"{name}.svg", size, ground)
        # In grey some of them are hardly darker than this yellow, and of 16 px the badge is greys of any depth.
        for mode in ("RGBA",) if ground == "#fc3" or size == 16 else ("RGBA", "LA"):
            levels = np.array(icon.convert(mode).convert("RGBA"), np.float32) / 255
            levels[..., :3] *= levels[..., 3:]
            style = choose_style(levels)
            assert style.name == "artwork", f"{name} {mode}: {style.reason}"


@pytest.mark.parametrize("size", [16, 24, 32, 48, 64])
@pytest.mark.parametrize("name", ["astronaut", "coffee", "chelsea"])
def test_photos_of_a_few_px_are_photos(name, size):
    picture = Image.fromarray(getattr(data, name)())
    picture.thumbnail((size, size), Image.Resampling.LANCZOS)
    for mode in ("RGB", "L"):
        style = choose_style(np.asarray(picture.convert(mode).convert("RGB"), np.float32) / 255)
        assert style.name == "photo", style.reason


def test_evenness_is_the_share_of_neighbours_that_are_alike_and_of_those_that_differ_a_little():
    levels = np.zeros((8, 8, 1), np.float32)
    levels[:, 2:] = 3.0  # alike
    levels[:, 4:] = 20.0
    levels[:, 6:] = 200.0  # an edge
    whole = evenness(levels, 8)
    assert whole.little == pytest.approx(8 / 112) and whole.alike == pytest.approx(96 / 112)
    # Of each row of tiles of 2 px one has the step of 17 levels and one the edge: 14 or 12 pairs for two tiles.
    tiles = evenness(levels, 2)
    assert tiles.little == pytest.approx(8 / 60) and tiles.alike == pytest.approx(44 / 60)
    assert evenness(np.zeros((8, 8, 1)), 4).alike == 1.0


def test_blocks_have_the_means_of_their_pixels():
    levels = np.arange(5 * 7 * 2, dtype=np.float32).reshape(5, 7, 2)
    blocks = in_blocks(levels, 2).mean((2, 3))
    assert blocks.shape == (2, 3, 2)
    assert np.array_equal(blocks[1, 2], levels[2:4, 4:6].mean((0, 1)))


def test_noise_is_a_photo_and_an_even_picture_artwork():
    noise = np.random.default_rng(0).random((64, 64, 3)).astype(np.float32)
    style = choose_style(noise)
    assert style.name == "photo"
    assert style.reason.startswith("edges between 99 %")
    assert choose_style(np.full((1, 1, 3), 0.5, np.float32)).name == "artwork"


def test_what_is_clear_does_not_count():
    picture = np.zeros((128, 128, 4), np.float32)
    assert choose_style(picture).name == "artwork"
    picture[:64, :64] = np.random.default_rng(1).random((64, 64, 1)).astype(np.float32)
    assert choose_style(picture).name == "photo"


@pytest.mark.parametrize("sides", [(1, 300), (2, 300), (6, 300), (4, 100)])
def test_a_picture_narrower_than_a_block_has_a_style(sides):
    noise = np.random.default_rng(6).random((*sides, 3)).astype(np.float32)
    halves = np.zeros((*sides, 3), np.float32)
    halves[:, sides[1] // 2 :] = 1.0
    for turned in (False, True):
        assert choose_style(noise.swapaxes(0, 1) if turned else noise).name == "photo"
        assert choose_style(halves.swapaxes(0, 1) if turned else halves).name == "artwork"


@pytest.mark.slow
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
    block = min(7 if max(shape) >= 256 else 5 if max(shape) >= 64 else 3, *(side - 1 + side % 2 for side in shape))
    spread = ndimage.maximum_filter(levels, (3, 3, 1)) - ndimage.minimum_filter(levels, (3, 3, 1))
    want = ndimage.binary_opening(spread.max(-1) > style.FLAT_RANGE, np.ones((block, block))).mean()
    rough = spread.max(-1) > style.FLAT_RANGE
    assert style._texture(rough, np.ones(shape, dtype=bool)) == pytest.approx(want, abs=1e-12)
    assert want > 0 or max(shape) == 1


@pytest.mark.parametrize(
    "asked",
    [{"colors": 3}, {"palette": "red,white"}, {"min_area": 9.0}, {"detail": 2.0}, {"completion": "off"}],
)
def test_options_of_drawings_imply_a_drawing(asked):
    rng = np.random.default_rng(3)
    pixels = rng.integers(0, 256, (6, 8, 3), dtype=np.uint8)
    made = vectorize(pixels, measure=False, threads=1, **asked)
    assert (made.report.style, made.report.style_reason) == ("artwork", f"asked for by {next(iter(asked))}")
    with pytest.raises(UsageError, match=f"^{next(iter(asked))} is for artwork"):
        vectorize(pixels, style="photo", **asked)
    artwork = ArtworkSettings(**asked)
    assert Request(FitSettings(mode="open"), artwork).of_artwork() == [*asked]


def test_what_gradients_explain_for_the_most_part_is_doubtful():
    y, x = np.mgrid[:320, :320].astype(float)
    picture = np.stack([200 - 0.4 * y, 60 + 0.2 * y, 230 - 0.35 * y], axis=2)
    soft = x > 190  # shading that no gradient explains, with some grain
    picture -= (soft * 20.0 * np.sin(x / 17.0) * np.sin(y / 23.0))[..., None]
    picture[soft] += np.random.default_rng(0).normal(0.0, 0.8, picture.shape)[soft]
    found = choose_style(np.rint(picture).astype(np.float32) / np.float32(255))
    assert (found.name, found.doubtful) == ("photo", True) and "drift" in found.reason
    gradient = np.rint(picture)[:, :180].astype(np.float32) / np.float32(255)
    assert choose_style(gradient).name == "artwork"
