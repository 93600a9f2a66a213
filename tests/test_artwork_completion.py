"""What goes on beneath: outlines behind what hides them, in the simplest way that stays hidden."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
from conftest import rest_slow
from hypothesis import assume, given
from hypothesis import strategies as st
from test_artwork_draw import box, disc

from benchmarks.artwork.document import Document
from cubicsplat_cli.artwork.geometry.outlines import Circle, Rectangle, polygon
from cubicsplat_cli.artwork.layers.completion import hidden_runs, outlines_of
from cubicsplat_cli.artwork.layers.extents import Contour, Extent, Window, enclosed
from cubicsplat_cli.artwork.layers.ways import End, HiddenLoop, by_cubic, ends_of, min_link_path
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.raster.ndimage import holes_of
from cubicsplat_cli.raster.outlines import coverage, misplaced

FINE = 8


def picture(size: int, *layers: tuple[object, tuple[float, float, float]]) -> np.ndarray:
    """White with layers (a function of x and y, colour) from back to front, (size, size, 3) in [0, 1]."""
    y, x = (np.mgrid[: size * FINE, : size * FINE] + 0.5) / FINE
    image = np.ones((*x.shape, 3))
    for inside, colour in layers:
        image = np.where(inside(x, y)[..., None], colour, image)
    return image.reshape(size, FINE, size, FINE, 3).mean(axis=(1, 3)).astype(np.float32)


RED, BLUE = (0.8, 0.1, 0.1), (0.1, 0.2, 0.7)


@pytest.mark.parametrize("top", rest_slow(10.0, 60.0))
def test_a_disc_of_which_half_shows_is_a_circle(top):
    # The bar hides the upper or the lower half; the disc's other half is as high as the part that shows.
    found = draw(picture(120, (disc(60.0, 60.0, 30.0), RED), (box(5.0, top, 115.0, top + 50.0), BLUE)))
    circles = [outline for shape in found.shapes for outline in shape.outlines if isinstance(outline, Circle)]
    assert len(circles) == 1
    assert (circles[0].cx, circles[0].cy, circles[0].r) == pytest.approx((60.0, 60.0, 30.0), abs=0.3)
    assert any(isinstance(outline, Rectangle) for shape in found.shapes[1:] for outline in shape.outlines)


def half_hidden(bend: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A circle of radius 40 with `bend` radians of it, about its top, replaced by the chord: points, sigma, the run."""
    angle = np.arange(250) * 2.0 * math.pi / 250
    points = 60.0 + 40.0 * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    hidden = np.minimum(angle, 2.0 * math.pi - angle) < 0.5 * bend
    sigma = np.where(hidden, np.inf, 0.05)
    (run,) = hidden_runs(sigma)
    ends = points[[run[0] - 1, run[-1] + 1]]
    t = np.linspace(0.0, 1.0, len(run) + 2)[1:-1, None]
    points[run] = ends[0] * (1.0 - t) + ends[1] * t
    return points, sigma, run


def window_in(shown: np.ndarray, hidden: np.ndarray) -> Window:
    """The window, all of a canvas, of an outline that may enclose what is hidden, and nothing around it."""
    extent = Extent(0, 0, shown, hidden | shown, np.zeros_like(shown), ())
    return replace(Window.of(extent, shown.shape), must=~hidden)


def continued(points, sigma, run, wrong):
    """The points of the cubic that goes on along a hidden run; None without one."""
    nothing = np.zeros((1, 1), dtype=bool)
    loop = HiddenLoop(points, sigma, wrong, window_in(nothing, nothing))
    found = next(by_cubic(loop, run, ends_of(points, sigma, run)), None)
    return None if found is None else found.points


def test_an_arc_goes_on_as_the_arc_that_it_was():
    points, sigma, run = half_hidden(1.2)
    found = continued(points, sigma, run, lambda _: 0)
    assert np.abs(np.hypot(*(found - 60.0).T) - 40.0).max() < 0.8
    # In order, and evenly.
    assert np.ptp(np.hypot(*np.diff(found, axis=0).T)) < 0.05


def test_what_turns_too_far_or_does_not_stay_hidden_is_not_continued():
    assert continued(*half_hidden(4.2), lambda _: 0) is None
    points, sigma, run = half_hidden(2.6)
    assert continued(points, sigma, run, lambda _: 5) is None
    # Of the cubics the first is taken that stays hidden, here below a height.
    free = continued(points, sigma, run, lambda _: 0)
    highest = float(free[:, 1].min()) + 2.0
    low = continued(points, sigma, run, lambda trial: int((trial[:, 1] < highest).sum()))
    assert low[:, 1].min() >= highest - 0.5


def test_nothing_is_continued_from_too_few_points():
    points, sigma, _ = half_hidden(1.2)
    sigma[40:215] = np.inf
    sigma[[38, 39, 216]] = np.inf
    runs = hidden_runs(sigma)
    assert continued(points, np.where(np.arange(250) < 36, np.inf, sigma), runs[0], lambda _: 0) is None


def corners_of(found, fill):
    (shape,) = (shape for shape in found.shapes if np.abs(np.array(shape.fill[:3]) / 255.0 - fill).max() < 0.02)
    return shape.outlines[0].ring().anchors


def test_straight_sides_go_on_until_they_meet():
    # The triangle's lower right corner lies beneath the disc.
    def triangle(x, y):
        return (y < 90.0) & (x < 95.0) & (y - 20.0 > 70.0 * (95.0 - x) / 75.0)

    found = draw(picture(130, (triangle, RED), (disc(95.0, 90.0, 22.0), BLUE)))
    anchors = corners_of(found, RED)
    assert len(anchors) == 3
    assert np.hypot(*(anchors - [95.0, 90.0]).T).min() < 0.5


def test_taut_lines_stay_within_what_hides_them():
    hidden = np.zeros((60, 60), dtype=bool)
    hidden[5:55, 5:15] = hidden[45:55, 5:55] = True
    shown = np.zeros_like(hidden)
    shown[0:5, 5:15] = shown[45:55, 55:60] = True
    room = window_in(shown, hidden)
    down, right = np.arange(5.5, 50.0), np.arange(12.5, 55.0)
    run = np.concatenate(
        [np.stack([np.full_like(down, 12.0), down], 1), np.stack([right, np.full_like(right, 48.0)], 1)]
    )
    found = list(
        min_link_path(run, End(run[0], np.array([0.0, 1.0]), True), End(run[-1], np.array([-1.0, 0.0]), True), room)
    )
    assert found
    corners = found[0]
    # One on each tangent, one about the bend.
    assert len(corners) <= 3
    t = np.linspace(0.0, 1.0, 200)[:, None]
    for a, b in pairwise(corners):
        assert room.at(hidden, a * (1.0 - t) + b * t).all()


def test_nothing_taut_leads_through_what_shows():
    hidden = np.zeros((40, 40), dtype=bool)
    hidden[10:20, 5:15] = hidden[10:20, 25:35] = True
    room = window_in(np.zeros_like(hidden), hidden)
    run = np.stack([np.arange(7.5, 33.0), np.full(26, 15.0)], axis=1)
    assert list(min_link_path(run, End(run[0], None, False), End(run[-1], None, False), room)) == []


def test_without_completion_what_is_hidden_ends_shortly():
    half = picture(120, (disc(60.0, 60.0, 30.0), RED), (box(5.0, 60.0, 115.0, 110.0), BLUE))
    lowest = {}
    for choice in ("on", "off"):
        found = draw(half, ArtworkSettings(completion=choice))
        lowest[choice] = max(corners_of(found, RED)[:, 1])
    assert lowest["on"] == pytest.approx(90.0, abs=0.5)
    assert 61.0 < lowest["off"] < 70.0


@pytest.mark.parametrize("choice, pieces", [("on", 1), ("off", 2)])
def test_pieces_of_one_fill_become_one_only_with_completion(choice, pieces):
    crossing = picture(120, (box(0.0, 40.0, 120.0, 60.0), RED), (box(50.0, 0.0, 70.0, 120.0), BLUE))
    found = draw(crossing, ArtworkSettings(completion=choice))
    red = [shape for shape in found.shapes if shape.fill[0] > 150 and shape.fill[2] < 100]
    assert len(red) == pieces


def test_completion_is_on_or_off():
    with pytest.raises(UsageError, match="completion"):
        ArtworkSettings(completion="maybe")
    assert ArtworkSettings(completion="off").public()["completion"] == "off"


def test_stripes_beneath_a_stripe_stay_rectangles():
    stripes = picture(90, (box(0.0, 0.0, 90.0, 30.2), RED), (box(0.0, 30.2, 90.0, 60.4), BLUE))
    found = draw(stripes)
    assert all(isinstance(outline, Rectangle) for shape in found.shapes for outline in shape.outlines)


@pytest.mark.parametrize("bottom", [80, 60])
def test_panels_beneath_a_bar_are_boxes(bottom):
    """A bar over two panels, or one that ends above the canvas's border: nothing hidden bends or slants."""
    picture = np.ones((80, 120, 3), dtype=np.float32)
    picture[18:bottom, :35], picture[:18] = 0.6, (0.0, 0.4, 0.7)
    shapes = draw(picture).shapes
    assert [type(outline) for shape in shapes for outline in shape.outlines] == [Rectangle] * 3
    x, y, right, low = (f(shapes[1].outlines[0].ring().anchors[:, k]) for f, k in product((min, max), (0, 1)))
    assert (x, right, low) == pytest.approx((0.0, 35.0, bottom), abs=0.02) and y < 18.0


@pytest.mark.parametrize("several", [False, True])
def test_cells_of_a_table_are_boxes_each_for_itself(several):
    """Outlines that turn where they meet do not show that one goes on beneath another, nor that two are pieces."""
    row, column = np.mgrid[:5, :5]
    number = (2 * row + column) % 5 if several else 5 * row + column
    colours = np.random.default_rng(2).integers(0, 256, (25, 3)) / 255.0
    shapes = draw(np.kron(colours[number], np.ones((20, 20, 1))).astype(np.float32)).shapes
    boxes = [outline for shape in shapes for outline in shape.outlines]
    assert len(boxes) == 25 and all(isinstance(box, Rectangle) for box in boxes)


def test_bars_on_a_thin_line_end_beneath_it():
    text = (Path(__file__).parent.parent / "samples" / "artwork" / "chart.svg").read_bytes()
    pixels = Document(text, "chart", 256).draw()[..., :3].astype(np.float32) / 255.0
    bars = [shape.outlines[0] for shape in draw(pixels).shapes if shape.fill[2] in (43, 167)]
    assert len(bars) == 2
    assert all(isinstance(bar, Rectangle) and bar.y + bar.height < 129.7 for bar in bars)


def test_what_shows_one_side_is_no_box():
    """It would be a hairline from one end of the canvas to the other."""
    hidden = np.ones((40, 40), dtype=bool)
    side = np.column_stack([np.full(12, 20.1) + 0.1 * np.sin(np.arange(12)), np.arange(12) + 14.5])
    points = np.concatenate([side, np.add(side[::-1], [0.6, 0.0])])
    contour = Contour(points, np.repeat([0.1, np.inf], 12), True)
    (found,) = outlines_of(Extent(0, 0, hidden, ~hidden, ~hidden, (contour,)), (40, 40), 1.0)
    assert np.ptp(found.ring().anchors, axis=0).max() < 14.0


def test_what_shows_a_round_corner_is_no_box():
    text = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 120 80"><rect width="120" height="80" fill="#fff"/>'
    text += '<path d="M20-9H90V50A12 12 0 0 1 78 62H20z" fill="#999"/><path d="M0 0H120V18H0z" fill="#06b"/></svg>'
    pixels = rerender(text.encode(), 120, 80).pixels[..., :3].astype(np.float32) / 255.0
    assert not any(isinstance(shape.outlines[0], Rectangle) for shape in draw(pixels).shapes if shape.fill[0] == 153)


def test_a_loop_that_runs_the_other_way_is_covered_too():
    eight = polygon(np.array([[2.0, 2.0], [10.0, 10.0], [18.0, 2.0], [18.0, 10.0], [10.0, 2.0], [2.0, 10.0]]))
    covered = coverage(eight.cubics, eight.lines, 0, 0, 12, 20)
    assert covered[5, 3] == pytest.approx(1.0) and covered[5, 16] == pytest.approx(1.0)
    assert covered[3, 10] == pytest.approx(1.0) and covered[0, 0] == 0.0


def test_an_outline_that_leaves_its_window_over_the_canvas_is_seen():
    shown = np.ones((8, 20), dtype=bool)
    square = np.array([[10.0, 20.0], [30.0, 20.0], [30.0, 28.0], [10.0, 28.0]])
    contour = Contour(square, np.full(4, 0.1), False)
    extent = Extent(20, 10, shown, shown, np.zeros_like(shown), (contour,))
    window = Window.of(extent, (40, 40))
    assert len(window.wrong(polygon(square))) == 0
    # Two sides go on until they meet, beyond the canvas.
    assert len(window.wrong(polygon(np.array([[10.0, 20.0], [20.0, -50.0], [30.0, 20.0], [30.0, 28.0], [10.0, 28.0]]))))


@given(st.lists(st.tuples(*[st.floats(-4.0, 30.0)] * 2), min_size=3, max_size=8), st.integers(0, 999), st.booleans())
def test_misplaced_is_what_an_outline_may_not_enclose_or_leaves_though_it_must(corners, seed, more):
    ring, (top, left), box = polygon(np.array(corners)), (3, 2), (slice(2, 9), slice(4, 15))
    may, must, besides = np.random.default_rng(seed).random((3, 16, 18)) < 0.5
    must, besides = must[box], besides[box] & more
    covered = coverage(ring.cubics, ring.lines, top, left, *may.shape)
    assume(np.abs(covered - 0.5).min() > 1e-6)
    allowed, wrong = may.copy(), np.zeros_like(may)
    wrong[box], allowed[box] = must, may[box] | besides
    wrong = np.where(covered > 0.5, ~allowed, wrong)
    found = misplaced(ring.cubics, ring.lines, (top, left), may, box, must, besides if more else None)
    assert (found == np.argwhere(wrong)[:, ::-1] + [left, top] + 0.5).all() and len(found) == wrong.sum()


@pytest.mark.parametrize(("top", "left"), [(0, 0), (200, 200), (55, 55), (0, 200), (40, 45)])
def test_only_what_an_outline_reaches_of_a_window_is_looked_at(top, left):
    wedge = polygon(np.array([(50.0, 50.5), (60.2, 50.0), (55.0, 70.0)]))
    whole = np.zeros((40, 20), dtype=bool)
    reached, own = enclosed(wedge, Extent(top, left, whole, whole, whole, ()))
    whole[reached] = own
    assert (whole == (coverage(wedge.cubics, wedge.lines, top, left, 40, 20) > 0.5)).all()
    assert own.size <= 11 * 20  # px


def test_a_hole_lies_within_the_outer_contour_of_a_thin_shape():
    shown = np.zeros((40, 40), dtype=bool)
    shown[10:30, 10:30] = True
    shown[12:28, 12:28] = False
    contours = [
        Contour(np.array([[a, a], [b, a], [b, b], [a, b]], dtype=float), np.full(4, 0.1), hole)
        for a, b, hole in ((10, 30, False), (12, 28, True))
    ]
    extent = Extent(0, 0, shown, shown, holes_of(shown), tuple(contours))
    window = Window.of(extent, (40, 40)).hole(contours[1])
    assert len(window.wrong(polygon(contours[1].points))) == 0
    # Nothing of the thin shape itself is so far from its edges that a hole surely must not have it.
    assert len(window.wrong(Circle(20.0, 4.0, 24.0)))


@pytest.mark.parametrize("width", [1, 2])
def test_a_gap_of_few_px_is_not_closed_from_its_two_sides(width):
    shown = np.zeros((30, 30), dtype=bool)
    shown[10:20, 2:28] = True
    shown[10:20, 14 : 14 + width] = False
    window = Window.of(Extent(0, 0, shown, shown, np.zeros_like(shown), ()), (30, 30))
    across = Rectangle(2.0, 10.0, 26.0, 10.0)
    assert len(window.wrong(across)) >= 8 * width
    whole = np.zeros_like(shown)
    whole[10:20, 2:28] = True
    # Around a part there is a px of tolerance.
    wide = Window.of(Extent(0, 0, whole, whole, np.zeros_like(whole), ()), (30, 30))
    assert len(wide.wrong(Rectangle(1.0, 9.0, 28.0, 12.0))) == 0


def test_a_hole_does_not_reach_into_another_one():
    shown, cover = np.zeros((40, 60), dtype=bool), np.zeros((40, 60), dtype=bool)
    shown[5:35, 5:55] = True
    cover[10:30, 28:32] = True  # lies above the bar between the two holes
    left, right = ((slice(10, 30), slice(*x)) for x in ((10, 28), (32, 50)))
    shown[left] = shown[right] = False
    corners = np.array([[10, 10], [28, 10], [28, 30], [10, 30]], dtype=float)
    contour = Contour(corners, np.array([0.1, np.inf, np.inf, 0.1]), True)
    extent = Extent(0, 0, shown & ~cover, shown, holes_of(shown), (contour,))
    window = Window.of(extent, (40, 60)).hole(contour)
    assert len(window.wrong(Rectangle(10.0, 10.0, 20.0, 20.0))) == 0  # beneath the cover
    assert len(window.wrong(Rectangle(10.0, 10.0, 30.0, 20.0))) > 100
