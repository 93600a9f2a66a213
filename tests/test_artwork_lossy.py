"""Drawings from files that were compressed with loss, and say so."""

from __future__ import annotations

import io

import numpy as np
import pytest
from conftest import rest_slow
from image_files import encode
from PIL import Image, ImageDraw, ImageFilter, ImageFont
from scipy.ndimage import gaussian_filter

from cubicsplat_cli.api import vectorize
from cubicsplat_cli.artwork.gradients.flattening import Flattened
from cubicsplat_cli.artwork.input.chroma import LUMA_CHROMA, with_sharp_chroma
from cubicsplat_cli.artwork.input.prepare import PreparedInput, analysed, as_levels
from cubicsplat_cli.artwork.input.recompressed import before_compression
from cubicsplat_cli.artwork.input.restore import restored
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.decode import Compression
from cubicsplat_cli.files.load import as_picture, laid_over, load_picture, resize_picture
from cubicsplat_cli.raster import ndimage


def stripes() -> np.ndarray:
    """(100, 150, 3) uint8 of three level stripes, with edges within rows."""
    levels = np.empty((100, 150, 3))
    levels[:33], levels[33:66], levels[66:] = (30, 181, 58), (255, 255, 255), (0, 114, 198)
    levels[33], levels[66] = 0.6 * levels[32] + 0.4 * levels[34], 0.7 * levels[65] + 0.3 * levels[67]
    return np.rint(levels).astype(np.uint8)


def drawn(size: tuple[int, int]) -> np.ndarray:
    """(H, W, 3) uint8 of a ring and a bar, with smooth edges, on a ground that is hardly lighter."""
    large = Image.new("RGB", (8 * size[0], 8 * size[1]), (0, 143, 37))
    pen, (right, bottom) = ImageDraw.Draw(large), large.size
    pen.ellipse([83, 69, right - 150, bottom - 77], fill=(239, 45, 41))
    pen.ellipse([210, 190, right - 290, bottom - 205], fill=(250, 240, 200))
    pen.rectangle([0, bottom // 2 + 3, right, bottom // 2 + 43], fill=(60, 40, 160))
    return np.asarray(large.resize(size, Image.Resampling.BOX))


def lossy(image, kind: str = "JPEG", **options: int) -> tuple[np.ndarray, PreparedInput]:
    """What is drawn of an image that was stored with loss, and what its analysis tells."""
    image = image if isinstance(image, Image.Image) else Image.fromarray(image)
    picture = load_picture(encode(image, kind, **options))
    return picture.target(), analysed(picture.target(), picture.compression)


def test_a_file_says_whether_it_was_compressed_with_loss():
    image = Image.fromarray(stripes())
    clear = Image.fromarray(np.dstack([stripes(), stripes()[..., 0]]))
    files = encode(image, "JPEG"), encode(image, "WEBP"), encode(clear, "WEBP")
    assert all(load_picture(file).compression.known for file in files)
    lossless = encode(image, "WEBP", lossless=True), encode(clear, "WEBP", lossless=True), encode(image)
    assert all(load_picture(file).compression is None for file in lossless)
    with Image.open(io.BytesIO(files[0])) as opened:
        assert as_picture(opened).compression == load_picture(files[0]).compression
    assert as_picture(stripes()).compression is resize_picture(load_picture(files[0]), 50).compression is None
    on_white = laid_over(load_picture(files[2]), (1.0, 1.0, 1.0))
    assert on_white.compression is not None and not on_white.compression.known


@pytest.mark.parametrize("sampling", [0, 1, 2])
def test_a_picture_is_compressed_again_as_its_file_was(sampling):
    image = Image.fromarray(drawn((211, 93)))
    read = load_picture(encode(image, "JPEG", quality=73, subsampling=sampling))
    again = read.compression.again(as_levels(as_picture(image).target()))
    assert np.array_equal(again[..., :3], np.rint(255.0 * read.rgb)) and (again[..., 3] == 255.0).all()
    assert np.array_equal(read.compression.again(as_levels(as_picture(image).target())[..., :3]), again[..., :3])


@pytest.mark.parametrize("clear", [False, True])
@pytest.mark.parametrize("quality", [50, 75, 90])
def test_a_webp_is_compressed_again_about_as_it_was(quality, clear):
    pixels = drawn((211, 93))
    if clear:
        pixels = np.dstack([pixels, np.tile(np.clip(np.arange(211) * 9, 0, 255), (93, 1)).astype(np.uint8)])
    read = load_picture(encode(Image.fromarray(pixels), "WEBP", quality=quality))
    assert abs(read.compression.quality - quality) <= 10
    levels, file = (as_levels(each.target()) for each in (as_picture(pixels), read))
    again = read.compression.again(levels)
    assert np.std(again - file) < 0.7 * np.std(levels - file)
    assert np.allclose(again[..., 3], file[..., 3], atol=0.01)


def test_a_file_says_nothing_of_pixels_that_were_turned_nor_of_other_channels():
    turned, image = Image.Exif(), Image.fromarray(drawn((80, 64)))
    turned[0x0112] = 6
    files = [encode(image, "JPEG", exif=turned), *(encode(image.convert(mode), "JPEG") for mode in ("L", "CMYK"))]
    assert [load_picture(file).compression for file in files] == [Compression()] * 3


@pytest.mark.parametrize(("file_format", "options", "share"), [("JPEG", {"subsampling": 2}, 0.7), ("WEBP", {}, 0.8)])
def test_a_drawing_is_nearer_to_what_was_compressed_than_the_file_is(file_format, options, share):
    levels = drawn((200, 160))
    _, prepared = lossy(levels, file_format, quality=60, **options)
    even = restored(prepared.levels, prepared.condition)
    assert prepared.compression is not None
    after, seen = before_compression(
        prepared.levels, Flattened(prepared.levels), even, prepared.condition, prepared.compression
    )
    error, before, asked, left = (
        float(np.sqrt(((found[..., :3] - levels) ** 2).mean()))
        for found in (prepared.levels, even.levels, seen, after.levels)
    )
    assert asked < share * error and left < 0.9 * before


def test_a_sticker_has_the_shapes_of_what_was_compressed():
    """A WebP with loss and transparency, whose artefacts looked like shading: it had 200 shapes."""
    y, x = np.mgrid[:220, :220]
    far = np.hypot(x - 110.2, y - 109.6)
    inner, outer = (np.clip(radius - far, 0.0, 1.0)[..., None] for radius in (70.0, 100.0))
    colours = np.where(y[..., None] < 90, [250, 90, 60], [40, 120, 230]) * inner + (1.0 - inner) * [255, 205, 60]
    sticker = Image.fromarray(np.rint(np.dstack([colours, 255.0 * outer])).astype(np.uint8))
    done = vectorize(sticker, measure=False), vectorize(encode(sticker, "WEBP", quality=70), measure=False)
    assert [each.report.shapes for each in done] == [3, 3]


def test_level_stripes_of_a_jpeg_are_drawn_without_its_ringing():
    """They have as few colours as a GIF, and coefficients along columns alone."""
    assert lossy(stripes(), quality=80)[1].condition.jpeg
    file = encode(Image.fromarray(stripes()), "JPEG", quality=80)
    assert vectorize(file, measure=False).report.shapes == 3


def test_a_file_without_a_trace_of_loss_is_clean():
    levels = np.full((64, 64, 3), 240, np.uint8)
    levels[16:48, 16:48] = (80, 80, 80)  # whole blocks
    assert lossy(levels, quality=95)[1].condition.clean


def test_a_jpeg_of_few_rows_is_known_as_one():
    assert lossy(drawn((64, 64))[26:38])[1].condition.jpeg


@pytest.mark.parametrize(("width", "height"), [(12, 40), (8, 8), (3, 40), (1, 1)])
def test_a_jpeg_of_few_pixels_is_drawn(width, height):
    target, prepared = lossy(drawn((64, 80))[26 : 26 + height, 5 : 5 + width])
    drawing = draw(target, prepared=prepared)
    assert drawing.shapes and (drawing.width, drawing.height) == (width, height)


@pytest.mark.parametrize("red", rest_slow(253, 2))
def test_a_gradient_of_a_jpeg_that_has_nearly_all_or_nothing_of_a_channel_is_one(red):
    levels = np.full((160, 160, 3), 255, np.uint8)
    levels[20:140, 20:140] = [[(red, 230 - y, 60) for x in range(120)] for y in range(120)]
    assert len(draw(lossy(levels, quality=90)[0]).gradients) == 1


@pytest.mark.parametrize("quality", [85, 90])
def test_lines_hardly_wider_than_a_pixel_keep_their_colour(quality):
    large = Image.new("RGB", (800, 1200), "white")
    pen = ImageDraw.Draw(large)
    for k in range(5):
        y = 80 + 220 * k
        pen.line([(60, y + 130), (500, y), (60, y - 130)], fill="#70ad47" if k < 2 else "#7f7f7f", width=5)
        pen.rectangle([600, y, 720, y + 40], fill="black")
        for below in (60, 100):
            pen.line([(560, y + below), (780, y + below)], fill="black", width=8)
    made = draw(lossy(large.resize((200, 300), Image.Resampling.BOX), quality=quality)[0])
    assert np.abs(np.array(made.fills)[:, :3] - (0x70, 0xAD, 0x47)).max(axis=1).min() <= 16


@pytest.mark.parametrize("blur", rest_slow(1.2, 2.0))
def test_a_blurred_jpeg_has_the_shapes_of_the_sharp_picture(blur):
    """What a blur makes of pixels beside edges is no fill."""
    large = Image.new("RGB", (800, 640), "white")
    pen = ImageDraw.Draw(large)
    pen.ellipse([80, 80, 400, 400], outline="#192b6f", width=40)
    pen.polygon([(480, 560), (720, 480), (560, 120)], fill="#d62728", outline="#192b6f", width=36)
    small = large.resize((400, 320), Image.Resampling.BOX)
    made = [draw(lossy(image, quality=75)[0]) for image in (small, small.filter(ImageFilter.GaussianBlur(blur)))]
    assert len(made[1].shapes) == len(made[0].shapes) and len(made[1].fills) == len(made[0].fills) == 3


def test_parts_of_near_fills_have_each_its_own():
    """Their pixels do not tell them apart."""
    first, second = (216, 205, 201), (210, 199, 195)
    large = Image.new("RGB", (8 * 200, 8 * 160), "white")
    pen = ImageDraw.Draw(large)
    pen.ellipse([100, 100, 900, 900], fill=first)
    for k in range(2):
        pen.polygon([(1000 + 220 * k, y) for y in (100, 700)] + [(1115 + 220 * k, y) for y in (900, 300)], fill=second)
    target, prepared = lossy(large.resize((200, 160), Image.Resampling.BOX), quality=80, subsampling=2)
    even = restored(prepared.levels, prepared.condition)
    assert even.palette is not None and len(even.palette) == 2
    drawing = draw(target, prepared=prepared)
    assert len(drawing.shapes) == 4 and not drawing.gradients
    found = np.array(drawing.fills)[1:, :3]
    assert np.abs(found[np.argsort(-found[:, 0])] - [first, second]).max() <= 1


EAR = (250, 192, 194)
EARS = (105, 27, 131, 45), (127, 52, 153, 68), (113, 4, 137, 20)


def painted(grain: float, quality: int) -> bytes:
    """A JPEG of 160 x 160 px: ovals in black outlines, some as large as ears, with grain of so many levels."""
    parts = [((8, 10, 96, 110), (252, 215, 218)), ((16, 90, 96, 150), (244, 160, 167))]
    parts += [((84, 70, 152, 150), (209, 206, 193)), *((box, EAR) for box in EARS)]
    large = Image.new("RGB", (640, 640), "white")
    for box, fill in parts:
        ImageDraw.Draw(large).ellipse([4 * side for side in box], fill=fill, outline=(20, 16, 16), width=8)
    levels = np.asarray(large.resize((160, 160), Image.Resampling.LANCZOS)).astype(float)
    soft = gaussian_filter(np.random.default_rng(2).standard_normal((160, 160)), 1.5)
    inside = (levels.min(axis=2) > 120) & (levels.min(axis=2) < 240)
    levels += np.where(inside, grain * soft / soft.std(), 0.0)[..., None]
    return encode(Image.fromarray(np.rint(levels.clip(0.0, 255.0)).astype(np.uint8)), "JPEG", quality=quality)


def test_small_painted_parts_keep_their_colour_amid_likely_others():
    """Grain hides that the colour of three small parts, which three other fills are near, is a fill of its own."""
    result = vectorize(painted(6.0, 84), style="artwork", threads=1)
    seen = rerender(result.svg.encode(), 160, 160).pixels[..., :3]
    for left, top, right, bottom in EARS:
        assert np.abs(seen[(top + bottom) // 2, (left + right) // 2] - np.array(EAR, float)).max() <= 6.0


@pytest.mark.parametrize(("grain", "quality", "most"), [(0.0, 60, 11), (0.0, 84, 11), (10.0, 84, 28)])
def test_black_outlines_and_painted_parts_are_no_patchwork_of_near_fills(grain, quality, most):
    assert vectorize(painted(grain, quality), style="artwork", threads=1, measure=False).report.shapes <= most


def test_a_colour_of_three_digits_comes_back_from_what_it_is_rounded_to():
    image = Image.new("RGB", (128, 128), (255, 255, 255))
    ImageDraw.Draw(image).rectangle([22, 21, 99, 97], fill=(34, 102, 153))
    target, prepared = lossy(image, quality=80)
    assert (255.0 * target[60, 60]).round().tolist() == [34, 101, 153]
    assert (34, 102, 153, 255) in draw(target, prepared=prepared).fills


def page(*inks: tuple[int, int, int]) -> np.ndarray:
    """(120, 290, 3) uint8 of text of 13 px, in two inks on white."""
    image, font = Image.new("RGB", (290, 120), (255, 255, 255)), ImageFont.load_default(13)
    pen = ImageDraw.Draw(image)
    for row, line in enumerate(
        ["File.txt, v1.0.2: 12:45 - 13:30.", "Yes... No: dots i, j, i. Fin.", "Mild fijis: 1.5 - 2.5. It is."]
    ):
        for half, ink in enumerate(inks):
            pen.text((12, 8 + 18 * (2 * row + half)), line, font=font, fill=ink)
    return np.asarray(image)


@pytest.mark.slow
def test_text_of_two_inks_keeps_its_small_marks_and_its_inks():
    clean = page((0, 0, 0), (0, 0, 238))
    _, prepared = lossy(clean, quality=80, subsampling=2)
    assert prepared.compression is not None and prepared.condition.halved == (0, 1)
    even = restored(prepared.levels, prepared.condition)
    after, _ = before_compression(
        prepared.levels, Flattened(prepared.levels), even, prepared.condition, prepared.compression
    )
    dark, found = (255.0 - each[..., :3].astype(float) @ LUMA_CHROMA[:3, 0] for each in (clean, after.levels))
    parts, count = ndimage.label(dark > 64.0, ndimage.SQUARE)
    weights = np.stack([np.bincount(parts.ravel(), each.ravel(), count + 1) for each in (dark, found)])
    small = np.bincount(parts.ravel()) <= 14  # px of a full stop, a dot or a dash
    assert small.sum() > 60 and (weights[1, small] > 0.5 * weights[0, small]).all()
    assert even.palette is not None and len(even.palette) == 3
    blue = even.palette[even.palette[:, 2].argsort()][1]
    assert blue[2] > 120.0 and blue[:2].max() < 40.0


@pytest.mark.parametrize("sampling", rest_slow(2, 0, 1))
def test_the_inks_of_text_come_back_whatever_size_its_chroma_was_stored_at(sampling):
    """Taken for halved, chroma that is not has a red of 239."""
    _, prepared = lossy(page((34, 34, 34), (187, 0, 0)), quality=92, subsampling=sampling)
    assert prepared.condition.halved == ((), (1,), (0, 1))[sampling]
    palette = restored(prepared.levels, prepared.condition).palette
    assert palette is not None and len(palette) == 3
    assert np.abs(palette[palette[:, 1].argsort(), :3] - [[187, 0, 0], [34, 34, 34], [255, 255, 255]]).max() <= 8.0


@pytest.mark.parametrize(("kind", "quality"), rest_slow(("JPEG", 80), ("WEBP", 80), ("JPEG", 92)))
def test_thin_black_lines_on_a_strong_colour_are_black(kind, quality):
    """Chroma of half the size is too blue for them, so red ends at 0, and the rest looks like a dark red."""
    large = Image.new("RGB", (8 * 260, 8 * 180), "white")
    pen = ImageDraw.Draw(large)
    pen.ellipse([60, 60, 2020, 1380], fill=(0, 164, 216), outline="black", width=22)
    for k in range(18):
        pen.line([300 + 70 * k, 500 + 6 * k, 360 + 72 * k, 900], fill="black", width=7 + k % 3)
    _, prepared = lossy(large.resize((260, 180), Image.Resampling.BOX), kind, quality=quality)
    palette = restored(prepared.levels, prepared.condition).palette
    dark = palette[palette[:, :3].max(axis=1) < 128.0]
    assert len(dark) == 1 and dark[0, :3].max() <= 12.0


def test_what_lies_between_a_grey_and_thin_black_marks_is_no_other_fill():
    """In luma an orange lies between the two, and nothing of the marks fills 3 x 3 px."""
    large = Image.new("RGB", (8 * 260, 8 * 160), (152, 149, 152))
    pen = ImageDraw.Draw(large)
    pen.rectangle([0, 0, 8 * 260, 8 * 40], fill=(180, 83, 50))
    pen.rectangle([100, 60, 400, 200], fill="black")
    for k in range(40):
        pen.line([150 + 45 * k, 420 + 40 * (k % 7), 165 + 47 * k, 470 + 40 * (k % 7)], fill="black", width=11)
        pen.line([150 + 45 * k, 820 + 30 * (k % 5), 190 + 45 * k, 825 + 30 * (k % 5)], fill="black", width=9)
    _, prepared = lossy(large.resize((260, 160), Image.Resampling.BOX), "WEBP", quality=80)
    even = restored(prepared.levels, prepared.condition)
    orange = np.abs(even.palette[:, :3] - [180.0, 83.0, 50.0]).max(axis=1).argmin()
    assert (even.labels[46:] == orange).sum() <= 4


def test_thin_marks_keep_their_fill_though_it_lies_between_two_fills_elsewhere():
    """Of teal and purple, which are far from all grey marks, a blend is the same grey."""
    large = Image.new("RGB", (8 * 200, 8 * 120), (247, 243, 232))
    pen = ImageDraw.Draw(large)
    pen.rectangle([0, 0, 1600, 160], fill=(42, 157, 142))
    pen.rectangle([0, 760, 1600, 960], fill=(133, 41, 80))
    for k in range(36):
        top = 260 + 40 * (k % 7)
        pen.line([60 + 42 * k, top, 75 + 42 * k, top + 60], fill=(102, 102, 102), width=11)
    _, prepared = lossy(large.resize((200, 120), Image.Resampling.BOX), quality=80)
    palette = restored(prepared.levels, prepared.condition).palette
    assert len(palette) == 4 and np.abs(palette[3, :3] - 102.0).max() <= 16.0


def test_chroma_of_half_the_size_becomes_nearly_as_sharp_as_luma():
    clean = page((0, 0, 0), (0, 0, 238))
    read = load_picture(encode(Image.fromarray(clean), "JPEG", quality=80, subsampling=2)).rgb * np.float32(255.0)
    truth, seen = (np.pad(each.astype(np.float32), ((0, 0), (0, 0), (0, 1))) @ LUMA_CHROMA for each in (clean, read))
    sharp = with_sharp_chroma(seen.astype(np.float32), (0, 1))
    before, after = (float(np.sqrt(((each - truth)[..., 1:3] ** 2).mean())) for each in (seen, sharp))
    assert after < 0.7 * before
    assert np.array_equal(sharp[..., [0, 3]], seen.astype(np.float32)[..., [0, 3]])
