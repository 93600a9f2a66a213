"""Which gradient, linear or radial, the pixels of an area follow: its geometry from the directions in which colours
change, then everything together by least squares.

A linear gradient changes in one direction. The direction in which a radial one changes points away from its middle; if
it spreads as an ellipse |A (p - c)| = t, it is that of A^T A (p - c). Either is a linear condition on the unknowns.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.gradients.ramps import (
    PRICE,
    SIGMA,
    STOP_PARAMETERS,
    Ramp,
    best_colours,
    fitted,
    hats,
    misfit,
    ramp_of,
    scatter,
    trimmed,
)
from cubicsplat_cli.scene.paint import Gradient, LinearGradient, Stop, radial_from

# Pixels looked at to choose and to settle; blocks, each of which gives a direction, px of one and pixels that it needs.
FEW_PIXELS, MOST_PIXELS, BLOCKS, LEAST_BLOCK, FULL = 1000, 4000, 300, 3, 5
ROUNDS, ENOUGH = 12, 1e-3
PEAK = 6.0  # px around a middle, where a ramp that rises to it has a tip that looks like an edge
UNLIKELY = 4.0  # times the least scatter
HUBER = 2.0  # levels, beyond which a pixel hardly counts
NEAR_AXIS = 0.05  # tangent of the angle to an axis
LONGEST, FARTHEST = 12.0, 8.0  # of an ellipse's axes; of its middle from the area, in lengths of that


@dataclass(frozen=True)
class Shade:
    """A gradient before it is one: frame (2, 3) as `Gradient.frame`, and the ramp over its t. radial: t is a length;
    parameters: how many numbers the geometry takes. open: whether the ramp goes on, for all that is seen, before its
    first and beyond its last stop."""

    frame: np.ndarray
    radial: bool
    ramp: Ramp
    parameters: int
    open: tuple[bool, bool] = (False, False)

    def t(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        first = self.frame[0, 0] * x + self.frame[0, 1] * y + self.frame[0, 2]
        if not self.radial:
            return first
        return np.hypot(first, self.frame[1, 0] * x + self.frame[1, 1] * y + self.frame[1, 2])

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(n, 4) premultiplied levels at places in px."""
        return self.ramp.at(self.t(x, y))

    def extended(self) -> Shade:
        """The shade with its ramp carried on, where it is open, by as much as it is long."""
        knots, colours = self.ramp.knots.copy(), self.ramp.colours.copy()
        length = knots[-1] - knots[0]
        for end, beside, step in ((0, 1, -length), (-1, -2, length)):
            if self.open[end]:
                colours[end] += step * (colours[end] - colours[beside]) / (knots[end] - knots[beside])
                knots[end] += step
        return Shade(self.frame, self.radial, Ramp(knots, colours), self.parameters, self.open)

    @property
    def price(self) -> float:
        """Nats."""
        return PRICE * (self.parameters + STOP_PARAMETERS * len(self.ramp.knots))


def shade_of(x: np.ndarray, y: np.ndarray, values: np.ndarray, hints: Sequence[Shade] = ()) -> Shade:
    """The gradient with the shortest description of pixels: x, y (n,) px, values (n, 4) premultiplied levels.

    hints: gradients that these pixels may have too; a small part of an ellipse says little about its middle.
    """
    places, slopes = _slopes(x, y, values)
    # Some pixels, in an order that is the same each time but follows neither rows nor columns.
    order = np.random.default_rng(0).permutation(len(x))
    few = order[:FEW_PIXELS]
    px, py, pv = x[few], y[few], values[few]
    scale = float(len(x)) / len(px)
    best, least = None, np.inf
    frames = _frames(places, slopes) + [(hint.frame, True, 5) for hint in hints if hint.radial]
    for frame, radial, parameters in _likely(frames, px, py, pv):
        shade = _settled(Shade(frame, radial, _ramp(frame, radial, px, py, pv), parameters), px, py, pv)
        cost = scale * misfit(shade.at(px, py) - pv) + shade.price
        if cost < least:
            best, least = shade, cost
    assert best is not None  # a linear one is always tried
    best = _pruned(best, px, py, pv, scale)
    if len(x) > FEW_PIXELS:
        many = order[:MOST_PIXELS]
        px, py, pv = x[many], y[many], values[many]
        best = _settled(best, px, py, pv)
    return _reaching(_level(best, px, py, pv, float(len(x)) / len(px)), x, y, values)


def _pruned(shade: Shade, x: np.ndarray, y: np.ndarray, values: np.ndarray, scale: float) -> Shade:
    """The shade with neighbouring stops made one as long as that is cheaper."""
    cost = scale * misfit(shade.at(x, y) - values) + shade.price
    while len(shade.ramp.knots) > 2:
        knots = shade.ramp.knots
        t = shade.t(x, y)
        trials = []
        for i in range(len(knots) - 1):
            one = knots[i] if i == 0 else knots[i + 1] if i == len(knots) - 2 else 0.5 * (knots[i] + knots[i + 1])
            fewer = np.concatenate([knots[:i], [one], knots[i + 2 :]])
            ramp = fitted(t, values, np.ones(len(x)), fewer)
            trial = Shade(shade.frame, shade.radial, ramp, shade.parameters)
            trials.append((misfit(trial.at(x, y) - values), i, trial))
        trial = _settled(min(trials)[2], x, y, values)
        following = scale * misfit(trial.at(x, y) - values) + trial.price
        if following >= cost:
            break
        shade, cost = trial, following
    return shade


def _level(shade: Shade, x: np.ndarray, y: np.ndarray, values: np.ndarray, scale: float) -> Shade:
    """A linear shade exactly along an axis, where the pixels do not mind."""
    slope = shade.frame[0, :2]
    axis = int(np.abs(slope).argmax())
    if shade.radial or abs(slope[1 - axis]) > NEAR_AXIS * abs(slope[axis]):
        return shade
    frame = np.zeros((2, 3))
    frame[0, axis] = slope[axis]
    frame[0, 2] = shade.frame[0, 2] + slope[1 - axis] * float(x.mean() if axis else y.mean())
    level = Shade(frame, False, shade.ramp, 1)
    ramp = fitted(level.t(x, y), values, np.ones(len(x)), shade.ramp.knots)
    level = Shade(frame, False, ramp, 1)
    loss = scale * (misfit(level.at(x, y) - values) - misfit(shade.at(x, y) - values))
    return level if loss < PRICE else shade


def _reaching(shade: Shade, x: np.ndarray, y: np.ndarray, values: np.ndarray) -> Shade:
    """The shade with stops that end its ramp where the pixels looked at did brought on to where all pixels end, and a
    pixel farther, where edges blend."""
    t, (knots, colours) = shade.t(x, y), (shade.ramp.knots.copy(), shade.ramp.colours.copy())
    margin = float(np.hypot(*shade.frame[0, :2]))
    goes_on = [False, False]
    for end, beside in ((0, 1), (-1, -2)):
        beyond = t < knots[0] if end == 0 else t > knots[-1]
        slope = (colours[end] - colours[beside]) / (knots[end] - knots[beside])
        off = colours[end] - values[beyond]
        tip = shade.radial and end == 0 and knots[0] < PEAK * margin
        if not tip and (off**2).sum() < ((off + slope * (t[beyond] - knots[end])[:, None]) ** 2).sum():
            continue
        place = min(float(t.min()), knots[0]) - margin if end == 0 else max(float(t.max()), knots[-1]) + margin
        place = 0.0 if tip else max(place, 0.0) if shade.radial else place
        colours[end] += slope * (place - knots[end])
        knots[end] = place
        goes_on[end] = True
    return Shade(shade.frame, shade.radial, Ramp(knots, _valid(colours)), shade.parameters, (goes_on[0], goes_on[1]))


def _valid(colours: np.ndarray) -> np.ndarray:
    """Premultiplied colours in levels that are ones."""
    alpha = np.clip(colours[:, 3:], 0.0, 255.0)
    return np.concatenate([np.clip(colours[:, :3], 0.0, alpha), alpha], axis=1)


def _likely(
    frames: list[tuple[np.ndarray, bool, int]], x: np.ndarray, y: np.ndarray, values: np.ndarray
) -> list[tuple[np.ndarray, bool, int]]:
    """The geometries along whose t colours scatter hardly more than along that of the best."""
    nothing = Ramp(np.array([0.0, 1.0]), np.zeros((2, 4)))
    spread = np.array([scatter(Shade(f, radial, nothing, 0).t(x, y), values) for f, radial, _ in frames])
    return [frame for frame, own in zip(frames, spread, strict=True) if own <= UNLIKELY * spread.min() + SIGMA**2]


def _ramp(frame: np.ndarray, radial: bool, x: np.ndarray, y: np.ndarray, values: np.ndarray) -> Ramp:
    nothing = Ramp(np.array([0.0, 1.0]), np.zeros((2, 4)))
    return ramp_of(Shade(frame, radial, nothing, 0).t(x, y), values)


def _slopes(x: np.ndarray, y: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles of blocks (b, 2) px and how the colours change there (b, 4, 2), levels per px times the root of the
    pixels, so that each block counts as its errors allow."""
    size = max(LEAST_BLOCK, math.ceil(math.sqrt(len(x) / BLOCKS)))
    left, top = float(x.min()), float(y.min())
    columns = int((float(x.max()) - left) // size) + 1
    index = ((y - top) // size).astype(int) * columns + ((x - left) // size).astype(int)
    names, index = np.unique(index, return_inverse=True)
    count = np.bincount(index).astype(float)

    def mean(v: np.ndarray) -> np.ndarray:
        return np.bincount(index, v, len(names)) / count

    mx, my = mean(x), mean(y)
    dx, dy = x - mx[index], y - my[index]
    xx, xy, yy = mean(dx * dx), mean(dx * dy), mean(dy * dy)
    det = xx * yy - xy * xy
    good = (count >= FULL) & (det > 0.02)
    det = np.where(good, det, 1.0)
    slopes = np.empty((len(names), 4, 2))
    for k in range(4):
        vx, vy = mean(dx * values[:, k]), mean(dy * values[:, k])
        slopes[:, k, 0] = (vx * yy - vy * xy) / det
        slopes[:, k, 1] = (vy * xx - vx * xy) / det
    slopes *= np.sqrt(count * np.minimum(xx, yy))[:, None, None]
    return np.stack([mx, my], axis=1)[good], slopes[good]


def _frames(places: np.ndarray, slopes: np.ndarray) -> list[tuple[np.ndarray, bool, int]]:
    """Geometries to begin with: frame, whether radial, and how many numbers it takes."""
    tensor = np.einsum("bki,bkj->ij", slopes, slopes)
    direction = np.linalg.eigh(tensor)[1][:, 1] if len(places) else np.array([1.0, 0.0])
    frames: list[tuple[np.ndarray, bool, int]] = [(np.array([[*direction, 0.0], [0.0, 0.0, 0.0]]), False, 2)]
    if len(places) < 6:
        return frames
    middle = places.mean(axis=0)
    reach = max(float(np.abs(places - middle).max()), 1.0)
    at = (places - middle) / reach
    gx, gy = slopes[..., 0], slopes[..., 1]
    px, py = at[:, :1] + np.zeros_like(gx), at[:, 1:] + np.zeros_like(gx)
    # A circle: slope x (place - c) = 0; an ellipse: slope x (M place - m) = 0.
    square = np.stack([-gy, gx], axis=-1).reshape(-1, 2)
    centre = np.linalg.lstsq(square, (gx * py - gy * px).ravel(), rcond=None)[0]
    if np.abs(centre).max() < FARTHEST:
        frames.append((_frame(np.eye(2), centre, middle, reach), True, 3))
    rows = np.stack([-gy * px, gx * px - gy * py, gx * py, gy, -gx], axis=-1).reshape(-1, 5)
    solution = np.linalg.eigh(rows.T @ rows)[1][:, 0]
    form = np.array([[solution[0], solution[1]], [solution[1], solution[2]]])
    form = form if np.trace(form) > 0 else -form
    values, axes = np.linalg.eigh(form)
    if values[0] > values[1] / LONGEST**2:
        centre = np.linalg.solve(np.array([[solution[0], solution[1]], [solution[1], solution[2]]]), solution[3:])
        if np.abs(centre).max() < FARTHEST:
            frames.append((_frame((axes * np.sqrt(values / values[1])).T, centre, middle, reach), True, 5))
    return frames


def _frame(turn: np.ndarray, centre: np.ndarray, middle: np.ndarray, reach: float) -> np.ndarray:
    place = middle + centre * reach
    return np.column_stack([turn, -turn @ place])


def _settled(shade: Shade, x: np.ndarray, y: np.ndarray, values: np.ndarray) -> Shade:
    """The shade with its geometry and the places of its inner stops at their best, by Gauss-Newton steps in which the
    colours always are (variable projection, with differences for derivatives)."""
    pixels = _Pixels(x, y, values)
    at = shade.at(x, y)
    weights = _trust(at - values)
    value, damping = _value(at - values), 1e-3
    for _ in range(ROUNDS):
        steps = _steps(shade, x, y)
        columns = [
            (pixels.moved(shade, np.where(np.arange(len(steps)) == k, step, 0.0), weights)[1] - at).ravel() / step
            for k, step in enumerate(steps)
        ]
        jacobian = np.stack(columns, axis=1)
        heavy = (np.repeat(weights, 4)[:, None] * jacobian).T
        gram, gradient = heavy @ jacobian, heavy @ (at - values).ravel()
        gained = 0.0
        while damping < 1e6:
            step = np.linalg.solve(gram + damping * np.diag(np.diag(gram) + 1e-12), -gradient)
            trial, there = pixels.moved(shade, step, weights)
            following = _value(there - values)
            if following < value:
                gained = value - following
                shade, at, value, damping = trial, there, following, damping / 5.0
                weights = _trust(at - values)
                break
            damping *= 5.0
        if gained < ENOUGH * value:
            break
    return Shade(shade.frame, shade.radial, trimmed(shade.ramp), shade.parameters)


def _trust(residuals: np.ndarray) -> np.ndarray:
    """(n,) the weights by which outliers count less."""
    return np.minimum(1.0, HUBER**2 / np.maximum((residuals * residuals).sum(axis=1), 1e-9))


def _value(residuals: np.ndarray) -> float:
    square = (residuals * residuals).sum(axis=1)
    return float(
        np.where(square < HUBER**2, square, HUBER**2 * (1.0 + np.log(np.maximum(square, 1e-9) / HUBER**2))).sum()
    )


def _steps(shade: Shade, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Small steps of what is free of a shade: numbers of its frame, and the places of its stops."""
    reach = max(float(np.ptp(x)), float(np.ptp(y)), 1.0)
    span = max(float(shade.ramp.knots[-1] - shade.ramp.knots[0]), 1e-9)
    middle, shape = [1e-4 * reach] * 2, [1e-3] * 2
    geometry = {2: [1e-3], 3: middle, 5: middle + shape}[shade.parameters]
    return np.array([*geometry, *[1e-3 * span] * len(shade.ramp.knots)])


@dataclass(frozen=True)
class _Pixels:
    """What a shade is fitted to."""

    x: np.ndarray
    y: np.ndarray
    values: np.ndarray

    def moved(self, shade: Shade, step: np.ndarray, weights: np.ndarray) -> tuple[Shade, np.ndarray]:
        """The shade after a step, its colours the best there, and its colours (n, 4) at the pixels."""
        count = len(step) - len(shade.ramp.knots)
        frame = _stepped(shade, step[:count], self.x, self.y)
        knots = np.sort(shade.ramp.knots + step[count:])
        knots[1:] = np.maximum(knots[1:], knots[:-1] + 1e-6 * (knots[-1] - knots[0]) + 1e-12)
        moved = Shade(frame, shade.radial, Ramp(knots, shade.ramp.colours), shade.parameters)
        basis = hats(moved.t(self.x, self.y), knots)
        colours = best_colours(basis, self.values, weights)
        return Shade(frame, shade.radial, Ramp(knots, colours), shade.parameters), basis @ colours


def _stepped(shade: Shade, step: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The frame after a step: of a direction its turn about the middle, of an ellipse its middle and its shape."""
    frame = shade.frame
    middle = np.array([float(x.mean()), float(y.mean())])
    if shade.parameters == 2:
        cos, sin = math.cos(float(step[0])), math.sin(float(step[0]))
        along = np.array([cos * frame[0, 0] - sin * frame[0, 1], sin * frame[0, 0] + cos * frame[0, 1]])
        shift = frame[0, :2] @ middle + frame[0, 2] - along @ middle
        return np.array([[*along, shift], [0.0, 0.0, 0.0]])
    turn = frame[:, :2]
    centre = np.linalg.solve(turn, -frame[:, 2]) + step[:2]
    if shade.parameters == 5:
        # A symmetric change: stretched along x and at 45 degrees; its scale is the ramp's.
        change = np.array([[1.0 + step[2], step[3]], [step[3], 1.0 - step[2]]])
        turn = turn @ change
    return np.column_stack([turn, -turn @ centre])


def gradient_of(shade: Shade) -> Gradient:
    """The gradient with 8-bit stops, t = 0 at the first of a linear one and t = 1 at the last."""
    knots = shade.ramp.knots
    first = knots[0] if not shade.radial else 0.0
    span = max(float(knots[-1] - first), 1e-9)
    stops = tuple(
        Stop(float(np.clip((knot - first) / span, 0.0, 1.0)), ink)
        for knot, ink in zip(knots.tolist(), _inks(shade.ramp.colours), strict=True)
    )
    if not shade.radial:
        slope = shade.frame[0, :2]
        square = float(slope @ slope)
        # The ends nearest to the area: the start on the line through the frame's own origin.
        start = slope * (first - shade.frame[0, 2]) / square
        end = start + slope * span / square
        return LinearGradient(float(start[0]), float(start[1]), float(end[0]), float(end[1]), stops)
    turn = np.linalg.inv(shade.frame[:, :2])
    return radial_from(np.column_stack([turn * span, -turn @ shade.frame[:, 2]]), stops)


def _inks(colours: np.ndarray) -> list[tuple[int, int, int, int]]:
    """8-bit inks of premultiplied colours (K, 4) in levels; a clear one has the colour of the stop beside it."""
    inks: list[tuple[int, int, int, int]] = []
    alpha = np.clip(colours[:, 3], 0.0, 255.0)
    visible = np.flatnonzero(alpha >= 8.0)
    for i in range(len(colours)):
        own = i if alpha[i] >= 8.0 or not len(visible) else int(visible[np.abs(visible - i).argmin()])
        straight = np.clip(np.rint(colours[own, :3] * 255.0 / max(float(alpha[own]), 1e-9)), 0, 255)
        r, g, b = (int(v) for v in straight)
        inks.append((r, g, b, round(float(alpha[i]))))
    return inks
