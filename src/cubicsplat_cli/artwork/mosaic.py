"""The drawing of a picture of cells: exactly along the cells' edges, with one path for each colour.

A colour reaches one cell beneath the opaque colours above it, so that no ground shines through at their edges.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.channels import FULL, widened
from cubicsplat_cli.artwork.geometry.outlines import next_in_loops, thirds
from cubicsplat_cli.artwork.input.cells import Cells
from cubicsplat_cli.artwork.regions.fills import eight_bit
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.borders import border_map
from cubicsplat_cli.record import record
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.paint import Rgba

MOST_CORNERS = 1365  # of a curve of a scene: each row of its arrays has room for the longest curve


@record
class CellLayer:
    """The cells of one colour. fill: of 8 bits, not premultiplied. mask: (R, C) bool, the cells that it covers. x: (C +
    1,) and y: (R + 1,) float64, px, the edges of their columns and rows.
    """

    fill: Rgba
    mask: np.ndarray
    x: np.ndarray
    y: np.ndarray

    @cached_property
    def loops(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the corners (n, 2) of all loops, float64 px, and the end (m,) of each loop; see `outlines`."""
        corners, ends = outlines(self.mask)
        return np.stack([self.x[corners[:, 0]], self.y[corners[:, 1]]], axis=1), ends

    def parts(self) -> list[CellLayer]:
        """Return parts of at most MOST_CORNERS corners; opaque ones overlap by a row or column of cells."""
        if len(self.loops[0]) <= MOST_CORNERS or self.mask.size == 1:
            return [self] if len(self.loops[0]) else []
        rows, columns = self.mask.shape
        lap = int(self.fill[3] == FULL)
        half = max(rows, columns) // 2
        if rows >= columns:
            first = replace(self, mask=self.mask[: half + lap], y=self.y[: half + lap + 1])
            second = replace(self, mask=self.mask[half:], y=self.y[half:])
        else:
            first = replace(self, mask=self.mask[:, : half + lap], x=self.x[: half + lap + 1])
            second = replace(self, mask=self.mask[:, half:], x=self.x[half:])
        return first.parts() + second.parts()

    def rings(self) -> list[np.ndarray]:
        """Return the control points (3k, 2) float32 of each loop as cubics."""
        corners, ends = self.loops
        after = corners[next_in_loops(_owners(ends))]
        points = np.concatenate([corners[:, None], thirds(corners, after)], axis=1)
        return np.split(points.reshape(-1, 2).astype(np.float32), 3 * ends[:-1])


@record
class Mosaic:
    """Layers back to front on a canvas of width x height px."""

    width: int
    height: int
    layers: tuple[CellLayer, ...]

    @property
    def corners(self) -> int:
        """Return the number of corners of all loops, which is that of their lines."""
        return sum(len(layer.loops[0]) for layer in self.layers)

    @property
    def fills(self) -> tuple[Rgba, ...]:
        """Return the different fills, in the order of first use."""
        return tuple(dict.fromkeys(layer.fill for layer in self.layers))

    def scene(self) -> Scene | None:
        """Return closed curves, front to back, one or more for each layer, without a background; None if empty."""
        parts = [part for layer in reversed(self.layers) for part in layer.parts()]
        if not parts:
            return None
        fills = np.array([part.fill for part in parts], np.float32) / np.float32(255.0)
        return Scene.filled(self.width, self.height, [part.rings() for part in parts], fills)


def with_ground(cells: Cells, colour: tuple[int, int, int] | None) -> tuple[Cells, bool]:
    """Return the cells with their ground in another colour, 8-bit sRGB, or transparent (None), and True if they have a
    ground: an opaque colour of most cells along the picture's edge. Transparent cells take the colour too.
    """
    edge = np.concatenate([cells.numbers[[0, -1]].ravel(), cells.numbers[1:-1, [0, -1]].ravel()])
    counts = np.bincount(edge, minlength=len(cells.colours))
    ground = int(counts.argmax())
    has_ground = bool(2 * counts[ground] > len(edge) and cells.colours[ground, 3] >= FULL)
    colours = cells.colours.copy()
    if colour is not None:
        colours[cells.colours[:, 3] == 0.0] = (*colour, FULL)
    if has_ground:
        colours[ground] = (0.0, 0.0, 0.0, 0.0) if colour is None else (*colour, FULL)
    return replace(cells, colours=colours), has_ground


def finer(cells: Cells, reach: float) -> Cells:
    """Return each cell cut into nine; layers overlap by the outer ones, `reach` px wide or a third of a small cell."""

    def cut(ends: np.ndarray) -> np.ndarray:
        low, high = ends[:-1], ends[1:]
        lap = np.minimum(reach, (high - low) / 3.0)
        return np.append(np.stack([low, low + lap, high - lap], axis=1).ravel(), ends[-1])

    return replace(cells, numbers=cells.numbers.repeat(3, axis=0).repeat(3, axis=1), x=cut(cells.x), y=cut(cells.y))


def mosaic(cells: Cells, width: int, height: int, *, abutting: bool = False) -> Mosaic:
    """Return the drawing of cells on a canvas, the most frequent colour at the back. abutting: without overlaps."""
    x, y = cells.x * (width / cells.x[-1]), cells.y * (height / cells.y[-1])
    order = np.argsort(-np.bincount(cells.numbers.ravel(), minlength=len(cells.colours)), kind="stable")
    # Later colours have higher ranks. Nothing may lie beneath a colour that is not opaque.
    rank = np.argsort(order)[cells.numbers]
    above = np.where((cells.colours[:, 3] >= FULL)[cells.numbers], rank, -1)
    layers = []
    for place, box in enumerate(ndimage.find_objects(rank + 1)):
        fill = eight_bit(cells.colours[order[place]])
        if box is None or fill[3] == 0:
            continue
        box = widened(box, 1, rank.shape)
        mask = rank[box] == place
        if not abutting:
            mask = mask | (ndimage.binary_dilation(mask, ndimage.SQUARE) & (above[box] > place))
        ends = (slice(side.start, side.stop + 1) for side in box)
        down, across = (where[side] for where, side in zip((y, x), ends, strict=True))
        layers.append(CellLayer(fill, mask, across, down))
    return Mosaic(width, height, tuple(layers))


def outlines(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the loops around a mask (H, W) bool, whose cells connect along edges and not at corners: (n, 2) int x and
    y of the corners of all loops, and (m,) int the end of each loop.

    Each loop begins with a horizontal side. Outer loops run clockwise as seen, holes the other way.
    """
    loops = border_map(mask.astype(np.int32)).loops
    owner = _owners(loops.ends)
    own = (loops.owners == 1)[owner]
    (x, y, way), owner = loops.cracks[own].T, owner[own]
    # The last crack of a loop comes before its first one.
    turns = way != way[np.argsort(next_in_loops(owner), kind="stable")]
    x, y, level, owner = x[turns], y[turns], way[turns] % 2 == 0, owner[turns]
    # Each begins with its uppermost horizontal side, the leftmost of several.
    low = np.minimum(x, x[next_in_loops(owner)])
    order = np.lexsort((low, y, ~level, owner))
    starts, counts = np.unique(owner, return_index=True, return_counts=True)[1:]
    heads = order[starts]
    rank = np.empty(len(heads), dtype=np.int64)
    rank[np.lexsort((low[heads], y[heads]))] = np.arange(len(heads))
    place = (np.arange(len(x)) - np.repeat(heads, counts)) % np.repeat(counts, counts)
    return np.stack([x, y], axis=1)[np.lexsort((place, np.repeat(rank, counts)))], np.cumsum(counts[np.argsort(rank)])


def _owners(ends: np.ndarray) -> np.ndarray:
    """Return (n,) the number of the loop of each element, of loops with these ends (m,)."""
    return np.repeat(np.arange(len(ends)), np.diff(ends, prepend=0))
