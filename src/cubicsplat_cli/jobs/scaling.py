"""Pictures too large to fit or to measure as they are, and scenes brought to another canvas size."""

from __future__ import annotations

import dataclasses
import math

from cubicsplat_cli.evaluate.rerender import MAX_SIDE
from cubicsplat_cli.files.load import Picture, resize_picture
from cubicsplat_cli.scene import Scene

# SSIM takes some 50 bytes a pixel: with this many, under 2 GB.
MAX_MEASURED_PIXELS = 2**25


def scaled_scene(scene: Scene, width: int, height: int) -> Scene:
    """The scene on a canvas of width x height px; the same object when it has that size already.

    Sides are scaled independently, so that a canvas whose sides were rounded to whole pixels fits again; half-widths
    by the geometric mean of both factors.
    """
    if (scene.width, scene.height) == (width, height):
        return scene
    across, down = width / scene.width, height / scene.height
    return dataclasses.replace(
        scene,
        width=width,
        height=height,
        points=scene.points * scene.points.new_tensor([across, down]),
        half_widths=scene.half_widths * math.sqrt(across * down),
    )


def measurable(picture: Picture) -> Picture:
    """The picture, scaled down where no renderer could draw it or measuring it would take too much memory."""
    longer, shorter = max(picture.width, picture.height), min(picture.width, picture.height)
    limit = min(MAX_SIDE, longer)
    if longer * shorter > MAX_MEASURED_PIXELS:
        limit = min(limit, math.floor(longer * math.sqrt(MAX_MEASURED_PIXELS / (longer * shorter))))
    return resize_picture(picture, limit)
