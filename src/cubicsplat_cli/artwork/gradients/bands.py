"""Gradients that were restored as several fills: bands that meet without a step.

Ringing hides a gradient from windows where it is narrow, as in letters, and near its edges. Restored pictures have
bands of it there. All pixels of the bands together still show the gradient, since ringing goes either way.
"""

from __future__ import annotations

from itertools import groupby

import numpy as np

from cubicsplat_cli.artwork.gradients.areas import CONTACT
from cubicsplat_cli.artwork.gradients.flattening import Flattened
from cubicsplat_cli.artwork.gradients.noisy import rough_areas
from cubicsplat_cli.artwork.gradients.shade import ShadedArea
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.restore import seen_as
from cubicsplat_cli.artwork.regions.regions import FlatPicture
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.sparse import linked_groups

BESIDE = 3  # px on either side of a border that show a step
STEP = 0.5  # share of the step between fills that bands have at most, and of their squared error that a gradient leaves
RIM = 2  # px beside other fills, which blend with the bands


def banded_areas(levels: np.ndarray, even: FlatPicture, flat: Flattened, condition: Condition) -> list[ShadedArea]:
    """Return the gradients of a picture (H, W, 4), premultiplied levels, that have bands. even: the restored picture,
    with its palette and labels; flat: the picture from which it was restored.
    """
    palette, labels = even.palette, even.labels
    assert palette is not None and labels is not None  # as every restored picture has
    drawn, space = flat.painted(palette, labels), seen_as(condition)
    groups, group_of = linked_groups(len(palette), *_without_step(levels, drawn, labels, len(palette)))
    banded = np.where(np.bincount(group_of, minlength=groups) > 1, np.arange(1, groups + 1), 0)[group_of][labels]
    parts, count = ndimage.label((banded > 0) & ndimage.alike(banded, 2 * RIM + 1))
    out = list[ShadedArea]()
    for _, sharing in groupby(rough_areas(levels, parts, count, condition), key=lambda area: id(area.shade)):
        areas, left, error = list(sharing), 0.0, 0.0
        for area in areas:
            pixels = area.patch.pixels(levels)
            left += float(((area.shade.extended().residuals(pixels) @ space) ** 2).sum())
            error += float((((drawn[area.patch.places()] - pixels.values) @ space) ** 2).sum())
        out += areas if left <= STEP * error else []
    return out


def _without_step(
    levels: np.ndarray, drawn: np.ndarray, labels: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs of `count` fills, (e,) each, between which a picture (H, W, 4) lacks the step that it is drawn with.

    drawn: (H, W, 4) levels of the fills; labels: (H, W) the fill of each pixel.
    """
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
