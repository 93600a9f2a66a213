"""Near points and groups of what is linked are those that scipy finds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from cubicsplat_cli.raster.point_tree import ClosedLines, PointTree
from cubicsplat_cli.raster.sparse import linked_groups

# On a coarse grid, so that many lie at the same place and as far as each other.
PLACES = st.integers(1, 60).flatmap(lambda n: arrays.arrays(float, (n, 2), elements=st.integers(-20, 20).map(float)))
LINKS = st.lists(st.tuples(st.integers(0, 19), st.integers(0, 19)), max_size=60)


@given(PLACES, PLACES, st.floats(0.0, 30.0))
def test_points_near_places(points, places, reach):
    ours, theirs = PointTree(points), cKDTree(points)
    distances, indices = ours.query(places)
    np.testing.assert_array_equal(distances, theirs.query(places)[0])
    np.testing.assert_array_max_ulp(np.hypot(*(points[indices] - places).T), distances)
    off = points - places[:, None]
    np.testing.assert_array_equal(indices, (off * off).sum(axis=2).argmin(axis=1))  # the first
    known = theirs.query_ball_point(places, reach)
    assert [own.tolist() for own in ours.query_ball_point(places, reach)] == [sorted(own) for own in known]
    pairs = theirs.query_pairs(reach, output_type="ndarray")
    assert ours.query_pairs(reach).tolist() == sorted(pairs.tolist())


def test_each_place_has_a_reach_of_its_own():
    points = np.random.default_rng(0).uniform(0.0, 100.0, (500, 2))
    reaches = np.linspace(0.0, 40.0, 500)
    known = cKDTree(points).query_ball_point(points, reaches, return_sorted=True)
    assert [own.tolist() for own in PointTree(points).query_ball_point(points, reaches)] == known.tolist()


def test_among_no_points_none_is_near():
    tree = PointTree(np.zeros((0, 2)))
    assert (tree.query(np.ones((1, 2)))[0] == np.inf).all()
    assert [own.tolist() for own in tree.query_ball_point(np.ones((1, 2)), 5.0)] == [[]]
    assert tree.query_pairs(5.0).tolist() == [] and tree.query_ball_point(np.zeros((0, 2)), 5.0) == []


@given(LINKS)
def test_groups_of_what_is_linked(links):
    first, second = np.array(links, dtype=int).reshape(-1, 2).T
    graph = coo_array((np.ones(len(links)), (first, second)), shape=(20, 20))
    count, known = connected_components(graph, directed=False)
    found = linked_groups(20, first, second)
    assert found[0] == count and found[1].tolist() == known.tolist()
    count, known = connected_components(graph, directed=True, connection="strong")
    found = linked_groups(20, first, second, directed=True)
    assert found[0] == count
    # The same things together, whatever their numbers.
    assert ((found[1][:, None] == found[1]) == (known[:, None] == known)).all()


def test_points_nowhere_and_links_to_nothing_are_refused():
    with pytest.raises(ValueError, match="finite"):
        PointTree(np.array([[0.0, np.nan]]))
    with pytest.raises(ValueError, match="0 to 2"):
        linked_groups(3, np.array([0]), np.array([3]))
    assert linked_groups(0, np.zeros(0, int), np.zeros(0, int))[0] == 0


@pytest.mark.parametrize("count", [1, 2, 3, 40])
def test_places_are_off_a_closed_line_as_off_its_nearest_edges(count: int) -> None:
    rng, turns = np.random.default_rng(count), np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    line = np.stack([30.0 * np.cos(turns), 20.0 * np.sin(turns)], axis=1)
    following = np.roll(line, -1, axis=0)
    places = np.concatenate([rng.normal(0.0, 25.0, (60, 2)), line, 0.5 * (line + following)])
    near = PointTree(line).query(places)[1]
    edges = np.stack([near - 1, near])
    along = (following - line)[edges]
    square = np.maximum((along**2).sum(axis=2), 1e-24)
    shares = np.clip(((places - line[edges]) * along).sum(axis=2) / square, 0.0, 1.0)
    gaps = places - line[edges] - shares[..., None] * along
    sizes = np.hypot(gaps[..., 0], gaps[..., 1])
    for k, (place, edge) in enumerate(zip(places, sizes.argmin(axis=0), strict=True)):
        size = sizes[edge, k]
        # Laid on the line with one point that shows, in no step, a line tells in which direction it is off.
        found = on_line(line, place, size + 1e-9)
        assert found is not None and (size < 1e-6 or on_line(line, place, size - 1e-9) is None)
        across = along[edge, k, ::-1] / np.sqrt(square[edge, k])
        if count > 2 or size > 1e-6:
            assert found == pytest.approx((gaps[edge, k] / size if size > 1e-6 else across) ** 2, abs=1e-5)


def on_line(line: np.ndarray, place: np.ndarray, most: float) -> np.ndarray | None:
    """What a place tells of a shift of x and of y if it is no farther than `most` off a closed line, else None."""
    trees, shown = [PointTree(line), PointTree(line)], [place[None].copy(), np.empty((0, 2))]
    lines = ClosedLines(trees, shown, np.zeros((2, 2, 2)), (most, most, most), (1, 0), 1e-6)
    found = lines.first_on(1, np.zeros(1, int), np.ones((1, 2)))
    return None if found is None else found[3]
