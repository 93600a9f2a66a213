"""The ends of centre lines: how far they reach, and their caps."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.geometry.stroke import BUTT, ROUND
from cubicsplat_cli.artwork.strokes.centre_line import end_of
from cubicsplat_cli.artwork.strokes.skeleton import Sides
from cubicsplat_cli.record import record

# A round end is shorter by 0.143 widths at 0.35 widths to the side.
BESIDE, ROUND_DROP = 0.35, 0.07
SLIT = 1.6  # steps of the outline: half of how wide a look ahead is
AHEAD = 0.6  # cosine
COARSE = 0.02  # widths between points that tell where a stroke is on both sides of
RUN = 10  # points that tell the direction of an end
ROUND_MEAN = (0.5 + 2.0 * (0.25 - BESIDE**2) ** 0.5) / 3.0  # widths: the three reaches of a half disc


def with_ends(
    line: np.ndarray, gaps: np.ndarray, width: float, sides: Sides, hidden: list[float]
) -> tuple[np.ndarray, np.ndarray, str]:
    """The points with both ends of the stroke, the gaps between them, and the cap.

    hidden: the widths of the strokes in which an end lies, where no cap shows; 0 for free ends.
    """
    tips = [_Tip.of(line[::-1]), _Tip.of(line)]
    reaches = [None if inside else _reaches(tip, width, sides) for tip, inside in zip(tips, hidden, strict=True)]
    drops = [r[0] - 0.5 * (r[1] + r[2]) for r in reaches if r is not None]
    cap = ROUND if drops and float(np.mean(drops)) > ROUND_DROP * width else BUTT
    places = []
    for tip, inside in zip(tips, hidden, strict=True):
        if inside:
            places.append(tip.on(_to_middle(tip, width, inside, sides)).place)
            continue
        for _ in range(2):
            tip = tip.on(float(_reaches(tip, width, sides).mean()) - (ROUND_MEAN * width if cap == ROUND else 0.0))
        places.append(tip.place)
    line = np.concatenate([places[0][None], line, places[1][None]])
    return line, np.concatenate([[False], gaps[:-1], [False, False]]), cap


@record
class _Tip:
    """An end of a line: its place, unit tangent and bend, (2,) each."""

    place: np.ndarray
    direction: np.ndarray
    bend: np.ndarray

    @classmethod
    def of(cls, line: np.ndarray) -> _Tip:
        """The last of some points."""
        return cls(line[-1], *end_of(line[-RUN:]))

    def on(self, reach: float) -> _Tip:
        """The end if the line went on by so many px, bending as it does."""
        direction = self.direction + reach * self.bend
        direction = direction / max(float(np.hypot(*direction)), 1e-9)
        return _Tip(self.place + reach * self.direction + 0.5 * reach**2 * self.bend, direction, self.bend)


def _reaches(tip: _Tip, width: float, sides: Sides) -> np.ndarray:
    """(3,) how far ahead the outline lies in the middle, and beside it to the left and to the right."""
    off = sides.points - tip.place
    along, across = off @ tip.direction, off @ np.array([-tip.direction[1], tip.direction[0]])
    found = []
    for side in (0.0, -BESIDE * width, BESIDE * width):
        near = (np.abs(across - side) < SLIT * sides.step) & (along > -0.2 * width) & (along < 2.0 * width)
        found.append(float(along[near].min()) if near.any() else 0.0)
    return np.array(found)


def _to_middle(tip: _Tip, width: float, beside: float, sides: Sides) -> float:
    """The distance ahead to the middle of the stroke, `beside` px wide, that this one ends in: half of that from its
    far side."""
    off = sides.points - tip.place
    off = off[np.hypot(*off.T) < 2.0 * (width + beside)][:: max(1, int(COARSE * beside / sides.step))]
    for reach in np.arange(0.0, width + beside, max(0.02 * width, 0.1)):
        rest = off - reach * tip.direction
        distance = np.hypot(*rest.T)
        ahead = rest @ tip.direction > AHEAD * distance
        if ahead.any() and distance[ahead].min() <= 0.5 * beside:
            return float(reach)
    return 0.0
