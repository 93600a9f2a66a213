"""The native fit of cubics to points, against the same in plain numpy."""

import numpy as np
import pytest

from cubicsplat_cli.artwork.geometry.outlines import bernstein, derivatives, points_at
from cubicsplat_cli.raster.cubics import divided_run, newton_steps

RUNS, POINTS, ROUNDS = 7, 20, 3


def runs(seed):
    """Cubics bent at random, points beside them in order, and parameters that are nearly theirs."""
    random = np.random.default_rng(seed)
    cubics = np.array([[0.0, 0.0], [10.0, 8.0], [22.0, 8.0], [30.0, 0.0]]) + random.normal(0.0, 1.0, (RUNS, 4, 2))
    u = np.tile((np.arange(POINTS) + 0.5) / POINTS, (RUNS, 1))
    return random, cubics, points_at(cubics, u) + random.normal(0.0, 0.1, (RUNS, POINTS, 2)), u


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
    far = points - [0.0, 400.0] * np.ones((RUNS, POINTS, 1))
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
    at, errors = cubics[:, [0, 3]] + random.normal(0.0, 0.1, (RUNS, 2, 2)), random.uniform(0.2, 0.4, (RUNS, 2, 2))
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
    strain = (stiffness * (values - expected) ** 2)[:, 2:].sum(axis=1)
    total = misfit(placed(values), points, weights, feet) + strain
    straight = np.stack([np.ones(POINTS), np.zeros(POINTS)], axis=1), np.zeros(POINTS), np.ones((POINTS, 2))
    for k in range(RUNS):
        # So dear that two pieces cost more, and not so dear that a line costs less.
        ends, price = (at[k], tangents[k], errors[k]), 0.3 * float(total[k])
        division, cost = divided_run((points[k], *straight), weights[k], ends, price)
        assert division.lines.tolist() == [False] and division.sizes.tolist() == [POINTS]
        # A cubic between two corners has six parameters.
        assert cost == pytest.approx(0.5 * total[k] + 6.0 * price)
        handles = placed(values)[k, [1, 2]] - placed(values)[k, [0, 3]]
        assert division.handles[0] == pytest.approx(handles, abs=1e-7)
        assert division.anchors[0] == pytest.approx(at[k, 0])


def test_a_line_costs_what_its_points_are_off_it():
    x = np.linspace(0.5, 19.5, 20)
    points = np.stack([x, np.where(np.arange(20) % 2, 0.1, -0.1)], axis=1)
    level = np.tile([1.0, 0.0], (20, 1)), np.zeros(20), np.full((20, 2), 0.1)
    ends = np.array([[0.0, 0.0], [20.0, 0.0]]), np.tile([1.0, 0.0], (2, 1)), np.full((2, 2), 0.1)
    division, cost = divided_run((points, *level), np.full(20, 100.0), ends, 1.0)
    # The outliers draw the line, but evenly: its points are one standard error off. A line has two parameters.
    assert division.lines.tolist() == [True]
    assert cost == pytest.approx(0.5 * 20.0 + 2.0, rel=0.05)
    assert division.handles == pytest.approx(np.array([[[20.0, 0.0], [-20.0, 0.0]]]) / 3.0)


def test_a_run_is_divided_where_that_is_cheapest():
    # A line, half a turn of radius 10, and a line back.
    turn = (np.arange(31) + 0.5) / 31 * np.pi
    there = np.arange(30) + 0.5
    points = np.concatenate(
        [
            np.stack([there, np.zeros(30)], axis=1),
            np.stack([30.0 + 10.0 * np.sin(turn), 10.0 - 10.0 * np.cos(turn)], axis=1),
            np.stack([there[::-1], np.full(30, 20.0)], axis=1),
        ]
    )
    angle = np.concatenate([np.zeros(30), turn, np.full(30, np.pi)])
    tangents = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    bend = np.concatenate([np.zeros(30), np.full(31, 0.1), np.zeros(30)])
    ends = np.array([[0.0, 0.0], [0.0, 20.0]]), tangents[[0, -1]], np.full((2, 2), 0.02)
    fits = points, tangents, bend, np.full((91, 2), 0.01)
    division, cost = divided_run(fits, np.full(91, 900.0), ends, 4.0)
    assert division.lines[[0, -1]].tolist() == [True, True] and (~division.lines).sum() in (1, 2)
    assert division.sizes.sum() == 91 and abs(int(division.sizes[0]) - 30) < 4
    # Twice the price of a parameter costs at most as much more as the same pieces do, and no less than before.
    parameters = (np.where(division.lines, 2, 5)).sum()
    assert cost <= divided_run(fits, np.full(91, 900.0), ends, 8.0)[1] <= cost + 4.0 * parameters + 1e-6
