"""A picture with gradients as one of flat inks: each gradient becomes an ink that stands for it.

Where a gradient and its neighbour share a pixel, the share follows from what the gradient has at that very place; the
same share of the ink that stands for it makes the flat picture's pixel. So whatever comes after, from regions to the
polish, draws gradients as exactly as flat inks, and knows nothing of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from cubicsplat_cli.artwork.gradients.areas import gradient_areas
from cubicsplat_cli.artwork.gradients.parts import smooth_parts
from cubicsplat_cli.artwork.gradients.shade import ShadedArea, gradient_of
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.scene.paint import Gradient, painted

REACH, SLOTS = 3, 4  # px in which the paints of a blend are sought, and how many
FARTHER = 1.5  # levels by which the next paint must explain a pixel better
# Standard deviations of a blur, by which paints are sought farther, and levels that two of them leave of a pixel where
# three are tried.
WIDER, THREE = 5.0, 3.0
LEAST_SINE = 0.2  # of the angle between the colours of three paints, for shares of them to be told
STRANGE = 24.0  # levels that no two paints explain: something thin lies there
APART = 24.0  # levels between the inks that stand for gradients and all others
LEAST_OPACITY, MOST_CLEAR = 32.0, 240.0  # levels of an ink for a gradient that is translucent somewhere
SHIFTS = (0.0, 24.0, -24.0, 48.0, -48.0, 80.0, -80.0, 120.0, -120.0)


@dataclass(frozen=True)
class Flattened:
    """levels: (H, W, 4) the picture in flat inks. inks: (G, 4) levels, whole numbers, those that stand for gradients;
    gradients: what they stand for."""

    levels: np.ndarray
    inks: np.ndarray
    gradients: tuple[Gradient, ...]

    def gradient(self, ink: np.ndarray) -> Gradient | None:
        """What an ink (4,) in levels stands for, None where only for itself."""
        own = np.flatnonzero((self.inks == np.rint(ink)).all(axis=1))
        return self.gradients[int(own[0])] if len(own) else None


def flattened(levels: np.ndarray) -> Flattened:
    """A picture (H, W, 4), premultiplied levels, without its gradients; the same array where it has none."""
    parts, count = smooth_parts(levels)
    return without_areas(levels, parts, gradient_areas(levels, parts, count))


def without_areas(levels: np.ndarray, parts: np.ndarray, areas: list[ShadedArea], blur: float = 0.0) -> Flattened:
    """A picture (H, W, 4), premultiplied levels, without the gradients of these areas.

    parts: (H, W) int32 numbers from 1 on of what changes evenly, 0 for edges. blur: px, standard deviation of what
    edges are blurred by.
    """
    if not areas:
        return Flattened(levels, np.zeros((0, 4)), ())
    shades = list({id(area.shade): area.shade for area in areas}.values())
    gradients = [gradient_of(shade) for shade in shades]
    paint = np.where(parts > 0, parts + len(gradients) - 1, -1).astype(np.int32)
    for area in areas:
        paint[area.mask] = next(k for k, shade in enumerate(shades) if shade is area.shade)
    colours = [lambda x, y, own=gradient: 255.0 * painted(own, x + 0.5, y + 0.5) for gradient in gradients]
    flat = Paints(levels, paint, colours, _standing_for(levels, paint, gradients), blur)
    out = flat.flat()
    for area in areas:
        if area.ground is not None:
            _fade(out, levels, area, paint, flat)
    return Flattened(out, flat.inks, tuple(gradients))


Colours = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Paints:
    """The paints of a picture. paint: (H, W) int32, below G one that changes, from G on what is even, -1 an edge.
    colours: what each that changes has, (n, 4) levels at columns and rows (n,). inks: (G, 4) levels that stand for
    it."""

    def __init__(
        self, levels: np.ndarray, paint: np.ndarray, colours: Sequence[Colours], inks: np.ndarray, blur: float = 0.0
    ) -> None:
        self.levels, self.paint, self.colours, self.inks = levels, paint, colours, inks
        self.reach, self.blurred = REACH + math.ceil(WIDER * blur), blur > 0.0

    def at(self, paint: np.ndarray, y: np.ndarray, x: np.ndarray, value: np.ndarray) -> np.ndarray:
        """(n, 4) levels of paints (n,) at pixels y, x; value: (n, 4) what something even has, a few px away."""
        out = value.astype(float)
        for k, colours in enumerate(self.colours):
            own = paint == k
            out[own] = colours(x[own], y[own])
        return out

    def standing(self, paint: np.ndarray, value: np.ndarray) -> np.ndarray:
        """(n, 4) what stands for paints (n,)."""
        out = value.astype(float)
        own = (paint >= 0) & (paint < len(self.colours))
        out[own] = self.inks[paint[own]]
        return out

    def flat(self) -> np.ndarray:
        """(H, W, 4) levels of the picture with each paint that changes replaced by what stands for it."""
        count = len(self.colours)
        inside = (self.paint >= 0) & (self.paint < count)
        out = self.levels.copy()
        out[inside] = self.inks[self.paint[inside]]
        near = ndimage.binary_dilation(inside, np.ones((3, 3), dtype=bool), iterations=self.reach)
        y, x = np.nonzero(near & (self.paint < 0))
        if len(y) == 0:
            return out
        slots, found = self._near(y, x)
        value = self.levels[y, x].astype(float)
        colours = [self.at(slots[:, i], y, x, found[:, i]) for i in range(SLOTS)]
        flats = [self.standing(slots[:, i], found[:, i]) for i in range(SLOTS)]
        cost, rest = np.full(len(y), np.inf), np.full(len(y), np.inf)
        flat = value.copy()
        for i in range(SLOTS):
            for j in range(i, SLOTS):
                span = colours[i] - colours[j]
                length = np.maximum((span * span).sum(axis=1), 1e-9)
                a = np.clip(((value - colours[j]) * span).sum(axis=1) / length, 0.0, 1.0)[:, None]
                left = value - colours[j] - a * span
                gap = np.abs(left).max(axis=1)
                better = (slots[:, i] >= 0) & (slots[:, j] >= 0) & (gap + FARTHER * (i + j) < cost)
                cost[better], rest[better] = (gap + FARTHER * (i + j))[better], gap[better]
                flat[better] = (flats[j] + a * (flats[i] - flats[j]) + left)[better]
        if self.blurred:
            # Where three paints meet a blur blends them over many pixels.
            few = np.flatnonzero(rest > THREE)
            found3 = _blends_of_three(value[few], slots[few], [c[few] for c in colours], [f[few] for f in flats])
            better = found3[0] < cost[few]
            flat[few[better]], rest[few[better]] = found3[2][better], found3[1][better]
        # A thin line over a gradient: as much of it as of its strongest pixel near.
        alone = np.flatnonzero((rest > STRANGE) & (slots[:, 0] >= 0))
        if len(alone):
            flat[alone] = self._lines(y[alone], x[alone], value[alone], colours[0][alone], flats[0][alone])
        out[y, x] = np.clip(flat, 0.0, 255.0)
        return out

    def _lines(
        self, y: np.ndarray, x: np.ndarray, value: np.ndarray, under: np.ndarray, flat: np.ndarray
    ) -> np.ndarray:
        size = np.zeros(self.paint.shape)
        size[y, x] = np.abs(value - under).max(axis=1)
        most = ndimage.maximum_filter(size, 2 * REACH + 1)[y, x]
        share = (size[y, x] / np.maximum(most, 1e-9))[:, None]
        return value + (1.0 - share) * (flat - under)

    def _near(self, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, SLOTS) the different paints nearest to pixels y, x, -1 where there are fewer, and (n, SLOTS, 4) the
        levels of the pixels where they were found."""
        reach = self.reach
        offsets = [(dy, dx) for dy in range(-reach, reach + 1) for dx in range(-reach, reach + 1)]
        offsets.sort(key=lambda o: (o[0] ** 2 + o[1] ** 2, o))
        padded = np.pad(self.paint, reach, constant_values=-1)
        height, width = self.paint.shape
        slots = np.full((len(y), SLOTS), -1, dtype=np.int32)
        values = np.zeros((len(y), SLOTS, 4))
        used = np.zeros(len(y), dtype=int)
        for dy, dx in offsets:
            found = padded[y + dy + reach, x + dx + reach]
            rows = np.nonzero((found >= 0) & (used < SLOTS) & ~(slots == found[:, None]).any(axis=1))[0]
            slots[rows, used[rows]] = found[rows]
            values[rows, used[rows]] = self.levels[
                np.clip(y[rows] + dy, 0, height - 1), np.clip(x[rows] + dx, 0, width - 1)
            ]
            used[rows] += 1
        return slots, values


def _blends_of_three(
    value: np.ndarray, slots: np.ndarray, colours: list[np.ndarray], flats: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of values (n, 4) as blends of three of their paints, by least squares: cost (n,) and residual (n,) in levels,
    infinite where none is one, and (n, 4) the flat values.

    slots: (n, SLOTS), colours and flats: of each slot (n, 4), what its paint has there and what stands for it.
    """
    cost, rest, flat = np.full(len(value), np.inf), np.full(len(value), np.inf), value.copy()
    for i, j, k in combinations(range(SLOTS), 3):
        first, second, wanted = colours[i] - colours[k], colours[j] - colours[k], value - colours[k]
        aa, bb, ab = (first * first).sum(axis=1), (second * second).sum(axis=1), (first * second).sum(axis=1)
        av, bv = (first * wanted).sum(axis=1), (second * wanted).sum(axis=1)
        det = aa * bb - ab * ab
        sure = det > LEAST_SINE**2 * aa * bb
        det = np.where(sure, det, 1.0)
        a, b = (av * bb - bv * ab) / det, (bv * aa - av * ab) / det
        sure &= (a >= 0.0) & (b >= 0.0) & (a + b <= 1.0) & (slots[:, [i, j, k]] >= 0).all(axis=1)
        left = wanted - a[:, None] * first - b[:, None] * second
        gap = np.abs(left).max(axis=1)
        better = sure & (gap + FARTHER * (i + j + k) < cost)
        cost[better], rest[better] = (gap + FARTHER * (i + j + k))[better], gap[better]
        blend = flats[k] + a[:, None] * (flats[i] - flats[k]) + b[:, None] * (flats[j] - flats[k]) + left
        flat[better] = blend[better]
    return cost, rest, flat


def _fade(out: np.ndarray, levels: np.ndarray, area: ShadedArea, paint: np.ndarray, paints: Paints) -> None:
    """Where a gradient ends without an edge, an edge of its own is drawn, along the line at which it does."""
    near = ndimage.binary_dilation(area.mask, np.ones((3, 3), dtype=bool), iterations=2)
    y, x = np.nonzero(near)
    t = area.shade.t(x + 0.5, y + 0.5)
    turn = area.shade.frame[:, :2]
    first = area.shade.frame @ np.stack([x + 0.5, y + 0.5, np.ones(len(x))])
    # The slope of t: of a length by the chain rule.
    slope = turn[0][:, None] if not area.shade.radial else (turn.T @ first) / np.maximum(t, 1e-9)
    distance = (t - area.rim) / np.maximum(np.hypot(slope[0], slope[1]), 1e-9)
    share = np.clip(0.5 + (-distance if area.inwards else distance), 0.0, 1.0)
    # Pixels of the ground beside the rim, and of the area itself on it.
    ground = np.abs(levels[y, x] - area.ground).max(axis=1) <= 1.5
    own = area.mask[y, x]
    at_rim = (share > 0.0) & (share < 1.0) & (own | ground)
    ink = paints.inks[paint[area.mask][0]]
    out[y[at_rim], x[at_rim]] = area.ground + share[at_rim, None] * (ink - area.ground)
    # What is left of the ground beyond the rim, and was held for the gradient, is ground.
    beyond = own & (share <= 0.0)
    out[y[beyond], x[beyond]] = area.ground


def _standing_for(levels: np.ndarray, paint: np.ndarray, gradients: list[Gradient]) -> np.ndarray:
    """(G, 4) for each gradient a colour near its mean that no other paint has."""
    count = len(gradients)
    even = np.unique(np.rint(levels[paint >= count]), axis=0)
    taken = even if len(even) <= 4096 else even[:: len(even) // 4096]
    inks = []
    for k, gradient in enumerate(gradients):
        mean = levels[paint == k].mean(axis=0)
        clear = any(stop.ink[3] < 255 for stop in gradient.stops)
        alpha = float(np.clip(mean[3], LEAST_OPACITY, MOST_CLEAR)) if clear else 255.0
        best, most = None, -1.0
        for shift in SHIFTS:
            for channel in (0, 1, 2):
                ink = np.append(mean[:3] * (alpha / max(mean[3], 1e-9)), alpha)
                ink[channel] += shift
                ink = np.rint(np.concatenate([np.clip(ink[:3], 0.0, alpha), ink[3:]]))
                gap = float(np.abs(taken - ink).max(axis=1).min(initial=255.0))
                if gap > most + 1e-9 and most < APART:
                    best, most = ink, gap
        assert best is not None
        inks.append(best)
        taken = np.vstack([taken, best])
    return np.array(inks)
