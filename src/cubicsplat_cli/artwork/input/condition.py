"""The degradation of a picture since it was drawn, measured from its pixels.

Pictures are (H, W, 4) float32 premultiplied RGBA in levels of 0..255.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from cubicsplat_cli.artwork.channels import LUMA, in_blocks, packed
from cubicsplat_cli.artwork.regions.fills import FLAT_RANGE
from cubicsplat_cli.artwork.regions.sampling import FEW_SAMPLES, FEWEST, ONE_SAMPLE, aliased
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import edge_variances, second_differences, spread

# Levels: pixels whose 5 x 5 neighbours span less are away from edges, by the first of these limits that half of the
# picture keeps to (25 normal deviates span 5 of their standard deviations); a second difference that an even or shaded
# picture does not have.
QUIET, ROUGH = (24.0, 48.0, 96.0), 3.0
# Of a second difference of normal noise of 1: the standard deviation; and over that, of the largest one in two
# directions and three channels, the median and the root of the mean square.
SECOND, LARGER_MEDIAN, LARGER = 6.0**0.5, 1.56, 1.7
LEAST_NOISE = 0.7  # levels, which rounding and dither do not reach
# A JPEG has more coefficients below ZERO in its own blocks of 8 x 8 px than in those half a block away. Blocks count
# that have one above BUSY other than along rows or columns alone: level edges are the same everywhere.
BLOCK, ZERO, BUSY = 8, 1.2, 12.0
# The waves of a block's discrete cosine transform but the level one, each of squares that sum to 1.
_STEPS = np.arange(1, BLOCK)[:, None] * (2 * np.arange(BLOCK) + 1)
WAVES = (np.cos(math.pi / (2 * BLOCK) * _STEPS) * (2.0 / BLOCK) ** 0.5).astype(np.float32)
MORE_ZEROS, ERROR, FEWEST_BLOCKS = 1.25, 0.8, 20  # times as many; the difference times the root of their number
# The ringing leaves 3 x 3 px alike in hardly any block with an edge: in 0 to 0.05 of them in JPEGs of quality 60 to 98,
# in 0 to 0.5 in nine of ten WebPs, in 0.5 to 1 in clean pictures. Pale stripes and text on a grid of 8 px look like
# blocks otherwise, and what many soft shadows are rounded to looks like ringing; over nothing, so do small gradients.
MOST_EVEN, MOST_EVEN_CLEAR = 0.5, 0.33
# Of the quiet pixels within so many px of one that is not, which wide margins leave as they are, the share that is
# rough: up to 0.018 in nine of ten clean pictures, 0.05 and more in JPEGs and WebPs of quality 60 to 98.
NEAR, LEAST_ROUGH = 4, 0.02
# Or no blocks at all, as in a small JPEG or in WebP, whose blocks are of many sizes and smoothed: of these pixels the
# share where it goes up and down. 0.1 and more in nine of ten reduced JPEGs, and eight of ten WebPs; of clip art with
# soft shading one in a hundred.
LEAST_RINGING = 0.1
MOST_INDEXED = 256  # colours
# Opacity counts as well: black on nothing has edges.
SEEN = np.append(LUMA, 0.7).astype(np.float32)
# Edges whose width is measured: levels of contrast, and how many are looked at each way.
CONTRAST, MOST = 60.0, 24_000
OFF_LINE = 0.1  # of an edge's contrast, by which its pixels may be off the line between the colours that they blend
JPEG_EDGES = 8.0  # times the noise elsewhere
# Times the noise that pixels count as off by where it is alike over 1.5 px: so many of them tell as much as one.
COARSE = 5.0
# px: less is how programs smooth edges, or what a JPEG does to them. A quarter of the edges may be sharper by a third.
LEAST_BLUR, LEAST_BLUR_OF_JPEG, SHARPER = 0.35, 0.6, 2.0 / 3.0
# Levels, for each px of blur, by which edges are off that were made sharp again.
BLUR_ERROR = 16.0


@dataclass(frozen=True)
class Condition:
    """noise: its standard deviation in levels away from edges, 0 where there is none. jpeg: whether the picture has
    the blocks of a JPEG, or rings like one or a lossy WebP. blur: standard deviation in px of what edges are blurred
    by beyond their pixels, 0 for none. coarse: whether the noise is that of a paper's grain, alike over a px or two.
    aliased: whether edges are steps of whole pixels. halved: the axes along which the chroma of a JPEG was stored at
    half its size, 0 for rows and 1 for columns: both, but where its file says otherwise.
    """

    noise: float = 0.0
    jpeg: bool = False
    blur: float = 0.0
    coarse: bool = False
    aliased: bool = False
    halved: tuple[int, ...] = (0, 1)

    @property
    def clean(self) -> bool:
        return not (self.noise or self.jpeg or self.blur)

    @property
    def share_error(self) -> float:
        """Standard deviation of the shares of pixels that shapes cover, by the samples that these were drawn from."""
        return ONE_SAMPLE if self.aliased else FEW_SAMPLES

    @property
    def only_blurred(self) -> bool:
        """Return whether there is a blur, and no noise."""
        return self.blur > 0.0 and not (self.noise or self.jpeg)

    @property
    def edge_error(self) -> float:
        """Levels by which pixels on edges are off: much more than elsewhere in a JPEG."""
        return self.noise * (COARSE if self.coarse else JPEG_EDGES if self.jpeg else 1.0)

    @property
    def noise_of_means(self) -> float:
        """Levels of noise that the means of 3 x 3 px have: a third, but where those next to each other are alike."""
        return self.noise if self.jpeg or self.coarse else self.noise / 3.0

    @property
    def restored_error(self) -> float:
        """Levels by which pixels on edges are off in the restored picture."""
        return math.hypot(self.edge_error, BLUR_ERROR * self.blur)

    def words(self) -> str:
        """The degradation in words, as part of a sentence; empty where it is clean."""
        parts = [f"a blur of {self.blur:.1f} px"] if self.blur else []
        if self.jpeg:
            parts.append(f"compression artefacts of {self.noise:.1f} levels")
        elif self.noise:
            parts.append(f"noise of {self.noise:.1f} levels")
        return " and ".join(parts)


CLEAN = Condition()


def condition_of(levels: np.ndarray, *, lossy: bool = False) -> Condition:
    """The condition of a picture. lossy: whether its file says that it is compressed with loss, as it then is where it
    is rough at all.
    """
    if min(levels.shape[:2]) < (BLOCK if lossy else 2 * BLOCK):
        return CLEAN
    luma = levels @ SEEN
    second = second_differences(levels)
    spans = spread(levels, 5, 5)
    quiet = _quiet(spans)
    if not quiet.any():
        return CLEAN
    # What spans no more than an even area may, as dither between two neighbouring levels does, is no noise.
    noise = _usual(second[quiet]) if (spans[quiet] > FLAT_RANGE).mean() > 0.5 else 0.0
    rough = quiet & (second >= ROUGH)
    jpeg = bool(rough.any()) if lossy else _compressed(levels, luma, rough, quiet, noise)
    if noise and not jpeg:
        whole = _within(levels)
        noise = max(noise, _usual(second[whole][_quiet(spans[whole])]))
    if jpeg:
        near = quiet & (ndimage.uniform_filter(rough.astype(np.float32), BLOCK + 1) > 0.0)
        noise = max(noise, float(np.sqrt((second[near] ** 2).mean())) / (SECOND * LARGER))
    blur = edge_blur(levels, noise) or 0.0
    condition = Condition(noise, jpeg, blur if blur >= (LEAST_BLUR_OF_JPEG if jpeg else LEAST_BLUR) else 0.0)
    return replace(condition, aliased=condition.clean and aliased(levels))


def _usual(second: np.ndarray) -> float:
    """Levels of noise, by second differences (n,) away from edges; 0 where they are no more than rounding."""
    noise = float(np.median(second)) / (SECOND * LARGER_MEDIAN) if len(second) else 0.0
    return noise if noise >= LEAST_NOISE else 0.0


def _within(levels: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels whose noise is whole, since nothing near is at an end of the scale in all channels."""
    colours = levels[..., :3]
    ends = np.all((colours <= 0.0) | (colours >= 255.0), axis=2)
    return ~ndimage.binary_dilation(ends, np.ones((5, 5), dtype=bool))


def _quiet(spans: np.ndarray) -> np.ndarray:
    """Return the pixels away from edges, bool. spans: the range of values around each pixel, in levels, which is larger
    in pictures full of noise or dithering.
    """
    least = spans < QUIET[0]
    found = next((quiet for quiet in (spans < limit for limit in QUIET) if 2 * quiet.sum() > quiet.size), least)
    return found if found.sum() > 2 * least.sum() else least


def _compressed(levels: np.ndarray, luma: np.ndarray, rough: np.ndarray, quiet: np.ndarray, noise: float) -> bool:
    """True if a picture has the blocks of a JPEG, or, without noise everywhere, rings like one or a lossy WebP."""
    near = quiet & ndimage.maximum_filter(~quiet, 2 * NEAR + 1)
    if rough[near].sum() <= LEAST_ROUGH * near.sum():
        return False
    opaque, found = bool((levels[..., 3] >= 255.0).all()), _coefficients(luma, 0)
    if _even(levels, _busy(found)) >= (MOST_EVEN if opaque else MOST_EVEN_CLEAR):
        return False
    return (opaque and _blocky(found, luma)) or (not noise and not _indexed(levels) and _rings(levels, rough, near))


def _blocky(found: np.ndarray, luma: np.ndarray) -> bool:
    """True if the coefficients of a picture's blocks, found, are nearly 0 more often than those half a block away."""
    own, number = _zeros(found)
    apart, _ = _zeros(_coefficients(luma, BLOCK // 2))
    return number >= FEWEST_BLOCKS and own > MORE_ZEROS * apart and (own - apart) * number**0.5 > ERROR


def _zeros(coefficients: np.ndarray) -> tuple[float, int]:
    """The share of coefficients (n, 7, 7) that are nearly 0 in blocks with edges; and how many blocks these are."""
    found = coefficients[_busy(coefficients)]
    return (float((found < ZERO).mean()), len(found)) if len(found) else (0.0, 0)


def _coefficients(luma: np.ndarray, start: int) -> np.ndarray:
    """(n, 7, 7) the sizes of those other than along rows or columns alone, of the blocks from a row and column on."""
    return np.abs(WAVES @ in_blocks(luma[start:, start:], BLOCK).reshape(-1, BLOCK, BLOCK) @ WAVES.T)


def _busy(coefficients: np.ndarray) -> np.ndarray:
    """(n,) bool: the blocks with edges, by their coefficients."""
    return coefficients.max(axis=(1, 2), initial=0.0) > BUSY


def _even(levels: np.ndarray, busy: np.ndarray) -> float:
    """The share of blocks with edges in which some 3 x 3 px are exactly alike, and not clear; 0 without such blocks.

    busy: (n,) bool, which of the blocks have edges.
    """
    alike = (levels[..., 3] > 0.0) & (spread(levels, 3, 3) == 0.0)
    found = in_blocks(alike, BLOCK).reshape(-1, BLOCK, BLOCK)[busy, 1:-1, 1:-1]
    return float(found.any(axis=(1, 2)).mean()) if found.size else 0.0


def _indexed(levels: np.ndarray) -> bool:
    """True if a picture has no more colours than a GIF or a PNG with a palette, which is rough by rounding, and more
    than grey."""
    colours = levels[..., :3]
    return bool((colours != colours[..., :1]).any()) and len(np.unique(packed(colours))) <= MOST_INDEXED


def _rings(levels: np.ndarray, rough: np.ndarray, near: np.ndarray) -> bool:
    """Return whether rough pixels go up and down near edges, in a picture that is not blurred, which reaches as far."""
    if (rough & _swinging(levels))[near].sum() < LEAST_RINGING * near.sum():
        return False
    return (edge_blur(levels) or 0.0) < LEAST_BLUR_OF_JPEG


def _swinging(levels: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels with a rough second difference of another sign than those beside it together have: what soft
    shading bends goes on bending the same way.
    """
    out = np.zeros(levels.shape[:2], dtype=bool)
    for found, lines in ((out, levels[..., :3]), (out.T, levels[..., :3].swapaxes(0, 1))):
        bends = lines[2:] - 2.0 * lines[1:-1] + lines[:-2]
        here, beside = bends[1:-1], bends[2:] + bends[:-2]
        found[2:-2] |= ((np.abs(here) >= ROUGH) & (here * beside <= 0.0)).any(axis=-1)
    return out


def edge_blur(levels: np.ndarray, noise: float = 0.0) -> float | None:
    """px that the edges of a picture are wider than by their pixels, None where too few are fit to measure it."""
    even = max(2.0, 3.0 * noise)
    found = edge_variances(levels, levels @ SEEN, MOST, even, CONTRAST, OFF_LINE)
    if len(found) < FEWEST:
        return None
    least, usual = np.sqrt(np.maximum(np.quantile(found, [0.25, 0.5]), 0.0))
    return float(usual) if least >= SHARPER * usual else 0.0
