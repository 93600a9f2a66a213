from dataclasses import replace

import numpy as np
import pytest
from red_rings import assert_jacobian
from scipy import ndimage

from cubicsplat_cli.artwork.finish.parameters import Constraints, parametrised
from cubicsplat_cli.artwork.finish.settle import NOTICED, judged, settle
from cubicsplat_cli.artwork.finish.state import begin, drawn, goal_of
from cubicsplat_cli.artwork.geometry.outlines import FINE, Circle, Ellipse, Rectangle, polygon, signed_area
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.restore import seen_as
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.raster.outlines import coverage
from cubicsplat_cli.svg.drawing_writer import write_drawing

RED, BLUE, YELLOW = (255, 0, 0, 255), (0, 0, 255, 255), (255, 230, 0, 255)


def finish(drawing, target):
    return drawn(drawing, settle(begin(drawing, goal_of(target))))


def covered(outline, height, width):
    ring = outline.ring(FINE) if not hasattr(outline, "anchors") else outline
    return coverage(ring.cubics, ring.lines, 0, 0, height, width)


def picture(shapes, height, width):
    out = np.zeros((height, width, 4))
    for outline, fill in shapes:
        share = covered(outline, height, width)[..., None]
        colour = np.array(fill) / 255.0
        out = out * (1.0 - share) + share * colour
    return out


def test_coverage_of_a_box_is_the_area_of_each_pixel():
    share = covered(polygon(np.array([[1.25, 2.5], [4.5, 2.5], [4.5, 5.0], [1.25, 5.0]])), 8, 8)
    assert share[2].tolist() == pytest.approx([0, 0.375, 0.5, 0.5, 0.25, 0, 0, 0])
    assert share[3].tolist() == pytest.approx([0, 0.75, 1, 1, 0.5, 0, 0, 0])
    assert share.sum() == pytest.approx(3.25 * 2.5)


def test_coverage_beyond_the_canvas_is_cut_off():
    share = covered(polygon(np.array([[-9.0, -9.0], [3.0, -9.0], [3.0, 30.0], [-9.0, 30.0]])), 6, 6)
    assert np.allclose(share, np.arange(6)[None] < 3)


@pytest.mark.parametrize("outline", [Circle(20.0, 19.0, 9.3), Ellipse(20.0, 20.0, 12.0, 5.0, 0.4)])
def test_coverage_sums_to_the_area(outline):
    area = np.pi * (outline.r**2 if isinstance(outline, Circle) else outline.rx * outline.ry)
    assert covered(outline, 40, 40).sum() == pytest.approx(area, rel=3e-4)
    assert signed_area(outline.ring(FINE)) == pytest.approx(area, rel=1e-5)


def test_a_fine_rounded_rectangle_has_round_corners():
    ring = Rectangle(2.0, 3.0, 10.0, 6.0, 2.0, 0.3).ring(FINE)
    assert signed_area(ring) == pytest.approx(60.0 - (4.0 - np.pi) * 4.0, rel=1e-5)


@pytest.mark.parametrize(
    "outline",
    [
        Circle(20.0, 19.0, 9.3),
        Ellipse(20.0, 20.0, 12.0, 5.0, 0.4),
        Rectangle(5.0, 6.0, 20.0, 10.0, 3.0, 0.2),
        Circle(20.0, 19.0, 9.3).ring(),
        Rectangle(5.0, 6.0, 20.0, 10.0, 3.0).ring(),
    ],
)
def test_jacobians_match_finite_differences(outline):
    assert_jacobian(parametrised(outline, Constraints(64, 64)))


def test_the_finish_finds_shapes_that_are_half_a_pixel_off():
    truth = [(Rectangle(4.0, 5.0, 40.3, 30.6, 6.2), RED), (Circle(33.3, 30.7, 11.4), BLUE)]
    start = [(Rectangle(4.4, 4.7, 39.8, 31.1, 6.5), RED), (Circle(33.7, 30.3, 11.8), BLUE)]
    shapes = tuple(Shape(fill, (outline,), "x") for outline, fill in start)
    done = finish(Drawing(56, 48, shapes), picture(truth, 48, 56))
    box, disc = (shape.outlines[0] for shape in done.shapes)
    assert (disc.cx, disc.cy, disc.r) == pytest.approx((33.3, 30.7, 11.4), abs=2e-3)
    assert (box.x, box.y, box.width, box.height, box.radius) == pytest.approx((4.0, 5.0, 40.3, 30.6, 6.2), abs=5e-3)


def test_the_finish_looks_through_a_blur():
    truth = [(Rectangle(4.0, 5.0, 40.3, 30.6, 6.2), RED), (Circle(33.3, 30.7, 11.4), BLUE)]
    start = [(Rectangle(4.3, 4.8, 39.9, 31.0, 7.0), RED), (Circle(33.6, 30.4, 11.7), BLUE)]
    target = ndimage.gaussian_filter(picture(truth, 48, 56), (1.5, 1.5, 0.0), mode="nearest")
    drawing = Drawing(56, 48, tuple(Shape(fill, (outline,), "x") for outline, fill in start))
    goal = goal_of(target, blur=1.5)
    settled = settle(begin(drawing, goal))
    box, disc = (shape.outlines[0] for shape in drawn(drawing, settled).shapes)
    assert (disc.cx, disc.cy, disc.r) == pytest.approx((33.3, 30.7, 11.4), abs=5e-3)
    assert (box.x, box.y, box.width, box.height, box.radius) == pytest.approx((4.0, 5.0, 40.3, 30.6, 6.2), abs=0.02)
    # An outline is judged by what the blur carries beyond the pixels that it crosses, too.
    moved = begin(drawing, goal)
    crossed = settled.stack.growth(moved.stack, settled.owners, moved.owners, 2)
    carried = settled.growth(moved, np.ones(2, dtype=bool), settled.spread)
    assert (carried > 1.5 * crossed).all() and (crossed > 0.0).all()


def test_an_edge_that_moves_by_a_whole_pixel_is_judged_by_what_it_uncovers():
    goal = goal_of(picture([(Rectangle(4.0, 5.0, 40.0, 30.0), RED)], 48, 56))
    states = [begin(Drawing(56, 48, (Shape(RED, (box,), "x"),)), goal) for box in (
        Rectangle(4.0, 5.0, 40.0, 30.0), Rectangle(4.0, 6.0, 40.0, 29.0))]  # fmt: skip
    lost = states[0].growth(states[1], np.ones(1, dtype=bool), 1)
    assert lost == pytest.approx(states[1].stack.cost - states[0].stack.cost) and lost > 0.0
    gained = states[0].gains(states[1], np.ones(1, dtype=bool))
    assert gained == pytest.approx(-0.5 * lost / states[0].floors[0])


def test_a_refused_change_leaves_its_neighbours_where_they_were():
    truth = [(Rectangle(4.0, 5.0, 40.0, 30.0), RED), (Circle(24.0, 20.0, 9.0), BLUE)]
    goal = goal_of(picture(truth, 48, 56))
    state = settle(begin(Drawing(56, 48, tuple(Shape(fill, (outline,), "x") for outline, fill in truth)), goal))
    away = state.outlines[0].moved(np.array([30.0, 0.0, 0.0, 0.0])), state.outlines[1].moved(np.array([9.0, 0.0, 0.0]))
    kept = judged(state, state.with_outlines(dict(enumerate(away))), 1.0)
    assert kept.stack.cost == pytest.approx(state.stack.cost, abs=1e-6)


def test_outlines_that_rest_are_looked_at_again_when_the_picture_beneath_them_changes():
    truth = [(Rectangle(4.0, 5.0, 40.0, 30.0), RED), (Circle(24.0, 20.0, 9.0), BLUE)]
    goal = goal_of(picture(truth, 48, 56))
    settled = settle(begin(Drawing(56, 48, tuple(Shape(fill, (outline,), "x") for outline, fill in truth)), goal))
    away = settled.outlines[1].moved(np.array([0.3, 0.0, 0.0]))
    changed = settled.with_layers([settled.layers[0], replace(settled.layers[1], outlines=[away])])
    noticed = changed.stack.changed(settled.stack, changed.owners, 2, NOTICED)
    assert noticed.tolist() == [False, True]
    disc = settle(changed).outlines[1].outline()
    assert (disc.cx, disc.cy, disc.r) == pytest.approx((24.0, 20.0, 9.0), abs=3e-3)


def test_only_what_has_changed_is_fitted_until_the_picture_beneath_the_rest_changes():
    shapes = [(Circle(15.0, 20.0, 8.0), RED), (Circle(45.0, 20.0, 8.0), BLUE)]
    target = picture(shapes, 40, 60)
    off = tuple(Shape(fill, (replace(each, cx=each.cx + 0.4),), "") for each, fill in shapes)
    state = begin(Drawing(60, 40, off), goal_of(target))
    left, right = settle(state, changed=np.array([True, False])).outlines
    assert left.outline().cx == pytest.approx(15.0, abs=0.01)
    assert right is state.outlines[1]


def test_the_finish_of_a_jpeg_trusts_luma_more_than_chroma():
    ground, disc, space = Rectangle(0.0, 0.0, 48.0, 48.0), Circle(24.2, 23.7, 14.3), seen_as(Condition(1.0, jpeg=True))
    target = picture([(ground, YELLOW), (disc, BLUE)], 48, 48) @ space
    target[..., 1:3] = np.roll(target[..., 1:3], 1, axis=1)
    target = target @ np.linalg.inv(space)
    drawing = Drawing(48, 48, (Shape(YELLOW, (ground,), "x"), Shape(BLUE, (disc,), "y")))
    off = []
    for goal in (goal_of(target), goal_of(target, space=space)):
        found = drawn(drawing, settle(begin(drawing, goal))).shapes[1].outlines[0]
        off.append(abs(found.cx - disc.cx))
    assert off[0] > 0.3 and off[1] < 0.5 * off[0]


def test_a_ring_is_not_turned_over_by_a_hidden_loop_that_outgrows_the_one_that_shows():
    # A bow: its left loop shows, and is to become smaller than the right one, which runs the other way.
    bow = polygon(np.array([[10.0, 8.0], [30.0, 20.0], [50.0, 31.0], [50.0, 9.0], [30.0, 20.0], [10.0, 32.0]]))
    shown, cover = polygon(np.array([[16.0, 12.0], [26.0, 18.0], [26.0, 22.0], [16.0, 28.0]])), (26.0, 4.0, 30.0, 32.0)
    goal = goal_of(picture([(shown, RED), (Rectangle(*cover), BLUE)], 40, 60))
    drawing = Drawing(60, 40, (Shape(RED, (bow,), "red"), Shape(BLUE, (Rectangle(*cover),), "blue")))
    after = settle(begin(drawing, goal))
    assert after.stack.cost < begin(drawing, goal).stack.cost
    assert begin(drawn(drawing, after), goal).stack.cost == pytest.approx(after.stack.cost)


def test_the_finish_leaves_the_canvas_border_and_a_hole_in_place():
    ground = Rectangle(0.0, 0.0, 40.0, 40.0)
    hole = Circle(20.0, 20.0, 8.0)
    truth = picture([(ground, RED)], 40, 40) * (1.0 - covered(hole, 40, 40)[..., None])
    off = Drawing(40, 40, (Shape(RED, (ground, Circle(20.3, 19.8, 8.2)), "ring"),))
    outer, inner = finish(off, truth).shapes[0].outlines
    assert (outer.x, outer.y, outer.width, outer.height) == (0.0, 0.0, 40.0, 40.0)
    assert (inner.cx, inner.cy, inner.r) == pytest.approx((20.0, 20.0, 8.0), abs=2e-3)


def test_what_was_drawn_as_exact_areas_is_fitted_closer_than_samples_allow():
    body = (
        '<path fill="#206040" fill-rule="evenodd" d="M12 20C30 2 50 30 70 14s40-4 44 16-20 22-18 40 10 30-10 36-30-12'
        '-46-6-34 8-36-14S-2 36 12 20zM40 40c10-8 22-4 26 6s-4 22-16 20-20-18-10-26z"/>'
    )

    def drawn_at(size, mode):
        document = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 128 128" shape-rendering="{mode}">{body}</svg>'
        )
        return rerender(document.encode(), size, size, renderer="resvg").pixels[..., 3] / 255.0

    areas = np.rint(255.0 * drawn_at(2048, "crispEdges").reshape(128, 16, 128, 16).mean(axis=(1, 3))) / 255.0
    green = np.array([32.0, 96.0, 64.0, 255.0]) / 255.0
    drawing = draw((areas[..., None] * green).astype(np.float32))
    text = write_drawing(drawing, title="t", comment="c").encode()
    off = rerender(text, 512, 512, renderer="resvg").pixels[..., 3] / 255.0 - drawn_at(512, "geometricPrecision")
    assert -10.0 * np.log10((off**2).mean()) > 45.4
