"""Local fits along chains of points, and feet on outlines: the native loops against plain numpy."""

from __future__ import annotations

import numpy as np
import pytest
from outline_loops import nearest_primitive

from cubicsplat_cli.artwork.geometry.outlines import FINE, Circle, Ellipse, Rectangle, derivatives, points_at
from cubicsplat_cli.raster.cubics import Joints, Pieces, newton_steps
from cubicsplat_cli.raster.outlines import BOX, CIRCLE, ELLIPSE, parabolas


def wavy_chain(count: int = 60) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, weights, of which some are 0, and arc lengths of a noisy chain with two corners."""
    rng = np.random.default_rng(4)
    t = np.arange(count, dtype=float)
    points = np.stack([t, 8.0 * np.abs(np.sin(t / 9.0)) + 0.03 * rng.normal(size=count)], axis=1)
    weights = np.where(rng.uniform(size=count) < 0.1, 0.0, rng.uniform(100.0, 900.0, count))
    return points, weights, np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def fitted(
    points: np.ndarray, weights: np.ndarray, at: np.ndarray, degree: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Coefficients, their variances, and the weighted squares across of a polynomial through one run."""
    powers = at[:, None] ** np.arange(degree + 1)
    gram = powers.T @ (weights[:, None] * powers)
    inverse = np.linalg.inv(gram + 1e-9 * np.trace(gram) * np.eye(degree + 1))
    terms = inverse @ (powers.T @ (weights[:, None] * points))
    tangent = terms[1] / np.hypot(*terms[1])
    rest = points - powers @ terms
    return terms, np.diag(inverse), float((weights * (rest[:, 0] * tangent[1] - rest[:, 1] * tangent[0]) ** 2).sum())


def test_parabolas_are_weighted_least_squares_over_the_widest_believed_window():
    points, weights, s = wavy_chain()
    kinds = ((2, np.inf), (4, 2.2), (9, 1.6))
    terms, errors, windows = parabolas(points, weights, s, kinds)
    assert set(windows.tolist()) == {2, 4, 9}
    for i in range(len(points)):
        for half, most in kinds:
            run = np.arange(max(i - half, 0), min(i + half + 1, len(points)))
            w = weights[run] + 1e-6
            own, variance, misfit = fitted(points[run] - points[i], w, (s[run] - s[i]) / half, 2)
            if misfit / max((w > 1e-4).sum() - 3, 1) > most:
                break
            expected, scale = own / half ** np.arange(3.0)[:, None], half
            wide = np.sqrt(variance[:2]) / [1.0, scale]
        expected[0] += points[i]
        assert terms[i] == pytest.approx(expected, rel=1e-6, abs=1e-6)
        assert errors[i] == pytest.approx(wide, rel=1e-6)


def test_feet_pass_on_at_smooth_joints_only():
    rng = np.random.default_rng(2)
    anchors = 10.0 * np.stack([np.cos(np.arange(4) * np.pi / 2), np.sin(np.arange(4) * np.pi / 2)], axis=1)
    after, before = np.roll(anchors, -1, axis=0), np.roll(anchors, 1, axis=0)
    cubics = np.stack([anchors, anchors + 0.55 * after, after + 0.55 * anchors, after], axis=1)
    ends, smooth = np.array([1, 2, 3, 0]), np.array([True, False, True, True])
    angles = np.linspace(-3.0, 3.0, 50)
    points = 10.0 * np.stack([np.cos(angles), np.sin(angles)], axis=1) + 0.1 * rng.normal(size=(50, 2))
    weights, piece, u = rng.uniform(1.0, 9.0, 50), rng.integers(0, 4, 50), rng.uniform(size=50)
    own, at = piece.copy(), u.copy()
    for _ in range(2):
        at = newton_steps(cubics[own], points[:, None], at[:, None])[:, 0]
        on, back = (at > 1.0) & smooth[ends[own]], (at < 0.0) & smooth[own]
        own = (own + on.astype(int) - back) % 4
        at = np.clip(np.where(on, 0.0, np.where(back, 1.0, at)), 0.0, 1.0)
    slopes, _ = derivatives(cubics[own], at[:, None])
    normals = np.stack([-slopes[:, 0, 1], slopes[:, 0, 0]], axis=1) / np.hypot(*slopes[:, 0].T)[:, None]
    rest = ((points_at(cubics[own], at[:, None])[:, 0] - points) * normals).sum(axis=1)
    joints = Joints(np.zeros(4, dtype=bool), smooth, np.zeros(4, dtype=bool), np.arange(8).reshape(4, 2))
    fitted = Pieces((anchors, 0.55 * before, 0.55 * after), joints)
    after, found, chi = fitted.refined(points, weights, (piece, u), 0)
    assert (found[0] == own).all() and (own != piece).any()
    assert found[1] == pytest.approx(at, abs=1e-9) and after.anchors.tolist() == anchors.tolist()
    size = np.abs(rest) * np.sqrt(weights)
    assert size.max() > 3.0 > size.min()
    assert chi == pytest.approx(np.where(size <= 3.0, size**2, 6.0 * size - 9.0).sum())


@pytest.mark.parametrize(
    ("kind", "truth"),
    [
        (CIRCLE, [20.0, 15.0, 9.0, 0.0, 0.0, 0.0]),
        (ELLIPSE, [20.0, 15.0, 9.0, 5.0, 0.0, 0.0]),
        (ELLIPSE, [20.0, 15.0, 9.0, 5.0, 0.0, 0.4]),
        (BOX, [20.0, 15.0, 9.0, 5.0, 0.0, 0.0]),
        (BOX, [20.0, 15.0, 9.0, 5.0, 2.0, 0.0]),
        (BOX, [20.0, 15.0, 9.0, 5.0, 0.0, 0.3]),
        (BOX, [20.0, 15.0, 9.0, 5.0, 2.0, 0.3]),
    ],
)
def test_the_cheapest_primitive_through_points_is_theirs_though_one_is_astray(kind, truth):
    x, y, a, b, radius, angle = truth
    shape = Circle(x, y, a) if kind == CIRCLE else Ellipse(x, y, a, b, angle)
    if kind == BOX:
        shape = Rectangle(x - a, y - b, 2.0 * a, 2.0 * b, radius, angle)
    ring = shape.ring(FINE)
    points = points_at(ring.cubics, np.tile((np.arange(20) + 0.5) / 20, (ring.pieces, 1))).reshape(-1, 2)
    weights, parameters = np.full(len(points), 400.0), shape.parameters
    off = 0.0
    if kind != BOX:
        # 0.5 px are 10 standard errors, which count 3 (2 x 10 - 3); a box has no such point.
        points[7] += 0.5 * (points[7] - [x, y]) / np.hypot(*(points[7] - [x, y]))
        off = 3.0 * (2.0 * 10.0 - 3.0)
    found = nearest_primitive(points, weights, 4.0)
    assert found is not None and found[0] == kind
    count = 3 if kind == CIRCLE else 6
    assert found[1][:count] == pytest.approx(truth[:count], abs=0.02)
    assert 0.6 * off <= found[3] * len(points) <= off + 1e-3
    assert found[2] == pytest.approx(0.5 * found[3] * len(points) + 4.0 * parameters)


def test_a_sliver_is_no_ellipse_that_is_far_longer():
    """Near its middle, such an ellipse is as near to both sides of it as they lie."""
    x = np.linspace(0.0, 30.0, 31)
    half = 0.5 * np.sqrt(1.0 - ((x - 15.0) / 400.0) ** 2)
    points = np.concatenate([np.column_stack([x, half]), np.column_stack([x, -half])[::-1]])
    found = nearest_primitive(points, np.full(len(points), 400.0), 4.0)
    assert found is None or max(found[1][2:4]) < 31.0
