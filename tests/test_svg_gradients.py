"""Gradients as SVG: what is written draws as the formulas say, comes back, and plain gradients of others are read."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cubicsplat_cli import read_svg
from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Rectangle, polygon
from cubicsplat_cli.artwork.shapes import Drawing, Shape, scaled_drawing
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.scene.paint import LinearGradient, RadialGradient, Stop, mean_fill, painted
from cubicsplat_cli.svg.drawing_reader import holds_drawing, read_drawing
from cubicsplat_cli.svg.drawing_writer import write_drawing
from cubicsplat_cli.svg.own import own_elements
from cubicsplat_cli.svg.scene_writer import write_svg

SIZE = (64, 48)
STOPS = (Stop(0.125, (255, 0, 0, 255)), Stop(0.5, (255, 255, 0, 255)), Stop(1.0, (0, 64, 255, 255)))
FADING = (Stop(0.0, (10, 20, 30, 255)), Stop(1.0, (10, 20, 30, 0)))
SLANTED = LinearGradient(8.0, 4.0, 50.0, 40.0, STOPS)
ROUND = RadialGradient(30.0, 20.0, 25.0, 25.0, 0.0, STOPS)
OVAL = RadialGradient(30.0, 20.0, 40.0, 15.0, 0.5, STOPS)
FOCAL = RadialGradient(30.0, 20.0, 25.0, 25.0, 0.0, STOPS, (41.0, 8.0))
FOCAL_OVAL = RadialGradient(30.0, 20.0, 40.0, 15.0, 0.5, STOPS, (44.0, 21.0))


AT = np.mgrid[1:47, 1:63][::-1] + 0.5


def written(*shapes: Shape) -> str:
    return write_drawing(Drawing(*SIZE, shapes), precision=2, title="t", comment="c")


def filled(gradient, outline=None) -> Shape:
    return Shape(mean_fill(gradient), (outline or Rectangle(0, 0, *SIZE),), "shape", gradient)


def expected(gradient) -> np.ndarray:
    y, x = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    return painted(gradient, x, y)


def drawn(svg: str) -> np.ndarray:
    return rerender(svg.encode(), *SIZE).pixels


@pytest.mark.parametrize("gradient", [SLANTED, ROUND, OVAL, FOCAL, FOCAL_OVAL, LinearGradient(0, 0, 64, 0, FADING)])
def test_the_file_draws_what_the_formulas_say(gradient):
    found = np.asarray(drawn(written(filled(gradient))), dtype=float) / 255.0
    premultiplied = np.concatenate([found[..., :3] * found[..., 3:], found[..., 3:]], axis=2)
    assert np.abs(premultiplied - expected(gradient)).max() < 4 / 255


@pytest.mark.parametrize("gradient", [SLANTED, OVAL])
@pytest.mark.parametrize(
    "outline",
    [
        Ellipse(32.0, 24.0, 24.0, 12.0, 0.6), Rectangle(12.0, 12.0, 40.0, 24.0, angle=0.5),
        Rectangle(12.0, 12.0, 40.0, 24.0, 6.0, 0.5), Rectangle(16.0, 12.0, 32.0, 24.0, 11.9, -0.7),
    ],
)  # fmt: skip
@pytest.mark.parametrize("renderer", ["cairosvg", "resvg"])
def test_a_gradient_is_not_turned_with_its_shape(outline, gradient, renderer):
    shape = filled(gradient, outline)
    svg = written(shape)
    found = np.asarray(rerender(svg.encode(), *SIZE, renderer=renderer).pixels, dtype=float) / 255.0
    inside = shape.coverage(0, 0, SIZE[1], SIZE[0]) > 0.999
    assert inside.sum() > 300 and np.abs(found - expected(gradient))[inside].max() < 4 / 255
    assert type(read_drawing(svg).shapes[0].gradient) is type(gradient)


def test_equal_gradients_are_written_once_and_the_text_is_short():
    first, second = Rectangle(0, 0, 20, 20), Rectangle(30, 0, 20, 20)
    text = written(filled(SLANTED, first), filled(SLANTED, second), filled(ROUND, Circle(30, 30, 9)))
    assert text.count("<linearGradient") == 1 and text.count('fill="url(#gradient)"') == 2
    assert (
        '<linearGradient id="gradient" x1="8" y1="4" x2="50" y2="40" gradientUnits="userSpaceOnUse">'
        '<stop offset=".125" stop-color="#f00"/><stop offset=".5" stop-color="#ff0"/>'
        '<stop offset="1" stop-color="#0040ff"/></linearGradient>\n'
    ) in text
    assert '<radialGradient id="gradient-2" cx="30" cy="20" r="25" gradientUnits="userSpaceOnUse">' in text
    assert written(filled(LinearGradient(0, 0, 1, 0, FADING))).count("stop-opacity") == 1


@pytest.mark.parametrize("gradient", [SLANTED, ROUND, OVAL, FOCAL, FOCAL_OVAL])
def test_gradients_come_back(gradient):
    shape = filled(gradient, polygon(np.array([[1.0, 1.0], [50.0, 3.0], [20.0, 40.0]])))
    text = written(Shape((0, 0, 0, 255), (Rectangle(0, 0, 9, 9),), "flat"), shape)
    assert holds_drawing(own_elements(text))
    flat, found = read_drawing(text).shapes
    assert flat.gradient is None and found.fill == shape.fill and found.gradient.stops == gradient.stops
    assert np.allclose(found.gradient.frame(), gradient.frame(), atol=2e-3)
    assert np.abs(painted(found.gradient, *AT) - painted(gradient, *AT)).max() < 0.02
    assert write_drawing(read_drawing(text), precision=2, title="t", comment="c") == text


def test_scaling_a_drawing_scales_its_gradients():
    for gradient in (SLANTED, OVAL, FOCAL_OVAL):
        (shape,) = scaled_drawing(Drawing(*SIZE, (filled(gradient),)), 128, 48).shapes
        y, x = np.mgrid[:48, :128] + 0.5
        assert np.allclose(painted(shape.gradient, x, y), painted(gradient, x / 2.0, y), atol=1e-9)


HEAD = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" {size}>'
SIZED = 'width="64" height="48" viewBox="0 0 64 48"'
TWO = '<stop offset="10%" stop-color="#f00"/><stop offset="1" stop-color="#00f"/>'
BOX = '<rect x="8" y="4" width="40" height="30" fill="url(#b)"/>'


def foreign(defs: str, shape: str = BOX) -> str:
    return f'<svg xmlns="http://www.w3.org/2000/svg" {SIZED}>{defs}{shape}</svg>'


@pytest.mark.parametrize(
    "defs",
    [
        f'<defs><linearGradient id="b" x1="0" y1="0" x2="1" y2="1">{TWO}</linearGradient></defs>',
        f'<linearGradient id="b" x1="50%" x2="50%" y1="80%" y2="0%">{TWO}</linearGradient>',
        f'<linearGradient id="b" gradientUnits="userSpaceOnUse" x1="10" y1="5" x2="30" y2="9" '
        f'gradientTransform="rotate(20 9 5)scale(1 .5),translate(3)">{TWO}</linearGradient>',
        f'<radialGradient id="b">{TWO}</radialGradient>',
        f'<radialGradient id="b" fx=".2" cy=".4">{TWO}</radialGradient>',
        f'<radialGradient id="b" gradientUnits="userSpaceOnUse" cx="20" cy="20" r="19" fx="28" fy="30" '
        f'gradientTransform="matrix(1 .5 -.3 .8 2 -9)">{TWO}</radialGradient>',
        f'<radialGradient id="b" gradientUnits="userSpaceOnUse" cx="20" cy="30" r="9" '
        f'gradientTransform="matrix(1 .5 -.3 .8 2 -9) skewX(10)">{TWO}</radialGradient>',
    ],
)
def test_plain_gradients_of_others_are_read(defs):
    drawing = read_drawing(foreign(defs))
    again = write_drawing(drawing, precision=5, title="t", comment="c")
    theirs, ours = (np.asarray(drawn(text), dtype=int) for text in (foreign(defs), again))
    assert np.abs(theirs - ours).max() <= 2


def test_gradients_inherit_and_may_stand_behind_their_shapes():
    parent = f'<linearGradient id="a" gradientUnits="userSpaceOnUse" x1="3" y1="4" x2="5" y2="6">{TWO}</linearGradient>'
    child = '<linearGradient id="b" xlink:href="#a" x2="9"/>'
    text = f"{HEAD.format(size=SIZED)}{BOX}{child}{parent}</svg>"
    (shape,) = read_drawing(text).shapes
    assert shape.gradient == LinearGradient(3, 4, 9, 6, (Stop(0.1, (255, 0, 0, 255)), Stop(1.0, (0, 0, 255, 255))))


@pytest.mark.parametrize("gradient", [ROUND, FOCAL, FOCAL_OVAL])
def test_a_scene_is_drawn_with_the_focus_of_the_file(gradient):
    text = written(filled(gradient))
    own = 255.0 * render_scene(read_svg(text))
    assert np.abs(own[..., :3] - drawn(text)[..., :3]).max() < 4.0
    again = write_svg(read_svg(text), precision=3)
    assert ("fx=" in again) == (gradient.focus is not None)
    assert np.abs(drawn(again)[..., :3].astype(float) - drawn(text)[..., :3]).max() <= 2.0


def test_what_is_left_out_is_said_once(caplog):
    first = f'<radialGradient id="b" fr=".2" spreadMethod="reflect">{TWO}</radialGradient>'
    read_drawing(foreign(first, BOX + BOX))
    assert [r.getMessage() for r in caplog.records] == ["left out of the SVG's gradients: fr, spreadMethod='reflect'"]


@pytest.mark.parametrize(
    ("defs", "reason"),
    [
        ("", "filled with #b, which is no gradient"),
        ('<linearGradient id="b"/>', "without stops"),
        (f"<linearGradient>{TWO}</linearGradient>", "without an id"),
        ('<stop offset="1"/>', "unexpected <stop>"),
        (f'<linearGradient id="b" href="#c">{TWO}</linearGradient>', "refers to '#c'"),
        ('<linearGradient id="b" href="#b"/>', "without end"),
        (f'<linearGradient id="b" x1="1em">{TWO}</linearGradient>', "x1='1em'"),
        (f'<linearGradient id="b" gradientTransform="twist(3)">{TWO}</linearGradient>', "cannot be read"),
        (f'<linearGradient id="b" gradientTransform="scale(0)">{TWO}</linearGradient>', "flattened to nothing"),
        ('<linearGradient id="b"><stop stop-color="blu"/></linearGradient>', "the colour 'blu'"),
        (f'<linearGradient id="b" mystery="1">{TWO}</linearGradient>', "unexpected attribute"),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_reason(defs, reason):
    with pytest.raises(InputError, match=r"not written by cubicsplat") as error:
        read_drawing(foreign(defs))
    assert reason in str(error.value)


def test_a_gradient_without_length_is_its_last_stop():
    (shape,) = read_drawing(foreign(f'<linearGradient id="b" x2="0" y2="0">{TWO}</linearGradient>')).shapes
    assert [stop.colour for stop in shape.gradient.stops] == [(0, 0, 255, 255)]
    (shape,) = read_drawing(foreign(f'<radialGradient id="b" r="0">{TWO}</radialGradient>')).shapes
    assert [stop.colour for stop in shape.gradient.stops] == [(0, 0, 255, 255)]


def test_the_angle_of_an_ellipse_is_of_its_longer_axis():
    (shape,) = scaled_drawing(Drawing(*SIZE, (filled(ROUND),)), 64, 144).shapes
    assert (shape.gradient.rx, shape.gradient.ry) == pytest.approx((75.0, 25.0))
    assert abs(shape.gradient.angle) == pytest.approx(math.pi / 2.0)
