"""Which shape lies over which: by the outlines that run straight on where three regions meet."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import ndimage

from cubicsplat_cli.artwork.geometry.outlines import Ellipse
from cubicsplat_cli.artwork.layers.completion import outlines_of
from cubicsplat_cli.artwork.layers.extents import extents
from cubicsplat_cli.artwork.layers.stacking import Stack, _without_cycles, junction_votes, meetings_of, stack
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.artwork.regions.sampling import edge_positions
from cubicsplat_cli.raster.outlines import EdgePositions, coverage, heading

FINE = 8
SIZE = 100
FILLS = np.array([[250.0, 250.0, 250.0, 255.0], [200.0, 30.0, 30.0, 255.0], [30.0, 50.0, 180.0, 255.0]])


def drawn(names) -> tuple[Regions, EdgePositions]:
    """The regions of a picture whose fills at x, y are those of these names (h, w), and where they end."""
    y, x = (np.mgrid[: SIZE * FINE, : SIZE * FINE] + 0.5) / FINE
    fine = names(x - 50.0, y - 50.0)
    shares = (fine[..., None] == np.arange(3)).reshape(SIZE, FINE, SIZE, FINE, 3).mean(axis=(1, 3))
    regions = Regions(shares.argmax(axis=2), FILLS, np.arange(3))
    return regions, edge_positions(shares @ FILLS, regions)


def votes(names) -> dict[tuple[int, int], float]:
    """The votes of where three regions of such a picture meet."""
    return junction_votes(meetings_of(*drawn(names)))


@pytest.mark.parametrize("slope", [20.0, 33.0, 70.0, 90.0, 140.0])
def test_the_outline_that_runs_straight_on_is_of_what_lies_above(slope):
    # A half-plane over the border of two others, which it meets at this angle.
    normal = np.array([math.sin(math.radians(slope)), -math.cos(math.radians(slope))])
    found = votes(lambda x, y: np.where(x * normal[0] + y * normal[1] > 0.0, 2, np.where(y < 0.0, 0, 1)))
    assert set(found) == {(2, 0), (2, 1)}
    assert min(found.values()) > 0.8


def test_a_round_outline_runs_on_as_well():
    found = votes(lambda x, y: np.where(x * x + y * y < 900.0, 2, np.where(x + 0.2 * y < 0.0, 0, 1)))
    assert set(found) == {(2, 0), (2, 1)}
    # At both ends of the border that it hides.
    assert min(found.values()) > 1.6


def test_where_three_corners_meet_none_lies_above():
    angle_of = lambda x, y: np.arctan2(y, x) % (2.0 * math.pi)  # noqa: E731
    assert votes(lambda x, y: (angle_of(x, y) // (2.0 * math.pi / 3.0)).astype(int)) == {}


def tin(x, y):
    """A tin whose sides begin at the ends of its lid, which therefore run on into either."""
    side = (np.abs(x) < 30.0) & (y > -15.0) & (y < 30.0)
    return np.where((x / 30.0) ** 2 + ((y + 15.0) / 10.0) ** 2 < 1.0, 2, np.where(side, 1, 0))


def test_the_lid_of_a_tin_is_a_whole_ellipse_on_its_side():
    regions, found = drawn(tin)
    layers = stack(regions, found)
    assert layers.layers == ((0,), (1,), (2,))
    _, _, lid = extents(regions, layers, found)
    (outline,) = outlines_of(lid[0], (SIZE, SIZE), 1.0)
    assert isinstance(outline, Ellipse)
    assert (outline.cx, outline.cy, outline.rx, outline.ry) == pytest.approx((50.0, 35.0, 30.0, 10.0), abs=0.1)


def test_a_heading_is_known_as_well_as_its_points():
    rng = np.random.default_rng(3)
    along = np.arange(15.0)
    found = []
    for _ in range(400):
        points = np.stack([-along, rng.normal(0.0, 0.05, 15)], axis=1)
        end = heading(points, np.full(15, 0.05), 14.0)
        found.append(math.atan2(end.tangent[1], end.tangent[0]))
    assert np.std(found) == pytest.approx(end.error, rel=0.15)
    assert heading(points[:3], np.full(3, 0.05), 14.0) is None


def test_a_layer_ends_at_those_whose_outlines_turn_where_they_meet_it():
    # Four boxes around a place: each lies beside two others.
    y, x = np.mgrid[:80, :80]
    labels, fills = 2 * (y >= 40) + (x >= 40), np.vstack([FILLS, [[20.0, 120.0, 40.0, 255.0]]])
    regions = Regions(labels, fills, np.arange(4))
    found = stack(regions, edge_positions(fills[labels], regions))
    pairs = {(found.layers[low][0], found.layers[high][0]) for low, some in enumerate(found.ends) for high in some}
    assert {frozenset(pair) for pair in pairs} == {frozenset(pair) for pair in ((0, 1), (0, 2), (1, 3), (2, 3))}
    # A half-plane over two others: its outline passes, and they go on beneath it.
    regions, edges = drawn(lambda x, y: np.where(x > 0.0, 2, np.where(y < 0.0, 0, 1)))
    found = stack(regions, edges)
    assert found.layers[-1] == (2,) and found.rank[2] not in [high for some in found.ends for high in some]


def test_what_upper_shapes_shut_in_is_not_covered_from_beneath_them():
    # A collar about three sides of a neck lies over a coat, a bar over both: the coat goes on beneath the collar, but
    # not across the neck, which is no hole of the coat.
    labels = np.zeros((120, 120), dtype=int)
    labels[40:110, 20:100] = 2
    labels[40:80, 35:85] = 3
    labels[40:70, 45:75] = 1
    labels[25:45, 10:110] = 4
    fills = np.vstack([FILLS, [[20.0, 120.0, 40.0, 255.0], [0.0, 0.0, 0.0, 255.0]]])
    regions = Regions(labels, fills, np.arange(5))
    stack = Stack(tuple((k,) for k in range(5)), np.arange(5), ((),) * 5)
    found = edge_positions(fills[labels], regions)
    (coat,) = [*extents(regions, stack, found)][2]
    covered = np.zeros(labels.shape)
    for contour, outline in zip(coat.contours, outlines_of(coat, labels.shape, 1.0), strict=True):
        ring = outline.ring()
        share = np.abs(coverage(ring.cubics, ring.lines, 0, 0, *labels.shape))
        covered += -share if contour.hole else share
    assert covered[labels == 2].min() > 0.5
    assert covered[46:69, 46:74].max() < 0.5


def test_pieces_join_across_what_hides_them_and_no_farther():
    # Two bars cross beneath a disc that is wider than they are, on a ground of which four corners show.
    y, x = np.mgrid[:120, :120] - 59.5
    labels = np.where(y < 0.0, 0, 2) + (x > 0.0)
    labels[np.abs(x) < 8.0] = np.where(y < 0.0, 4, 5)[np.abs(x) < 8.0]
    labels[np.abs(y) < 8.0] = np.where(x < 0.0, 6, 7)[np.abs(y) < 8.0]
    labels[x * x + y * y < 900.0] = 8
    fills = FILLS[[0, 0, 0, 0, 1, 1, 1, 1, 2]]
    regions = Regions(labels, fills, np.array([0, 0, 0, 0, 1, 1, 1, 1, 2]))
    found = stack(regions, edge_positions(fills[labels], regions))
    # The ground runs beneath all; either bar beneath the disc only, not beneath the corners of the ground.
    assert found.layers[0] == (0, 1, 2, 3)
    assert set(found.layers[1:]) == {(4, 5), (6, 7), (8,)}
    assert found.layers[-1] == (8,)


@pytest.mark.parametrize("radius", [20.0, 45.0])
def test_a_disc_beneath_a_bar_is_in_one_piece_at_any_size(radius):
    # What its hull holds of the ground are pixels of its rim, of which a small one has more for its area.
    regions, found = drawn(lambda x, y: np.where(np.abs(y - 0.4 * x) < 5.0, 2, np.hypot(x, y) < radius))
    labels = ndimage.label(regions.labels == 1)[0] + 10 * regions.labels
    _, labels = np.unique(labels, return_inverse=True)
    fill_of = np.array([0, 1, 1, 2])
    regions = Regions(labels.reshape(SIZE, SIZE), FILLS[fill_of], fill_of)
    assert (1, 2) in stack(regions, found).layers


def test_a_page_that_shows_in_three_corners_goes_on_beyond_the_canvas():
    # A rounded box as large as the canvas, with a hole, and what runs out of the canvas on a page: as with a margin.
    y, x = np.mgrid[:120, :120] - 59.5
    box = np.maximum(np.abs(x), np.abs(y)) + np.minimum(np.abs(x), np.abs(y)) < 90.0
    labels = np.where(box, 4, np.where(y < 0.0, 0, 2) + (x > 0.0))
    labels[50:70, 50:70] = 5
    fills = FILLS[[0, 0, 0, 0, 1, 0]]
    regions = Regions(labels, fills, np.array([0, 0, 0, 0, 1, 0]))
    layers = stack(regions, edge_positions(fills[labels], regions)).layers
    assert layers == ((0, 1, 2, 3, 5), (4,))

    labels = np.zeros((120, 120), dtype=int)
    labels[:80, :20], labels[:80, 80:100] = 1, 2
    regions = Regions(labels, FILLS[[0, 1, 1]], np.array([0, 1, 1]))
    layers = stack(regions, edge_positions(regions.fills[labels], regions)).layers
    assert layers == ((0,), (1,), (2,))


def test_pieces_do_not_join_beneath_a_shape_that_lies_around_one_of_them():
    # Two boxes (2, 3) are one shape beneath a bar (4). What lies within one of them (1) lies above it, and so is no
    # piece of what lies around the other (5), though nothing else is between.
    labels = np.zeros((120, 140), dtype=int)
    labels[40:80, 10:50] = 2
    labels[58:62, 47:49] = 1
    labels[37:83, 60:125] = 5
    labels[40:41, 50:60] = 5
    labels[40:80, 60:110] = 3
    labels[41:90, 50:60] = 4
    fills = np.vstack([FILLS, [[20.0, 120.0, 40.0, 255.0]]])
    fill_of = np.array([0, 1, 2, 2, 3, 1])
    regions = Regions(labels, fills[fill_of], fill_of)
    found = stack(regions, edge_positions(fills[fill_of][labels], regions))
    assert set(found.layers) == {(0,), (1,), (2, 3), (4,), (5,)}


def test_cycles_are_broken_where_the_evidence_is_weakest():
    net = np.zeros((5, 5), dtype=np.float32)
    net[0, 1], net[1, 2], net[2, 0], net[3, 2], net[0, 4], net[4, 0] = 3.0, 1.0, 2.0, 0.5, 4.0, 0.75
    above, below = np.nonzero(net)
    kept = _without_cycles(5, above, below, net[above, below])
    assert sorted(zip(*kept, strict=True)) == [(0, 1), (0, 4), (2, 0), (3, 2)]
