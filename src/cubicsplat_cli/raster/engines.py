"""Choice of the engine, the CPU's or CUDA's; pictures of finished scenes, and the importance of their curves."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.progress import log
from cubicsplat_cli.raster.cpu import CpuEngine, instruction_sets
from cubicsplat_cli.raster.cuda.libcuda import gpus
from cubicsplat_cli.raster.engine import Engine, EngineScene
from cubicsplat_cli.raster.settings import FLATNESS, RasterSettings
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import with_channels
from cubicsplat_cli.settings import Mode

if TYPE_CHECKING:
    import torch

    from cubicsplat_cli.raster.cuda.compile import Program
    from cubicsplat_cli.raster.cuda.engine import CudaEngine

_of_thread = threading.local()
_of_gpu: dict[int, CudaEngine] = {}
_lock = threading.Lock()


def open_engine(
    device: str = "auto",
    threads: int | None = None,
    *,
    mode: Mode = Mode.CLOSED,
    channels: int = 3,
    painted: bool = False,
    subdivide: bool = False,
    segments: int = 1,
    samples: int = 1,
    opened: Callable[[Program], Engine] | None = None,
) -> Engine:
    """Open the engine for `device`: "cpu", "cuda", or "auto", CUDA's if there is a GPU that passes its self-test.

    mode, channels, painted (with gradients): of the first scene, whose kernels CUDA compiles and tests at once.
    subdivide: de Casteljau subdivision is needed, which only the CPU's engine has. segments: of the longest curve.
    samples: edges per cubic at most. opened: opens CUDA's engine for a program at first; by default on a GPU of this
    machine, if it has one. Raises EngineError with the reason if the requested engine cannot run or draw this. If
    "auto" finds a GPU that it cannot use, it logs why.
    """
    if device == "cuda" or (device == "auto" and (opened or _gpu_is_usable())):
        from cubicsplat_cli.raster.cuda.compile import Program
        from cubicsplat_cli.raster.cuda.frame import check_drawable

        try:
            check_drawable(segments, samples, subdivide)
            program = Program(mode, channels, painted)
            return opened(program) if opened else cuda_engine(program=program)
        except EngineError as error:
            if device == "cuda":
                raise
            log.warning("using the CPU: %s", error)
    return CpuEngine(threads)


def _gpu_is_usable() -> bool:
    """Return whether torch can use a GPU of this machine."""
    if gpus() == 0:  # asked first, since the import of torch takes seconds
        return False
    from cubicsplat_cli.raster.cuda.driver import missing_piece

    return missing_piece() is None


def cuda_engine(index: int | None = None, program: Program | None = None) -> CudaEngine:
    """Return CUDA's engine, whose import is that of torch. Raises EngineError if it cannot run."""
    from cubicsplat_cli.raster.cuda.engine import CudaEngine

    return CudaEngine(index, program)


def shared_engine(device: torch.device) -> Engine:
    """Return an engine for tensors on a device, for calls that keep nothing (`render`, `gradients`).

    All threads share the GPU's, since autograd has threads of its own; a CPU engine belongs to the calling thread.
    """
    if device.type == "cpu":
        if not hasattr(_of_thread, "engine"):
            _of_thread.engine = CpuEngine()
        return _of_thread.engine
    import torch

    index = torch.cuda.current_device() if device.index is None else device.index
    with _lock:
        if index not in _of_gpu:
            _of_gpu[index] = cuda_engine(index)
        return _of_gpu[index]


def scene_arrays(scene: Scene) -> EngineScene:
    """Return a scene as the CPU engine takes it: float32, contiguous, detached, in numpy arrays."""

    def plain(array: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(array, np.int32 if array.dtype == np.int32 else np.float32)

    return EngineScene(**vars(scene.as_numpy().changed(plain)))


def render_scene(
    scene: Scene, coverage: str = "exact", samples: int = 24, threads: int | None = None, edge_width: float = 1.0
) -> np.ndarray:
    """Return the engine's own picture of a scene: (H, W, 3), or (H, W, 4) premultiplied without a background.

    It is float32. samples: edges per cubic at most; fewer if these stay within FLATNESS of it. edge_width: px, for
    relaxed coverage. Raises InputError for a scene that is not valid.
    """
    scene.validate()
    with closing(CpuEngine(threads)) as engine:
        return engine.render(scene_arrays(scene), RasterSettings(coverage, edge_width, samples, FLATNESS))


def leave_one_out_importance(
    scene: Scene, target: np.ndarray, weights: np.ndarray | None, samples: int, threads: int | None
) -> tuple[float, np.ndarray]:
    """Return the squared error of the exact picture against a target (H, W, C) of the scene's size, and its rise (N,)
    without each curve. weights (H, W): of the pixels. samples: edges per cubic at most.
    """
    goal = with_channels(np.ascontiguousarray(target, dtype=np.float32), scene.channels)
    with closing(CpuEngine(threads)) as engine:
        loss, found = engine.gradients(
            scene_arrays(scene), RasterSettings("exact", 1.0, samples, FLATNESS), target=goal,
            importance="loo", weights=None if weights is None else np.ascontiguousarray(weights),
        )  # fmt: skip
        return loss, found["importance"]


def describe(cuda: Callable[[], Engine] = cuda_engine) -> dict[str, Any]:
    """Describe, for `cubicsplat doctor`, the engines that can run here, and why others cannot. cuda: opens CUDA's."""
    engines: dict[str, Any] = {}
    opened: dict[str, Callable[[], Engine]] = {"cpu": CpuEngine, "cuda": cuda}
    for name, open_it in opened.items():
        try:
            with closing(open_it()) as engine:
                engines[name] = {"available": True, **engine.describe()}
        except EngineError as error:
            engines[name] = {"available": False, "reason": str(error)}
    if engines["cpu"]["available"]:
        engines["cpu"]["instruction_sets"] = instruction_sets()
    for name, state in engines.items():  # as `--device auto` chooses
        state["used"] = name == ("cuda" if engines["cuda"]["available"] else "cpu")
    return engines
