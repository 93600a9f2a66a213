"""Distance of a result from its picture: the levels by which photo and drawing are compared."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from cubicsplat_cli.evaluate.images import ImageSource, of_picture, of_pixels, of_scene, of_values
from cubicsplat_cli.evaluate.metrics import decibels, measurable, psnr_db
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.load import Picture, resize_picture
from cubicsplat_cli.pipeline.task import Task
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.scene import LayeredScene, Scene

LIKENESS_SIDE = 1024  # px of the longer side of the copy on which both are compared, where fine lines count
COARSE = 8  # px of a window whose mean people see as one tone, as they see a JPEG's blocks


class FileLevel:
    """Measures files of a task: their PSNR in dB as another renderer draws them, infinite where alike."""

    def __init__(self, task: Task) -> None:
        self.task = task

    @cached_property
    def _reference(self) -> Picture:
        return measurable(self.task.picture, math.inf)

    def __call__(self, svg: str) -> float:
        reference = self._reference
        drawn = rerender(svg.encode(), reference.width, reference.height)
        return _level_db(self.task, reference, of_pixels(drawn.pixels))


def level_db(task: Task, scene: Scene | LayeredScene | None, samples: int, blur: float = 0.0) -> float:
    """PSNR of a scene against what is fitted, at most LIKENESS_SIDE px; infinite where they are alike, or there is no
    scene. samples: edges per cubic. blur: px of the target by which the scene is blurred first.
    """
    return math.inf if scene is None else _level_db(task, *_drawn(task, scene, samples, blur))


def seen_db(
    task: Task, scene: Scene | LayeredScene | None, samples: int, blur: float = 0.0, enough_db: float = math.inf
) -> float:
    """The same as people see it: the mean of the PSNR of pixels and that of tones, the means of squares of COARSE px.
    Edges that are a little off hide neither shading that is missing nor what drifts from tone to tone. Infinite also
    where the pixels have `enough_db`.
    """
    if scene is None:
        return math.inf
    picture, drawn = _drawn(task, scene, samples, blur)
    pixels_db = _level_db(task, picture, drawn)
    if pixels_db >= enough_db:
        return math.inf
    off = np.subtract(*map(_over_black_and_white, (of_picture(picture), drawn)))
    tones = np.square(ndimage.uniform_filter(off, (COARSE, COARSE, 1))).mean(axis=(0, 1))
    return 0.5 * (pixels_db + decibels(max(float(tones[:3].mean()), float(tones[3:].mean()), 1e-12)))


def _drawn(task: Task, scene: Scene | LayeredScene, samples: int, blur: float) -> tuple[Picture, ImageSource]:
    """The target, and a scene as the engine draws it at that size."""
    picture, threads = resize_picture(task.target, LIKENESS_SIDE), task.request.settings.threads
    values = of_scene(scene, picture.width, picture.height, samples, threads).rows(0, picture.height)
    if blur:
        sigma = blur * picture.width / task.target.width
        values = ndimage.gaussian_filter(values, (sigma, sigma, 0.0), mode="nearest")
    return picture, of_values(values)


def _level_db(task: Task, picture: Picture, drawn: ImageSource) -> float:
    level = psnr_db(picture, drawn, task.request.settings.threads)
    return math.inf if level is None else level


def _over_black_and_white(source: ImageSource) -> np.ndarray:
    """(H, W, 6) the colours of a picture over black, then over white."""
    values = source.rows(0, source.height)
    alpha = values[..., 3:] if source.transparent else np.ones_like(values[..., :1])
    return np.concatenate([values[..., :3], values[..., :3] + 1.0 - alpha], axis=2)
