"""Whether a picture is a photo or flat artwork, by how much of it is texture and how few inks and gradients it has."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce

import numpy as np

from cubicsplat_cli.artwork.input.cells import cells_of
from cubicsplat_cli.artwork.input.evenness import covered, evenness

PHOTO, ARTWORK = "photo", "artwork"
# A pixel is flat where its 3 x 3 neighbours differ by no more; texture is where no pixel of a whole block is flat,
# which edges, three pixels wide, never fill.
FLAT_LEVELS = 3.0  # of 255
MOST_TEXTURE = 0.14  # share of the pixels. Measured: Kodak photos 0.61 to 0.99, upscaled 0.34, 48 drawings at most 0.08
COUNTED_INKS = 64
LEAST_INKED = 0.35  # share of the pixels that have the commonest inks: photos at most 0.23, drawings at least 0.87
# Of 2, for a picture to be a drawing that has suffered; below SURELY_EVEN so much must be in a few colours.
LEAST_EVEN, SURELY_EVEN, LEAST_COVERED = 0.6, 0.7, 0.82
LEAST_SHADED = 0.75  # share of the pixels in flat inks and gradients, for a picture of many colours to be a drawing
_TRIES, _SIDE = 16, 600  # gradients sought, and about how many px of the longer side looked at for that
_BANDS_OF = 64  # rows
_MOST_PIXELS = 2**20  # looked at


@dataclass(frozen=True)
class Style:
    """The style that suits a picture, and the measurement that says so."""

    name: str
    reason: str


def choose_style(target: np.ndarray) -> Style:
    """The style for a picture, (H, W, 3) or premultiplied (H, W, 4), float32 in [0, 1]. Large ones are sampled."""
    cells = cells_of(target)
    if cells is not None:
        return Style(ARTWORK, f"cells of {len(cells.colours)} colours")
    levels = np.rint(255.0 * _sampled(target)).astype(np.float32)
    drawn = levels[..., 3] > 0 if levels.shape[2] == 4 else np.ones(levels.shape[:2], dtype=bool)
    if not drawn.any():
        return Style(ARTWORK, "nothing is drawn")
    texture, inked = _texture(levels, drawn), _inked(levels[drawn])
    reason = f"{100 * texture:.0f} % texture, {100 * inked:.0f} % in the {COUNTED_INKS} commonest colours"
    if texture <= MOST_TEXTURE and inked >= LEAST_INKED:
        return _unless_soft(levels, drawn, reason)
    even = evenness(levels, drawn)
    if even >= SURELY_EVEN or (even >= LEAST_EVEN and covered(levels, drawn) >= LEAST_COVERED):
        return _unless_soft(levels, drawn, f"{reason}, but it was even before noise, JPEG or blur: {even:.2f} of 2")
    if _grey(levels):
        if _scanned(target):
            return Style(ARTWORK, f"{reason}, but it is ink on a scan's paper")
        if _flat(levels, drawn):
            return Style(ARTWORK, f"{reason}, but most of it is even greys")
    # In a steep gradient no pixel is flat, but colours change by straight lines.
    if texture > MOST_TEXTURE and _texture(levels, drawn, _straight(levels)) > MOST_TEXTURE:
        return Style(PHOTO, reason)
    shaded = _shaded(levels, drawn)
    reason = f"{reason}, {100 * shaded:.0f} % in inks and gradients"
    return _unless_soft(levels, drawn, reason) if shaded >= LEAST_SHADED else Style(PHOTO, reason)


def _unless_soft(levels: np.ndarray, drawn: np.ndarray, reason: str) -> Style:
    """Artwork; or a photo, where colours drift without an edge."""
    from cubicsplat_cli.artwork.input.softness import softness

    found = softness(levels, drawn)
    if found.drifts:
        return Style(PHOTO, f"{reason}, but colours drift across {100 * found.soft:.0f} % of it")
    return Style(ARTWORK, reason)


def _flat(levels: np.ndarray, drawn: np.ndarray) -> bool:
    """Whether most of a picture is even but for noise, JPEG or blur, by where its colours lie."""
    from cubicsplat_cli.artwork.input.softness import softness

    return softness(levels, drawn).flat


def _grey(levels: np.ndarray) -> bool:
    """Whether a picture has no colour, and so too few different values for its evenness to be told."""
    return bool((levels[..., :3] == levels[..., :1]).all())


def _scanned(target: np.ndarray) -> bool:
    """Whether a picture, every so many px of it, is a scan."""
    from cubicsplat_cli.artwork.input.intake import as_levels
    from cubicsplat_cli.artwork.input.paper import scan_of

    step = math.ceil(math.sqrt(target.shape[0] * target.shape[1] / _MOST_PIXELS))
    return scan_of(as_levels(target[::step, ::step])) is not None


def _sampled(target: np.ndarray) -> np.ndarray:
    """The picture, or bands of its rows, evenly spread, of about as many pixels as are looked at."""
    height, width = target.shape[:2]
    if height * width <= _MOST_PIXELS:
        return target
    bands = max(1, _MOST_PIXELS // (_BANDS_OF * width))
    starts = np.linspace(0, max(0, height - _BANDS_OF), bands).astype(int)
    return np.concatenate([target[start : start + _BANDS_OF] for start in starts])


def _straight(levels: np.ndarray) -> np.ndarray:
    """(H, W) bool: across the pixel colours change by straight lines, along rows and columns."""
    around = np.pad(levels, ((1, 1), (1, 1), (0, 0)), mode="reflect", reflect_type="odd")
    across = np.abs(around[1:-1, :-2] - 2.0 * levels + around[1:-1, 2:]).max(axis=2)
    down = np.abs(around[:-2, 1:-1] - 2.0 * levels + around[2:, 1:-1]).max(axis=2)
    return np.maximum(across, down) <= FLAT_LEVELS


def _texture(levels: np.ndarray, drawn: np.ndarray, even: np.ndarray | None = None) -> float:
    """Share of the drawn pixels in blocks without a flat pixel, nor one that is `even` (H, W) bool; blocks of 7 px,
    smaller in small pictures, and no larger than the picture's shorter side.
    """
    longer = max(levels.shape[:2])
    block = min(7 if longer >= 256 else 5 if longer >= 64 else 3, *levels.shape[:2])
    rough = _spread(levels) > FLAT_LEVELS
    whole = _over_blocks(rough if even is None else rough & ~even, block, np.logical_and)
    uneven = _over_blocks(np.pad(whole, block - 1), block, np.logical_or)
    return float((uneven & drawn).sum() / drawn.sum())


def _spread(levels: np.ndarray) -> np.ndarray:
    """(H, W) levels between the least and the greatest of 3 x 3 pixels, in the channel with most."""
    around = np.pad(levels, ((1, 1), (1, 1), (0, 0)), mode="edge")
    return (_over_blocks(around, 3, np.maximum) - _over_blocks(around, 3, np.minimum)).max(axis=-1)


def _over_blocks(values: np.ndarray, block: int, combine: np.ufunc) -> np.ndarray:
    """(H - block + 1, W - block + 1, ...): every whole block of values (H, W, ...) combined.

    In numpy, by rows and then by columns: photos, which need nothing else of scipy, are not kept waiting for it.
    """
    for _ in range(2):
        count = max(0, len(values) - block + 1)
        values = reduce(combine, (values[i : i + count] for i in range(block))).swapaxes(0, 1)
    return values


def _shaded(levels: np.ndarray, drawn: np.ndarray) -> float:
    """Share of the drawn pixels that are flat, in one of the commonest colours, or explained by a gradient."""
    from cubicsplat_cli.artwork.gradients.areas import gradient_areas, smooth_parts

    step = 1 + max(levels.shape[:2]) // _SIDE
    levels, drawn = levels[::step, ::step], drawn[::step, ::step]
    code = levels.astype(np.int64) @ (256 ** np.arange(levels.shape[2]))
    colours, counts = np.unique(code[drawn], return_counts=True)
    explained = np.isin(code, colours[np.argsort(-counts, kind="stable")[:COUNTED_INKS]])
    explained &= _spread(levels) <= FLAT_LEVELS
    if levels.shape[2] == 3:
        levels = np.concatenate([levels, np.full_like(levels[..., :1], 255.0)], axis=2)
    for area in gradient_areas(levels, *smooth_parts(levels), _TRIES):
        explained |= area.mask
    return float((explained & drawn).sum() / drawn.sum())


def _inked(levels: np.ndarray) -> float:
    """Share of pixels (n, channels) that have one of the commonest colours."""
    code = levels.astype(np.int64) @ (256 ** np.arange(levels.shape[1]))
    counts = np.sort(np.unique(code, return_counts=True)[1])
    return float(counts[-COUNTED_INKS:].sum() / counts.sum())
