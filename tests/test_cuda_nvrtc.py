"""Finding NVIDIA's run-time compiler: torch's copy first, of torch's CUDA version; and what is said without one."""

from __future__ import annotations

import types
from pathlib import Path

import pytest

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster import cpu
from cubicsplat_cli.raster.cuda import nvrtc


@pytest.fixture
def packages(tmp_path):
    """Folders of torch and NVIDIA's packages, without NVRTC."""
    return [tmp_path / "torch", tmp_path / "nvidia"]


def put(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"")
    return str(path)


def test_the_compiler_of_torchs_cuda_comes_first(packages):
    """pip may bring NVRTC 13 beside a torch for CUDA 12, whose driver may be too old for it."""
    torch, nvidia = packages
    older = put(nvidia / "cuda_nvrtc/lib/libnvrtc.so.12")
    newer = put(nvidia / "cu13/lib/libnvrtc.so.13")
    put(nvidia / "cu13/lib/libnvrtc-builtins.so.13.5")
    put(nvidia / "cuda_nvrtc/lib/libnvrtc.so.11.2")
    assert nvrtc.library_names(packages, None, "linux")[0] == newer
    assert nvrtc.library_names(packages, "12.8", "linux") == [older, "libnvrtc.so.12", newer, "libnvrtc.so.13"]
    own = put(torch / "lib/libnvrtc.so.12")
    assert nvrtc.library_names(packages, "12.8", "linux")[0] == own
    assert nvrtc.library_names(packages, "14.0", "linux")[0] == "libnvrtc.so.14"


def test_windows_has_names_of_its_own(packages):
    library = put(packages[0] / "lib/nvrtc64_120_0.dll")
    assert nvrtc.library_names(packages, "12.8", "win32") == [library]


def test_without_a_compiler_the_way_out_is_said(tmp_path):
    with pytest.raises(
        EngineError, match=r"NVRTC cannot be loaded \(.*libnvrtc\.so\.12.*\); torch's CUDA wheels bring"
    ):
        nvrtc.loaded([str(tmp_path / "libnvrtc.so.12")])
    with pytest.raises(EngineError, match="there is none"):
        nvrtc.loaded([])


def test_a_library_that_lacks_a_function_is_passed_over():
    (other,) = Path(cpu.__file__).parent.glob("_cubicsplat.*")
    with pytest.raises(EngineError, match=r"NVRTC cannot be loaded \(.*nvrtcVersion"):
        nvrtc.loaded([str(other)])


def fake(**functions):
    """A library whose functions return 0 but for the given ones."""
    return types.SimpleNamespace(**({name: lambda *_: 0 for name in nvrtc.FUNCTIONS} | functions))


def test_old_compilers_and_failing_calls_are_said():
    def old(major, minor):
        major._obj.value, minor._obj.value = 11, 8
        return 0

    with pytest.raises(EngineError, match=r"NVRTC 11\.8 is too old; version 12 or newer is needed"):
        nvrtc.version(fake(nvrtcVersion=old))
    with pytest.raises(EngineError, match="NVRTC failed in nvrtcGetNumSupportedArchs: error 3"):
        nvrtc.architectures(fake(nvrtcGetNumSupportedArchs=lambda *_: 3))
