"""Rings that are their own images by parts of a turn: found where they are, exact in the file, and nowhere else."""

import math

import numpy as np
import pytest
from conftest import rest_slow
from hypothesis import given
from hypothesis import strategies as st
from red_rings import assert_jacobian, red_outline, red_picture

from cubicsplat_cli.artwork.finish.parameters import Constraints, parametrised
from cubicsplat_cli.artwork.geometry.outlines import Ring, flattened, polygon
from cubicsplat_cli.artwork.regularities.alike import Track
from cubicsplat_cli.artwork.regularities.rotational import Rotation, rotated, rotational
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.raster.point_tree import PointTree
from cubicsplat_cli.svg.drawing_reader import read_drawing
from cubicsplat_cli.svg.drawing_writer import write_drawing

SIZE = 128


def corners(*radii, degrees=0.0):
    """Corners (n, 2) around (0, 0) at even angles, with so many px in turn."""
    angle = np.radians(degrees) + 2.0 * np.pi * np.arange(len(radii)) / len(radii)
    return np.array(radii)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def path_of(points):
    return "M" + "L".join(f"{x:.6f} {y:.6f}" for x, y in points) + "z"


def drawn(path, place="translate(63.3 64.6)"):
    return draw(red_picture(path, [place], SIZE, SIZE))


def unlike(ring, parts):
    """px by which the control points of a ring are off others when it is turned by an n-th."""
    z = ring.cubics @ np.array([1.0, 1.0j])
    turned = (z - ring.anchors.mean(axis=0) @ [1.0, 1.0j]) * np.exp(2.0j * np.pi / parts)
    own = z - ring.anchors.mean(axis=0) @ [1.0, 1.0j]
    return np.abs(turned - np.roll(own, -(ring.pieces // parts), axis=0)).max()


STAR = corners(*(50.0, 21.0) * 5, degrees=7.0)


def test_a_star_is_exactly_its_own_image_by_fifths_of_a_turn():
    drawing = drawn(path_of(STAR))
    ring = red_outline(drawing)
    assert ring.pieces == 10 and unlike(ring, 5) < 1e-6
    assert ring.anchors.mean(axis=0) == pytest.approx([63.3, 64.6], abs=0.01)
    # In the file to half a step of every coordinate, 0.001 px.
    assert unlike(red_outline(read_drawing(write_drawing(drawing, title="x", comment="y"))), 5) < 0.003


def test_a_gear_is_so_by_its_teeth():
    teeth = corners(*(40.0, 40.0, 48.0, 48.0) * 9, degrees=3.0)
    assert unlike(red_outline(drawn(path_of(teeth))), 9) < 1e-6


@pytest.mark.parametrize("off", rest_slow(0.5, -0.5))
def test_a_star_with_a_tip_that_is_longer_or_shorter_stays_so(off):
    points = STAR * np.where(np.arange(10) == 2, 1.0 + off / 50.0, 1.0)[:, None]
    ring = red_outline(drawn(path_of(points)))
    reach = np.sort(np.hypot(*(ring.anchors - [63.3, 64.6]).T))[-5:]
    assert (reach[-1] - reach[:-1].mean() if off > 0 else reach[0] - reach[1:].mean()) == pytest.approx(off, abs=0.1)


def test_a_star_with_a_tip_that_is_two_degrees_aside_stays_so():
    angle = np.radians(2.0)
    points = STAR.copy()
    points[2] = points[2] @ [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    found = red_outline(drawn(path_of(points))).anchors - [63.3, 64.6]
    assert np.hypot(*(found[:, None] - points).transpose(2, 0, 1)).min(axis=0).max() < 0.1


def track_of(ring):
    points = flattened(ring, 0.5)
    return Track(points, PointTree(points), points, True)


def pinwheel(jitter=0.0):
    """A ring of three arms, each a line, a smooth joint and a cubic that ends in a corner."""
    part = np.array([[6.0, 1.0], [20.0, 3.0], [25.0, 9.0]])
    handles = np.array([[[23.0, 3.0 + 3.0 / 7.0], [26.0, 6.0]], [[20.0, 14.0], [8.0, 10.0]]])
    turns = [np.array([[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]]) for a in 2 * np.pi * np.arange(3) / 3]
    anchors = np.concatenate([part @ turn for turn in turns]) + 32.0
    anchors[1] += jitter
    ends = np.roll(anchors, -1, axis=0)
    controls = np.stack([(2.0 * anchors + ends) / 3.0, (anchors + 2.0 * ends) / 3.0], axis=1)
    for k, turn in enumerate(turns):
        controls[3 * k + 1 : 3 * k + 3] = handles @ turn + [32.0, 32.0]
    return Ring(anchors, controls, np.tile([True, False, False], 3), np.tile([False, True, True], 3))


def test_a_part_stands_for_all():
    ring = pinwheel(0.05)
    parameters = parametrised(ring, Constraints(64, 64))
    found = rotated(parameters, track_of(ring))
    assert unlike(found.outline(), 3) < 1e-9 < 0.05 < unlike(ring, 3)
    # Of one part three anchors, an angle, and the lengths and handles of two cubics; and the middle.
    alone = parameters.jacobian.shape[1] // 3
    assert found.jacobian.shape[1] == alone + 2


@given(st.lists(st.floats(-0.5, 0.5), min_size=60, max_size=60))
def test_such_a_ring_stays_one_however_it_moves(steps):
    parameters = rotational(parametrised(pinwheel(), Constraints(64, 64)), Rotation(3, np.array([32.0, 32.0])))
    moved = parameters.moved(np.array(steps[: parameters.jacobian.shape[1]]))
    assert unlike(moved.outline(), 3) < 1e-9


def test_its_jacobian_matches_finite_differences():
    parameters = rotational(parametrised(pinwheel(), Constraints(64, 64)), Rotation(3, np.array([32.0, 32.0])))
    assert_jacobian(parameters)


def test_what_is_small_or_uneven_is_no_rotation():
    speck = polygon(corners(2.0, 2.1, 2.05, 2.1, degrees=10.0) * [1.0, 0.8] + 32.0)
    uneven = polygon(corners(20.0, 9.0, 20.0, 9.0, 21.0, 9.0) + 32.0)
    for ring in (speck, uneven):
        assert rotated(parametrised(ring, Constraints(64, 64)), track_of(ring)) is None


def test_a_star_keeps_the_tip_that_is_held_on_the_border():
    points = corners(*(20.0, 9.0) * 5)
    ring = polygon(points + np.array([[44.0, 32.0]]) + np.where(np.arange(10) == 3, 0.05, 0.0)[:, None])
    found = rotated(parametrised(ring, Constraints(64, 64)), track_of(ring))
    assert found.outline().anchors[0, 0] == 64.0 and unlike(found.outline(), 5) < 1e-9
    moved = found.moved(np.full(found.jacobian.shape[1], 0.1)).outline()
    assert moved.anchors[0, 0] == 64.0 and unlike(moved, 5) < 1e-9
