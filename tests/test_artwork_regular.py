"""What the picture itself blurs: edges sampled to a quarter of a pixel, on the canvas's rim, and in seams."""

import numpy as np
import pytest
from red_rings import red_outline, red_picture
from test_artwork_draw import BLUE, RED, WHITE, box, disc, painted
from test_artwork_finish import covered

from cubicsplat_cli.artwork.finish.state import begin, goal_of
from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Rectangle
from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.artwork.layers.seams import without_seams
from cubicsplat_cli.artwork.regions.regions import FlatPicture, find_regions
from cubicsplat_cli.artwork.regions.sampling import samples_across
from cubicsplat_cli.artwork.regularities.grid import on_grid
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.artwork.vectorize import draw

UNIT = 128 / 18  # px


def regions_of(levels, *fills):
    return find_regions(FlatPicture(levels, np.array(fills, dtype=float) * 255.0))


@pytest.mark.parametrize(("fine", "expected"), [(4, 4), (16, 0)])
def test_the_samples_of_a_picture_are_told_from_its_blends(fine, expected):
    levels = as_levels(painted(64, 64, (disc(30.3, 32.6, 20.25), RED), ground=WHITE, fine=fine))
    assert samples_across(levels, regions_of(levels, RED, WHITE)) == expected


def units(*numbers):
    return [number * UNIT for number in numbers]


def test_edges_sampled_to_a_quarter_of_a_pixel_are_brought_onto_the_artists_grid():
    shapes = ((box(*units(2, 3, 11, 7)), RED), (box(*units(4, 9, 15, 16)), BLUE), (disc(*units(13, 5, 1.5)), BLUE))
    drawing = draw(painted(128, 128, *shapes, ground=WHITE, fine=4))
    boxes = {shape.outlines[0].y: shape.outlines[0] for shape in drawing.shapes[1:] if hasattr(shape.outlines[0], "x")}
    assert sorted(boxes) == pytest.approx(units(3, 9), abs=1e-9)
    first, second = (boxes[y] for y in sorted(boxes))
    assert [first.x, first.width, first.height] == pytest.approx(units(2, 9, 4), abs=1e-9)
    assert [second.x, second.width, second.height] == pytest.approx(units(4, 11, 7), abs=1e-9)


def test_an_ellipse_whose_half_axes_are_one_on_the_grid_is_a_circle():
    boxes = [Rectangle(8.0 * a, 8.0 * b, 8.0 * c, 8.0 * d) for a, b, c, d in ((1, 1, 3, 2), (5, 2, 4, 3), (2, 9, 5, 4))]
    shapes = [*boxes, Ellipse(96.02, 88.01, 24.02, 23.97), Ellipse(96.0, 30.0, 16.01, 20.02)]
    drawing = Drawing(128, 128, tuple(Shape((255, 255, 255, 255), (shape,), "x") for shape in shapes))
    goal = goal_of(np.clip(sum(covered(shape, 128, 128)[..., None] for shape in shapes), 0.0, 1.0).repeat(4, axis=2))
    snapped, _ = on_grid(drawing, begin(drawing, goal))
    assert snapped.shapes[3].outlines == (Circle(96.0, 88.0, 24.0),)
    assert snapped.shapes[4].outlines[0].rx == 16.0 and snapped.shapes[4].outlines[0].ry == 20.0


def test_edges_off_any_grid_stay_where_they_are():
    edges = (17.31, 23.87, 61.13, 52.71)
    rectangle = draw(painted(128, 96, (box(*edges), RED), ground=WHITE, fine=16)).shapes[1].outlines[0]
    found = (rectangle.x, rectangle.y, rectangle.x + rectangle.width, rectangle.y + rectangle.height)
    assert found == pytest.approx(edges, abs=0.04)


@pytest.mark.parametrize("ground", [WHITE, (0.0, 0.0, 0.0, 0.0)])
def test_an_edge_within_the_last_row_is_found_there(ground):
    drawing = draw(painted(64, 64, (box(10.0, 20.0, 50.0, 63.6), RED), ground=ground, fine=10))
    (red,) = (shape.outlines[0] for shape in drawing.shapes if shape.fill == (255, 0, 0, 255))
    assert red.y + red.height == pytest.approx(63.6, abs=0.03)


def test_a_seam_between_shapes_that_abut_is_mended():
    picture = np.zeros((40, 40, 4))
    picture[:, :20] = RED
    picture[:, 21:] = BLUE
    # Red covers 0.3 of the column, blue in front of it the other 0.7.
    picture[:, 20] = 0.3 * np.array(RED) * 0.3 + 0.7 * np.array(BLUE)
    levels = as_levels(picture.astype(np.float32))
    mended = without_seams(levels, regions_of(levels, RED, BLUE))
    assert mended[:, 20] == pytest.approx(
        np.tile(255.0 * (0.3 * np.array(RED) + 0.7 * np.array(BLUE)), (40, 1)), abs=6.0
    )
    assert (np.delete(mended, 20, axis=1) == np.delete(levels, 20, axis=1)).all()


def test_a_clean_picture_has_no_seams():
    levels = as_levels(painted(64, 64, (disc(30.3, 32.6, 20.25), RED), ground=WHITE))
    regions = regions_of(levels, RED, WHITE)
    assert without_seams(levels, regions) is levels


# An arrow that points to the right, its head at 45 degrees.
ARROW = "M-44 -8H8L-12 -28H12L40 0 12 28H-12L8 8H-36C-42 8 -46 0 -44 -8z"


@pytest.mark.parametrize("turn", [0.0, 2.0])
def test_sloping_lines_have_the_directions_that_the_picture_shows(turn):
    ring = red_outline(draw(red_picture(ARROW, [f"translate(63.27 60.61) rotate({turn})"], 128, 128))).ring()
    ways = np.roll(ring.anchors, -1, axis=0) - ring.anchors
    ways = ways[ring.lines & (np.hypot(*ways.T) > 15.0)]
    angles = np.degrees(np.arctan2(ways[:, 1], ways[:, 0])) % 180.0
    found = sorted(angles[np.abs(angles % 90.0 - 45.0) < 25.0].tolist())
    assert found == pytest.approx([45.0 + turn] * 2 + [135.0 + turn] * 2, abs=0.2)
