"""Meetings of four regions in an X: the edges of two shapes cross, and both can be seen to go straight on.

Opaque shapes hardly ever do that, as the upper one hides the lower one's edge.
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.layers.ends import Heading, heading
from cubicsplat_cli.artwork.layers.junctions import LEAST_TURN, MEETING, REACHES, SMOOTH
from cubicsplat_cli.artwork.tracing.contours import EdgePositions
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.records import dataclass

RADII = (4.0, 6.0, 8.0)  # px of circles around a meeting, on the first of which all four regions lie
STEPS = 96
MOST_TURN = 3.0  # standard errors by which an edge that goes straight on turns at most
MOST_OFFSET = 1.0  # px
MOST_GAP = 2.5  # px between neighbouring points of an edge


@dataclass(frozen=True)
class Meeting:
    """at: (2,) px, x and y; regions: the four in their order around it."""

    at: np.ndarray
    regions: tuple[int, int, int, int]


def meetings(labels: np.ndarray) -> list[Meeting]:
    """The places where exactly four different regions of a map (H, W) meet."""
    first, *others = labels[:-1, :-1], labels[:-1, 1:], labels[1:, :-1], labels[1:, 1:]
    several = np.any([first != other for other in others], axis=0)
    corners = np.sort([each[several] for each in (first, *others)], axis=0)
    several[several] = (np.diff(corners, axis=0) != 0).sum(axis=0) >= 2
    near, count = ndimage.label(ndimage.binary_dilation(np.pad(several, MEETING), np.ones((MEETING, MEETING), bool)))
    near = near[MEETING:-MEETING, MEETING:-MEETING]
    if count == 0:
        return []
    out = []
    for y, x in ndimage.center_of_mass(several, near, np.arange(1, count + 1)):
        found = _around(labels, np.array([x + 1.0, y + 1.0]))
        if found is not None:
            out.append(found)
    return out


def _around(labels: np.ndarray, at: np.ndarray) -> Meeting | None:
    turn = np.linspace(0.0, 2.0 * math.pi, STEPS, endpoint=False)
    for radius in RADII:
        x, y = np.floor(at[0] + radius * np.cos(turn)).astype(int), np.floor(at[1] + radius * np.sin(turn)).astype(int)
        if x.min() < 0 or y.min() < 0 or x.max() >= labels.shape[1] or y.max() >= labels.shape[0]:
            return None
        seen = labels[y, x]
        runs = seen[seen != np.roll(seen, 1)]
        if len(runs) == 4 and len(set(runs.tolist())) == 4:
            a, b, c, d = (int(v) for v in runs)
            return Meeting(at, (a, b, c, d))
    return None


def goes_on(
    labels: np.ndarray, found: EdgePositions, at: np.ndarray, edges: tuple[tuple[int, int], ...]
) -> bool | None:
    """Whether the edge between one pair of regions goes straight on as that between another pair at a meeting; None
    where one of the two is too short or too rough to tell.
    """
    arms = [_arm(labels, found, at, pair) for pair in edges]
    one, other = arms
    if one is None or other is None:
        return None
    turn = math.pi - math.acos(float(np.clip(one.tangent @ other.tangent, -1.0, 1.0)))
    error = math.hypot(one.error, other.error, LEAST_TURN)
    normal = np.array([-one.tangent[1], one.tangent[0]])
    return turn <= MOST_TURN * error and abs(float((other.at - one.at) @ normal)) <= MOST_OFFSET


def _arm(labels: np.ndarray, found: EdgePositions, at: np.ndarray, pair: tuple[int, int]) -> Heading | None:
    """The direction of the edge between two regions at a meeting."""
    reach = int(REACHES[0]) + 2
    top, left = max(int(at[1]) - reach, 0), max(int(at[0]) - reach, 0)
    view = labels[top : int(at[1]) + reach + 1, left : int(at[0]) + reach + 1]
    first, second = view == pair[0], view == pair[1]
    y, x = np.nonzero((first[:-1] & second[1:]) | (second[:-1] & first[1:]))
    level = np.stack([x + left + 0.5, found.rows[y + top + 1, x + left]], axis=1)
    level_sigma = found.row_sigma[y + top + 1, x + left]
    y, x = np.nonzero((first[:, :-1] & second[:, 1:]) | (second[:, :-1] & first[:, 1:]))
    upright = np.stack([found.columns[y + top, x + left + 1], y + top + 0.5], axis=1)
    upright_sigma = found.column_sigma[y + top, x + left + 1]
    # The two may have other edges near: what counts is the one that begins here, as far as it has no gap.
    near = [int((np.hypot(*(each - at).T) <= RADII[-1]).sum()) for each in (level, upright)]
    points, sigma = (level, level_sigma) if near[0] >= near[1] else (upright, upright_sigma)
    order = np.argsort(np.hypot(*(points - at).T), kind="stable")
    gaps = np.flatnonzero(np.hypot(*np.diff(points[order], axis=0).T) > MOST_GAP)
    order = order[: gaps[0] + 1] if len(gaps) else order
    for length in REACHES:
        ends = heading(points[order], sigma[order], length)
        if ends is not None and ends.misfit <= SMOOTH:
            return ends
    return None
