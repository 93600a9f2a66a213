"""A drawing on film."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.files.load import Picture, resize_picture
from cubicsplat_cli.progress import FrameRecorder
from cubicsplat_cli.raster import render_scene
from cubicsplat_cli.scene import Scene, scaled_scene

_SIDE = 512  # px; what a part is compared at
_SAMPLES = 24


def film_shapes(film: FrameRecorder, scene: Scene, picture: Picture, threads: int | None) -> None:
    """Puts a drawing on film as it is laid down, shape after shape from the back."""
    small = resize_picture(picture, _SIDE)
    sized = scaled_scene(scene, small.width, small.height)
    pieces = np.linspace(1, sized.curves, min(sized.curves, 2 * film.frames)).astype(int)
    target = small.premultiplied()
    shown_db = 0.0
    for count in dict.fromkeys(pieces.tolist()):
        part = sized.chosen(slice(-count, None))  # those furthest to the back
        error = float(((render_scene(part, samples=_SAMPLES, threads=threads) - target) ** 2).mean())
        # A shape that later ones complete may make the picture worse at first: it is a step forward all the same.
        shown_db = max(shown_db, -10.0 * math.log10(max(error, 1e-10))) + 1e-3
        film.keep(shown_db, part)
