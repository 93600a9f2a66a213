"""The gradient, linear or radial, that has the shortest description of the pixels of an area.

The first geometries follow from the directions in which colours change. A linear gradient changes in one direction.
A circular one changes along the line to its middle c; one that spreads as an ellipse |A (p - c)| = t changes along
A^T A (p - c). Either is a linear condition on the unknowns. A gradient with a focus f other than its middle looks alike
at all sizes around f. While its colours C follow a straight line, (p - f) . grad C = C - C(f), which is linear in f and
C(f). With s along that line, s^2 = 2 s (l . v) + v^T P v for v = p - f, which is linear in l and P.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.artwork.gradients.parts import TIP
from cubicsplat_cli.artwork.gradients.shade import CLOSE, SHARE, SIGMA, STOP_PARAMETERS, Ramp, Shade
from cubicsplat_cli.artwork.shapes import PRICE
from cubicsplat_cli.raster.shades import Pixels, best_stops, fitted, reach, scatter, slopes

BLOCKS, LEAST_BLOCK, FULL = 300, 3, 5  # blocks that each show a direction, side of one in px, and pixels that it needs
FARTHEST = 12.0  # ratio of an ellipse's axes, and distance of its middle in lengths of the area, at most
FEW_PIXELS, MOST_PIXELS = 1000, 4000  # pixels with which a geometry is chosen, and with which it is fitted
MOST_STOPS = 8
STEADY = 0.1  # share of the steepest slope, below which a block lies beyond the end of the ramp
MOST_LEAN = 0.9  # ratio of the focus' distance from the middle to the radius, to begin with
SLIGHT = 0.05  # that ratio, or the tangent of a linear gradient's angle to an axis, which may be zero as well
UNLIKELY = 4.0  # a geometry is tried if its scatter is at most so many times the least


def shade_of(pixels: Pixels, hints: Sequence[Shade] = ()) -> Shade:
    """Return the gradient with the shortest description of pixels. hints: gradients that these pixels may show too,
    since a small part of an ellipse says little about its middle."""
    shade = common_shade(pixels, hints, np.inf)
    assert shade is not None
    return shade


def common_shade(pixels: Pixels, hints: Sequence[Shade] = (), most: float = (2.0 * CLOSE) ** 2) -> Shade | None:
    """Return the same; None if in every geometry the pixels of one t differ by more than `most` levels^2 in the mean,
    as pixels twice as far off as explained ones do, so that no gradient comes near them all."""
    count, sample = len(pixels.x), _sample(pixels)
    few = sample.some(np.arange(min(count, FEW_PIXELS)))
    frames = _first_frames(pixels) + [(hint.frame, True, max(hint.parameters, 5)) for hint in hints if hint.radial]
    spread = np.array([scatter(frame, radial, few) for frame, radial, _ in frames])
    if spread.min() > most:
        return None
    likely = [frames[k] for k in np.flatnonzero(spread <= UNLIKELY**2 * spread.min() + SIGMA**2)]
    shades = [_stopped(*frame, few, SIGMA) for frame in likely]
    # Errors that no geometry explains, such as a JPEG's near edges, tell how little the pixels say.
    sigma = min(_sigma(shade, few) for shade in shades)
    if sigma > SIGMA:
        shades = [_stopped(*frame, few, sigma) for frame in likely]
    best = _pruned(min(shades, key=lambda shade: _cost(shade, few, count, sigma)), few, count, sigma)
    if count > FEW_PIXELS:
        best = _fitted(best, sample)
    return reaching(_level(best, sample, count, sigma), pixels)


def _sample(pixels: Pixels) -> Pixels:
    """Return at most MOST_PIXELS of some pixels, in random order, but in the same one each time."""
    count = len(pixels.x)
    return pixels.some(np.random.default_rng(0).choice(count, min(count, MOST_PIXELS), replace=False))


def _stopped(frame: np.ndarray, radial: bool, parameters: int, pixels: Pixels, sigma: float) -> Shade:
    """Return the gradient of a geometry that has the shortest description of pixels. sigma: levels of their errors."""
    stops = best_stops(frame, radial, pixels, MOST_STOPS, PRICE * STOP_PARAMETERS * 2.0 * sigma**2 / SHARE)
    return _fitted(Shade(frame, radial, Ramp(*stops).trimmed(), parameters), pixels)


def _sigma(shade: Shade, pixels: Pixels) -> float:
    """Return the standard deviation, in levels, of the errors that a gradient leaves of pixels, at least SIGMA."""
    sigma = SIGMA
    while (grown := sigma * math.sqrt(shade.misfit(pixels, sigma) / (1.5 * SHARE * len(pixels.x)))) > 1.1 * sigma:
        sigma = grown
    return sigma


def refitted(shade: Shade, pixels: Pixels) -> Shade:
    """Return the gradient near another one that is best for pixels."""
    count, some = len(pixels.x), _sample(pixels)
    shade = _fitted(shade.extended(), some)
    sigma = _sigma(shade, some)
    return reaching(_level(_pruned(shade, some, count, sigma), some, count, sigma), pixels)


def _fitted(shade: Shade, pixels: Pixels) -> Shade:
    """Return the shade with its geometry and its stops fitted to pixels."""
    frame, knots, colours = fitted(shade.frame, shade.parameters, shade.ramp.knots, shade.ramp.colours, pixels)
    return Shade(frame, shade.radial, Ramp(knots, colours).trimmed(), shade.parameters)


def _cost(shade: Shade, some: Pixels, count: int, sigma: float) -> float:
    """Return the nats of `count` pixels, estimated from some of them, and of the shade."""
    return count / len(some.x) * shade.misfit(some, sigma) + shade.price


def _pruned(shade: Shade, pixels: Pixels, count: int, sigma: float) -> Shade:
    """Return the shade with neighbouring stops joined as long as that is cheaper."""
    cost = _cost(shade, pixels, count, sigma)
    while len(shade.ramp.knots) > 2:
        knots = shade.ramp.knots
        # The end stops stay where they are.
        joined = [knots[0], *(0.5 * (knots[1:-2] + knots[2:-1])), knots[-1]]
        fewer = (np.concatenate([knots[:i], [one], knots[i + 2 :]]) for i, one in enumerate(joined))
        trials = [shade.stopped(each, pixels) for each in fewer]
        trial = _fitted(min(trials, key=lambda trial: trial.misfit(pixels)), pixels)
        following = _cost(trial, pixels, count, sigma)
        if following >= cost:
            break
        shade, cost = trial, following
    return shade


def _level(shade: Shade, pixels: Pixels, count: int, sigma: float) -> Shade:
    """Return a linear shade exactly along an axis if that costs less than the angle."""
    slope = shade.frame[0, :2]
    axis = int(np.abs(slope).argmax())
    if shade.radial or abs(slope[1 - axis]) > SLIGHT * abs(slope[axis]):
        return shade
    frame = np.zeros((2, 4))
    frame[0, axis] = slope[axis]
    frame[0, 2] = shade.frame[0, 2] + slope[1 - axis] * float((pixels.x if axis else pixels.y).mean())
    level = Shade(frame, False, shade.ramp, 1).stopped(shade.ramp.knots, pixels)
    loss = count / len(pixels.x) * (level.misfit(pixels, sigma) - shade.misfit(pixels, sigma))
    return level if loss < PRICE else shade


def reaching(shade: Shade, pixels: Pixels) -> Shade:
    """Return the shade with its ramp carried on to where all pixels end, and a pixel farther, where edges blend, unless
    the pixels beyond a stop show that the ramp ends there."""
    knots, colours = shade.ramp.knots.copy(), shade.ramp.colours.copy()
    (least, most), squares = reach(shade.given, pixels)
    margin = float(np.hypot(*shade.frame[0, :2]))
    goes_on = [False, False]
    for end, beside in ((0, 1), (-1, -2)):
        slope = (colours[end] - colours[beside]) / (knots[end] - knots[beside])
        tip = shade.radial and end == 0 and knots[0] < TIP * margin
        flat, carried_on = squares[end]
        if not tip and flat < carried_on:
            continue
        place = min(float(least) - margin, knots[0]) if end == 0 else max(float(most) + margin, knots[-1])
        if shade.radial:
            place = 0.0 if tip else max(place, 0.0)
        colours[end] += slope * (place - knots[end])
        knots[end] = place
        goes_on[end] = True
    colours[:, 3:] = alpha = np.clip(colours[:, 3:], 0.0, 255.0)
    colours[:, :3] = np.clip(colours[:, :3], 0.0, alpha)
    return Shade(shade.frame, shade.radial, Ramp(knots, colours), shade.parameters, (goes_on[0], goes_on[1]))


def _first_frames(pixels: Pixels) -> list[tuple[np.ndarray, bool, int]]:
    """Return geometries for pixels: frame (2, 4), True if radial, and its numbers; the first is linear."""
    size = max(LEAST_BLOCK, math.ceil(math.sqrt(len(pixels.x) / BLOCKS)))
    places, changes, means, weights = slopes(pixels, size, FULL)
    tensor = np.einsum("bki,bkj->ij", changes, changes)
    direction = np.linalg.eigh(tensor)[1][:, 1] if len(places) else np.array([1.0, 0.0])
    frames = [(np.array([[*direction, 0.0, 0.0], [0.0] * 4]), False, 2)]
    if len(places) < 6:
        return frames
    middle = places.mean(axis=0)
    reach = max(float(np.abs(places - middle).max()), 1.0)
    at = (places - middle) / reach
    gx, gy = changes[..., 0], changes[..., 1]
    px, py = at[:, :1] + np.zeros_like(gx), at[:, 1:] + np.zeros_like(gx)
    # A circle: slope x (place - c) = 0; an ellipse: slope x (M place - m) = 0.
    square = np.stack([-gy, gx], axis=-1).reshape(-1, 2)
    centre = np.linalg.lstsq(square, (gx * py - gy * px).ravel(), rcond=None)[0]
    if np.abs(centre).max() < FARTHEST:
        frames.append((_frame(np.eye(2), centre, middle, reach), True, 3))
    rows = np.stack([-gy * px, gx * px - gy * py, gx * py, gy, -gx], axis=-1).reshape(-1, 5)
    solution = np.linalg.eigh(rows.T @ rows)[1][:, 0]
    form = solution[[[0, 1], [1, 2]]]
    form = form if np.trace(form) > 0 else -form
    values, axes = np.linalg.eigh(form)
    if values[0] > values[1] / FARTHEST**2:
        centre = np.linalg.solve(solution[[[0, 1], [1, 2]]], solution[3:])
        if np.abs(centre).max() < FARTHEST:
            frames.append((_frame((axes * np.sqrt(values / values[1])).T, centre, middle, reach), True, 5))
    if (focal := _focal_frame(at, changes * reach, means, weights)) is not None:
        frames.append((_frame(*focal[:2], middle, reach, focal[2]), True, 7))
    return frames


def _focal_frame(
    at: np.ndarray, changes: np.ndarray, values: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return the turn (2, 2), focus (2,) and lean (2,) of a gradient with a focus; None if the blocks show none. at:
    (b, 2) middles of the blocks, in any unit; the others as of `slopes`, changes in levels per that unit."""
    steep = np.sqrt(np.einsum("bki,bki->b", changes, changes)) / weights
    changing = steep >= STEADY * steep.max()
    if changing.sum() < 6:
        return None
    at, changes, values, weights = (each[changing] for each in (at, changes, values, weights))
    rows = np.zeros((len(at), 4, 6))
    rows[..., :2] = changes
    rows[:, range(4), range(2, 6)] = -weights[:, None]
    right = np.einsum("bki,bi->bk", changes, at) - weights[:, None] * values
    found = np.linalg.lstsq(rows.reshape(-1, 6), right.ravel(), rcond=None)[0]
    focus, off = found[:2], values - found[2:]
    line = off.mean(axis=0)
    if np.abs(focus).max() >= FARTHEST or not line.any():
        return None
    s, (vx, vy) = off @ line / np.linalg.norm(line), (at - focus).T
    rows = np.stack([2.0 * s * vx, 2.0 * s * vy, vx * vx, 2.0 * vx * vy, vy * vy], axis=1) * weights[:, None]
    a, b, xx, xy, yy = np.linalg.lstsq(rows, weights * s * s, rcond=None)[0]
    lengths, axes = np.linalg.eigh(np.array([[xx + a * a, xy + a * b], [xy + a * b, yy + b * b]]))
    if lengths[0] <= lengths[1] / FARTHEST**2:
        return None
    turn = (axes * np.sqrt(lengths)).T
    lean = np.linalg.solve(turn.T, np.array([a, b]))
    size = float(np.hypot(*lean))
    if size < SLIGHT:
        return None
    return turn / math.sqrt(lengths[1]), focus, lean * min(1.0, MOST_LEAN / size)


def _frame(
    turn: np.ndarray, centre: np.ndarray, middle: np.ndarray, reach: float, lean: Sequence[float] | np.ndarray = (0, 0)
) -> np.ndarray:
    """Return the frame (2, 4) around a centre (2,), which is given in units of `reach` px from the middle."""
    return np.column_stack([turn, -turn @ (middle + centre * reach), lean])
