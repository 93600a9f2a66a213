"""Even and drifting parts of a picture. What drifts changes softly without an edge, as in a photo out of focus.

Connected places in which colours hardly change from one pixel to the next are looked at as a whole: in a drawing such a
place has one colour, or a gradient; in a photo colours drift across it. Noise is taken out by the means of windows.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.gradients.areas import gradient_areas
from cubicsplat_cli.artwork.gradients.parts import smooth_parts
from cubicsplat_cli.artwork.input.condition import SECOND
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import planes
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.arrays import with_channels

# Px of a window, wider where there is more noise than NOISY levels.
WINDOW, WIDER, NOISY = 5, 9, 2.0
QUIET = 1.2  # levels per px, beyond which there is an edge or texture
SAME, SAME_GROUND = 4.0, 6.0  # levels around a place's median, and between the medians of places that are the ground
FEW = 9  # px, of a place that tells nothing
SECOND_MEDIAN = 0.6745 * SECOND  # of the size of second differences of normal noise of 1
LEAST_SOFT = 0.1  # share of the pixels, below which nothing drifts
# Of what is neither ground nor edge: drawings have at most 0.57 but for a bird in one gradient (0.77) and lettering in
# one (0.93), soft photos mostly 0.74 to 1, but at 128 px down to 0.34.
MOST_DRIFT = 0.6
TRIES, MOST_PARTS = 8, 100  # gradients sought, and uneven parts beyond which none are
# Levels of a second difference that rounding a ramp never gives, and the share of what drifts that has as much in a
# photo: 0.005 to 0.9, in renderings without noise at most 0.003.
BENT, LEAST_GRAIN = 2.0, 0.004


@record
class Softness:
    """Shares of the pixels: ground, of the commonest even colour; even, of all others; soft, of what drifts.

    levels: (H, W, C) float32, the picture; mask: (H, W) bool, what drifts.
    """

    ground: float
    even: float
    soft: float
    levels: np.ndarray
    mask: np.ndarray

    @property
    def drift(self) -> float:
        """0..1: of what is neither edge nor ground, the share that drifts; 0 where hardly anything does."""
        return _drift(self.soft, self.even)

    @property
    def drifts(self) -> bool:
        """Return whether colours drift, with some grain, and no gradients explain it."""
        if self.drift <= MOST_DRIFT or _grain(self.levels, self.mask) < LEAST_GRAIN:
            return False
        left = float((self.mask & ~in_gradients(self.levels, TRIES)).sum()) / max(float(self.mask.sum()), 1.0)
        return _drift(left * self.soft, self.even) > MOST_DRIFT


def _drift(soft: float, even: float) -> float:
    return soft / (soft + even) if soft >= LEAST_SOFT else 0.0


def softness(levels: np.ndarray, drawn: np.ndarray) -> Softness:
    """The shares of a picture (H, W, C) in 0..255; drawn: (H, W) bool, not empty, what counts."""
    values = levels.astype(np.float32)
    means, slopes = planes(values, WIDER if _is_noisy(values) else WINDOW)
    places, count = ndimage.label((slopes <= QUIET) & drawn)
    inside = places > 0
    order = np.argsort(places[inside], kind="stable")
    lengths = np.bincount(places[inside], minlength=count + 1)[1:]
    ends = np.cumsum(lengths)
    sorted_means = means[inside][order]
    soft = np.zeros(len(order), dtype=bool)
    colours, sizes = [np.full(levels.shape[2], -1e3)], [0]
    for start, end in zip(ends - lengths, ends, strict=True):
        if end - start < FEW:
            continue
        middle = np.median(sorted_means[start:end], axis=0)
        off = largest(np.abs(sorted_means[start:end] - middle)) > SAME
        soft[order[start:end]] = off
        colours.append(middle)
        sizes.append(int((~off).sum()))
    total, area = float(drawn.sum()), np.array(sizes, dtype=float)
    ground = np.abs(np.array(colours) - colours[int(area.argmax())]).max(axis=1) <= SAME_GROUND
    mask = np.zeros(places.shape, dtype=bool)
    mask[inside] = soft
    even = float(area[~ground].sum()) / total
    return Softness(float(area[ground].sum()) / total, even, float(soft.sum()) / total, values, mask)


def _grain(levels: np.ndarray, mask: np.ndarray) -> float:
    """The share of the pixels of a mask (H, W), or 1 where none is off the border, at which colours do not change as
    evenly as rounded ramps do.
    """
    turned = (levels, mask), (levels.swapaxes(0, 1), mask.T)
    every = np.concatenate([largest(_bends(each))[inside[:, 1:-1]] >= BENT for each, inside in turned])
    return float(every.mean()) if len(every) else 1.0


def _is_noisy(values: np.ndarray) -> bool:
    """True if what differs from pixel to pixel in most of the picture has a standard deviation beyond NOISY levels."""
    second = _bends(values)
    return 2 * np.count_nonzero(second > NOISY * SECOND_MEDIAN) > second.size


def _bends(values: np.ndarray) -> np.ndarray:
    """(H, W - 2, 3) the sizes of second differences along rows."""
    return np.abs(values[:, 2:, :3] - 2.0 * values[:, 1:-1, :3] + values[:, :-2, :3])


def in_gradients(levels: np.ndarray, tries: int) -> np.ndarray:
    """(H, W) bool: what of a picture (H, W, 3) or premultiplied (H, W, 4) in 0..255 gradients explain.

    tries: at most so many are sought.
    """
    levels = with_channels(levels, 4, 255.0)
    explained = np.zeros(levels.shape[:2], dtype=bool)
    for area in gradient_areas(levels, *smooth_parts(levels), tries, MOST_PARTS):
        explained[area.patch.window] |= area.patch.mask
    return explained
