"""A JPEG's picture as it was before it was compressed, as far as its restored picture and the file tell together.

What a hypothesis lacks is told by compressing it just as the file was: where its coefficients round to those of the
file, it lacks nothing, however much either rings. So the ringing is gone from the difference, which is added to the
hypothesis and divided into fills and their shares once more, as a blur is undone (van Cittert's iteration, between
projections onto what drawings are). The hypothesis that lacks least is kept.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.gradients.flattening import Flattened
from cubicsplat_cli.artwork.input.chroma import LUMA_CHROMA, Mixture, mixture_of
from cubicsplat_cli.artwork.input.restore import OFF, THIN, labelled
from cubicsplat_cli.artwork.regions.hairlines import with_lines
from cubicsplat_cli.artwork.regions.regions import FlatPicture
from cubicsplat_cli.files.decode import Compression
from cubicsplat_cli.progress import work
from cubicsplat_cli.scene.paint import painted

ROUNDS = 2
SPACES = LUMA_CHROMA, np.eye(4)  # coordinates in which fills are told apart: in RGB chroma counts more
# Levels by which pixels are off their fills then, and those on edges: half a step of the coefficients that matter.
MISFIT, EDGE_ERROR = 3.0, 4.0


def before_compression(
    levels: np.ndarray, flat: Flattened, even: FlatPicture, compression: Compression
) -> tuple[FlatPicture, np.ndarray]:
    """The restored picture of a JPEG once more, and (H, W, 4) the picture in levels that the file asks for, both with
    fills in place of gradients.

    levels: (H, W, 4) as they came; flat: the same without gradients; even: that restored, with palette and labels.
    """
    palette, found, least = even.palette, (even, levels), np.inf
    assert palette is not None and even.labels is not None  # as what was restored has
    for space in SPACES:
        labels, before, fills = even.labels, even.levels, palette @ space
        for number in range(ROUNDS + 1):
            work().at()
            seen = (before @ space).astype(np.float32)
            if number:
                labels = labelled(seen, fills, compression.rounding, len(fills), bounded=True)
                labels = with_lines(seen, fills, labels, OFF * MISFIT, THIN)
            mixture = mixture_of(seen, fills, labels, MISFIT, 0.0)
            picture = mixture.painted(palette)
            left = levels[..., :3] - compression.again(_with_gradients(picture, mixture, palette, flat)[..., :3])
            before = picture.copy()
            before[..., :3] += left
            if (error := float((left**2).sum())) < least:
                found, least = (FlatPicture(picture, palette, labels), before), error
    return found


def _with_gradients(picture: np.ndarray, mixture: Mixture, palette: np.ndarray, flat: Flattened) -> np.ndarray:
    """A picture (H, W, 4) in levels with its gradients in place of the fills that stand for them."""
    out = picture.copy()
    for fill, own in enumerate(palette):
        if (gradient := flat.gradient(own)) is not None:
            cover = mixture.coverage(fill)
            y, x = np.nonzero(cover)
            out[y, x] += cover[y, x, None] * (255.0 * painted(gradient, x + 0.5, y + 0.5) - own)
    return out
