"""Candidates for details: polygons of one ink where pixels hold an ink that the drawing does not have there."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from cubicsplat_cli.artwork.details.shares import ink_shares
from cubicsplat_cli.artwork.details.subpixels import SIDE, arranged, blocks
from cubicsplat_cli.artwork.geometry.coverage import paint_labels
from cubicsplat_cli.artwork.geometry.outlines import Ring, polygon
from cubicsplat_cli.artwork.regions.cracks import trace
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.artwork.tracing.fitting import few_lines

MARGIN = 3  # px around what is not explained, whose inks are looked at
PURE = 6.0  # levels within which a pixel shows an ink
REACH = 2  # px in which an ink that shows pure is near
MOST_INKS = 32  # that are all looked at everywhere
BAND = 65_536  # px that are looked at together
# Px to either side whose shares may change what the subpixels of a pixel are: by SMOOTH, and by interpolation.
ARRANGED_REACH = 4
LEAST = 12  # subpixels of a candidate and of its holes
TOLERANCES = (0.6, 1.0)  # subpixels that a polygon's lines may be off the cracks between them


@dataclass(frozen=True, eq=False)
class Candidate:
    """A detail to try. ink: its index; area: in subpixels; mask: (h, w) bool, and corner: (2,) x and y, where it is, in
    subpixels."""

    ink: int
    area: int
    mask: np.ndarray
    corner: np.ndarray

    def ways(self) -> list[tuple[Ring, ...]]:
        """The outer ring and the holes of each polygon that may stand for it, the closest first, in px."""
        loops = sorted(trace(self.mask), key=lambda loop: -loop.area)
        middles = [loop.middles + self.corner for loop in loops if loop.area >= 0.0 or -loop.area >= LEAST]
        return [tuple(_polygon(points, tolerance) for points in middles) for tolerance in TOLERANCES]


def painted_inks(drawing: Drawing, numbers: list[int], ground: int) -> np.ndarray:
    """(SIDE H, SIDE W) uint16 which ink each subpixel of a drawing shows, of shapes with the inks `numbers`; ground:
    where nothing is painted.
    """
    shapes = []
    for shape in drawing.shapes:
        rings = shape.oriented()
        cubics = SIDE * np.concatenate([ring.cubics for ring in rings])
        shapes.append((cubics, np.concatenate([ring.lines for ring in rings])))
    out = np.full((SIDE * drawing.height, SIDE * drawing.width), ground, dtype=np.uint16)
    paint_labels(out, shapes, numbers)
    return out


def candidates(
    levels: np.ndarray, palette: np.ndarray, painted: np.ndarray, unexplained: np.ndarray
) -> Iterator[Candidate]:
    """What the unexplained pixels (H, W) bool of a picture (H, W, 4) hold besides what is painted.

    palette: (P, 4) premultiplied inks in levels; painted: `painted_inks`.
    """
    clusters, _ = ndimage.label(ndimage.binary_dilation(unexplained, np.ones((3, 3), dtype=bool), MARGIN))
    for number, (rows, columns) in enumerate(ndimage.find_objects(clusters)):
        open_pixels = unexplained[rows, columns] & (clusters[rows, columns] == number + 1)
        fine = slice(SIDE * rows.start, SIDE * rows.stop), slice(SIDE * columns.start, SIDE * columns.stop)
        drawn = painted[fine]
        wanted = _wanted(levels[rows, columns].astype(float), palette, drawn, open_pixels)
        yield from _traced(wanted, drawn, columns.start, rows.start)


def _wanted(window: np.ndarray, palette: np.ndarray, drawn: np.ndarray, open_pixels: np.ndarray) -> np.ndarray:
    """(SIDE h, SIDE w) the inks that the subpixels of a window (h, w, 4) are to have, where it is open (h, w) bool; in
    bands of its rows, since each pixel has many inks.
    """
    height, width = open_pixels.shape
    step = max(1, BAND // width)
    pure = _rows(lambda part: _pure(part, palette), window, step)
    some = _inks_here(pure, drawn, window[open_pixels], palette)
    reach = (2 * REACH + 1, 2 * REACH + 1, 1)
    near = _rows(lambda part: ndimage.maximum_filter(part, reach), pure[..., some], step, REACH)[open_pixels]
    shown = ink_shares(window[open_pixels], palette[some], near)
    place = np.zeros(len(palette), dtype=np.uint16)
    place[some] = np.arange(len(some))
    own = place[drawn]
    number = np.cumsum(open_pixels).reshape(height, width) - 1  # of an open pixel, among all
    wanted = own.copy()
    for top in range(0, height, step):
        a, b = max(top - ARRANGED_REACH, 0), min(top + step + ARRANGED_REACH, height)
        inner, fine = open_pixels[a:b], own[SIDE * a : SIDE * b]
        if not open_pixels[top : top + step].any():
            continue
        shares = (blocks(fine)[..., None] == np.arange(len(some))).mean(axis=2)
        shares[inner] = shown[number[a:b][inner]]
        bottom = min(top + step, height)
        found = arranged(shares, fine, inner)
        wanted[SIDE * top : SIDE * bottom] = found[SIDE * (top - a) : SIDE * (bottom - a)]
    return some.astype(np.uint16)[wanted]


def _pure(window: np.ndarray, palette: np.ndarray) -> np.ndarray:
    """(h, w, P) bool: where a window (h, w, 4) shows each ink."""
    return np.asarray(np.abs(window[:, :, None] - palette).max(axis=3) <= PURE)


def _rows(found: Callable[[np.ndarray], np.ndarray], values: np.ndarray, step: int, reach: int = 0) -> np.ndarray:
    """What is found of values (h, ...), of each row by those within `reach` of it, `step` rows at a time."""
    parts = []
    for top in range(0, len(values), step):
        start, bottom = max(top - reach, 0), min(top + step, len(values))
        parts.append(found(values[start : bottom + reach])[top - start : bottom - start])
    return np.concatenate(parts)


def _inks_here(pure: np.ndarray, drawn: np.ndarray, values: np.ndarray, palette: np.ndarray) -> np.ndarray:
    """(k,) the inks, of many only those that show in a window, are drawn there, or are the nearest to one of its values
    (n, 4): all pairs are tried. pure: (h, w, P) bool, where each shows."""
    if len(palette) <= MOST_INKS:
        return np.arange(len(palette))
    nearest = np.abs(values[:, None] - palette).max(axis=2).argmin(axis=1)
    return np.unique(np.concatenate([np.flatnonzero(pure.any(axis=(0, 1))), drawn.ravel(), nearest]))


def _traced(wanted: np.ndarray, drawn: np.ndarray, left: int, top: int) -> Iterator[Candidate]:
    """The connected parts in which another ink is wanted than is drawn."""
    for ink in np.unique(wanted[wanted != drawn]).tolist():
        parts, _ = ndimage.label((wanted == ink) & (drawn != ink))
        areas = np.bincount(parts.ravel())
        for k, box in enumerate(ndimage.find_objects(parts)):
            if areas[k + 1] < LEAST:
                continue
            corner = np.array([box[1].start + SIDE * left, box[0].start + SIDE * top])
            yield Candidate(ink, int(areas[k + 1]), parts[box] == k + 1, corner)


def _polygon(points: np.ndarray, tolerance: float) -> Ring:
    """A polygon in px about points (n, 2) in subpixels."""
    return polygon(few_lines(points, tolerance).anchors / SIDE)
