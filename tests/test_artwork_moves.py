"""Edits that add a piece to a ring, and the moves that choose among them."""

from dataclasses import astuple, replace

import numpy as np
import pytest

from cubicsplat_cli.artwork.finish.polish import as_path, polish, rounded
from cubicsplat_cli.artwork.finish.state import begin, goal_of
from cubicsplat_cli.artwork.geometry.outlines import (
    Circle,
    Ellipse,
    Outline,
    Rectangle,
    Ring,
    divided,
    flattened,
    polygon,
    signed_area,
)
from cubicsplat_cli.artwork.shapes import Drawing, Shape, scaled_outline
from cubicsplat_cli.raster.outlines import coverage

RED = (255, 0, 0, 255)
SQUARE = polygon(np.array([[8.0, 8.0], [40.0, 8.0], [40.0, 40.0], [8.0, 40.0]]))


def test_dividing_a_piece_keeps_the_curve():
    ring = Circle(20.0, 20.0, 12.0).ring()
    cut = divided(ring, 1, 0.3)
    assert cut.pieces == 5 and cut.smooth.all()
    assert signed_area(cut) == pytest.approx(signed_area(ring), rel=1e-12)
    radii = np.hypot(*(flattened(cut, 0.3) - 20.0).T)
    assert np.abs(radii - 12.0).max() < 12.0 * 3e-4


def test_a_rounded_corner_cuts_its_tip_off_on_both_sides():
    ring = rounded(SQUARE, 1, 3.0)
    assert ring.pieces == 5 and ring.lines.tolist() == [True, False, True, True, True]
    assert ring.anchors[1] == pytest.approx([37.0, 8.0]) and ring.anchors[2] == pytest.approx([40.0, 11.0])
    assert ring.smooth.tolist() == [False, True, True, False, False]
    assert signed_area(SQUARE) - signed_area(ring) == pytest.approx((4.0 - np.pi) / 4.0 * 9.0, rel=0.05)


def test_the_polish_bends_a_line_that_should_be_an_arc():
    square = polygon(SQUARE.anchors + 0.6)
    cubics = square.cubics
    cubics[0, 1:3, 1] -= 0.7
    share = coverage(cubics, np.array([False, True, True, True]), 0, 0, 48, 48)
    target = share[..., None] * (np.array(RED) / 255.0)
    start = Drawing(48, 48, (Shape(RED, (square,), "red"),))
    done = polish(start, goal_of(target))
    assert begin(done, goal_of(target)).stack.cost < 0.02 * begin(start, goal_of(target)).stack.cost
    assert done.segments == 4


def polished(drawn: Outline, start: Outline) -> Outline:
    """What the polish makes of an outline where another one was drawn."""
    ring = drawn.ring()
    target = coverage(ring.cubics, ring.lines, 0, 0, 48, 48)[..., None] * (np.array(RED) / 255.0)
    (outline,) = polish(Drawing(48, 48, (Shape(RED, (start,), "red"),)), goal_of(target)).shapes[0].outlines
    return outline


def test_the_polish_leaves_alone_what_is_right():
    assert np.allclose(polished(SQUARE, SQUARE).anchors, SQUARE.anchors, atol=1e-6)


def test_the_polish_gives_up_an_ellipse_where_a_leaf_was_drawn():
    anchors = np.array([[10.0, 24.0], [38.0, 24.0]])
    controls = np.array([[[19.0, 15.0], [29.0, 15.0]], [[29.0, 33.0], [19.0, 33.0]]])
    leaf = Ring(anchors, controls, np.zeros(2, dtype=bool), np.zeros(2, dtype=bool))
    found = polished(leaf, Ellipse(24.0, 24.0, 13.0, 6.6))
    assert isinstance(found, Ring)
    assert found.pieces <= 4
    assert np.hypot(*(found.anchors[:, None] - anchors).transpose(2, 0, 1)).min(axis=0).max() < 0.3


@pytest.mark.parametrize(
    "drawn", [Ellipse(24.3, 23.8, 13.0, 6.6, 0.3), Circle(24.1, 23.7, 9.0), Rectangle(12.3, 18.2, 24.0, 11.0, 0.0, 0.4)]
)
def test_the_polish_keeps_primitives_that_are_right(drawn):
    start = scaled_outline(drawn, 1.005, 1.005)
    found = polished(drawn, start)
    assert type(found) is type(drawn)
    assert astuple(found) == pytest.approx(astuple(drawn), abs=0.02)


def test_a_ring_is_scaled_together_with_the_closer_one():
    ring = Rectangle(2.0, 4.0, 8.0, 4.0, 1.0).ring()
    halved = scaled_outline(replace(ring, otherwise=ring), 0.5, 0.25)
    assert halved.otherwise is not None and (halved.otherwise.anchors == ring.anchors * [0.5, 0.25]).all()
    assert (halved.otherwise.controls == halved.controls).all()


def test_a_large_circle_is_not_given_up_for_little_on_each_of_its_pixels():
    leaf, disc = Ellipse(20.0, 20.0, 9.0, 2.0, 0.3), Circle(250.0, 250.0, 240.0)
    assert as_path(leaf, 400.0, 40) is not None
    assert as_path(disc, 400.0, 1400) is None
