"""Which engine runs: the CPU's or CUDA's."""

from __future__ import annotations

from ..errors import EngineError
from .cpu import CpuEngine


def open_engine(device: str = "auto", threads: int | None = None) -> CpuEngine:
    """Opens the engine for `device` ("auto", "cpu" or "cuda"). Raises EngineError where it cannot run."""
    if device == "cuda":
        raise EngineError("the CUDA engine is not part of this version; use --device cpu")
    return CpuEngine(threads)
