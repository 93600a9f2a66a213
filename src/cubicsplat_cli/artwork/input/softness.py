"""Measure how much of a picture drifts: changes softly without an edge, as in a photo out of focus.

Connected areas in which colours hardly change from one pixel to the next are examined as a whole: in a drawing such an
area has one colour, or a gradient; in a photo colours drift across it. The means of windows remove noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.gradients.areas import gradient_areas
from cubicsplat_cli.artwork.gradients.layers import with_layers
from cubicsplat_cli.artwork.gradients.parts import smooth_parts
from cubicsplat_cli.artwork.gradients.shade import covered
from cubicsplat_cli.artwork.input.condition import SECOND
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import planes
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.arrays import with_channels

# Share of the pixels that are neither ground nor edge: drawings have at most 0.57 but for a bird in one gradient (0.77)
# and lettering in one (0.93), soft photos mostly 0.74 to 1, but at 128 px down to 0.34.
MOST_DRIFT = 0.6
MOST_PARTS = 100  # uneven parts, beyond which no gradients are sought


@record
class Softness:
    """Shares of the pixels: ground, of the commonest even colour; even, of all other even colours; soft, of those that
    drift. levels: (H, W, C) float32, the picture; mask: (H, W) bool, the pixels that drift.
    """

    ground: float
    even: float
    soft: float
    levels: np.ndarray
    mask: np.ndarray

    @property
    def drift(self) -> float:
        """The share, of the pixels that are neither edge nor ground, that drift; 0 if hardly any do."""
        return self.soft / (self.soft + self.even) if self.soft >= 0.1 else 0.0

    @property
    def drifts(self) -> bool:
        """True if colours drift, with some grain, and the first eight gradients do not explain it. Grain is in 0.005 to
        0.9 of the drifting pixels of photos, and in at most 0.003 of those of renderings without noise.
        """
        if self.drift <= MOST_DRIFT or _grain(self.levels, self.mask) < 0.004:
            return False
        left = float((self.mask & ~in_gradients(self.levels, 8)).sum()) / max(float(self.mask.sum()), 1.0)
        return replace(self, soft=left * self.soft).drift > MOST_DRIFT


def softness(levels: np.ndarray, drawn: np.ndarray) -> Softness:
    """Return the shares of a picture (H, W, C) in 0..255, of the drawn pixels (H, W) bool, at least one.

    Connected pixels of slopes up to 1.2 levels per px are an area, if they are 9 or more. Those within 4 levels of its
    median are even; areas whose medians are within 6 levels of that of the largest are the ground.
    """
    values = levels.astype(np.float32)
    bends = _bends(values)
    # Above a noise of 2 levels windows are wider. 0.6745: median of a normal error's size.
    noisy = 2 * np.count_nonzero(bends > 2.0 * 0.6745 * SECOND) > bends.size
    means, slopes = planes(values, 9 if noisy else 5)
    places, count = ndimage.large_parts((slopes <= 1.2) & drawn, 9)
    inside = places > 0
    inner, ends = means[inside], np.cumsum(np.bincount(places[inside], minlength=count + 1)[1:])
    soft = np.zeros(len(inner), dtype=bool)
    colours, sizes = [np.full(levels.shape[2], -1e3)], [0]
    for own in np.split(np.argsort(places[inside], kind="stable"), ends)[:-1]:
        middle = np.median(inner[own], axis=0)
        soft[own] = largest(np.abs(inner[own] - middle)) > 4.0
        colours.append(middle)
        sizes.append(int((~soft[own]).sum()))
    total, area = float(drawn.sum()), np.array(sizes, dtype=float)
    ground = np.abs(np.array(colours) - colours[int(area.argmax())]).max(axis=1) <= 6.0
    mask = np.zeros(places.shape, dtype=bool)
    mask[inside] = soft
    even = float(area[~ground].sum()) / total
    return Softness(float(area[ground].sum()) / total, even, float(soft.sum()) / total, values, mask)


def _grain(levels: np.ndarray, mask: np.ndarray) -> float:
    """Return the share of a mask (H, W) with second differences of 2 levels, above what rounding gives; 1 if empty."""
    turned = (levels, mask), (levels.swapaxes(0, 1), mask.T)
    bent = np.concatenate([largest(_bends(lines))[inside[:, 1:-1]] >= 2.0 for lines, inside in turned])
    return float(bent.mean()) if len(bent) else 1.0


def _bends(values: np.ndarray) -> np.ndarray:
    """Return (H, W - 2, 3) the sizes of second differences along rows."""
    return np.abs(values[:, 2:, :3] - 2.0 * values[:, 1:-1, :3] + values[:, :-2, :3])


def in_gradients(levels: np.ndarray, tries: int, *, layered: bool = False) -> np.ndarray:
    """Return (H, W) bool: the pixels of a picture (H, W, 3) or premultiplied (H, W, 4) in 0..255 that gradients
    explain, of which at most `tries` are sought. layered: also where one lies above the other.
    """
    levels = with_channels(levels, 4, 255.0)
    parts = smooth_parts(levels)
    areas = gradient_areas(parts, tries, MOST_PARTS)
    if layered:
        areas = with_layers(parts, areas, MOST_PARTS)
    return covered(areas, levels.shape)
