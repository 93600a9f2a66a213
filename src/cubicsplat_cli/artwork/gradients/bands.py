"""Gradients that were restored as fills: one, or bands that meet without a step.

Ringing hides a gradient from windows where it is narrow, as in letters, and near its edges. Restored pictures have a
fill or bands of it there. All their pixels together still show the gradient, since ringing goes either way.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.gradients.areas import RIM
from cubicsplat_cli.artwork.gradients.flattening import Flattened
from cubicsplat_cli.artwork.gradients.noisy import TOLD, WINDOW, steepest
from cubicsplat_cli.artwork.gradients.parts import LEAST_AREA, OUTER, Patch, joined_pixels, patches_of
from cubicsplat_cli.artwork.gradients.shade import Shade, ShadedArea
from cubicsplat_cli.artwork.gradients.shades import refitted, shade_of
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.restore import seen_as
from cubicsplat_cli.artwork.regions.fills import CONTACT, SEEN
from cubicsplat_cli.artwork.regions.regions import FlatPicture
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import Pixels, misfits, trimmed_range
from cubicsplat_cli.raster.sparse import linked_groups

BESIDE = 3  # px on either side of a border that show a step
STEP = 0.5  # share of the step between fills that bands have at most, and of their squared error that a gradient leaves


def banded_areas(levels: np.ndarray, even: FlatPicture, flat: Flattened, condition: Condition) -> list[ShadedArea]:
    """Return the gradients of a picture (H, W, 4), premultiplied levels, that were restored as fills. even: the
    restored picture, with its palette and labels; flat: the picture from which it was restored."""
    palette, labels = even.palette, even.labels
    assert palette is not None and labels is not None  # as every restored picture has
    drawn, areas = flat.painted(palette[labels], palette, labels.__eq__), list[ShadedArea]()
    groups, group_of = linked_groups(len(palette), *_without_step(levels, drawn, labels, len(palette)))
    for group in range(groups):
        own = (group_of == group)[labels]
        parts, _ = ndimage.label(ndimage.binary_erosion(own, ndimage.SQUARE, RIM, border_value=1))
        patches = sorted(patches_of(parts), key=lambda patch: -patch.size)
        left = [_Bands(levels, drawn, patch, condition) for patch in patches if patch.size >= LEAST_AREA]
        # All together, then each that no gradient has yet.
        for seed in [left, *([bands] for bands in left if len(left) > 1)]:
            if left and all(bands in left for bands in seed):
                shade, members = _shared(seed, left, condition)
                areas += [ShadedArea(shade, bands.patch) for bands in members]
                left = [bands for bands in left if bands not in members]
    return areas


class _Bands:
    """Connected pixels of fills that may be bands of a gradient. patch: these pixels, away from other fills. error: the
    squared error that the bands leave; even: the least of that and of what one fill of their own leaves, since a
    palette may have one fill for two near ones."""

    def __init__(self, levels: np.ndarray, drawn: np.ndarray, patch: Patch, condition: Condition) -> None:
        self.patch, self.pixels = patch, patch.pixels(levels)
        values, space = self.pixels.values, seen_as(condition)
        ways = values - drawn[patch.places()], values - values.mean(axis=0)
        self.error, own = (float(((off @ space) ** 2).sum()) for off in ways)
        self.even = min(self.error, own)


def _shared(seed: list[_Bands], left: list[_Bands], condition: Condition) -> tuple[Shade, list[_Bands]]:
    """Return the gradient of a seed, refitted to all those left that it explains as well as their bands do, and these;
    the seed's own and the seed if it leaves too much of their error; none of them if the seed shows no gradient."""
    alone = _joined(seed)
    shade = first = shade_of(alone)
    if not _is_gradient(first, seed, alone, condition):
        return first, []
    members, pixels = left, _joined(left)
    while len(members) > len(seed):
        shade = refitted(first, pixels)
        errors = _errors(shade, members, pixels, condition)
        better = [bands for bands, error in zip(members, errors, strict=True) if error <= bands.error]
        if len(better) == len(members):
            break
        members, pixels = better, _joined(better)
    if members and members != seed and _is_gradient(shade, members, pixels, condition):
        return shade, members
    return first, seed


def _is_gradient(shade: Shade, some: list[_Bands], pixels: Pixels, condition: Condition) -> bool:
    """Return True if a shade describes bands, with the pixels of them all, in less than their fills do."""
    before, even = (sum(each) for each in zip(*((bands.error, bands.even) for bands in some), strict=True))
    after = max(float(_errors(shade, some, pixels, condition).sum()), 1e-9)
    # Half of chi^2 of three channels, by the errors that the gradient leaves.
    if after > STEP * before or 1.5 * TOLD * len(pixels.x) * (even / after - 1.0) <= shade.price:
        return False
    span = trimmed_range(shade.at(pixels.x, pixels.y), OUTER)
    length = WINDOW * float(np.linalg.norm(shade.frame[:, :2], 2))  # of t, along the shorter axis
    return span >= SEEN and steepest(shade.ramp, length) < 0.5 * span


def _errors(shade: Shade, bands: list[_Bands], pixels: Pixels, condition: Condition) -> np.ndarray:
    """Return the squared errors (n,) that a gradient leaves of bands. pixels: of all of them."""
    ends = np.cumsum([each.patch.size for each in bands])
    return misfits(shade.extended().given, pixels, ends, seen_as(condition))


def _joined(bands: list[_Bands]) -> Pixels:
    """Return the pixels of all bands; none without any."""
    return joined_pixels([each.pixels for each in bands])


def _without_step(
    levels: np.ndarray, drawn: np.ndarray, labels: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs of `count` fills, (e,) each, between which a picture (H, W, 4) lacks the step that it is drawn with.
    drawn: (H, W, 4) levels of the fills; labels: (H, W) the fill of each pixel."""
    sums = np.zeros((3, count * count))
    for fills, *pictures in ((labels, drawn, levels), (labels.T, drawn.swapaxes(0, 1), levels.swapaxes(0, 1))):
        y, x = np.nonzero(fills[BESIDE - 1 : -BESIDE] != fills[BESIDE : 1 - BESIDE])
        across = np.stack([fills[y + k, x] for k in range(2 * BESIDE)])
        whole = (across[:BESIDE] == across[0]).all(axis=0) & (across[BESIDE:] == across[-1]).all(axis=0)
        y, x, (first, *_, last) = y[whole], x[whole], across[:, whole]
        pair = np.minimum(first, last) * count + np.maximum(first, last)
        step, shown = (each[y + 2 * BESIDE - 1, x].astype(float) - each[y, x] for each in pictures)
        for out, weight in zip(sums, ((step * shown).sum(axis=1), (step * step).sum(axis=1), None), strict=True):
            out += np.bincount(pair, weight, count * count)
    return np.divmod(np.flatnonzero((sums[2] >= CONTACT) & (sums[0] < STEP * sums[1])), count)
