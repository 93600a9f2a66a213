"""Drawing a finished scene, and saying what draws it."""

from __future__ import annotations

from typing import Any

import numpy as np
from torch import Tensor

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.gradients import Gradients
from cubicsplat_cli.raster.cpu import CpuEngine, instruction_sets
from cubicsplat_cli.raster.cuda.engine import CudaEngine
from cubicsplat_cli.raster.engine import SceneTensors
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Scene


def scene_tensors(scene: Scene) -> SceneTensors:
    """A scene as the engines take it: float32, contiguous, detached."""
    given = (scene.points, scene.colours, scene.opacities, scene.half_widths)
    points, colours, opacities, half_widths = (t.detach().cpu().float().contiguous() for t in given)
    ring_ends = None if scene.ring_ends is None else scene.ring_ends.cpu().contiguous()
    return SceneTensors(
        scene.mode, scene.width, scene.height, points, colours, opacities, half_widths, scene.background,
        ring_ends=ring_ends, gradients=plain_gradients(scene),
    )  # fmt: skip


def plain_gradients(scene: Scene) -> Gradients | None:
    """A scene's gradient fills as the engines take them."""
    if scene.gradients is None:
        return None
    return scene.gradients.floating(Tensor.float).changed(lambda t: t.detach().cpu().contiguous())


def render_scene(
    scene: Scene, coverage: str = "exact", samples: int = 24, threads: int | None = None, edge_width: float = 1.0
) -> np.ndarray:
    """The engine's own picture of a scene: (H, W, 3), or (H, W, 4) premultiplied without a background; float32.

    samples: S*, edges per cubic. edge_width: px, for relaxed coverage. Raises InputError for a scene that is not valid.
    """
    scene.validate()
    engine = CpuEngine(threads)
    try:
        return engine.render(scene_tensors(scene), RasterSettings(coverage, edge_width, samples)).numpy()
    finally:
        engine.close()


def describe() -> dict[str, Any]:
    """Which engines this installation can run, and why not: for `cubicsplat doctor`."""
    engines = {"cpu": _describe(CpuEngine), "cuda": _describe(CudaEngine)}
    if engines["cpu"]["available"]:
        engines["cpu"]["instruction_sets"] = instruction_sets()
    # What `--device auto` takes.
    chosen = "cuda" if engines["cuda"]["available"] else "cpu"
    for name, state in engines.items():
        state["used"] = name == chosen
    return engines


def _describe(engine_class: type[CpuEngine] | type[CudaEngine]) -> dict[str, Any]:
    """The engine itself, or the reason why there is none."""
    try:
        engine = engine_class()
    except EngineError as error:
        return {"available": False, "reason": str(error)}
    try:
        return {"available": True, **engine.describe()}
    finally:
        engine.close()
