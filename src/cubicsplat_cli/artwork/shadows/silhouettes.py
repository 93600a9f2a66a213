"""The soft shadow of things of any outline, moved and blurred alike, as "drop-shadow" in CSS makes it.

It darkens by s = alpha (G_sigma * C)(p - d), C the share that the things cover of each pixel.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.gradients.parts import Patch
from cubicsplat_cli.artwork.gradients.shade import CLOSE
from cubicsplat_cli.artwork.limits import blocks_of
from cubicsplat_cli.artwork.shadows.casters import OFF_LINE, Shaded
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import nearest_paints
from cubicsplat_cli.raster.unmix import blend_with
from cubicsplat_cli.record import record

BEGIN = (2.5, 6.0, 14.0)  # px of blur to begin with
ROUNDS, SETTLED, DAMPING = 30, 1e-3, 1e-3  # of Gauss-Newton; px of a last step
FAR_OFF = 64.0  # px that a shadow is moved or blurred by at most
BEYOND = 4.0  # sigmas from what casts it at which a shadow ends
# Px by which a silhouette may be larger than what casts the shadow, and from its tips to where that is even.
LARGER, TIP = 2, 10
# Px of the longer side of the copy that is fitted first; share of what is shaded there that is off by so much of the
# darkest shade at most, or no blur explains it.
SMALL, HALFWAY, FAR = 128, 0.6, 0.1
REFINED = 2  # rounds in which what they cover is told from what they shade
# Share of the shaded pixels, and of the others, that must be off by CLOSE at most; levels that count as shade.
EXPLAINED, FAINT = 0.97, 1.0
BOXES = 0.02  # of its darkest shade that a shadow is off which a program blurred by three boxes


@record
class Blur:
    """dx, dy: px by which a silhouette is moved; sigma: px of its blur; alpha: of its middle, 0..1."""

    dx: float
    dy: float
    sigma: float
    alpha: float

    def of(self, cover: np.ndarray) -> np.ndarray:
        """(H, W) how much the shadow of what covers so much of each pixel (H, W) darkens them."""
        return self.alpha * self._blurred(cover, 0)

    def _blurred(self, cover: np.ndarray, around: int) -> np.ndarray:
        """The blurred silhouette (H + 2 around, W + 2 around), moved."""
        pad = int(np.ceil(BEYOND * self.sigma + max(abs(self.dx), abs(self.dy)))) + around + 2
        padded = np.pad(cover, pad, mode="edge")
        wide = ndimage.gaussian_filter(padded, self.sigma, truncate=BEYOND, mode="nearest")
        return _moved(wide, pad - around, self.dx, self.dy)

    def nearest(self, cover: np.ndarray, seen: np.ndarray, where: np.ndarray, far: float = FAR_OFF) -> Blur:
        """The blur whose shadow is nearest to what is seen (H, W) where that is (H, W) bool known. far: px by which it
        is moved or blurred at most.
        """
        best, trial, left, damping, known = self, self, np.inf, DAMPING, seen[where]
        for _ in range(ROUNDS):
            wide = trial._blurred(cover, 2)
            field = wide[2:-2, 2:-2][where]
            off = trial.alpha * field - known
            error = float(off @ off)
            if error < left:
                done = left - error < SETTLED * error
                best, left, damping = trial, error, max(0.3 * damping, 1e-6)
                if done:
                    break
                # How it changes with dx, dy and sigma, as heat spreads, and with alpha.
                down, across = np.gradient(wide)
                bend = trial.sigma * (np.gradient(down, axis=0) + np.gradient(across, axis=1))
                slopes = np.stack([*(trial.alpha * each[2:-2, 2:-2][where] for each in (-across, -down, bend)), field])
                normal, force = slopes @ slopes.T, slopes @ off
            else:
                damping *= 10.0
                if damping > 1e3:
                    break
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + 1e-12 * np.eye(4), -force)
            moved = np.array([best.dx, best.dy, best.sigma, best.alpha]) + step
            trial = Blur(*np.clip(moved, [-far, -far, 0.5, 0.01], [far, far, far, 1.0]).tolist())
        return best


def _moved(field: np.ndarray, pad: int, dx: float, dy: float) -> np.ndarray:
    """A field, moved by less than it is padded, without the padding: between its values by lines."""
    x, y = int(np.floor(-dx)), int(np.floor(-dy))
    u, v = -dx - x, -dy - y
    height, width = field.shape[0] - 2 * pad, field.shape[1] - 2 * pad

    def part(down: int, across: int) -> np.ndarray:
        top, left = pad + y + down, pad + x + across
        return field[top : top + height, left : left + width]

    return np.asarray((1 - v) * ((1 - u) * part(0, 0) + u * part(0, 1)) + v * ((1 - u) * part(1, 0) + u * part(1, 1)))


@record
class Outlined:
    """The shadow of things of any outline. mask: (H, W) bool, they; share: (H, W) how much they darken;
    off: levels by which a pixel may be off that."""

    mask: np.ndarray
    share: np.ndarray
    off: float

    def darkening(self, shape: tuple[int, int]) -> tuple[slice, slice, np.ndarray]:
        """The rows and columns of a picture (H, W) that it may reach, and (h, w) how much it darkens them."""
        return slice(0, shape[0]), slice(0, shape[1]), self.share


def shadow_of_outlines(
    levels: np.ndarray, shaded: Shaded, seen: np.ndarray, scale: float, things: Patch, even: np.ndarray
) -> Outlined | None:
    """The shadow that things cast on the grounds of a picture (H, W, 4); None where one blur does not explain what is
    seen.

    seen: (H, W) how much the grounds are shaded; scale: levels of a whole shade; things: up to 2 px larger than they
    are; even: (H, W) bool where colours change evenly.
    """
    on, mask = shaded.mask, np.zeros(seen.shape, dtype=bool)
    mask[things.window] = things.mask
    strongest = min(1.5 * float(seen[on].max()), 0.9)
    ground, line = shaded.grounds[0].fill, shaded.colour - shaded.grounds[0].fill
    along = (levels - ground) @ line / float(line @ line)
    # What looks like shade among the things, as in the hole of a letter, is theirs only where it is not explained.
    shade = mask & (scale * along > FAINT) & (along <= strongest)
    shade &= largest(np.abs(levels - ground - along[..., None] * line)) <= OFF_LINE
    own = mask & ~shade
    cover = 0.5 * (own + ndimage.binary_erosion(own, ndimage.SQUARE, iterations=LARGER, border_value=1))
    best, explained = _roughly(cover, seen, on, strongest)
    if explained < HALFWAY:
        return None
    best = best.nearest(cover, seen, on)
    for _ in range(REFINED):
        share = best.of(cover)
        off = max(CLOSE, BOXES * scale * float(share.max()))
        own = mask & ~(shade & (scale * np.abs(share - along) <= 2.0 * off))
        cover = _covered(levels, shaded, share, own, even)
        best = best.nearest(cover, seen, on)
    share = best.of(cover)
    near, dark = scale * np.abs(share - seen) <= off, scale * seen > FAINT
    if any((near & part).sum() < EXPLAINED * part.sum() for part in (on & dark, on & ~dark)):
        return None
    return Outlined(own & (cover >= 0.5), share, off)


def _roughly(cover: np.ndarray, seen: np.ndarray, on: np.ndarray, strongest: float) -> tuple[Blur, float]:
    """The best of a few blurs, fitted to a small copy, and the share of what is shaded there that it is off by little.
    strongest: the share of its middle to begin with.
    """
    factor = -(-max(cover.shape) // SMALL)
    cover, seen, known, _ = np.moveaxis(blocks_of(np.stack([cover, seen, on, on], axis=2), factor), 2, 0)
    on = known == 1.0
    fits = [Blur(0.0, 0.0, sigma, strongest).nearest(cover, seen, on, FAR_OFF / factor) for sigma in BEGIN]
    errors = [np.abs(blur.of(cover) - seen)[on] for blur in fits]
    blur, error = min(zip(fits, errors, strict=True), key=lambda fit: float(fit[1] @ fit[1]))
    off = FAR * strongest
    dark = seen[on] > off
    explained = float((error[dark] <= off).mean()) if dark.any() else 0.0
    return Blur(factor * blur.dx, factor * blur.dy, factor * blur.sigma, blur.alpha), explained


def _covered(levels: np.ndarray, shaded: Shaded, share: np.ndarray, mask: np.ndarray, even: np.ndarray) -> np.ndarray:
    """(H, W) the share that things, (H, W) bool at most, cover of each pixel of a picture: all that is even, and at
    their edges what a blend of that with a ground tells. share: (H, W) how much grounds are shaded.
    """
    inner = even & ndimage.binary_erosion(mask, ndimage.SQUARE, iterations=LARGER, border_value=1)
    edge = np.flatnonzero(mask & ~inner)
    found, places = nearest_paints(np.where(inner, 0, -1), edge, TIP, 1)
    edge, places = edge[found[:, 0] == 0], places[found[:, 0] == 0, 0]
    values, dark, cover = levels.reshape(-1, 4), share.ravel()[edge, None], mask.astype(float)
    grounds = [ground.fill + dark * (shaded.colour - ground.fill) for ground in shaded.grounds]
    shares, left = zip(*(blend_with(values[edge], values[places], own, own) for own in grounds), strict=True)
    cover.ravel()[edge] = np.take_along_axis(np.array(shares), np.argmin(left, axis=0)[None], 0)[0]
    return cover
