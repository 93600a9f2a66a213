"""Finding NVIDIA's run-time compiler: torch's copy first, of torch's CUDA version; and what is said without one."""

from __future__ import annotations

import ctypes
import sys
import types

import pytest
import torch

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cuda import nvrtc


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """torch and NVIDIA's packages in a folder of their own, without NVRTC."""
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(torch, "__file__", str(tmp_path / "torch" / "__init__.py"))
    spec = types.SimpleNamespace(submodule_search_locations=[str(tmp_path / "nvidia")])
    monkeypatch.setattr(nvrtc.importlib.util, "find_spec", lambda name: spec)
    monkeypatch.setattr(torch.version, "cuda", None)
    cached = nvrtc.library, nvrtc.version
    for function in cached:
        function.cache_clear()
    yield tmp_path
    for function in cached:
        function.cache_clear()


def put(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"")
    return str(path)


def test_the_compiler_of_torchs_cuda_comes_first(machine, monkeypatch):
    """pip may bring NVRTC 13 beside a torch for CUDA 12, whose driver may be too old for it."""
    older = put(machine / "nvidia/cuda_nvrtc/lib/libnvrtc.so.12")
    newer = put(machine / "nvidia/cu13/lib/libnvrtc.so.13")
    put(machine / "nvidia/cu13/lib/libnvrtc-builtins.so.13.5")
    put(machine / "nvidia/cuda_nvrtc/lib/libnvrtc.so.11.2")
    assert nvrtc.candidates()[0] == newer
    monkeypatch.setattr(torch.version, "cuda", "12.8")
    assert nvrtc.candidates() == [older, "libnvrtc.so.12", newer, "libnvrtc.so.13"]
    own = put(machine / "torch/lib/libnvrtc.so.12")
    assert nvrtc.candidates()[0] == own
    monkeypatch.setattr(torch.version, "cuda", "14.0")
    assert nvrtc.candidates()[0] == "libnvrtc.so.14"


def test_windows_has_names_of_its_own(machine, monkeypatch):
    monkeypatch.setattr(sys, "platform", "win32")
    library = put(machine / "torch/lib/nvrtc64_120_0.dll")
    assert nvrtc.candidates() == [library]


def test_without_a_compiler_the_way_out_is_said(machine, monkeypatch):
    def missing(name):
        raise OSError(f"{name}: cannot open\nshared object file")

    monkeypatch.setattr(ctypes, "CDLL", missing)
    match = r"NVRTC cannot be loaded \(libnvrtc\.so\.12: cannot open shared object file\); torch's CUDA wheels bring it"
    with pytest.raises(EngineError, match=match):
        nvrtc.version()


def test_a_compiler_that_lacks_a_function_is_passed_over(machine, monkeypatch):
    monkeypatch.setattr(ctypes, "CDLL", lambda name: types.SimpleNamespace())
    with pytest.raises(EngineError, match=r"NVRTC cannot be loaded \(.*nvrtcVersion"):
        nvrtc.library()


def fake(**functions):
    """A library whose functions return 0 but for the given ones."""
    return types.SimpleNamespace(**({name: lambda *_: 0 for name in nvrtc.PROTOTYPES} | functions))


def test_old_compilers_and_failing_calls_are_said(machine, monkeypatch):
    def old(major, minor):
        major._obj.value, minor._obj.value = 11, 8
        return 0

    monkeypatch.setattr(nvrtc, "library", lambda: fake(nvrtcVersion=old))
    with pytest.raises(EngineError, match=r"NVRTC 11\.8 is too old; version 12 or newer is needed"):
        nvrtc.version()
    monkeypatch.setattr(nvrtc, "library", lambda: fake(nvrtcGetNumSupportedArchs=lambda *_: 3))
    with pytest.raises(EngineError, match="NVRTC failed in nvrtcGetNumSupportedArchs: error 3"):
        nvrtc.architectures()
