"""The native fit of cubics to points, against the same in plain numpy."""

from itertools import pairwise, product

import numpy as np
import pytest

from cubicsplat_cli.artwork.geometry.beziers import bernstein, derivatives, points_at
from cubicsplat_cli.raster.cubics import cheapest_path, newton_steps, piece_misfits

RUNS, POINTS, ROUNDS = 7, 20, 3


def runs(seed):
    """Cubics bent at random, points beside them in order, and parameters that are nearly theirs."""
    random = np.random.default_rng(seed)
    cubics = np.array([[0.0, 0.0], [10.0, 8.0], [22.0, 8.0], [30.0, 0.0]]) + random.normal(0.0, 3.0, (RUNS, 4, 2))
    u = np.tile((np.arange(POINTS) + 0.5) / POINTS, (RUNS, 1))
    return random, cubics, points_at(cubics, u) + random.normal(0.0, 0.3, (RUNS, POINTS, 2)), u


def nearer(cubics, points, u):
    rest = points_at(cubics, u) - points
    first, second = derivatives(cubics, u)
    speed = (first * first).sum(-1)
    bend = speed + (rest * second).sum(-1)
    return u - (rest * first).sum(-1) / np.maximum(np.where(bend > 0.3 * speed, bend, speed), 1e-12)


def test_a_newton_step_is_that_of_the_distance():
    _, cubics, points, u = runs(1)
    assert newton_steps(cubics, points, u) == pytest.approx(nearer(cubics, points, u), abs=1e-12)
    # Far inside of a bend the distance is not convex.
    far = points + [0.0, 400.0] * np.ones((RUNS, POINTS, 1))
    rest, (first, second) = points_at(cubics, u) - far, derivatives(cubics, u)
    assert ((rest * second).sum(-1) < -0.7 * (first * first).sum(-1)).any()
    assert newton_steps(cubics, far, u) == pytest.approx(nearer(cubics, far, u), abs=1e-9)


def test_steps_repeated_find_the_feet():
    _, cubics, points, u = runs(2)
    for _ in range(6):
        u = newton_steps(cubics, points, u)
    along = ((points_at(cubics, u) - points) * derivatives(cubics, u)[0]).sum(-1)
    assert np.abs(along).max() < 1e-6


def improved(given, values, cubics, points, weights, u):
    """The values after one Gauss-Newton step, by a dense system for each run."""
    directions, expected, stiffness, length = given
    first, _ = derivatives(cubics, u)
    normal = np.stack([-first[..., 1], first[..., 0]], axis=-1) / np.hypot(first[..., 0], first[..., 1])[..., None]
    b = bernstein(u)
    columns = np.einsum("pkc,pka,pvca->pkv", b, normal, directions)
    rest = ((points - b @ cubics) * normal).sum(-1)
    gram = np.einsum("pk,pkv,pkw->pvw", weights, columns, columns) + stiffness[:, None] * np.eye(6)
    slope = np.einsum("pk,pkv,pk->pv", weights, columns, rest) + stiffness * (expected - values)
    values = values + np.linalg.solve(gram, slope[..., None])[..., 0]
    values[:, :2] = np.clip(values[:, :2], 0.03 * length[:, None], length[:, None])
    return values


def misfit(cubics, points, weights, u):
    size = np.sqrt(((points_at(cubics, u) - points) ** 2).sum(-1) * weights)
    return np.where(size <= 3.0, size**2, 6.0 * size - 9.0).sum(axis=1)


def test_pieces_go_where_plain_gauss_newton_goes():
    random, cubics, points, _ = runs(3)
    weights = random.uniform(0.5, 20.0, (RUNS, POINTS))
    at, errors = cubics[:, [0, 3]] + random.normal(0.0, 0.2, (RUNS, 2, 2)), random.uniform(0.05, 0.3, (RUNS, 2, 2))
    tangents = np.stack([cubics[:, 1] - cubics[:, 0], cubics[:, 3] - cubics[:, 2]], axis=1)
    tangents /= np.hypot(tangents[..., 0], tangents[..., 1])[..., None]
    knots = np.diff(np.concatenate([at[:, :1], points, at[:, 1:]], axis=1), axis=1)
    along = np.cumsum(np.hypot(knots[..., 0], knots[..., 1]), axis=1)
    u, length = along[:, :-1] / along[:, -1:], along[:, -1]
    across = np.stack([-tangents[..., 1], tangents[..., 0]], axis=-1)
    base, directions = at[:, [0, 0, 1, 1]], np.zeros((RUNS, 6, 4, 2))
    directions[:, 0, 1], directions[:, 1, 2] = tangents[:, 0], -tangents[:, 1]
    directions[:, 2, 0] = directions[:, 2, 1] = directions[:, 4, 1] = across[:, 0]
    directions[:, 3, 3] = directions[:, 3, 2] = directions[:, 5, 2] = across[:, 1]
    expected = np.zeros((RUNS, 6))
    expected[:, :2] = length[:, None] / 3.0
    sizes = [np.repeat(length[:, None] / 2.0, 2, axis=1), errors[..., 0], errors[..., 1] * length[:, None] / 3.0]
    stiffness = [0.1, 0.1, 1.0, 1.0, 1.0, 1.0] / np.concatenate(sizes, axis=1) ** 2
    given, values = (directions, expected, stiffness, length), expected

    def placed(values):
        return base + np.einsum("pv,pvca->pca", values, directions)

    feet = np.clip(nearer(placed(values), points, u), 0.0, 1.0)
    for _ in range(ROUNDS):
        values = improved(given, values, placed(values), points, weights, feet)
        feet = np.clip(nearer(placed(values), points, feet), 0.0, 1.0)
    # Each run has two nodes of its own.
    first, rank = np.arange(0, 2 * RUNS, 2), POINTS * (np.arange(2 * RUNS) // 2 + np.arange(2 * RUNS) % 2)
    nodes = rank, at.reshape(-1, 2), tangents.reshape(-1, 2), errors.reshape(-1, 2)
    told = points.reshape(-1, 2), weights.ravel()
    found, cubic, line, bends = piece_misfits(first, first + 1, nodes, *told, 1e3)
    assert found == pytest.approx(placed(values), abs=1e-7)
    strain = (stiffness * (values - expected) ** 2)[:, 2:].sum(axis=1)
    assert cubic == pytest.approx(misfit(found, points, weights, feet) + strain)
    way = at[:, 1] - at[:, 0]
    for end in (0, 1):
        turn = np.arctan2(
            way[:, 0] * tangents[:, end, 1] - way[:, 1] * tangents[:, end, 0], (way * tangents[:, end]).sum(1)
        )
        angles = np.abs(turn) / (np.radians(0.5) + errors[:, end, 1])
        assert bends[:, end] == pytest.approx(0.5 * np.minimum(angles, 30.0) ** 2)
    assert (line > cubic).all()


def test_the_misfit_of_a_line_is_that_of_the_points_off_it_and_hopeless_cubics_stay_rough():
    x = np.linspace(0.5, 19.5, 20)
    points = np.stack([x, np.where(np.arange(20) % 2, 0.1, -0.1)], axis=1)
    nodes = np.array([0, 20]), np.array([[0.0, 0.0], [20.0, 0.0]]), np.array([[1.0, 0.0]] * 2), np.full((2, 2), 0.1)
    start = np.array([0]), np.array([1])
    _, cubic, line, bends = piece_misfits(*start, nodes, points, np.full(20, 100.0), 1.0)
    # The outliers draw the line, but evenly: its points are one standard error off.
    assert line == pytest.approx([20.0], rel=0.05) and cubic == pytest.approx([20.0], rel=0.2)
    assert bends == pytest.approx(np.zeros((1, 2)))
    between = (np.array([0, 10, 20]), np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]]), np.array([[1.0, 0.0]] * 3))
    far = np.stack([x, 400.0 * np.sin(x)], axis=1)
    wide = piece_misfits(np.array([0]), np.array([2]), (*between, np.full((3, 2), 0.1)), far, np.full(20, 100.0), 1e-3)
    assert wide[0][0, [0, 3]] == pytest.approx(between[1][[0, 2]], abs=1e-12)


def test_the_cheapest_path_is_that_of_all_paths():
    random = np.random.default_rng(5)
    first, last = np.triu_indices(6, 1)
    for _ in range(20):
        costs, bend = random.uniform(0.0, 4.0, (len(first), 2)), 1.5
        number = {(a, b): k for k, (a, b) in enumerate(zip(first.tolist(), last.tolist(), strict=True))}
        best = np.inf
        for inner in product((False, True), repeat=4):
            stops = [0, *(np.flatnonzero(inner) + 1).tolist(), 5]
            for kinds in product((0, 1), repeat=len(stops) - 1):
                own = sum(costs[number[pair], kind] for pair, kind in zip(pairwise(stops), kinds, strict=True))
                best = min(best, own + bend * sum(a + b == 0 for a, b in pairwise(kinds)))
        path, kinds, cost = cheapest_path(6, first, last, costs, bend)
        assert cost == pytest.approx(best)
        assert first[path[0]] == 0 and last[path[-1]] == 5 and (last[path[:-1]] == first[path[1:]]).all()
        bends = sum(a + b == 0 for a, b in pairwise(kinds.tolist()))
        assert costs[path, kinds].sum() + bend * bends == pytest.approx(cost)
