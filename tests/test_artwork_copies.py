"""Outlines that are alike: found where they are, exactly so in the drawing, and nowhere else."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from red_rings import RED, assert_jacobian, red_picture
from test_artwork_finish import covered

from cubicsplat_cli.artwork.finish.parameters import Constraints, CopyParameters, RigidTransform, parametrised
from cubicsplat_cli.artwork.finish.settle import settle
from cubicsplat_cli.artwork.finish.state import begin, drawn, goal_of
from cubicsplat_cli.artwork.geometry.outlines import FINE, Circle, Ellipse, Rectangle, Ring, flattened
from cubicsplat_cli.artwork.regularities.regularities import with_copies
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.svg.drawing_reader import read_drawing
from cubicsplat_cli.svg.drawing_writer import write_drawing

WIDTH, HEIGHT = 160, 96
DROP = "M0 -26C12 -14 20 -4 18 8 16 22 -10 24 -16 12 -20 2 -8 -12 0 -26z"


def pictured(*placed):
    """The picture of the drop, once for each transform."""
    return red_picture(DROP, placed, WIDTH, HEIGHT)


def drops(picture):
    rings = [o for shape in draw(picture).shapes for o in shape.outlines if shape.fill == RED]
    return sorted(rings, key=lambda ring: ring.anchors[:, 0].mean())


def test_a_shape_that_is_repeated_has_the_same_numbers_but_for_the_first():
    left, right = drops(pictured("translate(40.3 44.2)", "translate(117.05 47.7)"))
    shifts = right.cubics - left.cubics
    assert np.ptp(shifts, axis=(0, 1)) == pytest.approx([0.0, 0.0], abs=1e-9)
    assert shifts[0, 0] == pytest.approx([76.75, 3.5], abs=0.02)
    assert shifts[0, 0] * 1000.0 == pytest.approx(np.rint(shifts[0, 0] * 1000.0), abs=1e-6)


def test_a_pair_across_the_middle_is_mirrored_exactly():
    left, right = drops(pictured("translate(40.3 44.2)", "translate(119.7 44.2) scale(-1 1)"))
    assert np.abs(right.cubics - (left.cubics * [-1.0, 1.0] + [WIDTH, 0.0])).max() < 1e-9


def test_shapes_that_differ_by_half_a_pixel_stay_different():
    left, right = drops(pictured("translate(40.3 44.2)", "translate(117.05 47.7) scale(1.015 1)"))
    widths = [float(np.ptp(flattened(ring, 0.1), axis=0)[0]) for ring in (left, right)]
    assert widths[1] - widths[0] == pytest.approx(0.5, abs=0.1)


SIGN, PLACE = st.sampled_from([1.0, -1.0]), st.floats(-50.0, 50.0)
SHAPES = [Circle(3.0, 4.0, 2.0), Ellipse(3.0, 4.0, 5.0, 2.0, 0.4), Rectangle(1.0, 2.0, 7.0, 3.0, 0.5, 0.3)]


@pytest.mark.parametrize("shape", SHAPES)
@given(signs=st.tuples(SIGN, SIGN), shift=st.tuples(PLACE, PLACE))
def test_a_primitive_comes_to_lie_where_its_points_do(shape, signs, shift):
    way = RigidTransform(signs, shift)
    points, moved = (r.cubics.reshape(-1, 2) for r in (shape.ring(FINE), way.outline(shape).ring(FINE)))
    gaps = np.hypot(*(way.points(points)[:, None] - moved).transpose(2, 0, 1))
    assert gaps.min(axis=1).max() < 1e-9


def test_copies_follow_their_model_and_fit_together():
    truth = np.zeros((48, 96, 4))
    for cx, r in ((24.0, 9.0), (70.0, 9.04)):
        truth += covered(Circle(cx, 24.0, r), 48, 96)[..., None]
    goal, constraints = goal_of(truth), Constraints(96, 48)
    white = (255, 255, 255, 255)
    shapes = tuple(Shape(white, (Circle(cx, 24.0, 8.8),), "x") for cx in (24.0, 70.0))
    state = begin(Drawing(96, 48, shapes), goal)
    model = parametrised(shapes[0].outlines[0], constraints)
    state = state.with_outlines({0: model, 1: CopyParameters(model, RigidTransform((1.0, 1.0), (46.0, 0.0)), 0)})
    first, second = (layer.outlines[0].outline() for layer in settle(state, trim=False).layers)
    assert (first.r, second.r) == pytest.approx((9.02, 9.02), abs=0.005) and first.r == second.r
    assert (second.cx - first.cx, second.cy - first.cy) == (46.0, 0.0)


def copied(truth, begun):
    """The outlines of a drawing of primitives in white, with its copies, of a picture of others."""
    goal = goal_of(sum(covered(shape, 48, 128)[..., None] for shape in truth).repeat(4, axis=2))
    drawing = Drawing(128, 48, tuple(Shape((255, 255, 255, 255), (shape,), "x") for shape in begun))
    state = with_copies(settle(begin(drawing, goal)), Constraints(128, 48), 1.0)
    return [shape.outlines[0] for shape in drawn(drawing, state).shapes]


@pytest.mark.parametrize(("radius", "alike"), [(9.03, True), (9.5, False)])
def test_primitives_that_touch_the_border_are_copies_where_they_are_alike(radius, alike):
    truth = [Ellipse(12.4, 9.0, 12.4, 9.0), Ellipse(60.2, 30.1, 12.41, radius)]
    first, second = copied(truth, [Ellipse(12.3, 9.1, 12.2, 9.2), Ellipse(60.1, 30.2, 12.3, 9.1)])
    assert ((first.rx, first.ry) == (second.rx, second.ry)) is alike
    assert second.ry == pytest.approx(0.5 * (9.0 + radius) if alike else radius, abs=0.02)


def test_one_that_is_hardly_alike_does_not_keep_the_others_from_being_copies():
    radii = (14.0, 14.01, 14.14)
    found = copied(*([Circle(x, 24.0, r) for x, r in zip((20.2, 60.3, 100.1), radii, strict=True)] for _ in range(2)))
    assert found[0].r == found[1].r == pytest.approx(14.005, abs=0.01)
    assert found[2].r == pytest.approx(14.14, abs=0.01)


def test_the_jacobian_of_a_copy_matches_finite_differences():
    ring = Circle(20.0, 19.0, 9.3).ring()
    copy = CopyParameters(parametrised(ring, Constraints(64, 64)), RigidTransform((-1.0, 1.0), (60.0, 3.0)), 0)
    assert_jacobian(copy)
    assert isinstance(copy.outline(), Ring)


def test_repeated_rings_are_the_same_text_but_for_the_first_point():
    ring = Ring(
        np.array([[4.0, 4.0], [9.0, 4.0], [11.5, 12.25]]),
        np.array([[[5.0, 4.0], [8.0, 4.0]], [[12.0, 5.0], [13.0, 9.0]], [[8.0, 14.0], [3.0, 9.0]]]),
        np.array([True, False, False]),
        np.zeros(3, bool),
    )
    moved = [RigidTransform((1.0, 1.0), shift).outline(ring) for shift in ((0.0, 0.0), (1.11, 60.07), (300.5, 7.0))]
    shapes = tuple(Shape((colour, 0, 0, 255), (one,), "x") for colour, one in zip((255, 200, 150), moved, strict=True))
    text = write_drawing(Drawing(400, 100, shapes), precision=2, title="x", comment="y")
    paths = re.findall(r' d="M([^"]*)"', text)
    assert len(paths) == 3 and len({re.sub(r"^[-.\d ]+", "", path) for path in paths}) == 1
    found = [shape.outlines[0] for shape in read_drawing(text).shapes]
    for one, expected in zip(found, moved, strict=True):
        assert np.array(sorted(one.anchors.tolist())) == pytest.approx(
            np.array(sorted(expected.anchors.tolist())), abs=0.006
        )
