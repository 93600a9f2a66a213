"""Finished scenes: their pictures, the importance of their curves, and which engines can draw them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from typing import Any

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import CpuEngine, instruction_sets
from cubicsplat_cli.raster.engine import Engine, EngineScene
from cubicsplat_cli.raster.engines import cuda_engine
from cubicsplat_cli.raster.settings import FLATNESS, RasterSettings
from cubicsplat_cli.scene import Scene


def scene_arrays(scene: Scene) -> EngineScene:
    """A scene as the CPU engine takes it: float32, contiguous, detached, in arrays of its kind on the host."""

    def plain(array: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(array, np.int32 if array.dtype == np.int32 else np.float32)

    given = scene.as_numpy().changed(plain)
    if not isinstance(scene.points, np.ndarray):
        given = given.as_torch()
    return EngineScene(**vars(given))


def render_scene(
    scene: Scene, coverage: str = "exact", samples: int = 24, threads: int | None = None, edge_width: float = 1.0
) -> np.ndarray:
    """The engine's own picture of a scene: (H, W, 3), or (H, W, 4) premultiplied without a background; float32.

    samples: edges per cubic at most; fewer where they keep within FLATNESS of it. edge_width: px, for relaxed coverage.
    Raises InputError for a scene that is not valid.
    """
    scene.validate()
    with closing(CpuEngine(threads)) as engine:
        return engine.render(scene_arrays(scene.as_numpy()), RasterSettings(coverage, edge_width, samples, FLATNESS))


def leave_one_out_importance(
    scene: Scene, target: np.ndarray, weights: np.ndarray | None, samples: int, threads: int | None = None
) -> tuple[float, np.ndarray]:
    """The squared error of the exact picture against a target (H, W, C) of the scene's size, and (N,) how much it would
    rise without each curve. weights (H, W): of the pixels. samples: edges per cubic at most.
    """
    goal = np.ascontiguousarray(target, dtype=np.float32)
    if scene.background is None and goal.shape[2] == 3:
        goal = np.concatenate([goal, np.ones_like(goal[..., :1])], axis=2)
    with closing(CpuEngine(threads)) as engine:
        loss, found = engine.gradients(
            scene_arrays(scene.as_numpy()), RasterSettings("exact", 1.0, samples, FLATNESS), target=goal,
            importance="loo", weights=None if weights is None else np.ascontiguousarray(weights),
        )  # fmt: skip
        return loss, found["importance"]


def describe(cuda: Callable[[], Engine] = cuda_engine) -> dict[str, Any]:
    """Which engines this installation can run, and why not: for `cubicsplat doctor`. cuda: opens CUDA's."""
    engines = {"cpu": _describe(CpuEngine), "cuda": _describe(cuda)}
    if engines["cpu"]["available"]:
        engines["cpu"]["instruction_sets"] = instruction_sets()
    # What `--device auto` takes.
    chosen = "cuda" if engines["cuda"]["available"] else "cpu"
    for name, state in engines.items():
        state["used"] = name == chosen
    return engines


def _describe(opened: Callable[[], Engine]) -> dict[str, Any]:
    """The engine itself, or the reason why there is none."""
    try:
        with closing(opened()) as engine:
            return {"available": True, **engine.describe()}
    except EngineError as error:
        return {"available": False, "reason": str(error)}
