"""What is said where the CUDA engine cannot run, and that its self-test expects what the reference computes."""

from __future__ import annotations

import sys
import types

import pytest
import torch
from emulated import EmulatedDriver, compiler
from engines import close, open_cuda
from scenes import as_arguments, random_scene

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster import draw, engines, operator, reference
from cubicsplat_cli.raster.cuda import compile as cuda_compile
from cubicsplat_cli.raster.cuda import driver as cuda_driver
from cubicsplat_cli.raster.cuda import engine as cuda
from cubicsplat_cli.raster.cuda import selftest as cuda_selftest
from cubicsplat_cli.raster.cuda.compile import Program
from cubicsplat_cli.raster.cuda.engine import CudaEngine
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.settings import Mode

NAMES = ("points", "colours", "opacities", "half_widths")
needs_compiler = pytest.mark.skipif(compiler() is None, reason="needs a C++ compiler")


@pytest.mark.parametrize(("mode", "channels", "coverage"), list(cuda_selftest.EXPECTED))
def test_the_self_test_expects_what_the_reference_computes(mode, channels, coverage):
    program = Program(mode, channels)
    scene, target = cuda_selftest.scene(program), cuda_selftest.target(program)
    leaves = [getattr(scene, name).double().requires_grad_() for name in NAMES]
    image = reference.render(
        *leaves, mode=mode, width=scene.width, height=scene.height, background=scene.background,
        settings=cuda_selftest.settings(coverage),
    )  # fmt: skip
    loss = reference.image_loss(image, target.double())
    loss.backward()
    gradients = {name: leaf.grad for name, leaf in zip(NAMES, leaves, strict=True)}
    got = cuda_selftest.digest(program, image.detach(), float(loss.detach()), gradients)
    assert got == pytest.approx(cuda_selftest.EXPECTED[mode, channels, coverage], rel=1e-4, abs=1e-4)


def test_every_program_has_expectations():
    wanted = {(mode, channels, c) for mode in Mode for channels in (3, 4) for c in cuda_selftest.COVERAGES}
    assert set(cuda_selftest.EXPECTED) == wanted


@needs_compiler
def test_a_gpu_that_computes_wrongly_is_not_used(monkeypatch):
    engine = open_cuda("emulated")
    draw = CudaEngine.render
    monkeypatch.setattr(CudaEngine, "render", lambda *a: draw(*a).mul_(1.1))
    with pytest.raises(EngineError, match=r"self-test \(closed, RGB, relaxed\) gives .* in place of .*; use --device"):
        CudaEngine(driver=EmulatedDriver())
    # A program loaded later is tested then, and stays untrusted.
    for _ in range(2):
        with pytest.raises(EngineError, match=r"self-test \(open, RGBA, relaxed\)"):
            engine._load(Program(Mode.OPEN, 4))


@needs_compiler
@pytest.mark.parametrize("mode", list(Mode))
def test_the_operator_with_the_cuda_engine(mode, monkeypatch):
    """As on a GPU, any loss goes through the engine's kernels, with torch's autograd around them."""
    engine = open_cuda("emulated")
    scene = random_scene(mode, 6, 2, 30, 26, 2, background=None)
    keywords = as_arguments(scene)[1] | {"settings": RasterSettings("relaxed", 1.5, 8)}
    results = []
    for shared in (engines.shared_engine, lambda device: engine):
        monkeypatch.setattr(operator, "shared_engine", shared)
        leaves = [getattr(scene, name).clone().requires_grad_() for name in NAMES]
        picture = operator.render(*leaves, **keywords)
        (picture.sin() * picture).sum().backward()
        results.append((picture, *(leaf.grad for leaf in leaves)))
    assert engine._driver.launches[-1][0] == "update"
    for got, want in zip(results[1], results[0], strict=True):
        assert close(got, want, 3e-3, 0.02)


@needs_compiler
def test_auto_takes_the_gpu_where_there_is_one(monkeypatch, caplog):
    monkeypatch.setattr(engines, "missing_piece", lambda: None)
    monkeypatch.setattr(engines, "CudaEngine", lambda: open_cuda("emulated"))
    assert engines.open_engine("auto").name == engines.open_engine("cuda").name == "cuda"
    assert engines.open_engine("cpu").name == "cpu"
    assert engines.open_engine("auto", 1, subdivide=True).name == "cpu"
    with pytest.raises(EngineError, match=r"no de Casteljau subdivision; use uniform samples, or the CPU"):
        engines.open_engine("cuda", subdivide=True)

    def broken():
        raise EngineError("its self-test failed")

    monkeypatch.setattr(engines, "CudaEngine", broken)
    assert engines.open_engine("auto", 1).name == "cpu"
    assert [message.split(";")[0] for message in caplog.messages] == [
        "using the CPU: the CUDA engine has no de Casteljau subdivision", "using the CPU: its self-test failed"
    ]  # fmt: skip
    with pytest.raises(EngineError, match="self-test failed"):
        engines.open_engine("cuda")


def test_auto_takes_the_cpu_without_a_word_where_there_is_no_gpu(monkeypatch, caplog):
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
    monkeypatch.setattr(draw, "CudaEngine", lambda: open_cuda("emulated"))
    found = draw.describe()
    assert found["cuda"] == {"available": True, "name": "cuda", "gpu": "emulated", "used": True}
    assert not found["cpu"]["used"]


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


def test_no_bindings(monkeypatch):
    monkeypatch.setattr(cuda_driver, "missing_piece", lambda: None)
    monkeypatch.setitem(sys.modules, "cuda.bindings", None)
    with pytest.raises(EngineError, match=r"needs the Python package cuda-bindings .* pip install cuda-bindings"):
        CudaEngine()
    cuda_compile.nvrtc.cache_clear()
    with pytest.raises(EngineError, match="needs the Python package cuda-bindings"):
        cuda_compile.nvrtc()


def test_no_compiler_library(monkeypatch):
    def missing():
        raise RuntimeError("Failed to dlopen libnvrtc.so.13")

    bindings = types.ModuleType("cuda.bindings")
    bindings.nvrtc = types.SimpleNamespace(nvrtcVersion=missing)
    monkeypatch.setitem(sys.modules, "cuda", types.ModuleType("cuda"))
    monkeypatch.setitem(sys.modules, "cuda.bindings", bindings)
    cuda_compile.nvrtc.cache_clear()
    with pytest.raises(EngineError, match=r"NVRTC cannot be loaded \(Failed to dlopen libnvrtc"):
        cuda_compile.nvrtc()
    bindings.nvrtc.nvrtcVersion = lambda: (0, 11, 8)
    with pytest.raises(EngineError, match=r"NVRTC 11\.8 is too old"):
        cuda_compile.nvrtc()
    cuda_compile.nvrtc.cache_clear()


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
