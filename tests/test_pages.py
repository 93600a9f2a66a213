"""Pages: photographs within drawings, as groups of curves or as embedded images."""

from __future__ import annotations

import base64
import re

import numpy as np
import pytest
from conftest import ctrl_c_when
from image_files import encode, png_of, recoded
from PIL import Image
from scans import target_of
from test_svg_viewers import AGREEMENT_DB

from benchmarks.artwork.pixels import psnr
from cubicsplat_cli import vectorize
from cubicsplat_cli.artwork.finish.state import goal_of
from cubicsplat_cli.artwork.photo_parts import Page, PhotoPart, page_of
from cubicsplat_cli.artwork.structure import boxes_of
from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.evaluate.images import of_scene
from cubicsplat_cli.evaluate.rerender import rerender, rerender_untrusted
from cubicsplat_cli.export.formats import exported
from cubicsplat_cli.files.load import as_picture
from cubicsplat_cli.from_options import request_of
from cubicsplat_cli.html_report.embed import shown_elements
from cubicsplat_cli.pipeline.pages import SAMPLE, _sample, page_in
from cubicsplat_cli.pipeline.vectorize import task_of
from cubicsplat_cli.progress import StageTimer
from cubicsplat_cli.scene import EmbeddedImage, LayeredScene
from cubicsplat_cli.svg.drawing_reader import read_drawing
from cubicsplat_cli.svg.drawing_writer import write_drawing
from cubicsplat_cli.svg.values import picture_in, uri_of

WIDTH, HEIGHT = 300, 200
LEFT, TOP, RIGHT, BOTTOM = 24, 60, 144, 160  # of the photo
QUICK = {"preset": "draft", "curves": 60, "threads": 1}


def photo(width: int, height: int) -> np.ndarray:
    """(height, width, 3) uint8: part of the sample photo."""
    with Image.open("samples/chelsea.png") as image:
        return np.asarray(image.convert("RGB"))[60 : 60 + height, 100 : 100 + width]


def page(box: tuple[int, int, int, int] = (LEFT, TOP, RIGHT, BOTTOM), frame: bool = True) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) uint8: a head, bars like lines of text, and a photo in a box, in a frame of 2 px."""
    out = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    out[:36] = 35, 95, 140
    out[12:24, 20:120] = 255
    for row in range(60, 160, 14):
        for left in range(168, 270, 30):
            out[row : row + 6, left : left + 22] = 50, 60, 70
    left, top, right, bottom = box
    if frame:
        out[max(0, top - 2) : bottom + 2, max(0, left - 2) : right + 2] = 60, 60, 60
    out[top:bottom, left:right] = photo(right - left, bottom - top)
    return out


def found_page(target: np.ndarray) -> Page | None:
    return page_of(target, lambda _picture, _part: True)


def photos_in(pixels: np.ndarray) -> list[tuple[int, int, int, int]]:
    """Left, top, right and bottom of the photographs of a page."""
    found = found_page(target_of(pixels))
    windows = [part.window for part in found.parts] if found else []
    return [(columns.start, rows.start, columns.stop, rows.stop) for rows, columns in windows]


def drawn(svg: str) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) levels of a page as cairosvg draws it."""
    return rerender(svg.encode(), WIDTH, HEIGHT).pixels[..., :3].astype(float)


def level(off: np.ndarray) -> float:
    """PSNR of differences in levels, dB."""
    return float(10.0 * np.log10(255.0**2 / np.square(off).mean()))


@pytest.fixture(scope="module")
def fitted():
    return vectorize(page(), **QUICK)


@pytest.fixture(scope="module")
def embedded():
    return vectorize(page(), photo_parts="image", **QUICK)


def test_a_photo_in_a_frame_is_found_to_the_pixel():
    found = found_page(target_of(page()))
    assert photos_in(page()) == [(LEFT, TOP, RIGHT, BOTTOM)]
    assert found.parts[0].rectangular
    assert len(np.unique(found.flat[TOP:BOTTOM, LEFT:RIGHT].reshape(-1, 3), axis=0)) == 1
    assert np.array_equal(found.flat[:TOP], target_of(page())[:TOP])


def with_clear_margin(pixels: np.ndarray) -> np.ndarray:
    """(HEIGHT, WIDTH, 4) uint8: a page that ends in the rounded corners of a window, 8 px from the picture's edges."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    across, down = (np.abs(at - size / 2) - size / 2 + 18 for at, size in ((x, WIDTH), (y, HEIGHT)))
    inside = np.clip(10.5 - np.hypot(np.maximum(across, 0), np.maximum(down, 0)), 0.0, 1.0)
    return np.dstack([pixels, np.rint(255 * inside).astype(np.uint8)])


def test_a_photo_in_a_window_with_clear_corners_is_found_and_the_corners_stay_clear():
    pixels = with_clear_margin(page())
    pixels[TOP + 40 : TOP + 44, LEFT + 40 : LEFT + 60, 3] = 254  # as palettes round opaque pixels
    premultiplied = as_picture(pixels).target()
    found = found_page(premultiplied)
    (part,) = found.parts
    assert part.window == (slice(TOP, BOTTOM), slice(LEFT, RIGHT))
    assert np.abs(found.flat[:TOP] - premultiplied[:TOP]).max() < 2e-3
    assert np.array_equal(found.flat[:TOP, :, 3], premultiplied[:TOP, :, 3]) and np.all(
        found.flat[part.window][..., 3] == 1
    )
    result = vectorize(pixels, **QUICK)
    assert [shape.name for shape in read_drawing(result.svg).shapes if shape.shading is not None] == ["photo"]
    seen = rerender(result.svg.encode(), WIDTH, HEIGHT).pixels
    assert np.abs(seen[..., 3].astype(float) - pixels[..., 3]).mean() < 0.2 and np.all(seen[part.window][..., 3] == 255)
    assert np.array_equal(seen[TOP:BOTTOM, 168:270], pixels[TOP:BOTTOM, 168:270])


def test_a_photo_that_is_partly_clear_is_none_of_a_page():
    pixels = with_clear_margin(page())
    pixels[TOP + 40 : TOP + 44, LEFT + 40 : LEFT + 60, 3] = 100
    assert found_page(as_picture(pixels).target()) is None


def test_photos_at_the_edges_of_the_picture_are_found():
    assert photos_in(page((0, 90, 130, HEIGHT), frame=False)) == [(0, 90, 130, HEIGHT)]


def test_a_jpeg_of_a_page_ends_its_photo_at_the_strongest_steps():
    ((left, top, right, bottom),) = photos_in(recoded(page(frame=False), quality=85))
    assert np.abs(np.array([left, top, right, bottom]) - (LEFT, TOP, RIGHT, BOTTOM)).max() <= 1


def round_photo() -> np.ndarray:
    """A page whose photo is a disc."""
    pixels = page((20, 50, 130, 160), frame=False)
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    pixels[(np.hypot(x - 75, y - 105) > 54) & (x < 140) & (y > 40)] = 255
    return pixels


def test_a_round_photo_keeps_its_form():
    found = found_page(target_of(round_photo()))
    (part,) = found.parts
    assert not part.rectangular
    assert part.size == pytest.approx(np.pi * 54**2, rel=0.05)


@pytest.mark.slow
def test_a_round_photo_is_clipped_to_its_form():
    pixels = round_photo()
    result = vectorize(pixels, **QUICK)
    shape = next(shape for shape in read_drawing(result.svg).shapes if shape.shading is not None)
    assert shape.name == "photo"
    assert np.abs((drawn(result.svg) - pixels)[:, 140:]).max() <= 1.0


def test_a_photo_with_round_ends_is_clipped_to_them_and_not_drawn_as_a_thick_stroke():
    pixels = page((20, 30, 80, 190), frame=False)
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    beyond = np.hypot(x - 50, y - np.clip(y, 60, 160)) > 30
    pixels[beyond & ((x < 140) | (y < 40)) & (y > 20)] = 255
    result = vectorize(pixels, style="artwork", photo_parts="image", preset="draft", curves=12, threads=1)
    (shape,) = (shape for shape in read_drawing(result.svg).shapes if shape.shading is not None)
    assert shape.stroke is None
    assert level((drawn(result.svg) - pixels)[30:190, 20:80]) > 25.0


def test_a_small_photo_on_a_card_with_a_soft_shadow_is_found():
    pixels = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    off = np.hypot(np.maximum(np.abs(x - 150) - 90, 0), np.maximum(np.abs(y - 100) - 50, 0))
    pixels[:] = np.rint(255.0 - 120.0 * np.exp(-((off / 14.0) ** 2)))[..., None]
    pixels[50:150, 60:240] = 255
    pixels[70:76, 140:220] = pixels[90:96, 140:200] = 40
    pixels[70:118, 76:124] = photo(48, 48)
    assert photos_in(pixels) == [(76, 70, 124, 118)]


def test_a_round_portrait_of_few_pixels_is_a_photo_and_a_round_drawing_is_none():
    """Neighbouring pixels of both differ as in drawings."""
    side, y, x = 44, *(np.mgrid[:44, :44] + 0.5 - 22)
    with Image.open("samples/astronaut.jpg") as image:
        face = image.convert("RGB").crop((60, 0, 460, 400)).resize((side, side), Image.Resampling.LANCZOS)
    sign = np.where((np.abs(x) < 4) | (np.abs(y) < 4), 250, np.where(x * y > 0, 60, 160))[..., None]
    pixels = np.full((120, 200, 3), 255, np.uint8)
    pixels[:20] = 35, 95, 140
    for row in (30, 38, 76, 84):
        pixels[row : row + 4, 70:180] = 50, 60, 70
    inside = np.hypot(x, y) < 21.5
    for top, what in ((24, np.asarray(face)), (70, np.broadcast_to(sign, (side, side, 3)))):
        pixels[top : top + side, 12 : 12 + side][inside] = what[inside]
    result = vectorize(pixels, **QUICK)
    (one,) = (shape for shape in read_drawing(result.svg).shapes if shape.shading is not None)
    (box,) = boxes_of([one])
    assert np.abs(box - (12, 24, 56, 68)).max() < 2
    off = np.abs(rerender(result.svg.encode(), 200, 120).pixels[..., :3].astype(float) - pixels)
    assert off[24:68, 12:56].mean() < 10
    assert off[70:].mean() < 1


def test_soft_shading_within_an_outline_is_no_photo(monkeypatch):
    pixels = page((20, 50, 130, 160), frame=False)
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    waves = [np.sin(x / 9.0 + y / 13.0), np.cos(x / 11.0 - y / 8.0), np.sin(y / 6.0) * np.cos(x / 7.0)]
    shaded = np.rint(140.0 + 70.0 * np.stack(waves, axis=2)).astype(np.uint8)
    inside = np.hypot(x - 75, y - 105) < 54
    pixels[50:160, 20:140] = 255
    pixels[inside] = shaded[inside]
    assert found_page(target_of(pixels)) is None
    monkeypatch.setattr("cubicsplat_cli.artwork.photo_parts.GRAINY", 0.0)
    monkeypatch.setattr("cubicsplat_cli.artwork.photo_parts.RINGING", 0.0)
    assert found_page(target_of(pixels)) is not None


def test_ringing_around_the_edges_of_a_gradient_is_no_photo(monkeypatch):
    y, x = np.mgrid[:160, :160] + 0.5
    pixels = np.full((160, 160, 3), 255.0)
    pixels[:20] = 35, 95, 140
    far = np.hypot(x - 70, y - 75) / 62.0
    ball = np.stack([np.interp(far, [0, 1], ends) for ends in ((250, 60), (230, 20), (120, 100))], axis=2)
    off = np.hypot(x - 80, y - 90)
    for cover, fill in ((48.5 - off, ball), (2.5 - np.abs(off - 26.4), 255.0)):
        pixels += np.clip(cover, 0.0, 1.0)[..., None] * (fill - pixels)
    lossy = recoded(np.rint(pixels).astype(np.uint8), quality=80)
    assert found_page(target_of(lossy)) is None
    monkeypatch.setattr("cubicsplat_cli.artwork.photo_parts.RINGING", 0.0)
    assert found_page(target_of(lossy)) is not None


def test_two_photos_are_two_parts():
    pixels = page(frame=False)
    pixels[60:160, 168:290] = 255
    pixels[70:170, 180:290] = photo(110, 100)[:, ::-1]
    assert sorted(photos_in(pixels)) == [(LEFT, TOP, RIGHT, BOTTOM), (180, 70, 290, 170)]
    first, second = found_page(target_of(pixels)).parts
    assert (first.stand_in != second.stand_in).any()


def test_drawings_photos_and_text_have_no_part():
    plain = page()
    plain[TOP:BOTTOM, LEFT:RIGHT] = 200, 30, 30
    assert found_page(target_of(plain)) is None
    assert found_page(target_of(photo(WIDTH, HEIGHT))) is None
    text = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    rng = np.random.default_rng(0)
    for row in range(8, HEIGHT - 16, 12):
        for left in range(8, WIDTH - 16, 7):
            text[row : row + 8, left : left + 5] = np.where(rng.random((8, 5, 1)) < 0.5, 255, 30)
    assert found_page(target_of(recoded(text, quality=70))) is None
    small = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    small[20:40, 20:200] = photo(180, 20)
    assert found_page(target_of(small)) is None


def test_a_photo_with_even_margins_alone_stays_a_photo():
    pixels = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    pixels[30:170] = photo(WIDTH, 140)
    assert found_page(target_of(pixels)) is None


def test_a_page_is_a_drawing_with_its_photo_in_it(fitted):
    assert fitted.report.style == "artwork"
    assert fitted.report.shaded == ["photo"]
    box = f'x="{LEFT}" y="{TOP}" width="{RIGHT - LEFT}" height="{BOTTOM - TOP}"'
    assert f'<clipPath id="photo-outline"><rect {box}' in fitted.svg
    off = drawn(fitted.svg) - page()
    inside = np.zeros((HEIGHT, WIDTH), bool)
    inside[TOP:BOTTOM, LEFT:RIGHT] = True
    assert np.abs(off[~inside]).max() <= 1.0


@pytest.mark.slow
def test_a_photo_in_a_page_is_as_near_as_alone(fitted):
    off = drawn(fitted.svg) - page()
    alone = vectorize(np.ascontiguousarray(page()[TOP:BOTTOM, LEFT:RIGHT]), style="photo", **QUICK)
    assert level(off[TOP:BOTTOM, LEFT:RIGHT]) > alone.report.quality.svg.psnr_db - 0.5


def test_a_page_reads_back_and_the_engine_draws_it(fitted):
    assert write_drawing(read_drawing(fitted.svg), title="a", comment="b").count("<path") == fitted.svg.count("<path")
    assert isinstance(fitted.scene, LayeredScene)
    own = of_scene(fitted.scene, WIDTH, HEIGHT, 24, 1).rows(0, HEIGHT)
    assert psnr(np.rint(255.0 * own).astype(np.uint8), rerender(fitted.svg.encode(), WIDTH, HEIGHT).pixels) > 40.0


def test_none_keeps_photos_from_being_parts():
    given = as_picture(page())
    for how, found in (("curves", True), ("none", False)):
        task = task_of(given, request_of({"photo_parts": how, "style": "artwork"}), StageTimer())
        assert (page_in(task, lambda part: True) is not None) == found
        assert page_in(task, lambda part: False) is None


def test_an_image_is_embedded_and_read_and_drawn_by_all(embedded):
    assert embedded.svg.count("<image") == 1
    assert level(drawn(embedded.svg) - page()) > 40.0
    read = read_drawing(embedded.svg)
    (image,) = (shape.shading for shape in read.shapes if shape.shading is not None)
    assert isinstance(image, EmbeddedImage)
    assert (image.left, image.top, image.width, image.height) == (LEFT, TOP, RIGHT - LEFT, BOTTOM - TOP)
    assert "<image" in write_drawing(read, title="a", comment="b")
    pictures = [
        rerender_untrusted(embedded.svg.encode(), source="x.svg", renderer=name)[0].pixels
        for name in ("cairosvg", "resvg")
    ]
    assert psnr(*pictures) > AGREEMENT_DB
    own = of_scene(embedded.scene, WIDTH, HEIGHT, 24, 1).rows(0, HEIGHT)
    assert psnr(np.rint(255.0 * own).astype(np.uint8), pictures[0]) > 40.0
    half = of_scene(embedded.scene, WIDTH // 2, HEIGHT // 2, 24, 1).rows(0, HEIGHT // 2)
    assert half[50, 40, :3] == pytest.approx(own[100:102, 80:82, :3].mean(axis=(0, 1)), abs=0.1)


def test_other_formats_and_the_report_take_an_embedded_image(embedded):
    data = embedded.svg.encode()
    assert b"/Image" in exported(data, "pdf", "the SVG", tolerance=0.05)[0]
    _, notes = exported(data, "xml", "the SVG", tolerance=0.05)
    assert "1 shading" in " ".join(notes)
    page_shown = shown_elements(data, as_picture(page()), 1)
    assert "data:image/" in page_shown.markup


PNG = base64.b64encode(b"\x89PNG\r\n\x1a\n" + bytes(40)).decode()


def png(width: int, height: int) -> bytes:
    """A PNG whose header says it has so many pixels, and that has none."""
    return png_of(width, height, 1, 0, b"")


@pytest.mark.parametrize(
    "uri",
    [
        "photo.png",
        "file:///etc/hostname",
        "data:image/svg+xml;base64,PHN2Zy8+",
        f"data:image/png;charset=x;base64,{PNG}",
        f"data:image/png;base64,{PNG}",
        "data:image/png;base64,AAA",
        f"data:image/png;base64,{base64.b64encode(b'GIF89a' + bytes(30)).decode()}",
        uri_of(png(9000, 9000)),
        uri_of(png(30_000, 30_000)),
    ],
)
def test_other_references_are_no_pictures(uri):
    with pytest.raises(ValueError, match="image"):
        picture_in(uri)


def test_a_jpeg_that_a_renderer_may_take_for_an_svg_is_refused():
    file = encode(Image.new("RGB", (9, 9)), "JPEG", comment=b"<svg onload='x'/>")
    with pytest.raises(ValueError, match="plain PNG or JPEG"):
        picture_in(uri_of(file))


@pytest.mark.parametrize("name", ["cairosvg", "resvg"])
@pytest.mark.parametrize(
    "body",
    [
        '<image width="9" height="9"/>',
        '<pattern id="p"><image width="9" height="9" href="{uri}"/></pattern>',
        '<g id="g"><image width="9" height="9" href="{uri}"/></g><use href="#g"/>',
        '<image width="9" height="9" href="{uri}" xlink:href="file:///etc/hostname"/>',
        '<image width="9" height="9" href="{uri}"/>' * 3,
    ],
)
def test_images_that_are_drawn_often_or_are_too_large_are_refused(body, name):
    root = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" width="9" height="9">'
    svg = f"{root}{body.format(uri=uri_of(png(8000, 8000)))}</svg>"
    with pytest.raises(InputError, match="<image>"):
        rerender_untrusted(svg.encode(), source="x.svg", renderer=name)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (r'preserveAspectRatio="none"', ""),
        (r'data:image/(png|jpeg);base64,[^"]*', "file:///etc/hostname"),
        (r"(<image [^>]*>)", r"\1\1"),
        (r' (x="\d+" y="\d+" )width="\d+"( height="\d+" preserve)', r' \1width="0"\2'),
    ],
)
def test_what_is_no_image_of_ours_is_refused(embedded, old, new):
    assert re.search(old, embedded.svg)
    with pytest.raises(InputError, match="line"):
        read_drawing(re.sub(old, new, embedded.svg))


@pytest.mark.parametrize(
    "options",
    [
        {"style": "photo"},
        {"style": "pixel"},
        {"fill": "linear"},
        {"colors": 4},
        {"stacking": "cutout"},
        {"mode": "open"},
        {"max_bytes": 9000},
        {"time_limit": 9},
    ],
)
def test_images_do_not_go_with_what_has_none(options):
    with pytest.raises(UsageError, match="leave out"):
        request_of({"photo_parts": "image", **options})
    assert not request_of(options).may_hold_photos


def test_photo_parts_takes_three_words():
    with pytest.raises(UsageError, match="curves, image"):
        request_of({"photo_parts": "all"})


def test_an_interrupt_leaves_the_photo_in_its_mean_colour(monkeypatch):
    stop = ctrl_c_when(lambda target, *_: target.shape[1] > 2 * SAMPLE)  # the page, of which samples are drawn before
    monkeypatch.setattr("cubicsplat_cli.artwork.vectorize.goal_of", lambda *given: stop(*given) or goal_of(*given))
    made = vectorize(page(), style="artwork", measure=False, **QUICK)
    assert made.report.interrupted
    off = np.abs(drawn(made.svg)[100, 80] - page()[TOP:BOTTOM, LEFT:RIGHT].mean(axis=(0, 1)))
    assert off.max() < 3.0


def test_the_sample_of_a_part_has_its_most_change_and_whole_blocks():
    picture = np.zeros((300, 400, 3), np.float32)
    picture[150:210, 200:260] = np.random.default_rng(0).random((60, 60, 3))
    part = PhotoPart(21, 10, np.ones((269, 380), dtype=bool), np.zeros(3))
    rows, columns = _sample(picture, part)
    assert rows.start % 16 == columns.start % 16 == 0
    assert rows.start <= 156 and rows.stop >= 204 and columns.start <= 206 and columns.stop >= 254
    assert max(rows.stop - rows.start, columns.stop - columns.start) < 64 + 16
    # What lies in front of a part, such as a menu, is none of it.
    part.mask[150 - 21 : 210 - 21, 200 - 10 : 260 - 10] = False
    picture[240:280, 40:80] = 0.1 * np.random.default_rng(1).random((40, 40, 3))
    rows, columns = _sample(picture, part)
    assert rows.stop > 260 and columns.start < 60
