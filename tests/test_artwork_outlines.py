import math

import numpy as np
import pytest

from cubicsplat_cli.artwork.geometry.outlines import (
    Circle,
    Ellipse,
    Rectangle,
    Ring,
    flattened,
    polygon,
    reversed_ring,
    signed_area,
)
from cubicsplat_cli.artwork.shapes import Drawing, Shape


def test_a_circles_ring_lies_on_the_circle():
    points = flattened(Circle(10.0, 20.0, 5.0).ring(), 0.2)
    radii = np.hypot(points[:, 0] - 10.0, points[:, 1] - 20.0)
    assert np.abs(radii - 5.0).max() < 5.0 * 3e-4


def test_a_turned_ellipse_satisfies_its_equation():
    ellipse = Ellipse(3.0, 4.0, 8.0, 2.0, 0.5)
    x, y = (flattened(ellipse.ring(), 0.2) - [3.0, 4.0]).T
    along, across = x * math.cos(0.5) + y * math.sin(0.5), y * math.cos(0.5) - x * math.sin(0.5)
    assert np.allclose((along / 8.0) ** 2 + (across / 2.0) ** 2, 1.0, atol=1e-3)


@pytest.mark.parametrize("angle", [0.0, 0.3])
def test_a_rounded_rectangle_has_the_area_of_its_formula(angle):
    ring = Rectangle(2.0, 3.0, 10.0, 6.0, 2.0, angle).ring()
    assert signed_area(ring) == pytest.approx(60.0 - (4.0 - math.pi) * 4.0, rel=1e-4)
    assert ring.anchors.mean(axis=0) == pytest.approx([7.0, 6.0])
    assert ring.smooth.all() and ring.lines.sum() == 4


def test_a_square_counts_its_coordinates_as_path_data():
    ring = polygon(np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]))
    assert ring.coordinates == 5  # M0 0 H4 V4 H0 Z
    assert signed_area(ring) == 16.0


def test_reversing_turns_the_area_and_keeps_the_curve():
    ring = Ring(
        np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0]]),
        np.array([[[1.0, -1.0], [3.0, -1.0]], [[4.0, 1.0], [5.0, 3.0]], [[2.0, 4.0], [1.0, 1.0]]]),
        np.array([False, False, False]),
        np.array([False, True, False]),
    )
    turned = reversed_ring(ring)
    assert signed_area(turned) == pytest.approx(-signed_area(ring))
    assert np.allclose(turned.anchors[0], ring.anchors[0]) and turned.smooth.tolist() == [False, False, True]
    assert np.allclose(reversed_ring(turned).cubics, ring.cubics)


def test_a_shape_turns_its_holes_against_its_outer_ring():
    shape = Shape((255, 0, 0, 255), (Circle(10.0, 10.0, 8.0), Circle(10.0, 10.0, 3.0)), "ring")
    outer, hole = shape.oriented()
    assert signed_area(outer) > 0.0 > signed_area(hole)
    assert Drawing(20, 20, (shape, shape)).fills == ((255, 0, 0, 255),)
    assert Drawing(20, 20, (shape,)).coordinates == 6
