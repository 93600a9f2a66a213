"""Which engine is taken, what is said where the CUDA engine cannot run, and its place in torch's autograd."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from emulated import compiler
from engines import close, open_cuda
from scenes import PAPER, random_scene, random_target

from cubicsplat_cli.errors import DeviceError, EngineError
from cubicsplat_cli.photo import fit
from cubicsplat_cli.raster import draw, engines, operator, render_scene
from cubicsplat_cli.raster.cuda import compile as cuda_compile
from cubicsplat_cli.raster.cuda import driver as cuda_driver
from cubicsplat_cli.raster.cuda import engine as cuda
from cubicsplat_cli.raster.cuda import libcuda
from cubicsplat_cli.raster.cuda.engine import CudaEngine
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.settings import FitSettings, Mode

NAMES = ("points", "colours", "opacities", "half_widths")
needs_compiler = pytest.mark.skipif(compiler() is None, reason="needs a C++ compiler")


@needs_compiler
@pytest.mark.parametrize("mode", list(Mode))
def test_the_operator_with_the_cuda_engine(mode, monkeypatch):
    """As on a GPU, any loss goes through the engine's kernels, with torch's autograd around them."""
    engine = open_cuda("emulated")
    scene = random_scene(mode, 6, 2, 30, 26, 2, background=None)
    results = []
    for shared in (engines.shared_engine, lambda device: engine):
        monkeypatch.setattr(operator, "shared_engine", shared)
        leaves = [getattr(scene, name).clone().requires_grad_() for name in NAMES]
        drawn = replace(scene, **dict(zip(NAMES, leaves, strict=True)))
        picture = operator.render(drawn, RasterSettings("relaxed", 1.5, 8))
        (picture.sin() * picture).sum().backward()
        results.append((picture, *(leaf.grad for leaf in leaves)))
    assert engine._driver.launches[-1][0] == "update"
    for got, want in zip(results[1], results[0], strict=True):
        assert close(got, want, 3e-3, 0.02)


@needs_compiler
def test_auto_takes_the_gpu_where_there_is_one(monkeypatch, caplog):
    monkeypatch.setattr(engines, "gpus", lambda: 1)
    monkeypatch.setattr(cuda_driver, "missing_piece", lambda: None)
    monkeypatch.setattr(engines, "cuda_engine", lambda **_: open_cuda("emulated"))
    assert engines.open_engine("auto").name == engines.open_engine("cuda").name == "cuda"
    assert engines.open_engine("cpu").name == "cpu"
    assert engines.open_engine("auto", 1, subdivide=True).name == "cpu"
    with pytest.raises(EngineError, match=r"no de Casteljau subdivision; use uniform samples, or the CPU"):
        engines.open_engine("cuda", subdivide=True)
    assert engines.open_engine("auto", 1, segments=43).name == "cpu"
    with pytest.raises(EngineError, match="at most 42 segments and 4096 edges, not 20 and 20000"):
        engines.open_engine("cuda", segments=20, samples=1000)

    def broken(**_):
        raise EngineError("its self-test failed")

    monkeypatch.setattr(engines, "cuda_engine", broken)
    assert engines.open_engine("auto", 1).name == "cpu"
    assert [message.split(";")[0] for message in caplog.messages] == [
        "using the CPU: the CUDA engine has no de Casteljau subdivision",
        "using the CPU: the CUDA engine draws curves of at most 42 segments and 4096 edges, not 43 and 43",
        "using the CPU: its self-test failed",
    ]  # fmt: skip
    with pytest.raises(EngineError, match="self-test failed"):
        engines.open_engine("cuda")


@needs_compiler
@pytest.mark.parametrize("failing", [0, 37])
def test_a_gpu_that_fails_leaves_the_best_so_far(monkeypatch, failing):
    """The state that the host has last seen, measured on the CPU; before there is one, only the error."""
    monkeypatch.setattr(engines, "cuda_engine", lambda **_: open_cuda("emulated"))
    whole = CudaEngine.step

    def step(self, scene, settings, training):
        if self._number == failing:
            raise DeviceError("the GPU failed: gone")
        return whole(self, scene, settings, training)

    monkeypatch.setattr(CudaEngine, "step", step)
    picture = random_target(random_scene(Mode.CLOSED, 1, 3, 24, 20, background=PAPER), 4).numpy()
    settings = FitSettings.from_preset("draft", curves=4, steps=60, device="cuda")
    if not failing:
        with pytest.raises(DeviceError, match="gone"):
            fit(picture, settings)
        return
    result = fit(picture, settings)
    assert result.device["name"] == "cpu"
    assert np.isfinite(result.scene.points).all()
    assert result.steps == failing
    note = "the GPU failed: gone; the result is what the fit had come to by step 36 of 60, without the exact finish"
    assert result.notes == [note]
    seen = result.history[-1]["psnr_db"]
    drawn = render_scene(result.scene, samples=48)[..., :3]
    assert 10 * np.log10(1 / np.mean((drawn - picture) ** 2)) > seen - 3.0


def test_auto_takes_the_cpu_without_a_word_where_there_is_no_gpu(monkeypatch, caplog):
    """Nor where torch was built without CUDA, whatever the machine has."""
    for count in (0, 1):
        monkeypatch.setattr(engines, "gpus", lambda count=count: count)
        monkeypatch.setattr(torch.version, "cuda", None)
        assert engines.open_engine("auto", 1).name == "cpu"
    assert caplog.messages == []
    assert engines.shared_engine(torch.device("cpu")) is engines.shared_engine(torch.device("cpu"))


@needs_compiler
def test_what_doctor_is_told(monkeypatch):
    monkeypatch.setattr(torch.version, "cuda", None)
    found = draw.describe()
    assert found["cpu"]["used"]
    assert not found["cuda"]["used"]
    assert found["cuda"]["reason"].startswith("this torch has no CUDA")
    monkeypatch.setattr(draw, "cuda_engine", lambda: open_cuda("emulated"))
    found = draw.describe()
    assert found["cuda"] == {"available": True, "name": "cuda", "gpu": "emulated", "used": True}
    assert not found["cpu"]["used"]


class FakeLibrary:
    """NVIDIA's driver library, with as many GPUs, or an error of its start."""

    def __init__(self, count: int, error: int = 0) -> None:
        self.count, self.error = count, error

    def cuInit(self, flags) -> int:
        return self.error

    def cuDeviceGetCount(self, count) -> int:
        count._obj.value = self.count
        return 0


def test_gpus_are_counted_without_torch(monkeypatch):
    def missing():
        raise EngineError("no driver")

    for library, count in ((lambda: FakeLibrary(2), 2), (lambda: FakeLibrary(2, 100), 0), (missing, 0)):
        monkeypatch.setattr(libcuda, "open_library", library)
        assert libcuda.gpus() == count


def test_torch_without_cuda(monkeypatch):
    monkeypatch.setattr(torch.version, "cuda", None)
    with pytest.raises(EngineError, match=r"this torch has no CUDA: install the CUDA wheel of torch .* use --device"):
        CudaEngine()


def test_no_gpu(monkeypatch):
    def fail():
        raise RuntimeError("Found no NVIDIA driver on your system.\nPlease check.")

    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.cuda, "init", fail)
    with pytest.raises(EngineError, match=r"no usable GPU: Found no NVIDIA driver on your system\. Please check; "):
        CudaEngine()


def test_an_incomplete_package(monkeypatch, tmp_path):
    monkeypatch.setattr(cuda_compile, "KERNELS", tmp_path)
    with pytest.raises(EngineError, match=r"kernels are missing from the package .*; reinstall cubicsplat"):
        cuda_compile.sources()


def test_the_kernels_are_written_for_the_device_alone():
    """No header of the toolkit: everything included is in the package."""
    text = cuda_compile.sources()
    lines = [line for t in text.values() for line in t.decode().splitlines()]
    included = {line.split('"')[1] for line in lines if line.startswith('#include "')}
    assert len(included) >= 8
    assert included <= set(text)
    assert all(b"#include <" not in t for name, t in text.items() if name != "curve.h")
    assert cuda.CudaEngine.name == "cuda"
