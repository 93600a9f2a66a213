"""Restore a picture with noise or compression artefacts: even fills, and blends of two where these meet.

Every pixel is one fill, or a blend of it with another one nearby that has less than half of the pixel. Pixels between
the solid parts of fills are labelled together, since neighbours mostly have the same fill. Edges keep their shares.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of, commonest, largest
from cubicsplat_cli.artwork.input.chroma import LUMA_CHROMA, RGB, explained, mixture_of, smeared, with_sharp_chroma
from cubicsplat_cli.artwork.input.condition import MISFIT, OUTLIER, Condition
from cubicsplat_cli.artwork.input.palette import FAR, even_fills, missing_colours, noisy_fills, reach_of, square_fills
from cubicsplat_cli.artwork.regions.fills import (
    APART,
    FLAT_RANGE,
    LONG,
    MOST_SMALL,
    SAME,
    TOGETHER,
    commoner_fills,
    picture_fills,
)
from cubicsplat_cli.artwork.regions.hairlines import MOST_SEEN, NONE, missing_fills, solid_labels, with_lines
from cubicsplat_cli.artwork.regions.hidden_fills import hidden_fills, overshoots
from cubicsplat_cli.artwork.regions.regions import FlatPicture
from cubicsplat_cli.artwork.shapes import PRICE, SHAPE_PARAMETERS
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import (
    REACH,
    best_blend,
    blend_with,
    components,
    near_fills,
    nearest_fills,
    relabelled,
    spread,
    with_joined_parts,
)
from cubicsplat_cli.record import record

JPEG_TIMES = 4.0  # times the noise by which pixels near a JPEG's edges are off
NO_BLEND = 6.0  # times the misfit by which other colours are off; errors of rounding are bounded, so less tells there
NOWHERE = 3.0  # nats for a fill that is nowhere solid nearby
NEIGHBOUR = 0.7  # nats for each neighbour of another fill: odds of 2 to 1
ONE_COLOUR = 16.0  # levels within which the pixels of a small part or a thin line are of one colour
THIN = 0.25  # least share of a thin line in the pixels on its middle
SHARP_MISFIT = 2.0  # levels by which a picture is off its fills when it is made sharp again
INSIDE, FEWEST_INSIDE = 3, 16  # px from edges where a JPEG's pixels are pure, and the fewest there that show a fill
BLUR_REACH = 3.0  # standard deviations beyond which a blur changes nothing


def seen_as(condition: Condition, *, sharp: bool = False) -> np.ndarray:
    """Return the matrix (4, 4) that takes rows of RGBA to coordinates in which distances tell colours apart.

    sharp: True if chroma is as sharp as luma. A JPEG's chroma counts less: by its quantisation steps, 1.5 times those
    of luma in the standard's tables, or more if it is of half the size.
    """
    if not condition.jpeg:
        return np.eye(4)
    chroma = 0.7 if sharp or not condition.halved else 0.4
    return LUMA_CHROMA * np.array([1.0, chroma, chroma, 1.0])


def misfit_of(condition: Condition) -> float:
    """Return the levels by which the pixels of a picture in a condition are off their fills and blends."""
    return condition.noise * (JPEG_TIMES if condition.jpeg else 1.0) + MISFIT


def without_fragments(picture: FlatPicture, levels: np.ndarray, condition: Condition) -> FlatPicture:
    """Return a restored picture of levels (H, W, 4) with each small part of a fill in that of a neighbour, where both
    together are described by less: the price of a shape and its borders weighs more than what its pixels then are off.

    A blurred picture stays, since its edges are wider than blends of neighbours.
    """
    labels, palette = picture.labels, picture.palette
    if labels is None or palette is None or condition.blur:
        return picture
    space, sigma = seen_as(condition, sharp=True), misfit_of(condition)
    seen, fills = (levels @ space).astype(np.float32), palette @ space
    # Parts of 64 px at most may be a neighbour's. Each costs as much as a shape besides its outline, which both have.
    # Their fills are 64 levels apart at most, a quarter of the scale: so far a JPEG's ringing goes.
    costs = SHAPE_PARAMETERS * PRICE, NEIGHBOUR, sigma**2, OUTLIER**2, 64.0
    joined = with_joined_parts(labels, seen, fills, 64, costs)
    changed = ndimage.binary_dilation(joined != labels, ndimage.SQUARE)
    painted = mixture_of(seen, fills, joined, sigma, 0.0).painted(palette)
    return FlatPicture(np.where(changed[..., None], painted, picture.levels), palette, joined)


def explained_by_blur(levels: np.ndarray, condition: Condition) -> bool:
    """Return True if a blur explains a picture (H, W, 4) in levels: restored and blurred again, it has less than twice
    the error that it has restored without a blur. Enlarging blurs by no Gaussian, so the ratio is up to 1.3 in pictures
    that were enlarged by 1.5; it is 2.3 to 33 in clean ones.
    """
    sharp = restored(levels, condition, lines=False).levels
    plain = restored(levels, replace(condition, blur=0.0), lines=False).levels
    return bool(((levels - _blurred(sharp, condition.blur)) ** 2).sum() < 4.0 * ((levels - plain) ** 2).sum())


def _blurred(levels: np.ndarray, blur: float) -> np.ndarray:
    return ndimage.gaussian_filter(levels, (blur, blur, 0.0), mode="nearest", truncate=BLUR_REACH)


def restored(
    levels: np.ndarray, condition: Condition, placeholders: np.ndarray = NONE, *, lines: bool = True
) -> FlatPicture:
    """Return a picture (H, W, 4) in levels as if it were clean. placeholders: (G, 4) fills that stand for gradients and
    stay as they are. lines: True to find thin lines that its labels lack.
    """
    if condition.only_blurred:
        return FlatPicture(_sharpened(levels, condition.blur))
    if condition.rounded:
        palette = even_fills(levels)
    else:
        palette = noisy_fills(levels, (levels @ seen_as(condition)).astype(np.float32), condition)
    if not len(palette):
        palette = np.median(levels.reshape(-1, 4), axis=0).astype(float)[None]
    stored = levels
    if condition.jpeg and condition.halved:
        sharp = with_sharp_chroma((levels @ LUMA_CHROMA).astype(np.float32), condition.halved)
        levels = np.clip(sharp @ RGB, 0.0, 255.0).astype(np.float32)
    space = seen_as(condition, sharp=True)
    seen = (levels @ space).astype(np.float32)
    sigma = misfit_of(condition)
    if not condition.rounded:
        nearest, _ = nearest_fills(seen, palette @ space, straight=True)
        palette = np.vstack([palette, missing_colours(levels, palette, nearest, condition)])
    thick, squares = len(palette), NONE
    if thick <= MOST_SEEN:
        # What a JPEG's chroma smears beside edges is no fill.
        reach = reach_of(condition)
        apart = reach * (FAR if condition.jpeg else 1.0)
        squares = square_fills(levels, seen, palette @ space, sigma, reach, apart)
        if not condition.jpeg:
            palette = np.vstack([palette, squares])
            thin = _line_fills(seen, palette, sigma, (OUTLIER if condition.rounded else NO_BLEND) * sigma)
            palette = np.vstack([palette, np.clip(thin, 0.0, 255.0)])
    if condition.jpeg:
        palette, labels = _with_small_parts(stored, seen, palette, sigma, squares, condition)
        near = np.where(_shows_inside(labels, len(palette)), np.inf, ONE_COLOUR)
        palette = rounded_as_jpegs(_median_fills(levels, palette, labels, near))
    else:
        labels = labelled(seen, palette, sigma, thick)
        if condition.rounded:
            for k in np.unique(labels):
                (palette[k],) = commonest(levels[labels == k], 1, 1)
        else:
            palette = _median_fills(levels, palette, labels)
    for fill in placeholders:
        off = np.abs(palette - fill).max(axis=1)
        if off.min() < 0.5 * APART:
            palette[off.argmin()] = fill
    if lines:
        labels = with_lines(seen, palette @ space, labels, OUTLIER * sigma, THIN, placeholders @ space)
    mixture = mixture_of(seen, palette @ space, labels, sigma, condition.blur)
    return FlatPicture(mixture.painted(palette), palette, labels)


def _line_fills(seen: np.ndarray, fills: np.ndarray, sigma: float, least: float) -> np.ndarray:
    """Return (k, 4) the fills of thin lines: common colours of a picture (H, W, 4) of a misfit sigma that are off all
    blends of two of its fills (P, 4) by more than `least` levels.
    """
    _, gap = nearest_fills(seen, fills, straight=True)
    return hidden_fills(seen[gap > OUTLIER * sigma], fills, least, ONE_COLOUR, LONG)


def _nearby_line_fills(seen: np.ndarray, fills: np.ndarray, pure: np.ndarray, sigma: float) -> np.ndarray:
    """Return (k, 4) the fills of thin lines, though they may be blends of two fills (P, 4): common colours of a picture
    (H, W, 4) that are off all blends of fills nearby by more than six times the misfit sigma. pure: (H, W) int32, the
    fill of each pixel that is near one, -1 of others.
    """
    y, x = np.nonzero(pure < 0)
    near = near_fills(solid_labels(pure), y, x, REACH)
    odd = (best_blend(seen[y, x], fills, near)[1] > NO_BLEND * sigma) & (near[:, 0] >= 0)
    y, x = y[odd], x[odd]
    return missing_fills(seen, (y, x), fills[near[odd, 0]], ONE_COLOUR, NO_BLEND * sigma)


def _with_small_parts(
    levels: np.ndarray, seen: np.ndarray, palette: np.ndarray, sigma: float, proposed: np.ndarray, condition: Condition
) -> tuple[np.ndarray, np.ndarray]:
    """Return the palette of a JPEG (H, W, 4) in levels, with the fills of small parts fitted to all of their pixels and
    missing fills added; and the labels.

    Fills, those proposed (k, 4), those of thin lines, and those of what remains unexplained, are added only if they
    explain the picture better, by more than the cost of further borders between labels. Fills that ringing and chroma
    may have made of others are removed if the picture is as well explained without them.
    """
    space, colours = seen_as(condition, sharp=True), (levels @ LUMA_CHROMA).astype(np.float32)
    thick = len(palette)
    nearest, gap = nearest_fills(seen, palette @ space, straight=True)
    odd = gap > OUTLIER * sigma
    if len(palette) <= MOST_SEEN:
        lines = _nearby_line_fills(seen, palette @ space, np.where(odd, -1, nearest).astype(np.int32), sigma)
        proposed = np.vstack([proposed, np.clip(lines @ np.linalg.inv(space), 0.0, 255.0)])

    def fitted(palette: np.ndarray, thick: int) -> _Labelling:
        labels = labelled(seen, palette @ space, sigma, thick, bounded=True)
        lined = with_lines(seen, palette @ space, labels, OUTLIER * sigma, THIN)
        mixture = mixture_of(seen, palette @ space, lined, sigma, condition.blur, sharp=False)
        free = ~_shows_inside(labels, len(palette))
        fills, cost, missing = explained(colours, mixture, palette @ LUMA_CHROMA, free, odd, sigma, condition.halved)
        fills, missing = fills @ RGB, missing @ RGB
        return _Labelling(np.clip(fills, 0.0, 255.0), labels, cost + NEIGHBOUR * _borders(lined), missing)

    best = fitted(palette, thick)
    for fill in proposed:
        if len(best.palette) <= MOST_SEEN and _is_apart(fill, best.palette):
            # First as the fill of thin lines, which edges may look like; then as that of a small part.
            for place, solid in ((len(best.palette), thick), (thick, thick + 1)):
                trial = fitted(np.insert(best.palette, place, fill, axis=0), solid)
                shown = solid == thick or (ndimage.alike(trial.labels, 3) & (trial.labels == place)).sum() >= TOGETHER
                # Smeared chroma makes a colour of its own of a fill, which the fitted one is again.
                others = np.delete(trial.palette, place, axis=0)
                if shown and trial.cost < best.cost and _is_apart(trial.palette[place], others):
                    best, thick = trial, solid
                    break
    for _ in range(4):  # rounds
        # At least 8 pixels of half the size show a fill, within 20 levels.
        new = hidden_fills(np.clip(best.missing, 0.0, 255.0), best.palette, APART, 20.0, 8)
        if not len(new) or len(best.palette) > MOST_SEEN:
            break
        trial = fitted(np.vstack([best.palette, new]), thick)
        if trial.cost >= best.cost:
            break
        best = trial
    for fill in _fills_of_parts(levels, best.palette, best.labels):
        if len(best.palette) <= MOST_SEEN and _is_apart(fill, best.palette, ONE_COLOUR):
            trial = fitted(np.insert(best.palette, thick, fill, axis=0), thick + 1)
            if trial.cost < best.cost and _shows_inside(trial.labels, len(trial.palette))[thick]:
                best, thick = trial, thick + 1
    for fill in np.flatnonzero(~_shows_inside(best.labels, len(best.palette)))[::-1]:
        others = np.delete(best.palette, fill, axis=0)
        if overshoots(best.palette[fill], others) or smeared(best.palette[fill], others):
            fewer = thick - (fill < thick)
            trial = fitted(others, fewer)
            if trial.cost <= best.cost:
                best, thick = trial, fewer
    return best.palette, best.labels


def _fills_of_parts(levels: np.ndarray, palette: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return (k, 4) the colours, far from the palette (P, 4), that connected parts of one label have away from edges in
    a picture (H, W, 4): where it lacks a fill, others stand for that and explain each pixel, but not all together.
    """
    parts, count = components(labels)
    inner = ndimage.alike(labels, 3)
    sizes = np.bincount(parts[inner], minlength=count)
    boxes, large = ndimage.find_objects(parts + 1), np.flatnonzero(sizes >= FEWEST_INSIDE)
    own = (levels[boxes[part]][inner[boxes[part]] & (parts[boxes[part]] == part)] for part in large)
    colours = np.array([np.median(values, axis=0) for values in own]).reshape(-1, 4)
    far = nearest_fills(colours, palette)[1] > ONE_COLOUR
    return commoner_fills(colours[far], sizes[large][far].astype(float), ONE_COLOUR, MOST_SMALL)[0]


def _is_apart(fill: np.ndarray, palette: np.ndarray, levels: float = APART) -> bool:
    """Return True if a fill (4,) is surely none of a palette (P, 4): farther than so many levels from each."""
    return bool(largest(np.abs(palette - fill)).min() > levels)


@record
class _Labelling:
    """Palette (P, 4) in levels and labels (H, W) that explain a JPEG; cost: nats; missing: (k, 4) colours they lack."""

    palette: np.ndarray
    labels: np.ndarray
    cost: float
    missing: np.ndarray


def rounded_as_jpegs(palette: np.ndarray) -> np.ndarray:
    """Return the palette (P, 4) of a JPEG in levels with likely colours in place of those that round to them.

    Channels within 3 levels of 0 or 255 become that, since luma and chroma of quality 70 are rounded by as much: of
    1,400 channels of artists' colours 106 are 0 or 255, and 14 that near. Colours with the same luma and chroma as one
    that is written in three digits, such as #269, become that; by chance one in a thousand does.
    """
    digit = 255.0 / 15.0
    short = np.rint(palette / digit) * digit
    same = (np.rint(short @ LUMA_CHROMA) == np.rint(palette @ LUMA_CHROMA)).all(axis=1, keepdims=True)
    return np.where(palette <= 3.0, 0.0, np.where(palette >= 252.0, 255.0, np.where(same, short, palette)))


def _borders(labels: np.ndarray) -> float:
    """Return the number of pairs of neighbours in a map (H, W) that differ. Pairs across corners count 1 / sqrt(2), so
    that borders count alike in all directions (Boykov and Kolmogorov 2003, "Computing geodesics via graph cuts").
    """
    straight = sum(np.count_nonzero(np.diff(labels, axis=axis)) for axis in (0, 1))
    across = (labels[1:, 1:], labels[:-1, :-1]), (labels[1:, :-1], labels[:-1, 1:])
    return straight + math.sqrt(0.5) * sum(np.count_nonzero(one != other) for one, other in across)


def _shows_inside(labels: np.ndarray, count: int) -> np.ndarray:
    """Return (count,) bool: True for fills that enough pixels show away from edges."""
    return np.bincount(labels[depth_in(labels) >= INSIDE], minlength=count) >= FEWEST_INSIDE


def depth_in(labels: np.ndarray) -> np.ndarray:
    """Return (H, W) px: the distance from the edges between labels (H, W)."""
    return ndimage.distance_transform_cdt(ndimage.alike(labels, 3))


def _sharpened(levels: np.ndarray, blur: float) -> np.ndarray:
    """Return a picture (H, W, 4) in levels, which is only blurred, as before the blur.

    Each round adds what the estimate, blurred again, lacks, and makes pixels fills and blends of two again (van
    Cittert's iteration, between projections onto what drawings are).
    """
    palette = _fills_beneath(levels, blur)
    thick = len(palette)
    labels = labelled(levels, palette, MISFIT, thick)
    out = mixture_of(levels, palette, labels, MISFIT, blur).painted(palette)
    for number in range(4):
        sharp = np.clip(out + levels - _blurred(out, blur), 0.0, 255.0)
        if number == 0 and thick <= MOST_SEEN:
            new = _line_fills(sharp, palette, SHARP_MISFIT, NO_BLEND * SHARP_MISFIT)
            palette = np.vstack([palette, *(fill[None] for fill in new if not overshoots(fill, palette))])
        labels = labelled(sharp, palette, SHARP_MISFIT, thick)
        out = mixture_of(sharp, palette, labels, MISFIT, 0.0).painted(palette)
    return out


def _fills_beneath(levels: np.ndarray, blur: float) -> np.ndarray:
    """Return (P, 4) the fills of a blurred picture (H, W, 4) in levels, without those that the blur makes of two others
    in the middle of what is narrow: blends that no square is even of, which is as wide as the blur to all sides.
    """
    palette, width = picture_fills(levels), 2 * math.ceil(blur) + 1
    nearest, gap = nearest_fills(levels[spread(levels, width, width) <= FLAT_RANGE], palette)
    wide = np.isin(np.arange(len(palette)), nearest[gap <= SAME])
    for k in np.flatnonzero(~wide)[::-1]:
        others = np.delete(palette, k, axis=0)
        first, second = np.triu_indices(len(others), 1)
        share, off = blend_of(palette[k], others[first], others[second], most=None)
        if ((share > 0.0) & (share < 1.0) & (np.linalg.norm(off, axis=-1) <= SAME)).any():
            palette = others
    return palette


def labelled(seen: np.ndarray, fills: np.ndarray, sigma: float, thick: int, *, bounded: bool = False) -> np.ndarray:
    """Return (H, W) int32: the fill (P, 4) that each pixel of a picture (H, W, 4) has most of. Fills from `thick` on
    have only thin lines. bounded: True if pixels are off by rounding, as in a JPEG, and not by chance.
    """
    nearest, gap = nearest_fills(seen, fills, straight=True)
    pure = np.where(gap <= OUTLIER * sigma, nearest, -1).astype(np.int32)
    solid = np.where(pure >= thick, pure, solid_labels(pure))
    y, x = np.nonzero(solid < 0)
    labels = nearest.astype(np.int32)
    if not len(y):
        return labels
    candidates = near_fills(solid, y, x, REACH)
    strange_fills = [nearest[y, x]]
    if bounded:
        strange_fills.append(_blended(seen[y, x], fills, candidates, thick, OUTLIER * sigma))
    for strange in strange_fills:
        listed = (candidates == strange[:, None]).any(axis=1)
        candidates = np.column_stack([candidates, np.where(listed, -1, strange)])
    # Without errors by chance, a pixel blends only with what is right beside it.
    costs = 2.0 * sigma**2, 0.5 * OUTLIER**2, NEIGHBOUR, NOWHERE
    return relabelled(labels, seen, fills, (y, x), candidates, costs, bounded=bounded)


def _blended(values: np.ndarray, fills: np.ndarray, near: np.ndarray, thick: int, off: float) -> np.ndarray:
    """Return (n,): which of the first `thick` fills explains values (n, 4) best as a blend with the nearest of the
    fills near them (n, slots), since a thin line may show its fill nowhere; -1 if those near explain the value to `off`
    levels.
    """
    out, best = np.full(len(values), -1), best_blend(values, fills, near)[1]
    odd = np.flatnonzero((best > off) & (near[:, 0] >= 0))
    first = fills[near[odd, 0]]
    for fill, colour in enumerate(fills[:thick]):
        _, gap = blend_with(values[odd], colour, first, first)
        better = gap < best[odd]
        best[odd[better]], out[odd[better]] = gap[better], fill
    return out


def _median_fills(
    levels: np.ndarray, palette: np.ndarray, labels: np.ndarray, near: np.ndarray | float = np.inf
) -> np.ndarray:
    """Return the palette (P, 4) with the median of the pixels of each fill that are farthest from edges, of those that
    are off it by less than `near` (P,) levels; rounded to whole levels.
    """
    depth, off = depth_in(labels), largest(np.abs(levels - palette[labels]))
    close = off < np.broadcast_to(near, len(palette))[labels]
    out = palette.copy()
    for k, box in enumerate(ndimage.find_objects(labels + 1, len(palette))):
        if box is None:
            continue
        own = (labels[box] == k) & close[box]
        if not own.any():
            continue
        deep = depth[box][own]
        far = deep >= max(1, min(8, np.quantile(deep, 0.75)))
        if deep.max() > 1:
            out[k] = np.median(levels[box][own][far], axis=0)
    return np.rint(out)
