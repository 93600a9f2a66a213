"""The soft shadow of a picture: what casts it, how that is moved and blurred, and how much it shades each pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from cubicsplat_cli.artwork.shadows.blurred import MARGIN, Layer, Silhouette, settled
from cubicsplat_cli.artwork.shadows.casters import SQUARE, Shaded, casters_of, shaded_grounds

# Levels by which a pixel may be off its shadow, share of the shaded that must not be, levels that count as shade.
CLOSE, EXPLAINED, FAINT = 2.0, 0.97, 1.0
MOST_LAYERS, HALFWAY = 3, 0.6  # share of the shaded pixels that a first layer explains
# Pixels looked at that are shaded, and that are not.
DARK, LIGHT = 2400, 800
BEGIN = (7.0, 2.5, 20.0)  # px of blur to begin with
# Least px of the side of a square as large, and most px between pixels, of what is looked at first; levels, in the mean
# square, that may be left there.
COARSE, COARSEST, ROUGH = 80, 4, 3.0
MOST_MOVED, MOST_GROWN = 64.0, 12.0  # px
LEAST_STRENGTH = 4.0  # levels of the darkest shade
AROUND = 4  # px of the window around what is shaded


@dataclass(frozen=True)
class Shadow:
    """A soft shadow. shaded: its grounds and its colour; window: the part of the picture that it is within; layers: its
    blurred copies; casters: (h, w) bool each, in the window; share: (h, w) how much it shades each pixel, 0..1."""

    shaded: Shaded
    window: tuple[slice, slice]
    layers: tuple[Layer, ...]
    casters: tuple[np.ndarray, ...]
    share: np.ndarray

    def everywhere(self) -> np.ndarray:
        """(H, W) how much it shades each pixel of the picture."""
        out = np.zeros(self.shaded.grounds[0].mask.shape)
        out[self.window] = self.share
        return out


def shadow_of(levels: np.ndarray, parts: np.ndarray, count: int) -> Shadow | None:
    """The shadow in a picture (H, W, 4), premultiplied levels, that blurred silhouettes explain to its rounding; None
    without one. parts, count: as of `smooth_parts`."""
    shaded = shaded_grounds(levels, parts, count)
    if shaded is None:
        return None
    casters = casters_of(levels, shaded)
    if not casters:
        return None
    seen = shaded.share(levels)
    scale = float(np.abs(shaded.colour - shaded.grounds[0].ink).max())
    if scale * float(seen.max()) < LEAST_STRENGTH:
        return None
    window = _window(seen * scale > 0.5, casters)
    fit = _Fit(shaded, window, levels[window], parts[window] > 0, scale)
    return fit.best([mask[window] for mask in casters])


def _window(dark: np.ndarray, casters: list[np.ndarray]) -> tuple[slice, slice]:
    rows, columns = np.nonzero(np.logical_or.reduce([dark, *casters]))
    return tuple(
        slice(max(int(at.min()) - AROUND, 0), min(int(at.max()) + 1 + AROUND, size))
        for at, size in zip((rows, columns), dark.shape, strict=True)
    )  # type: ignore[return-value]


class _Fit:
    """The search for the layers that explain what is seen in a window, (h, w, 4) levels. even: (h, w) bool where
    colours change evenly; scale: levels of a whole shade."""

    def __init__(
        self, shaded: Shaded, window: tuple[slice, slice], levels: np.ndarray, even: np.ndarray, scale: float
    ) -> None:
        self.shaded, self.window, self.scale = shaded, window, scale
        self.grounds = np.logical_or.reduce([ground.mask[window] for ground in shaded.grounds])
        self.seen = shaded.share(levels, window)
        self.even = even & ~self.grounds
        self.dark = self.grounds & (scale * self.seen > FAINT)

    def best(self, casters: list[np.ndarray]) -> Shadow | None:
        """The shadow with the fewest layers that explain it; None where none do."""
        begun = None
        # What is steep in the shade looks like a part of what casts it: then that is what is even in it.
        for trial in (casters, [self._even(mask) for mask in casters]):
            first = self._one_layer(Silhouette(np.logical_or.reduce(trial)), np.logical_or.reduce(trial))
            begun = begun if first is None else (trial, *first)
            if begun is not None and begun[-1]:
                break
        if begun is None:
            return None
        casters, silhouette, layers, good = begun
        whole = np.logical_or.reduce(casters)
        while not good and len(layers) < MOST_LAYERS:
            begins = [self._coarse(whole, self._begin(layers, sigma)) for sigma in BEGIN[1:]]
            fits = [self._settled(silhouette, begin) for begin in begins if begin is not None]
            if not fits:
                return None
            layers, good = max(fits, key=lambda fit: fit[1])
        if not good or not all(map(_likely, layers)):
            return None
        return Shadow(self.shaded, self.window, layers, tuple(casters), silhouette.shaded(layers))

    def _one_layer(
        self, silhouette: Silhouette, whole: np.ndarray
    ) -> tuple[Silhouette, tuple[Layer, ...], bool] | None:
        """The layer nearest to what is seen, and whether it explains that; None where that is too little."""
        begin = self._coarse(whole, self._begin((), BEGIN[0]))
        if begin is None:
            return None
        layers, good = self._settled(silhouette, begin)
        if self._explained(silhouette, layers) < HALFWAY or not all(map(_likely, layers)):
            return None
        return silhouette, layers, good

    def _coarse(self, whole: np.ndarray, begin: tuple[Layer, ...]) -> tuple[Layer, ...] | None:
        """The layers nearest to every few pixels of the window; None where they explain hardly anything."""
        factor = min(max(int(np.sqrt(whole.size)) // COARSE, 1), COARSEST)
        if factor == 1:
            return begin
        every = (slice(factor // 2, None, factor), slice(factor // 2, None, factor))
        silhouette = Silhouette(whole[every], -(-MARGIN // factor))
        index, seen = self._picked(self.grounds[every], self.dark[every], self.seen[every])
        fitted, left = settled(silhouette, [layer.scaled(1.0 / factor) for layer in begin], index, seen, self.scale)
        layers = tuple(layer.scaled(factor) for layer in fitted)
        off = self.scale * np.abs(silhouette.shaded(fitted) - self.seen[every])[self.dark[every]]
        good = left <= ROUGH**2 and len(off) > 0 and (off <= CLOSE).mean() >= HALFWAY
        return layers if good and all(map(_likely, layers)) else None

    def _picked(self, grounds: np.ndarray, dark: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels to look at, in raster order, and how much they are shaded."""
        order = np.random.default_rng(0).permutation(seen.size)
        own, shaded = grounds.ravel()[order], dark.ravel()[order]
        index = np.concatenate([order[shaded][:DARK], order[own & ~shaded][:LIGHT]])
        return index, seen.ravel()[index]

    def _explained(self, silhouette: Silhouette, layers: tuple[Layer, ...]) -> float:
        """The share of the shaded pixels that layers explain."""
        return float((self.scale * np.abs(silhouette.shaded(layers) - self.seen)[self.dark] <= CLOSE).mean())

    def _settled(self, silhouette: Silhouette, begin: tuple[Layer, ...]) -> tuple[tuple[Layer, ...], bool]:
        """The layers nearest to what is seen, and whether they explain it."""
        layers, _ = settled(silhouette, begin, *self._picked(self.grounds, self.dark, self.seen), self.scale)
        even = self.grounds & ~self.dark
        faint = self.scale * silhouette.shaded(layers)[even] <= CLOSE
        return layers, self._explained(silhouette, layers) >= EXPLAINED and (
            not len(faint) or faint.mean() >= EXPLAINED
        )

    def _even(self, mask: np.ndarray) -> np.ndarray:
        """What is even in what casts a shadow, (h, w) bool, and what that surrounds; all of it where that is little."""
        inner = ndimage.binary_dilation(mask & self.even, SQUARE, iterations=2) & mask
        inner = ndimage.binary_fill_holes(inner)
        return inner if inner.sum() > 0.5 * mask.sum() else mask

    def _begin(self, layers: tuple[Layer, ...], sigma: float) -> tuple[Layer, ...]:
        """The layers and one more, with so many px of blur, to begin with."""
        if not layers:
            return (Layer(0.0, 1.0, -1.0, sigma, min(1.5 * float(self.seen[self.grounds].max()), 0.9)),)
        last = layers[-1]
        weaker = [replace(layer, alpha=0.6 * layer.alpha) for layer in layers]
        return (*weaker, replace(last, sigma=sigma, alpha=0.4 * last.alpha))


def _likely(layer: Layer) -> bool:
    """Whether a layer is one that people draw: neither moved far nor much smaller or larger than what casts it."""
    moved = float(np.hypot(layer.dx, layer.dy))
    return moved <= MOST_MOVED and abs(layer.grown) <= MOST_GROWN + 0.5 * layer.sigma
