"""Which gradient, linear or radial, the pixels of an area follow: the one with the shortest description."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.artwork.gradients.frames import first_frames
from cubicsplat_cli.artwork.gradients.ramps import PRICE, SIGMA, Ramp, fitted, misfit, ramp_of, scatter
from cubicsplat_cli.artwork.gradients.settling import settled
from cubicsplat_cli.artwork.gradients.shade import Shade

FEW_PIXELS, MOST_PIXELS = 1000, 4000  # looked at to choose and to settle
PEAK = 6.0  # px around a middle, where a ramp that rises to it has a tip that looks like an edge
UNLIKELY = 4.0  # times the least scatter
NEAR_AXIS = 0.05  # tangent of the angle to an axis


def shade_of(x: np.ndarray, y: np.ndarray, values: np.ndarray, hints: Sequence[Shade] = ()) -> Shade:
    """The gradient with the shortest description of pixels: x, y (n,) px, values (n, 4) premultiplied levels.

    hints: gradients that these pixels may have too; a small part of an ellipse says little about its middle.
    """
    # Some pixels, in an order that is the same each time but follows neither rows nor columns.
    order = np.random.default_rng(0).permutation(len(x))
    few = order[:FEW_PIXELS]
    px, py, pv = x[few], y[few], values[few]
    scale = float(len(x)) / len(px)
    best, least = None, np.inf
    frames = first_frames(x, y, values) + [(hint.frame, True, 5) for hint in hints if hint.radial]
    for frame, radial, parameters in _likely(frames, px, py, pv):
        shade = settled(Shade(frame, radial, _ramp(frame, radial, px, py, pv), parameters), px, py, pv)
        cost = scale * misfit(shade.at(px, py) - pv) + shade.price
        if cost < least:
            best, least = shade, cost
    assert best is not None  # a linear one is always tried
    best = _pruned(best, px, py, pv, scale)
    if len(x) > FEW_PIXELS:
        many = order[:MOST_PIXELS]
        px, py, pv = x[many], y[many], values[many]
        best = settled(best, px, py, pv)
    return _reaching(_level(best, px, py, pv, float(len(x)) / len(px)), x, y, values)


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
        trial = settled(min(trials)[2], x, y, values)
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
