"""The map of the borders between regions: neighbours, what encloses what, and loops of cracks, by their definitions."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as numbers

from cubicsplat_cli.raster.borders import BorderMap, border_map, border_positions, meeting
from cubicsplat_cli.raster.ndimage import holes_of
from cubicsplat_cli.raster.unmix import components

STEP = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
RIGHT, LEFT = np.array([[0, 0], [-1, 0], [-1, -1], [0, -1]]), np.array([[0, -1], [0, 0], [-1, 0], [-1, -1]])
SIDES = st.tuples(st.integers(1, 12), st.integers(1, 12))
LABELS = numbers.arrays(np.int32, SIDES, elements=st.integers(0, 2)).map(lambda values: components(values)[0])


def held_by(borders: BorderMap) -> dict[int, set[int]]:
    """The regions within each that encloses some."""
    held: dict[int, set[int]] = {}
    for region, outer in enumerate(borders.around.tolist()):
        while outer >= 0:
            held.setdefault(outer, set()).add(region)
            outer = int(borders.around[outer])
    return held


@given(LABELS)
def test_neighbours_share_the_cracks_between_their_pixels(labels):
    borders = border_map(labels)
    pairs = [*zip(labels[1:].flat, labels[:-1].flat), *zip(labels[:, 1:].flat, labels[:, :-1].flat)]  # noqa: B905
    expected = Counter((int(a), int(b)) for u, v in pairs for a, b in ((u, v), (v, u)) if a != b)
    found = zip(borders.first.tolist(), borders.second.tolist(), borders.cracks.tolist(), strict=True)
    assert [*found] == [(a, b, n) for (a, b), n in sorted(expected.items())]
    assert borders.beside == [[b for a, b in sorted(expected) if a == k] for k in range(labels.max() + 1)]


@given(LABELS)
def test_three_labels_meet_where_four_pixels_have_as_many(labels):
    height, width = labels.shape
    corners = [[len(set(labels[y : y + 2, x : x + 2].flat)) >= 3 for x in range(width - 1)] for y in range(height - 1)]
    assert (meeting(labels) == np.array(corners, dtype=bool).reshape(height - 1, width - 1)).all()


@given(LABELS)
def test_what_a_region_encloses_lies_in_the_holes_of_its_mask(labels):
    held = {k: set(np.unique(labels[holes_of(labels == k)]).tolist()) for k in range(labels.max() + 1)}
    assert held_by(border_map(labels)) == {k: some for k, some in held.items() if some}


def test_rings_enclose_all_within_them():
    y, x = np.indices((21, 21))
    labels = np.minimum(np.maximum(abs(x - 10), abs(y - 10)), 9)  # the outermost ring is two px wide
    assert border_map(labels).around.tolist() == [*range(1, 10), -1]


def test_a_stripe_across_the_canvas_encloses_nothing():
    labels = np.repeat([0, 1, 2], 4)[:, None].repeat(9, axis=1)
    assert border_map(labels).around.tolist() == [-1, -1, -1]


@given(LABELS)
def test_loops_are_the_cracks_around_regions_and_turn_right_first(labels):
    loops = border_map(labels).loops
    padded = np.pad(labels, 1, constant_values=-1)
    assert loops.owners.tolist() == sorted(loops.owners.tolist())
    areas = []
    for owner, cracks, beside in zip(
        loops.owners.tolist(), np.split(loops.cracks, loops.ends[:-1]), np.split(loops.beside, loops.ends[:-1]),
        strict=True,
    ):  # fmt: skip
        at, direction = cracks[:, :2], cracks[:, 2]
        ends = at + STEP[direction]
        assert (np.roll(ends, 1, axis=0) == at).all()
        left, right = (padded[tuple((at + side[direction] + 1).T[::-1])] for side in (LEFT, RIGHT))
        assert (right == owner).all() and (left == beside).all() and (left != owner).all()
        # Where two pixels touch at a corner the loop keeps to its own: a turn to the left has its pixel ahead.
        turn = (np.roll(direction, -1) - direction) % 4
        ahead = padded[tuple((at + LEFT[direction] + STEP[direction] + 1).T[::-1])] == owner
        assert ahead[turn == 3].all() and not ahead[turn == 0].any() and (turn != 2).all()
        areas.append((owner, 0.5 * float((at[:, 0] * ends[:, 1] - at[:, 1] * ends[:, 0]).sum())))
    # Every crack once on either side, and the largest loop of a region first, which is the one around all of it.
    assert (
        len(np.unique(loops.cracks, axis=0))
        == len(loops.cracks)
        == border_map(labels).cracks.sum() + 2 * sum(labels.shape)
    )
    assert areas == sorted(areas, key=lambda each: (each[0], -each[1]))
    sizes = np.zeros(labels.max() + 1)
    np.add.at(sizes, loops.owners, [area for _, area in areas])
    assert (sizes == np.bincount(labels.ravel())).all()
    assert [len(cracks) for _, cracks, _ in loops.outer()] == [
        int(np.diff(loops.ends, prepend=0)[np.searchsorted(loops.owners, k)]) for k in range(len(sizes))
    ]


@pytest.mark.parametrize("count", [3, 4])
def test_labels_of_many_parts_may_touch_more_than_connected_regions_do(count):
    labels = np.random.default_rng(0).permutation(np.arange(400) % (5 * count)).reshape(20, 20)
    borders = border_map(labels)
    assert borders.cracks.sum() == 2 * ((labels[1:] != labels[:-1]).sum() + (labels[:, 1:] != labels[:, :-1]).sum())
    assert len(borders.first) > 6 * (labels.max() + 1)


FILLS = np.array([[255.0, 255.0, 255.0, 255.0], [200.0, 30.0, 30.0, 255.0]])


@given(st.floats(3.0, 9.0), st.floats(-0.3, 0.3))
def test_borders_run_where_the_shares_of_pixels_say(height, slope):
    # What lies above a line that is rather level covers so much of each column, sums of shares in 64 samples a pixel.
    fine = (np.arange(12 * 64)[:, None] + 0.5) / 64 < height + slope * (np.arange(8) - 3.5)
    shares = fine.reshape(12, 64, 8).mean(axis=1)
    levels = shares[..., None] * FILLS[0] + (1.0 - shares[..., None]) * FILLS[1]
    labels = (shares < 0.5).astype(np.int32)
    rows, errors, columns, column_errors = border_positions(levels, labels, FILLS, 0.8, 0.8, 0.04)
    y, x = np.nonzero(np.diff(labels, axis=0))
    assert rows[y + 1, x] == pytest.approx(shares.sum(axis=0)[x], abs=0.03)  # a share below 0.02 may end the walk
    assert errors[y + 1, x] == pytest.approx(0.04, abs=0.001)
    turned = border_positions(levels.swapaxes(0, 1), labels.T, FILLS, 0.8, 0.8, 0.04)
    assert [(a == b.T).all() for a, b in zip(turned, (columns, column_errors, rows, errors), strict=True)] == [True] * 4
