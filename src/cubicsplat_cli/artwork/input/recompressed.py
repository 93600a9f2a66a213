"""Reconstruct a JPEG's picture before its compression from its restored picture and the file's quantisation.

A hypothesis is compressed just as the file was. Where its coefficients round to those of the file, nothing differs,
however much both ring. The difference is added to the hypothesis, which is divided into fills and their shares again,
as a blur is undone (van Cittert's iteration, between projections onto what drawings are). The hypothesis with the least
difference is kept.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.gradients.flattening import Flattened
from cubicsplat_cli.artwork.input.chroma import LUMA_CHROMA, Mixture, mixture_of
from cubicsplat_cli.artwork.input.condition import OUTLIER
from cubicsplat_cli.artwork.input.restore import THIN, labelled
from cubicsplat_cli.artwork.regions.hairlines import with_lines
from cubicsplat_cli.artwork.regions.regions import FlatPicture
from cubicsplat_cli.files.decode import Compression
from cubicsplat_cli.progress import work
from cubicsplat_cli.scene.paint import painted

# Levels by which pixels are off their fills, and those on edges: half a step of the coefficients that matter.
MISFIT, EDGE_ERROR = 3.0, 4.0


def before_compression(
    levels: np.ndarray, flat: Flattened, even: FlatPicture, compression: Compression
) -> tuple[FlatPicture, np.ndarray]:
    """Return a JPEG's picture before its compression, in flat fills, and the levels (H, W, 4) that its outlines are
    fitted to, corrected by what the file lacks of it; both with placeholders for gradients.

    levels: (H, W, 4) the file's; flat: the same without gradients; even: that restored, with palette and labels.
    """
    palette, best, least = even.palette, (even, levels), np.inf
    assert palette is not None and even.labels is not None  # as every restored picture with noise has
    for space in (LUMA_CHROMA, np.eye(4)):  # in RGB, chroma counts more when fills are told apart
        labels, target, fills = even.labels, even.levels, palette @ space
        for number in range(3):
            work().at()
            seen = (target @ space).astype(np.float32)
            if number:
                labels = labelled(seen, fills, compression.rounding, len(fills), bounded=True)
                labels = with_lines(seen, fills, labels, OUTLIER * MISFIT, THIN)
            mixture = mixture_of(seen, fills, labels, MISFIT, 0.0)
            picture = mixture.painted(palette)
            left = levels[..., :3] - compression.again(_with_gradients(picture, mixture, palette, flat)[..., :3])
            target = picture.copy()
            target[..., :3] += left
            if (error := float((left**2).sum())) < least:
                best, least = (FlatPicture(picture, palette, labels), target), error
    return best


def _with_gradients(picture: np.ndarray, mixture: Mixture, palette: np.ndarray, flat: Flattened) -> np.ndarray:
    """Return a picture (H, W, 4) in levels with its gradients in place of their placeholders."""
    out = picture.copy()
    for number, fill in enumerate(palette):
        if (gradient := flat.gradient(fill)) is not None:
            cover = mixture.coverage(number)
            y, x = np.nonzero(cover)
            out[y, x] += cover[y, x, None] * (255.0 * painted(gradient, x + 0.5, y + 0.5) - fill)
    return out
