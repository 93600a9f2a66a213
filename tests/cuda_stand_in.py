"""One GPU without one: the driver's library as C functions in Python, and torch's streams, events and graphs.

The C functions are called through ctypes with the prototypes of `libcuda`, so arguments cross over as they would to the
real library: as addresses and plain numbers. Kernels that are launched run on the emulator.
"""

from __future__ import annotations

import ctypes
import types
from contextlib import contextmanager

import torch
from emulated import EmulatedDriver

from cubicsplat_cli.raster.cuda import driver as cuda_driver
from cubicsplat_cli.raster.cuda import libcuda, nvrtc
from cubicsplat_cli.raster.cuda.compile import Program
from cubicsplat_cli.raster.cuda.frame import StepFrame, StepValues
from cubicsplat_cli.settings import Mode

CONTEXT = 77  # torch's
MAIN_STREAM, OTHER_STREAM = types.SimpleNamespace(cuda_stream=7), types.SimpleNamespace(cuda_stream=8)
KINDS = {"set_step": (StepValues, ctypes.c_void_p)}


class FakeGpu:
    """What its tests look at and set: contexts (a stack), failing (status by function), out_of_memory (functions of
    torch that say so), calls, captured, hints.
    """

    def __init__(self) -> None:
        self.contexts: list[int] = []
        self.version = 13000
        self.failing: dict[str, int] = {}
        self.out_of_memory: set[str] = set()
        self.streams = [MAIN_STREAM]
        self.captured: list | None = None
        self.calls: list[tuple[str, str]] = []
        self.loads: list[Program] = []
        self.hints: dict[str, int] = {}
        self.launch_errors: list[int] = []
        self._handles: list[object] = [None]
        self._emulated = EmulatedDriver()

    def library(self) -> types.SimpleNamespace:
        """The functions of `libcuda.PROTOTYPES`, callable from C."""
        made = {}
        for name, arguments in libcuda.PROTOTYPES.items():
            prototype = ctypes.CFUNCTYPE(ctypes.c_int, *arguments)
            made[name] = prototype(lambda *a, name=name: self.failing.get(name) or getattr(self, name)(*a) or 0)
        return types.SimpleNamespace(**made)

    def asked(self, function: str) -> None:
        """What torch says of it."""
        if function in self.out_of_memory:
            raise RuntimeError("CUDA error: out of memory\nCompile with ...")

    def _handle(self, thing: object) -> int:
        self._handles.append(thing)
        return len(self._handles) - 1

    def cuInit(self, flags):
        assert flags == 0

    def cuDriverGetVersion(self, version):
        version[0] = self.version

    def cuGetErrorName(self, status, name):
        known = {700: b"CUDA_ERROR_ILLEGAL_ADDRESS", 222: b"CUDA_ERROR_UNSUPPORTED_PTX_VERSION"}
        if status not in known:
            return 1
        name[0] = known[status]
        return 0

    def cuDeviceGet(self, device, index):
        device[0] = 40 + index

    def cuDeviceGetAttribute(self, value, attribute, device):
        assert device == 40
        value[0] = {
            libcuda.MAX_SHARED_MEMORY_PER_BLOCK: 48 * 1024, libcuda.MAX_SHARED_MEMORY_PER_MULTIPROCESSOR: 228 * 1024
        }[attribute]  # fmt: skip

    def cuDevicePrimaryCtxRetain(self, context, device):
        context[0] = CONTEXT

    def cuCtxGetCurrent(self, context):
        context[0] = self.contexts[-1] if self.contexts else None

    def cuCtxPushCurrent_v2(self, context):
        self.contexts.append(context)

    def cuCtxPopCurrent_v2(self, context):
        context[0] = self.contexts.pop()

    def cuModuleLoadData(self, module, code):
        assert self.contexts[-1] == CONTEXT
        mode, channels = code.decode().split()
        self.loads.append(Program(Mode(mode), int(channels)))
        module[0] = self._handle(self._emulated.kernels(self.loads[-1]))

    def cuModuleGetFunction(self, function, module, name):
        function[0] = self._handle((self._handles[module], name.decode()))

    def cuFuncSetAttribute(self, function, attribute, value):
        assert attribute == libcuda.PREFERRED_SHARED_MEMORY_CARVEOUT
        self.hints[self._handles[function][1]] = value

    def cuLaunchKernel(self, function, gx, gy, gz, bx, by, bz, shared, stream, parameters, extra):
        assert (gz, by, bz) == (1, 1, 1)
        assert not extra
        assert stream == self.streams[-1].cuda_stream
        assert self.contexts[-1] == CONTEXT
        kernels, name = self._handles[function]
        if self.launch_errors:
            return self.launch_errors.pop(0)
        # An argument's value is taken at the launch, as the driver does.
        values = [kind.from_buffer_copy(kind.from_address(parameters[i])) for i, kind in enumerate(self._kinds(name))]
        self.calls.append((name, "captured" if self.captured is not None else "run"))
        launch = (kernels, name, gx, gy, bx, shared, values)
        if self.captured is not None:
            self.captured.append(launch)
        else:
            self.run(launch)
        return 0

    @staticmethod
    def _kinds(name: str) -> tuple:
        return KINDS.get(name, (StepFrame,))

    @staticmethod
    def run(launch: tuple) -> None:
        kernels, name, gx, gy, bx, shared, values = launch
        kernels.launch(name, (gx, gy), bx, shared, *values)

    @contextmanager
    def use(self, stream):
        self.streams.append(stream)
        yield
        self.streams.pop()

    def graph(self):
        gpu = self

        class Graph:
            def capture_begin(self, capture_error_mode):
                assert gpu.streams[-1] is OTHER_STREAM, "a capture on the stream in use would need an idle device"
                gpu.captured = []

            def capture_end(self):
                launches, gpu.captured = gpu.captured, None
                if len(launches) < 3:
                    raise RuntimeError("CUDA error: operation failed due to a previous error during capture")
                self.launches = launches

            def replay(self):
                gpu.calls.append(("graph", "replayed"))
                for launch in self.launches:
                    gpu.run(launch)

        return Graph()


class FakeEvent:
    """done: whether what was recorded has happened."""

    done = True

    def record(self) -> None:
        pass

    def query(self) -> bool:
        return FakeEvent.done


def install(monkeypatch) -> FakeGpu:
    """Puts a fake GPU in the place of the driver's library and of what torch.cuda offers."""
    gpu = FakeGpu()
    MAIN_STREAM.wait_stream = OTHER_STREAM.wait_stream = lambda other: None
    properties = types.SimpleNamespace(name="Pretender", major=9, minor=0, total_memory=10**11)
    replaced = {
        "current_device": lambda: gpu.asked("current_device") or 0,
        "device": lambda device: gpu.use(gpu.streams[-1]), "synchronize": lambda: gpu.asked("synchronize"),
        "get_device_properties": lambda device: properties, "current_stream": lambda device: gpu.streams[-1],
        "Stream": lambda device: OTHER_STREAM, "stream": gpu.use, "CUDAGraph": gpu.graph, "Event": FakeEvent,
    }  # fmt: skip
    empty_like, text = torch.empty_like, "{0.mode.value} {0.channels}"
    places = [
        *((torch.cuda, name, value) for name, value in replaced.items()),
        (torch, "empty_like", lambda t, pin_memory=False, **options: empty_like(t, **options)),
        (cuda_driver, "missing_piece", lambda: None),
        (cuda_driver, "_drivers", {}),
        (libcuda, "open_library", gpu.library),
        (nvrtc, "version", lambda: (13, 0)),
        (cuda_driver, "machine_code", lambda program, _: (text.format(program).encode(), "sm_90")),
    ]
    for owner, name, value in places:
        monkeypatch.setattr(owner, name, value)
    return gpu


def on_the_cpu(driver: cuda_driver.CudaDriver) -> cuda_driver.CudaDriver:
    """The driver with its tensors where the emulator's memory is."""
    driver.device = torch.device("cpu")
    return driver
