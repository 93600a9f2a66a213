"""Grids of cells: where a picture that was enlarged without smoothing, by any factor, has the borders of its pixels."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.channels import ROWS
from cubicsplat_cli.record import record

# Enlargements by less than this are not told from none. Those by no whole number need so many nats of evidence: the
# logarithm of the odds that all borders fall on such a grid by chance, of which some thousands are tried.
LEAST_SCALE, LEAST_EVIDENCE = 1.5, 14.0
# Borders of cells of two px and more are rounded to whole px, in halves either way; the sides tried are so near one
# another, over the whole picture.
ROUNDING, FINE = 1.1, 0.1  # px
# Of a noisy picture: cells have so many px and more, which leave a middle without their borders' artefacts; of the
# changes between columns, and between rows, so much must be at the borders of cells.
LEAST_NOISY, LEAST_AT_BORDERS = 3.5, 0.6
MOST_OBLONG = 1.1  # such cells are
LEAST_LINES = 8  # cells each way of a noisy picture
LEAST_BORDERS = 4.0  # that the change is spread over: some period fits any two
LEAST_CUT = 0.25  # of a cell, that is left of one at the side of a noisy picture
_TRIES = 12  # of the strongest periods
_FINER = 16  # times as many frequencies as px, so that a period is known to a fraction of a px across the picture
_SAMPLE, _FEW = 1024, 32


@record
class Grid:
    """x: (C + 1,) and y: (R + 1,) int, px, where columns and rows of cells begin and end. side: of a cell, px, the
    shorter one on average.
    """

    x: np.ndarray
    y: np.ndarray
    side: float

    def enlarged(self, cells: np.ndarray) -> np.ndarray:
        """(H, W, ...) the picture whose cells (R, C, ...) are."""
        return cells.repeat(np.diff(self.y), axis=0).repeat(np.diff(self.x), axis=1)


def exact_grid(target: np.ndarray) -> Grid:
    """The coarsest grid whose cells each have one colour; single pixels where there is none coarser."""
    height, width = target.shape[:2]
    columns, rows = _changes(target)
    steps = np.concatenate([np.diff(columns), np.diff(rows)])
    # Without two changes along a side the canvas's border is as good as one.
    side = int(np.gcd.reduce(steps)) if len(steps) else math.gcd(*columns.tolist(), *rows.tolist(), width, height)
    if side > 1:
        return Grid(_ends(columns, side, width), _ends(rows, side, height), float(side))
    found = [_fractional(changes, length) for changes, length in ((columns, width), (rows, height))]
    if sum(evidence for _, _, evidence in found) < LEAST_EVIDENCE or not all(evidence for _, _, evidence in found):
        return Grid(np.arange(width + 1), np.arange(height + 1), 1.0)
    (x, across, _), (y, down, _) = found
    return Grid(x, y, min(across, down))


def _changes(target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The columns (n,) and rows (m,) that differ from the one before; all of them as soon as both have three in a row,
    which those of no enlargement have.
    """
    height, width = target.shape[:2]
    columns, rows = np.zeros(width - 1, dtype=bool), np.zeros(height - 1, dtype=bool)
    for top in range(0, height, ROWS):
        part = target[top : top + ROWS]
        columns |= (part[:, 1:] != part[:, :-1]).any(axis=(0, 2))
        down = target[max(0, top - 1) : top + ROWS]
        rows[max(0, top - 1) : max(0, top - 1) + len(down) - 1] = (down[1:] != down[:-1]).any(axis=(1, 2))
        if all((each[:-2] & each[1:-1] & each[2:]).any() for each in (columns, rows)):
            return np.arange(1, width), np.arange(1, height)
    return np.flatnonzero(columns) + 1, np.flatnonzero(rows) + 1


def _ends(changes: np.ndarray, side: int, length: int) -> np.ndarray:
    first = int(changes[0]) % side if len(changes) else 0
    return np.concatenate([[0], np.arange(first or side, length, side), [length]])


def _fractional(changes: np.ndarray, length: int) -> tuple[np.ndarray, float, float]:
    """The ends (C + 1,) of cells of no whole number of px that have all changes (n,) at their borders, their side, and
    the evidence for that in nats, 0 where there are no such cells.

    Borders at phase + n side are rounded to whole px, so that modulo the side all changes are within a px.
    """
    single = np.arange(length + 1), 1.0, 0.0
    if len(changes) < 2:
        return single
    steps = np.diff(changes)
    least = int(steps.min())
    if least == 1 and (steps[:-1] + steps[1:]).min(initial=3) == 2:  # three in a row
        return single
    rounding = ROUNDING if least > 1 else 1.0 - 1e-9
    sides = np.arange(least + 1.0, max(LEAST_SCALE, least - 1.0), -FINE * least / length)
    # Most sides are refused by a few of the changes.
    sides = sides[_widest_gap(changes[:_FEW], sides)[0] <= rounding]
    for part in np.array_split(sides, max(1, len(sides) * len(changes) // 2**20)):
        within, phases = _widest_gap(changes, part)
        good = np.flatnonzero(within <= rounding)
        if len(good):
            side, phase = float(part[good[0]]), float(phases[good[0]])
            by_chance = float(((np.arange(1, length) - phase) % side <= rounding).mean())
            return _borders(changes, side, phase, length), side, -len(changes) * math.log(by_chance)
    return single


def _widest_gap(changes: np.ndarray, sides: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Spreads of the changes (n,) modulo each of the sides (m,), px, and the first of them there."""
    rest = np.sort(changes[None] % sides[:, None], axis=1)
    gaps = np.diff(rest, axis=1, append=rest[:, :1] + sides[:, None])
    widest = gaps.argmax(axis=1)
    rows = np.arange(len(sides))
    return sides - gaps[rows, widest], rest[rows, (widest + 1) % len(changes)]


def _borders(changes: np.ndarray, side: float, phase: float, length: int) -> np.ndarray:
    """(C + 1,) the borders of cells, at the changes (n,) where there are such, else where they are expected."""
    ends = np.rint(phase + side * np.arange(-1, math.ceil(length / side) + 2)).astype(int)
    ends[np.floor((changes - phase) / side + 1e-6).astype(int) + 1] = changes
    return np.unique(np.concatenate([[0], ends[(ends > 0) & (ends < length)], [length]]))


def noisy_grid(levels: np.ndarray) -> Grid | None:
    """The grid of a picture (H, W, C) in levels that has noise or a JPEG's artefacts: the longest period, across and
    down, at which most of the change between neighbours is; None where it is nowhere.
    """
    height, width = levels.shape[:2]
    if min(height, width) < 2:
        return None
    found = []
    for axis in (1, 0):
        lines = levels[:: 1 + height // _SAMPLE] if axis == 1 else levels[:, :: 1 + width // _SAMPLE]
        change = np.abs(np.diff(lines, axis=axis)).mean(axis=(1 - axis, 2))
        best = _period(np.maximum(change - np.median(change), 0.0))
        if best is None:
            return None
        found.append(best)
    (x, across), (y, down) = found
    return Grid(x, y, min(across, down)) if max(across, down) <= MOST_OBLONG * min(across, down) else None


def _period(change: np.ndarray) -> tuple[np.ndarray, float] | None:
    """The ends (C + 1,) of cells whose borders have most of the change (L - 1,) between pixels, and their side, px."""
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
    for peak in peaks[np.argsort(-power[peaks], kind="stable")[:_TRIES]]:
        side = _FINER * length / float(peak)
        phase = (-np.angle(spectrum[peak]) * side / (2.0 * math.pi)) % side
        ends = np.rint(phase + side * np.arange(math.ceil(length / side) + 1)).astype(int) + 1
        # What is left at the sides is of a cell that was cut, or of none.
        ends = ends[(ends > LEAST_CUT * side) & (ends < length - LEAST_CUT * side)]
        own = change[ends - 1]
        share, lines = float(own.sum()) / total, float(own.sum() ** 2 / max((own**2).sum(), 1e-12))
        # Of periods that explain about as much, a whole multiple of another, the longest.
        if share >= LEAST_AT_BORDERS and lines >= LEAST_BORDERS and (best is None or share * math.sqrt(side) > best[0]):
            best = share * math.sqrt(side), np.concatenate([[0], ends, [length]]), side
    return None if best is None else best[1:]
