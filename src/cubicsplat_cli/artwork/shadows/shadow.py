"""The soft shadows of a picture: the boxes that cast them, their offsets and blurs, and the shade of each pixel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.artwork.gradients.areas import EXPLAINED
from cubicsplat_cli.artwork.gradients.parts import LEAST_AREA, Parts
from cubicsplat_cli.artwork.gradients.shade import CLOSE
from cubicsplat_cli.artwork.regions.fills import EVEN
from cubicsplat_cli.artwork.regions.sampling import EXAMINED
from cubicsplat_cli.artwork.shadows.boxes import BlurredBox, Box, nearest_layers, numbers_of, reached, shaded
from cubicsplat_cli.artwork.shadows.casters import LEAST_RANGE, Caster, Shaded, casters_of, shaded_grounds
from cubicsplat_cli.raster.shades import ShadowSamples
from cubicsplat_cli.record import record

HALFWAY = 0.6  # share of the shaded pixels that layers must explain to be continued
FAINT = EVEN  # levels of shade that are counted
MOST_LAYERS = 3  # of one caster
DARK, LIGHT = 2400, 800  # shaded and unshaded pixels for a fit
BLURS = (3.0, 7.0, 16.0)  # px of the first blurs
FEW = 6  # first fits use one pixel of so many
SWEEPS = 3  # rounds over shadows that fall on each other
MOST_MOVED, MOST_GROWN = 64.0, 12.0  # px
Layers = tuple[BlurredBox, ...]


@record
class Cast(Caster):
    """The shadow of a box: its blurred copies."""

    layers: Layers

    def darkening(self, shape: tuple[int, int]) -> tuple[tuple[slice, slice], np.ndarray]:
        """Return the rows and columns of a picture (H, W) that it may reach, and (h, w) how much it darkens them."""
        window = reached(self.box, self.layers, shape)
        y, x = (np.arange(side.start, side.stop) + 0.5 for side in window)
        return window, shaded(self.box, self.layers, x, y)


@record
class Shadow:
    """The soft shadows of a picture, with their grounds and colour. No shadow falls on a ground within its caster."""

    shaded: Shaded
    casts: tuple[Cast, ...]

    def share_on(self, ground: np.ndarray) -> np.ndarray:
        """Return (H, W) the share by which the shadows would darken each pixel as a part of a ground (H, W) bool."""
        light = np.ones(ground.shape)
        for cast in self.casts:
            if falls_on(cast.mask, ground):
                window, share = cast.darkening(ground.shape)
                light[window] *= 1.0 - share
        return 1.0 - light


def falls_on(caster: np.ndarray, ground: np.ndarray) -> bool:
    """Return True if the shadow of a caster (H, W) bool falls on a ground (H, W) bool."""
    return bool((caster & ground).sum() <= 0.5 * ground.sum())


def shadow_of(parts: Parts) -> Shadow | None:
    """Return the shadows of a picture, by its even parts, that blurred boxes explain to its rounding; None for none."""
    if (grounds := shaded_grounds(parts)) is None:
        return None
    seen = grounds.share(parts.levels)
    scale = float(np.abs(grounds.colour - grounds.grounds[0].fill).max())
    if scale * float(seen.max()) < LEAST_RANGE:
        return None
    best, tried = tuple[Cast, ...](), list[list[Box]]()
    for casters in casters_of(grounds, seen, parts.numbers > 0):
        boxes = [caster.box for caster in casters]
        if boxes in tried:
            continue
        tried.append(boxes)
        if (layers := _ShadowSearch(grounds, seen, scale, casters).best()) is not None:
            casts = tuple(Cast(c.mask, c.box, some) for c, some in zip(casters, layers, strict=True) if some)
            # More shapes have shadows, or as many with fewer layers.
            best = min(best, casts, key=lambda some: (-len(some), sum(len(cast.layers) for cast in some)))
            if all(len(cast.layers) == 1 for cast in best):
                break
    return Shadow(grounds, best) if best else None


class _ShadowSearch:
    """The search for the layers of casters. seen: (H, W) shade on the grounds, 0..1; scale: levels of full shade."""

    def __init__(self, grounds: Shaded, seen: np.ndarray, scale: float, casters: list[Caster]) -> None:
        self.casters, self.scale = casters, scale
        dark, order = scale * seen > FAINT, np.random.default_rng(0)
        shaded, clear = (order.permutation(np.flatnonzero(grounds.mask & some)) for some in (dark, ~dark))
        self.rows, self.columns = np.unravel_index(np.concatenate([shaded, clear[:EXAMINED]]), seen.shape)
        self.seen = seen[self.rows, self.columns]
        self.dark = scale * self.seen > FAINT
        self.open = np.zeros((len(casters), len(self.seen)), dtype=bool)
        for open_, caster in zip(self.open, casters, strict=True):
            for ground in grounds.grounds:
                if falls_on(caster.mask, ground.mask):
                    open_ |= ground.mask[self.rows, self.columns]
        gaps = [caster.box.distance(self.columns + 0.5, self.rows + 0.5) for caster in casters]
        # Each pixel belongs to the nearest caster.
        self.nearest = np.where(self.open, gaps, np.inf).argmin(axis=0)

    def best(self) -> list[Layers | None] | None:
        """Return the layers of each caster, None for one without a shadow; None if they leave much unexplained."""
        count = len(self.casters)
        whole = self._samples(list(range(count)), [])
        shared = self._layers(whole, (), MOST_LAYERS if count == 1 else 1, [])
        if shared is not None and self._explained([shared] * count).mean() >= EXPLAINED:
            return [_more(whole, shared, MOST_LAYERS)] * count
        if count == 1:
            return None
        found = self._each()
        return found if any(found) and self._explained(found).mean() >= EXPLAINED else None

    def _each(self) -> list[Layers | None]:
        """Return the layers of each caster, fitted one at a time with the shadows of the others."""
        found: list[Layers | None] = [None] * len(self.casters)
        for sweep in range(SWEEPS):
            for k in range(len(self.casters)):
                if (self.dark & (self.nearest == k)).sum() < LEAST_AREA:
                    continue
                known = list(dict.fromkeys(some for some in found if some is not None))
                most = 1 if sweep == 0 else MOST_LAYERS
                found[k] = self._layers(self._samples([k], found), found[k] or (), most, known)
            if not sweep and not (any(found) and self._explained(found).mean() >= HALFWAY):
                break
            if all(self._good(k, found) for k in range(len(self.casters))):
                break
        return found

    def _good(self, k: int, found: list[Layers | None]) -> bool:
        """Return True if the shadow of a caster is explained, or too small to tell."""
        near = self.nearest[self.dark][:EXAMINED] == k
        return near.sum() < LEAST_AREA or bool(self._explained(found)[near].mean() >= EXPLAINED)

    def _samples(self, casters: list[int], found: Sequence[Layers | None]) -> ShadowSamples:
        """Return samples of the shadows of some casters, next to them."""
        near = np.isin(self.nearest, casters)
        at = np.concatenate([np.flatnonzero(near & self.dark)[:DARK], np.flatnonzero(near & ~self.dark)[:LIGHT]])
        return self._samples_at(casters, at, self._light(found, at, casters))

    def _samples_at(self, casters: list[int], at: np.ndarray, through: np.ndarray) -> ShadowSamples:
        """Return the samples at some pixels (n,). through: (n,) light that other shadows leave."""
        boxes, open_ = np.array([self.casters[k].box for k in casters]), self.open[casters][:, at]
        return ShadowSamples(boxes, self.rows[at], self.columns[at], open_, self.seen[at], through, self.scale)

    def _light(self, found: Sequence[Layers | None], at: np.ndarray, without: Sequence[int] = ()) -> np.ndarray:
        """Return (n,) the light that the shadows of all casters but some leave to pixels."""
        out = np.ones(len(at))
        for k, layers in enumerate(found):
            if layers and k not in without:
                out = out * self._samples_at([k], at, out).light(numbers_of(layers))
        return out

    def _layers(self, samples: ShadowSamples, begun: Layers, most: int, known: list[Layers]) -> Layers | None:
        """Return the fewest layers that explain samples, or the nearest ones; None if one of them is unlikely."""
        alpha = min(1.5 * float(samples.seen.max()), 0.9)
        begins = [begun] if begun else [(BlurredBox(0.0, 1.0, -1.0, 0.0, sigma, alpha),) for sigma in BLURS]
        best = _nearest(samples, [*begins, *known])
        return _more(samples, best, most) if all(map(_plausible, best)) else None

    def _explained(self, found: Sequence[Layers | None]) -> np.ndarray:
        """Return (n,) bool: True for shaded pixels that the shadows explain."""
        at = np.flatnonzero(self.dark)[:EXAMINED]
        return self.scale * np.abs(1.0 - self._light(found, at) - self.seen[at]) <= CLOSE


def _more(samples: ShadowSamples, best: Layers, most: int) -> Layers:
    """Return the layers with further ones, `most` in all, as long as these bring them nearer to the samples."""
    while len(best) < most and HALFWAY <= _explained(samples, best) < EXPLAINED:
        last = best[-1]
        weaker = [layer._replace(alpha=0.6 * layer.alpha) for layer in best]
        more = _nearest(samples, [(*weaker, last._replace(sigma=s, alpha=0.4 * last.alpha)) for s in BLURS])
        if _rough(samples, more) >= _rough(samples, best):
            break
        best = more
    return best


def _nearest(samples: ShadowSamples, begins: list[Layers]) -> Layers:
    """Return the layers nearest to the samples, from several beginnings, which are first fitted to few pixels."""
    few = samples.every(FEW)
    fits = [nearest_layers(few, layers) for layers in begins]
    rated = [(not all(map(_plausible, layers)), left, layers) for layers, left in fits]
    unlikely, _, best = min(rated, key=lambda fit: fit[:2])
    return best if unlikely or _explained(few, best) < HALFWAY else nearest_layers(samples, best)[0]


def _too_dark(samples: ShadowSamples, layers: Layers) -> np.ndarray:
    """Return (n,) levels by which layers make each shaded pixel of samples too dark."""
    off = samples.scale * (1.0 - samples.through * samples.light(numbers_of(layers)) - samples.seen)
    return off[samples.scale * samples.seen > FAINT]


def _explained(samples: ShadowSamples, layers: Layers) -> float:
    """Return the share of the shaded pixels of samples that layers explain."""
    wrong = _too_dark(samples, layers)
    return float((np.abs(wrong) <= CLOSE).mean()) if len(wrong) else 0.0


def _rough(samples: ShadowSamples, layers: Layers) -> float:
    """Return the root mean square in levels by which layers differ from the shaded pixels."""
    wrong = _too_dark(samples, layers)
    return float(np.sqrt((wrong * wrong).mean())) if len(wrong) else 0.0


def _plausible(layer: BlurredBox) -> bool:
    """Return True for a layer as people draw them: neither moved far nor much smaller or larger than its caster."""
    moved = float(np.hypot(layer.dx, layer.dy))
    return moved <= MOST_MOVED and abs(layer.grown) <= MOST_GROWN + 0.5 * layer.sigma
