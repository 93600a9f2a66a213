"""The scenes through which a result comes about, for whoever shows them: few, and spread by how good they are."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cubicsplat_cli.scene import Scene

# Scenes that are kept take at most so much memory, or are as few as FEWEST.
MOST_BYTES = 1 << 26
FEWEST = 8
FIRST_STEP_DB = 0.02
FRAMES = 48


class Film:
    """Keeps a scene whenever the picture has become better by a step, and doubles the step when there are too many.

    frames: how many are wanted at the end; four times as many are kept at most.
    """

    def __init__(self, frames: int) -> None:
        self.frames = frames
        self._step_db = FIRST_STEP_DB
        self._kept: list[tuple[float, Scene]] = []

    def due(self, psnr_db: float) -> bool:
        """Whether a picture of this quality is the next to keep."""
        return not self._kept or psnr_db >= self._kept[-1][0] + self._step_db

    def keep(self, psnr_db: float, scene: Scene) -> None:
        """Keeps a scene that is due; it must not change afterwards."""
        self._kept.append((psnr_db, scene))
        values = sum(
            math.prod(array.shape) for array in (scene.points, scene.colours, scene.opacities, scene.half_widths)
        )
        most = max(FEWEST, min(4 * self.frames, MOST_BYTES // (4 * values)))
        while len(self._kept) > most:
            self._step_db *= 2.0
            thinned = self._kept[:1]
            for level, kept in self._kept[1:]:
                if level >= thinned[-1][0] + self._step_db:
                    thinned.append((level, kept))
            self._kept = thinned

    def scenes(self, last: Scene) -> list[Scene]:
        """At most `frames` of the kept scenes, evenly by their quality, and after them `last`."""
        chosen = list(range(len(self._kept)))
        if len(chosen) >= self.frames:
            levels = [level for level, _ in self._kept]
            span = (levels[-1] - levels[0]) / max(1, self.frames - 2)
            wanted = [levels[0] + span * index for index in range(self.frames - 1)]
            nearest = [min(chosen, key=lambda index: abs(levels[index] - level)) for level in wanted]
            chosen = list(dict.fromkeys(nearest))
        return [*(self._kept[index][1] for index in chosen), last]
