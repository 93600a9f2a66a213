"""The artwork style on drawings whose truth is known."""

import numpy as np
import pytest
from conftest import rest_slow

from cubicsplat_cli.artwork.finish.state import begin, goal_of
from cubicsplat_cli.artwork.geometry.outlines import Circle, Rectangle
from cubicsplat_cli.artwork.regions.fills import APART
from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.raster.engines import render_scene


def painted(width, height, *layers, ground=(0.0, 0.0, 0.0, 0.0), fine=8):
    """(H, W, 4) premultiplied: each layer is a function of x, y (px) and a premultiplied colour, back to front."""
    y, x = (np.mgrid[0 : height * fine, 0 : width * fine] + 0.5) / fine
    picture = np.broadcast_to(np.array(ground), (height, width, 4)).copy()
    for inside, colour in layers:
        share = inside(x, y).reshape(height, fine, width, fine).mean(axis=(1, 3))[..., None]
        colour = np.array(colour)
        picture = picture * (1.0 - share * colour[3]) + share * colour
    return (np.rint(picture * 255.0) / 255.0).astype(np.float32)


def disc(cx, cy, r):
    return lambda x, y: np.hypot(x - cx, y - cy) <= r


def box(x0, y0, x1, y1):
    return lambda x, y: (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)


RED, BLUE, WHITE = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0), (1.0, 1.0, 1.0, 1.0)


def test_a_disc_becomes_a_circle():
    drawing = draw(painted(64, 64, (disc(30.3, 32.6, 20.25), RED)))
    (shape,) = drawing.shapes
    (circle,) = shape.outlines
    assert shape.fill == (255, 0, 0, 255) and isinstance(circle, Circle)
    assert (circle.cx, circle.cy, circle.r) == pytest.approx((30.3, 32.6, 20.25), abs=0.02)


def test_a_box_on_a_ground_becomes_two_rectangles():
    drawing = draw(painted(80, 60, (box(10.25, 12.5, 50.75, 40.0), BLUE), ground=WHITE))
    ground, shape = drawing.shapes
    assert ground.fill == (255, 255, 255, 255) and isinstance(ground.outlines[0], Rectangle)
    rectangle = shape.outlines[0]
    assert isinstance(rectangle, Rectangle) and rectangle.radius == 0.0
    assert (rectangle.x, rectangle.y) == pytest.approx((10.25, 12.5), abs=0.03)
    assert (rectangle.width, rectangle.height) == pytest.approx((40.5, 27.5), abs=0.05)


def pill(x0, y0, length, width, *, angle=0.0):
    """A box with half circles for ends, its middle line starting at x0, y0."""

    def inside(x, y):
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        t = (x - x0) * along[0] + (y - y0) * along[1]
        s = (x - x0) * across[0] + (y - y0) * across[1]
        return np.hypot(t - np.clip(t, 0.0, length), s) <= 0.5 * width

    return inside


@pytest.mark.parametrize(("length", "width", "angle"), [(27.1, 13.57, 0.5 * np.pi), (5.4, 5.5, 0.46), (5.4, 5.5, -1.1)])
@pytest.mark.parametrize("shift", [0.0, 0.13, 0.4])
def test_a_pill_becomes_a_rectangle_of_the_roundest_corners(length, width, angle, shift):
    """Drawn with 4 x 4 samples a px, as drawing programs do."""
    drawing = draw(painted(60, 60, (pill(25.0 + shift, 20.3, length, width, angle=angle), RED), ground=WHITE, fine=4))
    found = drawing.shapes[1].outlines[0]
    assert isinstance(found, Rectangle)
    assert min(found.width, found.height) == pytest.approx(width, abs=0.2)
    assert max(found.width, found.height) == pytest.approx(length + width, abs=0.2)
    assert found.radius == pytest.approx(0.5 * width, abs=0.12)


@pytest.mark.parametrize("end", [0.0, 1.0, -1.0])
def test_a_bar_with_a_slanted_end_is_no_rectangle(end):
    def bar(x, y):
        return (x > 8.3) & (np.abs(y - 20.2) < 2.3) & (x < 60.0 + end * (y - 20.0))

    drawing = draw(painted(70, 40, (bar, RED), ground=WHITE, fine=4))
    assert isinstance(drawing.shapes[1].outlines[0], Rectangle) == (end == 0.0)


def test_a_disc_behind_another_goes_on_beneath_it():
    drawing = draw(painted(120, 80, (disc(45.0, 40.0, 30.0), RED), (disc(80.0, 40.0, 25.0), BLUE)))
    assert [shape.fill[:3] for shape in drawing.shapes] == [(255, 0, 0), (0, 0, 255)]
    hidden = drawing.shapes[0].outlines[0]
    assert isinstance(hidden, Circle)
    assert (hidden.cx, hidden.cy, hidden.r) == pytest.approx((45.0, 40.0, 30.0), abs=0.05)


def test_a_hole_shows_the_ground_and_an_inset_fills_none():
    ring = draw(painted(80, 80, (disc(40.0, 40.0, 30.0), RED), (disc(40.0, 40.0, 12.0), WHITE), ground=WHITE))
    assert [len(shape.outlines) for shape in ring.shapes] == [1, 2]
    inset = draw(painted(80, 80, (disc(40.0, 40.0, 30.0), RED), (disc(40.0, 40.0, 12.0), BLUE), ground=WHITE))
    assert [len(shape.outlines) for shape in inset.shapes] == [1, 1, 1]


def test_a_translucent_fill_keeps_its_opacity():
    drawing = draw(painted(64, 64, (disc(32.0, 32.0, 20.0), (0.25, 0.0, 0.25, 0.5))))
    assert drawing.shapes[0].fill == pytest.approx((127, 0, 127, 128), abs=1)


def test_drawing_twice_gives_the_same():
    picture = painted(64, 64, (disc(30.0, 30.0, 20.0), RED), (box(20.0, 35.0, 60.0, 50.0), BLUE))
    assert repr(draw(picture)) == repr(draw(picture))


def test_settings_are_checked():
    for wrong in ({"colors": 0}, {"min_area": -1.0}, {"detail": 0.0}, {"palette": ((0, 0, 256),)}):
        with pytest.raises(UsageError):
            ArtworkSettings(**wrong)


@pytest.mark.parametrize(
    "shape",
    rest_slow(*(((10, 12, 3),), ((1, 40, 3),), ((1, 1, 3),), ((40, 1, 4),), ((2, 2, 4),), ((24, 24, 3),)), fast=2),
)
def test_noise_of_any_size_is_drawn(shape):
    noise = np.random.default_rng(0).random(shape).astype(np.float32)
    drawing = draw(noise if shape[-1] == 3 else noise * noise[..., 3:])
    assert (drawing.width, drawing.height) == shape[1::-1]


def test_a_clear_picture_has_no_shapes_and_an_even_one_a_single_rectangle():
    assert draw(np.zeros((20, 30, 4), np.float32)).shapes == ()
    (shape,) = draw(np.full((20, 30, 3), 0.5, np.float32)).shapes
    assert shape.outlines == (Rectangle(0.0, 0.0, 30.0, 20.0),)


def test_checkerboards_of_single_pixels_become_even():
    board = (np.indices((64, 64)).sum(axis=0) % 2).astype(np.float32)[..., None].repeat(3, axis=-1)
    assert len(draw(board).shapes) < 10


def test_a_ring_beneath_a_band_keeps_its_hole_open():
    ring = lambda x, y: disc(40.0, 40.0, 32.0)(x, y) & ~disc(40.0, 34.0, 14.0)(x, y)  # noqa: E731
    picture = painted(80, 80, (ring, RED), (box(4.0, 52.25, 77.0, 60.5), BLUE))
    drawing = draw(picture)
    target = np.asarray(picture, dtype=float)
    image = begin(drawing, goal_of(target)).image
    assert np.abs(image - target).mean() < 2e-3


def test_curves_cap_the_shapes_and_a_palette_replaces_fills():
    spots = [(disc(12.0 + 16.0 * i, 20.0, 3.0 + i), RED) for i in range(4)]
    picture = painted(76, 40, *spots, ground=WHITE)
    drawing = draw(picture, ArtworkSettings(curves=3, palette=((250, 250, 240), (10, 200, 10))))
    assert len(drawing.shapes) <= 3
    assert drawing.fills == ((250, 250, 240, 255), (10, 200, 10, 255))


def test_shapes_are_named_by_their_colour():
    drawing = draw(painted(40, 40, (disc(20.0, 20.0, 12.0), RED), ground=WHITE))
    assert [shape.name for shape in drawing.shapes] == ["background", "red"]


@pytest.mark.parametrize("size", [(1, 2), (2, 2), (1, 3)])  # px
def test_specks_of_whole_pixels_are_drawn_exactly(size):
    target = np.ones((32, 32, 4))
    target[22:30, 4:28, :3] = 0.0
    for y in range(3, 20, 6):
        for x in range(3, 28, 7):
            target[y : y + size[0], x : x + size[1], :3] = 0.0
    drawing = draw(target.astype(np.float32))
    assert np.abs(begin(drawing, goal_of(target)).image - target).max() < 0.01
    assert len(drawing.shapes) == 2 + 3 * 4


# No translucent shape lies beneath another.
@pytest.mark.parametrize(("opacity", "most"), [(1.0, 18), (250 / 255, 22)])
def test_shading_that_no_gradient_explains_is_drawn_in_bands(opacity, most):
    """A bent shade within an outline: no fills of other things, and no spikes."""
    y, x = np.mgrid[0:80, 0:100] + 0.5
    shade = np.exp(-(((y - 40 - 12 * np.sin(x / 9)) / 7) ** 2) - ((x - 50) / 22) ** 2)[..., None]
    picture = painted(100, 80, (box(60, 70, 100, 80), (0.6, 0.3, 0.2, 1.0)), ground=WHITE)[..., :3]
    for radius, colour in ((32, 0.08), (30, 0.84 - 0.4 * shade)):
        share = np.clip(radius + 0.5 - np.hypot(x - 46, y - 38), 0, 1)[..., None]
        picture = picture + share * (colour - picture)
    picture = opacity * np.dstack([picture, np.ones((80, 100))])
    drawing = draw((np.rint(255 * picture) / 255).astype(np.float32))
    assert len(drawing.shapes) <= most
    inside = disc(46, 38, 28)(x, y)
    off = np.abs(255 * (render_scene(scene_of(drawing)) - picture))[inside]
    assert off.max() <= 1.5 * APART and off.mean() < 4.0
