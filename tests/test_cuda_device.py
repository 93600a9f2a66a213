"""Which engine is taken, what is said where the CUDA engine cannot run, and its place in torch's autograd."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from conftest import rest_slow
from emulated import EmulatedDriver, compiler
from engines import close, open_cuda
from scenes import PAPER, random_scene, random_target

from cubicsplat_cli.errors import DeviceError, EngineError
from cubicsplat_cli.photo.loop import FitLoop
from cubicsplat_cli.raster import engines, operator
from cubicsplat_cli.raster.cuda import compile as cuda_compile
from cubicsplat_cli.raster.cuda import driver as cuda_driver
from cubicsplat_cli.raster.cuda import engine as cuda
from cubicsplat_cli.raster.cuda import libcuda
from cubicsplat_cli.raster.cuda.compile import Program
from cubicsplat_cli.raster.cuda.engine import CudaEngine
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.settings import FitSettings, Mode

NAMES = ("points", "colours", "opacities", "half_widths")
needs_compiler = pytest.mark.skipif(compiler() is None, reason="needs a C++ compiler")


@needs_compiler
@pytest.mark.parametrize("mode", rest_slow(*Mode))
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


def emulated(program: Program, engine: type[CudaEngine] = CudaEngine) -> CudaEngine:
    """The engine of a machine with a GPU."""
    return engine(program=program, driver=EmulatedDriver())


def broken(program: Program) -> CudaEngine:
    """The same of a GPU on which the engine does not run."""
    raise EngineError("its self-test failed")


@needs_compiler
def test_auto_takes_the_gpu_where_there_is_one(caplog):
    opened = partial(engines.open_engine, opened=emulated)
    assert opened("auto").name == opened("cuda").name == "cuda"
    assert opened("cpu").name == "cpu"
    assert opened("auto", 1, subdivide=True).name == "cpu"
    with pytest.raises(EngineError, match=r"no de Casteljau subdivision; use uniform samples, or the CPU"):
        opened("cuda", subdivide=True)
    assert opened("auto", 1, segments=43).name == "cpu"
    with pytest.raises(EngineError, match="at most 42 segments and 4096 edges, not 20 and 20000"):
        opened("cuda", segments=20, samples=1000)
    assert engines.open_engine("auto", 1, opened=broken).name == "cpu"
    assert [message.split(";")[0] for message in caplog.messages] == [
        "using the CPU: the CUDA engine has no de Casteljau subdivision",
        "using the CPU: the CUDA engine draws curves of at most 42 segments and 4096 edges, not 43 and 43",
        "using the CPU: its self-test failed",
    ]  # fmt: skip
    with pytest.raises(EngineError, match="self-test failed"):
        engines.open_engine("cuda", opened=broken)


@needs_compiler
@pytest.mark.parametrize("failing", [0, 36])
def test_a_gpu_that_fails_leaves_the_best_so_far(failing):
    """The state that the host has last seen, measured on the CPU; before there is one, only the error."""

    class Failing(CudaEngine):
        def steps(self, scene, settings, training, paces, *further):
            if self._number + len(paces) > failing and scene.logits and training.target.shape[0] == 20:
                raise DeviceError("the GPU failed: gone")
            return super().steps(scene, settings, training, paces, *further)

    picture = random_target(random_scene(Mode.CLOSED, 1, 3, 24, 20, background=PAPER), 4).numpy()
    settings = FitSettings.from_preset("draft", curves=4, steps=60, device="cuda")
    loop = FitLoop(picture, settings, opened=partial(engines.open_engine, opened=partial(emulated, engine=Failing)))
    if not failing:
        with pytest.raises(DeviceError, match="gone"):
            loop.finish()
        return
    result = loop.finish()
    assert result.device["name"] == "cpu"
    assert np.isfinite(result.scene.points).all()
    assert result.steps == failing
    note = "the GPU failed: gone; the result is what the fit had come to by step 36 of 60, without the exact finish"
    assert result.notes == [note]
    seen = result.history[-1]["psnr_db"]
    drawn = render_scene(result.scene, samples=48)[..., :3]
    assert 10 * np.log10(1 / np.mean((drawn - picture) ** 2)) > seen - 3.0


@pytest.mark.skipif(torch.cuda.is_available(), reason="has a GPU")
def test_auto_takes_the_cpu_without_a_word_where_there_is_no_gpu(caplog):
    assert engines.open_engine("auto", 1).name == "cpu"
    assert caplog.messages == []
    assert engines.shared_engine(torch.device("cpu")) is engines.shared_engine(torch.device("cpu"))


@needs_compiler
def test_what_doctor_is_told():
    def without():
        raise EngineError("this torch has no CUDA")

    found = engines.describe(without)
    assert found["cpu"]["used"]
    assert found["cuda"] == {"available": False, "reason": "this torch has no CUDA", "used": False}
    found = engines.describe(lambda: open_cuda("emulated"))
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


def test_gpus_are_counted_without_torch():
    def missing():
        raise EngineError("no driver")

    for library, count in ((lambda: FakeLibrary(2), 2), (lambda: FakeLibrary(2, 100), 0), (missing, 0)):
        assert libcuda.gpus(library) == count


def test_torch_without_cuda():
    why = cuda_driver.missing_piece(None)
    assert re.match(r"this torch has no CUDA: install the CUDA wheel of torch .* use --device", why)


@pytest.mark.skipif(torch.cuda.is_available(), reason="has a GPU")
def test_no_gpu():
    said = r"no usable GPU: (Torch not compiled with CUDA enabled|Found no NVIDIA driver.*); check nvidia-smi"
    assert re.match(said, cuda_driver.missing_piece("13.0"))
    with pytest.raises(EngineError, match="use --device cpu"):
        CudaEngine()


def test_an_incomplete_package(tmp_path):
    with pytest.raises(EngineError, match=r"kernels are missing from the package .*; reinstall cubicsplat"):
        cuda_compile.sources(tmp_path)


def test_the_kernels_are_written_for_the_device_alone():
    """No header of the toolkit: everything included is in the package."""
    text = cuda_compile.sources()
    lines = [line for t in text.values() for line in t.decode().splitlines()]
    included = {line.split('"')[1] for line in lines if line.startswith('#include "')}
    assert len(included) >= 8
    assert included <= set(text)
    assert all(b"#include <" not in t for name, t in text.items() if name != "curve.h")
    assert cuda.CudaEngine.name == "cuda"
