"""The soft shadows of a picture: what casts them, how that is moved and blurred, and how much they shade each pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.gradients.shade import CLOSE
from cubicsplat_cli.artwork.shadows.boxes import BlurredBox, Box, ShadowSamples, reached, shaded
from cubicsplat_cli.artwork.shadows.casters import Caster, Shaded, casters_of, shaded_grounds, silhouettes_of
from cubicsplat_cli.raster.shadows import ShadedPixels
from cubicsplat_cli.record import record

# Share of the shaded pixels, and of the others, that must be off by CLOSE at most, and to go on; levels that count as
# shade.
EXPLAINED, HALFWAY, FAINT = 0.97, 0.6, 1.0
ROUGH = 0.75  # levels, the root of the mean square, beyond which another layer is tried
MOST_LAYERS, MOST_SHARED = 3, 2
# Pixels looked at that are shaded, and that are not, and of all shaded ones; fewest shaded ones of a shadow.
DARK, LIGHT, CHECKED, FEWEST = 2400, 800, 20_000, 60
BEGIN, MORE = (3.0, 7.0, 16.0), (2.5, 20.0)  # px of blur to begin with, of the first layer and of others
FEW = 6  # every so many pixels are looked at first
SWEEPS = 3  # rounds through shadows that fall on each other
MOST_MOVED, MOST_GROWN = 64.0, 12.0  # px
LEAST_STRENGTH = 4.0  # levels of the darkest shade


@record
class Cast(Caster):
    """The shadow of a box: its blurred copies."""

    layers: tuple[BlurredBox, ...]

    def darkening(self, shape: tuple[int, int]) -> tuple[slice, slice, np.ndarray]:
        """The rows and columns of a picture (H, W) that it may reach, and (h, w) how much it darkens them."""
        rows, columns = reached(self.box, self.layers, shape)
        x, y = np.arange(columns.start, columns.stop) + 0.5, np.arange(rows.start, rows.stop) + 0.5
        return rows, columns, shaded(self.box, self.layers, x, y)


@record
class Shadow:
    """The soft shadows of a picture, with their grounds and colour. None falls on a ground within what casts it."""

    shaded: Shaded
    casts: tuple[Cast, ...]


class Shares:
    """Shares by which the shadows of a picture shade its pixels. shape: (H, W)."""

    def __init__(self, shadow: Shadow, shape: tuple[int, int]) -> None:
        self._shape, self._casts = shape, shadow.casts
        self._dark = [cast.darkening(shape) for cast in shadow.casts]
        self._known: dict[tuple[bool, ...], np.ndarray] = {}

    def on(self, mask: np.ndarray) -> np.ndarray:
        """(H, W) the share by which each pixel of a ground would be darkened that is seen in a mask (H, W)."""
        key = tuple(falls_on(cast.mask, mask) for cast in self._casts)
        if key not in self._known:
            light = np.ones(self._shape)
            for falls, (rows, columns, share) in zip(key, self._dark, strict=True):
                if falls:
                    light[rows, columns] *= 1.0 - share
            self._known[key] = 1.0 - light
        return self._known[key]


def falls_on(caster: np.ndarray, ground: np.ndarray) -> bool:
    """Whether the shadow of what casts it, (H, W) bool, falls on a ground (H, W) bool."""
    return bool((caster & ground).sum() <= 0.5 * ground.sum())


def shadow_of(levels: np.ndarray, parts: np.ndarray, count: int) -> Shadow | None:
    """The shadows in a picture (H, W, 4), premultiplied levels, that blurred boxes explain to its rounding;
    None without any. parts, count: as of `smooth_parts`."""
    shaded_ = shaded_grounds(levels, parts, count)
    if shaded_ is None:
        return None
    seen = shaded_.share(levels)
    scale = float(np.abs(shaded_.colour - shaded_.grounds[0].fill).max())
    if scale * float(seen.max()) < LEAST_STRENGTH:
        return None
    silhouettes = silhouettes_of(shaded_, seen)
    best = tuple[Cast, ...]()
    tried: set[tuple[Box, ...]] = set()
    for casters in casters_of(shaded_, silhouettes, parts > 0):
        boxes = tuple(caster.box for caster in casters)
        if boxes in tried:
            continue
        tried.add(boxes)
        layers = _ShadowSearch(shaded_, seen, scale, casters).best()
        if layers is not None:
            casts = tuple(Cast(c.mask, c.box, own) for c, own in zip(casters, layers, strict=True) if own is not None)
            best = casts if not best or _rank(casts) < _rank(best) else best
            if all(len(cast.layers) == 1 for cast in best):
                break
    return Shadow(shaded_, best) if best else None


def _rank(casts: tuple[Cast, ...]) -> tuple[int, int]:
    """The less the better: more things have their shadows told, or the same in fewer layers."""
    return -len(casts), sum(len(cast.layers) for cast in casts)


Layers = tuple[BlurredBox, ...]


class _ShadowSearch:
    """The search for the layers of some casters. seen: (H, W) how much each pixel of the grounds is shaded; scale:
    levels of a whole shade."""

    def __init__(self, grounds: Shaded, seen: np.ndarray, scale: float, casters: list[Caster]) -> None:
        self.casters, self.scale = casters, scale
        on = grounds.mask
        dark = scale * seen > FAINT
        order = np.random.default_rng(0)
        at = [order.permutation(np.flatnonzero(own)) for own in (on & dark, on & ~dark)]
        at[1] = at[1][:CHECKED]
        self.rows, self.columns = np.unravel_index(np.concatenate(at), seen.shape)
        self.seen = seen[self.rows, self.columns]
        self.dark = scale * self.seen > FAINT
        x, y = self.columns + 0.5, self.rows + 0.5
        self.open, gaps = [], []
        for caster in casters:
            open_ = np.zeros(len(self.seen), dtype=bool)
            for ground in grounds.grounds:
                if falls_on(caster.mask, ground.mask):
                    open_ |= ground.mask[self.rows, self.columns]
            self.open.append(open_)
            gaps.append(np.where(open_, caster.box.distance(x, y), np.inf))
        # Each pixel is asked of the nearest caster.
        self.nearest = np.argmin(gaps, axis=0)

    def best(self) -> list[Layers | None] | None:
        """The layers of each caster, None for one without a shadow; None where they leave much unexplained."""
        everyone = list(range(len(self.casters)))
        whole = self._samples(everyone, [None] * len(everyone))
        if self.dark.sum() < FEWEST:
            return None
        shared = self._layers(whole, (), MOST_LAYERS if len(everyone) == 1 else 1, [])
        if shared is not None and self._explained([shared] * len(everyone)).mean() >= EXPLAINED:
            shared = _more(whole, shared, MOST_SHARED)
            return [shared] * len(everyone) if self._faint([shared] * len(everyone)) else None
        if len(everyone) == 1:
            return None
        found = self._each()
        explained = any(found) and self._explained(found).mean() >= EXPLAINED
        return found if explained and self._faint(found) else None

    def _each(self) -> list[Layers | None]:
        """The layers of each caster by itself, what the others let through being known."""
        found: list[Layers | None] = [None] * len(self.casters)
        for sweep in range(SWEEPS):
            for k in range(len(self.casters)):
                samples = self._samples([k], found)
                if (self.dark & (self.nearest == k)).sum() < FEWEST:
                    continue
                known = list(dict.fromkeys(own for own in found if own is not None))
                found[k] = self._layers(samples, found[k] or (), 1 if sweep == 0 else MOST_LAYERS, known)
            if not sweep and not (any(found) and self._explained(found).mean() >= HALFWAY):
                break
            if all(self._good(k, found) for k in range(len(self.casters))):
                break
        return found

    def _good(self, k: int, found: list[Layers | None]) -> bool:
        own = self.nearest[self.dark][:CHECKED] == k
        return own.sum() < FEWEST or bool(self._explained(found)[own].mean() >= EXPLAINED)

    def _samples(self, own: list[int], found: Sequence[Layers | None]) -> ShadowSamples:
        """Samples of the shadows of some casters, next to them."""
        near = np.isin(self.nearest, own)
        at = np.concatenate([np.flatnonzero(near & self.dark)[:DARK], np.flatnonzero(near & ~self.dark)[:LIGHT]])
        return self._seen(own, at, self._light(found, at, own))

    def _seen(self, own: list[int], at: np.ndarray, through: np.ndarray) -> ShadowSamples:
        boxes = np.stack([self.casters[k].box.numbers() for k in own])
        open_ = np.stack([self.open[k][at] for k in own])
        pixels = ShadedPixels(boxes, self.rows[at], self.columns[at], open_)
        return ShadowSamples(pixels, self.seen[at], through, self.scale)

    def _light(self, found: Sequence[Layers | None], at: np.ndarray, without: Sequence[int] = ()) -> np.ndarray:
        """(n,) what the shadows of casters, without some of these, let through to pixels."""
        out = np.ones(len(at))
        for k, layers in enumerate(found):
            if layers and k not in without:
                out = out * self._seen([k], at, out).light(layers)
        return out

    def _layers(self, samples: ShadowSamples, begun: Layers, most: int, known: list[Layers]) -> Layers | None:
        """The fewest layers that explain a samples, or those that come nearest; None where one is unlikely."""
        alpha = min(1.5 * float(samples.seen.max()), 0.9)
        begins = [begun] if begun else [(BlurredBox(0.0, 1.0, -1.0, 0.0, sigma, alpha),) for sigma in BEGIN]
        best = _nearest(samples, [*begins, *known])
        return _more(samples, best, most) if all(map(_plausible, best)) else None

    def _explained(self, found: Sequence[Layers | None]) -> np.ndarray:
        """(n,) bool which of the shaded pixels the shadows explain."""
        at = np.flatnonzero(self.dark)[:CHECKED]
        light = self._light(found, at)
        return np.asarray(self.scale * np.abs(1.0 - light - self.seen[at]) <= CLOSE)

    def _faint(self, found: Sequence[Layers | None]) -> bool:
        """Whether the shadows leave alone what is not shaded."""
        at = np.flatnonzero(~self.dark)[: 4 * LIGHT]
        light = self._light(found, at)
        return len(at) == 0 or bool((self.scale * (1.0 - light) <= CLOSE).mean() >= EXPLAINED)


def _more(samples: ShadowSamples, best: Layers, most: int) -> Layers:
    """The layers, and as many more, up to so many, as bring them nearer to what is seen until they are exact."""
    while len(best) < most and _explained(samples, best) >= HALFWAY:
        if _explained(samples, best) >= EXPLAINED and _rough(samples, best) <= ROUGH:
            break
        last = best[-1]
        weaker = [replace(layer, alpha=0.6 * layer.alpha) for layer in best]
        more = _nearest(samples, [(*weaker, replace(last, sigma=s, alpha=0.4 * last.alpha)) for s in MORE])
        if not all(map(_plausible, more)) or _rough(samples, more) >= _rough(samples, best):
            break
        best = more
    return best


def _nearest(samples: ShadowSamples, begins: list[Layers]) -> Layers:
    """The layers that come nearest to what is seen, from those to begin with: first to some of the pixels."""
    few = samples.every(FEW)
    fits = [few.nearest(layers) for layers in begins]
    unlikely, _, best = min(
        ((not all(map(_plausible, layers)), left, layers) for layers, left in fits), key=lambda fit: fit[:2]
    )
    return best if unlikely or _explained(few, best) < HALFWAY else samples.nearest(best)[0]


def _explained(samples: ShadowSamples, layers: Layers) -> float:
    """The share of the shaded pixels in a samples that layers explain."""
    dark = samples.scale * samples.seen > FAINT
    return float((np.abs(samples.off(layers)) <= CLOSE)[dark].mean()) if dark.any() else 0.0


def _rough(samples: ShadowSamples, layers: Layers) -> float:
    """Levels, the root of the mean square, by which layers are off what is seen shaded."""
    off = samples.off(layers)[samples.scale * samples.seen > FAINT]
    return float(np.sqrt((off * off).mean())) if len(off) else 0.0


def _plausible(layer: BlurredBox) -> bool:
    """Whether a layer is one that people draw: neither moved far nor much smaller or larger than what casts it."""
    moved = float(np.hypot(layer.dx, layer.dy))
    return moved <= MOST_MOVED and abs(layer.grown) <= MOST_GROWN + 0.5 * layer.sigma
