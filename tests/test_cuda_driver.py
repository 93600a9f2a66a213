"""`CudaDriver` between stand-ins: for NVIDIA's bindings, which run the emulator, and for torch's streams and graphs."""

from __future__ import annotations

import ctypes
import types
from contextlib import contextmanager

import pytest
import torch
from emulated import EmulatedDriver, compiler
from engines import packed, state_for
from scenes import PAPER, random_scene, random_target

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.cuda import compile as cuda_compile
from cubicsplat_cli.raster.cuda import driver as cuda_driver
from cubicsplat_cli.raster.cuda.driver import CudaDriver
from cubicsplat_cli.raster.cuda.engine import CudaEngine
from cubicsplat_cli.raster.cuda.frame import Frame, StepValues
from cubicsplat_cli.raster.engine import Rates
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.settings import Mode

pytestmark = pytest.mark.skipif(compiler() is None, reason="needs a C++ compiler")
OK, OLD_CODE = 0, 222
MAIN_STREAM, OTHER_STREAM = types.SimpleNamespace(cuda_stream=7), types.SimpleNamespace(cuda_stream=8)


class FakeCuda:
    """One GPU: driver calls as `cuda.bindings.driver` has them, and streams and graphs as `torch.cuda` has them."""

    def __init__(self) -> None:
        self.context = 0
        self.version = 13000
        self.loading = OK
        self.stream = MAIN_STREAM
        self.captured: list | None = None
        self.kernels = None
        self.calls: list[tuple] = []
        self.CUdevice_attribute = types.SimpleNamespace(
            CU_DEVICE_ATTRIBUTE_MAX_SHARED_MEMORY_PER_BLOCK="block",
            CU_DEVICE_ATTRIBUTE_MAX_SHARED_MEMORY_PER_MULTIPROCESSOR="sm",
        )

    def cuDeviceGet(self, index):
        return OK, f"device {index}"

    def cuDevicePrimaryCtxRetain(self, device):
        return OK, 77

    def cuCtxGetCurrent(self):
        return OK, self.context

    def cuCtxSetCurrent(self, context):
        self.context = context
        return (OK,)

    def cuDriverGetVersion(self):
        return OK, self.version

    def cuDeviceGetAttribute(self, attribute, device):
        return OK, {"block": 48 * 1024, "sm": 228 * 1024}[attribute]

    def cuModuleLoadData(self, code):
        assert self.context == 77
        program = dict(line.split("=") for line in code.decode().split())
        mode, channels = Mode(program["mode"]), int(program["channels"])
        self.kernels = EmulatedDriver().load(cuda_compile.Program(mode, channels))
        return self.loading, self.kernels

    def cuModuleGetFunction(self, module, name):
        return OK, (module, name.decode())

    def cuLaunchKernel(self, function, gx, gy, gz, bx, by, bz, shared, stream, parameters, extra):
        assert (gz, by, bz, extra) == (1, 1, 1, 0)
        assert stream == self.stream.cuda_stream
        kernels, name = function
        kinds = (StepValues, ctypes.c_void_p) if name == "set_step" else (Frame,)
        addresses = (ctypes.c_void_p * len(kinds)).from_address(parameters)
        copies = [kind.from_buffer_copy(kind.from_address(at)) for kind, at in zip(kinds, addresses, strict=True)]
        self.calls.append((name, "captured" if self.captured is not None else "run"))
        if self.captured is not None:
            self.captured.append((kernels, name, gx, gy, bx, shared, copies))
        else:
            kernels.launch(name, (gx, gy), bx, shared, *copies)
        return (OK,)

    @contextmanager
    def use(self, stream):
        before, self.stream = self.stream, stream
        yield
        self.stream = before

    def graph(self):
        cuda = self

        class Graph:
            def capture_begin(self, capture_error_mode):
                assert cuda.stream is OTHER_STREAM, "a capture on the stream in use would need the device to be idle"
                cuda.captured = []

            def capture_end(self):
                self.launches, cuda.captured = cuda.captured, None

            def replay(self):
                cuda.calls.append(("graph", "replayed"))
                for kernels, name, gx, gy, bx, shared, copies in self.launches:
                    kernels.launch(name, (gx, gy), bx, shared, *copies)

        return Graph()


@pytest.fixture
def fake(monkeypatch):
    fake = FakeCuda()
    MAIN_STREAM.wait_stream = OTHER_STREAM.wait_stream = lambda other: None
    properties = types.SimpleNamespace(name="Pretender", major=9, minor=0, total_memory=10**11)
    replaced = {
        "current_device": lambda: 0, "device": lambda device: fake.use(fake.stream), "synchronize": lambda: None,
        "get_device_properties": lambda device: properties, "current_stream": lambda device: fake.stream,
        "Stream": lambda device: OTHER_STREAM, "stream": fake.use, "CUDAGraph": fake.graph,
    }  # fmt: skip
    for name, value in replaced.items():
        monkeypatch.setattr(torch.cuda, name, value)
    monkeypatch.setattr(cuda_driver, "missing_piece", lambda: None)
    monkeypatch.setattr(cuda_driver, "_bindings", lambda: fake)
    monkeypatch.setattr(cuda_driver, "version", lambda: (13, 0))

    def machine_code(program, capability):
        return f"mode={program.mode.value} channels={program.channels}".encode(), "sm_90"

    monkeypatch.setattr(cuda_driver, "machine_code", machine_code)
    return fake


def test_steps_go_through_the_driver_and_its_graphs(fake):
    driver = CudaDriver()
    assert driver.device == torch.device("cuda", 0)
    driver.device = torch.device("cpu")  # where the emulator's memory is
    engine = CudaEngine(driver=driver)
    assert engine.describe()["gpu"] == "Pretender"
    scene = random_scene(Mode.OPEN, 9, 2, 30, 26, background=PAPER)
    target, settings, rates = random_target(scene, 1), RasterSettings("relaxed", 1.5, 8), Rates(0.2, 0.02, 0.02, 0.01)
    here, there = packed(scene), packed(scene)
    states = state_for(here), state_for(there)
    fake.calls.clear()
    fake.context = 0  # as in a new thread
    for _ in range(4):
        got = float(engine.step(here, settings, target, states[0], rates))
        assert got == pytest.approx(CpuEngine(1).step(there, settings, target, states[1], rates), rel=1e-3)
    names = ("flatten", "bin", "raster_relaxed", "update")
    steps = [call for call in fake.calls if call != ("set_step", "run")]
    tests = 2 * (3 + 4)  # this program's self-test: a picture and gradients in two kinds of coverage
    wanted = [(name, "run") for name in names] + [(name, "captured") for name in names] + 3 * [("graph", "replayed")]
    assert steps[tests:] == wanted
    assert fake.context == 77


def test_what_goes_wrong_is_said(fake, monkeypatch):
    fake.loading = OLD_CODE
    with pytest.raises(EngineError, match=r"GPU failed while loading the kernels \(is the driver too old\?\): 222"):
        CudaDriver().load(cuda_compile.Program(Mode.CLOSED, 3))
    fake.version = 12040
    with pytest.raises(EngineError, match=r"driver is too old: it supports CUDA 12, the compiler is for CUDA 13"):
        CudaDriver()

    def broken():
        raise RuntimeError("CUDA error: out of memory\nCompile with ...")

    monkeypatch.setattr(torch.cuda, "synchronize", broken)
    with pytest.raises(EngineError, match="cuda:0 cannot be used: CUDA error: out of memory Compile"):
        CudaDriver()


def test_a_failed_launch_is_said(fake):
    driver = CudaDriver()
    driver.device = torch.device("cpu")
    engine = CudaEngine(driver=driver)

    class Status(int):
        name = "CUDA_ERROR_ILLEGAL_ADDRESS"

    fake.cuLaunchKernel = lambda *_: (Status(700),)
    scene = packed(random_scene(Mode.CLOSED, 2, 2, background=PAPER))
    with pytest.raises(EngineError, match="GPU failed while starting the kernel set_step: CUDA_ERROR_ILLEGAL_ADDRESS"):
        engine.render(scene, RasterSettings())
