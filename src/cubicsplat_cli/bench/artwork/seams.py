"""Seams: what shows of the ground where the truth is opaque, between shapes that should touch.

The measure is the ground's share 1 - alpha of the drawing, so it holds for white, black, magenta and every other ground
at once. It is summed over what lies at least two px inside the canvas and the truth's opaque shapes (drawn without
smoothing, which has no hairlines of its own): there neither a displaced outline nor a smoothed edge shows the ground,
only a gap does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.bench.artwork.document import Document

SCALES = (1, 4, 16)
INSIDE = 2  # px
_TILE = 64  # px of the canvas: 1024 at the largest scale


@dataclass(frozen=True)
class Opaque:
    """Where the truth is opaque: (H, W) bool at 4 times its size, without what is within two px of the edge."""

    mask: np.ndarray

    def at(self, scale: int) -> np.ndarray:
        """The mask at 1, 4 or 16 times the size; at 1 a px counts where all of it does."""
        if scale >= 4:
            return self.mask.repeat(scale // 4, axis=0).repeat(scale // 4, axis=1)
        height, width = (side // 4 * 4 for side in self.mask.shape)
        blocks = self.mask[:height, :width].reshape(height // 4, 4, width // 4, 4)
        return np.logical_and.reduce(blocks, axis=(1, 3))


def opaque_inside(truth: Document) -> Opaque:
    """The region in which no seam may show."""
    from scipy.ndimage import binary_erosion

    mask = truth.draw(4, smooth=False)[..., 3] == 255
    # Row by row and column by column is a square. The canvas's edge counts too: a circle may touch it from within.
    for shape in ((1, 2 * 4 * INSIDE + 1), (2 * 4 * INSIDE + 1, 1)):
        mask = binary_erosion(mask, np.ones(shape, dtype=bool))
    return Opaque(mask)


def seam_areas(document: Document, opaque: Opaque, drawn: dict[int, np.ndarray]) -> tuple[float, ...]:
    """Area in px of the ground that shows, at 1, 4 and 16 times the size. drawn: the pictures at 1 and 4 times it.

    At 16 times the size only those parts are drawn that have a seam at 4 times: an edge that runs along px at 16 times
    the size and not at 4 does not exist, and what is narrower than a px still shows in its share of it.
    """
    shown = {scale: _shown(drawn[scale], opaque.at(scale)) for scale in SCALES[:2]}
    areas = [float(shown[scale].sum()) / scale**2 for scale in SCALES[:2]]
    return (*areas, _largest_scale(document, opaque, shown[4]))


def _shown(pixels: np.ndarray, inside: np.ndarray) -> np.ndarray:
    return np.where(inside, (255.0 - pixels[..., 3]) / 255.0, 0.0)


def _largest_scale(document: Document, opaque: Opaque, shown: np.ndarray) -> float:
    total = 0.0
    for top in range(0, document.height, _TILE):
        for left in range(0, document.width, _TILE):
            width, height = min(_TILE, document.width - left), min(_TILE, document.height - top)
            part = slice(4 * top, 4 * (top + height)), slice(4 * left, 4 * (left + width))
            if not shown[part].any():
                continue
            tile = document.draw(16, window=(left, top, width, height))
            total += float(_shown(tile, Opaque(opaque.mask[part]).at(16)).sum()) / 16**2
    return total
