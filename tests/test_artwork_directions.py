"""Lines at 45 degrees, and at 30 and 60: found where they are, exactly so in the file, and nowhere else."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from red_rings import assert_jacobian, red_outline, red_picture

from cubicsplat_cli.artwork.finish.parameters import Constraints, Pins, parametrised
from cubicsplat_cli.artwork.finish.settle import LONGEST
from cubicsplat_cli.artwork.geometry.outlines import Ring, polygon
from cubicsplat_cli.artwork.geometry.transforms import RigidTransform
from cubicsplat_cli.artwork.regularities.grid import directed, has_diagonal
from cubicsplat_cli.artwork.regularities.ties import null_basis, on_steps, tied_ring
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.svg.drawing_reader import read_drawing
from cubicsplat_cli.svg.drawing_writer import write_drawing

SIZE = 128
# An arrow that points to the right, its head at 45 degrees, with a round tail that keeps it from being its own mirror
# image about a level axis.
ARROW = "M-44 -8H8L-12 -28H12L40 0 12 28H-12L8 8H-36C-42 8 -46 0 -44 -8z"
# A kite with sides at 30 and 60 degrees.
KITE = "M0 -34L29.445 17 0 34 -29.445 17z"


def ring_of(path, place):
    """The one red ring of the file that is made of a picture of the path."""
    drawing = read_drawing(write_drawing(draw(red_picture(path, [place], SIZE, SIZE)), title="x", comment="y"))
    return red_outline(drawing).ring()


def degrees(ring, longest=15.0):
    """The directions, from 0 to 180, of the lines that are longer than so many px."""
    ways = np.roll(ring.anchors, -1, axis=0) - ring.anchors
    ways = ways[ring.lines & (np.hypot(*ways.T) > longest)]
    return sorted((np.degrees(np.arctan2(ways[:, 1], ways[:, 0])) % 180.0).tolist())


def test_lines_at_45_degrees_are_so_in_the_file_to_its_last_digit():
    ring = ring_of(ARROW, "translate(63.27 60.61)")
    steps = np.rint(1000.0 * (np.roll(ring.anchors, -1, axis=0) - ring.anchors)).astype(int)
    sloping = ring.lines & (steps != 0).all(axis=1) & (np.abs(steps) > 12000).all(axis=1)
    assert sloping.sum() == 4
    assert (np.abs(steps[sloping, 0]) == np.abs(steps[sloping, 1])).all()


def test_lines_that_are_off_by_two_degrees_stay_so():
    found = [angle for angle in degrees(ring_of(ARROW, "translate(63.27 60.61) rotate(2)")) if angle % 90.0 > 20.0]
    assert found == pytest.approx([47.0, 47.0, 137.0, 137.0], abs=0.4)


def test_lines_that_are_off_by_half_a_pixel_stay_so():
    ring = ring_of("M-30 -30L0.5 0 -30 30z", "translate(70.2 60.3)")
    tip = ring.anchors[ring.anchors[:, 0].argmax()] - ring.anchors[:, 0].min()
    assert tip[0] == pytest.approx(30.5, abs=0.1)


def test_lines_at_30_and_60_degrees_are_so_where_there_are_many():
    found = degrees(ring_of(KITE, "translate(60.3 58.7)"))
    assert found == pytest.approx([30.0, 60.0, 120.0, 150.0], abs=math.degrees(0.02 / 30.0))


def house(jitter=0.0):
    """A ring with lines at 45 and 135 degrees, the second off by so many px, level and upright ones, and a cubic."""
    ring = polygon(np.array([[10.0, 20.0], [20.0, 10.0], [30.0, 20.0 + jitter], [30.0, 40.0], [10.0, 40.0]]))
    controls = ring.controls.copy()
    controls[4] = [[6.0, 34.0], [7.0, 27.0]]
    return Ring(ring.anchors, controls, np.array([True, True, True, True, False]), ring.smooth)


SLOPES = [(0, math.radians(135.0)), (1, math.radians(45.0))]


@given(st.lists(st.floats(-1.4, 1.4), min_size=20, max_size=20))
def test_directed_lines_stay_so_however_the_ring_moves(steps):
    free = tied_ring(parametrised(house(0.3), Constraints(64, 64)))
    ring = directed(free, SLOPES)
    step = np.array(steps[: ring.jacobian.shape[1]])
    # As far as the finish lets control points move.
    step *= min(1.0, LONGEST / max(np.abs(ring.jacobian.times(step)).max(), 1e-9))
    moved = ring.moved(step)
    ways = np.diff(moved.outline().anchors[:3], axis=0)
    assert np.abs(np.abs(ways[:, 0]) - np.abs(ways[:, 1])).max() < 1e-9
    assert ring.jacobian.shape[1] == free.jacobian.shape[1] - 2


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_directed_ring_on_steps_is_as_regular(across, down):
    ring = RigidTransform((1.0, 1.0), (across, down)).outline(house(0.3))
    found = directed(tied_ring(parametrised(ring, Constraints(64, 64))), SLOPES)
    placed = on_steps(found, 0.01).outline()
    assert np.abs(100.0 * placed.anchors - np.rint(100.0 * placed.anchors)).max() < 1e-6
    assert np.abs(placed.anchors - found.outline().anchors).max() < 0.02
    assert has_diagonal(placed)


def test_the_jacobian_of_a_directed_ring_matches_finite_differences():
    ring = directed(tied_ring(parametrised(house(), Constraints(64, 64))), SLOPES)
    assert_jacobian(ring)


def test_a_line_between_fixed_points_is_left_alone():
    ring = polygon(np.array([[0.0, 20.0], [30.0, 0.0], [64.0, 40.0], [0.0, 50.0]]))
    constraints = Constraints(64, 64, Pins(x=(30.0,), y=(20.0,)))
    assert directed(tied_ring(parametrised(ring, constraints)), [(0, math.radians(150.0))]) is None


@given(st.lists(st.dictionaries(st.integers(0, 7), st.sampled_from([-2.0, -1.0, 0.5, 1.0]), min_size=1), max_size=9))
def test_what_follows_from_equations_fulfils_them_and_nothing_more(equations):
    matrix = np.zeros((len(equations), 8))
    for row, equation in zip(matrix, equations, strict=True):
        row[list(equation)] = list(equation.values())
    basis = null_basis(8, equations).toarray()
    assert np.abs(matrix @ basis).max(initial=0.0) < 1e-7
    assert basis.shape[1] == 8 - (np.linalg.matrix_rank(matrix) if len(matrix) else 0)
    assert np.linalg.matrix_rank(basis) == basis.shape[1]
