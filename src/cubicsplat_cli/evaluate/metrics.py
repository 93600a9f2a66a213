"""PSNR and SSIM of pictures against their reference, part by part: in bounded memory, on all cores, or scaled down."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.images import ImageSource, of_picture, of_pixels, of_values
from cubicsplat_cli.evaluate.rerender import MAX_SIDE
from cubicsplat_cli.files.load import Picture, resize_picture
from cubicsplat_cli.metrics import Quality
from cubicsplat_cli.raster.cpu import native
from cubicsplat_cli.settings import cpu_count

# Far below half a step of 16 bits: differences under this come from float arithmetic, not from the pictures.
IDENTICAL_TOLERANCE = 1e-6
# What one thread works on at a time: small enough for a core's cache.
_TILE_HEIGHT, _TILE_WIDTH = 64, 256
STRIP_PIXELS = 2**20  # read, or drawn, at a time
_CHANNELS = 3
# A drawing of so many takes 4 bytes each, the picture 12.
MAX_MEASURED_PIXELS = 2**25
# What drawing, measuring and writing the PNG may take on a slow machine: measured 0.15 s a megapixel on two cores of
# 2.5 GHz; importing the renderer. A smaller copy is made of every pixel.
_SECONDS_PER_PIXEL, _SECONDS_BEFORE, _SECONDS_PER_COPIED = 0.3e-6, 0.3, 0.05e-6
# Takes no time to speak of, so it is measured whatever time is left.
LEAST_PIXELS = 2**18
TAPS = 11  # of a window of SSIM
REACH = TAPS // 2  # of a window from its middle, px


def compare(reference: Picture, candidate: np.ndarray) -> Quality:
    """Quality of a drawn picture, (H, W, 4) uint8 straight RGBA or (H, W, 3) uint8 RGB, against `reference`.

    Where either has transparency both are laid over black and over white, and the worse value of each measure
    is reported. Raises InputError when sizes differ.
    """
    return measure(reference, [of_pixels(candidate)])[0][0]


def compare_premultiplied(reference: Picture, candidate: np.ndarray) -> Quality:
    """Quality of a float picture, (H, W, 3) or premultiplied (H, W, 4) in [0, 1], as the engine renders it.

    Values are clipped to [0, 1] and not rounded to 8 bits. Raises InputError when sizes differ or a value is
    not finite.
    """
    return measure(reference, [of_values(candidate)])[0][0]


def measure(
    reference: Picture, candidates: Sequence[ImageSource], threads: int | None = None, strip_pixels: int = STRIP_PIXELS
) -> tuple[list[Quality], float | None]:
    """The quality of each candidate against `reference`, and the agreement of the first two (None: there is one).

    One pass over the pictures, in strips of about strip_pixels. threads: None for one per core; the figures are the
    same for any number. Raises InputError when sizes differ.
    """
    for each in candidates:
        if (each.height, each.width) != (reference.height, reference.width):
            raise InputError(
                f"sizes differ: {reference.source} is {reference.width} x {reference.height} px, the other picture "
                f"{each.width} x {each.height} px; scale one of them first"
            )
    grounds = _compared(of_picture(reference), candidates, similarity=True, threads=threads, strip_pixels=strip_pixels)
    qualities = [_worst([_quality(ground[i]) for ground in grounds]) for i in range(len(candidates))]
    between = [ground[len(candidates)] for ground in grounds if len(ground) > len(candidates)]
    return qualities, _worst_psnr(between)


def psnr_db(reference: Picture, candidate: ImageSource, threads: int | None = None) -> float | None:
    """PSNR alone, of a candidate of the reference's size; None when no value differs."""
    sums = _compared(of_picture(reference), [candidate], similarity=False, threads=threads)
    return _worst_psnr([ground[0] for ground in sums])


def weighted_psnr_db(reference: Picture, candidate: ImageSource, weights: np.ndarray) -> float | None:
    """PSNR from the mean of the squared errors weighted by weights (H, W), at least 0 and not all 0; the worse one over
    black and over white. None where no value that matters differs.
    """
    layer = of_picture(reference)
    total = _CHANNELS * float(weights.sum(dtype=np.float64))
    means = []
    for ground in (0.0, 1.0) if layer.transparent or candidate.transparent else (0.0,):
        squares = 0.0
        for top, bottom in _strips(layer):
            error = _planes(layer.rows(top, bottom), ground) - _planes(candidate.rows(top, bottom), ground)
            squares += float((np.square(error).sum(0) * weights[top:bottom]).sum(dtype=np.float64))
        means.append(squares / total)
    worst = max(means)
    return None if worst <= IDENTICAL_TOLERANCE**2 else decibels(worst)


def decibels(mean_square: float) -> float:
    """PSNR in dB of a mean squared error above 0, of values in [0, 1]."""
    return -10.0 * math.log10(mean_square)


@dataclass(eq=False)
class _Sums:
    """Sums over two pictures on one ground: values, squared differences and the largest of these; windows of SSIM."""

    values: int = 0
    squares: float = 0.0
    worst: float = 0.0
    windows: int = 0
    similarity: float = 0.0

    def add(self, other: _Sums) -> None:
        self.values += other.values
        self.squares += other.squares
        self.worst = max(self.worst, other.worst)
        self.windows += other.windows
        self.similarity += other.similarity

    @property
    def psnr_db(self) -> float | None:
        if self.worst <= IDENTICAL_TOLERANCE**2:
            return None
        return decibels(self.squares / self.values)


def _compared(
    reference: ImageSource,
    candidates: Sequence[ImageSource],
    *,
    similarity: bool,
    threads: int | None,
    strip_pixels: int = STRIP_PIXELS,
) -> list[list[_Sums]]:
    """For each ground, black and where anything is transparent white too: the sums of the reference with each
    candidate, and of each two candidates.
    """
    layers = [reference, *candidates]
    grounds = (0.0, 1.0) if any(layer.transparent for layer in layers) else (0.0,)
    pairs = len(layers) * (len(layers) - 1) // 2
    totals = [[_Sums() for _ in range(pairs)] for _ in grounds]
    with ThreadPoolExecutor(threads or cpu_count()) as pool:
        for top, bottom in _strips(reference, strip_pixels):
            above, below = max(0, top - REACH), min(reference.height, bottom + REACH)
            parts = [layer.rows(above, below) for layer in layers]
            for ground, total in zip(grounds, totals, strict=True):
                work = [
                    pool.submit(_tile, parts, ground, rows, columns, similarity)
                    for rows, columns in _tiles(top - above, bottom - above, reference.width)
                ]
                # In the order of the tiles, whichever is done first: sums of floats depend on it.
                for done in work:
                    for sums, more in zip(total, done.result(), strict=True):
                        sums.add(more)
    return totals


def _strips(layer: ImageSource, pixels: int = STRIP_PIXELS) -> Iterator[tuple[int, int]]:
    """First and last row of parts of the picture: whole tiles, of about as many pixels as are read at a time."""
    rows = max(1, pixels // (layer.width * _TILE_HEIGHT)) * _TILE_HEIGHT
    for top in range(0, layer.height, rows):
        yield top, min(layer.height, top + rows)


def _tiles(top: int, bottom: int, width: int) -> Iterator[tuple[slice, slice]]:
    for row in range(top, bottom, _TILE_HEIGHT):
        for column in range(0, width, _TILE_WIDTH):
            yield slice(row, min(bottom, row + _TILE_HEIGHT)), slice(column, min(width, column + _TILE_WIDTH))


def _tile(parts: Sequence[np.ndarray], ground: float, rows: slice, columns: slice, similarity: bool) -> list[_Sums]:
    """The sums of one tile of a strip; windows are those whose middle lies on it."""
    height, width = parts[0].shape[:2]
    tall = slice(max(0, rows.start - REACH), min(height, rows.stop + REACH))
    wide = slice(max(0, columns.start - REACH), min(width, columns.stop + REACH))
    pictures = [_planes(part[tall, wide], ground) for part in parts]
    inner = (
        slice(None),
        slice(rows.start - tall.start, rows.stop - tall.start),
        slice(columns.start - wide.start, columns.stop - wide.start),
    )
    squared = [np.square(first[inner] - second[inner]) for first, second in combinations(pictures, 2)]
    pairs = [_Sums(squares.size, float(squares.sum(dtype=np.float64)), float(squares.max())) for squares in squared]
    windows = (pictures[0].shape[1] - 2 * REACH, pictures[0].shape[2] - 2 * REACH)
    if similarity and min(windows) > 0:
        for channel in range(_CHANNELS):
            sums = similarity_sums(pictures[0][channel], [other[channel] for other in pictures[1:]])
            for each, more in zip(pairs, sums, strict=False):
                each.similarity += more
                each.windows += windows[0] * windows[1]
    return pairs


def _planes(part: np.ndarray, ground: float) -> np.ndarray:
    """(h, w, 3 or 4) to (3, h, w) over a grey ground."""
    colours = np.array(np.moveaxis(part[..., :_CHANNELS], 2, 0), np.float32, order="C")
    if ground and part.shape[2] > _CHANNELS:
        colours += np.float32(ground) * (1 - part[..., _CHANNELS])
    return colours


def _quality(sums: _Sums) -> Quality:
    psnr = sums.psnr_db
    if psnr is None:
        return Quality(None, 1.0, True)
    if not sums.windows:
        return Quality(psnr, None, False, f"the picture is smaller than the {TAPS} x {TAPS} window of SSIM")
    return Quality(psnr, sums.similarity / sums.windows, False)


def _worst(grounds: Sequence[Quality]) -> Quality:
    """The smallest value of each measure; None counts as perfect (PSNR) or unknown for all (SSIM)."""
    if all(each.identical for each in grounds):
        return grounds[0]
    psnr = min(each.psnr_db for each in grounds if each.psnr_db is not None)
    note = next((each.ssim_note for each in grounds if each.ssim_note is not None), None)
    similarities = [each.ssim for each in grounds if each.ssim is not None]
    return Quality(psnr, None if note is not None else min(similarities), False, note)


def _worst_psnr(grounds: Sequence[_Sums]) -> float | None:
    return min((each.psnr_db for each in grounds if each.psnr_db is not None), default=None)


def seconds_to_measure(picture: Picture) -> float:
    """An upper bound of the seconds that it takes to draw and measure an SVG of the picture."""
    return _SECONDS_BEFORE + _SECONDS_PER_PIXEL * min(picture.width * picture.height, MAX_MEASURED_PIXELS)


def measurable(picture: Picture, seconds: float = math.inf, most: int = MAX_MEASURED_PIXELS) -> Picture:
    """The picture, scaled down where no renderer could draw it, or where so many seconds do not suffice.

    most: pixels that memory suffices for.
    """
    longer, shorter = max(picture.width, picture.height), min(picture.width, picture.height)
    pixels = longer * shorter
    if seconds < seconds_to_measure(picture):
        spent = _SECONDS_BEFORE + _SECONDS_PER_COPIED * pixels
        most = min(most, max(LEAST_PIXELS, math.floor((seconds - spent) / _SECONDS_PER_PIXEL)))
    limit = min(MAX_SIDE, longer)
    if pixels > most:
        limit = min(limit, math.floor(longer * math.sqrt(most / pixels)))
    return resize_picture(picture, max(1, limit))


def similarity_sums(reference: np.ndarray, candidates: Sequence[np.ndarray]) -> list[float]:
    """For each candidate the sum of SSIM over the windows of one channel (Wang et al. 2004): Gaussian windows of sigma
    1.5 cut to 11 x 11 taps, population covariance, data range 1.

    All (H, W) float32 in [0, 1], H and W at least 11; there are (H - 10) * (W - 10) windows. Candidates are compared at
    once because what is smoothed of the reference then serves all of them. Raises EngineError where memory is missing.
    """
    sums = np.zeros(len(candidates))
    native("comparison", "cs_similarity", np.stack([reference, *candidates]), len(candidates), *reference.shape, sums)
    return sums.tolist()
