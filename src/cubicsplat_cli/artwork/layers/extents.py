"""The extent of each layer: what shows, the holes that upper layers fill, and some way under its neighbours.

The pixel masks decide only the topology; where the outlines run follows from the points that are visible.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.channels import widened
from cubicsplat_cli.artwork.geometry.outlines import Outline, Ring, dense, flattened, polygon
from cubicsplat_cli.artwork.layers.stacking import Stack
from cubicsplat_cli.artwork.regions.fills import OPAQUE
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.outlines import EdgePositions, contours_of, coverage, hull_mask, misplaced
from cubicsplat_cli.record import record

HIDDEN_SIGMA = 0.5  # px, standard error of the points of a cubic, and of those along the edge of what hides an outline
UNDERLAP = 3  # px that a layer reaches under its upper neighbours, so that no hairline shows


@record
class Contour:
    """A closed contour to be fitted. points: (n, 2) px; sigma: (n,) px, inf where hidden; hole: whether it is one."""

    points: np.ndarray
    sigma: np.ndarray
    hole: bool

    @property
    def known(self) -> np.ndarray:
        """(n,) px, standard errors with which hidden points count as well."""
        return np.where(np.isfinite(self.sigma), self.sigma, HIDDEN_SIGMA)


@record
class Extent:
    """A connected part of a layer. top, left: its window's corner, px. shown: the window's pixels (h, w) bool that
    show it; allowed: those that it may cover; holes: those within the contours of its holes. contours: the outer one
    first. near: the same that goes hardly beneath the layers at which its own likely ends; None if there are none."""

    top: int
    left: int
    shown: np.ndarray
    allowed: np.ndarray
    holes: np.ndarray
    contours: tuple[Contour, ...]
    near: Extent | None = None

    @property
    def seen(self) -> tuple[int, int, int]:
        """The row and column of the first pixel that shows, and how many do."""
        row, column = divmod(int(self.shown.argmax()), self.shown.shape[1])
        return self.top + row, self.left + column, int(self.shown.sum())


def extents(regions: Regions, stack: Stack, found: EdgePositions) -> Iterator[list[Extent]]:
    """The parts of each layer, back to front."""
    depth = stack.rank[regions.labels]
    opaque = (regions.fills[:, 3] >= OPAQUE)[regions.labels]
    boxes = ndimage.find_objects(depth + 1)
    for place, (box, own) in enumerate(zip(boxes, stack.layers, strict=True)):
        window = _with_room(box, depth.shape)
        shown, above = depth[window] == place, (depth[window] > place) & opaque[window]
        parts = [*_parts(window, shown, above, found, joined=len(own) > 1)]
        beyond = above & np.isin(depth[window], stack.ends[place])
        if beyond.any() and (beyond := beyond & ~ndimage.binary_dilation(shown, ndimage.SQUARE, UNDERLAP + 1)).any():
            near = {part.seen: part for part in _parts(window, shown, above & ~beyond, found, joined=len(own) > 1)}
            parts = [replace(part, near=near.get(part.seen)) for part in parts]
        yield parts


def extents_of(cover: np.ndarray, above: np.ndarray, found: EdgePositions) -> Iterator[Extent]:
    """The parts of a translucent overlay, of no layer. cover, above: (H, W) bool, where it shows, and what hides it."""
    window = _with_room(ndimage.find_objects(cover)[0], cover.shape)
    return _parts(window, cover[window], above[window], found, joined=False)


def _parts(
    window: tuple[slice, slice], shown: np.ndarray, above: np.ndarray, found: EdgePositions, joined: bool
) -> Iterator[Extent]:
    """window: the rows and columns of `shown` and `above`; joined: the hull of what shows counts too."""
    parts, count = ndimage.label(ndimage.reached(shown, above, hull_mask(shown) if joined else None, UNDERLAP))
    boxes = ndimage.find_objects(parts)
    # What a hull adds apart from all that shows is of no use.
    for k in np.flatnonzero(np.bincount(parts[shown], minlength=count + 1)).tolist():
        own = _with_room(boxes[k - 1], shown.shape)
        top, left = (outer.start + inner.start for outer, inner in zip(window, own, strict=True))
        part, seen = parts[own] == k, shown[own]
        loops = contours_of(part, seen, (top, left), found)
        contours = tuple(Contour(points, sigma, area < 0.0) for points, sigma, area in loops)
        yield Extent(top, left, seen & part, seen | above[own], ndimage.holes_of(part), contours)


def _with_room(box: tuple[slice, slice], shape: tuple[int, ...]) -> tuple[slice, slice]:
    """A box with as much room as the rest of a primitive may take that upper layers hide: half a circle shows as long
    as the whole one is, and half as high.
    """
    return widened(box, UNDERLAP + 1 + max(side.stop - side.start for side in box) // 2, shape)


def enclosed(ring: Ring, extent: Extent) -> tuple[tuple[slice, slice], np.ndarray]:
    """The rows and columns of an extent's window that a ring reaches; and (h, w) bool, of these: the pixels of which it
    encloses half or more."""
    top, left, size = extent.top, extent.left, extent.shown.shape
    ends = np.stack([np.floor(ring.cubics.min(axis=(0, 1))), np.ceil(ring.cubics.max(axis=(0, 1)))])
    (x, y), (right, bottom) = np.clip(ends - [left, top], 0, size[::-1]).astype(int).tolist()
    inside = coverage(ring.cubics, ring.lines, top + y, left + x, bottom - y, right - x) > 0.5
    return (slice(y, bottom), slice(x, right)), inside


@record
class Window:
    """Pixels that an outline of an extent must and may enclose, one px of tolerance taken off: an outer one all that
    shows, and what upper layers hide besides; one of a hole what shows in it of lower layers, and nothing that shows or
    lies outside of the outer one or in other holes. must: of a box, rows and columns, beyond which there is nothing
    that it must. may: (h, w) of the whole extent; besides: what else it may within the box, if anything."""

    extent: Extent
    must: np.ndarray
    may: np.ndarray
    canvas: tuple[int, int]
    box: tuple[slice, slice]
    besides: np.ndarray | None = None

    @classmethod
    def of(cls, extent: Extent, canvas: tuple[int, int]) -> Window:
        """That of the outer outline of an extent, on a canvas of such a height and width."""
        must = ndimage.binary_erosion(extent.shown, ndimage.SQUARE, border_value=1)
        # Where upper layers hide the edge it runs beneath them, not along it.
        beneath = ndimage.binary_dilation(extent.shown) & extent.allowed & ~extent.shown
        must |= beneath & ~ndimage.binary_dilation(~extent.allowed, ndimage.SQUARE, 2)
        # An outer outline may go around holes, which have outlines of their own.
        may = extent.allowed | extent.holes
        # The tolerance is not to close a gap that is as narrow as it.
        wide = ndimage.binary_dilation(ndimage.binary_erosion(~may, ndimage.SQUARE, border_value=1), ndimage.SQUARE, 2)
        may = ndimage.binary_dilation(may, ndimage.SQUARE) & (may | wide)
        return cls(extent, must, may, canvas, (slice(0, must.shape[0]), slice(0, must.shape[1])))

    @cached_property
    def spare(self) -> np.ndarray:
        """(h, w) bool: pixels that the outer outline may enclose but need not."""
        return ndimage.binary_dilation(self.extent.allowed, ndimage.SQUARE) & ~self.must

    @cached_property
    def between(self) -> np.ndarray:
        """(h, w) bool: pixels that any hole within the outer outline may enclose: where two overlapped, the shape would
        show."""
        return self.may & ~(self.must | ndimage.binary_erosion(~self.extent.allowed, ndimage.SQUARE))

    @cached_property
    def hidden(self) -> np.ndarray:
        """(h, w) bool: pixels that upper layers hide."""
        return self.extent.allowed & ~self.extent.shown

    @cached_property
    def wide(self) -> np.ndarray:
        """(h, w) bool: hidden pixels far enough from all others."""
        return ndimage.binary_erosion(self.hidden, ndimage.SQUARE, border_value=1)

    def at(self, mask: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(...) bool: a mask (h, w) at points (..., 2); beyond the canvas as on its border, beyond the window False."""
        column = np.clip(np.floor(points[..., 0]).astype(int), 0, self.canvas[1] - 1) - self.extent.left
        row = np.clip(np.floor(points[..., 1]).astype(int), 0, self.canvas[0] - 1) - self.extent.top
        height, width = mask.shape
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        return np.asarray(inside & mask[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)])

    def hole(self, contour: Contour) -> Window:
        """The same of a contour of a hole of the extent."""
        box, free = enclosed(polygon(contour.points), self.extent)
        must = ndimage.binary_erosion(free & ~self.extent.allowed[box], ndimage.SQUARE)
        return replace(self, must=must, may=self.between, box=box, besides=free & self.may[box] & ~self.must[box])

    def wrong(self, outline: Outline) -> np.ndarray:
        """(k, 2) middles x, y of the pixels that an outline encloses or leaves wrongly."""
        ring, corner = outline.ring(), (self.extent.top, self.extent.left)
        cubics = ring.cubics
        within = misplaced(cubics, ring.lines, corner, self.may, self.box, self.must, self.besides)
        # Points beyond the window, though on the canvas; none where no control point is beyond.
        low = np.array(corner[::-1]) - 1.0
        high = low + self.may.shape[::-1] + 2.0
        if not ((cubics < low) | (cubics > high)).any():
            return within
        points = dense(flattened(ring, 1.0), 1.0)
        beyond = ((points < low) | (points > high)).any(axis=1)
        astray = beyond & ((points > 0.0) & (points < self.canvas[::-1])).all(axis=1)
        return np.concatenate([within, points[astray]])
