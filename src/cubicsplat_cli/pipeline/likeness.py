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
from cubicsplat_cli.records import dataclass
from cubicsplat_cli.scene import LayeredScene, Scene

LIKENESS_SIDE = 1024  # px of the longer side of the copy on which both are compared, where fine lines count
COARSE = 8  # px of a window whose mean people see as one tone, as they see a JPEG's blocks


@dataclass(frozen=True, eq=False)
class Likeness:
    """The target of a fit, at most LIKENESS_SIDE px, and a scene as the engine draws it at that size."""

    picture: Picture
    drawn: ImageSource
    threads: int | None

    @classmethod
    def of(cls, task: Task, scene: Scene | LayeredScene, samples: int, blur: float = 0.0) -> Likeness:
        """samples: edges per cubic. blur: px of the target by which the scene is blurred first."""
        picture, threads = resize_picture(task.target, LIKENESS_SIDE), task.request.settings.threads
        values = of_scene(scene, picture.width, picture.height, samples, threads).rows(0, picture.height)
        if blur:
            sigma = blur * picture.width / task.target.width
            values = ndimage.gaussian_filter(values, (sigma, sigma, 0.0), mode="nearest")
        return cls(picture, of_values(values), threads)

    def pixels_db(self) -> float | None:
        """PSNR of the pixels; None where they are alike."""
        return psnr_db(self.picture, self.drawn, self.threads)

    def seen_db(self, pixels_db: float) -> float:
        """The mean of the PSNR of pixels and that of tones, the means of squares of COARSE px: edges that are a little
        off hide neither shading that is missing nor what drifts from tone to tone.
        """
        off = np.subtract(*map(_over_black_and_white, (of_picture(self.picture), self.drawn)))
        tones = np.square(ndimage.uniform_filter(off, (COARSE, COARSE, 1))).mean(axis=(0, 1))
        return 0.5 * (pixels_db + decibels(max(float(tones[:3].mean()), float(tones[3:].mean()), 1e-12)))


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
        level = psnr_db(reference, of_pixels(drawn.pixels), self.task.request.settings.threads)
        return math.inf if level is None else level


def level_db(task: Task, scene: Scene | LayeredScene | None, samples: int, blur: float = 0.0) -> float | None:
    """PSNR of a scene against what is fitted; None where they are alike, or there is no scene. See `Likeness.of`."""
    return None if scene is None else Likeness.of(task, scene, samples, blur).pixels_db()


def seen_db(task: Task, scene: Scene, samples: int) -> float | None:
    """The same of pixels and tones, as people see them; see `Likeness.seen_db`."""
    likeness = Likeness.of(task, scene, samples)
    level = likeness.pixels_db()
    return None if level is None else likeness.seen_db(level)


def _over_black_and_white(source: ImageSource) -> np.ndarray:
    """(H, W, 6) the colours of a picture over black, then over white."""
    values = source.rows(0, source.height)
    alpha = values[..., 3:] if source.transparent else np.ones_like(values[..., :1])
    return np.concatenate([values[..., :3], values[..., :3] + 1.0 - alpha], axis=2)
