"""Whether a picture is pixel art, flat artwork or a photo: by its cells, by how even it is, or by how much of it fills
and gradients explain; and pictures of one colour, which nothing need be fitted to.
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.channels import ROWS, in_blocks, largest, packed
from cubicsplat_cli.artwork.input.cells import Cells, cells_of, without_repeats
from cubicsplat_cli.artwork.input.evenness import APART, SMALL, contrasts, even
from cubicsplat_cli.artwork.regions.fills import FLAT_RANGE, MOST_PALETTE
from cubicsplat_cli.artwork.shapes import Drawing, ground_shape
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import spread
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import Rgba

PHOTO, ARTWORK, PIXEL = "photo", "artwork", "pixel"
# Texture is where no pixel of a whole block is flat, which edges, three pixels wide, never fill.
MOST_TEXTURE = 0.14  # share of the pixels, where colours do not change by straight lines either
LEAST_SHADED = 0.75  # share of the pixels in flat fills and gradients, for a picture of many colours to be a drawing
# Levels of difference that people hardly see, by which a JPEG's pixels may be off; and how wide colours are then. Share
# of the pixels in common colours or gradients for a picture to be a drawing perhaps: 0.58 and 0.70 in two
# illustrations, photos that have little texture at most 0.28; emoji with soft shading at most 0.40.
UNSEEN, COLOUR, LEAST_DOUBTFUL = 6.0, 8, 0.5
_TRIES, _SIDE = 16, 600  # gradients sought, and about how many px of the longer side looked at for that
# Px of the blocks looked at for paper; what these have of the lightest ones' light; by which tints, in shares of the
# light, may differ; and share of the blocks that are such, where ink covers the others.
PAPER_BLOCK, LEAST_LIGHT, SAME_TINT, LEAST_PAPER = 8, 0.6, 0.08, 0.5
_MOST_PIXELS = 2**20  # looked at
# What a JPEG makes of one colour with a trace of noise: two steps of 8 bits between any two pixels, which nobody sees.
_SPREAD = 2.0 / 255.0 + 1e-6


@record
class Style:
    """The style that suits a picture, and the measurement that says so. cells: of pixel art, None of all else.
    doubtful: whether the other style may suit it as well.
    """

    name: str
    reason: str
    cells: Cells | None = None
    doubtful: bool = False


def choose_style(target: np.ndarray) -> Style:
    """The style for a picture, (H, W, 3) or premultiplied (H, W, 4), float32 in [0, 1]. Large ones are sampled."""
    cells = cells_of(target)
    if cells is not None:
        return Style(PIXEL, f"cells of {len(cells.colours)} colours", cells)
    target = without_repeats(target)
    levels = np.rint(255.0 * _sampled(target)).astype(np.float32)
    drawn = levels[..., 3] > 0 if levels.shape[2] == 4 else np.ones(levels.shape[:2], dtype=bool)
    if not drawn.any():
        return Style(ARTWORK, "nothing is drawn")
    is_drawn, reason = _drawn(levels)
    if is_drawn:
        return _unless_soft(levels, drawn, reason)
    if _like_paper(levels) and _scanned(target):
        return Style(ARTWORK, f"{reason}, but it is ink on a scan's paper")
    # In a steep gradient no pixel is flat, but colours change by straight lines.
    change, straight = spread(levels, 3, 3), _straight(levels)
    if _texture((change > FLAT_RANGE) & ~straight, drawn) <= MOST_TEXTURE:
        shaded = _shaded(levels, drawn)
        reason = f"{reason}, {100 * shaded:.0f} % in fills and gradients"
        if shaded >= LEAST_SHADED:
            return _unless_soft(levels, drawn, reason)
    if _texture((change > UNSEEN) & ~straight, drawn) > MOST_TEXTURE:
        return Style(PHOTO, reason)
    alike = _in_few_colours(levels, drawn, UNSEEN)
    if (alike & drawn).sum() < LEAST_DOUBTFUL * drawn.sum():
        return Style(PHOTO, reason)
    suits = _unless_soft(levels, drawn, reason)
    return suits if suits.name == PHOTO else Style(PHOTO, reason, doubtful=True)


def _drawn(levels: np.ndarray) -> tuple[bool, str]:
    """Whether neighbours in a picture (H, W, C) in 0..255 differ as in drawings, and what says so."""
    if max(levels.shape[:2]) > SMALL:
        is_even, shares = even(levels)
        return is_even, str(shares)
    found = contrasts(levels)
    return (True, f"all pixels {APART} px apart alike") if found is None else (found.drawn, str(found))


def _unless_soft(levels: np.ndarray, drawn: np.ndarray, reason: str) -> Style:
    """Artwork; or a photo, where colours drift without an edge, which in a few px cannot be told."""
    if max(drawn.shape) <= SMALL:
        return Style(ARTWORK, reason)
    from cubicsplat_cli.artwork.input.softness import softness

    found = softness(levels, drawn)
    if found.drifts:
        reason = f"{reason}, but colours drift across {100 * found.soft:.0f} % of it"
        # A window with a soft shadow, say, is even for the most part; and a logo may be one gradient beside another.
        even = 2.0 * found.soft < found.ground + found.even
        return Style(PHOTO, reason, doubtful=even or _shaded(levels, drawn) >= LEAST_DOUBTFUL)
    return Style(ARTWORK, reason)


def _like_paper(levels: np.ndarray) -> bool:
    """Whether most of a picture may be paper: light, and of one tint. In numpy alone, as most photos are not."""
    blocks = in_blocks(levels[..., :3], min(PAPER_BLOCK, *levels.shape[:2])).mean((2, 3)).reshape(-1, 3)
    light = blocks.mean(axis=1)
    bright = light >= LEAST_LIGHT * np.percentile(light, 90)
    tints = blocks / np.maximum(light, 1.0)[:, None]
    of_tint = np.abs(tints - np.median(tints[bright], axis=0)).max(axis=1) <= SAME_TINT
    return bool((bright & of_tint).mean() >= LEAST_PAPER)


def _scanned(target: np.ndarray) -> bool:
    """Whether a picture, every so many px of it, is a scan."""
    from cubicsplat_cli.artwork.input.paper import scan_of
    from cubicsplat_cli.artwork.input.prepare import as_levels

    step = math.ceil(math.sqrt(target.shape[0] * target.shape[1] / _MOST_PIXELS))
    return scan_of(as_levels(target[::step, ::step])) is not None


def _sampled(target: np.ndarray) -> np.ndarray:
    """The picture, or bands of its rows, evenly spread, of about as many pixels as are looked at."""
    height, width = target.shape[:2]
    if height * width <= _MOST_PIXELS:
        return target
    bands = max(1, _MOST_PIXELS // (ROWS * width))
    starts = np.linspace(0, max(0, height - ROWS), bands).astype(int)
    return np.concatenate([target[start : start + ROWS] for start in starts])


def _straight(levels: np.ndarray) -> np.ndarray:
    """(H, W) bool: across the pixel colours change by straight lines, along rows and columns."""
    around = np.pad(levels, ((1, 1), (1, 1), (0, 0)), mode="reflect", reflect_type="odd")
    across = largest(np.abs(around[1:-1, :-2] - 2.0 * levels + around[1:-1, 2:]))
    down = largest(np.abs(around[:-2, 1:-1] - 2.0 * levels + around[2:, 1:-1]))
    return np.maximum(across, down) <= FLAT_RANGE


def _texture(rough: np.ndarray, drawn: np.ndarray) -> float:
    """Share of the drawn pixels (H, W) bool in blocks of which all pixels are `rough` (H, W) bool; blocks of 7 px,
    smaller in small pictures, and no larger than the picture.
    """
    longer = max(rough.shape)
    block = min(7 if longer >= 256 else 5 if longer >= 64 else 3, *(side - 1 + side % 2 for side in rough.shape))
    uneven = ndimage.binary_opening(rough, np.ones((block, block), dtype=bool))
    return float((uneven & drawn).sum() / drawn.sum())


def _shaded(levels: np.ndarray, drawn: np.ndarray) -> float:
    """Share of the drawn pixels that are flat, in one of the commonest colours, or explained by a gradient."""
    from cubicsplat_cli.artwork.input.softness import in_gradients

    step = 1 + max(levels.shape[:2]) // _SIDE
    levels, drawn = levels[::step, ::step], drawn[::step, ::step]
    explained = _in_few_colours(levels, drawn, FLAT_RANGE, 1)
    explained |= in_gradients(levels, _TRIES)
    return float((explained & drawn).sum() / drawn.sum())


def _in_few_colours(levels: np.ndarray, drawn: np.ndarray, flat: float, width: int = COLOUR) -> np.ndarray:
    """(H, W) bool: pixels of a picture that are in one of the commonest colours, each so many levels wide, and differ
    from those around them by at most `flat` levels.
    """
    code = packed(levels // width)
    colours, counts = np.unique(code[drawn], return_counts=True)
    commonest = colours[np.argsort(-counts, kind="stable")[:MOST_PALETTE]]
    return np.isin(code, commonest) & (spread(levels, 3, 3) <= flat)


def only_fill(picture: Picture) -> Rgba | None:
    """The colour of every pixel, (0, 0, 0, 0) where all are transparent; None where there are several.

    Colours that are all but the same count as their mean; opacities must be the same.
    """
    if picture.alpha is not None and _mean(picture.alpha[..., None], 0.0) is None:
        return None
    colour = _mean(picture.rgb, _SPREAD)
    if colour is None:
        return None
    red, green, blue = (round(255 * value) for value in colour)
    return red, green, blue, 255 if picture.alpha is None else round(255 * float(picture.alpha[0, 0]))


def _mean(plane: np.ndarray, spread: float) -> list[float] | None:
    """The mean of each channel of (H, W, C); None where one's values lie further apart than `spread`."""
    least = most = plane[0, 0]
    total = np.zeros(plane.shape[2])
    # Most pictures are known by their first rows.
    for top in range(0, plane.shape[0], ROWS):
        part = plane[top : top + ROWS]
        least, most = np.minimum(least, part.min((0, 1))), np.maximum(most, part.max((0, 1)))
        if (most - least > spread).any():
            return None
        total += part.sum((0, 1), dtype=np.float64)
    return [float(value) for value in total / (plane.shape[0] * plane.shape[1])]


def plain_drawing(fill: Rgba, width: int, height: int) -> Drawing:
    """A rectangle of one fill over the whole canvas; nothing where the fill is transparent."""
    return Drawing(width, height, (ground_shape(fill, width, height),) if fill[3] else ())
