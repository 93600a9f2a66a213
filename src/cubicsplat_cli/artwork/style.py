"""Whether a picture is a photo or flat artwork, by how much of it is texture and how few inks and gradients it has."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np

from cubicsplat_cli.artwork.input.evenness import evenness

PHOTO, ARTWORK = "photo", "artwork"
# A pixel is flat where its 3 x 3 neighbours differ by no more; texture is where no pixel of a whole block is flat,
# which edges, three pixels wide, never fill.
FLAT_LEVELS = 3.0  # of 255
MOST_TEXTURE = 0.14  # share of the pixels. Measured: Kodak photos 0.61 to 0.99, upscaled 0.34, 48 drawings at most 0.08
COUNTED_INKS = 64
LEAST_INKED = 0.35  # share of the pixels that have the commonest inks: photos at most 0.23, drawings at least 0.87
LEAST_EVEN = 0.6  # of 2, for a picture to be a drawing that has suffered
LEAST_SHADED = 0.5  # share of the pixels in gradients, for a picture of many colours to be a drawing
_BANDS_OF = 64  # rows
_MOST_PIXELS = 2**20  # looked at


@dataclass(frozen=True)
class Style:
    """The style that suits a picture, and the measurement that says so."""

    name: str
    reason: str


def choose_style(target: np.ndarray) -> Style:
    """The style for a picture, (H, W, 3) or premultiplied (H, W, 4), float32 in [0, 1]. Large ones are sampled."""
    levels = np.rint(255.0 * _sampled(target)).astype(np.float32)
    drawn = levels[..., 3] > 0 if levels.shape[2] == 4 else np.ones(levels.shape[:2], dtype=bool)
    if not drawn.any():
        return Style(ARTWORK, "nothing is drawn")
    texture, inked = _texture(levels, drawn), _inked(levels[drawn])
    reason = f"{100 * texture:.0f} % texture, {100 * inked:.0f} % in the {COUNTED_INKS} commonest colours"
    if texture <= MOST_TEXTURE and inked >= LEAST_INKED:
        return Style(ARTWORK, reason)
    even = evenness(levels, drawn)
    if even >= LEAST_EVEN:
        return Style(ARTWORK, f"{reason}, but it was even before noise, JPEG or blur: {even:.2f} of 2")
    if texture > MOST_TEXTURE:
        return Style(PHOTO, reason)
    shaded = _shaded(levels, drawn)
    style = ARTWORK if shaded >= LEAST_SHADED else PHOTO
    return Style(style, f"{reason}, {100 * shaded:.0f} % in gradients")


def _sampled(target: np.ndarray) -> np.ndarray:
    """The picture, or bands of its rows, evenly spread, of about as many pixels as are looked at."""
    height, width = target.shape[:2]
    if height * width <= _MOST_PIXELS:
        return target
    bands = max(1, _MOST_PIXELS // (_BANDS_OF * width))
    starts = np.linspace(0, max(0, height - _BANDS_OF), bands).astype(int)
    return np.concatenate([target[start : start + _BANDS_OF] for start in starts])


def _texture(levels: np.ndarray, drawn: np.ndarray) -> float:
    """Share of the drawn pixels in blocks without a flat pixel; blocks of 7 px, smaller in small pictures."""
    longer = max(levels.shape[:2])
    block = 7 if longer >= 256 else 5 if longer >= 64 else 3
    around = np.pad(levels, ((1, 1), (1, 1), (0, 0)), mode="edge")
    spread = _over_blocks(around, 3, np.maximum) - _over_blocks(around, 3, np.minimum)
    whole = _over_blocks(spread.max(-1) > FLAT_LEVELS, block, np.logical_and)
    uneven = _over_blocks(np.pad(whole, block - 1), block, np.logical_or)
    return float((uneven & drawn).sum() / drawn.sum())


def _over_blocks(values: np.ndarray, block: int, combine: np.ufunc) -> np.ndarray:
    """(H - block + 1, W - block + 1, ...): every whole block of values (H, W, ...) combined.

    In numpy, by rows and then by columns: photos, which need nothing else of scipy, are not kept waiting for it.
    """
    for _ in range(2):
        count = max(0, len(values) - block + 1)
        values = reduce(combine, (values[i : i + count] for i in range(block))).swapaxes(0, 1)
    return values


def _shaded(levels: np.ndarray, drawn: np.ndarray) -> float:
    """Share of the drawn pixels that linear and radial gradients explain."""
    from cubicsplat_cli.artwork.areas import gradient_areas, smooth_parts

    if levels.shape[2] == 3:
        levels = np.concatenate([levels, np.full_like(levels[..., :1], 255.0)], axis=2)
    explained = np.zeros(drawn.shape, dtype=bool)
    for area in gradient_areas(levels, *smooth_parts(levels)):
        explained |= area.mask
    return float((explained & drawn).sum() / drawn.sum())


def _inked(levels: np.ndarray) -> float:
    """Share of pixels (n, channels) that have one of the commonest colours."""
    code = levels.astype(np.int64) @ (256 ** np.arange(levels.shape[1]))
    counts = np.sort(np.unique(code, return_counts=True)[1])
    return float(counts[-COUNTED_INKS:].sum() / counts.sum())
