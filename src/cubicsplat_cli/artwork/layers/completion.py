"""Outlines of the parts of layers: where upper layers hide them they continue the simplest way that stays hidden.

A hidden run of a contour is tried unconstrained (the rest of a circle, a straight continuation), then as one cubic that
goes on smoothly at both ends, as its chord, and ever nearer to the way along the upper layers' edge. A way is good when
it covers what shows and nothing else does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from skimage.measure import approximate_polygon

from cubicsplat_cli.artwork.geometry.coverage import coverage, edges_of
from cubicsplat_cli.artwork.geometry.hulls import holes_of
from cubicsplat_cli.artwork.geometry.outlines import Outline, flattened, polygon, reversed_ring, signed_area
from cubicsplat_cli.artwork.layers.continuation import continued
from cubicsplat_cli.artwork.layers.extents import Contour, Extent
from cubicsplat_cli.artwork.tracing.fitting import fit_outline

# How a hidden run is guided, in the order of trial: standard errors in px, or a cubic, or its chord.
FREE, SLIGHT, CHORD, ROUND = np.inf, -3.0, -1.0, -2.0
WAYS = (FREE, SLIGHT, CHORD, ROUND, 1.5, 0.7, 0.25)
# The most that such a cubic turns, radians; an edge less likely turns by more than a right angle.
MOST_TURN = {SLIGHT: 0.5 * math.pi, ROUND: 1.25 * math.pi}
CHORD_SIGMA = 0.3
# A contour with more hidden runs than SEVERAL starts with this way: too many would have to be tried.
SEVERAL, CROWDED = 8, 4
FEWEST_SEEN = 4  # points of a contour, below which all of it goes along the upper layers' edge
# Points of a hidden run that stay as they are at either end of a chord: down to the full underlap.
DEEP = 4
# Contours of fewer points than FEWEST are drawn as polygons, TOLERANCE px about their points.
FEWEST, TOLERANCE = 8, 0.3
SQUARE = np.ones((3, 3), dtype=bool)


@dataclass(frozen=True)
class _Window:
    """What an outline of an extent must and must not cover, one px of tolerance taken off."""

    top: int
    left: int
    must: np.ndarray
    may: np.ndarray
    canvas: tuple[int, int]

    @classmethod
    def of(cls, extent: Extent, canvas: tuple[int, int]) -> _Window:
        edge = np.pad(extent.shown, 1, mode="edge")
        must = ndimage.binary_erosion(edge, SQUARE)[1:-1, 1:-1]
        # Where upper layers hide the edge it runs beneath them, not along it.
        beneath = ndimage.binary_dilation(extent.shown) & extent.allowed & ~extent.shown
        must |= beneath & ~ndimage.binary_dilation(~extent.allowed, SQUARE, 2)
        # An outer outline may go around holes, which have outlines of their own.
        may = ndimage.binary_dilation(extent.allowed | holes_of(extent.allowed), SQUARE)
        return cls(extent.top, extent.left, must, may, canvas)

    def wrong(self, outline: Outline, hole: bool) -> np.ndarray:
        """(k, 2) middles x, y of the pixels that an outline covers or leaves wrongly."""
        ring = outline.ring()
        points = flattened(ring, 1.0) - [self.left, self.top]
        ring = ring if signed_area(ring) > 0.0 else reversed_ring(ring)
        inside = coverage(edges_of(ring.cubics, ring.lines), self.top, self.left, *self.must.shape) > 0.5
        bad = (inside & self.must) if hole else (inside & ~self.may) | (~inside & self.must)
        y, x = np.nonzero(bad)
        within = np.stack([x + 0.5, y + 0.5], axis=1)
        corner = np.array([self.left, self.top])
        return np.concatenate([within, points[self._astray(points)]]) + corner

    def _astray(self, points: np.ndarray) -> np.ndarray:
        """(n,) bool: points of an outline beyond the window, though on the canvas."""
        height, width = self.must.shape
        x, y = points.T
        beyond = (x < -1.0) | (y < -1.0) | (x > width + 1.0) | (y > height + 1.0)
        x, y = x + self.left, y + self.top
        return beyond & (x > 0.0) & (y > 0.0) & (x < self.canvas[1]) & (y < self.canvas[0])


def _sound(contour: Contour, outline: Outline) -> bool:
    """Whether an outline encloses what its points do, to a tenth of a px along them."""
    x, y = contour.points.T
    area = 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    length = float(np.hypot(*(contour.points - np.roll(contour.points, 1, axis=0)).T).sum())
    return abs(abs(signed_area(outline.ring())) - abs(area)) <= 0.1 * length + 1.0


def _visible(contour: Contour, detail: float) -> Outline:
    """The outline of a contour that shows all around; where the fit has gone astray, ever closer to its points."""
    for factor in (1.0, 4.0, 16.0):
        outline = fit_outline(contour.points, contour.sigma, detail * factor)
        if _sound(contour, outline):
            return outline
    return _polygon(contour)


def _polygon(contour: Contour) -> Outline:
    """Few straight lines along the points of a contour."""
    points = approximate_polygon(np.vstack([contour.points, contour.points[:1]]), TOLERANCE)[:-1]
    return polygon(points if len(points) >= 3 else contour.points)


def outlines_of(extent: Extent, canvas: tuple[int, int], detail: float, least: int = 0) -> tuple[Outline, ...]:
    """The fitted outlines of a part of a layer, the outer one first.

    canvas: its height and width, px. Contours of fewer than `least` points, and than FEWEST, become polygons.
    """
    window = _Window.of(extent, canvas)
    least = max(least, FEWEST)
    return tuple(
        _polygon(contour) if len(contour.points) < least else _completed(contour, window, detail)
        for contour in extent.contours
    )


def _completed(contour: Contour, window: _Window, detail: float) -> Outline:
    runs = hidden_runs(contour.sigma)
    if not runs:
        return _visible(contour, detail)
    ways = np.full(len(runs), 0 if len(runs) <= SEVERAL else CROWDED)
    if np.isfinite(contour.sigma).sum() < FEWEST_SEEN:
        ways[:] = len(WAYS) - 1
    best, least = None, np.inf
    curves = _Curves(contour, runs, window)
    for _ in range(2 * len(WAYS)):
        for k, way in enumerate(ways.tolist()):
            ways[k] += WAYS[way] in MOST_TURN and curves[k, WAYS[way]] is None
        points, sigma = guided(contour, runs, ways, curves)
        outline = fit_outline(points, sigma, detail)
        wrong = window.wrong(outline, contour.hole)
        if len(wrong) < least:
            best, least = outline, len(wrong)
        if len(wrong) <= 1:
            break
        blamed = _blamed(contour.points, runs, ways, wrong)
        if not len(blamed):
            break
        ways[blamed] += 1
    assert best is not None
    return best


def hidden_runs(sigma: np.ndarray) -> list[np.ndarray]:
    """The indices of every run of hidden points of a closed contour, each in order."""
    hidden = ~np.isfinite(sigma)
    n = len(sigma)
    if hidden.all():
        return [np.arange(n)]
    starts = np.nonzero(hidden & ~np.roll(hidden, 1))[0]
    stops = np.nonzero(hidden & ~np.roll(hidden, -1))[0]
    # The first run to stop may be the last one to start.
    stops = np.roll(stops, -1) if len(stops) and stops[0] < starts[0] else stops
    return [np.arange(a, a + (b - a) % n + 1) % n for a, b in zip(starts, stops, strict=True)]


class _Curves:
    """The cubics that continue hidden runs, sought when they are asked for; None where there is none."""

    def __init__(self, contour: Contour, runs: list[np.ndarray], window: _Window) -> None:
        self.contour, self.runs, self.window = contour, runs, window
        self.found: dict[tuple[int, float], np.ndarray | None] = {}

    def __getitem__(self, key: tuple[int, float]) -> np.ndarray | None:
        if key not in self.found:
            run, contour = self.runs[key[0]], self.contour
            self.found[key] = continued(contour.points, contour.sigma, run, MOST_TURN[key[1]], self._wrong)
        return self.found[key]

    def _wrong(self, points: np.ndarray) -> int:
        return len(self.window.wrong(polygon(points), self.contour.hole))


def guided(
    contour: Contour, runs: list[np.ndarray], ways: np.ndarray, curves: _Curves
) -> tuple[np.ndarray, np.ndarray]:
    """Points and standard errors with every hidden run guided in its way; curves: the points of those that have one."""
    points, sigma = contour.points.copy(), contour.sigma.copy()
    for k, (run, way) in enumerate(zip(runs, ways, strict=True)):
        kind = WAYS[way]
        curve = curves[k, kind] if kind in MOST_TURN else None
        if curve is not None:
            points[run], sigma[run] = curve, CHORD_SIGMA
        elif kind == CHORD:
            if len(run) > 2 * DEEP + 2:
                middle = run[DEEP - 1 : len(run) - DEEP + 1]
                t = np.linspace(0.0, 1.0, len(middle))[:, None]
                points[middle] = points[middle[0]] * (1.0 - t) + points[middle[-1]] * t
            sigma[run] = CHORD_SIGMA
        else:
            sigma[run] = kind
    return points, sigma


def _blamed(points: np.ndarray, runs: list[np.ndarray], ways: np.ndarray, wrong: np.ndarray) -> np.ndarray:
    """The runs nearest to wrong pixels that have another way left; all such runs where those have none."""
    left = ways < len(WAYS) - 1
    if not len(runs) or not left.any():
        return np.empty(0, dtype=int)
    sample = wrong[:: max(1, len(wrong) // 50)]
    gaps = np.stack([np.hypot(*(points[run][None] - sample[:, None]).transpose(2, 0, 1)).min(axis=1) for run in runs])
    named = np.unique(gaps.argmin(axis=0))
    named = named[left[named]]
    return named if len(named) else np.nonzero(left)[0]
