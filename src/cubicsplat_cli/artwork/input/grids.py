"""Find the grid of a picture that was enlarged without smoothing, by any factor: the borders of its pixels."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.channels import ROWS
from cubicsplat_cli.record import record

# Cells of a noisy picture have so many px a side, hence a middle without the artefacts of their borders; and there are
# so many of them each way.
LEAST_NOISY, LEAST_LINES = 3.5, 8
_FINER = 16  # times as many frequencies as px, so that a period is exact to a fraction of a px across the picture


@record
class Grid:
    """x: (C + 1,) and y: (R + 1,) int, px, the borders of columns and rows. side: the shorter mean side of cells."""

    x: np.ndarray
    y: np.ndarray
    side: float

    def enlarged(self, cells: np.ndarray) -> np.ndarray:
        """Return the picture (H, W, ...) of cells (R, C, ...)."""
        return cells.repeat(np.diff(self.y), axis=0).repeat(np.diff(self.x), axis=1)

    def sampled(self, picture: np.ndarray) -> np.ndarray:
        """Return (R, C, ...) the first pixel of every cell of a picture; the same array if cells are pixels."""
        return picture if self.side == 1.0 else picture[self.y[:-1]][:, self.x[:-1]]


def exact_grid(target: np.ndarray) -> Grid:
    """Return the coarsest grid whose cells have one colour each; single pixels if there is none coarser.

    Grids of no whole number of px need 14 nats of evidence: the log of the odds that all borders fall on such a grid by
    chance, of which some thousands are tried.
    """
    height, width = target.shape[:2]
    columns, rows = _changes(target)
    steps = np.concatenate([np.diff(columns), np.diff(rows)])
    # If no side has two changes, the canvas's border counts as one.
    side = int(np.gcd.reduce(steps)) if len(steps) else math.gcd(*columns.tolist(), *rows.tolist(), width, height)
    if side > 1:
        return Grid(_ends(columns, side, width), _ends(rows, side, height), float(side))
    x, across, by_columns = _fractional(columns, width)
    y, down, by_rows = _fractional(rows, height)
    if by_columns + by_rows < 14.0 or not (by_columns and by_rows):
        return Grid(np.arange(width + 1), np.arange(height + 1), 1.0)
    return Grid(x, y, min(across, down))


def _changes(target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns (n,) and rows (m,) that differ from the one before; or all of them as soon as both have three
    in a row, which no enlarged picture has.
    """
    height, width = target.shape[:2]
    columns, rows = np.zeros(width - 1, dtype=bool), np.zeros(height - 1, dtype=bool)
    for top in range(0, height, ROWS):
        part = target[top : top + ROWS]
        columns |= (part[:, 1:] != part[:, :-1]).any(axis=(0, 2))
        down = target[max(0, top - 1) : top + ROWS]
        rows[max(0, top - 1) : max(0, top - 1) + len(down) - 1] = (down[1:] != down[:-1]).any(axis=(1, 2))
        if all((line[:-2] & line[1:-1] & line[2:]).any() for line in (columns, rows)):
            return np.arange(1, width), np.arange(1, height)
    return np.flatnonzero(columns) + 1, np.flatnonzero(rows) + 1


def _ends(changes: np.ndarray, side: int, length: int) -> np.ndarray:
    first = int(changes[0]) % side if len(changes) else 0
    return np.concatenate([[0], np.arange(first or side, length, side), [length]])


def _fractional(changes: np.ndarray, length: int) -> tuple[np.ndarray, float, float]:
    """Return the ends (C + 1,) of cells of no whole number of px with all changes (n,) at their borders, their side,
    and the evidence for that in nats, 0 if there are no such cells.

    Borders at phase + n side are rounded to whole px, halves either way, so modulo the side all changes are within a
    px. Sides are tried in steps of a tenth of a px over the whole picture, down to 1.5 px: smaller ones are pixels.
    """
    single = np.arange(length + 1), 1.0, 0.0
    if len(changes) < 2:
        return single
    steps = np.diff(changes)
    least = int(steps.min())
    if least == 1 and (steps[:-1] + steps[1:]).min(initial=3) == 2:  # three in a row
        return single
    rounding = 1.1 if least > 1 else 1.0 - 1e-9  # px
    sides = np.arange(least + 1.0, max(1.5, least - 1.0), -0.1 * least / length)
    # A few of the changes refuse most sides.
    sides = sides[_widest_gap(changes[:32], sides)[0] <= rounding]
    for part in np.array_split(sides, max(1, len(sides) * len(changes) // 2**20)):
        spreads, phases = _widest_gap(changes, part)
        good = np.flatnonzero(spreads <= rounding)
        if len(good):
            side, phase = float(part[good[0]]), float(phases[good[0]])
            by_chance = float(((np.arange(1, length) - phase) % side <= rounding).mean())
            return _borders(changes, side, phase, length), side, -len(changes) * math.log(by_chance)
    return single


def _widest_gap(changes: np.ndarray, sides: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (m,) the spread of changes (n,) modulo each of the sides (m,), px, and (m,) the first change there."""
    rest = np.sort(changes[None] % sides[:, None], axis=1)
    gaps = np.diff(rest, axis=1, append=rest[:, :1] + sides[:, None])
    widest = gaps.argmax(axis=1)
    rows = np.arange(len(sides))
    return sides - gaps[rows, widest], rest[rows, (widest + 1) % len(changes)]


def _borders(changes: np.ndarray, side: float, phase: float, length: int) -> np.ndarray:
    """Return (C + 1,) the borders of cells: changes (n,), or the expected places if there is none."""
    ends = np.rint(phase + side * np.arange(-1, math.ceil(length / side) + 2)).astype(int)
    ends[np.floor((changes - phase) / side + 1e-6).astype(int) + 1] = changes
    return np.unique(np.concatenate([[0], ends[(ends > 0) & (ends < length)], [length]]))


def noisy_grid(levels: np.ndarray) -> Grid | None:
    """Return the grid of a picture (H, W, C) in levels that has noise or a JPEG's artefacts: the longest periods,
    across and down, with most of the change between neighbours; None if there are none, or they differ by over a tenth.
    """
    height, width = levels.shape[:2]
    if min(height, width) < 2:
        return None
    periods = []
    for axis in (1, 0):
        lines = levels[:: 1 + height // 1024] if axis == 1 else levels[:, :: 1 + width // 1024]
        change = np.abs(np.diff(lines, axis=axis)).mean(axis=(1 - axis, 2))
        period = _period(np.maximum(change - np.median(change), 0.0))
        if period is None:
            return None
        periods.append(period)
    (x, across), (y, down) = periods
    return Grid(x, y, min(across, down)) if max(across, down) <= 1.1 * min(across, down) else None


def _period(change: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Return the ends (C + 1,) of cells whose borders have 0.6 of the change (L - 1,) between pixels or more, spread
    over four of them, since some period fits any two; and their side, px. None if there are none.
    """
    length = len(change) + 1
    total = float(change.sum())
    longest = length / LEAST_LINES
    if total <= 0.0 or longest <= LEAST_NOISY:
        return None
    spectrum = np.fft.rfft(change, _FINER * length)
    first, last = math.ceil(_FINER * length / longest), int(_FINER * length / LEAST_NOISY)
    power = np.abs(spectrum[: last + 2])
    peaks = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])) + 1
    peaks = peaks[peaks >= first]
    best: tuple[float, np.ndarray, float] | None = None
    for peak in peaks[np.argsort(-power[peaks], kind="stable")[:12]]:
        side = _FINER * length / float(peak)
        phase = (-np.angle(spectrum[peak]) * side / (2.0 * math.pi)) % side
        ends = np.rint(phase + side * np.arange(math.ceil(length / side) + 1)).astype(int) + 1
        # At the sides, a quarter of a cell or more may be left of one that was cut.
        ends = ends[(ends > 0.25 * side) & (ends < length - 0.25 * side)]
        own = change[ends - 1]
        share, lines = float(own.sum()) / total, float(own.sum() ** 2 / max((own**2).sum(), 1e-12))
        # If several periods explain about as much, one is a multiple of the others: the longest.
        if share >= 0.6 and lines >= 4.0 and (best is None or share * math.sqrt(side) > best[0]):
            best = share * math.sqrt(side), np.concatenate([[0], ends, [length]]), side
    return None if best is None else best[1:]
