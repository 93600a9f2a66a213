"""The gradient, linear or radial, that the pixels of an area follow: the one with the shortest description."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.artwork.gradients.frames import first_frames
from cubicsplat_cli.artwork.gradients.shade import CLOSE, PRICE, SHARE, SIGMA, STOP_PARAMETERS, Ramp, Shade
from cubicsplat_cli.raster.shades import Pixels, best_stops, fitted, scatter

FEW_PIXELS, MOST_PIXELS = 1000, 4000  # looked at to choose and to settle
MOST_STOPS = 8
PEAK = 6.0  # px around a middle, where a ramp that rises to it has a tip that looks like an edge
UNLIKELY = 4.0  # times as far off those of the same t as along the best geometry: as rough are those to begin with
SCATTERED = (2.0 * CLOSE) ** 2  # levels^2, the mean of pixels that are twice as far off as what a gradient explains
NEAR_AXIS = 0.05  # tangent of the angle to an axis


def shade_of(pixels: Pixels, hints: Sequence[Shade] = ()) -> Shade:
    """The gradient with the shortest description of pixels.

    hints: gradients that these pixels may have too; a small part of an ellipse says little about its middle.
    """
    shade = common_shade(pixels, hints, np.inf)
    assert shade is not None
    return shade


def common_shade(pixels: Pixels, hints: Sequence[Shade], most: float = SCATTERED) -> Shade | None:
    """The same; None where along no likely geometry pixels are off those of the same t by less than `most` levels^2 in
    the mean, so that no gradient comes near them all."""
    # Some pixels, in an order that is the same each time but follows neither rows nor columns.
    count = len(pixels.x)
    order = np.random.default_rng(0).choice(count, min(count, MOST_PIXELS), replace=False)
    few = pixels.some(order[:FEW_PIXELS])
    frames = first_frames(pixels) + [(hint.frame, True, 5) for hint in hints if hint.radial]
    spread = np.array([scatter(frame, radial, few) for frame, radial, _ in frames])
    if spread.min() > most:
        return None
    best, least = None, np.inf
    for k in np.flatnonzero(spread <= UNLIKELY**2 * spread.min() + SIGMA**2):
        shade = _settled(_stopped(*frames[k], few), few)
        cost = _cost(shade, few, count)
        if cost < least:
            best, least = shade, cost
    assert best is not None  # a linear one is always tried
    best = _pruned(best, few, count)
    if count > FEW_PIXELS:
        few = pixels.some(order)
        best = _settled(best, few)
    return _reaching(_level(best, few, count), pixels)


def _stopped(frame: np.ndarray, radial: bool, parameters: int, pixels: Pixels) -> Shade:
    """The shade along a frame with as many stops as the pixels support."""
    ramp = Ramp(*best_stops(frame, radial, pixels, MOST_STOPS, PRICE * STOP_PARAMETERS * 2.0 * SIGMA**2 / SHARE))
    return Shade(frame, radial, ramp.trimmed(), parameters)


def _settled(shade: Shade, pixels: Pixels) -> Shade:
    """The shade with its geometry and its stops at their best."""
    frame, knots, colours = fitted(shade.frame, shade.parameters, shade.ramp.knots, shade.ramp.colours, pixels)
    return Shade(frame, shade.radial, Ramp(knots, colours).trimmed(), shade.parameters)


def _cost(shade: Shade, some: Pixels, count: int) -> float:
    """Nats, of `count` pixels, of which some are looked at, and of the shade."""
    return count / len(some.x) * shade.misfit(some) + shade.price


def _pruned(shade: Shade, pixels: Pixels, count: int) -> Shade:
    """The shade with neighbouring stops made one as long as that is cheaper."""
    cost = _cost(shade, pixels, count)
    while len(shade.ramp.knots) > 2:
        knots = shade.ramp.knots
        trials = []
        for i in range(len(knots) - 1):
            one = knots[i] if i == 0 else knots[i + 1] if i == len(knots) - 2 else 0.5 * (knots[i] + knots[i + 1])
            trials.append(shade.stopped(np.concatenate([knots[:i], [one], knots[i + 2 :]]), pixels))
        trial = _settled(min(trials, key=lambda own: own.misfit(pixels)), pixels)
        following = _cost(trial, pixels, count)
        if following >= cost:
            break
        shade, cost = trial, following
    return shade


def _level(shade: Shade, pixels: Pixels, count: int) -> Shade:
    """A linear shade exactly along an axis, where the pixels do not mind."""
    slope = shade.frame[0, :2]
    axis = int(np.abs(slope).argmax())
    if shade.radial or abs(slope[1 - axis]) > NEAR_AXIS * abs(slope[axis]):
        return shade
    frame = np.zeros((2, 3))
    frame[0, axis] = slope[axis]
    frame[0, 2] = shade.frame[0, 2] + slope[1 - axis] * float((pixels.x if axis else pixels.y).mean())
    level = Shade(frame, False, shade.ramp, 1).stopped(shade.ramp.knots, pixels)
    loss = count / len(pixels.x) * (level.misfit(pixels) - shade.misfit(pixels))
    return level if loss < PRICE else shade


def _reaching(shade: Shade, pixels: Pixels) -> Shade:
    """The shade with stops that end its ramp where the pixels looked at did brought on to where all pixels end, and a
    pixel farther, where edges blend."""
    t, (knots, colours) = shade.t(pixels.x, pixels.y), (shade.ramp.knots.copy(), shade.ramp.colours.copy())
    margin = float(np.hypot(*shade.frame[0, :2]))
    goes_on = [False, False]
    for end, beside in ((0, 1), (-1, -2)):
        beyond = t < knots[0] if end == 0 else t > knots[-1]
        slope = (colours[end] - colours[beside]) / (knots[end] - knots[beside])
        off = colours[end] - pixels.values[beyond]
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
