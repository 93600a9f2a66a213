"""Flat clips: shapes that stand still or move as a whole are one shape, the others are shown in their frames."""

from __future__ import annotations

import io
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from command import run_here
from PIL import Image, ImageDraw

import cubicsplat_cli
from cubicsplat_cli.artwork.geometry.outlines import Circle, Rectangle
from cubicsplat_cli.artwork.moving import SAME_PX, moving_drawing
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.svg.moving_file import still, write_moving_drawing

WIDTH, HEIGHT = 80, 60
GROUND = Rectangle(0.0, 0.0, WIDTH, HEIGHT)


def shape(fill: tuple[int, int, int], outline) -> Shape:
    return Shape((*fill, 255), (outline,), "shape")


def drawing(*shapes: Shape) -> Drawing:
    return Drawing(WIDTH, HEIGHT, (shape((220, 230, 240), GROUND), *shapes))


def ball(x: float, y: float = 30.0, r: float = 8.0, fill=(200, 30, 60)) -> Shape:
    return shape(fill, Circle(x, y, r))


BOX = shape((40, 80, 160), Rectangle(50.0, 10.0, 20.0, 12.0, angle=0.5))


def moves_of(drawings: list[Drawing]):
    return moving_drawing(iter(drawings))


def test_what_stands_still_and_what_moves_is_one_shape():
    moving = moves_of([drawing(BOX, ball(20 + 5 * index)) for index in range(4)])
    assert len(moving.drawing.shapes) == 3 and moving.shown.all()
    np.testing.assert_allclose(moving.offsets[:, -1], [[0, 0], [5, 0], [10, 0], [15, 0]])
    assert not moving.offsets[:, :-1].any()


@pytest.mark.parametrize(
    ("second", "same"),
    [
        (ball(20.2), True), (ball(20, fill=(203, 33, 57)), True), (ball(20, r=8.2), True),
        (ball(20, fill=(200, 30, 90)), False), (ball(20, r=9), False),
        (shape((200, 30, 60), Rectangle(12.0, 22.0, 16.0, 16.0)), False),
    ],
)  # fmt: skip
def test_shapes_are_the_same_within_what_edges_and_colours_show(second, same):
    moving = moves_of([drawing(ball(20)), drawing(second)])
    assert (len(moving.drawing.shapes) == 2) == same
    # The noise of a fit is no motion.
    assert not moving.offsets.any() and SAME_PX < 1


def test_a_shape_that_comes_back_is_the_same():
    moving = moves_of([drawing(BOX), drawing(), drawing(BOX)])
    assert moving.shown.tolist() == [[True, True], [True, False], [True, True]]


def test_shapes_that_change_their_order_are_not_taken_for_the_same():
    moving = moves_of([drawing(BOX, ball(20)), drawing(ball(20), BOX)])
    assert len(moving.drawing.shapes) == 4
    # In each frame they are drawn in its own order.
    names = [[moving.drawing.shapes[s].fill for s in np.flatnonzero(row)] for row in moving.shown]
    assert [row[1:] for row in names] == [[BOX.fill, ball(20).fill], [ball(20).fill, BOX.fill]]


@pytest.mark.parametrize(("width", "same"), [(34.0, True), (18.0, False)])
def test_a_shape_that_differs_beneath_others_only_is_the_same(width, same):
    cover = shape((20, 120, 60), Rectangle(30.0, 0.0, 20.0, 60.0))  # over what reaches 30 to 50 px
    beneath = [shape((200, 30, 60), Rectangle(10.0, 20.0, size, 15.0)) for size in (30.0, width)]
    moving = moves_of([drawing(each, cover) for each in beneath])
    assert (len(moving.drawing.shapes) == 3) == same  # one that ends before the cover shows


def made(count: int = 4) -> tuple[str, list[Drawing], np.ndarray]:
    """A box at an angle that moves and blinks beneath a ball that moves."""
    drawings = []
    for index in range(count):
        moved = shape((40, 80, 160), Rectangle(50.0, 10.0 + 6 * index, 20.0, 12.0, angle=0.5))
        drawings.append(drawing(*([] if index == 1 else [moved]), ball(20 + 9 * index)))
    begins = 0.25 * np.arange(count)
    return write_moving_drawing(moves_of(drawings), begins, 0.25 * count), drawings, begins


def test_the_file_shows_each_frame_in_its_time():
    text, drawings, begins = made()
    assert text.count("<animateTransform") == 2 and "script" not in text
    for begin, one in zip(begins, drawings, strict=True):
        for at in (begin, begin + 0.24):  # it changes at once, and not before
            drawn = rerender(still(text, at).encode(), WIDTH, HEIGHT).pixels.astype(int)
            alone = write_moving_drawing(moves_of([one]), np.zeros(1), 1.0)
            assert np.abs(drawn - rerender(alone.encode(), WIDTH, HEIGHT).pixels).max() <= 2
    assert "<animate" not in still(text, 0.3)


def test_viewers_that_stand_still_show_the_first_frame():
    text, _, _ = made()
    shown = [rerender(each.encode(), WIDTH, HEIGHT).pixels for each in (text, still(text, 0.0))]
    assert np.array_equal(*shown)
    assert ElementTree.fromstring(text).tag == "{http://www.w3.org/2000/svg}svg"


@pytest.mark.slow
def test_chromium_plays_it(browser):
    text, _, begins = made()
    page = browser.new_page(viewport={"width": 200, "height": 100})
    page.set_content(f"<style>body{{margin:0}}svg{{display:block}}</style>{text[text.index('<svg') :]}")
    for at in (*(begins + 0.1), 1.1):  # the last is the first again
        page.evaluate("t => { const s = document.querySelector('svg'); s.pauseAnimations(); s.setCurrentTime(t) }", at)
        data = page.screenshot(clip={"x": 0, "y": 0, "width": WIDTH, "height": HEIGHT})
        wanted = rerender(still(text, at % 1.0).encode(), WIDTH, HEIGHT).pixels[..., :3] / 255
        with Image.open(io.BytesIO(data)) as image:
            error = np.square(np.asarray(image.convert("RGB")) / 255 - wanted).mean()
        assert -10 * np.log10(error) > 35
    page.close()


def frames() -> list[Image.Image]:
    """A ball that moves before a ground of two colours."""
    pictures = []
    for index in range(3):
        large = Image.new("RGB", (4 * WIDTH, 4 * HEIGHT), "#dfe9f2")
        pen = ImageDraw.Draw(large)
        pen.rectangle((0, 180, 320, 240), fill="#6a9a5b")
        pen.ellipse((40 + 72 * index, 60, 120 + 72 * index, 140), fill="#c23b6b")
        pictures.append(large.resize((WIDTH, HEIGHT), Image.Resampling.BOX))
    return pictures


def test_a_flat_clip_is_drawn_without_being_asked(tmp_path):
    first, *rest = frames()
    first.save(tmp_path / "ball.webp", save_all=True, append_images=rest, duration=[100, 100, 900], lossless=True)
    done = run_here("animate", tmp_path / "ball.webp", "--threads", 1)
    assert re.search(r"artwork  3 frames  3 shapes", done.stderr.decode())
    text = (tmp_path / "ball.svg").read_text()
    assert text.count("<animateTransform") == 1 and len(text) < 1000
    pictures = [np.asarray(image) for image in frames()]
    animation = cubicsplat_cli.animate(pictures, fps=10, style="artwork", threads=1)
    assert animation.report.quality.worst_psnr_db > 35
    assert len(animation.frames()) == 4
    with pytest.raises(UsageError, match="style photo"):
        animation.lottie()


def stickers() -> list[Image.Image]:
    """A face that moves before nothing, in pixels that are there or not, as a GIF has them."""
    pictures = []
    for index in range(2):
        large = Image.new("RGBA", (4 * 72, 4 * 72), (255, 204, 51, 0))
        pen, left = ImageDraw.Draw(large), 24 + 20 * index
        pen.ellipse((left, 40, left + 200, 240), fill="#ffcc33")
        for x in (60, 120):
            pen.ellipse((left + x, 100, left + x + 24, 140), fill="#553300")
        small = np.array(large.resize((72, 72), Image.Resampling.BOX))
        small[..., 3] = np.where(small[..., 3] > 127, 255, 0)
        pictures.append(Image.fromarray(small))
    return pictures


def test_a_sticker_of_pixels_that_are_there_or_not_is_drawn(tmp_path):
    first, second = stickers()
    first.save(tmp_path / "face.gif", save_all=True, append_images=[second], duration=100, disposal=2)
    done = run_here("animate", tmp_path / "face.gif", "--threads", 1)
    assert re.search(r"artwork  2 frames  3 shapes", done.stderr.decode())
    text = (tmp_path / "face.svg").read_text()
    shown = rerender(still(text, 0.0).encode(), 72, 72).pixels
    assert shown[0, 0, 3] == 0 and np.abs(shown[35, 31].astype(int) - (255, 204, 51, 255)).max() <= 2
