"""A picture with noise as it was before: fills that are even again, and blends of two where these meet.

Every pixel is one fill, or a blend of it with another one near it of which it has less than half. Which, is decided for
all pixels between the solid parts of fills together, since neighbours mostly have the same fill. Edges keep their
shares.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of, summed
from cubicsplat_cli.artwork.input.chroma import (
    LUMA_CHROMA,
    RGB,
    explained,
    missing_fills,
    mixture_of,
    smeared,
    with_sharp_chroma,
)
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.palette import FAR, missing_colours, noisy_fills, reach_of, square_fills
from cubicsplat_cli.artwork.regions.fills import APART, picture_fills
from cubicsplat_cli.artwork.regions.hairlines import NONE, solid_labels, with_lines
from cubicsplat_cli.artwork.regions.hidden_fills import hidden_fills, overshoots
from cubicsplat_cli.artwork.regions.regions import FlatPicture
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import REACH, SLOTS, best_blend, blend_with, near_fills, nearest_fills
from cubicsplat_cli.record import record

# Levels by which pixels are off the model beyond their noise, and how many times the noise that is near the edges of a
# JPEG; residuals count up to MOST standard deviations.
MISFIT, JPEG_TIMES, MOST = 1.0, 4.0, 4.0
ROUNDED = 3.0  # levels that a channel of a fill is off at most, as luma and chroma are rounded in a JPEG of quality 70
SHORT = 17.0  # levels between the colours that are written in three digits
# Chroma of a JPEG, of half the size, tells that much less; and once it is sharp, by its steps, which are 1.5 times
# those of luma in the standard's tables.
CHROMA, SHARP_CHROMA = 0.4, 0.7
# Nats for each neighbour of another fill, and for a fill of which nothing solid is near.
NEIGHBOUR, STRANGE = 0.7, 3.0
ROUNDS = 6
MOST_THICK = 24  # fills, beyond which those of thin lines are not sought
# Times the misfit that the colour of a thin line is off all blends of two others; levels that are one colour, and px
# that show it.
STRANGE_FILL, ONE_COLOUR, FEWEST = 6.0, 16.0, 24
# Px from edges at which pixels have their fill alone, and how many show it; rounds in which fills of small parts are
# added.
DEEP, FEWEST_DEEP, PROPOSALS = 4, 16, 4
# Rounds in which a blurred picture is made sharp again, and levels by which it is off its fills then; standard
# deviations beyond which nothing is left of a blur.
SHARPER, SHARP_MISFIT, BLUR_REACH = 4, 2.0, 3.0
# Times the misfit that pixels are off which the labels do not explain; the least share of a thin line in its pixels.
OFF, THIN = 4.0, 0.25
# Times the error without a blur that the error with it may be, as enlarging blurs by no Gaussian: it is up to 1.3 times
# in pictures that were enlarged by 1.5, and 2.3 to 33 times in clean ones.
CLEARER = 2.0


def seen_as(condition: Condition, *, sharp: bool = False) -> np.ndarray:
    """(4, 4) what rows of RGBA are multiplied by for coordinates whose distances tell colours apart. sharp: whether
    chroma is as sharp as luma.
    """
    if not condition.jpeg:
        return np.eye(4)
    chroma = SHARP_CHROMA if sharp or not condition.halved else CHROMA
    return LUMA_CHROMA * np.array([1.0, chroma, chroma, 1.0])


def explained_by_blur(levels: np.ndarray, condition: Condition) -> bool:
    """True if a picture (H, W, 4) in levels, restored and blurred again, is about as near to how it came as it is
    restored as if nothing had blurred it, with blends of two fills one pixel wide; or nearer.
    """
    blur = (condition.blur, condition.blur, 0.0)
    sharp = restored(levels, condition, lines=False).levels
    again = ndimage.gaussian_filter(sharp, blur, mode="nearest", truncate=BLUR_REACH)
    plain = restored(levels, replace(condition, blur=0.0), lines=False).levels
    return bool(((levels - again) ** 2).sum() < CLEARER**2 * ((levels - plain) ** 2).sum())


def restored(
    levels: np.ndarray,
    condition: Condition,
    standing: np.ndarray = NONE,
    *,
    lines: bool = True,
) -> FlatPicture:
    """The picture (H, W, 4) in levels as a clean one. standing: (G, 4) fills that stand for gradients, which stay as
    they are. lines: whether thin lines that its colours lack are sought.
    """
    if condition.only_blurred:
        return FlatPicture(_sharpened(levels, condition.blur))
    palette = noisy_fills(levels, (levels @ seen_as(condition)).astype(np.float32), condition)
    came = levels
    if condition.jpeg and condition.halved:
        sharp = with_sharp_chroma((levels @ LUMA_CHROMA).astype(np.float32), condition.halved)
        levels = np.clip(sharp @ RGB, 0.0, 255.0).astype(np.float32)
    space = seen_as(condition, sharp=True)
    seen = (levels @ space).astype(np.float32)
    sigma = condition.noise * (JPEG_TIMES if condition.jpeg else 1.0) + MISFIT
    nearest, _ = nearest_fills(seen, palette @ space, straight=True)
    palette = np.vstack([palette, missing_colours(levels, palette, nearest, condition)])
    thick, squares = len(palette), np.zeros((0, 4))
    if thick <= MOST_THICK:
        _, gap = nearest_fills(seen, palette @ space, straight=True)
        far = gap > MOST * sigma
        reach = reach_of(condition)
        # What a JPEG's chroma smears beside edges is no fill.
        apart = reach * (FAR if condition.jpeg else 1.0)
        squares = square_fills(levels, seen, palette @ space, sigma, reach, apart)
        if not condition.jpeg:
            palette = np.vstack([palette, squares])
        hidden = hidden_fills(seen[far], palette @ space, STRANGE_FILL * sigma, ONE_COLOUR, FEWEST)
        palette = np.vstack([palette, np.clip(hidden @ np.linalg.inv(space), 0.0, 255.0)])
    labels = labelled(seen, palette @ space, sigma, thick, bounded=condition.jpeg)
    if condition.jpeg:
        palette, labels = _of_small_parts(came, seen, palette, labels, sigma, thick, squares, condition)
        near = np.where(_deep(labels, len(palette)), np.inf, ONE_COLOUR)
        palette = _settled_fills(levels, palette, labels, near)
        # Of 1,400 channels of artists' colours 106 are 0 or 255, and 14 within ROUNDED of that.
        palette = np.where(palette <= ROUNDED, 0.0, np.where(palette >= 255.0 - ROUNDED, 255.0, _short(palette)))
    else:
        palette = _settled_fills(levels, palette, labels, np.full(len(palette), np.inf))
    for fill in standing:
        off = np.abs(palette - fill).max(axis=1)
        if off.min() < 0.5 * APART:
            palette[off.argmin()] = fill
    if lines:
        labels = with_lines(seen, palette @ space, labels, OFF * sigma, THIN, standing @ space)
    out = mixture_of(seen, palette @ space, labels, sigma, condition.blur)
    return FlatPicture(out.painted(palette), palette, labels)


def _of_small_parts(
    levels: np.ndarray,
    seen: np.ndarray,
    palette: np.ndarray,
    labels: np.ndarray,
    sigma: float,
    thick: int,
    proposed: np.ndarray,
    condition: Condition,
) -> tuple[np.ndarray, np.ndarray]:
    """The palette of a JPEG (H, W, 4) in levels, of a condition, with the fills of its small parts as all of their
    pixels tell them, and with those that are missing; and the labels. Fills, of those proposed (k, 4) and of what is
    left, are added only if the picture is explained better, by more than further borders between labels cost; those
    that ringing and chroma make of others go if it is as well explained without them.
    """
    space, colours = seen_as(condition, sharp=True), (levels @ LUMA_CHROMA).astype(np.float32)

    def fitted(palette: np.ndarray, labels: np.ndarray) -> _Explained:
        lined = with_lines(seen, palette @ space, labels, OFF * sigma, THIN)
        mixture = mixture_of(seen, palette @ space, lined, sigma, 0.0)
        free = ~_deep(labels, len(palette))
        fills, cost, missing = explained(colours, mixture, palette @ LUMA_CHROMA, free, sigma, condition.halved)
        fills, missing = fills @ RGB, missing @ RGB
        return _Explained(np.clip(fills, 0.0, 255.0), labels, cost + NEIGHBOUR * _borders(lined), missing)

    def fitted_of(palette: np.ndarray, thick: int) -> _Explained:
        return fitted(palette, labelled(seen, palette @ space, sigma, thick, bounded=True))

    best = fitted(palette, labels)
    for fill in proposed:
        if len(best.palette) <= MOST_THICK:
            best = min(best, fitted_of(np.vstack([best.palette, fill]), thick), key=lambda each: each.cost)
    for _ in range(PROPOSALS):
        new = missing_fills(best.missing, best.palette)
        if not len(new) or len(best.palette) > MOST_THICK:
            break
        found = fitted_of(np.vstack([best.palette, new]), thick)
        if found.cost >= best.cost:
            break
        best = found
    for fill in np.flatnonzero(~_deep(best.labels, len(best.palette)))[::-1]:
        rest = np.delete(best.palette, fill, axis=0)
        if not (overshoots(best.palette[fill], rest) or smeared(best.palette[fill], rest)):
            continue
        fewer = thick - (fill < thick)
        without = fitted_of(rest, fewer)
        if without.cost <= best.cost:
            best, thick = without, fewer
    return best.palette, best.labels


@record
class _Explained:
    """A palette (P, 4) in levels and labels (H, W) that explain a JPEG at a cost in nats; missing: (k, 4) colours that
    pixels of which they leave much would have.
    """

    palette: np.ndarray
    labels: np.ndarray
    cost: float
    missing: np.ndarray


def _short(palette: np.ndarray) -> np.ndarray:
    """The palette (P, 4) of a JPEG in levels with colours that are written in three digits, as #269, in place of those
    that round to the same luma and chroma: by chance one in a thousand does.
    """
    short = np.rint(palette / SHORT) * SHORT
    same = np.rint(short @ LUMA_CHROMA) == np.rint(palette @ LUMA_CHROMA)
    return np.where(same.all(axis=1, keepdims=True), short, palette)


def _borders(labels: np.ndarray) -> int:
    """Count the neighbours in a map (H, W), also across corners, that differ."""
    ahead = (labels[1:], labels[:, 1:], labels[1:, 1:], labels[1:, :-1])
    behind = (labels[:-1], labels[:, :-1], labels[:-1, :-1], labels[:-1, 1:])
    return sum(int((one != other).sum()) for one, other in zip(ahead, behind, strict=True))


def _deep(labels: np.ndarray, count: int) -> np.ndarray:
    """(count,) bool: the fills of which enough pixels lie so far from edges that they show them."""
    return np.asarray(np.bincount(labels[_depth(labels) >= DEEP], minlength=count) >= FEWEST_DEEP)


def _depth(labels: np.ndarray) -> np.ndarray:
    """(H, W) px from the edges between labels (H, W)."""
    return ndimage.distance_transform_cdt(ndimage.alike(labels, 3))


def _sharpened(levels: np.ndarray, blur: float) -> np.ndarray:
    """A picture (H, W, 4) in levels that is only blurred as it was before.

    What the restored picture, blurred again, lacks is added to it, and pixels become fills and blends of two once more
    (van Cittert's iteration, between projections onto what drawings are).
    """
    palette = picture_fills(levels)
    thick = len(palette)
    labels = labelled(levels, palette, MISFIT, thick)
    out = mixture_of(levels, palette, labels, MISFIT, blur).painted(palette)
    for number in range(SHARPER):
        again = ndimage.gaussian_filter(out, (blur, blur, 0.0), mode="nearest", truncate=BLUR_REACH)
        sharp = np.clip(out + levels - again, 0.0, 255.0)
        if number == 0 and thick <= MOST_THICK:
            _, gap = nearest_fills(sharp, palette, straight=True)
            far = gap > MOST * SHARP_MISFIT
            new = hidden_fills(sharp[far], palette, STRANGE_FILL * SHARP_MISFIT, ONE_COLOUR, FEWEST)
            palette = np.vstack([palette, *(fill[None] for fill in new if not overshoots(fill, palette))])
        labels = labelled(sharp, palette, SHARP_MISFIT, thick)
        out = mixture_of(sharp, palette, labels, MISFIT, 0.0).painted(palette)
    return out


def labelled(seen: np.ndarray, fills: np.ndarray, sigma: float, thick: int, *, bounded: bool = False) -> np.ndarray:
    """(H, W) int32 the fill that each pixel has most of; of fills from `thick` on there are only thin lines. bounded:
    whether no pixel is off by chance, as none of a JPEG is: all that it is off is what rounding to steps makes.
    """
    nearest, gap = nearest_fills(seen, fills, straight=True)
    pure = np.where(gap <= MOST * sigma, nearest, -1).astype(np.int32)
    solid = np.where(pure >= thick, pure, solid_labels(pure))
    y, x = np.nonzero(solid < 0)
    labels = np.where(solid >= 0, solid, nearest).astype(np.int32)
    if not len(y):
        return labels
    candidates = near_fills(solid, y, x, REACH)
    strange_ones = [nearest[y, x]]
    if bounded:
        strange_ones.append(_blended(seen[y, x], fills, candidates, thick, MOST * sigma))
    for strange in strange_ones:
        known = (candidates == strange[:, None]).any(axis=1)
        candidates = np.column_stack([candidates, np.where(known, -1, strange)])
    cost = _costs(seen[y, x], fills, candidates) / (2.0 * sigma**2)
    alone, least = cost.diagonal(axis1=1, axis2=2)[:, :, None], np.minimum(cost.min(axis=2), 0.5 * MOST**2)
    prior = np.where(candidates < 0, np.inf, 0.0)
    prior[:, SLOTS:] += STRANGE
    for _ in range(ROUNDS):
        padded = np.pad(labels, 1, mode="edge")
        around = [padded[y + 1 + dy, x + 1 + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx]
        alike = np.sum([other[:, None] == candidates for other in around], axis=0)
        # A pixel blends with nothing but what is beside it, where that is told for certain.
        left = np.where(alike[:, None, :] > 0, cost, alone).min(axis=2) if bounded else least
        chosen = candidates[np.arange(len(y)), (left + prior - NEIGHBOUR * alike).argmin(axis=1)]
        if (chosen == labels[y, x]).all():
            break
        labels[y, x] = chosen
    return labels


def _blended(values: np.ndarray, fills: np.ndarray, near: np.ndarray, thick: int, off: float) -> np.ndarray:
    """(n,) which of the first `thick` fills explains values (n, 4) best as a blend with the nearest one of those near
    them (n, slots), -1 where these explain them to `off` levels: a thin line may show its fill nowhere.
    """
    out, best = np.full(len(values), -1), best_blend(values, fills, near)[1]
    odd = np.flatnonzero((best > off) & (near[:, 0] >= 0))
    first = fills[near[odd, 0]]
    for fill, colour in enumerate(fills[:thick]):
        _, gap = blend_with(values[odd], colour, first, first)
        better = gap < best[odd]
        best[odd[better]], out[odd[better]] = gap[better], fill
    return out


def _costs(values: np.ndarray, fills: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """(n, k, k) the squared residuals of values (n, 4) as blends of each candidate, by half or more, with each."""
    count = candidates.shape[1]
    out = np.full((len(values), count, count), np.inf)
    colours = fills[np.maximum(candidates, 0)]
    known = candidates >= 0
    for i in range(count):
        for j in range(count):
            _, rest = blend_of(values, colours[:, i], colours[:, j], most=0.5)
            out[:, i, j] = np.where(known[:, i] & known[:, j], summed(rest**2), np.inf)
    return out


def _settled_fills(levels: np.ndarray, palette: np.ndarray, labels: np.ndarray, near: np.ndarray) -> np.ndarray:
    """The palette by the median of the pixels of each fill that are off it by less than `near` (P,) levels, those
    farthest from edges.
    """
    depth = _depth(labels)
    out = palette.copy()
    for k, box in enumerate(ndimage.find_objects(labels + 1, len(palette))):
        if box is None:
            continue
        own = labels[box] == k
        if near[k] < np.inf:
            own &= np.abs(levels[box] - palette[k]).max(axis=-1) < near[k]
            if not own.any():
                continue
        deep = depth[box][own]
        far = deep >= max(1, min(8, np.quantile(deep, 0.75)))
        if deep.max() > 1:
            out[k] = np.median(levels[box][own][far], axis=0)
    return np.rint(out)
