"""The paint of a translucent overlay, from fills beneath it and what it makes of them.

An overlay of paint F and opacity a shows C = a F + (1 - a) G over a fill G. Two grounds say both, as C1 - C2 is
(1 - a)(G1 - G2) in all channels (Metelli 1974, "The perception of transparency"); premultiplied ones, so that opacity
is a channel like the others.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.records import dataclass
from cubicsplat_cli.scene.paint import Rgba

# Levels that colours are off by what drawing programs round; by which the grounds, and what is seen of them, differ.
ROUNDED, LEAST_APART, LEAST_SEEN = 1.6, 24.0, 8.0
FULL = 255.0
_OPACITIES = np.arange(5, 251)  # of 8 bits: 0.02 to 0.98


@dataclass(frozen=True)
class Paint:
    """fill: sRGB and opacity, 8 bits each."""

    fill: Rgba

    def over(self, grounds: np.ndarray) -> np.ndarray:
        """(n, 4) premultiplied levels of what it makes of grounds (n, 4)."""
        return self.premultiplied + (1.0 - self.fill[3] / FULL) * grounds

    @property
    def premultiplied(self) -> np.ndarray:
        """(4,) in levels."""
        return np.array([*(v * self.fill[3] / FULL for v in self.fill[:3]), float(self.fill[3])])


def paint_of(seen: np.ndarray, grounds: np.ndarray) -> Paint | None:
    """The paint that makes `seen` (n, 4) of `grounds` (n, 4), premultiplied levels, n >= 2, by least squares over all
    opacities of 8 bits; None where none does, or where the grounds are too much alike to tell.
    """
    if np.ptp(grounds, axis=0).max() < LEAST_APART or np.ptp(seen, axis=0).max() < LEAST_SEEN:
        return None
    opacity = _OPACITIES / FULL
    rest = seen[None] - (1.0 - opacity)[:, None, None] * grounds
    colours = np.clip(np.rint((rest.mean(axis=1) / opacity[:, None])[:, :3]), 0.0, FULL)
    made = np.concatenate([colours * opacity[:, None], FULL * opacity[:, None]], axis=1)
    off = np.abs(rest - made[:, None])
    k = int((off**2).sum(axis=(1, 2)).argmin())
    if off[k].max() > ROUNDED:
        return None
    r, g, b = (int(v) for v in colours[k])
    return Paint((r, g, b, int(_OPACITIES[k])))


def likeliest(seen: np.ndarray, grounds: np.ndarray) -> Rgba:
    """Of the fills that make what is `seen` (n, 4) of `grounds` (n, 4) the likeliest one: that with which a drawing
    program gets the very same numbers, at an opacity in whole twentieths, black or white.

    Programs round what an opacity leaves of a ground to the nearest number, or, as (v + 255) >> 8, mostly up; what they
    were given follows from what they made only by trying. Of a faint paint many colours make the same.
    """
    best: tuple[float, bool, bool, float] | None = None
    fill = (0, 0, 0, 0)
    colours = np.arange(int(FULL) + 1)
    for opacity in _OPACITIES.tolist():
        through = grounds * (FULL - opacity)
        over = np.rint(np.outer(colours, [opacity] * 3) / FULL)
        for left in (np.rint(through / FULL), np.floor((through + FULL) / (FULL + 1.0))):
            off = np.abs(seen[None, :, :3] - left[None, :, :3] - over[:, None]).sum(axis=1)
            clear = np.abs(seen[:, 3] - left[:, 3] - opacity).sum()
            least = off.min(axis=0)
            plain = [int(v) for v in (0, FULL) if (off[int(v)] == least).all()]
            mean = (seen - grounds * (1.0 - opacity / FULL)).mean(axis=0)[:3] * FULL / opacity
            tied = np.where(off == least, np.abs(colours[:, None] - mean), np.inf)
            chosen = [plain[0]] * 3 if plain else tied.argmin(axis=0).tolist()
            paint = Paint((chosen[0], chosen[1], chosen[2], opacity))
            misfit = float(((seen - paint.over(grounds)) ** 2).sum())
            whole = abs(opacity - FULL * round(20.0 * opacity / FULL) / 20.0) <= 0.5
            score = (float(least.sum() + clear), not whole, not plain, misfit)
            if best is None or score < best:
                best, fill = score, paint.fill
    return fill
