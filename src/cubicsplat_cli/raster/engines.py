"""Which engine runs: the CPU's or CUDA's."""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.cuda.libcuda import gpus
from cubicsplat_cli.raster.engine import Engine
from cubicsplat_cli.settings import Mode

if TYPE_CHECKING:
    import torch

    from cubicsplat_cli.raster.cuda.compile import Program
    from cubicsplat_cli.raster.cuda.engine import CudaEngine

_log = logging.getLogger("cubicsplat")
_of_thread = threading.local()
_of_gpu: dict[int, CudaEngine] = {}
_lock = threading.Lock()


class Gpus:
    """What `open_engine` asks about GPUs, and gets an engine from."""

    def usable(self) -> bool:
        """Whether there is one for torch."""
        if gpus() == 0:  # asked first, since the import of torch takes seconds
            return False
        from cubicsplat_cli.raster.cuda.driver import missing_piece

        return missing_piece() is None

    def engine(self, program: Program) -> Engine:
        """CUDA's engine, for a program at first. Raises EngineError where it cannot run."""
        return cuda_engine(program=program)


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
    gpus: Gpus | None = None,
) -> Engine:
    """Opens the engine for `device`: "cpu", "cuda", or "auto", CUDA's where there is a GPU that passes its self-test.

    mode, channels, painted (with gradients): what it will draw first, which CUDA compiles and tests at once. subdivide:
    it has to know de Casteljau subdivision, which is the CPU's alone. segments: of the longest curve. samples: edges
    per cubic at most. gpus: default this machine's. Raises EngineError with the reason where the engine that was asked
    for cannot run or draw this. Where "auto" finds a GPU that it cannot use, it logs why.
    """

    gpus = gpus or Gpus()

    def cuda() -> Engine:
        if subdivide:
            raise EngineError("the CUDA engine has no de Casteljau subdivision; use uniform samples, or the CPU")
        from cubicsplat_cli.raster.cuda.compile import Program
        from cubicsplat_cli.raster.cuda.frame import check_lengths

        check_lengths(segments, samples)
        return gpus.engine(Program(mode, channels, painted))

    if device == "cuda":
        return cuda()
    if device == "auto" and gpus.usable():
        try:
            return cuda()
        except EngineError as error:
            _log.warning("using the CPU: %s", error)
    return CpuEngine(threads)


def cuda_engine(index: int | None = None, program: Program | None = None) -> CudaEngine:
    """CUDA's engine, whose import is that of torch. Raises EngineError where it cannot run."""
    from cubicsplat_cli.raster.cuda.engine import CudaEngine

    return CudaEngine(index, program)


def shared_engine(device: torch.device) -> Engine:
    """An engine for tensors on a device, for calls that keep nothing (`render`, `gradients`).

    The GPU's is shared by all threads, of which autograd has its own; a CPU engine belongs to the calling thread.
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
