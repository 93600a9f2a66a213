"""What the curves of a finished scene are worth."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.draw import scene_arrays
from cubicsplat_cli.raster.settings import FLATNESS, RasterSettings
from cubicsplat_cli.scene import Scene


def worth_of(
    scene: Scene, target: np.ndarray, weights: np.ndarray | None, samples: int, threads: int | None = None
) -> tuple[float, np.ndarray]:
    """The squared error of the exact picture against a target (H, W, C) of the scene's size, and (N,) how much it would
    rise without each curve. weights (H, W): of the pixels. samples: edges per cubic at most.
    """
    goal = np.ascontiguousarray(target, dtype=np.float32)
    if scene.background is None and goal.shape[2] == 3:
        goal = np.concatenate([goal, np.ones_like(goal[..., :1])], axis=2)
    engine = CpuEngine(threads)
    try:
        loss, found = engine.gradients(
            scene_arrays(scene.as_numpy()), RasterSettings("exact", 1.0, samples, FLATNESS), target=goal,
            importance="loo", weights=None if weights is None else np.ascontiguousarray(weights),
        )  # fmt: skip
        return loss, found["importance"]
    finally:
        engine.close()
