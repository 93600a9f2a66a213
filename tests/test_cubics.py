"""The native fit of cubics to points, against the same in plain numpy."""

import numpy as np
import pytest

from cubicsplat_cli.artwork.geometry.beziers import bernstein, derivatives, points_at
from cubicsplat_cli.raster.cubics import gauss_newton, newton_steps

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
    _, directions, expected, stiffness, limits = given
    first, _ = derivatives(cubics, u)
    normal = np.stack([-first[..., 1], first[..., 0]], axis=-1) / np.hypot(first[..., 0], first[..., 1])[..., None]
    b = bernstein(u)
    columns = np.einsum("pkc,pka,pvca->pkv", b, normal, directions)
    rest = ((points - b @ cubics) * normal).sum(-1)
    gram = np.einsum("pk,pkv,pkw->pvw", weights, columns, columns) + stiffness[:, None] * np.eye(6)
    slope = np.einsum("pk,pkv,pk->pv", weights, columns, rest) + stiffness * (expected - values)
    values = values + np.linalg.solve(gram, slope[..., None])[..., 0]
    values[:, :2] = np.clip(values[:, :2], limits[:, :1], limits[:, 1:])
    return values


def test_cubics_go_where_plain_gauss_newton_goes():
    random, cubics, points, u = runs(3)
    directions = random.normal(0.0, 1.0, (RUNS, 6, 4, 2))
    expected, stiffness = random.normal(0.0, 0.3, (RUNS, 6)), random.uniform(0.1, 50.0, (RUNS, 6))
    weights = random.uniform(0.0, 20.0, (RUNS, POINTS))
    limits = np.sort(random.uniform(-0.3, 0.3, (RUNS, 2)), axis=1)
    given = (cubics, directions, expected, stiffness, limits)
    values = expected.copy()

    def placed(values):
        return cubics + np.einsum("pv,pvca->pca", values, directions)

    at = np.clip(nearer(placed(values), points, u), 0.0, 1.0)
    for _ in range(ROUNDS):
        values = improved(given, values, placed(values), points, weights, at)
        at = np.clip(nearer(placed(values), points, at), 0.0, 1.0)
    assert (values[:, :2] == limits[:, :1]).any() or (values[:, :2] == limits[:, 1:]).any()
    found = gauss_newton(*given, points, weights, u, ROUNDS)
    assert found[0] == pytest.approx(values, abs=1e-8)
    assert found[1] == pytest.approx(placed(values), abs=1e-8)
    assert found[2] == pytest.approx(at, abs=1e-8)
