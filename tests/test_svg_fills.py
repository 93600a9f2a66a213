"""Gradient fills of scenes in SVG files: written, read back, and as other renderers draw them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from reference import paint_at
from scenes import MODES, PAPER, painted_scene, random_gradients, random_scene, rectangle, scene_of
from test_gradients import one

from cubicsplat_cli.artwork.geometry.outlines import Circle, Rectangle
from cubicsplat_cli.artwork.scene import scene_of as scene_of_drawing
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.images import Tile, draw_part
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.gradients import FLAT, LINEAR, RADIAL, linear_frames
from cubicsplat_cli.scene.paint import LinearGradient, RadialGradient, Stop, mean_fill
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.drawing_writer import write_drawing
from cubicsplat_cli.svg.scene_reader import quantise_scene, read_svg
from cubicsplat_cli.svg.scene_writer import bytes_by_curve, write_svg


def assert_same(one: Scene, other: Scene) -> None:
    for name in ("points", "colours", "opacities", "half_widths"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    assert (one.gradients is None) == (other.gradients is None)
    if one.gradients is not None:
        theirs = other.gradients.arrays_by_name()
        for name, tensor in one.gradients.arrays_by_name().items():
            assert np.array_equal(tensor, theirs[name]), name


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("precision", [0, 2, 5])
@pytest.mark.parametrize("seed", range(4))
def test_a_file_gives_back_the_gradients_that_it_says(mode, precision, seed):
    scene = painted_scene(mode, 12, 60, 50, seed, background=PAPER)
    quantised = quantise_scene(scene, precision)
    assert_same(read_svg(write_svg(scene, precision=precision)), quantised)
    given, coarse = scene.as_numpy(), 0.1 * 10.0 ** -max(0, precision - 1)
    for curve in np.flatnonzero(quantised.gradients.kinds != FLAT).tolist():
        places = given.points[curve]
        before, after = (paint_at(each.gradients, curve, places) for each in (given, quantised))
        before[:, 3] *= given.opacities[curve]
        after[:, 3] *= quantised.opacities[curve]
        assert abs(before - after).mean() < 0.005 + coarse
    assert int((quantised.gradients.kinds == LINEAR).sum()) >= 3
    assert int((quantised.gradients.kinds == RADIAL).sum()) >= 3


@pytest.mark.parametrize("mode", MODES)
def test_the_file_is_drawn_as_the_engine_draws_the_scene(mode):
    """Through cairo, which keeps 8 bits of each layer."""
    scene = painted_scene(mode, 9, 64, 48, 3, background=PAPER, half_width=(2.0, 5.0))
    drawn = rerender(write_svg(scene, precision=3).encode(), 64, 48).pixels[..., :3]
    own = 255.0 * render_scene(scene, samples=48)
    assert abs(drawn - own).mean() < 1.0
    flat = 255.0 * render_scene(replace(scene, gradients=None), samples=48)
    assert abs(flat - own).mean() > 10.0


def test_text_of_a_linear_gradient():
    scene = scene_of(Mode.CLOSED, [rectangle(1, 1, 9, 9)], 10, 10, background=PAPER, opacity=0.5)
    frames = linear_frames(torch.tensor([[1.0, 5.0]]), torch.tensor([[9.0, 5.0]]))[0].tolist()
    fill = one(LINEAR, frames, [0.0, 1.0], [[1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.2, 1.0]])
    text = write_svg(replace(scene, gradients=fill), precision=1)
    assert (
        '<defs>\n<linearGradient id="units" gradientUnits="userSpaceOnUse"/>\n'
        '<linearGradient id="a" xlink:href="#units" x1="1" y1="5" x2="9" y2="5" gradientTransform="scale(10)">'
        '<stop offset="0" stop-color="#f00"/><stop offset="1" stop-color="#003"/></linearGradient>\n</defs>\n'
    ) in text
    assert 'fill="url(#a)" fill-opacity=".5"/>' in text


def test_different_opacities_are_the_stops_and_equal_ones_the_curves():
    scene = scene_of(Mode.CLOSED, [rectangle(1, 1, 9, 9)], 10, 10, opacity=0.5)
    frame = linear_frames(torch.tensor([[1.0, 5.0]]), torch.tensor([[9.0, 5.0]]))[0].tolist()
    for last, words, absent in ((0.6, 'fill-opacity=".3"', "stop-op"), (0.2, 'stop-opacity=".102"', "fill-op")):
        fill = one(LINEAR, frame, [0.0, 1.0], [[1.0, 0.0, 0.0, 0.6], [0.0, 0.0, 0.2, last]])
        text = write_svg(replace(scene, gradients=fill))
        assert words in text
        assert absent not in text


@pytest.mark.parametrize(
    ("kind", "frame", "stops"),
    [
        (LINEAR, [[0.1, 0.0, 0.0], [0.0, 0.0, 0.0]], [[0.2, 0.4, 0.6, 1.0]] * 2),  # equal stops
        (LINEAR, [[1e-9, 0.0, 0.5], [0.0, 0.0, 0.0]], [[0.2, 0.4, 0.6, 1.0], [0.2, 0.4, 0.6, 0.5]]),  # too long
        (LINEAR, [[0.0, 0.0, 0.5], [0.0, 0.0, 0.0]], [[0.2, 0.4, 0.6, 1.0], [0.2, 0.4, 0.6, 0.5]]),  # no direction
        (RADIAL, [[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]], [[0.2, 0.4, 0.6, 1.0], [0.2, 0.4, 0.6, 0.5]]),
        (FLAT, [[0.1, 0.0, 0.0], [0.0, 0.0, 0.0]], [[0.9, 0.9, 0.9, 1.0]] * 2),
    ],
)
def test_what_is_as_good_as_one_colour_is_written_as_one(kind, frame, stops):
    scene = scene_of(Mode.CLOSED, [rectangle(1, 1, 9, 9)], 10, 10, background=PAPER)
    scene = replace(scene, gradients=one(kind, frame, [0.0, 1.0], stops))
    text = write_svg(scene)
    assert "radient" not in text
    difference = abs(render_scene(read_svg(text)) - render_scene(scene)).max()
    assert difference < 0.005


def test_equal_gradients_are_written_once():
    scene = random_scene(Mode.CLOSED, 6, 3, 40, 30, background=PAPER)
    given = random_gradients(scene)
    frame = linear_frames(torch.tensor([[0.0, 15.0]]), torch.tensor([[40.0, 15.0]]))
    given.frames[:] = frame
    given.kinds[:] = LINEAR
    given.stops[:] = given.stops[0]
    given.offsets[:] = given.offsets[0]
    given.counts[:] = 4
    points = scene.points[:1].expand(6, -1, -1).contiguous()
    text = write_svg(replace(scene, points=points, gradients=given, opacities=torch.ones(6)))
    assert text.count("<linearGradient") == 2  # and the one with the units
    assert text.count("url(#a)") == 6


def test_a_gradient_in_another_unit_is_refused():
    text = write_svg(painted_scene(Mode.CLOSED, 3, background=PAPER))
    with pytest.raises(InputError, match="has a gradient that is not in px"):
        read_svg(text.replace("userSpaceOnUse", "objectBoundingBox"))
    with pytest.raises(InputError, match="gradients in another unit than the paths"):
        read_svg(text.replace("scale(100)", "scale(10)"))
    with pytest.raises(InputError, match="which is no gradient in it"):
        read_svg(text.replace("url(#a)", "url(#zz)"))


def test_bytes_by_curve_know_the_gradients():
    scene = painted_scene(Mode.CLOSED, 30, 60, 50, background=PAPER)
    without = len(write_svg(replace(scene, gradients=None)))
    assert sum(bytes_by_curve(scene, 2)) - sum(bytes_by_curve(replace(scene, gradients=None), 2)) == pytest.approx(
        len(write_svg(scene)) - without, rel=0.1
    )


@pytest.mark.parametrize("mode", MODES)
def test_a_part_of_an_enlarged_scene_has_its_gradients(mode):
    scene = painted_scene(mode, 9, 40, 36, background=PAPER)
    whole = draw_part(scene, 2, Tile(0, 0, 40, 36), 16, 1)
    part = draw_part(scene, 2, Tile(16, 8, 20, 24), 16, 1)
    assert abs(part - whole[16:64, 32:72]).max() < 2e-3


def test_a_drawings_gradients_are_its_scenes():
    stops = (Stop(0.0, (255, 0, 0, 255)), Stop(0.6, (0, 0, 255, 128)))
    focal = RadialGradient(30.0, 24.0, 18.0, 9.0, 0.6, stops, (38.0, 27.0))
    gradients = (LinearGradient(8.0, 4.0, 40.0, 20.0, stops), focal)
    shapes = [
        Shape((250, 240, 230, 255), (Rectangle(0.0, 0.0, 48.0, 40.0),), "ground"),
        Shape(mean_fill(gradients[0]), (Rectangle(4.0, 4.0, 36.0, 18.0),), "board", gradients[0]),
        Shape(mean_fill(gradients[1]), (Circle(30.0, 24.0, 12.0),), "ball", gradients[1]),
    ]
    drawing = Drawing(48, 40, tuple(shapes))
    scene = scene_of_drawing(drawing)
    scene.validate()
    assert scene.gradients.kinds.tolist() == [RADIAL, LINEAR, FLAT]
    drawn = rerender(write_drawing(drawing, title="", comment="").encode(), 48, 40).pixels
    own = 255.0 * render_scene(scene, samples=32)
    assert abs(drawn[..., : own.shape[2]] - own).mean() < 0.6
