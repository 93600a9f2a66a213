"""Tell pixel art, artwork and photos apart: by cells, evenness, or shares of fills; and find those of one colour."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.channels import ROWS, largest, packed
from cubicsplat_cli.artwork.input.cells import Cells, cells_of, without_repeats
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.dither import without_dither
from cubicsplat_cli.artwork.input.evenness import ASIDE, SMALL, contrasts, even
from cubicsplat_cli.artwork.regions.fills import FLAT_RANGE, MOST_PALETTE
from cubicsplat_cli.artwork.shapes import Drawing, ground_shape
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import spread
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.arrays import with_channels
from cubicsplat_cli.scene.paint import Rgba

PHOTO, ARTWORK, PIXEL = "photo", "artwork", "pixel"
# Texture consists of blocks without a flat pixel; edges, three pixels wide, never fill a block.
MOST_TEXTURE = 0.14  # share of a drawing's pixels, outside of linear gradients
LEAST_SHADED = 0.75  # share of a drawing's pixels in flat fills and gradients, if it has many colours
# Levels of difference that people hardly see, and a JPEG's error; the width of a colour in levels under that error; the
# least share of the pixels in common colours or gradients of a possible drawing: two illustrations have 0.58 and 0.70,
# photos of little texture at most 0.28, emoji with soft shading at most 0.40.
UNSEEN, COLOUR, LEAST_DOUBTFUL = 6.0, 8, 0.5
# The commonest colours, as wide as a JPEG rings near strong edges, in levels, and the least share of the pixels in them
# of a possible drawing: small logos in JPEGs have 0.66 and more, photos without an even ground at most 0.57.
FEW_COLOURS, RINGING, LEAST_IN_FEW = 4, 32, 0.6
TYPICAL = Condition(noise=1.0, jpeg=True)  # 48 JPEGs and WebPs of drawings have a noise of 0.6 to 2.3 levels
_MOST_PIXELS = 2**20  # that are tested


@record
class Style:
    """The style that suits a picture, and why. cells: of pixel art, else None. doubtful: another may suit as well."""

    name: str
    reason: str
    cells: Cells | None = None
    doubtful: bool = False


def choose_style(target: np.ndarray, *, lossy: bool = False) -> Style:
    """Return the style for a picture, (H, W, 3) or premultiplied (H, W, 4), float32 in [0, 1]. Samples large ones.
    lossy: True if its file was compressed with loss.
    """
    cells = cells_of(target)
    if cells is not None:
        return Style(PIXEL, f"cells of {len(cells.colours)} colours", cells)
    target = without_repeats(target)
    levels = np.rint(255.0 * _sampled(target)).astype(np.float32)
    levels = levels if lossy else without_dither(levels)[0]
    drawn = levels[..., 3] > 0 if levels.shape[2] == 4 else np.ones(levels.shape[:2], dtype=bool)
    if not drawn.any():
        return Style(ARTWORK, "nothing is drawn")
    is_drawn, reason = _drawn(levels)
    suits = _unless_soft(levels, drawn, reason, lossy=lossy, plain=not lossy) if is_drawn else None
    if suits is not None and suits.name == ARTWORK:
        return suits
    # Colours drift across the paper of a scan too, and fine grain is lost in a JPEG.
    if _scanned(target):
        return Style(ARTWORK, f"{reason}, but it is ink on a scan's paper")
    if suits is not None:
        return suits
    # A steep gradient has no flat pixel, but its colours change linearly.
    change, straight = spread(levels, 3, 3), _straight(levels)
    if _texture((change > FLAT_RANGE) & ~straight, drawn) <= MOST_TEXTURE:
        shaded = _shaded(levels, drawn)
        reason = f"{reason}, {100 * shaded:.0f} % in fills and gradients"
        if shaded >= LEAST_SHADED:
            return _unless_soft(levels, drawn, reason, lossy=lossy)
    if lossy:
        possible = _in_very_few(levels, drawn) or _in_possible_paints(levels, drawn) >= LEAST_DOUBTFUL
    else:
        textured = _texture((change > UNSEEN) & ~straight, drawn) > MOST_TEXTURE
        possible = not textured and _in_possible_fills(levels, drawn) >= LEAST_DOUBTFUL
    if not possible:
        return Style(PHOTO, reason)
    suits = _unless_soft(levels, drawn, reason, lossy=lossy)
    return suits if suits.name == PHOTO else Style(PHOTO, reason, doubtful=True)


def _drawn(levels: np.ndarray) -> tuple[bool, str]:
    """Return True if neighbours in a picture (H, W, C) in 0..255 differ as in drawings, and the measurement."""
    if max(levels.shape[:2]) > SMALL:
        is_even, shares = even(levels)
        return is_even, str(shares)
    contrast = contrasts(levels)
    return (True, f"all pixels {ASIDE} px apart alike") if contrast is None else (contrast.drawn, str(contrast))


def _unless_soft(levels: np.ndarray, drawn: np.ndarray, reason: str, *, lossy: bool, plain: bool = False) -> Style:
    """Return artwork; or a photo if colours drift without edges, which small pictures cannot show. plain: they may in
    gradients and fills, since neighbours differ as in drawings.
    """
    if max(drawn.shape) <= SMALL:
        return Style(ARTWORK, reason)
    from cubicsplat_cli.artwork.input.softness import softness

    areas = softness(levels, drawn)
    if not areas.drifts:
        return Style(ARTWORK, reason)
    reason = f"{reason}, but colours drift across {100 * areas.soft:.0f} % of it"
    # A window with a soft shadow is mostly even, and a logo may consist of gradients, in a JPEG with artefacts on them.
    even = 2.0 * areas.soft < areas.ground + areas.even
    explained = _in_possible_fills(levels, drawn) if lossy else _shaded(levels, drawn)
    if plain and explained >= LEAST_SHADED:
        return Style(ARTWORK, f"{reason} in gradients")
    return Style(PHOTO, reason, doubtful=even or explained >= LEAST_DOUBTFUL)


def _scanned(target: np.ndarray) -> bool:
    """True if a picture, sampled evenly, is a scan."""
    from cubicsplat_cli.artwork.input.paper import scan_of
    from cubicsplat_cli.artwork.input.prepare import as_levels

    step = math.ceil(math.sqrt(target.shape[0] * target.shape[1] / _MOST_PIXELS))
    return scan_of(as_levels(target[::step, ::step])) is not None


def _sampled(target: np.ndarray) -> np.ndarray:
    """Return a picture of at most about _MOST_PIXELS, else evenly spread bands of its rows."""
    height, width = target.shape[:2]
    if height * width <= _MOST_PIXELS:
        return target
    bands = max(1, _MOST_PIXELS // (ROWS * width))
    starts = np.linspace(0, max(0, height - ROWS), bands).astype(int)
    return np.concatenate([target[start : start + ROWS] for start in starts])


def _straight(levels: np.ndarray) -> np.ndarray:
    """Return (H, W) bool, true for pixels around which colours change linearly, along rows and columns."""
    around = np.pad(levels, ((1, 1), (1, 1), (0, 0)), mode="reflect", reflect_type="odd")
    across = largest(np.abs(around[1:-1, :-2] - 2.0 * levels + around[1:-1, 2:]))
    down = largest(np.abs(around[:-2, 1:-1] - 2.0 * levels + around[2:, 1:-1]))
    return np.maximum(across, down) <= FLAT_RANGE


def _texture(rough: np.ndarray, drawn: np.ndarray) -> float:
    """Return the share of drawn pixels in blocks of rough ones, (H, W) bool each, of 7 px a side, or less if small."""
    longer = max(rough.shape)
    block = min(7 if longer >= 256 else 5 if longer >= 64 else 3, *(side - 1 + side % 2 for side in rough.shape))
    return float((ndimage.binary_opening(rough, np.ones((block, block), dtype=bool)) & drawn).sum() / drawn.sum())


def _shaded(levels: np.ndarray, drawn: np.ndarray) -> float:
    """Return the share of the drawn pixels that are flat in one of the commonest colours, or in gradients."""
    from cubicsplat_cli.artwork.input.softness import in_gradients

    levels, drawn = _thinned(levels, drawn)
    explained = _in_few_colours(levels, drawn, FLAT_RANGE, 1) | in_gradients(levels, tries=16, layered=True)
    return float((explained & drawn).sum() / drawn.sum())


def _thinned(levels: np.ndarray, drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return every so many rows and columns of a picture: about 600 px of its longer side."""
    step = 1 + max(levels.shape[:2]) // 600
    return levels[::step, ::step], drawn[::step, ::step]


def _in_possible_fills(levels: np.ndarray, drawn: np.ndarray) -> float:
    """Return the share of the drawn pixels in common colours that change less than people, or a JPEG, would tell."""
    return float((_in_few_colours(levels, drawn, UNSEEN) & drawn).sum() / drawn.sum())


def _in_possible_paints(levels: np.ndarray, drawn: np.ndarray) -> float:
    """Return the share of the drawn pixels in possible fills, or in gradients under the artefacts of a JPEG."""
    from cubicsplat_cli.artwork.gradients.noisy import plane_areas
    from cubicsplat_cli.artwork.gradients.shade import covered

    levels, drawn = _thinned(levels, drawn)
    gradients = covered(plane_areas(with_channels(levels, 4, 255.0), TYPICAL), drawn.shape)
    return float(((_in_few_colours(levels, drawn, UNSEEN) | gradients) & drawn).sum() / drawn.sum())


def _in_very_few(levels: np.ndarray, drawn: np.ndarray) -> bool:
    """Return True if most of the drawn pixels are in very few colours, but for the ringing of a JPEG."""
    starts = (0, RINGING // 2)  # a colour may lie where two of a row of them meet
    few = (_in_few_colours(levels + start, drawn, 255.0, RINGING, FEW_COLOURS) for start in starts)
    return max((within & drawn).sum() for within in few) >= LEAST_IN_FEW * drawn.sum()


def _in_few_colours(
    levels: np.ndarray, drawn: np.ndarray, flat: float, width: int = COLOUR, most: int = MOST_PALETTE
) -> np.ndarray:
    """Return (H, W) bool: pixels in the `most` commonest colours, `width` levels wide, within `flat` of neighbours."""
    code = packed(levels // width)
    colours, counts = np.unique(code[drawn], return_counts=True)
    commonest = colours[np.argsort(-counts, kind="stable")[:most]]
    return np.isin(code, commonest) & (spread(levels, 3, 3) <= flat)


def only_fill(picture: Picture) -> Rgba | None:
    """Return the only colour of a picture, (0, 0, 0, 0) if all pixels are clear; None if it has several. Nearly equal
    colours count as their mean; opacities must be equal.
    """
    if picture.alpha is not None and _mean(picture.alpha[..., None], 0.0) is None:
        return None
    # A JPEG of one colour with a trace of noise varies by two steps of 8 bits, which nobody sees.
    colour = _mean(picture.rgb, 2.0 / 255.0 + 1e-6)
    if colour is None:
        return None
    red, green, blue = (round(255 * value) for value in colour)
    return red, green, blue, 255 if picture.alpha is None else round(255 * float(picture.alpha[0, 0]))


def _mean(plane: np.ndarray, spread: float) -> list[float] | None:
    """Return the mean of each channel of (H, W, C); None if a channel's values lie further apart than `spread`."""
    least = most = plane[0, 0]
    total = np.zeros(plane.shape[2])
    # The first rows of most pictures suffice.
    for top in range(0, plane.shape[0], ROWS):
        part = plane[top : top + ROWS]
        least, most = np.minimum(least, part.min((0, 1))), np.maximum(most, part.max((0, 1)))
        if (most - least > spread).any():
            return None
        total += part.sum((0, 1), dtype=np.float64)
    return [float(value) for value in total / (plane.shape[0] * plane.shape[1])]


def plain_drawing(fill: Rgba, width: int, height: int) -> Drawing:
    """Return a rectangle of one fill over the whole canvas; an empty drawing if the fill is transparent."""
    return Drawing(width, height, (ground_shape(fill, width, height),) if fill[3] else ())
