"""Scans of drawings on paper: the paper is a ground that changes slowly, with a grain; it is found and divided out.

Pictures are (H, W, 4) float32 premultiplied RGBA in levels of 0..255. The paper is first a polynomial through the
lighter pixels of cells, fitted so that cells full of ink do not count, and then the smoothed means of what it
explains.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import LUMA, in_blocks
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.record import record

LEAST_SIDE, CELLS = 96, 48  # px, and along the longer side
LIGHTER = 0.75  # of the pixels of a cell, ordered by lightness: at least a quarter of it is paper
DEGREE, ROUNDS = 4, 12
TUKEY = 4.685  # standard deviations from which a cell does not count
NEAR = 3.0  # standard deviations of the grain within which pixels are paper
FINE = 4.0  # px, the standard deviation of the window to whose mean pixels of paper are compared
SMOOTH, PRIOR = 2.0, 0.05  # cells, and of a cell's pixels that the polynomial counts as
# What a scan is. Levels of grain; of the paper at its lightest, not below the middle tone; its darkest over that; by
# which it changes.
GRAIN, LIGHTEST, DARKEST, UNEVEN = (0.6, 14.0), 128.0, 0.3, 6.0
# Shares of the pixels: paper, lighter than paper, and ink; and levels by which those are off the paper.
PAPER, GLARE, FILL, OFF = 0.6, 0.004, 0.0005, 24.0
FAINT, BESIDE = 4.0, 3  # standard deviations of smoothed grain that count as ink, and px around it that stay
STEP = 7  # px of a square in which ink, which has edges even where a scan is soft, loses half of its depth


@record
class Scan:
    """levels: (H, W, 4), the drawing on white paper under even light; bare: (H, W, 3), the same with the paper's grain
    and what is lighter than the paper; grain: standard deviation in levels.
    """

    levels: np.ndarray
    bare: np.ndarray
    grain: float


def scan_of(levels: np.ndarray) -> Scan | None:
    """The drawing on a scan's paper; None where a picture is no scan, or one whose light is even."""
    if min(levels.shape[:2]) < LEAST_SIDE or (levels[..., 3] < 255.0).any():
        return None
    colours = levels[..., :3]
    luma = colours @ LUMA
    cell = max(4, round(max(luma.shape) / CELLS))
    light = _enlarged(_polynomial(np.quantile(_cells(luma, cell), LIGHTER, axis=-1)), luma.shape, cell)
    light, grain = _centred(luma, light)
    if not GRAIN[0] <= grain <= GRAIN[1]:
        return None
    own = np.abs(luma - light) <= NEAR * grain
    if _fine(luma, own) < GRAIN[0]:
        return None
    surface = np.stack([_surface(colours[..., k], own, cell) for k in range(3)], axis=-1)
    light = surface @ LUMA
    off = luma - light
    own = np.abs(off) <= NEAR * grain
    even = light.max() - light.min() < UNEVEN
    if even or light.max() < LIGHTEST or light.min() < DARKEST * light.max():
        return None
    far = max(OFF, 2.0 * NEAR * grain)
    if own.mean() < PAPER or (off > far).mean() > GLARE or (off < -far).mean() < FILL:
        return None
    bare = colours * (255.0 / np.maximum(surface, 1.0))
    white = np.clip(bare, 0.0, 255.0)
    grain *= 255.0 / float(np.median(light))
    ink = _ink(white, grain)
    if not ink.any():
        return None
    out = levels.copy()
    out[..., :3] = np.where(ink[..., None], white, 255.0)
    return Scan(out, bare, grain)


def _ink(white: np.ndarray, grain: float) -> np.ndarray:
    """(H, W) bool: what is ink on white paper (H, W, 3), and the pixels beside it; specks that are faint are grain, and
    what darkens slowly is a shadow."""
    depth = ndimage.gaussian_filter(255.0 - (white @ LUMA), 1.0)
    parts, count = ndimage.label(depth > FAINT * grain, ndimage.SQUARE)
    deepest = ndimage.maximum(depth, parts, np.arange(count + 1))
    steps = ndimage.maximum_filter(depth, STEP) - ndimage.minimum_filter(depth, STEP)
    steepest = ndimage.maximum(steps, parts, np.arange(count + 1))
    clear = (deepest > 2.0 * FAINT * grain) & (steepest > deepest / 2.0)
    clear[0] = False
    return ndimage.binary_dilation(clear[parts], iterations=BESIDE)


def _cells(values: np.ndarray, cell: int) -> np.ndarray:
    """(rows, columns, cell x cell) the pixels of each cell of values (H, W), which end with the last whole one."""
    blocks = in_blocks(values, cell)
    return blocks.reshape(*blocks.shape[:2], cell * cell)


def _powers(shape: tuple[int, int]) -> np.ndarray:
    """(rows x columns, terms) of a polynomial over a grid."""
    y, x = (axis.ravel() for axis in np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in shape), indexing="ij"))
    return np.stack([x**i * y**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)], axis=1)


def _polynomial(cells: np.ndarray) -> np.ndarray:
    """The polynomial (rows, columns) through most of the cells, by Tukey's biweight."""
    terms, values = _powers(cells.shape), cells.ravel()
    # The lightest half of the cells to begin with: the rest may be full of ink.
    weights = (values >= np.median(values)).astype(float)
    for _ in range(ROUNDS):
        weighted = terms.T * weights
        found = terms @ np.linalg.lstsq(weighted @ terms, weighted @ values, rcond=None)[0]
        off = values - found
        scale = max(1.4826 * float(np.median(np.abs(off))), 0.5)
        weights = np.maximum(1.0 - (off / (TUKEY * scale)) ** 2, 0.0) ** 2
    return found.reshape(cells.shape)


def _enlarged(cells: np.ndarray, shape: tuple[int, int], cell: int) -> np.ndarray:
    """(H, W) the values of cells between their middles, and beyond the outermost ones as these."""
    for n in shape:  # rows, then columns
        at = np.clip((np.arange(n) + 0.5) / cell - 0.5, 0.0, len(cells) - 1.0)
        before = np.minimum(at.astype(int), max(0, len(cells) - 2))
        share = (at - before)[:, None]
        cells = ((1.0 - share) * cells[before] + share * cells[np.minimum(before + 1, len(cells) - 1)]).T
    return cells


def _centred(luma: np.ndarray, light: np.ndarray) -> tuple[np.ndarray, float]:
    """The light brought from the lighter pixels of the paper down to their middle, and the deviation of its grain."""
    off = luma - light
    # What is lighter than the commonest difference is paper alone.
    counts = np.bincount(np.clip(np.rint(off + 64.0), 0, 128).astype(int).ravel(), minlength=129)
    middle = float(ndimage.uniform_filter(counts.astype(float), 3).argmax()) - 64.0
    above = off[off >= middle] - middle
    return light + middle, float(np.sqrt(np.mean(above[above <= np.quantile(above, 0.99)] ** 2)))


def _fine(luma: np.ndarray, own: np.ndarray) -> float:
    """The deviation of the paper, own (H, W) bool, from its mean nearby: hardly any in a gradient, which a polynomial
    may leave as much of as paper has grain."""
    own = ndimage.binary_erosion(own, iterations=2)
    weight = ndimage.gaussian_filter(own.astype(np.float32), FINE)
    off = luma - ndimage.gaussian_filter(np.where(own, luma, 0.0), FINE) / np.maximum(weight, 1e-6)
    return 1.4826 * float(np.median(np.abs(off[own]))) if own.any() else 0.0


def _surface(channel: np.ndarray, own: np.ndarray, cell: int) -> np.ndarray:
    """(H, W) the paper in one channel, from the pixels that are paper, own (H, W) bool."""
    count = _cells(own, cell).mean(axis=-1)
    total = _cells(np.where(own, channel, 0.0), cell).mean(axis=-1)
    means = total / np.maximum(count, 1e-6)
    known = count > 0.1
    coarse = _polynomial(np.where(known, means, np.median(means[known]) if known.any() else 0.0))
    weight = ndimage.gaussian_filter(count, SMOOTH, mode="nearest")
    rest = ndimage.gaussian_filter(np.where(known, (means - coarse) * count, 0.0), SMOOTH, mode="nearest")
    return _enlarged(coarse + rest / (weight + PRIOR), channel.shape, cell)
