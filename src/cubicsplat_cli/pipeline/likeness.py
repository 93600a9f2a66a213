"""How near results are to their picture: PSNR in dB, infinite for identical ones, and mean CIEDE2000."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import chain, product

import numpy as np
from PIL import Image

from cubicsplat_cli.evaluate.images import ImageSource, of_picture, of_pixels, of_scene, of_values
from cubicsplat_cli.evaluate.metrics import decibels, psnr_db
from cubicsplat_cli.evaluate.perceptual import opaque_delta_e
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.load import Picture, resampled, resize_picture, with_levels
from cubicsplat_cli.pipeline.task import Drawn, Task
from cubicsplat_cli.raster import ndimage

LIKENESS_SIDE = 1024  # px of the longer side of the copy that is compared; fine lines count at this size
# dB by which the PSNR by tones must be higher for a drawing to be near enough. Edges a little off hardly change
# tones, whose PSNR is 8 dB or more higher then. Bands in place of soft shading change both alike.
TONES_DB = 5.0
COARSE = 8  # px of a window whose mean people see as one tone, as they see a JPEG's blocks


def file_db(task: Task, svg: str) -> float:
    """Return the PSNR of an SVG's text as another renderer draws it."""
    reference = task.reference
    return _level_db(task, reference, of_pixels(rerender(svg.encode(), reference.width, reference.height).pixels))


def level_db(task: Task, made: Drawn) -> float:
    """Return the PSNR of a scene against the target, both at most LIKENESS_SIDE px wide and high; infinite without a
    scene. It counts sharp or blurred alike, against the target or the small one, and its text with an LCD's colour
    fringes or without, whichever is nearer.
    """
    return max((_level_db(task, *pair) for pair in _pairs(task, made)), default=math.inf)


def seen_db(task: Task, made: Drawn, enough_db: float = math.inf) -> float:
    """Return the mean of a scene's PSNR by pixels and its PSNR by tones, which are means over squares of COARSE px.

    This is nearer to what people see: slightly misplaced edges do not hide missing shading or drifting tones. Infinite
    without a scene, and if the PSNR by pixels reaches `enough_db` and that by tones TONES_DB more.
    """
    return max((_seen_db(task, *pair, enough_db) for pair in _pairs(task, made)), default=math.inf)


def seen_db_of(task: Task, pixels: np.ndarray) -> float:
    """Return the level, see `seen_db`, of other pixels of the target, (H, W, 4) float32, premultiplied in [0, 1]."""
    copies = task.once(compared_copies)
    drawn = resampled(pixels, (copies[0].width, copies[0].height), Image.Resampling.BOX)
    return max(_seen_db(task, *pair, math.inf) for pair in _beside(copies, [drawn]))


def delta_e(task: Task, made: Drawn) -> float:
    """Return the mean CIEDE2000 of a scene against the target, the larger one over black and over white; 0 without a
    scene. The nearest of the copies counts, as of `level_db`.
    """
    return min((_delta_e(*pair) for pair in _pairs(task, made)), default=0.0)


def _pairs(task: Task, made: Drawn) -> Iterable[tuple[Picture, ImageSource]]:
    """Return `_beside` of a scene's picture, also blurred, and pairs with the small target; none without a scene."""
    scene, small = made.scene, made.small
    if scene is None:
        return ()

    def drawn(copy: Picture) -> list[np.ndarray]:
        pixels = [of_scene(scene, *copy.size, made.samples, task.request.settings.threads).rows(0, copy.height)]
        if made.blur:
            sigma = made.blur * copy.width / task.target.width
            pixels.append(ndimage.gaussian_filter(pixels[0], (sigma, sigma, 0.0), mode="nearest"))
        return pixels

    copies = task.once(compared_copies)
    pairs = _beside(copies, drawn(copies[0]))
    return pairs if small is None else chain(pairs, product([small], map(of_values, drawn(small))))


def compared_copies(task: Task) -> list[Picture]:
    """Return the target, and a copy without colour fringes and halos if it has any, at the size that is compared."""
    found, (plain, notes) = [task.target], task.once(plain_picture)
    if notes:
        found.append(with_levels(task.target, plain))
    return [resize_picture(each, LIKENESS_SIDE) for each in found]


def plain_picture(task: Task) -> tuple[np.ndarray, list[str]]:
    """Return the target's levels, (H, W, 4), without colour fringes and halos, and notes on these."""
    from cubicsplat_cli.artwork.input.prepare import as_levels, without_filters  # cells may do without

    return without_filters(as_levels(task.pixels), lossy=task.target.compression is not None)


def _beside(copies: Sequence[Picture], drawn: Sequence[np.ndarray]) -> Iterable[tuple[Picture, ImageSource]]:
    """Return each copy of the target with each picture of it, (H, W, 4) premultiplied in [0, 1]. The pictures are
    compressed as the target was, so that they are not blamed for artefacts that they lack.
    """
    compression = copies[0].compression
    if compression is not None and compression.known:
        drawn = [compression.again(255.0 * values) / np.float32(255.0) for values in drawn]
    return product(copies, map(of_values, drawn))


def _seen_db(task: Task, picture: Picture, drawn: ImageSource, enough_db: float) -> float:
    pixels_db = _level_db(task, picture, drawn)
    off = np.subtract(*map(_over_black_and_white, (of_picture(picture), drawn)))
    tones = np.square(ndimage.uniform_filter(off, (COARSE, COARSE, 1))).mean(axis=(0, 1))
    tones_db = decibels(max(float(tones[:3].mean()), float(tones[3:].mean()), 1e-12))
    return math.inf if min(pixels_db, tones_db - TONES_DB) >= enough_db else 0.5 * (pixels_db + tones_db)


def _delta_e(picture: Picture, drawn: ImageSource) -> float:
    sources = of_picture(picture), drawn
    pair = [np.rint(255.0 * np.clip(_over_black_and_white(each), 0.0, 1.0)).astype(np.uint8) for each in sources]
    # What is opaque looks alike over both.
    over = [slice(0, 3), slice(3, 6)] if any(each.transparent for each in sources) else [slice(0, 3)]
    return max(opaque_delta_e(pair[0][..., ground], pair[1][..., ground]) for ground in over)


def _level_db(task: Task, picture: Picture, drawn: ImageSource) -> float:
    level = psnr_db(picture, drawn, task.request.settings.threads)
    return math.inf if level is None else level


def _over_black_and_white(source: ImageSource) -> np.ndarray:
    """Return the colours of a picture over black, then over white, (H, W, 6)."""
    values = source.rows(0, source.height)
    alpha = values[..., 3:] if source.transparent else np.ones_like(values[..., :1])
    return np.concatenate([values[..., :3], values[..., :3] + 1.0 - alpha], axis=2)
