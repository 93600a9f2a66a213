"""Artwork from pictures that something has happened to since they were drawn."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from conftest import rest_slow
from image_files import encode, recoded
from PIL import Image, ImageDraw, ImageFilter
from scipy import ndimage
from stroke_icons import ICONS, svg_of

from benchmarks.artwork.degradations import clouds, degraded, with_background
from benchmarks.artwork.document import Document
from cubicsplat_cli.api import vectorize as vectorize_pixels
from cubicsplat_cli.artwork import plan
from cubicsplat_cli.artwork.geometry.outlines import Circle, Rectangle
from cubicsplat_cli.artwork.input import prepare
from cubicsplat_cli.artwork.input.condition import Condition, blurred_everywhere, condition_of, rippled
from cubicsplat_cli.artwork.input.enlargement import before_enlargement
from cubicsplat_cli.artwork.input.palette import noisy_fills
from cubicsplat_cli.artwork.input.prepare import analysed, as_levels
from cubicsplat_cli.artwork.input.restore import explained_by_blur, restored
from cubicsplat_cli.artwork.regions.hidden_fills import overshoots
from cubicsplat_cli.artwork.style import choose_style
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.load import as_picture
from cubicsplat_cli.raster.unmix import components
from cubicsplat_cli.svg.values import hex_colour

SAMPLES = Path(__file__).resolve().parents[1] / "samples"
SIDE = 160
FILLS = [(255, 204, 77), (102, 69, 0), (190, 25, 49)]
FACE = (
    '<circle cx="80" cy="78" r="70" fill="#ffcc4d"/><circle cx="55" cy="62" r="12.5" fill="#664500"/>'
    '<circle cx="105" cy="62" r="12.5" fill="#664500"/>'
    '<path d="M45 100C60 122 100 122 115 100L118 112C100 140 60 140 42 112z" fill="#be1931"/>'
)

SKIN = (
    '<rect width="160" height="160" fill="#fff"/><circle cx="80" cy="80" r="60" fill="#f2d2a1"/>'
    '<path d="M55 105Q80 130 105 105L102 116Q80 136 58 116z" fill="#de2e43"/>'
    '<rect x="45" y="50" width="14" height="24" rx="6" fill="#682014"/>'
    '<rect x="100" y="50" width="14" height="24" rx="6" fill="#682014"/>'
)


def pixels(kind: str, body: str = FACE, side: int = SIDE) -> np.ndarray:
    """What tools get of a drawing."""
    text = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIDE} {SIDE}">{body}</svg>'
    document = Document(text.encode(), "x", side)
    with_background(document, kind)
    return degraded(document, kind)


def target(kind: str, body: str = FACE) -> np.ndarray:
    """The same as the artwork style takes it."""
    return as_picture(pixels(kind, body)).target()


def drifting(picture: np.ndarray, px: float, levels: float, channels: int = 3) -> np.ndarray:
    """A picture with soft edges, and noise that is alike over so many px, of so many levels, in 3 channels or in 1."""
    drift = clouds(np.random.default_rng(0), (*picture.shape[:2], channels), px, levels)
    soft = ndimage.gaussian_filter(picture[..., :3].astype(float), (0.7, 0.7, 0.0))
    noisy = soft + drift + np.random.default_rng(1).normal(0.0, 0.4, soft.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("px", [2.0, 6.0])
def test_colours_that_drift_like_a_generators_are_fills_with_noise(px):
    ground = '<rect width="160" height="160" fill="#406090"/>'
    found = drifting(pixels("clean", ground + FACE), px, 1.5)
    assert 1.0 < condition_of(as_levels(as_picture(found).target())).noise < 2.5
    done = vectorize_pixels(found, measure=False)
    assert done.report.style == "artwork" and done.report.shapes <= 6


def large_face() -> np.ndarray:
    """A face on an even ground, of twice the size."""
    return pixels("clean", '<rect width="160" height="160" fill="#406090"/>' + FACE).repeat(2, 0).repeat(2, 1)


def test_drift_in_a_compressed_picture_is_noise_too():
    found = recoded(drifting(large_face(), 3.0, 2.5), "JPEG", quality=90)
    condition = condition_of(as_levels(as_picture(found).target()))
    assert condition.jpeg and 1.5 < condition.noise < 3.5


@pytest.mark.parametrize(("px", "channels"), [(3.0, 3), (20.0, 1)])
def test_clouds_on_fills_are_no_shapes(px, channels):
    """They differ from their fills by up to 10 levels, but have no borders."""
    found = vectorize_pixels(drifting(large_face(), px, 3.5, channels), measure=False)
    assert found.report.shapes <= 8


@pytest.mark.parametrize(("side", "quality"), [(80, 75), (80, 92), (96, 65), (112, 85), (144, 65)])
def test_a_small_part_in_a_jpeg_is_no_mosaic_of_the_others(side, quality):
    """A nose of a few px, whose colour is a blend of those of the skin, the lips and the eyes."""
    nose = '<rect x="71" y="87" width="18" height="7" rx="3" fill="#c0694d"/>'
    picture = Image.fromarray(pixels("clean", SKIN + nose, side)[..., :3].copy())
    report = vectorize_pixels(encode(picture, "JPEG", quality=quality), measure=False).report
    off = [np.abs(np.subtract(hex_colour(ink[:7]), (192, 105, 77))).max() for ink in report.inks]
    assert report.shapes == 6 and min(off) <= 16


def test_soft_shading_is_no_noise():
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE - 0.5
    ball = 40.0 + 200.0 * np.clip(1.0 - 2.0 * (x + 0.1) ** 2 - 2.0 * (y + 0.2) ** 2, 0.0, 1.0)
    shaded = np.rint(ball[..., None] * [1.0, 0.8, 0.6]).astype(np.uint8)
    assert condition_of(as_levels(as_picture(shaded).target())).noise == 0.0


def test_clean_pictures_are_known_as_such():
    for kind in ("clean", "palette"):
        assert condition_of(as_levels(target(kind))) == Condition(), kind
    assert Condition().description == ""


def test_a_clean_picture_is_drawn_as_it_is(monkeypatch):
    monkeypatch.setattr(plan, "restored", lambda *_: pytest.fail("a clean picture was restored"))
    assert len(draw(target("clean")).shapes) == 4


def test_what_happened_is_found_and_said():
    found = condition_of(as_levels(target("jpeg")))
    assert found.jpeg and 0.5 < found.noise < 4.0 and found.blur == 0.0
    assert found.description == f"compression artefacts of {found.noise:.1f} levels"
    found = condition_of(as_levels(target("noisy")))
    # Noise is cut off at 255, so that white has half of it.
    assert not found.jpeg and 2.0 < found.noise < 5.0 and found.blur == 0.0
    assert found.description == f"noise of {found.noise:.1f} levels"
    found = condition_of(as_levels(target("blurred")))
    assert found.blur == pytest.approx(1.2, abs=0.1) and found.noise == 0.0
    assert Condition(3.0, False, 1.2).description == "a blur of 1.2 px and noise of 3.0 levels"


@pytest.mark.parametrize(("file", "quality"), rest_slow(("JPEG", 95), ("WEBP", 80), ("JPEG", 80)))
def test_a_margin_makes_no_compressed_picture_clean(file, quality):
    levels = recoded(pixels("palette")[..., :3], file, quality=quality)
    for margin in (0, 50, 400):  # px; aligned to no block
        wide = np.pad(levels, ((margin, margin), (margin, margin), (0, 0)), constant_values=255)
        assert condition_of(as_levels(as_picture(wide).target())).jpeg, margin


@pytest.mark.parametrize("mode", rest_slow("RGBA", "RGB"))
def test_a_lossy_webp_is_known_and_drawn_as_it_was(mode):
    # Its blocks are of many sizes and smoothed: only the ringing tells.
    clean = pixels("clean") if mode == "RGBA" else pixels("palette")
    levels = recoded(Image.fromarray(clean).convert(mode), "WEBP", quality=80)
    assert levels.shape[2] == len(mode)
    assert condition_of(as_levels(as_picture(levels).target())).jpeg
    drawing = draw(as_picture(levels).target())
    circles = [outline for shape in drawing.shapes for outline in shape.outlines if isinstance(outline, Circle)]
    assert sorted(circle.r for circle in circles) == pytest.approx([12.5, 12.5, 70.0], abs=0.1)
    assert len(drawing.shapes) == len(draw(target("clean")).shapes) + (mode == "RGB")


@pytest.mark.parametrize("lossy", [True, False])
def test_a_lossy_picture_that_was_made_smaller_is_known_by_its_ripples(lossy):
    # Lanczos' filter leaves halos, which are undone, and with them most of what tells the loss.
    clean = pixels("palette", side=256)[..., :3]
    levels = recoded(clean, "WEBP", quality=75) if lossy else clean
    small = as_picture(np.asarray(Image.fromarray(levels).resize((128, 128), Image.Resampling.LANCZOS))).target()
    condition = analysed(small).condition
    assert condition.jpeg == lossy and condition.sharpened != lossy
    assert len(draw(small).shapes) == 5


def test_a_ground_that_alternates_between_two_levels_is_no_noise():
    y, x = np.mgrid[0:120, 0:160]
    levels = np.full((120, 160, 4), 255.0, dtype=np.float32)
    levels[..., :3] = np.where((x + y) % 2 == 0, 240.0, 242.0)[..., None]
    levels[30:60, 30:80] = [200.0, 40.0, 40.0, 255.0]
    assert condition_of(levels).clean


@pytest.mark.parametrize("pitch", [7.6, 6.4])
def test_a_grid_of_thin_lines_is_no_noise(pitch):
    """Lines of a px, between most of which too few pixels for a window of 5 x 5 are even."""
    lines = "".join(f"M{k * pitch} 0V{SIDE}M0 {k * pitch}H{SIDE}" for k in range(1, int(SIDE / pitch)))
    levels = as_levels(target("clean", f'<path d="M0 0H160V160H0z" fill="#fff"/><path d="{lines}" stroke="#a8c8e8"/>'))
    assert condition_of(levels).clean
    noise = np.random.default_rng(4).normal(0.0, 15.0, (*levels.shape[:2], 3))
    levels[..., :3] = np.clip(np.rint(levels[..., :3] + noise), 0.0, 255.0)
    assert condition_of(levels).noise > 5.0


def test_a_picture_in_the_colours_of_a_palette_was_no_jpeg():
    """Buttons that get darker downwards, and lines on them, in 24 colours."""
    random, rows = np.random.default_rng(0), np.arange(640)[:, None] % 120 / 30.0
    shades = [np.broadcast_to(first - rows * fall, (640, 960)) for first, fall in ((235, 6), (225, 8), (200, 5))]
    large = Image.fromarray(np.dstack(shades).astype(np.uint8))
    for x, y in random.integers(0, [940, 620], (200, 2)).tolist():
        right, down = random.integers(-40, 40, 2).tolist()
        ImageDraw.Draw(large).line([x, y, x + right, y + down], fill=(20, 30, 80), width=5)
    indexed = large.resize((240, 160), Image.Resampling.BOX).quantize(24, dither=Image.Dither.NONE).convert("RGB")
    assert condition_of(as_levels(as_picture(np.asarray(indexed)).target())).clean


def test_a_picture_that_was_scaled_down_was_no_jpeg():
    levels = np.full((40, 48, 3), 240, np.uint8)
    levels[8:30, 10:34] = (20, 90, 160)
    small = Image.fromarray(levels).resize((24, 20), Image.Resampling.LANCZOS)
    assert not condition_of(as_levels(as_picture(np.asarray(small)).target())).jpeg


def test_pale_stripes_and_marks_on_a_grid_of_8_px_are_no_jpeg():
    levels = np.full((256, 256, 3), 255, np.uint8)
    for top in range(32, 256, 64):
        levels[top : top + 32] = (243, 244, 246)
    # A diagonal has few coefficients in the blocks that it fills, and many in those half a block away.
    for top in range(8, 256, 32):
        for left in range(8, 256, 16):
            levels[top : top + 8, left : left + 8][np.eye(8, dtype=bool)] = 0
    assert condition_of(as_levels(as_picture(levels).target())) == Condition()
    assert condition_of(as_levels(as_picture(recoded(levels, quality=90)).target())).jpeg


def test_a_screenshot_is_not_compressed_though_it_shows_a_photograph():
    """Compression of the whole picture leaves ripples at the text too."""
    photo = np.asarray(Image.open(SAMPLES / "chelsea.png").convert("RGB").crop((60, 40, 220, 140)))
    window = Image.new("RGB", (400, 300), (236, 236, 236))
    window.paste(Image.fromarray(recoded(photo, quality=60)), (20, 20))
    for line in range(12):
        ImageDraw.Draw(window).text((200, 20 + 22 * line), f"A label, and {line} more", fill=(30, 30, 30))
    shown = np.asarray(window)
    assert not condition_of(as_levels(as_picture(shown).target())).jpeg
    assert condition_of(as_levels(as_picture(recoded(shown, quality=80)).target())).jpeg


def test_the_faint_lines_of_a_plot_are_no_ripples():
    large = Image.new("RGB", (1280, 960), "white")
    draw_on = ImageDraw.Draw(large)
    for k in range(-960, 1280, 60):
        draw_on.line([k, 0, k + 960, 960], fill=(249, 249, 249), width=4)
    for k in range(80, 1280, 160):
        draw_on.line([k, 80, k, 880], fill=(40, 40, 40), width=4)
        draw_on.ellipse([k + 40, k // 2, k + 80, k // 2 + 40], fill=(31, 119, 180))
    plot = np.asarray(large.resize((320, 240), Image.Resampling.BOX))
    levels = as_levels(as_picture(plot).target())
    assert rippled(levels) and condition_of(levels).clean
    assert condition_of(as_levels(as_picture(recoded(plot, quality=90)).target())).jpeg


@pytest.mark.parametrize("kind", ["jpeg", "noisy"])
def test_noise_gives_no_fills_and_hides_none(kind):
    levels = as_levels(target(kind))
    fills = noisy_fills(levels, levels, condition_of(levels))
    assert len(fills) == 4
    for fill in [(255, 255, 255), *FILLS]:
        assert np.abs(fills[:, :3] - fill).max(axis=1).min() <= 4.0


def test_a_corner_without_opacity_is_no_paler_fill():
    # A white button, cropped to its rounded outline, of which one pixel in each corner is clear.
    levels = np.full((48, 48, 4), 255.0, np.float32)
    for corner in (levels[:3, :3], levels[:3, :-4:-1], levels[:-4:-1, :3], levels[:-4:-1, :-4:-1]):
        corner[:] = np.array([[0, 15, 111], [15, 223, 255], [159, 255, 255]], np.float32)[..., None]
    levels[20:28, 10:38, :3] = 56.0
    drawing = draw(levels / 255.0)
    assert drawing.fills == ((255, 255, 255, 255), (56, 56, 56, 255)) and len(drawing.shapes) == 2
    assert not isinstance(drawing.shapes[0].outlines[0], Rectangle)


@pytest.mark.parametrize("deviation", [3.0, 8.0, 14.0])
def test_strong_noise_is_measured_and_makes_no_more_of_near_fills(deviation):
    levels = np.full((200, 200, 4), 255.0, np.float32)
    y, x = np.mgrid[:200, :200]
    greys = [66.0, 87.0, 120.0, 190.0]
    for k, grey in enumerate(greys):
        levels[np.hypot(x - 100, y - 100) < 95 - 20 * k, :3] = grey
    noise = np.random.default_rng(2).normal(0.0, deviation, (200, 200, 3))
    levels[..., :3] = np.clip(np.rint(levels[..., :3] + noise), 0.0, 255.0)
    assert choose_style(levels / 255.0).name == "artwork"
    found = condition_of(levels)
    assert found.noise == pytest.approx(deviation, rel=0.2) and not found.jpeg
    picture = restored(levels, found)
    assert sorted(picture.palette[:, 0]) == pytest.approx([*greys, 255.0], abs=2.0)
    assert components(picture.labels)[1] == 5


def test_a_photo_that_comes_as_near_as_noise_lets_it_is_no_better_than_the_drawing():
    levels = np.full((240, 240, 3), 255.0)
    levels[40:200, 30:110] = (59, 136, 195)
    levels[90:160, 100:210] = (59, 136, 195)
    levels += np.random.default_rng(2).normal(0.0, 14.0, levels.shape)
    made = vectorize_pixels(np.clip(np.rint(levels), 0, 255).astype(np.uint8), threads=1)
    assert made.report.style == "artwork" and made.report.shapes == 2


@pytest.mark.parametrize(("kind", "least"), [("jpeg", 1.7), ("noisy", 1.4)])
def test_a_restored_picture_is_nearer_to_the_clean_one(kind, least):
    ground = f'<path d="M0 0H{SIDE}V{SIDE}H0z" fill="#fff"/>'
    clean, spoilt = as_levels(target("clean", ground + FACE)), as_levels(target(kind))
    done = restored(spoilt, condition_of(spoilt)).levels
    before, after = (float(np.sqrt(((p - clean) ** 2).mean())) for p in (spoilt, done))
    assert before > least * after
    # Interiors are even again.
    assert len(np.unique(np.rint(done[20:140, 20:140]).reshape(-1, 4)[::7], axis=0)) < 400
    assert np.ptp(done[70:90, 20:40], axis=(0, 1)).max() == 0.0


@pytest.mark.parametrize("kind", rest_slow("jpeg", "noisy"))
def test_the_drawing_is_that_of_the_clean_picture(kind):
    drawing = draw(target(kind))
    assert len(drawing.shapes) == 5
    for fill in FILLS:
        assert min(np.abs(np.array(shape.fill[:3]) - fill).max() for shape in drawing.shapes) <= 2
    circles = [outline for shape in drawing.shapes for outline in shape.outlines if isinstance(outline, Circle)]
    assert sorted(circle.r for circle in circles) == pytest.approx([12.5, 12.5, 70.0], abs=0.1)
    # A ground more than the clean one has.
    assert drawing.segments <= draw(target("clean")).segments + 4


def test_a_blurred_drawing_is_as_simple_and_as_exact_as_a_sharp_one():
    sharp, blurred = draw(target("clean")), draw(target("blurred"))
    assert len(blurred.shapes) == len(sharp.shapes)
    assert blurred.coordinates <= 1.5 * sharp.coordinates
    circles = [outline for shape in blurred.shapes for outline in shape.outlines if isinstance(outline, Circle)]
    assert sorted(circle.r for circle in circles) == pytest.approx([12.5, 12.5, 70.0], abs=0.05)


def test_narrow_strokes_through_a_wide_blur_keep_their_fill():
    """The middles of strokes and of the gaps between them are pale, though neither is of another fill."""
    large = Image.new("RGB", (4 * 320, 4 * 120), "white")
    pen = ImageDraw.Draw(large)
    for k in range(5):
        pen.rounded_rectangle([60 + 96 * k, 60, 108 + 96 * k, 420], 24, fill="#ff6c2c")
    pen.ellipse([600, 100, 960, 400], fill="#ff6c2c")
    pen.ellipse([650, 150, 910, 350], fill="white")
    pen.rounded_rectangle([1040, 60, 1220, 420], 24, fill="#ff6c2c")
    small = large.resize((320, 120), Image.Resampling.BOX).filter(ImageFilter.GaussianBlur(3.0))
    prepared = analysed(as_picture(np.asarray(small)).target())
    assert prepared.condition.blur == pytest.approx(3.0, abs=0.3)
    drawing = draw(as_picture(np.asarray(small)).target(), None, prepared)
    fills = {shape.fill[:3] for shape in drawing.shapes}
    assert len(drawing.shapes) <= 8 and all(
        min(np.abs(np.subtract(fill, own)).max() for own in ((255, 108, 44), (255, 255, 255))) <= 8 for fill in fills
    )


def test_lines_are_drawn_through_a_blur_that_leaves_nothing_even_between_them():
    large = Image.new("RGB", (72 * 8, 72 * 8), "white")
    pen = ImageDraw.Draw(large)
    pen.arc([60, 60, 516, 516], 20, 300, "black", 48)
    pen.arc([156, 156, 420, 420], 200, 480, "black", 48)
    pen.line([110, 540, 470, 540], "black", 44)
    small = large.resize((72, 72), Image.Resampling.BOX).filter(ImageFilter.GaussianBlur(1.2))
    prepared = analysed(as_picture(np.asarray(small)).target())
    assert prepared.condition.blur == pytest.approx(1.2, abs=0.15)
    drawing = draw(as_picture(np.asarray(small)).target(), None, prepared)
    assert len(drawing.shapes) <= 6 and drawing.segments <= 40


def test_grey_outlines_between_light_and_dark_are_no_blur():
    levels = np.full((90, 256, 4), 255.0, np.float32)
    levels[15:75, 14:242, :3], levels[16:74, 15:241, :3] = 248, 204
    for left, colour in zip(
        range(16, 240, 56), [(0, 109, 44), (190, 20, 40), (20, 60, 180), (120, 0, 120)], strict=True
    ):
        levels[17:73, left : left + 55, :3] = np.add(np.multiply(colour, 0.75), 51)
        levels[18:72, left + 1 : left + 54, :3] = colour
    assert condition_of(levels).clean


def test_a_picture_is_blurred_everywhere_only_if_its_edges_say_so():
    soft = Image.fromarray(pixels("clean")).filter(ImageFilter.GaussianBlur(2.0))
    assert blurred_everywhere(as_levels(as_picture(np.asarray(soft)).target()))
    assert not blurred_everywhere(as_levels(target("clean")))
    assert not blurred_everywhere(np.full((40, 40, 4), 255.0, np.float32))


# --- the style ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "body, kind",
    [
        ('<circle cx="80" cy="80" r="80" fill="#ffcc4d"/>', Circle),
        ('<rect width="160" height="160" rx="30" fill="#3b88c3"/>', Rectangle),
    ],
)
def test_what_touches_the_canvas_is_as_round_in_a_jpeg(body, kind):
    # Along the border slivers of the ground are less than a pixel wide, and JPEG leaves nothing of them.
    drawing = draw(target("jpeg", body))
    assert [type(outline) for outline in drawing.shapes[-1].outlines] == [kind]


@pytest.mark.parametrize("kind", rest_slow("jpeg", "blurred", "noisy", "enlarged", "palette", fast=2))
def test_a_spoilt_drawing_is_still_a_drawing(kind):
    lines = "".join(f'<path d="M{x} 0L{x + 9} 160" stroke="#369" stroke-width="2"/>' for x in range(0, 150, 24))
    for body in (FACE, lines + FACE):
        found = choose_style(target(kind, body))
        assert found.name == "artwork", found.reason


@pytest.mark.parametrize("scale", rest_slow(0.5, 2))
def test_a_photo_as_a_jpeg_is_still_a_photo(scale):
    with Image.open(SAMPLES / "chelsea.png") as picture:
        sized = picture.convert("RGB").resize([round(side * scale) for side in picture.size], Image.Resampling.BICUBIC)
    jpeg = recoded(sized, quality=80).astype(np.float32) / 255.0
    found = choose_style(jpeg)
    assert found.name == "photo", found.reason
    # On white as well.
    framed = np.ones((3 * sized.height // 2, 3 * sized.width // 2, 3), np.float32)
    framed[: sized.height, : sized.width] = jpeg
    assert choose_style(framed).name == "photo"


# --- enlarged pictures ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("filtered", "times"),
    rest_slow(
        ("BICUBIC", 3), ("LANCZOS", 1.6), ("NEAREST", 10), *product(("NEAREST", "BILINEAR", "BICUBIC"), (2, 3)), fast=3
    ),
)
def test_an_enlarged_picture_is_known_as_it_was(filtered, times):
    small = np.rint(255.0 * target("palette")).astype(np.uint8)
    side = round(SIDE * times)
    large = Image.fromarray(small).resize((side, side), Image.Resampling[filtered])
    found, factors = before_enlargement(as_levels(as_picture(np.asarray(large)).target()))
    assert factors == (times, times)
    off = np.abs(found[..., :3] - small).max(axis=-1)
    assert (off <= 3.0).mean() > 0.995


@pytest.mark.parametrize(("filtered", "times"), [("BICUBIC", 1.3), ("LANCZOS", 1.5), ("BILINEAR", 1.8)])
def test_a_small_enlargement_of_parts_that_repeat_is_known(filtered, times):
    """Keys have peaks of their own in the spectrum, and edges that are still steep."""
    keys = "".join(f'<path d="M{9 + 27.3 * k} 30h20.6v{60 + 4 * k}h-20.6z" fill="#333"/>' for k in range(5))
    sign = '<circle cx="90.3" cy="135.2" r="19.5" fill="#c22"/><path d="M40 110l25.4 44.1h-50.9z" fill="#26c"/>'
    small = np.rint(255.0 * target("clean", keys + sign)[..., :3]).astype(np.uint8)
    side = round(SIDE * times)
    large = Image.fromarray(small).resize((side, side), Image.Resampling[filtered])
    found, factors = before_enlargement(as_levels(as_picture(large).target()))
    assert factors == (times, times)
    assert np.abs(found[..., :3] - small).mean() < 1.0


@pytest.mark.parametrize(("wide", "high"), rest_slow((2.5, 2.5), (1.5, 2.25), (3.2, 3.2)))
def test_an_enlarged_picture_is_known_in_a_jpeg(wide, high):
    small = Image.fromarray(np.rint(255.0 * target("clean")).astype(np.uint8)).convert("RGB")
    size = round(SIDE * wide), round(SIDE * high)
    large = recoded(small.resize(size, Image.Resampling.BICUBIC), quality=85)
    found, factors = before_enlargement(as_levels(as_picture(large).target()))
    assert factors == (wide, high)
    assert np.abs(found[..., :3] - np.asarray(small)).mean() < 3.0


@pytest.mark.parametrize("blur", [2.2, 2.8])
def test_lines_are_drawn_through_a_wide_blur_that_looks_like_an_enlargement(blur):
    sharp = rerender(svg_of(ICONS["cross"]).encode(), 320, 320).pixels[..., :3]
    picture = np.asarray(Image.fromarray(sharp).filter(ImageFilter.GaussianBlur(blur)), dtype=np.float32) / 255.0
    assert before_enlargement(as_levels(picture))[1] == (2.0, 2.0)  # since a blur hides what is between its pixels
    prepared = analysed(picture)
    assert prepared.mean_scale * prepared.condition.blur == pytest.approx(blur, rel=0.1)
    drawing = vectorize_pixels(np.rint(255.0 * picture).astype(np.uint8), measure=False)
    drawn = rerender(drawing.svg.encode(), 320, 320).pixels[..., :3]
    assert drawing.svg.count("<path") <= 3 and np.abs(drawn.astype(float) - sharp).mean() <= 0.1


def test_what_was_not_enlarged_stays():
    for kind in ("clean", "palette", "jpeg", "noisy", "blurred"):
        levels = as_levels(target(kind))
        found, factor = before_enlargement(levels)
        assert factor == (1.0, 1.0) and found is levels, kind
    # Shapes on a grid of two px are no enlarged pixels.
    boxes = as_levels(target("clean", '<path d="M20 20H80V60H20zM100 40H140V120H100z"/>'))
    assert before_enlargement(boxes)[1] == (1.0, 1.0)


def test_an_enlarged_picture_is_drawn_as_it_was():
    circle = '<circle cx="80" cy="80" r="50.4" fill="#be1931"/>'
    small, large = draw(target("clean", circle)), draw(target("enlarged", circle))
    assert (large.width, large.height) == (SIDE, SIDE)
    (shape,) = large.shapes
    (found,) = shape.outlines
    assert isinstance(found, Circle) and shape.fill == small.shapes[0].fill
    assert (found.cx, found.cy, found.r) == pytest.approx((80.0, 80.0, 50.4), abs=0.06)


# --- the command and the library ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "note"),
    rest_slow(
        ("jpeg", "through compression artefacts of"), ("blurred", "through a blur of 1."), ("enlarged", "2 times as")
    ),
)
def test_the_report_says_what_was_drawn_through(kind, note):
    done = vectorize_pixels(pixels(kind), measure=False)
    assert done.report.style == "artwork"
    assert any(note in each for each in done.report.notes), done.report.notes


def test_of_a_clean_picture_there_is_nothing_to_say():
    assert analysed(target("clean")).notes == []


def test_a_fill_of_thin_lines_alone_is_found_and_drawn():
    lines = "".join(f'<path d="M0 {y}L160 {y + 40}" stroke="#000" stroke-width="1.8"/>' for y in range(-10, 110, 30))
    body = f'<path d="M0 0H160V160H0z" fill="#fff"/><path d="M0 0H80V160H0z" fill="#0071bd"/>{lines}'
    levels = as_levels(target("jpeg", body))
    condition = condition_of(levels)
    palette = noisy_fills(levels, levels, condition)
    assert np.abs(palette[:, :3]).max(axis=1).min() > 100.0
    done = restored(levels, condition).levels
    clean = as_levels(target("clean", body))
    black = (clean[..., :3] < 8.0).all(axis=-1)
    assert black.sum() > 300
    assert (done[black][:, :3].max(axis=1) < 60.0).mean() > 0.9


@pytest.mark.parametrize("kind", ["jpeg", "noisy"])
def test_lines_that_cover_less_than_half_of_any_pixel_stay(kind):
    # The bar has their fill, of which no pixel on a line has as much as half.
    lines = "".join(f'<path d="M10 {y}H150" stroke="#123" stroke-width=".8"/>' for y in (20, 60, 100))
    body = f'<path d="M0 0H160V160H0z" fill="#fff"/><path d="M10 130H150V150H10z" fill="#123"/>{lines}'
    levels, clean = as_levels(target(kind, body)), as_levels(target("clean", body))
    done = restored(levels, condition_of(levels)).levels
    for y in (19, 20, 59, 60, 99, 100):
        assert clean[y, 12:148, 0].max() > 130.0
        assert np.abs(done[y, 12:148, :3] - clean[y, 12:148, :3]).mean() < 12.0


# --- blur -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ground", "fill", "outline"),
    [("none", "#ffcc4d", "#222"), ("none", "#fff", "#000"), ("#fff", "#222", "#888")],
)
def test_an_outline_between_two_areas_is_no_wide_edge(ground, fill, outline):
    # Its colour is no blend of those beside it; or it is one, and the steps to either side of it are two edges.
    body = f'<path d="M0 0H160V160H0z" fill="{ground}"/>'
    body += f'<rect x="20.3" y="30.4" width="110" height="90" fill="{fill}" stroke="{outline}" stroke-width="3"/>'
    assert condition_of(as_levels(target("clean", body))) == Condition()


def blurred(body: str, blur: float = 1.2) -> tuple[np.ndarray, np.ndarray]:
    """(SIDE, SIDE, 4) float32 levels of a drawing, and of it blurred."""
    clean = as_levels(target("clean", f'<path d="M0 0H{SIDE}V{SIDE}H0z" fill="#fff"/>' + body))
    soft = ndimage.gaussian_filter(clean, (blur, blur, 0.0), mode="nearest")
    return clean, np.rint(soft).astype(np.float32)


def even(levels: np.ndarray) -> np.ndarray:
    """(H, W) bool: the 3 x 3 px around are of one colour."""
    return (ndimage.maximum_filter(levels, (3, 3, 1)) == ndimage.minimum_filter(levels, (3, 3, 1))).all(axis=-1)


@pytest.mark.parametrize("noise", [0.0, 4.0])
def test_a_blur_is_what_explains_the_picture_better(noise):
    _, soft = blurred(FACE, 1.5)
    soft += np.random.default_rng(0).normal(0.0, noise, soft.shape) * [1.0, 1.0, 1.0, 0.0]
    assert explained_by_blur(soft, Condition(noise, blur=1.5))
    assert not explained_by_blur(as_levels(target("noisy" if noise else "palette")), Condition(noise, blur=1.5))


@pytest.mark.slow
@pytest.mark.parametrize("noise", [3.0, 6.0])
def test_a_blur_is_told_under_noise(noise):
    sharp = pixels("clean", '<rect width="160" height="160" fill="#406090"/>' + FACE)[..., :3].astype(float)
    for blur in (0.0, 1.0, 1.6):
        soft = ndimage.gaussian_filter(sharp, (blur, blur, 0.0), mode="nearest")
        seen = np.clip(np.rint(soft + np.random.default_rng(3).normal(0.0, noise, soft.shape)), 0, 255)
        found = condition_of(as_levels(as_picture(seen.astype(np.uint8)).target())).blur
        assert found == pytest.approx(blur, rel=0.2)


def test_a_blur_that_is_measured_but_not_there_is_not_drawn_through(monkeypatch):
    monkeypatch.setattr(prepare, "condition_of", lambda _, **__: Condition(blur=1.5))
    assert analysed(target("clean")).condition == Condition()
    assert analysed(target("blurred")).condition == Condition(blur=1.5)


def test_fills_that_are_nearly_alike_stay_apart_in_a_blurred_picture():
    """They differ by eight levels, as those that noise would make of one fill do."""
    clean, soft = blurred('<path d="M10 10H80V150H10z" fill="#eaeaea"/><path d="M80 10H150V150H80z" fill="#e2dfe4"/>')
    done = restored(soft, Condition(0.0, False, 1.2)).levels
    for y, x in ((80, 40), (80, 120), (80, 5)):
        assert (done[y, x] == clean[y, x]).all()
    assert len(np.unique(np.rint(done[60:100, 20:140]).reshape(-1, 4), axis=0)) <= 3


def test_no_fill_is_made_up_where_three_meet_in_a_blurred_picture():
    sectors = "".join(
        f'<path d="M80 80L{80 + 70 * np.cos(a):.3f} {80 + 70 * np.sin(a):.3f}'
        f'A70 70 0 0 1 {80 + 70 * np.cos(a + 0.9):.3f} {80 + 70 * np.sin(a + 0.9):.3f}z" fill="{fill}"/>'
        for a, fill in zip(np.arange(7) * 0.9, ["#c33", "#fc4", "#28a", "#3a5", "#a4c", "#f84", "#234"], strict=True)
    )
    clean, soft = blurred(sectors)
    done = restored(soft, Condition(0.0, False, 1.2)).levels
    before, after = (float(np.sqrt(((p - clean) ** 2).mean())) for p in (soft, done))
    assert after < 0.35 * before
    fills, found = ({tuple(fill) for fill in picture[even(picture)].tolist()} for picture in (clean, done))
    assert found == fills and len(fills) == 8


def test_what_sharpening_makes_beside_an_edge_is_no_fill():
    palette = np.array([[0.0, 0.0, 0.0, 0.0], [190.0, 25.0, 49.0, 255.0]])
    assert overshoots(np.array([204.0, 27.0, 53.0, 255.0]), palette)
    assert not overshoots(np.array([190.0, 90.0, 49.0, 255.0]), palette)


def test_fills_of_a_jpeg_that_are_all_but_pure_are_pure():
    body = '<path d="M0 0H96V96H0z" fill="#fff"/><circle cx="40" cy="44" r="31" fill="#002b80"/>'
    text = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 96 96">{body}</svg>'
    levels = as_levels(as_picture(recoded(Document(text.encode(), "x", 96).draw()[..., :3], quality=70)).target())
    assert 0.0 < np.median(levels[30:60, 25:55, 0]) < 5.0
    assert {tuple(fill) for fill in restored(levels, condition_of(levels)).palette[:, [0, 3]]} == {(0, 255), (255, 255)}


def test_soft_shading_is_not_taken_for_ringing_which_goes_up_and_down():
    """Both are rough near edges; of the JPEG, reduced by half, no blocks are left."""
    relief = ndimage.gaussian_filter(np.random.default_rng(3).normal(size=(160, 160)), 2.0)
    shaded = np.full((160, 160), 245.0)
    shaded[20:140, 20:140] = 120.0 + 14.0 * (relief / relief.std())[20:140, 20:140]
    shaded[60:100:8, 30:130] = 245.0
    clean = np.repeat(np.clip(np.rint(shaded), 0, 255)[..., None], 3, axis=2).astype(np.uint8)
    assert not condition_of(as_levels(as_picture(clean).target())).jpeg
    flat = Image.new("RGB", (320, 240), "white")
    for k in range(12):
        ImageDraw.Draw(flat).ellipse([20 * k, 15 * k, 20 * k + 60, 15 * k + 50], fill=(20 * k, 90, 200 - 10 * k))
    small = np.asarray(Image.fromarray(recoded(np.asarray(flat), "JPEG", quality=60)).resize((160, 120)))
    assert condition_of(as_levels(as_picture(small).target())).jpeg
