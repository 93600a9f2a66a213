"""Find the paper of a scanned drawing, a background with grain that changes slowly, and divide it out.

Pictures are (H, W, 4) float32 premultiplied RGBA in levels of 0..255. A polynomial is fitted to the lighter pixels of
cells, in which cells full of ink do not count. Then the smoothed means of the pixels that it explains are the paper.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.channels import FULL, LUMA, in_blocks
from cubicsplat_cli.artwork.input.condition import OUTLIER
from cubicsplat_cli.artwork.input.pens import Pens, pens_of, unexplained
from cubicsplat_cli.artwork.regions.fills import APART
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.record import record

DEGREE = 4  # of the polynomial
LEAST_GRAIN, MOST_GRAIN = 0.6, 14.0  # levels
MOST_UNEXPLAINED = 0.05  # of ink's pixels, off by APART from what pens drew: noise and JPEGs leave up to half of that
WHITE = np.full(3, FULL)  # what unevenly lit paper becomes, levels
NORMAL = 1.4826  # standard deviation of normal errors over the median of their sizes


@record
class Scan:
    """levels: (H, W, 4), the drawing on even paper: white if its light is uneven, else of its own colour; bare: (H, W,
    3), the same with the paper's grain and with pixels lighter than the paper; grain: standard deviation in levels, 0
    if the paper has none; pens: those of its lines under even light, which prove the scan, else None.
    """

    levels: np.ndarray
    bare: np.ndarray
    grain: float
    pens: Pens | None


def scan_of(levels: np.ndarray) -> Scan | None:
    """Return the drawing on a scan's paper; None if a picture is no scan.

    A scan has at least 96 px a side and 48 cells along the longer one. Its paper is at least as light as the middle
    tone at its lightest, and at least 0.3 of that at its darkest. It covers 0.6 of the pixels; at most 0.004 of them
    are clearly lighter, and at least 0.0005 are clearly darker: ink, as is most of what is darker than the grain.
    Outside of ink all of it has one tint. Under light that varies by 6 levels or more, it has grain, which is alike
    over a px or two; means over 4 px, which show shading, differ by at most 1.5 times as much. Under even light it may
    have none, but the ink is in lines that pens drew, which nearly all pixels confirm. Such paper may be dark, too, and
    its ink light.
    """
    if min(levels.shape[:2]) < 96 or (levels[..., 3] < 255.0).any():
        return None
    luma = levels[..., :3] @ LUMA
    grainy = bool(np.median(ndimage.ranges(luma, 3)) > 0.0)  # hardly a pixel is like all around it
    if (scan := _on_light_paper(levels, luma, may_be_uneven=grainy)) is not None:
        return scan
    paper = np.median(luma)  # of even paper, which is most of the picture
    if paper >= 128.0 or not _soft(luma - paper):
        return None
    scan = _on_light_paper(_negative(levels), 255.0 - luma, may_be_uneven=False)
    if scan is None or scan.pens is None:
        return None
    pens = replace(scan.pens, paper=255.0 - scan.pens.paper, inks=255.0 - scan.pens.inks)
    return Scan(_negative(scan.levels), 255.0 - scan.bare, scan.grain, pens)


def _negative(levels: np.ndarray) -> np.ndarray:
    """Return an opaque picture (H, W, 4) with its colours turned to the opposite ones."""
    return np.where([True, True, True, False], 255.0 - levels, levels)


def _on_light_paper(levels: np.ndarray, luma: np.ndarray, *, may_be_uneven: bool) -> Scan | None:
    """Return the drawing on light paper, as `scan_of` does; None if there is none. luma: (H, W), that of the levels."""
    colours = levels[..., :3]
    cell = max(4, round(max(luma.shape) / 48))
    # The lightest quarter of a cell is paper.
    light = _enlarged(_polynomial(np.quantile(_cells(luma, cell), 0.75, axis=-1)), luma.shape, cell)
    light, grain = _centred(luma, light)
    possible = _soft(light - luma) if _is_even(light) else may_be_uneven and grain >= LEAST_GRAIN
    if not possible or grain > MOST_GRAIN:
        return None
    rest = max(grain, LEAST_GRAIN)  # levels, that of paper from its light
    paper = np.abs(luma - light) <= OUTLIER * rest
    surface = np.stack([_surface(colours[..., k], paper, cell) for k in range(3)], axis=-1)
    light = surface @ LUMA
    off = luma - light
    fine, coarse = _grain(off, paper)
    grainy = fine >= max(LEAST_GRAIN, coarse / 1.5)
    even = _is_even(light)
    if not (even or (grainy and may_be_uneven)) or light.max() < 128.0 or light.min() < 0.3 * light.max():
        return None
    far = max(APART, 2.0 * OUTLIER * rest)
    if (np.abs(off) <= OUTLIER * rest).mean() < 0.6 or (off > far).mean() > 0.004 or (off < -far).mean() < 0.0005:
        return None
    colour = np.median(colours[paper], axis=0) if even else WHITE
    bare = colours * (colour / np.maximum(surface, 1.0))
    drawn = np.clip(bare, 0.0, colour)
    rest *= float(colour @ LUMA) / float(np.median(light))
    depth = (colour - drawn) @ LUMA
    ink, dark = _ink(depth, rest), depth > OUTLIER * rest
    tint = bare - colour - ((bare - colour) @ LUMA)[..., None]
    lost = (np.abs(tint) > APART).any(axis=-1) & ~ink
    # Most of what is darker than the grain is ink; in a photo of a texture it is shade.
    if 2 * (dark & ink).sum() <= dark.sum() or lost.mean() > 0.004:
        return None
    out = levels.copy()
    out[..., :3] = np.where(ink[..., None], drawn, colour)
    pens = pens_of(bare, colour, rest) if even else None
    if even and (pens is None or unexplained(out, pens, far) > MOST_UNEXPLAINED):
        return None
    return Scan(out, bare, rest if grainy else 0.0, pens)


def _is_even(light: np.ndarray) -> bool:
    """True if light (H, W) varies by less than 6 levels."""
    return bool(light.max() - light.min() < 6.0)


def _soft(depth: np.ndarray) -> bool:
    """True if the lines of a depth (H, W), in levels below the paper, may be blurred; sharp ones need no pens to be
    told. No neighbours differ by the depth of ink: through a blur of half a px they differ by 0.61 of it at most.
    """
    dark = depth > APART
    steps = (np.abs(np.diff(depth, axis=k, prepend=depth.take([0], axis=k))) for k in (0, 1))
    return bool(dark.any() and np.quantile(np.maximum(*steps)[dark], 0.99) < 0.7 * np.quantile(depth[dark], 0.99))


def _ink(depth: np.ndarray, grain: float) -> np.ndarray:
    """Return (H, W) bool: ink, of a depth (H, W) in levels below the paper, and the pixels within 3 px of it. Faint
    specks are grain, and parts that do not lose half of their depth within 7 px are shadows, since ink has edges even
    in a soft scan.
    """
    depth = ndimage.gaussian_filter(depth, 1.0)
    parts, count = ndimage.label(depth > OUTLIER * grain, ndimage.SQUARE)
    deepest = ndimage.maximum(depth, parts, np.arange(count + 1))
    steepest = ndimage.maximum(ndimage.ranges(depth, 7), parts, np.arange(count + 1))
    clear = (deepest > 2.0 * OUTLIER * grain) & (steepest > deepest / 2.0)
    clear[0] = False
    return ndimage.binary_dilation(clear[parts], iterations=3)


def _cells(values: np.ndarray, cell: int) -> np.ndarray:
    """Return (rows, columns, cell x cell): the pixels of each whole cell of values (H, W)."""
    blocks = in_blocks(values, cell)
    return blocks.reshape(*blocks.shape[:2], cell * cell)


def _polynomial(cells: np.ndarray) -> np.ndarray:
    """Return the polynomial (rows, columns) through most of the cells, by 12 rounds of Tukey's biweight."""
    y, x = (axis.ravel() for axis in np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in cells.shape), indexing="ij"))
    terms = np.stack([x**i * y**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)], axis=1)
    values = cells.ravel()
    # The first fit takes the lightest half of the cells, since the others may be full of ink.
    weights = (values >= np.median(values)).astype(float)
    for _ in range(12):
        weighted = terms.T * weights
        fit = terms @ np.linalg.lstsq(weighted @ terms, weighted @ values, rcond=None)[0]
        off = values - fit
        scale = max(NORMAL * float(np.median(np.abs(off))), 0.5)
        weights = np.maximum(1.0 - (off / (4.685 * scale)) ** 2, 0.0) ** 2  # 95 % efficient for normal errors
    return fit.reshape(cells.shape)


def _enlarged(cells: np.ndarray, shape: tuple[int, int], cell: int) -> np.ndarray:
    """Return (H, W): the values of cells interpolated between their middles, and constant beyond the outermost ones."""
    for n in shape:  # rows, then columns
        at = np.clip((np.arange(n) + 0.5) / cell - 0.5, 0.0, len(cells) - 1.0)
        before = np.minimum(at.astype(int), max(0, len(cells) - 2))
        share = (at - before)[:, None]
        cells = ((1.0 - share) * cells[before] + share * cells[np.minimum(before + 1, len(cells) - 1)]).T
    return cells


def _centred(luma: np.ndarray, light: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the light, moved down to the middle of the paper, and the standard deviation of its grain, in levels."""
    off = luma - light
    # Pixels lighter than the commonest difference are paper alone.
    counts = np.bincount(np.clip(np.rint(off + 64.0), 0, 128).astype(int).ravel(), minlength=129)
    middle = float(ndimage.uniform_filter(counts.astype(float), 3).argmax()) - 64.0
    above = off[off >= middle] - middle
    return light + middle, float(np.sqrt(np.mean(above[above <= np.quantile(above, 0.99)] ** 2)))


def _grain(off: np.ndarray, paper: np.ndarray) -> tuple[float, float]:
    """Return the standard deviations in levels of the paper (H, W) bool: from its means nearby, by a Gaussian of 4 px,
    and of these. off: (H, W) levels from the light.
    """
    paper = ndimage.binary_erosion(paper, iterations=2)
    if not paper.any():
        return 0.0, 0.0
    weight = ndimage.gaussian_filter(paper.astype(np.float32), 4.0)
    means = ndimage.gaussian_filter(np.where(paper, off, 0.0), 4.0) / np.maximum(weight, 1e-6)
    fine, coarse = (NORMAL * float(np.median(np.abs(part[paper]))) for part in (off - means, means))
    return fine, coarse


def _surface(channel: np.ndarray, paper: np.ndarray, cell: int) -> np.ndarray:
    """Return (H, W): the light of paper (H, W) bool in a channel. The polynomial counts as a twentieth of a cell."""
    count = _cells(paper, cell).mean(axis=-1)
    means = _cells(np.where(paper, channel, 0.0), cell).mean(axis=-1) / np.maximum(count, 1e-6)
    measured = count > 0.1
    coarse = _polynomial(np.where(measured, means, np.median(means[measured]) if measured.any() else 0.0))
    weight = ndimage.gaussian_filter(count, 2.0, mode="nearest")
    rest = ndimage.gaussian_filter(np.where(measured, (means - coarse) * count, 0.0), 2.0, mode="nearest")
    return _enlarged(coarse + rest / (weight + 0.05), channel.shape, cell)
