"""Whole loops that are circles, ellipses or rectangles, fitted to their points by least squares."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Outline, Rectangle
from cubicsplat_cli.artwork.robust import outlying_loss
from cubicsplat_cli.raster.outlines import BOX, CIRCLE, ELLIPSE, Form, fitted_values

ROUNDS = 10
WORST_MISFIT = 9.0  # mean squared residual, in sigmas, above which a primitive is out of the question
FEW = 120  # points suffice for the first fit
# Area over the root of the determinant of the second moments: 12 for rectangles, 4 pi for ellipses, less for the rest.
LEAST_FULLNESS = 11.7
MOST_HIDDEN = 0.03  # share of the loop's length above which its area tells nothing
SHARP_REACH, SHARP_SIGMA = 1.5, 0.3  # px from a sharp corner in which points are biased, and by how much
FAR = 3.0  # sigmas that no point of a rectangle may be off, near its corners either
RADII = (0.15, 0.3, 0.5, 0.75, 1.0)  # of round corners to begin with, as shares of half of the shorter side
LEAST_SIDE = 0.25  # px; half the straight part of a rounded rectangle's longer side, below which it is a circle
MOST_BACK = 0.25  # share of the way around a primitive's middle that a loop may run against its own sense
LEAST_TURN = 2.0 * math.pi / 3.0  # around the middle of a circle or an ellipse that known points must run

Signed = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class _Candidate:
    """A kind of primitive: its form for the fit, the signed distance of points (n, 2) from it, a start, and the outline
    of its values."""

    form: Form
    distance: Signed
    start: np.ndarray
    outline: Callable[[np.ndarray], Outline | None]
    sharp: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None


def fit_primitive(points: np.ndarray, weights: np.ndarray, price: float) -> tuple[Outline, float, float] | None:
    """The cheapest primitive through a closed loop, its description length, and its misfit; None when none comes near.

    points: (n, 2) px. weights: (n,) 1/px^2, 0 where unknown. price: of a parameter, in nats. The misfit is the mean
    squared residual in sigmas.
    """
    known = weights > 0.0
    if known.sum() < 6:
        return None
    p, w = points[known], weights[known]
    middle, spread, turn, fullness = _solid(points)
    whole = (~known).mean() <= MOST_HIDDEN
    if whole and fullness < LEAST_FULLNESS:
        return None
    if not whole:
        middle = 0.5 * (p.min(axis=0) + p.max(axis=0))
        spread = np.ptp(p, axis=0) ** 2 / 14.0
        turn = 0.0
    best = None
    for candidate in _candidates(p, w, middle, spread, turn):
        fitted = _fitted(candidate, p, w)
        if fitted is None:
            continue
        outline, misfit, mean = fitted
        if not _runs_around(points, known, outline):
            continue
        cost = 0.5 * misfit + price * outline.parameters
        if best is None or cost < best[1]:
            best = (outline, cost, mean)
    return best


def _runs_around(points: np.ndarray, known: np.ndarray, outline: Outline) -> bool:
    """Whether the known points of a loop run around a primitive as the loop does, rather than there and back along it,
    and far enough around a circle or an ellipse for it to be one.

    The two sides of a thin sliver lie as near to a huge circle that touches them as to anything, but enclose nothing
    like it; and so does a short arc of anything lie near to some circle.
    """
    ring = outline.ring()
    arms = points - 0.5 * (ring.anchors.min(axis=0) + ring.anchors.max(axis=0))
    onward = np.roll(arms, -1, axis=0)
    turn = np.arctan2(arms[:, 0] * onward[:, 1] - arms[:, 1] * onward[:, 0], (arms * onward).sum(axis=1))
    steps = turn[known & np.roll(known, -1)]
    x, y = (points - points.mean(axis=0)).T
    clockwise = float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) > 0.0
    back = np.maximum(-steps if clockwise else steps, 0.0).sum()
    if not isinstance(outline, Rectangle) and abs(steps.sum()) < LEAST_TURN:
        return False
    return bool(back <= MOST_BACK * np.abs(steps).sum())


def _candidates(p: np.ndarray, w: np.ndarray, middle: np.ndarray, spread: np.ndarray, turn: float) -> list[_Candidate]:
    size = 2.0 * np.sqrt(spread)
    low, high = p.min(axis=0), p.max(axis=0)
    half = 0.5 * (high - low)
    box = [*(0.5 * (low + high)), *half]
    tilt = _box_angle(p)
    q = _turned(p, -tilt)
    tilted_middle = _turned(0.5 * (q.min(axis=0) + q.max(axis=0))[None], tilt)[0]
    tilted = [*tilted_middle, *(0.5 * np.ptp(q, axis=0))]
    few = _few(p)

    def ellipse(v: np.ndarray) -> Outline | None:
        return Ellipse(*map(float, v)) if (v[2:4] > 0.0).all() else None

    return [
        _Candidate(Form(CIRCLE), _circle_distance, np.array([*middle, size.mean()]), lambda v: Circle(*map(float, v))),
        _Candidate(Form(ELLIPSE), lambda v, x: _ellipse_distance(np.append(v, 0.0), x), np.array(box), ellipse),
        _Candidate(Form(ELLIPSE, turned=True), _ellipse_distance, np.array([*middle, *size, turn]), ellipse),
        _box(box, (0.0, 0.0), ""),
        _box(box, (_first_radius(box, 0.0, p[few], w[few]), 0.0), "r"),
        _box(tilted, (0.0, tilt), "a"),
        _box(tilted, (_first_radius(tilted, tilt, p[few], w[few]), tilt), "ra"),
    ]


def _few(p: np.ndarray) -> np.ndarray:
    return np.unique(np.linspace(0, len(p) - 1, FEW).astype(int))


def _first_radius(box: list[float], angle: float, p: np.ndarray, w: np.ndarray) -> float:
    """The radius, of a few, with which a box has its points nearest: what a corner leaves out says nothing of the
    radius as long as that is much too small, so least squares would not find it from there."""
    radii = [share * min(box[2:]) for share in RADII]
    return min(radii, key=lambda r: outlying_loss(_box_distance(np.array([*box, r, angle]), p), w))


def _box(start: list[float], rest: tuple[float, float], free: str) -> _Candidate:
    """A rectangle; free: "r" if its corners are rounded, "a" if it is turned."""

    def full(v: np.ndarray) -> np.ndarray:
        # Least squares may step beyond the roundest of corners, half of the shorter side; there it is that.
        radius = min(v[4], *np.abs(v[2:4])) if "r" in free else 0.0
        return np.array([*v[:4], radius, v[-1] if "a" in free else 0.0])

    def outline(v: np.ndarray) -> Outline | None:
        x, y, a, b, radius, angle = map(float, full(v))
        if min(a, b) <= 0.25 or ("r" in free and radius < 0.5):
            return None
        if max(a, b) - radius < LEAST_SIDE:  # nothing but round corners: a circle has half the parameters
            return None
        return Rectangle(x - a, y - b, 2.0 * a, 2.0 * b, radius, angle)

    def near_corner(v: np.ndarray, p: np.ndarray) -> np.ndarray:
        q = np.abs(_turned(p - v[:2], -full(v)[5])) - v[2:4]
        return np.hypot(*q.T) < SHARP_REACH

    begin = np.array([*start, *([rest[0]] if "r" in free else []), *([rest[1]] if "a" in free else [])])
    form = Form(BOX, "r" in free, "a" in free)
    sharp = None if "r" in free else near_corner
    return _Candidate(form, lambda v, p: _box_distance(full(v), p), begin, outline, sharp)


def _fitted(candidate: _Candidate, p: np.ndarray, w: np.ndarray) -> tuple[Outline, float, float] | None:
    """The outline, chi^2 and mean squared residual in sigmas; None when it is far off."""
    sure = w
    if candidate.sharp is not None:
        w = np.where(candidate.sharp(candidate.start, p), np.minimum(sure, SHARP_SIGMA**-2), sure)
    few = _few(p)
    value, misfit = fitted_values(candidate.form, candidate.start, p[few], w[few], ROUNDS)
    if misfit > 2.0 * WORST_MISFIT * len(few):
        return None
    if candidate.sharp is not None:
        w = np.where(candidate.sharp(value, p), np.minimum(sure, SHARP_SIGMA**-2), sure)
    value, misfit = fitted_values(candidate.form, value, p, w, ROUNDS)
    mean = misfit / max(int((w > 0.0).sum()), 1)
    outline = candidate.outline(value)
    # A round or slanted end of a thin bar is all corner, and hardly a point among those of its sides. What is known no
    # better than near corners may be a guess at what is hidden.
    firm = np.where(sure > SHARP_SIGMA**-2, sure, 0.0)
    if isinstance(outline, Rectangle) and (np.abs(candidate.distance(value, p)) * np.sqrt(firm)).max() > FAR:
        return None
    return None if outline is None or mean > WORST_MISFIT else (outline, misfit, mean)


def _circle_distance(value: np.ndarray, p: np.ndarray) -> np.ndarray:
    return np.hypot(p[:, 0] - value[0], p[:, 1] - value[1]) - value[2]


def _ellipse_distance(value: np.ndarray, p: np.ndarray) -> np.ndarray:
    """The distance to first order, exact on the ellipse and on circles."""
    q = _turned(p - value[:2], -value[4])
    size = np.maximum(np.abs(value[2:4]), 1e-3)
    f = np.hypot(*(q / size).T)
    slope = np.hypot(*(q / size**2).T)
    return (f - 1.0) * f / np.maximum(slope, 1e-9)


def _box_distance(value: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Signed distance from a box; value: middle (2), half sides (2), radius of the corners, angle."""
    q = np.abs(_turned(p - value[:2], -value[5])) - value[2:4] + value[4]
    outside = np.hypot(*np.maximum(q, 0.0).T)
    return outside + np.minimum(q.max(axis=1), 0.0) - value[4]


def _box_angle(p: np.ndarray) -> float:
    """Angle in (-pi/4, pi/4] of the smallest box around the points."""
    angles = np.linspace(-math.pi / 4, math.pi / 4, 46)[1:]
    for width in (math.radians(2.0), math.radians(0.2)):
        cos, sin = np.cos(angles)[:, None], np.sin(angles)[:, None]
        sides = np.ptp(cos * p[:, 0] + sin * p[:, 1], axis=1), np.ptp(cos * p[:, 1] - sin * p[:, 0], axis=1)
        best = angles[int(np.argmin(sides[0] * sides[1]))]
        angles = best + np.linspace(-width, width, 21)
    return float(best)


def _solid(p: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Of the polygon: middle, variances along its main axes (larger first), angle of the first axis, and fullness."""
    origin = p.mean(axis=0)
    a = p - origin
    b = np.roll(a, -1, axis=0)
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    area = 0.5 * cross.sum()
    if abs(area) < 1e-6:
        return origin, np.ones(2), 0.0, 0.0
    middle = ((a + b) * cross[:, None]).sum(axis=0) / (6.0 * area)
    outer = a[:, :, None] * a[:, None, :] + b[:, :, None] * b[:, None, :]
    mixed = 0.5 * (a[:, :, None] * b[:, None, :] + b[:, :, None] * a[:, None, :])
    second = ((outer + mixed) * cross[:, None, None]).sum(axis=0) / (12.0 * area) - np.outer(middle, middle)
    values, vectors = np.linalg.eigh(second)
    values = np.maximum(values, 1e-9)
    fullness = abs(area) / math.sqrt(values[0] * values[1])
    return middle + origin, values[::-1], math.atan2(vectors[1, 1], vectors[0, 1]), fullness


def _turned(p: np.ndarray, angle: float) -> np.ndarray:
    cos, sin = math.cos(angle), math.sin(angle)
    return p @ np.array([[cos, sin], [-sin, cos]])
