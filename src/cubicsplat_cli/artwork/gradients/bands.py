"""Gradients that were restored as several fills: bands that meet without a step.

Ringing hides a gradient from windows where it is narrow, as in letters, and near its edges; restored pictures have
bands of it there. All pixels of the bands together, which ring either way, still tell it.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.gradients.flattening import Flattened
from cubicsplat_cli.artwork.gradients.noisy import is_step, roughness
from cubicsplat_cli.artwork.gradients.parts import LEAST_AREA, Part, Patch
from cubicsplat_cli.artwork.gradients.shade import Shade, ShadedArea
from cubicsplat_cli.artwork.gradients.shades import refitted, shade_of
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.palette import SAME
from cubicsplat_cli.artwork.input.restore import seen_as
from cubicsplat_cli.artwork.regions.regions import FlatPicture
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import Pixels
from cubicsplat_cli.raster.sparse import linked_groups

# Px on either side of a border across which two fills have a step, and places that show it; share of the step between
# the fills that the picture has at the most where they are bands, and of their squared error that a gradient leaves.
BESIDE, FEWEST, STEP = 3, 8, 0.5
RIM = 2  # px beside other fills, which blend with these


def banded_areas(levels: np.ndarray, even: FlatPicture, flat: Flattened, condition: Condition) -> list[ShadedArea]:
    """The gradients of a picture (H, W, 4), premultiplied levels, of which there are bands. even: it restored, with its
    palette and labels; flat: what it was restored from.
    """
    palette, labels = even.palette, even.labels
    assert palette is not None and labels is not None  # as what was restored has
    drawn, found = flat.painted(palette, labels), list[ShadedArea]()
    groups, group_of = linked_groups(len(palette), *_without_step(levels, drawn, labels, len(palette)))
    for group in np.flatnonzero(np.bincount(group_of, minlength=groups) > 1):
        own, _ = ndimage.label(ndimage.binary_erosion((group_of == group)[labels], ndimage.SQUARE, RIM, border_value=1))
        boxes = enumerate(ndimage.find_objects(own), start=1)
        patches = [Patch(rows.start, columns.start, own[rows, columns] == k) for k, (rows, columns) in boxes]
        bands = [_Bands(levels, drawn, patch, condition) for patch in patches]
        left = sorted(
            (each for each in bands if len(each.pixels.x) >= LEAST_AREA), key=lambda each: -len(each.pixels.x)
        )
        for seed in [left, *([each] for each in left)]:  # all together, then each that no gradient has yet
            if left and all(each in left for each in seed):
                shade, members = _shared(seed, left, roughness(condition))
                found += [ShadedArea(shade, each.patch) for each in members]
                left = [each for each in left if each not in members]
    return found


def _without_step(
    levels: np.ndarray, drawn: np.ndarray, labels: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of `count` fills, (e,) each, between which a picture (H, W, 4) has not the step that it is drawn with."""
    sums = np.zeros((3, count * count))
    for own, came, made in ((labels, levels, drawn), (labels.T, levels.swapaxes(0, 1), drawn.swapaxes(0, 1))):
        y, x = np.nonzero(own[BESIDE - 1 : -BESIDE] != own[BESIDE : 1 - BESIDE])
        across = np.stack([own[y + k, x] for k in range(2 * BESIDE)])
        whole = (across[:BESIDE] == across[0]).all(axis=0) & (across[BESIDE:] == across[-1]).all(axis=0)
        y, x, (first, *_, last) = y[whole], x[whole], across[:, whole]
        pair = np.minimum(first, last) * count + np.maximum(first, last)
        step, seen = (each[y + 2 * BESIDE - 1, x].astype(float) - each[y, x] for each in (made, came))
        for out, weight in zip(sums, ((step * seen).sum(axis=1), (step * step).sum(axis=1), None), strict=True):
            out += np.bincount(pair, weight, count * count)
    return np.divmod(np.flatnonzero((sums[2] >= FEWEST) & (sums[0] < STEP * sums[1])), count)


class _Bands:
    """Connected pixels of fills that may be bands of a gradient. patch: they, away from others."""

    def __init__(self, levels: np.ndarray, drawn: np.ndarray, patch: Patch, condition: Condition) -> None:
        part = Part(levels, patch)
        self.patch, self._space, rough = patch, seen_as(condition), roughness(condition)
        self.pixels = Pixels(part.pixels.x, part.pixels.y, part.pixels.values / rough)
        self.error = self._off(drawn[part.rows, part.columns] / rough)

    def _off(self, colours: np.ndarray) -> float:
        return float((((self.pixels.values - colours) @ self._space) ** 2).sum())

    def left(self, shade: Shade) -> float:
        """The squared error that a gradient leaves, as `error` is that of the bands."""
        return self._off(shade.extended().at(self.pixels.x, self.pixels.y))


def _shared(seed: list[_Bands], left: list[_Bands], rough: float) -> tuple[Shade, list[_Bands]]:
    """The gradient of a seed, at its best for all those left that it explains as well as their bands do, if it leaves
    much less of them together; else that of the seed alone; with none of them where that is none either.
    """
    first = shade_of(_joined(seed))
    members, shade = left, first
    while len(members) > len(seed):
        shade = refitted(first, _joined(members))
        better = [each for each in members if each.left(shade) <= each.error]
        if len(better) == len(members):
            break
        members = better
    for some, own in ((members, shade), (seed, first)):
        if some and sum(each.left(own) for each in some) <= STEP * sum(each.error for each in some):
            x, y, _ = _joined(some)
            if rough * np.ptp(own.at(x, y), axis=0).max() >= SAME and not is_step(own):
                return own.times(rough), some
    return first, []


def _joined(bands: list[_Bands]) -> Pixels:
    """The pixels of all."""
    return Pixels(*(np.concatenate(each) for each in zip(*(each.pixels for each in bands), strict=True)))
