"""The fit of a clip frame by frame, each from the curves of the one before."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from cubicsplat_cli.photo import fit
from cubicsplat_cli.photo.inputs import FitInputs
from cubicsplat_cli.progress import work
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.moving import Clip, MovingScene
from cubicsplat_cli.settings import FitSettings

FOLLOWING = 0.1  # of the steps of the first frame, for each of the others


def fit_clip(frames: Iterable[tuple[np.ndarray, float, float]], settings: FitSettings, count: int | None) -> Clip:
    """A clip of one group whose curves have a knot at every frame.

    frames: pictures (H, W, 3 or 4) as `fit` takes them, with the seconds from and until which each is shown; read one
    at a time. count: how many there are, where that is known. Ends with the frames so far where the work is stopped.
    """
    scenes: list[Scene] = []
    begins: list[float] = []
    ends: list[float] = []
    steps = max(1, round(FOLLOWING * settings.steps))
    following = settings.with_(steps=steps, recipe=replace(settings.recipe, prune=False))
    with work().stoppable():
        for pixels, begin, end in frames:
            if scenes:
                work().at("fitting frames", len(scenes) / count if count else 0.0)
                start = FitInputs(start=scenes[-1])
                fitted = fit(pixels, following.with_(curves=scenes[-1].curves), inputs=start)
            else:
                fitted = fit(pixels, settings)
            scenes.append(fitted.scene)
            begins.append(begin)
            ends.append(end)

    def stacked(name: str) -> np.ndarray:
        return np.stack([getattr(scene, name) for scene in scenes]).astype(np.float32)

    points, colours, opacities, half_widths = map(stacked, ("points", "colours", "opacities", "half_widths"))
    first, knots = scenes[0], np.ones((len(scenes), scenes[0].curves), bool)
    group = MovingScene(first, np.array(begins), ends[-1], points, colours, opacities, half_widths, knots)
    return Clip(first.width, first.height, first.background, [group])
