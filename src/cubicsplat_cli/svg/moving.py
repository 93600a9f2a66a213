"""The numbers of a clip as a file can hold them: whole numbers, at the knots that are written."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.motion.tracks import OPACITY_DECIMALS, Tracks
from cubicsplat_cli.record import record
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import PRECISION, Mode, width_decimals
from cubicsplat_cli.svg.quantise import MAX_COORDINATE
from cubicsplat_cli.svg.values import levels_of, unit_colour

SHAPE, OFFSET, COLOUR, OPACITY, WIDTH = "shape", "offset", "colour", "opacity", "width"
TIME_DECIMALS = 4  # of seconds
_OF_A_FRAME = 0.03  # by which the time of a knot may be off
_NOISE = 1e-9  # of float arithmetic, in steps


@record
class GridTrack:
    """The values of a group over time: linear between knots.

    keys: (k,) int64, rising from 0, when the knots are, in units of `GridClip.key_s` after the group's begin. values:
    (k, n) int64. One knot: it never changes.
    """

    keys: np.ndarray
    values: np.ndarray

    def times(self, whole: int) -> tuple[np.ndarray, bool]:
        """Return the keys of a path of values, which ends when its round does, at `whole`; and whether they are evenly
        spaced, up to rounding: then the file says no times, and they are exact.
        """
        keys = np.append(self.keys, whole) if self.keys[-1] < whole else self.keys
        even = np.linspace(0, whole, len(keys))
        return (even, True) if (np.rint(even) == keys).all() else (keys, False)

    def at(self, keys: np.ndarray, whole: int) -> np.ndarray:
        """Return the values (F, n) float64 at times (F,), which need not be whole. whole: see `times`."""
        knots = self.times(whole)[0][: len(self.keys)]
        return np.stack([np.interp(keys, knots, values) for values in self.values.T], axis=1)


@record
class GridGroup:
    """Frames between two cuts. begin, end: s after the start of the clip. curves: tracks by name, front to back."""

    begin: float
    end: float
    curves: list[dict[str, GridTrack]]


@record
class GridClip:
    """A clip in whole numbers.

    Control points ("shape", 2 K of them) and offsets (2) are multiples of 10^-precision px, "colour" has 3 of 0..255,
    "opacity" is in hundredths, "width" (of strokes) in multiples of 10^-`width_decimals` px. duration: s. key_decimals:
    of the times of knots, as shares of the duration.
    """

    mode: Mode
    width: int
    height: int
    precision: int
    background: tuple[int, int, int] | None
    duration: float
    key_decimals: int
    groups: list[GridGroup]

    @property
    def whole(self) -> int:
        """The duration in units of `GridTrack.keys`."""
        return 10**self.key_decimals

    @property
    def key_s(self) -> float:
        """Seconds of a unit of `GridTrack.keys`."""
        return self.duration / self.whole

    @property
    def knots(self) -> int:
        """Knots that are written, of all tracks that change."""
        tracks = [track for group in self.groups for curve in group.curves for track in curve.values()]
        return sum(len(track.keys) for track in tracks if len(track.keys) > 1)

    def scenes(self, group: GridGroup, seconds: np.ndarray) -> Iterator[Scene]:
        """Yield the scenes that the file shows at times (F,) within a group, s from the start of the clip."""
        keys = (np.asarray(seconds, np.float64) - group.begin) / self.key_s

        def all_of(name: str) -> np.ndarray:
            return np.stack([curve[name].at(keys, self.whole) for curve in group.curves], axis=1)

        points = all_of(SHAPE)
        points = points.reshape(*points.shape[:2], -1, 2) + all_of(OFFSET)[:, :, None]
        points = (points / 10.0**self.precision).astype(np.float32)
        colours, opacities = (all_of(COLOUR) / 255.0).astype(np.float32), all_of(OPACITY)[..., 0]
        opacities = (opacities / 10.0**OPACITY_DECIMALS).astype(np.float32)
        half_widths = (all_of(WIDTH)[..., 0] / 10.0 ** width_decimals(self.precision) / 2.0).astype(np.float32)
        for frame in range(len(keys)):
            yield Scene(
                self.mode, self.width, self.height, points[frame], colours[frame], opacities[frame],
                half_widths[frame], unit_colour(self.background),
            )  # fmt: skip


def shown_at(group: Tracks) -> np.ndarray:
    """Return the times (F,), s, at which a file shows each frame of a group exactly, while that frame is displayed.

    The last knot of a path must be at the end of its group, or it is written twice. Times are stretched for that: the
    first frame is exact when it begins, the last one when it ends. They stay if a frame would be exact too late.
    """
    times = group.times
    if len(times) == 1:
        return times.copy()
    stretched = times[0] + (times - times[0]) * (group.end - times[0]) / (times[-1] - times[0])
    ends = np.append(times[1:], group.end)
    return stretched if (stretched <= ends + 1e-9).all() else times.copy()


def to_grid_clip(clip: Sequence[Tracks], precision: int, off: float = 0.5) -> GridClip:
    """Round the groups of a clip to the numbers of a file with `precision` decimals.

    Knots at most `off` steps from the line between others are left out; rounding alone moves them by half a step.
    Raises InputError for a value that is out of range, UsageError for a precision outside 0..6.
    """
    PRECISION.check("precision", precision)
    start, first = float(clip[0].times[0]), clip[0].scene
    duration = round(clip[-1].end - start, TIME_DECIMALS)
    shortest = min(float(np.diff(np.append(group.times, group.end)).min()) for group in clip)
    decimals = max(1, math.ceil(math.log10(0.5 * duration / (_OF_A_FRAME * shortest))))
    background = levels_of(first.background)
    key_s = duration / 10**decimals
    groups = [
        GridGroup(
            round(float(group.times[0]) - start, TIME_DECIMALS), round(group.end - start, TIME_DECIMALS),
            _curves(group, precision, key_s, off),
        )
        for group in clip
    ]  # fmt: skip
    return GridClip(first.mode, first.width, first.height, precision, background, duration, decimals, groups)


def _curves(group: Tracks, precision: int, key_s: float, off: float) -> list[dict[str, GridTrack]]:
    seconds = shown_at(group)
    keys = np.rint((seconds - seconds[0]) / key_s).astype(np.int64)
    values = {name: track.values.astype(np.float64) for name, track in group.by_name.items()}
    points, offsets, half_widths = values["shapes"][..., :-1], values["offsets"], values["shapes"][..., -1:]
    if not np.abs(points).max() + np.abs(offsets).max() <= MAX_COORDINATE:  # false for NaN too
        raise InputError(f"control points lie more than {MAX_COORDINATE:.0f} px from the origin")
    # The offset at the start becomes part of the shape.
    points = points + np.tile(offsets[:1], points.shape[2] // 2)
    unit = 10.0**precision
    grids = {
        SHAPE: (points * unit, "shapes"),
        OFFSET: ((offsets - offsets[:1]) * unit, "offsets"),
        COLOUR: (values["colours"] * 255.0, "colours"),
        OPACITY: (values["opacities"] * 10.0**OPACITY_DECIMALS, "opacities"),
        WIDTH: (2.0 * half_widths * 10.0 ** width_decimals(precision), "shapes"),
    }

    def track(name: str, curve: int) -> GridTrack:
        grid, of = grids[name]
        chosen = group.by_name[of].knots[:, curve] & ~group.by_name[of].still[curve]
        chosen[0] = True
        return _needed(keys[chosen], np.rint(grid[chosen, curve]).astype(np.int64), off)

    return [{name: track(name, curve) for name in grids} for curve in range(points.shape[1])]


def _needed(keys: np.ndarray, values: np.ndarray, most: float) -> GridTrack:
    """Return the track without knots at most so many steps off the lines between others (Douglas and Peucker, 1973)."""
    if np.abs(values - values[0]).max() <= most - 0.5:
        return GridTrack(keys[:1] * 0, values[:1])
    # Two frames may have one key where they are a hundredth of a frame apart.
    distinct = np.append(np.diff(keys) > 0, True)
    keys, values = keys[distinct], values[distinct]
    kept, ahead = [0], [(0, len(keys) - 1)]
    while ahead:
        first, last = ahead.pop()
        inner = slice(first + 1, last)
        share = (keys[inner] - keys[first]) / max(int(keys[last] - keys[first]), 1)
        off = np.abs(values[first] + share[:, None] * (values[last] - values[first]) - values[inner]).max(axis=1)
        if len(off) and off.max() > most + _NOISE:
            middle = first + 1 + int(off.argmax())
            ahead += [(middle, last), (first, middle)]
        else:
            kept.append(last)
    return GridTrack(keys[kept], values[kept])
