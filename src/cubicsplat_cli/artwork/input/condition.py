"""Estimate the degradation of a picture since it was drawn: noise, compression, blur, missing anti-aliasing, or the
rounding of its colours to a few.

Pictures are (H, W, 4) float32 premultiplied RGBA in levels of 0..255.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from cubicsplat_cli.artwork.channels import LUMA, are_few, blend_of, commonest, in_blocks, largest, packed, unpacked
from cubicsplat_cli.artwork.regions.fills import APART, FLAT_RANGE, MOST_PALETTE
from cubicsplat_cli.artwork.regions.sampling import CONTRAST, EXAMINED, FEW_SAMPLES, FEWEST, ONE_SAMPLE, aliased
from cubicsplat_cli.artwork.settings import MOST_COLORS
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import edge_variances, second_differences, spread

OUTLIER = 4.0  # standard deviations; what is farther off is no noise
MISFIT = 1.0  # levels by which pixels are off the model of a restored picture beyond their noise
SECOND = 6.0**0.5  # standard deviation of a second difference of white noise of 1: weights 1, -2 and 1
ROUGH = 3.0  # levels of a second difference that neither even areas nor gradients have
PLANE = 9  # px of the blocks to which planes are fitted
BLOCK = 8  # px of a JPEG's block
# Ripples are within so many levels of a fill; they are more than so large a share of its pixels, of which at least so
# many must tell.
RIPPLE, RIPPLED, FEWEST_TELL = 8.0, 0.01, 200
# The 2D waves of a block's discrete cosine transform are products of two of these, which leaves out the level ones.
WAVES = (
    np.cos(math.pi / (2 * BLOCK) * np.arange(1, BLOCK)[:, None] * (2 * np.arange(BLOCK) + 1)) * (2.0 / BLOCK) ** 0.5
).astype(np.float32)
# Edges in opacity count too: black on nothing has edges.
SEEN = np.append(LUMA, 0.7).astype(np.float32)
# px: a narrower blur is the way in which programs smooth edges, or the effect of a JPEG on them.
LEAST_BLUR, LEAST_BLUR_OF_JPEG = 0.35, 0.6
NEAR_EDGES = 2.0  # times as much as elsewhere, by which the pixels of a JPEG are off a few px from edges
# Fewer different blends do not tell. Of the blends in pictures of 16 or 32 colours, 0.3 to 0.85 are rounded off their
# lines, unless the palette holds them all, and in those of 64 up to 0.7; in plain drawings at most 0.18.
FEWEST_BLENDS, ROUNDED = 20, 0.25
NEARLY = 1.0  # levels by which another colour may be nearer to a blend: palettes are not searched exactly


@dataclass(frozen=True)
class Condition:
    """The degradation of a picture.

    noise: its standard deviation in levels away from edges, 0 for none. jpeg: True if the picture has the blocks of a
    JPEG, or rings like one or a lossy WebP. blur: standard deviation in px of the blur of edges beyond their pixels, 0
    for none. coarse: True if the noise of neighbours is alike: that of a paper's grain, or of colours that drift.
    aliased: True if edges are steps of whole pixels. sharpened: True if edges ring, but for halos that are undone.
    halved: the axes along which a JPEG's chroma is stored at half its size, 0 for rows and 1 for columns; both, unless
    its file says otherwise. rounded: True if the noise is that of blends whose colours were rounded to a few.
    """

    noise: float = 0.0
    jpeg: bool = False
    blur: float = 0.0
    coarse: bool = False
    aliased: bool = False
    sharpened: bool = False
    halved: tuple[int, ...] = (0, 1)
    rounded: bool = False

    @property
    def clean(self) -> bool:
        """True if there is no noise, compression or blur."""
        return not (self.noise or self.jpeg or self.blur)

    @property
    def share_error(self) -> float:
        """Standard deviation of the share of a pixel that a shape covers, from the number of samples a pixel."""
        return ONE_SAMPLE if self.aliased else FEW_SAMPLES

    @property
    def only_blurred(self) -> bool:
        """True if there is a blur, and no noise."""
        return self.blur > 0.0 and not (self.noise or self.jpeg)

    def error_of_mean(self, count: int) -> float:
        """Levels by which the mean of so many neighbours is off: as much as each of them where their noise is alike."""
        return self.noise if self.jpeg or self.coarse else self.noise / math.sqrt(count)

    @property
    def edge_error(self) -> float:
        """Levels by which pixels on edges are off. A JPEG's ringing there is 8 times its noise elsewhere. Coarse noise
        counts 5 times, because it is alike over 1.5 px, and 5 pixels say no more than one.
        """
        return self.noise * (8.0 if self.jpeg else 5.0 if self.coarse else 1.0)

    @property
    def restored_error(self) -> float:
        """Levels by which pixels on edges are off in the restored picture, by 16 for each px of blur removed."""
        return math.hypot(self.edge_error, 16.0 * self.blur)

    @property
    def description(self) -> str:
        """The degradation in words, as part of a sentence; empty if the picture is clean."""
        parts = [f"a blur of {self.blur:.1f} px"] if self.blur else []
        if self.jpeg:
            parts.append(f"compression artefacts of {self.noise:.1f} levels")
        elif self.rounded:
            parts.append("the rounding of its edges to few colours")
        elif self.noise:
            parts.append(f"noise of {self.noise:.1f} levels")
        return " and ".join(parts)


def condition_of(levels: np.ndarray, *, lossy: bool = False) -> Condition:
    """Return the condition of a picture. lossy: True if its file has loss, which a rough pixel suffices to show."""
    if min(levels.shape[:2]) < (BLOCK if lossy else 2 * BLOCK):
        return Condition()
    second = second_differences(levels)
    spans = spread(levels, 5, 5)
    quiet = _quiet(spans)
    if not quiet.any():
        return Condition()
    # Spans within those of an even area, such as dither between two neighbouring levels, are no noise.
    everywhere = (spans[quiet] > FLAT_RANGE).mean() > 0.5 and not _even_everywhere(levels)
    noise = _white_noise(second[quiet]) if everywhere else 0.0
    rough = quiet & (second >= ROUGH)
    jpeg = bool(rough.any()) if lossy else _compressed(levels, rough, spans, quiet, noise)
    drift = 0.0 if noise else _drift(levels, compressed=jpeg)
    if drift:
        noise = drift
    elif noise and not jpeg:
        whole = ~ndimage.binary_dilation(_cut_off(levels[..., :3]), np.ones((5, 5), dtype=bool))
        noise = max(noise, _white_noise(second[whole][_quiet(spans[whole])]))
    if jpeg:
        near = quiet & (ndimage.uniform_filter(rough.astype(np.float32), BLOCK + 1) > 0.0)
        # 1.7: root of the mean square of the largest of six normal deviates (two directions, three channels).
        noise = max(noise, float(np.sqrt((second[near] ** 2).mean())) / (SECOND * 1.7))
    blur = edge_blur(levels, noise * (NEAR_EDGES if jpeg else 1.0)) or 0.0
    blur = blur if blur >= (LEAST_BLUR_OF_JPEG if jpeg else LEAST_BLUR) else 0.0
    condition = Condition(noise, jpeg, blur, coarse=drift > 0.0)
    return replace(condition, aliased=condition.clean and aliased(levels))


def _white_noise(second: np.ndarray) -> float:
    """Return the standard deviation of white noise, in levels, from second differences (n,) away from edges; 0 if it is
    below 0.7 levels, which rounding and dither do not reach.
    """
    # 1.56: median of the largest of six normal deviates (two directions, three channels).
    noise = float(np.median(second)) / (SECOND * 1.56) if len(second) else 0.0
    return noise if noise >= 0.7 else 0.0


def _even_everywhere(levels: np.ndarray) -> bool:
    """Return True if nearly all pixels have 3 x 3 px that are exactly alike nearby, as between the lines of a grid."""
    return bool(ndimage.maximum_filter(spread(levels, 3, 3) == 0.0, 2 * BLOCK + 1).mean() >= 0.9)


def _cut_off(colours: np.ndarray) -> np.ndarray:
    """Return (...) bool: True for colours (..., 3) at an end of the scale in all channels, where noise is cut off."""
    return np.asarray(((colours <= 0.0) | (colours >= 255.0)).all(axis=-1))


def _drift(levels: np.ndarray, *, compressed: bool) -> float:
    """Return the standard deviation, in levels, of noise that drifts, alike over several px, as in the pictures of
    generators and in those made smaller after a loss; 0 unless nearly all blocks without edges are off the planes
    fitted to them by more than rounding leaves.
    """
    blocks = in_blocks(levels[..., :3], PLANE)
    blocks = blocks.reshape(*blocks.shape[:2], PLANE**2, 3)
    spans = np.ptp(blocks, axis=2).max(axis=2)
    even = (spans < APART) & ~_cut_off(blocks).any(axis=2)
    if compressed:  # whose errors reach from edges into the next block
        even &= ndimage.binary_erosion(spans < APART, ndimage.SQUARE)
    if even.sum() < FEWEST or np.median(spans[even]) <= FLAT_RANGE:
        return 0.0
    blocks = blocks[even]
    blocks = blocks - blocks.mean(axis=1, keepdims=True)
    line = np.arange(PLANE) - 0.5 * (PLANE - 1)
    ways = np.stack([np.repeat(line, PLANE), np.tile(line, PLANE)]).astype(np.float32) / np.sqrt(PLANE * line @ line)
    squares = (blocks**2).sum(axis=(1, 2)) - ((ways @ blocks) ** 2).sum(axis=(1, 2))
    off = np.sqrt(np.maximum(squares, 0.0) / (3 * (PLANE**2 - 3)))
    # Rounding makes 0.29 levels, and 0.22 in the flattest places of clean gradients. Planes follow half of the noise.
    return 2.0 * float(np.median(off)) if np.quantile(off, 0.05) >= 0.35 else 0.0


def _quiet(spans: np.ndarray) -> np.ndarray:
    """Return the pixels away from edges, bool, by the ranges of values in 5 x 5 px around pixels, in levels. The limit
    grows until half of the pixels keep it, for noise: 25 normal deviates span 4.5 of their standard deviations in the
    widest of three channels.
    """
    masks = [spans < limit for limit in (APART, 2.0 * APART, 4.0 * APART)]
    quiet = next((mask for mask in masks if 2 * mask.sum() > mask.size), masks[0])
    return quiet if quiet.sum() > 2 * masks[0].sum() else masks[0]


def _compressed(levels: np.ndarray, rough: np.ndarray, spans: np.ndarray, quiet: np.ndarray, noise: float) -> bool:
    """Return True if a picture's fills ripple, or it has the blocks of a JPEG, or, without noise everywhere, rings like
    one or a lossy WebP.

    rough, quiet: (H, W) bool; spans: as of `_quiet`. Only pixels near edges count, so that wide margins change nothing:
    of those in nine of ten clean pictures at most 0.018 are rough, in JPEGs and WebPs of quality 60 to 98 over 0.05.
    """
    near = quiet & ndimage.maximum_filter(~quiet, BLOCK + 1)
    rough = rough & near
    ripples = _rippled(levels, rough, spans, quiet) and _everywhere(rough, near)
    if not ripples and rough.sum() <= 0.02 * near.sum():
        return False
    luma, opaque, colours = levels @ SEEN, bool((levels[..., 3] >= 255.0).all()), levels[..., :3]
    # A GIF or a palette has at most 256 colours, not all grey, whose rounding makes a picture rough.
    indexed = bool((colours != colours[..., :1]).any()) and are_few(packed(colours), MOST_COLORS)
    coefficients = _coefficients(luma, 0)
    # Ringing leaves 3 x 3 px alike in hardly any block with an edge: in at most 0.05 of them in JPEGs of quality 60 to
    # 98, in at most 0.5 in nine of ten WebPs and 0.77 in all, and in 0.5 to 1 in clean pictures. Pale stripes, text on
    # a grid of 8 px and rounded shadows look like blocks or ringing otherwise; so do small gradients, over nothing, and
    # the faint lines of plots like ripples.
    even = _even_blocks(levels, _busy(coefficients))
    if even >= (0.5 if opaque else 0.33):
        return ripples and not indexed and even < 0.8
    if ripples or (opaque and _blocky(coefficients, luma)):
        return True
    return not (noise or indexed) and _rings(levels, rough, near) and _everywhere(rough, near)


def _everywhere(rough: np.ndarray, near: np.ndarray) -> bool:
    """Return True if nearly all places, of 32 px, are rough near their edges, (H, W) bool, as the whole picture's
    compression leaves them, and not the photographs in a screenshot.

    In nine of ten JPEGs and WebPs of quality 70 to 97, of half the size or saved as PNG too, at most 0.2 of the pixels
    near edges are in smooth places, and in 0.98 of them at most 0.35; in nine of ten screenshots with a photograph or a
    map 0.15 and more, in half of them 0.43.
    """
    counts = [ndimage.uniform_filter(mask.astype(np.float32), 32) for mask in (rough, near)]
    smooth = near & (counts[0] <= 0.01 * counts[1])
    return bool(smooth.sum() <= 0.25 * near.sum())


def rippled(levels: np.ndarray) -> bool:
    """Return True if a picture's fills ripple as a compression with loss leaves them."""
    spans = spread(levels, 5, 5)
    return _rippled(levels, second_differences(levels) >= ROUGH, spans, _quiet(spans))


def _rippled(levels: np.ndarray, rough: np.ndarray, spans: np.ndarray, quiet: np.ndarray) -> bool:
    """Return True if a picture's fills ripple 5 to 8 px from edges, beyond the filters that make pictures smaller.
    rough, spans, quiet: as of `_compressed`.

    In clean pictures, and in those reduced by Lanczos' filter, at most 0.008 of the pixels there that are nearly of a
    fill do; in nine of ten JPEGs and WebPs of quality 70 to 90 0.02 to 0.4, of half the size or saved as PNG too.
    """
    far = quiet & ndimage.maximum_filter(~quiet, BLOCK + 1) & ~ndimage.maximum_filter(~quiet, 5)
    rough = rough & far
    swinging = _swinging(levels, rough)[far]
    if swinging.sum() <= RIPPLED * FEWEST_TELL:
        return False
    low, high = (extreme(levels, (3, 3, 1))[far] for extreme in (ndimage.minimum_filter, ndimage.maximum_filter))
    of_fill = np.zeros(len(low), dtype=bool)
    for fill in commonest(levels[spans == 0.0], MOST_PALETTE, FEWEST):
        of_fill |= largest(np.maximum(high - fill, fill - low)) <= RIPPLE
    return bool((of_fill & swinging).sum() > RIPPLED * max(of_fill.sum(), FEWEST_TELL))


def _blocky(coefficients: np.ndarray, luma: np.ndarray) -> bool:
    """Return True if coefficients of blocks are nearly 0 more often than those half a block away: by a quarter in at
    least 20 blocks, and by more than chance.
    """
    own, number = _zeros(coefficients)
    apart, _ = _zeros(_coefficients(luma, BLOCK // 2))
    return number >= 20 and own > 1.25 * apart and (own - apart) * number**0.5 > 0.8


def _zeros(coefficients: np.ndarray) -> tuple[float, int]:
    """Return the share of coefficients (n, 7, 7) below 1.2 levels in blocks with edges, and the number of these."""
    busy = coefficients[_busy(coefficients)]
    return (float((busy < 1.2).mean()), len(busy)) if len(busy) else (0.0, 0)


def _coefficients(luma: np.ndarray, start: int) -> np.ndarray:
    """Return (n, 7, 7) the sizes of the DCT's coefficients, but for those along rows or columns alone, which level
    edges have in any block: of the blocks from a row and column on.
    """
    return np.abs(WAVES @ in_blocks(luma[start:, start:], BLOCK).reshape(-1, BLOCK, BLOCK) @ WAVES.T)


def _busy(coefficients: np.ndarray) -> np.ndarray:
    """Return (n,) bool: True for blocks with edges, which have a coefficient (n, 7, 7) above 12 levels."""
    return coefficients.max(axis=(1, 2), initial=0.0) > 12.0


def _even_blocks(levels: np.ndarray, busy: np.ndarray) -> float:
    """Return the share of busy blocks (n,) bool with 3 x 3 px that are exactly alike, and not clear; 0 without any."""
    alike = (levels[..., 3] > 0.0) & (spread(levels, 3, 3) == 0.0)
    inner = in_blocks(alike, BLOCK).reshape(-1, BLOCK, BLOCK)[busy, 1:-1, 1:-1]
    return float(inner.any(axis=(1, 2)).mean()) if inner.size else 0.0


def _rings(levels: np.ndarray, rough: np.ndarray, near: np.ndarray) -> bool:
    """Return True if rough pixels go up and down near edges, (H, W) bool, in a picture without blur, which looks alike.

    WebPs and small JPEGs may ring without showing blocks: 0.1 and more of the pixels in eight of ten WebPs, and in nine
    of ten reduced JPEGs, but in one of a hundred clip arts with soft shading.
    """
    swinging = bool(_swinging(levels, rough).sum() >= 0.1 * near.sum())
    return swinging and (edge_blur(levels, cut=False) or 0.0) < LEAST_BLUR_OF_JPEG


def _swinging(levels: np.ndarray, rough: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: the rough pixels (H, W) bool with a second difference whose sign differs from that of its
    neighbours' sum, since soft shading goes on bending the same way.
    """
    out = np.zeros(rough.shape, dtype=bool)
    for part, some, lines in ((out, rough, levels[..., :3]), (out.T, rough.T, levels[..., :3].swapaxes(0, 1))):
        y, x = np.nonzero(some[2:-2])
        near = lines[y[:, None] + np.arange(5), x[:, None]]
        bends = near[:, 2:] - 2.0 * near[:, 1:-1] + near[:, :-2]
        here, beside = bends[:, 1], bends[:, 0] + bends[:, 2]
        part[2:-2][y, x] |= ((np.abs(here) >= ROUGH) & (here * beside <= 0.0)).any(axis=-1)
    return out


def edge_blur(levels: np.ndarray, noise: float = 0.0, *, cut: bool = True) -> float | None:
    """Return the standard deviation in px of the blur of a picture's edges beyond their pixels; None if too few edges
    can be measured, and 0 if a quarter of them are sharper than the median by more than a third. cut: as in
    `_variances`.

    At most EXAMINED edges are measured each way; their pixels may be off the line between the colours that they blend
    by a share of the contrast.
    """
    variances = _variances(levels, noise, cut=cut)
    if len(variances) < FEWEST:
        return None
    quarter, half, rest = np.maximum(np.quantile(variances, [0.25, 0.5, 0.75]), 0.0)
    # Where some edges are sharp the lower quartile is farther off the median.
    spread_by_noise = noise > 0.0 and half - quarter <= 2.0 * (rest - half)
    return math.sqrt(half) if quarter >= 4.0 / 9.0 * half or spread_by_noise else 0.0


def blurred_everywhere(levels: np.ndarray) -> bool:
    """Return True if nearly all edges of a blurred picture are as wide as its median edge, but for a quarter. Those of
    a shape that casts a soft shadow are sharper. False if too few edges can be measured.
    """
    variances = _variances(levels, 0.0)
    if len(variances) < FEWEST:
        return False
    few, half = np.quantile(variances, [0.05, 0.5])
    return bool(few >= 9.0 / 16.0 * half)


def _variances(levels: np.ndarray, noise: float, *, cut: bool = True) -> np.ndarray:
    """Return (n,) px^2, the variances of the blur of a picture's edges between places that are even but for noise, in
    levels. cut: of those cut off too, as between thin lines, where too few are not.
    """
    # The share of the contrast by which blends may be off their line: a grey outline between a light and a dark colour
    # is off by more than the lower one.
    off = 0.1 if noise else 0.03
    given = levels, levels @ SEEN, EXAMINED, max(2.0, 3.0 * noise), CONTRAST, off
    whole = edge_variances(*given)
    return edge_variances(*given, cut=True) if cut and len(whole) < FEWEST else whole


def rounding_noise(levels: np.ndarray) -> float:
    """Return the noise, in levels, that the rounding of a picture to a few colours without dither, as in GIFs and PNGs
    with a short palette, makes of blends; 0 if it was not rounded, or by little.

    A pixel on an edge should lie on the line between the colours that it blends. Rounded, it has the one of the few
    that is nearest to the blend, and its distance from the line shows the error of all blends. A uniform error of
    standard deviation s ends at sqrt(3) s. `restore` expects that noise, and its MISFIT, end at OUTLIER times theirs.
    """
    numbers = packed(np.rint(levels))
    kinds, counts = np.unique(np.concatenate([_blends(numbers), _blends(numbers.T)]), axis=0, return_counts=True)
    first, value, last = (unpacked(column) for column in kinds.T)
    share, off = blend_of(value, first, last)
    error = np.linalg.norm(off, axis=-1)
    wide = np.linalg.norm(last - first, axis=-1) > CONTRAST
    if wide.sum() < FEWEST_BLENDS or (error[wide] > ROUGH).mean() < ROUNDED:
        return 0.0
    colours = np.unique(numbers)
    if len(colours) > MOST_COLORS:
        return 0.0
    from scipy.spatial import cKDTree  # takes a while to import, and few pictures come to it

    least, _ = cKDTree(unpacked(colours)).query(first + share[:, None] * (last - first))
    nearest = wide & (error <= least + NEARLY)
    if (nearest & (error > ROUGH)).sum() < ROUNDED * wide.sum():
        return 0.0
    # The error of a channel, of which two are off the line.
    deviation = float(np.sqrt(0.5 * np.average(error[nearest] ** 2, weights=counts[nearest])))
    return max(0.0, 3.0**0.5 * deviation / OUTLIER - MISFIT)


def _blends(numbers: np.ndarray) -> np.ndarray:
    """Return (n, 3): the colours of single pixels, between those of two runs of 2 px or more to the left and right of
    them, of a picture (H, W) in numbers for colours.
    """
    count = max(0, numbers.shape[1] - 4)
    before, left, middle, right, after = (numbers[:, k : k + count] for k in range(5))
    single = (before == left) & (left != middle) & (middle != right) & (right == after) & (left != right)
    return np.stack([left[single], middle[single], right[single]], axis=1)
