"""Rings that are their own mirror images: found where they are, exactly so in the file, and nowhere else."""

import numpy as np
import pytest
from conftest import rest_slow
from hypothesis import given
from hypothesis import strategies as st
from red_rings import assert_jacobian, dense, red_outline, red_picture

from cubicsplat_cli.artwork.finish.parameters import Constraints
from cubicsplat_cli.artwork.geometry.outlines import Ring, flattened, polygon
from cubicsplat_cli.artwork.regularities.alike import Track
from cubicsplat_cli.artwork.regularities.mirrored import (
    Axis,
    axis_of,
    mirrored_parameters,
    mirrored_rings,
    null_basis,
)
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.raster.point_tree import PointTree
from cubicsplat_cli.svg.drawing_reader import read_drawing
from cubicsplat_cli.svg.drawing_writer import write_drawing

SIZE = 160
# A shield: level above, bulging sides, a point below; {} px is where its right side bulges to.
SHIELD = "M40 30H120C{0} 60 {0} 80 112 100 100 122 90 132 80 140 70 132 60 122 48 100 30 80 30 60 40 30z"


def pictured(path, shift=0.0):
    return red_picture(path, [f"translate({shift})"], SIZE, SIZE)


def asymmetry(ring, at):
    """px by which the anchors and handles, mirrored, are off the nearest ones."""
    points = ring.cubics[:, :3].reshape(-1, 2)
    mirrored = np.abs(points * [-1.0, 1.0] + [2.0 * at, 0.0])
    return np.hypot(*(mirrored[:, None] - points).transpose(2, 0, 1)).min(axis=1).max()


@pytest.mark.parametrize("shift", rest_slow(0.37, 0.0))
def test_a_symmetric_shape_is_exactly_its_own_mirror_image(shift):
    ring = red_outline(draw(pictured(SHIELD.format(130.0), shift)))
    middle = 0.5 * (ring.anchors[:, 0].min() + ring.anchors[:, 0].max())
    assert middle == pytest.approx(80.0 + shift, abs=0.02)
    assert asymmetry(ring, middle) < 1e-6


def test_a_symmetric_shape_is_so_in_the_file_to_its_last_digit():
    drawing = read_drawing(write_drawing(draw(pictured(SHIELD.format(130.0))), title="x", comment="y"))
    ring = red_outline(drawing)
    assert asymmetry(ring, 0.5 * (ring.anchors[:, 0].min() + ring.anchors[:, 0].max())) < 1e-6


def test_a_shape_that_is_asymmetric_by_half_a_pixel_stays_so():
    # A cubic's middle moves by three quarters of what its handles do.
    ring = red_outline(draw(pictured(SHIELD.format(130.0 + 0.5 / 0.75))))
    points = flattened(ring)
    assert points[:, 0].max() - 80.0 == pytest.approx(80.0 - points[:, 0].min() + 0.5, abs=0.1)


def test_a_ring_that_is_exactly_symmetric_is_found_so():
    points = flattened(heart(), 0.5)
    track = Track(points, PointTree(points), points)
    found = axis_of(track, 0)
    assert found.at == pytest.approx(20.0, abs=1e-9)
    assert axis_of(track, 1) is None


def heart(jitter=0.0):
    anchors = np.array([[20.0, 12.0], [32.0 + jitter, 15.0], [20.0, 34.0], [8.0, 15.0]])
    controls = np.array(
        [
            [[22.0, 7.0], [32.0, 6.0]],
            [[32.0, 24.0], [22.0, 28.0]],
            [[18.0, 28.0], [8.0, 24.0]],
            [[8.0, 6.0], [18.0, 7.0]],
        ]
    )
    return Ring(anchors, controls, np.zeros(4, bool), np.array([False, True, False, True]))


@given(st.lists(st.floats(-0.5, 0.5), min_size=40, max_size=40))
def test_a_mirrored_ring_stays_one_however_it_moves(steps):
    for found in mirrored_rings(heart(0.3), Axis(0, 20.0)):
        parameters = mirrored_parameters(found, Constraints(40, 40))
        moved = parameters.moved(np.array(steps[: parameters.jacobian.shape[1]]))
        assert asymmetry(moved.outline(), 20.0) < 1e-9


def test_the_jacobian_of_a_mirrored_ring_matches_finite_differences():
    parameters = mirrored_parameters(mirrored_rings(heart(), Axis(0, 20.0))[0], Constraints(40, 40))
    assert_jacobian(parameters)


def test_a_mirrored_ring_has_about_half_of_the_variables():
    parameters = mirrored_parameters(mirrored_rings(heart(), Axis(0, 20.0))[0], Constraints(40, 40))
    # Two anchors on the axis (1 each), one beside it (2) with two lengths, and two handles at corners (2 each).
    assert parameters.jacobian.shape[1] == 2 + 2 + 2 + 4


def test_either_side_makes_a_ring_of_its_own():
    left, right = (found.ring.anchors[:, 0].max() for found in mirrored_rings(heart(0.3), Axis(0, 20.0)))
    assert sorted([left, right]) == pytest.approx([32.0, 32.3])


def test_one_line_or_cubic_runs_across_the_axis():
    box = polygon(np.array([[4.0, 4.0], [16.0, 4.0], [13.0, 9.0], [7.0, 9.0]]))
    assert [found.ring.pieces for found in mirrored_rings(box, Axis(0, 10.0))] == [4, 4]
    dome = Ring(
        np.array([[4.0, 10.0], [16.0, 10.0], [10.0, 14.0]]),
        np.array([[[4.0, 2.0], [16.0, 2.0]], [[14.0, 11.0], [12.0, 13.0]], [[8.0, 13.0], [6.0, 11.0]]]),
        np.array([False, True, True]),
        np.zeros(3, bool),
    )
    assert [found.ring.pieces for found in mirrored_rings(dome, Axis(0, 10.0))] == [3, 3]


def test_a_ring_that_crosses_its_axis_four_times_has_no_halves():
    letter = polygon(
        np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 4.0], [4.0, 4.0], [4.0, 8.0], [20.0, 8.0], [20.0, 12.0], [0.0, 12.0]])
    )
    assert mirrored_rings(letter, Axis(0, 12.0)) == []


def test_what_is_tied_to_something_fixed_or_to_its_own_opposite_is_fixed():
    matrix = dense(null_basis(6, [(0, 1, -1.0), (1, 2, 1.0), (3, -1, 1.0), (4, 4, -1.0)]))
    assert matrix[3:5].tolist() == [[0.0, 0.0], [0.0, 0.0]]
    assert (matrix[0] == -matrix[1]).all() and (matrix[1] == matrix[2]).all() and matrix[5].tolist() == [0.0, 1.0]
