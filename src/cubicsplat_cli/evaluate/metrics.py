"""PSNR and SSIM of pictures against their reference, part by part: in bounded memory, on all cores, or scaled down."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import combinations

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.images import ImageSource, of_picture
from cubicsplat_cli.evaluate.rerender import MAX_SIDE
from cubicsplat_cli.files.load import Picture, resize_picture
from cubicsplat_cli.metrics import Quality
from cubicsplat_cli.raster.native import native
from cubicsplat_cli.settings import cpu_count

# Squared difference, far below half a step of 16 bits: smaller ones come from float arithmetic, not from the pictures.
IDENTICAL_SQUARE = 1e-12
_BAND = 64  # rows that one thread works on
STRIP_PIXELS = 2**20  # px read, or drawn, at a time
_CHANNELS = 3
# A rendering of so many px takes 4 bytes for each, the picture 12.
MAX_MEASURED_PIXELS = 2**25
# Seconds on a slow machine: to draw and measure a pixel and write its PNG (measured: 0.15 s a megapixel on two cores of
# 2.5 GHz); to import the renderer; and to make a pixel of a smaller copy.
_SECONDS_PER_PIXEL, _SECONDS_BEFORE, _SECONDS_PER_COPIED = 0.3e-6, 0.3, 0.05e-6
# So few px take hardly any time, so they are measured after a time limit too.
LEAST_PIXELS = 2**18
TAPS = 11  # of a window of SSIM
REACH = TAPS // 2  # px from the middle of a window to its edge


def compare(reference: Picture, candidate: ImageSource) -> Quality:
    """Return the quality of a picture: if either has transparency, the worse value of each metric over black and over
    white. Raises InputError if sizes differ.
    """
    return measure(reference, [candidate])[0][0]


def measure(
    reference: Picture, candidates: Sequence[ImageSource], threads: int | None = None, strip_pixels: int = STRIP_PIXELS
) -> tuple[list[Quality], float | None]:
    """Return the quality of each candidate, and the PSNR between the first two in dB (None for one candidate).

    The pictures are read once, in strips of about `strip_pixels`. threads: None for one per core; the figures do not
    depend on it. Raises InputError if sizes differ.
    """
    for candidate in candidates:
        if (candidate.height, candidate.width) != (reference.height, reference.width):
            first = f"{reference.source} is {reference.width} x {reference.height} px"
            second = f"the other picture {candidate.width} x {candidate.height} px"
            raise InputError(f"sizes differ: {first}, {second}; scale one of them first")
    layer, count = of_picture(reference), len(candidates)
    sums = _compared(layer, candidates, threads, strip_pixels, similarity=True)
    agreement = None if count < 2 else _worst_psnr(layer, sums[:, count])
    return [_quality(layer, sums[:, index]) for index in range(count)], agreement


def psnr_db(reference: Picture, candidate: ImageSource, threads: int | None = None) -> float | None:
    """Return the PSNR alone, in dB, of a candidate of the reference's size; None if no value differs."""
    layer = of_picture(reference)
    return _worst_psnr(layer, _compared(layer, [candidate], threads, STRIP_PIXELS, similarity=False)[:, 0])


def weighted_psnr_db(reference: Picture, candidate: ImageSource, weights: np.ndarray) -> float | None:
    """Return the PSNR in dB of squared errors weighted by weights (H, W), at least 0 and not all 0; the worse one over
    black and over white. None if no value with a weight differs.
    """
    layer = of_picture(reference)
    squares = dict.fromkeys((0.0, 1.0) if layer.transparent or candidate.transparent else (0.0,), 0.0)
    for top, bottom in _strips(layer):
        part, other = layer.rows(top, bottom), candidate.rows(top, bottom)
        for ground in squares:
            error = np.square(_planes(part, ground) - _planes(other, ground)).sum(0)
            squares[ground] += float((error * weights[top:bottom]).sum(dtype=np.float64))
    worst = max(squares.values()) / (_CHANNELS * float(weights.sum(dtype=np.float64)))
    return None if worst <= IDENTICAL_SQUARE else decibels(worst)


def decibels(mean_square: float) -> float:
    """Return the PSNR in dB of a mean squared error above 0, of values in [0, 1]."""
    return -10.0 * math.log10(mean_square)


def _compared(
    reference: ImageSource, candidates: Sequence[ImageSource], threads: int | None, strip_pixels: int, similarity: bool
) -> np.ndarray:
    """Compare the reference with each candidate, and each two candidates with one another.

    Returns (G, P, 3) float64 for G grounds, black and, if any picture has transparency, white, and P pairs: the sum of
    the squared differences, the largest of them, and the sum of SSIM over all windows and channels.
    """
    layers = [reference, *candidates]
    grounds = (0.0, 1.0) if any(layer.transparent for layer in layers) else (0.0,)
    totals = np.zeros((len(grounds), math.comb(len(layers), 2), 3))
    with ThreadPoolExecutor(threads or cpu_count()) as pool:
        for top, bottom in _strips(reference, strip_pixels):
            above, below = max(0, top - REACH), min(reference.height, bottom + REACH)
            parts = [layer.rows(above, below) for layer in layers]
            for ground, total in zip(grounds, totals, strict=True):
                first, last = top - above, bottom - above
                bands = [slice(row, min(last, row + _BAND)) for row in range(first, last, _BAND)]
                # In the order of the bands, whichever is done first: sums of floats depend on it.
                for sums in pool.map(partial(_sums_of, parts, ground, similarity), bands):
                    total[:, 1] = np.maximum(total[:, 1], sums[:, 1])
                    total[:, ::2] += sums[:, ::2]
    return totals


def _strips(layer: ImageSource, pixels: int = STRIP_PIXELS) -> Iterator[tuple[int, int]]:
    """Yield the first and last row of parts of the picture: whole bands, of about so many pixels."""
    rows = max(1, pixels // (layer.width * _BAND)) * _BAND
    for top in range(0, layer.height, rows):
        yield top, min(layer.height, top + rows)


def _sums_of(parts: Sequence[np.ndarray], ground: float, similarity: bool, band: slice) -> np.ndarray:
    """Return the sums (P, 3) of one band of a strip, see `_compared`; its windows have their middle on the band."""
    above = max(0, band.start - REACH)
    pictures = [_planes(part[above : band.stop + REACH], ground) for part in parts]
    inner = [picture[:, band.start - above : band.stop - above] for picture in pictures]
    squared = [np.square(first - second) for first, second in combinations(inner, 2)]
    sums = np.array([[squares.sum(dtype=np.float64), squares.max(), 0.0] for squares in squared])
    if similarity and min(pictures[0].shape[1:]) >= TAPS:
        # SSIM of Wang et al. (2004): Gaussian windows of sigma 1.5 cut to 11 x 11 taps, population covariance, data
        # range 1. All candidates share the smoothed reference.
        for channel in zip(*pictures, strict=True):
            values = np.zeros(len(channel) - 1)
            native("comparison", "cs_similarity", np.stack(channel), len(values), *channel[0].shape, values)
            sums[: len(values), 2] += values
    return sums


def _planes(part: np.ndarray, ground: float) -> np.ndarray:
    """Return the colours (3, h, w) of a part (h, w, 3 or 4) over a grey ground."""
    colours = np.array(np.moveaxis(part[..., :_CHANNELS], 2, 0), np.float32, order="C")
    if ground and part.shape[2] > _CHANNELS:
        colours += np.float32(ground) * (1 - part[..., _CHANNELS])
    return colours


def _worst_psnr(layer: ImageSource, sums: np.ndarray) -> float | None:
    """Return the smallest PSNR of a pair over its grounds, whose sums are (G, 3); None if no value differs."""
    values = _CHANNELS * layer.width * layer.height
    levels = (decibels(squares / values) for squares, largest, _ in sums.tolist() if largest > IDENTICAL_SQUARE)
    return min(levels, default=None)


def _quality(layer: ImageSource, sums: np.ndarray) -> Quality:
    """Return the worst metrics of a candidate over its grounds, whose sums are (G, 3)."""
    psnr = _worst_psnr(layer, sums)
    if psnr is None:
        return Quality(None, 1.0, True)
    if min(layer.width, layer.height) < TAPS:
        return Quality(psnr, None, False, f"the picture is smaller than the {TAPS} x {TAPS} window of SSIM")
    windows = _CHANNELS * (layer.width - 2 * REACH) * (layer.height - 2 * REACH)
    differing = sums[sums[:, 1] > IDENTICAL_SQUARE, 2]
    return Quality(psnr, float(differing.min()) / windows, False)


def seconds_to_measure(picture: Picture) -> float:
    """Return an upper bound of the seconds to draw and measure an SVG of the picture."""
    return _SECONDS_BEFORE + _SECONDS_PER_PIXEL * min(picture.width * picture.height, MAX_MEASURED_PIXELS)


def measurable(picture: Picture, seconds: float = math.inf, most: int = MAX_MEASURED_PIXELS) -> Picture:
    """Return the picture, or a smaller copy if no renderer can draw it, or the seconds are too few. most: px."""
    longer, pixels = max(picture.width, picture.height), picture.width * picture.height
    if seconds < seconds_to_measure(picture):
        spent = _SECONDS_BEFORE + _SECONDS_PER_COPIED * pixels
        most = min(most, max(LEAST_PIXELS, math.floor((seconds - spent) / _SECONDS_PER_PIXEL)))
    limit = min(MAX_SIDE, longer)
    if pixels > most:
        limit = min(limit, math.floor(longer * math.sqrt(most / pixels)))
    return resize_picture(picture, max(1, limit))
