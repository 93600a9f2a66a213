"""Scores from pixels: displaced edges, exact fill colours, and the background that leaks between shapes.

A leak is the background's share 1 - alpha of the drawing, so it holds for every background at once. It is summed over
the area at least two px inside the canvas and the truth's opaque shapes (drawn without anti-aliasing, which has no
hairlines of its own): neither a displaced outline nor a smoothed edge shows the background there, only a gap does.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_erosion, maximum_filter, minimum_filter

from benchmarks.artwork.document import Document
from cubicsplat_cli.evaluate.metrics import decibels
from cubicsplat_cli.evaluate.perceptual import BLACK, WHITE, over

_LUMA = np.array([0.299, 0.587, 0.114], np.float32)
_LEAST_CONTRAST = 8.0  # levels; less is no edge
_NEAR = 5  # px, the square whose range of levels is an edge's contrast
LEAST_SHARE = 5e-4  # of the picture's px, from which a colour counts as a fill
MOST_DB = 100.0  # what identical pictures count as, so that they have a mean
INSIDE = 2  # px
_TILE = 64  # px of the canvas: 1024 at the largest scale


def srgb_of_light(light: np.ndarray) -> np.ndarray:
    """Return sRGB values, 0 to 1, of linear light (IEC 61966-2-1)."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)


def psnr(first: np.ndarray, second: np.ndarray) -> float:
    """PSNR in dB of two straight RGBA pictures, over white or black, whichever is worse; at most 100."""
    worst = 0.0
    for ground in (WHITE, BLACK):
        difference = over(first, ground).astype(np.float32) - over(second, ground)
        worst = max(worst, float(np.mean(np.square(difference), dtype=np.float64)))
    return MOST_DB if worst == 0.0 else min(MOST_DB, decibels(worst / 255.0**2))


def edge_displacement(truth: np.ndarray, candidate: np.ndarray, scale: float) -> float | None:
    """Mean distance in px at 1x between both pictures' edges, worse of white and black ground; None without an edge.

    truth, candidate: straight RGBA at `scale` times the size. Along an edge of contrast c that lies d px away the
    difference of the pictures sums up to c d, and the truth's gradient to c, for each px of its length: the quotient of
    both sums, each divided by the contrast around its px, is the mean distance.
    """
    found = [_displacement(over(truth, ground) @ _LUMA, over(candidate, ground) @ _LUMA) for ground in (WHITE, BLACK)]
    return max((distance / scale for distance in found if distance is not None), default=None)


def _displacement(truth: np.ndarray, candidate: np.ndarray) -> float | None:
    contrast = maximum_filter(truth, _NEAR) - minimum_filter(truth, _NEAR)
    edge = contrast > _LEAST_CONTRAST
    if min(truth.shape) < 2 or not edge.any():
        return None
    down, across = np.gradient(truth)
    length = (np.hypot(down, across)[edge] / contrast[edge]).sum(dtype=np.float64)
    moved = (np.abs(truth - candidate)[edge] / contrast[edge]).sum(dtype=np.float64)
    return float(moved / length)


def exact_colours(truth: np.ndarray, candidate: np.ndarray) -> float | None:
    """Share of the truth's fill colours that the candidate has to the last level, on at least half of their area.

    Both straight RGBA (H, W, 4) uint8. A fill colour is one that fills 3 x 3 px somewhere, which blends along edges do
    not, and in such places at least 0.05 % of the px; None where the truth has none. Levels of a gradient count too.
    """
    flat = _packed(truth)[evenly_coloured(truth)]
    colours, areas = np.unique(flat, return_counts=True)
    fills = {
        c: area for c, area in zip(colours, areas, strict=True) if area >= LEAST_SHARE * truth[..., 0].size and c & 255
    }
    if not fills:
        return None
    found = dict(zip(*np.unique(_packed(candidate), return_counts=True), strict=True))
    return sum(bool(found.get(colour, 0) >= 0.5 * area) for colour, area in fills.items()) / len(fills)


def evenly_coloured(pixels: np.ndarray) -> np.ndarray:
    """(H, W) bool: the px of a picture (H, W, 4) uint8 that are the middle of 3 x 3 px of one colour."""
    colours = _packed(pixels)
    even: np.ndarray = np.zeros(colours.shape, dtype=bool)
    even[1:-1, 1:-1] = (maximum_filter(colours, 3) == minimum_filter(colours, 3))[1:-1, 1:-1]
    return even


def _packed(pixels: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(pixels).view(">u4")[..., 0]


def opaque_inside(truth: Document) -> np.ndarray:
    """(H, W) bool at 4 times the size: where nothing may leak, at least two px within what is opaque."""
    mask = truth.draw(4, smooth=False)[..., 3] == 255
    # Row by row and column by column is a square. The canvas's edge counts too: a circle may touch it from within.
    for shape in ((1, 2 * 4 * INSIDE + 1), (2 * 4 * INSIDE + 1, 1)):
        mask = binary_erosion(mask, np.ones(shape, dtype=bool))
    return mask


def leak_areas(document: Document, opaque: np.ndarray, drawn: dict[int, np.ndarray]) -> tuple[float, float, float]:
    """Area in px of the background that leaks through, at 1, 4 and 16 times the size.

    opaque: see `opaque_inside`. drawn: the pictures at 1 and 4 times the size. At 16 times the size only those parts
    are drawn that leak at 4 times: an edge that runs along px at 16 times the size and not at 4 does not exist, and
    what is narrower than a px still shows in its share of it.
    """
    height, width = drawn[1].shape[:2]
    # At the size itself a px counts where all of it does.
    native = _shown(drawn[1], np.logical_and.reduce(opaque.reshape(height, 4, width, 4), axis=(1, 3)))
    shown, largest = _shown(drawn[4], opaque), 0.0
    for top in range(0, height, _TILE):
        for left in range(0, width, _TILE):
            across, down = min(_TILE, width - left), min(_TILE, height - top)
            part = slice(4 * top, 4 * (top + down)), slice(4 * left, 4 * (left + across))
            if shown[part].any():
                tile = document.draw(16, window=(left, top, across, down))
                largest += float(_shown(tile, opaque[part].repeat(4, axis=0).repeat(4, axis=1)).sum()) / 16**2
    return float(native.sum()), float(shown.sum()) / 4**2, largest


def _shown(pixels: np.ndarray, inside: np.ndarray) -> np.ndarray:
    return np.where(inside, (255.0 - pixels[..., 3]) / 255.0, 0.0)
