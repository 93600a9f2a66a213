"""Candidates for details: polygons of one ink where pixels hold an ink that the drawing does not have there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from cubicsplat_cli.artwork.details.shares import ink_shares
from cubicsplat_cli.artwork.details.subpixels import SIDE, arranged, blocks
from cubicsplat_cli.artwork.geometry.coverage import Edges, coverage, edges_of
from cubicsplat_cli.artwork.geometry.outlines import Ring, polygon
from cubicsplat_cli.artwork.regions.cracks import trace
from cubicsplat_cli.artwork.shapes import Shape
from cubicsplat_cli.artwork.tracing.fitting import few_lines

MARGIN = 3  # px around what is not explained, whose inks are looked at
PURE = 6.0  # levels within which a pixel shows an ink
REACH = 2  # px in which an ink that shows pure is near
MOST_INKS = 32  # that are all looked at everywhere
LEAST = 12  # subpixels of a candidate and of its holes
TOLERANCES = (0.6, 1.0)  # subpixels that a polygon's lines may be off the cracks between them


@dataclass(frozen=True)
class Candidate:
    """A detail to try. ink: its index; area: in subpixels; ways: the outer ring and the holes of each polygon that may
    stand for it, the closest first, in px."""

    ink: int
    area: int
    ways: list[tuple[Ring, ...]]


@dataclass(frozen=True)
class Painted:
    """A shape as it is painted, in subpixels. ink: its index; edges; low, high: (2,) x and y of its box."""

    ink: int
    edges: Edges
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, shape: Shape, ink: int) -> Painted:
        rings = shape.oriented()
        cubics = SIDE * np.concatenate([ring.cubics for ring in rings])
        points = cubics.reshape(-1, 2)
        edges = edges_of(cubics, np.concatenate([ring.lines for ring in rings]))
        return cls(ink, edges, np.floor(points.min(axis=0)).astype(int), np.ceil(points.max(axis=0)).astype(int))


def candidates(
    levels: np.ndarray, palette: np.ndarray, painted: list[Painted], unexplained: np.ndarray, ground: int
) -> Iterator[Candidate]:
    """What the unexplained pixels (H, W) bool of a picture (H, W, 4) hold besides what is painted, back to front.

    palette: (P, 4) premultiplied inks in levels; ground: the index of that which shows where nothing is painted.
    """
    clusters, _ = ndimage.label(ndimage.binary_dilation(unexplained, np.ones((3, 3), dtype=bool), MARGIN))
    boxes = (
        np.array([shape.low for shape in painted]).reshape(-1, 2),
        np.array([shape.high for shape in painted]).reshape(-1, 2),
    )
    for number, (rows, columns) in enumerate(ndimage.find_objects(clusters)):
        open_pixels = unexplained[rows, columns] & (clusters[rows, columns] == number + 1)
        drawn = _drawn(painted, boxes, rows, columns, ground)
        window = levels[rows, columns].astype(float)
        pure = np.abs(window[:, :, None] - palette).max(axis=3) <= PURE
        some = _inks_here(pure, drawn, window[open_pixels], palette)
        near = ndimage.maximum_filter(pure[..., some], (2 * REACH + 1, 2 * REACH + 1, 1))
        own = np.searchsorted(some, drawn)
        shares = (blocks(own)[..., None] == np.arange(len(some))).mean(axis=2)
        shares[open_pixels] = ink_shares(window[open_pixels], palette[some], near[open_pixels])
        wanted = some[arranged(shares, own, open_pixels)]
        yield from _traced(wanted, drawn, columns.start, rows.start)


def _inks_here(pure: np.ndarray, drawn: np.ndarray, values: np.ndarray, palette: np.ndarray) -> np.ndarray:
    """(k,) the inks, of many only those that show in a window, are drawn there, or are the nearest to one of its values
    (n, 4): all pairs are tried. pure: (h, w, P) bool, where each shows."""
    if len(palette) <= MOST_INKS:
        return np.arange(len(palette))
    nearest = np.abs(values[:, None] - palette).max(axis=2).argmin(axis=1)
    return np.unique(np.concatenate([np.flatnonzero(pure.any(axis=(0, 1))), drawn.ravel(), nearest]))


def _drawn(
    painted: list[Painted], boxes: tuple[np.ndarray, np.ndarray], rows: slice, columns: slice, ground: int
) -> np.ndarray:
    """(SIDE h, SIDE w) the inks of the subpixels of a window as they are painted. boxes: the (n, 2) least and greatest
    x and y of all shapes."""
    lows, highs = boxes
    top, left = SIDE * rows.start, SIDE * columns.start
    out = np.full((SIDE * (rows.stop - rows.start), SIDE * (columns.stop - columns.start)), ground)
    corner, far = np.array([left, top]), np.array([left, top]) + out.shape[::-1]
    for k in np.flatnonzero(((lows < far) & (highs > corner)).all(axis=1)).tolist():
        shape = painted[k]
        x0, y0 = np.maximum(shape.low - [left, top], 0).tolist()
        x1, y1 = np.minimum(shape.high - [left, top], out.shape[::-1]).tolist()
        if x1 > x0 and y1 > y0:
            out[y0:y1, x0:x1][coverage(shape.edges, top + y0, left + x0, y1 - y0, x1 - x0) > 0.5] = shape.ink
    return out


def _traced(wanted: np.ndarray, drawn: np.ndarray, left: int, top: int) -> Iterator[Candidate]:
    """The connected parts in which another ink is wanted than is drawn."""
    for ink in np.unique(wanted[wanted != drawn]).tolist():
        parts, _ = ndimage.label((wanted == ink) & (drawn != ink))
        areas = np.bincount(parts.ravel())
        for k, box in enumerate(ndimage.find_objects(parts)):
            if areas[k + 1] < LEAST:
                continue
            loops = sorted(trace(parts[box] == k + 1), key=lambda loop: -loop.area)
            middles = [loop.middles for loop in loops if loop.area >= 0.0 or -loop.area >= LEAST]
            corner = np.array([box[1].start + SIDE * left, box[0].start + SIDE * top])
            yield Candidate(
                ink,
                int(areas[k + 1]),
                [tuple(_polygon(points + corner, tolerance) for points in middles) for tolerance in TOLERANCES],
            )


def _polygon(points: np.ndarray, tolerance: float) -> Ring:
    """A polygon in px about points (n, 2) in subpixels."""
    return polygon(few_lines(points, tolerance).anchors / SIDE)
