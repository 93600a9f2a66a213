"""How near results are to their picture: PSNR in dB, infinite for identical ones, and mean CIEDE2000."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import product

import numpy as np

from cubicsplat_cli.evaluate.images import ImageSource, of_picture, of_pixels, of_scene, of_values
from cubicsplat_cli.evaluate.metrics import decibels, psnr_db
from cubicsplat_cli.evaluate.perceptual import opaque_delta_e
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.load import Picture, resize_picture
from cubicsplat_cli.pipeline.task import Task
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.scene import AnyScene

LIKENESS_SIDE = 1024  # px of the longer side of the copy that is compared; fine lines count at this size
# dB by which the PSNR by tones must be higher for a drawing to be near enough. Edges a little off hardly change
# tones, whose PSNR is 8 dB or more higher then. Bands in place of soft shading change both alike.
TONES_DB = 5.0
COARSE = 8  # px of a window whose mean people see as one tone, as they see a JPEG's blocks


def file_db(task: Task, svg: str) -> float:
    """Return the PSNR of an SVG's text as another renderer draws it."""
    reference = task.reference
    return _level_db(task, reference, of_pixels(rerender(svg.encode(), reference.width, reference.height).pixels))


def level_db(task: Task, scene: AnyScene | None, samples: int, blur: float = 0.0) -> float:
    """Return the PSNR of a scene against the target, both at most LIKENESS_SIDE px wide and high; infinite without a
    scene. samples: edges per cubic. blur: px of the target by which its picture is blurred; the scene counts sharp or
    blurred alike, and its text with an LCD's colour fringes or without, whichever is nearer.
    """
    return max((_level_db(task, *pair) for pair in _pairs(task, scene, samples, blur)), default=math.inf)


def seen_db(task: Task, scene: AnyScene | None, samples: int, blur: float = 0.0, enough_db: float = math.inf) -> float:
    """Return the mean of a scene's PSNR by pixels and its PSNR by tones, which are means over squares of COARSE px.

    This is nearer to what people see: slightly misplaced edges do not hide missing shading or drifting tones. Infinite
    without a scene, and if the PSNR by pixels reaches `enough_db` and that by tones TONES_DB more. Other parameters as
    of `level_db`.
    """
    return max((_seen_db(task, *pair, enough_db) for pair in _pairs(task, scene, samples, blur)), default=math.inf)


def delta_e(task: Task, scene: AnyScene | None, samples: int, blur: float = 0.0) -> float:
    """Return the mean CIEDE2000 of a scene against the target, the larger one over black and over white; 0 without a
    scene. Parameters, and the copies of which the nearest counts, as of `level_db`.
    """
    return min((_delta_e(*pair) for pair in _pairs(task, scene, samples, blur)), default=0.0)


def _pairs(task: Task, scene: AnyScene | None, samples: int, blur: float) -> Iterable[tuple[Picture, ImageSource]]:
    """Return each copy of the target, with and without colour fringes if its text has these, with each of the engine's
    pictures of a scene at their size: sharp, and blurred if there is a blur. None without a scene.

    The scene is compressed as the target was, so that it is not blamed for artefacts that it lacks.
    """
    if scene is None:
        return ()
    pictures, threads = [resize_picture(each, LIKENESS_SIDE) for each in task.targets], task.request.settings.threads
    picture = pictures[0]
    sharp = of_scene(scene, picture.width, picture.height, samples, threads).rows(0, picture.height)
    drawn = [sharp]
    if blur:
        sigma = blur * picture.width / task.target.width
        drawn.append(ndimage.gaussian_filter(sharp, (sigma, sigma, 0.0), mode="nearest"))
    compression = picture.compression
    if compression is not None and compression.known:
        again = [compression.again(255.0 * values[..., :3]) / np.float32(255.0) for values in drawn]
        drawn = [np.concatenate([rgb, values[..., 3:]], axis=2) for rgb, values in zip(again, drawn, strict=True)]
    return product(pictures, map(of_values, drawn))


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
