"""Whole loops that are circles, ellipses or rectangles, fitted to their points by least squares."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from cubicsplat_cli.artwork.outlines import Circle, Ellipse, Outline, Rectangle

ROUNDS = 12
HUBER = 3.0
WORST_RMS = 3.0  # sigmas: a primitive farther away from its points than that is none

Signed = Callable[[np.ndarray, np.ndarray], np.ndarray]


def fit_primitive(points: np.ndarray, weights: np.ndarray, price: float) -> tuple[Outline, float] | None:
    """The cheapest primitive through a closed loop, and its description length; None when none comes near.

    points: (n, 2) px. weights: (n,) 1/px^2, 0 where unknown. price: of a parameter, in nats.
    """
    known = weights > 0.0
    if known.sum() < 6:
        return None
    p, w = points[known], weights[known]
    found = []
    for candidate in (_circle, _ellipse, _rectangle):
        found += candidate(p, w)
    costs = [
        (0.5 * misfit + price * shape.parameters, k) for k, (shape, misfit, n) in enumerate(found) if _near(misfit, n)
    ]
    if not costs:
        return None
    cost, k = min(costs)
    return found[k][0], cost


def _near(misfit: float, count: float) -> bool:
    return misfit <= WORST_RMS**2 * max(count, 1.0)


Found = list[tuple[Outline, float, float]]


def _circle(p: np.ndarray, w: np.ndarray) -> Found:
    middle, axes, _ = _moments(p, w)
    start = np.array([*middle, math.sqrt(2.0) * float(np.sqrt(axes.mean()))])
    value, misfit = _least_squares(_circle_distance, start, p, w)
    return [(Circle(*map(float, value)), misfit, len(p))] if value[2] > 0.0 else []


def _circle_distance(value: np.ndarray, p: np.ndarray) -> np.ndarray:
    return np.hypot(p[:, 0] - value[0], p[:, 1] - value[1]) - value[2]


def _ellipse(p: np.ndarray, w: np.ndarray) -> Found:
    middle, axes, turn = _moments(p, w)
    sizes = np.sqrt(2.0 * np.maximum(axes, 1e-6))
    out: Found = []
    for angle in (None, 0.0):
        if angle is None:
            start = np.array([*middle, *sizes, turn])
            value, misfit = _least_squares(_ellipse_distance, start, p, w)
        else:
            half = 0.5 * np.ptp(p, axis=0)
            value, misfit = _least_squares(
                lambda v, q: _ellipse_distance(np.append(v, 0.0), q), np.array([*middle, *half]), p, w
            )
            value = np.append(value, 0.0)
        if (value[2:4] > 0.0).all():
            out.append((Ellipse(*map(float, value)), misfit, len(p)))
    return out


def _ellipse_distance(value: np.ndarray, p: np.ndarray) -> np.ndarray:
    """First-order distance (Sampson), refined by the radial one; both agree near the ellipse."""
    q = _turned(p - value[:2], -value[4])
    size = np.maximum(np.abs(value[2:4]), 1e-3)
    f = np.hypot(*(q / size).T)
    slope = np.hypot(*(q / size**2).T)
    return (f - 1.0) * f / np.maximum(slope, 1e-9)


def _rectangle(p: np.ndarray, w: np.ndarray) -> Found:
    out: Found = []
    for free in (False, True):
        turn = _box_angle(p) if free else 0.0
        q = _turned(p, -turn)
        low, high = q.min(axis=0), q.max(axis=0)
        middle = _turned(0.5 * (low + high)[None], turn)[0]
        half = 0.5 * (high - low)
        for radius in (0.0, 0.25 * float(half.min())):
            start = [*middle, *half]
            if radius:
                start.append(radius)
            fitted = _fitted_box(np.array(start), turn, free, radius > 0.0, p, w)
            if fitted is not None:
                out.append(fitted)
    return out


def _fitted_box(start: np.ndarray, turn: float, free: bool, rounded: bool, p: np.ndarray, w: np.ndarray):
    def full(v: np.ndarray) -> np.ndarray:
        radius = v[4] if rounded else 0.0
        return np.array([*v[:4], radius, v[-1] if free else turn])

    if not rounded:
        # The points next to a sharp corner are biased.
        w = w * (_corner_distance(full(np.append(start, turn) if free else start), p) > 2.0)
        if (w > 0.0).sum() < 6:
            return None
    start = np.append(start, turn) if free else start
    value, misfit = _least_squares(lambda v, q: _box_distance(full(v), q), start, p, w)
    x, y, a, b, radius, angle = full(value)
    if min(a, b) <= 0.25 or not 0.0 <= radius <= 1.02 * min(a, b):
        return None
    radius = min(radius, a, b)
    shape = Rectangle(float(x - a), float(y - b), float(2 * a), float(2 * b), float(radius), float(angle))
    return shape, misfit, float((w > 0.0).sum())


def _box_distance(value: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Signed distance from a box; value: middle (2), half sides (2), radius of the corners, angle."""
    q = np.abs(_turned(p - value[:2], -value[5])) - value[2:4] + value[4]
    outside = np.hypot(*np.maximum(q, 0.0).T)
    return outside + np.minimum(q.max(axis=1), 0.0) - value[4]


def _corner_distance(value: np.ndarray, p: np.ndarray) -> np.ndarray:
    q = np.abs(_turned(p - value[:2], -value[5])) - value[2:4]
    return np.hypot(*q.T)


def _box_angle(p: np.ndarray) -> float:
    """Angle in (-pi/4, pi/4] of the smallest box around the points."""
    angles = np.linspace(-math.pi / 4, math.pi / 4, 91)[1:]
    for width in (math.radians(1.0), math.radians(0.1)):
        areas = []
        for angle in angles:
            sides = np.ptp(_turned(p, -angle), axis=0)
            areas.append(sides.prod())
        best = angles[int(np.argmin(areas))]
        angles = best + np.linspace(-width, width, 21)
    return float(best)


def _moments(p: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Middle, variances along the main axes (larger first), and the angle of the first axis."""
    middle = 0.5 * (p.min(axis=0) + p.max(axis=0))
    q = p - middle
    steps = np.hypot(*(np.roll(p, -1, axis=0) - np.roll(p, 1, axis=0)).T)
    values, vectors = np.linalg.eigh((q * steps[:, None]).T @ q / steps.sum())
    return middle, values[::-1], math.atan2(vectors[1, 1], vectors[0, 1])


def _turned(p: np.ndarray, angle: float) -> np.ndarray:
    cos, sin = math.cos(angle), math.sin(angle)
    return p @ np.array([[cos, sin], [-sin, cos]])


def _least_squares(distance: Signed, start: np.ndarray, p: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, float]:
    """Levenberg-Marquardt with Huber weights and central differences; the parameters and chi^2."""
    value, damping = start.astype(float), 1e-3
    rest = distance(value, p)
    best = _huber(rest, w)
    for _ in range(ROUNDS):
        columns = []
        for k in range(len(value)):
            step = np.zeros(len(value))
            step[k] = 1e-4
            columns.append((distance(value + step, p) - distance(value - step, p)) / 2e-4)
        jacobian = np.stack(columns, axis=1)
        z = np.abs(rest) * np.sqrt(w)
        weighted = jacobian * (w * np.minimum(1.0, HUBER / np.maximum(z, 1e-12)))[:, None]
        gram = weighted.T @ jacobian
        system = gram + damping * np.diag(np.diag(gram)) + 1e-9 * np.eye(len(value))
        trial = value - np.linalg.solve(system, weighted.T @ rest)
        trial_rest = distance(trial, p)
        misfit = _huber(trial_rest, w)
        if misfit < best:
            gain, best, value, rest = best - misfit, misfit, trial, trial_rest
            damping = max(damping / 10.0, 1e-8)
            if gain < 1e-3 * best + 1e-3:
                break
        else:
            damping *= 10.0
    return value, best


def _huber(rest: np.ndarray, w: np.ndarray) -> float:
    z = np.abs(rest) * np.sqrt(w)
    return float(np.where(z <= HUBER, z * z, HUBER * (2.0 * z - HUBER)).sum())
