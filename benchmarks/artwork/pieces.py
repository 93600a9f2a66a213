"""The pieces that a drawing is stacked of, also where others hide them: what an editor would take hold of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from benchmarks.artwork.document import Document, alone, resources

OPAQUE = 250  # of 255
SAME_COLOUR = 2  # levels
LEAST_SEEN = 30  # px^2 that show of a piece that counts
WHOLE = 0.99  # of the canvas, above which a piece is its background
COVERED = 0.1  # share that others hide, from which a piece counts as covered
COMPLETED = 0.9  # intersection over union
MATCHING = 0.5  # the same of what shows, below which two pieces have nothing to do with each other
DIFFERENT = 16  # levels of the worst channel
MOST_ELEMENTS = 1500


@dataclass(frozen=True, eq=False)
class _Part:
    """A connected part of a fill or of a stroke. element: its number; box: rows and columns; mask: (h, w) bool;
    pixels: (h, w, 4) uint8."""

    element: int
    box: tuple[slice, slice]
    mask: np.ndarray
    pixels: np.ndarray

    @property
    def colour(self) -> np.ndarray:
        return np.median(self.pixels[self.mask], axis=0)


class DrawingPieces:
    """A drawing without smoothing, taken apart: the connected parts of fills and strokes, those joined that meet
    visibly in one colour. Translucent parts are left out.

    names: (parts,) the piece of each, piece k being named by one of its parts. top, element: (H, W) the part that
    shows, and the number of its element, -1 where none does.
    """

    def __init__(self, document: Document) -> None:
        self.shape = (document.height, document.width)
        self.parts = list(_parts(document))
        self.top = np.full(self.shape, -1)
        for k, part in enumerate(self.parts):
            self.top[part.box][part.mask] = k
        self.element = np.array([*(part.element for part in self.parts), -1])[self.top]
        self.names = self._joined()
        self.shown = np.where(self.top >= 0, self.names[self.top], -1) if self.parts else self.top
        names, sizes = np.unique(self.shown[self.shown >= 0], return_counts=True)
        self.seen: dict[int, int] = dict(zip(names.tolist(), sizes.tolist(), strict=True))

    def _joined(self) -> np.ndarray:
        names = np.arange(len(self.parts))
        colours = np.array([part.colour for part in self.parts]).reshape(-1, 4)
        for a, b in ((self.top[1:], self.top[:-1]), (self.top[:, 1:], self.top[:, :-1])):
            edge = (a != b) & (a >= 0) & (b >= 0)
            for i, j in np.unique(np.sort(np.stack([a[edge], b[edge]], axis=1), axis=1), axis=0):
                if names[i] != names[j] and (np.abs(colours[i] - colours[j]) <= SAME_COLOUR).all():
                    names[names == names[j]] = names[i]
        return names

    def silhouette(self, name: int) -> np.ndarray:
        """(H, W) bool: all that a piece covers, whether it shows or not."""
        found = np.zeros(self.shape, dtype=bool)
        for k in np.flatnonzero(self.names == name):
            found[self.parts[k].box] |= self.parts[k].mask
        return found

    def without(self, name: int) -> np.ndarray:
        """(H, W, 4) int16 the drawing when a piece is taken away."""
        image = np.zeros((*self.shape, 4), dtype=np.int16)
        for k, part in enumerate(self.parts):
            if self.names[k] != name:
                image[part.box][part.mask] = part.pixels[part.mask]
        return image

    def counting(self) -> Iterator[int]:
        """The pieces that show enough to count, but for the background that fills the canvas."""
        for name, seen in self.seen.items():
            if seen >= LEAST_SEEN and self.silhouette(name).mean() < WHOLE:
                yield name


def pieces_of(document: Document) -> DrawingPieces | None:
    """The pieces of a drawing; None for one of more elements than can be drawn one by one."""
    return DrawingPieces(document) if len(document.shapes()) <= MOST_ELEMENTS else None


def _parts(document: Document) -> Iterator[_Part]:
    shared = resources(document.root)
    for number, shape in enumerate(document.shapes()):
        for part in ("fill", "stroke"):
            if shape.style[part] == "none":
                continue
            pixels = document.draw(smooth=False, content=[*shared, alone(shape, part)])
            labels, _ = ndimage.label(pixels[..., 3] >= OPAQUE, np.ones((3, 3)))
            for k, box in enumerate(ndimage.find_objects(labels)):
                yield _Part(number, box, labels[box] == k + 1, pixels[box].copy())


def completed(truth: DrawingPieces, made: DrawingPieces) -> tuple[int, int]:
    """(how many of the truth's covered pieces the file has whole, how many there are).

    Covered: others hide a tenth or more of it. Whole: a piece of the file covers the same, hidden parts included, to an
    intersection over union above 0.9.
    """
    whole = total = 0
    for name in truth.counting():
        covered = truth.silhouette(name)
        if truth.seen[name] > (1.0 - COVERED) * covered.sum():
            continue
        total += 1
        rivals = np.unique(made.shown[covered & (truth.shown == name)])
        whole += any(_overlap(covered, made.silhouette(int(n))) > COMPLETED for n in rivals if n >= 0)
    return whole, total


def visible_error(truth: DrawingPieces, made: DrawingPieces) -> float | None:
    """The edit test: a piece is taken away in both drawings, and the share of its place where they then differ is
    measured; the mean over the truth's pieces, None without any.

    A piece that the file has no counterpart of, which shows to an intersection over union of a half, counts 1.
    """
    shares = []
    for name in truth.counting():
        place = truth.shown == name
        rivals = [int(n) for n in np.unique(made.shown[place]) if n >= 0]
        twin = max(rivals, key=lambda n: _overlap(place, made.shown == n), default=None)
        if twin is None or _overlap(place, made.shown == twin) < MATCHING:
            shares.append(1.0)
            continue
        inside = ndimage.binary_erosion(place & (made.shown == twin))
        if inside.any():
            rest = truth.without(name)[inside].astype(int) - made.without(twin)[inside]
            shares.append(float((np.abs(rest).max(axis=1) > DIFFERENT).mean()))
    return float(np.mean(shares)) if shares else None


def _overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))
