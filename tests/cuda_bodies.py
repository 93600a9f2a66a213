"""Engines that the tests of the CUDA engine run on, and helpers that hide where their tensors live."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from emulated import EmulatedDriver, compiler
from torch import Tensor

from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.cuda.engine import CudaEngine
from cubicsplat_cli.raster.draw import scene_tensors
from cubicsplat_cli.raster.engine import OptimiserState, SceneTensors
from cubicsplat_cli.scene import Scene

TENSORS = ("points", "colours", "opacities", "half_widths", "edge_widths")
ENGINES = [
    pytest.param("emulated", marks=pytest.mark.skipif(compiler() is None, reason="needs a C++ compiler")),
    pytest.param("gpu", marks=pytest.mark.gpu),
]


def open_cuda(kind: str, **options) -> CudaEngine:
    """The CUDA engine on the emulator or on the real device. options: of `EmulatedDriver`."""
    if kind == "gpu":
        if not torch.cuda.is_available():
            pytest.skip("needs a CUDA device")
        return CudaEngine()
    return CudaEngine(driver=EmulatedDriver(**options))


def packed(scene: Scene | SceneTensors, device: torch.device | str = "cpu") -> SceneTensors:
    """A copy of a scene's tensors on a device."""
    tensors = scene_tensors(scene) if isinstance(scene, Scene) else scene
    moved = {name: getattr(tensors, name) for name in TENSORS}
    return replace(tensors, **{name: None if t is None else t.to(device, copy=True) for name, t in moved.items()})


def state_for(scene: SceneTensors) -> OptimiserState:
    """An empty optimiser state beside the scene's tensors."""
    return OptimiserState.zeros(*scene.points.shape[:2]).to(scene.points.device)


def close(got: Tensor, want: Tensor, tolerance: float, share: float = 0.0) -> bool:
    """Whether all values but a share differ by at most the tolerance times the largest wanted one (or 1e-6)."""
    got, want = got.detach().cpu().double(), want.detach().cpu().double()
    assert got.shape == want.shape
    assert torch.isfinite(got).all()
    if want.numel() == 0:
        return True
    scale = max(float(want.abs().max()), 1e-6)
    return float(((got - want).abs() > tolerance * scale).double().mean()) <= share


def assert_like_cpu(engine: CudaEngine, scene: SceneTensors, settings, target: Tensor, share: float = 0.02) -> None:
    """Picture, loss, every gradient and leave-one-out importance are those of the CPU engine."""
    cpu = CpuEngine(1)
    here = packed(scene, engine.device)
    picture = cpu.render(scene, settings)
    assert close(engine.render(here, settings), picture, 5e-4, share / 5), "picture"
    loss, want = cpu.gradients(scene, settings, target=target, importance="loo")
    found, got = engine.gradients(here, settings, target=target.to(engine.device), importance="loo")
    assert found == pytest.approx(loss, rel=2e-3, abs=1e-4)
    assert set(got) == set(want)
    for name, value in want.items():
        assert close(got[name], value, 3e-3, share), name
    cpu.close()
