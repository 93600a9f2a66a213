"""Photographs within a page: the parts of a picture that the measure of photos calls such, where it calls the rest a
drawing.

The even areas of a page end at its photos, and text is thin. So what is left between them, where whole squares fit into
it, may be a photo.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import largest, packed, widened
from cubicsplat_cli.artwork.gradients.parts import Patch
from cubicsplat_cli.artwork.input.evenness import ALIKE, TILE
from cubicsplat_cli.artwork.style import ARTWORK, COLOUR, PHOTO, UNSEEN, choose_style
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import bends_and_steps
from cubicsplat_cli.raster.unmix import spread
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.arrays import with_channels

LEAST_SIDE = 4 * TILE  # px
FRAME = 8  # px of a frame around a photo, at most, and of an edge's blends
LEAST_LINE = 0.9  # of the pixels of a row, in one colour, that is one of a frame
# Levels by which the pixels of a drawing's areas are off one colour or gradient, root mean square: rounding, and twice
# what a JPEG leaves off the edges. A photo's grain is more.
GRAIN = 1.0
LEAST_FILLED = 0.9  # of a rectangle with all its corners, that a photo fills: what is missing is as even as the page
# Of a photo's px in one colour: at most .25 in photos, at least .5 in text that a JPEG's blocks surround.
MOST_IN_ONE = 0.35
# Levels of second difference that half of the pixels have at least, of what is no rectangle: 2 to 6 in 22 objects
# with soft shading, 6 to 37 in 20 photos.
GRAINY = 7.0
SOFT, FAINT = 2.0, 1e-6  # px over which a picture goes on beyond a mask; of its weight, below which that is its mean
OTHER = 64.0  # levels that a fill may be nearer to what surrounds it for being another one than that of a part
LEAST_REST = 0.002  # of the picture, in px away from the parts, at which something is drawn
Box = tuple[int, int, int, int]  # left, top, right, bottom, px


@record
class PhotoPart(Patch):
    """A photograph in a picture. stand_in: three levels of a fill that differs from all that is around it, under which
    it is drawn.
    """

    stand_in: np.ndarray

    @property
    def rectangular(self) -> bool:
        return bool(self.mask.all())


@record
class Page:
    """A drawing with photographs in it: picture (H, W, 3), float32 in [0, 1]; flat, the same with a fill in place of
    each of them. reason: what says that this is a drawing.
    """

    picture: np.ndarray
    flat: np.ndarray
    parts: tuple[PhotoPart, ...]
    reason: str


def page_of(target: np.ndarray) -> Page | None:
    """The drawing and the photographs of a picture (H, W, 3), float32 in [0, 1]; None where it does not consist of
    both.
    """
    levels = np.rint(255.0 * target).astype(np.float32)
    even = _even_areas(levels)
    parts = [part for part in _candidates(levels, even) if _is_photo(levels, part)]
    if not parts:
        return None
    flat = levels.copy()
    for part in parts:
        _stand_in_for(part, flat)
    flat = (flat / np.float32(255.0)).astype(np.float32)
    rest = choose_style(flat)
    if rest.name != ARTWORK or _drawn_share(flat * 255.0, parts) < LEAST_REST:
        return None
    return Page(target, flat, tuple(parts), rest.reason)


def _stand_in_for(part: PhotoPart, flat: np.ndarray) -> None:
    """Puts the fill of a part into levels (H, W, 3), at the edge of what is no rectangle blended with what surrounds
    it.
    """
    if part.rectangular:
        flat[part.window] = part.stand_in
        return
    whole = np.zeros(flat.shape[:2], dtype=bool)
    whole[part.window] = part.mask
    around = widened(part.window, 1, whole.shape)
    crop, mask = flat[around], whole[around]
    edge = mask & ndimage.binary_dilation(~mask, ndimage.SQUARE)
    outside, inside = (
        _continued(crop, known) for known in (~mask, mask & ~ndimage.binary_dilation(edge, ndimage.SQUARE))
    )
    # The share of the photo in a pixel that lies between both colours.
    apart = inside - outside
    share = ((crop - outside) * apart).sum(axis=2) / np.maximum(np.square(apart).sum(axis=2), ALIKE**2)
    covered = np.where(edge, np.clip(share, 0.0, 1.0), mask)[..., None]
    flat[around] = covered * part.stand_in + (1.0 - covered) * outside


def _continued(crop: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """A picture (h, w, 3) that goes on softly beyond a mask (h, w) bool, which is not empty."""
    inside = mask[..., None].astype(np.float32)
    weights, sums = (ndimage.gaussian_filter(each, (SOFT, SOFT, 0.0)) for each in (inside, crop * inside))
    mean = crop[mask].mean(axis=0)
    return np.where(inside > 0.0, crop, (sums + FAINT * mean) / (weights + FAINT)).astype(np.float32)


def _even_areas(levels: np.ndarray) -> np.ndarray:
    """(H, W) int32 the number of the connected area in one colour or one linear gradient, of a TILE's square at least,
    that a pixel is in; 0 elsewhere.
    """
    areas, count = ndimage.large_parts(spread(levels, 3, 3) <= ALIKE, TILE**2)
    off = _off_planes(levels, areas, count)
    kept = np.concatenate([[False], off <= GRAIN])
    return np.asarray((np.cumsum(kept) * kept)[areas], np.int32)


def _off_planes(levels: np.ndarray, areas: np.ndarray, count: int) -> np.ndarray:
    """(count,) levels by which the pixels of areas, numbered from 1 on, are off the nearest linear gradient, root mean
    square of the channel with most.
    """
    y, x = np.nonzero(areas)
    owner, sides = areas[y, x] - 1, np.array(areas.shape, float)
    terms = [np.ones(len(y)), x / sides[1] - 0.5, y / sides[0] - 0.5, *levels[y, x].T.astype(float)]
    sums = np.array([[np.bincount(owner, a * b, count) for b in terms] for a in terms[:3]]).transpose(2, 0, 1)
    # A very thin area has no slope across: the ridge is far below any other.
    normal, right = sums[..., :3] + 1e-6 * np.eye(3), sums[..., 3:]
    squares = np.stack([np.bincount(owner, a * a, count) for a in terms[3:]], axis=1)
    squares = squares - (right * np.linalg.solve(normal, right)).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(squares, 0.0).max(axis=1, initial=0.0) / np.maximum(sums[:, 0, 0], 1.0)))


def _candidates(levels: np.ndarray, even: np.ndarray) -> list[PhotoPart]:
    """What is not even and not thin: rectangles that end at their strongest steps, without what frames them, or other
    forms.
    """
    thick = _opened(even == 0)
    parts = list[PhotoPart]()
    labels, _ = ndimage.label(ndimage.binary_fill_holes(thick))
    for number, (rows, columns) in enumerate(ndimage.find_objects(labels), 1):
        if min(rows.stop - rows.start, columns.stop - columns.start) < LEAST_SIDE:
            continue
        whole = (columns.start, rows.start, columns.stop, rows.stop)
        own = labels == number
        box = _ended(levels, whole)
        mask = _mask_of(own, even, box)
        corners = mask[[0, 0, -1, -1], [0, -1, 0, -1]]
        if corners.all() and mask.mean() >= LEAST_FILLED:
            mask = np.ones_like(mask)
        else:
            box = whole
            mask = _mask_of(own, even, box)
        if min(mask.shape) >= LEAST_SIDE and mask.sum() >= LEAST_SIDE**2:
            parts.append(PhotoPart(box[1], box[0], mask, _stand_in(levels, box, mask, parts)))
    return parts


def _opened(mask: np.ndarray) -> np.ndarray:
    """(H, W) bool: what of a mask squares a little wider than a TILE fit into."""
    narrowed = ndimage.minimum_filter(mask.astype(np.float32), TILE + 1)
    return np.asarray(ndimage.maximum_filter(narrowed, TILE + 1) > 0.0)


def _ended(levels: np.ndarray, box: Box) -> Box:
    """A box (left, top, right, bottom) with its sides moved inwards to where the picture changes most along them, and
    beyond what frames it, each by at most 2 FRAME px.
    """
    left, top, right, bottom = box
    grown = np.pad(levels, ((1, 1), (1, 1), (0, 0)), constant_values=-np.inf)  # beyond the picture all is different
    part = grown[top : bottom + 2, left : right + 2]
    turned = part.swapaxes(0, 1)
    sides = (turned[:, 1:-1], part[:, 1:-1], turned[::-1, 1:-1], part[::-1, 1:-1])
    steps = [_strongest(side) for side in sides]
    steps = [step + _frame(side[1 + step :]) for step, side in zip(steps, sides, strict=True)]
    return left + steps[0], top + steps[1], right - steps[2], bottom - steps[3]


def _strongest(part: np.ndarray) -> int:
    """The number of rows, of those after the first one, at the top of a part before the outermost of the steps from one
    row to the next that are about as large as the largest.
    """
    rows = part[: min(2 * FRAME, len(part) // 3) + 1]
    sizes = np.median(largest(np.abs(np.diff(rows, axis=0))), axis=1)
    return int(np.argmax(sizes >= 0.5 * sizes.max()))


def _frame(part: np.ndarray) -> int:
    """The number of rows at the top of a part that frame it."""
    found = 0
    for row in range(min(FRAME, len(part) - 1)):
        line = part[row]
        off = largest(np.abs(line - np.median(line, axis=0)))
        if (off <= UNSEEN).mean() < LEAST_LINE:
            break
        if (largest(np.abs(part[row + 1] - line)) > ALIKE).mean() > 0.5:
            found = row + 1
    return found


def _mask_of(own: np.ndarray, even: np.ndarray, box: Box) -> np.ndarray:
    """(h, w) bool: what of a box belongs to a part (H, W) bool: all but even areas that reach into it from outside."""
    left, top, right, bottom = box
    inside = even[top:bottom, left:right]
    counts = np.bincount(even.ravel())
    outside = np.bincount(inside.ravel(), minlength=len(counts)) < counts
    outside[0] = False
    free = ~ndimage.binary_dilation(outside[inside], ndimage.SQUARE)
    labels, count = ndimage.label(_opened(free))
    sizes = np.bincount(labels.ravel(), own[top:bottom, left:right].ravel(), count + 1)
    sizes[0] = 0.0
    # Corners, which no square fits into, again.
    wide = ndimage.maximum_filter((labels == int(sizes.argmax())).astype(np.float32), TILE // 2 - 1) > 0.0
    return np.asarray(ndimage.binary_fill_holes(wide & free))


def _stand_in(levels: np.ndarray, box: Box, mask: np.ndarray, others: list[PhotoPart]) -> np.ndarray:
    """(3,) levels as far as may be from those around a mask in a box, and other than those of other parts: what covers
    two of one fill would make them one shape.
    """
    left, top, right, bottom = box
    around = np.ones(levels.shape[:2], dtype=bool)
    around[top:bottom, left:right] = ~mask
    window = widened((slice(top, bottom), slice(left, right)), FRAME, around.shape)
    near = levels[window][around[window]]
    corners = np.array(np.meshgrid(*[(0.0, 255.0)] * 3)).reshape(3, -1).T
    used = [(corners == other.stand_in).all(axis=1) for other in others]
    far = [largest(np.abs(near - corner)).min(initial=255.0) for corner in corners]
    return corners[int(np.argmax(far - OTHER * np.sum(used, axis=0)))]


def _is_photo(levels: np.ndarray, part: PhotoPart) -> bool:
    """Whether the measure of photos calls the part one, and does not doubt it; and it has no ground, and grain
    where it has not the form of photos.
    """
    crop = levels[part.window] / np.float32(255.0)
    values = levels[part.window][part.mask]
    code = packed(values // COLOUR)
    _, which, counts = np.unique(code, return_inverse=True, return_counts=True)
    commonest = values[which.reshape(-1) == int(counts.argmax())].mean(axis=0)
    if (largest(np.abs(values - commonest)) <= UNSEEN).mean() > MOST_IN_ONE:
        return False
    if not part.rectangular:
        bends, _ = bends_and_steps(with_channels(levels[part.window], 4, 255.0))
        if float(np.median(bends[part.mask])) < GRAINY:
            return False
        crop = with_channels(crop, 4) * part.mask[..., None]
    found = choose_style(crop)
    return found.name == PHOTO and not found.doubtful


def _drawn_share(flat: np.ndarray, parts: list[PhotoPart]) -> float:
    """The share of the pixels off the parts and what frames them that differ from a neighbour."""
    differ = spread(flat, 3, 3) > UNSEEN
    for part in parts:
        differ[widened(part.window, FRAME, differ.shape)] = False
    return float(differ.mean())
