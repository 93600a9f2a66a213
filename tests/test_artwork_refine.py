"""The joint fit of an outline's pieces, the corners of its points, and cubics fitted many at once."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from outline_loops import corners_of
from red_rings import dense
from test_artwork_fitting import sampled, star

from cubicsplat_cli.artwork.geometry.outlines import Circle, Rectangle, bernstein, derivatives, points_at
from cubicsplat_cli.raster.cubics import Joints, Pieces, divided_run, held_ring, tied_coordinates

SIGMA = 0.02


def drop() -> Pieces:
    """A corner, a line, and smooth joints of every kind: line and cubic, cubic and line, two cubics, a level one."""
    anchors = np.array([[50.0, 10.0], [75.0, 50.0], [50.0, 90.0], [25.0, 70.0], [30.0, 40.0]])
    line = (anchors[1] - anchors[0]) / np.hypot(*(anchors[1] - anchors[0]))
    up = (anchors[4] - anchors[3]) / np.hypot(*(anchors[4] - anchors[3]))
    none = np.zeros(2)
    outgoing = np.array([none, 15.0 * line, [-12.0, 0.0], none, 10.0 * up])
    incoming = np.array([[-8.0, 6.0], none, [14.0, 0.0], -9.0 * up, none])
    lines = np.array([True, False, False, True, False])
    smooth = np.array([False, True, True, True, True])
    level = np.array([False, False, True, False, False])
    return Pieces((anchors, incoming, outgoing), Joints(lines, smooth, level, np.arange(10).reshape(5, 2)))


def test_the_control_points_move_with_the_variables_as_the_jacobian_says() -> None:
    pieces = drop()
    jacobian = dense(pieces.jacobian)
    assert jacobian.shape == (40, pieces.joints.variables)
    for k in range(pieces.joints.variables):
        step = np.zeros(pieces.joints.variables)
        step[k] = 1e-5
        ends = [pieces.moved(sign * step).cubics.ravel() for sign in (1.0, -1.0)]
        np.testing.assert_allclose(jacobian[:, k], (ends[0] - ends[1]) / 2e-5, atol=1e-5)


@pytest.mark.parametrize("tied", [np.arange(10).reshape(5, 2), np.full((5, 2), -1)])
@pytest.mark.parametrize("smooth", [drop().joints.smooth, np.zeros(5, dtype=bool), np.ones(5, dtype=bool)])
@pytest.mark.parametrize("level", [drop().joints.level, np.zeros(5, dtype=bool)])
def test_a_variable_moves_what_its_number_says(level: np.ndarray, smooth: np.ndarray, tied: np.ndarray) -> None:
    pieces = replace(drop(), joints=Joints(drop().lines, smooth, level, tied))
    numbers, still = pieces.joints.numbers, pieces.moved(np.zeros(pieces.joints.variables))
    every = np.concatenate([tied.ravel(), *numbers[:3], *numbers[3:], *(each[each >= 0] + 1 for each in numbers[3:])])
    assert sorted(every[every >= 0].tolist()) == [*range(pieces.joints.variables)]
    for lengths, vectors, side in zip(numbers[1:3], numbers[3:], (1, 2), strict=True):
        for k in np.flatnonzero((lengths >= 0) | (vectors >= 0)):
            step = np.zeros(pieces.joints.variables)
            step[lengths[k] if lengths[k] >= 0 else vectors[k]] = 0.25
            before, after = (each.outline[side][k] for each in (still, still.moved(step)))
            way = before / np.hypot(*before) if lengths[k] >= 0 else np.array([1.0, 0.0])
            assert after == pytest.approx(before + 0.25 * way)
    for k in np.flatnonzero(numbers.angle >= 0):
        step = np.zeros(pieces.joints.variables)
        step[numbers.angle[k]] = 0.1
        for side in (1, 2):
            before, after = (each.outline[side][k] for each in (still, still.moved(step)))
            cross = before[0] * after[1] - before[1] * after[0]
            assert cross == pytest.approx(math.sin(0.1) * np.hypot(*before) * np.hypot(*after))


@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3), st.booleans()), min_size=3, max_size=9, unique=True),
    st.sampled_from([(), (2.0,)]),
)
def test_ends_of_level_and_upright_lines_share_a_variable_and_what_is_on_the_border_has_none(places, pins) -> None:
    anchors = np.array([place[:2] for place in places], float)
    lines = np.array([place[2] for place in places])
    controls = np.stack([anchors, np.roll(anchors, -1, axis=0)], axis=1)
    pieces = held_ring(anchors + 0.01, controls, lines, np.zeros(len(lines), bool), (3, 9), 0.06, (pins, ()))
    found, joints = pieces.anchors, pieces.joints
    assert found == pytest.approx(np.where((anchors == 0.0) | (anchors == [3.0, 9.0]), anchors, anchors + 0.01))
    assert joints.level.tolist() == [False] * len(lines)
    numbers = np.arange(anchors.size).reshape(anchors.shape)
    for _ in anchors:  # each takes the least number that it is linked to, once more for every line between the two
        for i, j, c in ((i, (i + 1) % len(lines), c) for i in np.flatnonzero(lines) for c in (0, 1)):
            if found[i, c] == found[j, c]:
                numbers[i, c] = numbers[j, c] = min(numbers[i, c], numbers[j, c])
    held = (found == 0.0) | (found == [3.0, 9.0]) | np.isin(found, pins) & [True, False]
    held = np.isin(numbers, numbers[held])
    assert (joints.tied < 0).tolist() == held.tolist()
    pairs = {*zip(numbers[~held].tolist(), joints.tied[~held].tolist(), strict=True)}
    assert len(pairs) == len(np.unique(numbers[~held])) == joints.tied.max() + 1
    assert (
        (tied_coordinates(found, lines)[..., None, None] == tied_coordinates(found, lines))
        == (numbers[..., None, None] == numbers)
    ).all()


def test_pieces_moved_off_their_points_find_back() -> None:
    truth = drop()
    u = np.tile((np.arange(30) + 0.5) / 30, 5)
    piece = np.repeat(np.arange(5), 30)
    points = (bernstein(u)[:, None, :] @ truth.cubics[piece])[:, 0]
    numbers = truth.joints.numbers
    step = np.random.default_rng(0).normal(0.0, 0.2, truth.joints.variables)
    step[numbers.angle[numbers.angle >= 0]] *= 0.05
    start = truth.moved(step)
    found, _, misfit = start.refined(points, np.full(len(points), SIGMA**-2), (piece, u))
    assert misfit < 5.0
    assert np.abs(found.anchors[0] - truth.anchors[0]).max() < 0.05


@pytest.mark.parametrize("repeats", [1, 20])
def test_a_round_is_a_damped_gauss_newton_step_of_the_variables(repeats: int) -> None:
    one = drop()
    count, shift = len(one.anchors), 200.0 * np.arange(repeats)[:, None, None]
    handles = [np.tile(each, (repeats, 1)) for each in one.outline[1:]]
    flags = {name: np.tile(getattr(one.joints, name), repeats) for name in ("lines", "smooth", "level")}
    anchors = (one.anchors + shift).reshape(-1, 2)
    pieces = Pieces((anchors, *handles), Joints(**flags, tied=np.arange(2 * len(anchors)).reshape(-1, 2)))
    truth = pieces.moved(np.zeros(pieces.joints.variables))
    piece = np.repeat(np.arange(count * repeats), 30)
    u = np.tile((np.arange(30) + 0.5) / 30, count * repeats)
    rng = np.random.default_rng(3)
    points = (bernstein(u)[:, None, :] @ truth.cubics[piece])[:, 0] + rng.normal(0.0, 0.05, (len(u), 2))
    weights = rng.uniform(0.5, 2.0, len(u))
    start, (owner, at), before = truth.refined(points, weights, (piece, u), 0)
    slopes, _ = derivatives(start.cubics[owner], at[:, None])
    normals = np.stack([-slopes[:, 0, 1], slopes[:, 0, 0]], axis=1) / np.hypot(*slopes[:, 0].T)[:, None]
    rest = ((points_at(start.cubics[owner], at[:, None])[:, 0] - points) * normals).sum(axis=1)
    rows = np.zeros((len(u), count * repeats, 8))
    rows[np.arange(len(u)), owner] = (bernstein(at)[:, :, None] * normals[:, None]).reshape(-1, 8)
    jacobian = rows.reshape(len(u), -1) @ dense(start.jacobian)
    gram = jacobian.T @ (weights[:, None] * jacobian)
    gram += np.diag(1e-3 * (gram.diagonal() + 1e-4 * gram.diagonal().max()) + 0.3)
    step = np.linalg.solve(gram, -jacobian.T @ (weights * rest))
    found, _, after = start.refined(points, weights, (piece, u), 1)
    assert after < before
    assert found.cubics == pytest.approx(start.moved(step).cubics, abs=1e-7)


def test_a_star_has_corners_and_a_circle_has_none() -> None:
    points = sampled(star())
    indices, positions, _ = corners_of(points, np.full(len(points), SIGMA**-2))
    assert len(indices) == 10
    away = np.hypot(*np.moveaxis(positions[:, None] - star().anchors, -1, 0)).min(axis=1)
    assert away.max() < 0.15
    for radius in (25.0, 60.0):
        points = sampled(Circle(80.0, 80.0, radius))
        assert len(corners_of(points, np.full(len(points), SIGMA**-2))[0]) == 0


def test_a_corner_is_found_across_unknown_points() -> None:
    points = sampled(Rectangle(20.3, 20.6, 60.0, 40.0))
    near = np.hypot(*(points - [20.3, 20.6]).T) < 2.5
    _, positions, turns = corners_of(points, np.where(near, 0.0, SIGMA**-2))
    assert np.hypot(*(positions - [20.3, 20.6]).T).min() < 0.1
    assert np.degrees(np.abs(turns)) == pytest.approx([90.0] * 4, abs=3.0)


def test_many_cubics_are_found_from_their_points_at_once() -> None:
    turns = np.array([0.3, 0.8, 1.4])
    k = 4.0 / 3.0 * np.tan(turns / 4.0)
    truth = 40.0 * np.stack(
        [
            np.stack([np.ones(3), np.zeros(3)], axis=1),
            np.stack([np.ones(3), k], axis=1),
            np.stack([np.cos(turns) + k * np.sin(turns), np.sin(turns) - k * np.cos(turns)], axis=1),
            np.stack([np.cos(turns), np.sin(turns)], axis=1),
        ],
        axis=1,
    )
    u = np.tile((np.arange(20) + 0.5) / 20, (3, 1))
    points = bernstein(u) @ truth
    last = np.stack([-np.sin(turns), np.cos(turns)], axis=1)
    tangents = np.stack([np.tile([0.0, 1.0], (3, 1)), last], axis=1)
    # The ends are given 0.05 px and the tangents a degree off, within their standard errors.
    positions = truth[:, [0, 3]] + 0.05
    cos, sin = math.cos(0.017), math.sin(0.017)
    tangents = tangents @ np.array([[cos, sin], [-sin, cos]])
    straight = np.tile([1.0, 0.0], (20, 1)), np.zeros(20), np.ones((20, 2))
    cubics = positions[:, [0, 0, 1, 1]]
    for k in range(3):
        ends = positions[k], tangents[k], np.full((2, 2), 0.1)
        division, cost = divided_run((points[k], *straight), np.full(20, SIGMA**-2), ends, 4.0)
        # The price of the six parameters of a cubic between corners, and hardly any misfit.
        assert division.lines.tolist() == [False] and cost < 6.0 * 4.0 + 2.0
        cubics[k, 1:3] += division.handles[0]
    gaps = np.abs(points[:, :, None] - points_at(cubics, np.tile(np.linspace(0.0, 1.0, 999), (3, 1)))[:, None])
    assert np.hypot(gaps[..., 0], gaps[..., 1]).min(axis=2).max() < 0.08
