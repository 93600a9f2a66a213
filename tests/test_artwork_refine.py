"""The joint fit of an outline's pieces, the corners of its points, and cubics fitted many at once."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from test_artwork_fitting import sampled, star

from cubicsplat_cli.artwork.geometry.outlines import Circle, Rectangle, bernstein, derivatives, points_at
from cubicsplat_cli.artwork.tracing.variables import Feet, Pieces, Variables, refine
from cubicsplat_cli.raster.cubics import divided_run
from cubicsplat_cli.raster.outlines import corners_of

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
    return Pieces(anchors, incoming, outgoing, lines, smooth, level, np.arange(10).reshape(5, 2))


def test_the_control_points_move_with_the_variables_as_the_jacobian_says() -> None:
    variables = Variables(drop())
    jacobian = variables.jacobian().toarray()
    assert jacobian.shape == (40, variables.total)
    for k in range(variables.total):
        step = np.zeros(variables.total + 1)
        step[k] = 1e-5
        ends = [variables.moved(sign * step).cubics.ravel() for sign in (1.0, -1.0)]
        np.testing.assert_allclose(jacobian[:, k], (ends[0] - ends[1]) / 2e-5, atol=1e-5)


def test_the_variables_are_numbered_alike_in_both_languages() -> None:
    for smooth in (drop().smooth, np.zeros(5, dtype=bool), np.ones(5, dtype=bool)):
        for tied in (np.arange(10).reshape(5, 2), np.full((5, 2), -1)):
            variables = Variables(replace(drop(), smooth=smooth, tied=tied))
            assert variables.total == variables.numbering.total
            step = np.zeros(variables.total + 1)
            step[variables.numbering.length_out[2]] = 0.25  # px, of a handle that is smooth or at a corner
            if smooth[2]:
                assert variables.moved(step).outgoing[2] == pytest.approx([-12.25, 0.0])


def test_pieces_moved_off_their_points_find_back() -> None:
    truth = drop()
    u = np.tile((np.arange(30) + 0.5) / 30, 5)
    piece = np.repeat(np.arange(5), 30)
    points = (bernstein(u)[:, None, :] @ truth.cubics[piece])[:, 0]
    variables = Variables(truth)
    step = np.random.default_rng(0).normal(0.0, 0.2, variables.total + 1)
    step[-1] = 0.0
    step[variables.numbering.angle[variables.numbering.turning]] *= 0.05
    start = variables.moved(step)
    found, _, misfit = refine(start, points, np.full(len(points), SIGMA**-2), Feet(piece, u))
    assert misfit < 5.0
    assert np.abs(found.anchors[0] - truth.anchors[0]).max() < 0.05


@pytest.mark.parametrize("repeats", [1, 20])
def test_a_round_is_a_damped_gauss_newton_step_of_the_variables(repeats: int) -> None:
    one = drop()
    count, shift = len(one.anchors), 200.0 * np.arange(repeats)[:, None, None]
    tiled = {name: np.tile(getattr(one, name), (repeats, 1)) for name in ("incoming", "outgoing")}
    flags = {name: np.tile(getattr(one, name), repeats) for name in ("lines", "smooth", "level")}
    anchors = (one.anchors + shift).reshape(-1, 2)
    pieces = Pieces(anchors, **tiled, **flags, tied=np.arange(2 * len(anchors)).reshape(-1, 2))
    truth = Variables(pieces).moved(np.zeros(Variables(pieces).total + 1))
    piece = np.repeat(np.arange(count * repeats), 30)
    u = np.tile((np.arange(30) + 0.5) / 30, count * repeats)
    rng = np.random.default_rng(3)
    points = (bernstein(u)[:, None, :] @ truth.cubics[piece])[:, 0] + rng.normal(0.0, 0.05, (len(u), 2))
    weights = rng.uniform(0.5, 2.0, len(u))
    start, feet, before = refine(truth, points, weights, Feet(piece, u), 0)
    slopes, _ = derivatives(start.cubics[feet.piece], feet.u[:, None])
    normals = np.stack([-slopes[:, 0, 1], slopes[:, 0, 0]], axis=1) / np.hypot(*slopes[:, 0].T)[:, None]
    rest = ((points_at(start.cubics[feet.piece], feet.u[:, None])[:, 0] - points) * normals).sum(axis=1)
    rows = np.zeros((len(u), count * repeats, 8))
    rows[np.arange(len(u)), feet.piece] = (bernstein(feet.u)[:, :, None] * normals[:, None]).reshape(-1, 8)
    jacobian = rows.reshape(len(u), -1) @ Variables(start).jacobian().toarray()
    gram = jacobian.T @ (weights[:, None] * jacobian)
    gram += np.diag(1e-3 * (gram.diagonal() + 1e-4 * gram.diagonal().max()) + 0.3)
    step = np.linalg.solve(gram, -jacobian.T @ (weights * rest))
    found, _, after = refine(start, points, weights, Feet(piece, u), 1)
    assert after < before
    assert found.cubics == pytest.approx(Variables(start).moved(np.append(step, 0.0)).cubics, abs=1e-7)


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
