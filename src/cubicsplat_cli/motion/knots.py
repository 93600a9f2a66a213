"""The choice of knots: of every curve as few as keep its path within an error that costs less than their bytes.

A picture's squared error rises by about g' g for a change g of its pixels, and g = J d for a small change d of a
curve's numbers. Of J' J only the diagonal is used, one value for each number of a curve: `sensitivity` estimates it
with random signs (Hutchinson, 1990), from gradients of the engine. A dynamic program then finds, for a price of a knot,
the knots with the least sum of error and price, each curve and track on its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cubicsplat_cli.motion.tracks import PAINTS, KnotTrack, Tracks, track_gradients
from cubicsplat_cli.raster.engine import Engine
from cubicsplat_cli.raster.settings import RasterSettings

CHUNK = 64  # curves at once, of F x C numbers each
UNSEEN = 1e-3  # of the weight of other frames: what cannot be seen decides only where nothing else does
# What gzip leaves, in bytes, of an animation beside its knots, of a number of a path with its separator, of the time of
# a knot, of a colour and of an opacity.
START_BYTES, NUMBER_BYTES, TIME_BYTES, COLOUR_BYTES, OPACITY_BYTES = 6.0, 1.85, 1.1, 5.0, 1.5
LEAST_PRICE, MOST_PRICE = 1e-9, 1e3  # of a byte, in units of the loss: one pixel that is wrong has at most 3
BISECTIONS = 24


def sensitivity(
    tracks: Tracks, engine: Engine, raster: RasterSettings, generator: np.random.Generator
) -> dict[str, np.ndarray]:
    """Of each track (N, C): by how much the squared error of a frame rises for the square of a change, on average over
    the frames that show the curve.
    """
    lines, curves = tracks.lines(), tracks.by_name["shapes"].knots.shape[1]
    sums = {name: np.zeros(track.values.shape[1:]) for name, track in tracks.by_name.items()}
    count = np.zeros((curves, 1))
    for frame in range(tracks.frames):
        scene, seen = tracks.at(frame, lines)
        count[seen] += 1.0
        signs = 2.0 * generator.integers(0, 2, (scene.height, scene.width, scene.channels)) - 1.0
        _, found = engine.gradients(scene, raster, gradient=signs.astype(np.float32))
        for name, gradient in track_gradients(found).items():
            sums[name][seen] += gradient.astype(np.float64) ** 2
    return {name: total / np.maximum(count, 1.0) for name, total in sums.items()}


def split_offsets(tracks: Tracks, weights: dict[str, np.ndarray]) -> None:
    """Moves what all points of a curve move alike, weighted, from the shapes to the offsets; 0 at the first frame."""
    shapes, offsets = tracks.by_name["shapes"].values, tracks.by_name["offsets"].values
    frames, curves = shapes.shape[:2]
    points = shapes[..., :-1].reshape(frames, curves, -1, 2)
    of_points = weights["shapes"][:, :-1].reshape(curves, -1, 2) + 1e-9
    middles = (points * of_points).sum(axis=2) / of_points.sum(axis=1)
    moved = (middles - middles[:1]).astype(np.float32)
    offsets += moved
    shapes[..., :-1] -= np.tile(moved, (1, 1, points.shape[2]))


@dataclass(eq=False)
class Choice:
    """The knots of a track for any price: its errors are computed once.

    track: with values at every frame. weights: (N, C), of squared errors. there: (F, N) bool, where errors count.
    """

    track: KnotTrack
    weights: np.ndarray
    there: np.ndarray
    times: np.ndarray

    def __post_init__(self) -> None:
        frames, curves = self.track.knots.shape
        self.errors, self.still_errors = np.empty((frames, frames, curves)), np.empty(curves)
        for begin in range(0, curves, CHUNK):
            part = slice(begin, begin + CHUNK)
            scaled = self.track.values[:, part].astype(np.float64) * np.sqrt(self.weights[part])
            there = self.there[:, part].astype(np.float64)
            self.errors[..., part] = _errors(scaled, self.times, there)
            middle = (scaled * there[..., None]).sum(axis=0) / np.maximum(there.sum(axis=0), 1.0)[:, None]
            self.still_errors[part] = (np.square(scaled - middle).sum(axis=2) * there).sum(axis=0)

    def at(self, price: float, start: float) -> tuple[KnotTrack, float]:
        """The track with the knots of the least sum of errors and prices, and the sum of its errors.

        price: of a knot; start: of a curve that is not still; both in units of the loss. Values are those of before.
        """
        knots, cost = _cheapest(self.errors, price)
        still = self.still_errors <= cost + start
        knots[1:-1, still] = False
        error = np.where(still, self.still_errors, cost - price * (knots.sum(axis=0) - 1))
        return KnotTrack(self.track.values, knots, still), float(error.sum())

    def fitted(self, track: KnotTrack) -> KnotTrack:
        """A track of these knots whose path is nearest to the values that they were chosen for, at the frames that
        count; others count a little. Values at frames without a knot are 0.
        """
        lines, wanted, (frames, curves) = track.lines(self.times), self.track.values, track.knots.shape
        each, every = np.indices((frames, curves))
        shares = np.zeros((curves, frames, frames))  # of knots, the last axis, in frames
        shares[every, each, lines.before] = 1.0 - lines.share
        shares[every, each, lines.after] += lines.share
        weighted = (shares * np.where(self.there, 1.0, UNSEEN).T[..., None]).swapaxes(1, 2)
        unused = np.eye(frames) * (shares.sum(axis=1) == 0.0)[:, None]
        found = np.linalg.solve(weighted @ shares + unused, weighted @ wanted.swapaxes(0, 1))
        return KnotTrack(np.ascontiguousarray(found.swapaxes(0, 1), np.float32), track.knots, track.still)


def choose(tracks: Tracks, weights: dict[str, np.ndarray], there: np.ndarray, loss: float, most_bytes: float) -> Tracks:
    """Tracks with fewer knots: those that take away as much of the loss as their bytes would as one more curve, or
    fewer where these take more than `most_bytes` with the curves.

    The loss of N curves is about as 1 / N, so a byte of one is worth `loss` over the bytes of all. loss: of all frames,
    with all knots. weights: `sensitivity`. there: (F, N) bool, the frames at which a curve is seen.
    """
    every = np.ones_like(there)
    choices = {
        name: Choice(track, weights[name], every if name == "opacities" else there, tracks.times)
        for name, track in tracks.by_name.items()
    }
    costs = {name: knot_bytes(name, track.values.shape[2]) for name, track in tracks.by_name.items()}
    standing = there.shape[1] * curve_bytes(tracks)

    def at(price: float) -> dict[str, tuple[KnotTrack, float]]:
        return {name: one.at(price * costs[name], price * START_BYTES) for name, one in choices.items()}

    def size(price: float) -> float:
        found = [(costs[name], track, (~track.still).sum()) for name, (track, _) in at(price).items()]
        return standing + sum(START_BYTES * moving + cost * (track.count - moving) for cost, track, moving in found)

    chosen = _bisected(lambda price: price * size(price) <= loss)[0]
    if size(chosen) > most_bytes:
        chosen = _bisected(lambda price: size(price) > most_bytes)[1]
    fitted = {name: choices[name].fitted(track) for name, (track, _) in at(chosen).items()}
    for name in PAINTS:
        fitted[name].values.clip(0.0, 1.0, out=fitted[name].values)
    opacities = fitted["opacities"]
    opacities.values[~there & ~opacities.still] = 0.0
    return replace(tracks, by_name=fitted)


def _bisected(holds: Callable[[float], bool]) -> tuple[float, float]:
    """Two prices next to each other: of the first something holds, if of any, and of the second no more."""
    low, high = LEAST_PRICE, MOST_PRICE
    if holds(high):
        return high, high
    for _ in range(BISECTIONS):
        price = math.sqrt(low * high)
        low, high = (price, high) if holds(price) else (low, price)
    return low, high


def curve_bytes(tracks: Tracks) -> float:
    """About what a curve that stands still takes in a file after gzip."""
    return 2.0 * NUMBER_BYTES * tracks.scene.points.shape[1] + COLOUR_BYTES + OPACITY_BYTES


def knot_bytes(name: str, numbers: int) -> float:
    """About what a knot of a track takes in a file after gzip, with its time."""
    return TIME_BYTES + {"colours": COLOUR_BYTES, "opacities": OPACITY_BYTES}.get(name, NUMBER_BYTES * numbers)


def _errors(values: np.ndarray, times: np.ndarray, there: np.ndarray) -> np.ndarray:
    """(F, F, N): the sum over the frames between i and j that count, `there` (F, N), of the squared distance of values
    (F, N, C) from the line from those of frame i to those of frame j.
    """
    frames, curves, _ = values.shape
    errors = np.zeros((frames, frames, curves))
    for i in range(frames - 2):
        away, counts = values[i + 1 :] - values[i], there[i + 1 :]  # (G, N, C), (G, N)
        span = (times[i + 1 :] - times[i])[:, None]
        squares = np.cumsum(np.square(away).sum(axis=2) * counts, axis=0)
        along = np.cumsum(away * (span * counts)[..., None], axis=0)
        squared = np.cumsum(span * span * counts, axis=0)
        slope = away / span[..., None]
        to_each = squares - 2.0 * (slope * along).sum(axis=2) + np.square(slope).sum(axis=2) * squared
        # Not through float rounding below 0; at the frame itself the line has no error.
        errors[i, i + 1 :] = np.maximum(to_each, 0.0)
    return errors


def _cheapest(errors: np.ndarray, price: float) -> tuple[np.ndarray, np.ndarray]:
    """(F, N) bool, (N,): the knots of the least sum of errors (F, F, N) and of the price of each, and that sum."""
    frames, _, curves = errors.shape
    cost, before = np.zeros((frames, curves)), np.zeros((frames, curves), np.int64)
    for j in range(1, frames):
        through = cost[:j] + errors[:j, j] + price
        before[j] = through.argmin(axis=0)
        cost[j] = through.min(axis=0)
    knots, at, every = np.zeros((frames, curves), bool), np.full(curves, frames - 1), np.arange(curves)
    knots[[0, -1]] = True
    while at.any():
        at = before[at, every]
        knots[at, every] = True
    return knots, cost[-1]
