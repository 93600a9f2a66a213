"""Fills that no pixel shows pure, or hardly one: the farthest common colours that no blend of two others explains.

Blends lie between fills, so what is farthest from all blends of the known fills is the least blended with any of them.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of, largest
from cubicsplat_cli.raster.unmix import blend_with, distance_to_blends

MOST, TRIES = 8, 400  # fills, and colours tried
ONE_OF_THREE = 0.6  # of the distance from blends of two, that a fill has from those of three
BLEND = 12.0  # levels by which a blend may be off the line between two fills
CLEAR, SOLID = 64.0, 254.0  # levels of opacity below which a colour says nothing of a fill, and of what is opaque
# Of the distance between two fills: steps by which the sharpening of an edge between them goes beyond either, and
# levels by which what it makes is off that.
BEYOND, BEYOND_OFF = np.linspace(0.02, 0.25, 12), 8.0


def hidden_fills(levels: np.ndarray, palette: np.ndarray, least: float, reach: float, fewest: float) -> np.ndarray:
    """(k, 4) fills that a palette (P, 4) lacks, of pixels (n, 4), all premultiplied RGBA in levels.

    least: levels by which a fill is off all blends of two others; reach: levels that are one colour; fewest: pixels
    that show it.
    """
    found: list[np.ndarray] = []
    gap = distance_to_blends(levels, palette)
    # Translucent colours are seams between shapes, or blends of a fill with nothing where nothing is a fill.
    strange = (gap > least) & (levels[:, 3] >= (CLEAR if (palette[:, 3] < 1.0).any() else SOLID))
    levels, gap = levels[strange], gap[strange]
    for _ in range(TRIES):
        if len(found) == MOST or not (gap > least).any():
            break
        farthest = int(gap.argmax())
        own = np.abs(levels - levels[farthest]).max(axis=1) <= reach
        fill = np.median(levels[own], axis=0)
        if own.sum() < fewest or _blend_of_three(fill, palette, ONE_OF_THREE * least):
            gap[farthest] = 0.0
            continue
        fill = _opaque(fill)
        found.append(fill)
        palette = np.vstack([palette, fill])
        gap = np.minimum(gap, distance_to_blends(levels, palette, len(palette) - 1))
        gap[farthest] = 0.0
    return np.array(found, dtype=float).reshape(-1, 4)


def _opaque(fill: np.ndarray) -> np.ndarray:
    """A fill that shows with nothing only is taken for opaque, of which its pixels then have a part."""
    return fill * (255.0 / fill[3])


def _blend_of_three(fill: np.ndarray, palette: np.ndarray, gap: float) -> bool:
    """Whether a fill (4,) is a blend of three of a palette, to so many levels: corners of small shapes are."""
    for k in range(len(palette) - 2):
        first, second = np.triu_indices(len(palette) - k - 1, 1)
        rest = palette[k + 1 :]
        if (blend_with(fill, palette[k], rest[first], rest[second])[1] <= gap).any():
            return True
    return False


def without_blends(palette: np.ndarray, seen: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """(P,) bool: the fills of a palette (P, 4) but those that only blends on the edges of a hidden fill (k, 4) have:
    between it and another one, and without a pixel that is flat, `seen` (P,) bool.
    """
    kept = np.ones(len(palette), dtype=bool)
    for k in np.flatnonzero(~seen):
        for fill in hidden:
            t, rest = blend_of(palette[k], fill, palette[seen])
            kept[k] &= not ((largest(np.abs(rest)) <= BLEND) & (t > 0.0) & (t < 1.0)).any()
    return kept


def overshoots(fill: np.ndarray, palette: np.ndarray) -> bool:
    """Whether a colour (4,), in levels, is what sharpening makes of one fill of a palette (P, 4) beside another one."""
    step = BEYOND[:, None, None, None] * (palette[:, None] - palette[None])
    beyond = np.clip(palette[:, None] + step, 0.0, 255.0)
    apart = np.abs(palette[:, None] - palette[None]).max(axis=-1) > 0.0
    return bool(((np.abs(beyond - fill).max(axis=-1) <= BEYOND_OFF) & apart).any())
