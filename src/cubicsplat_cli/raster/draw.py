"""Drawing a finished scene, and saying what draws it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import CpuEngine, instruction_sets
from cubicsplat_cli.raster.engine import Engine, SceneArrays
from cubicsplat_cli.raster.engines import cuda_engine
from cubicsplat_cli.raster.settings import FLATNESS, RasterSettings
from cubicsplat_cli.scene import Scene


def scene_arrays(scene: Scene) -> SceneArrays:
    """A scene as the CPU engine takes it: float32, contiguous, detached, in arrays of its kind on the host."""

    def plain(array: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(array, np.int32 if array.dtype == np.int32 else np.float32)

    given = scene.as_numpy().changed(plain)
    if not isinstance(scene.points, np.ndarray):
        given = given.as_torch()
    return SceneArrays(
        given.mode, given.width, given.height, given.points, given.colours, given.opacities, given.half_widths,
        given.background, ring_ends=given.ring_ends, gradients=given.gradients,
    )  # fmt: skip


def render_scene(
    scene: Scene, coverage: str = "exact", samples: int = 24, threads: int | None = None, edge_width: float = 1.0
) -> np.ndarray:
    """The engine's own picture of a scene: (H, W, 3), or (H, W, 4) premultiplied without a background; float32.

    samples: edges per cubic at most; fewer where they keep within FLATNESS of it. edge_width: px, for relaxed coverage.
    Raises InputError for a scene that is not valid.
    """
    scene.validate()
    engine = CpuEngine(threads)
    try:
        return engine.render(scene_arrays(scene.as_numpy()), RasterSettings(coverage, edge_width, samples, FLATNESS))
    finally:
        engine.close()


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
        engine = opened()
    except EngineError as error:
        return {"available": False, "reason": str(error)}
    try:
        return {"available": True, **engine.describe()}
    finally:
        engine.close()
