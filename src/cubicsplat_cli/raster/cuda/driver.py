"""The little that the CUDA engine asks of a device: load kernels, launch them, capture launches in a graph.

`CudaDriver` does it with NVIDIA's driver, beside torch on torch's own streams and context. The tests have another one,
which runs the kernels on an emulator, so that everything above this file runs without a GPU as well.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from types import ModuleType
from typing import Any, Protocol

import torch

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cuda.compile import INSTALL, Program, machine_code, version
from cubicsplat_cli.words import one_line

Argument = ctypes.Structure | ctypes.c_void_p


class Kernels(Protocol):
    """The kernels of one program, ready to run."""

    def launch(self, name: str, grid: tuple[int, int], threads: int, shared: int, *arguments: Argument) -> None:
        """Queues a kernel of `grid` blocks with `threads` threads and `shared` bytes of dynamic shared memory each."""


class Driver(Protocol):
    """A device with its memory and its queue."""

    device: torch.device
    shared_per_block: int  # bytes of shared memory a block may take without asking
    shared_per_sm: int  # bytes that the blocks of a multiprocessor share

    def load(self, program: Program) -> Kernels:
        """The kernels of a program. Raises EngineError where they cannot be had."""

    def capture(self, body: Callable[[], None]) -> Callable[[], None]:
        """Records the launches of `body` without running them; the result replays them with the same arguments."""

    def active(self) -> AbstractContextManager[Any]:
        """Within, the device is torch's current one."""

    def describe(self) -> dict[str, object]:
        """What the user should know of it, as plain values."""


def missing_piece() -> str | None:
    """Why torch has no GPU here, in one sentence that says what to do; None where it has one."""
    if torch.version.cuda is None:
        return "this torch has no CUDA: install the CUDA wheel of torch (https://pytorch.org), or use --device cpu"
    if torch.cuda.is_available():
        return None
    try:
        torch.cuda.init()
    except (RuntimeError, AssertionError) as error:
        reason = one_line(error)
    else:
        reason = "torch sees no GPU"
    return f"no usable GPU: {reason.rstrip('.')}; check nvidia-smi and CUDA_VISIBLE_DEVICES, or use --device cpu"


def _bindings() -> ModuleType:
    try:
        from cuda.bindings import driver
    except ImportError as error:
        raise EngineError(f"the CUDA engine needs the Python package cuda-bindings ({error}); {INSTALL}") from error
    return driver


class _LoadedKernels:
    """Functions of a module in the device's memory."""

    def __init__(self, driver: CudaDriver, module: Any) -> None:
        self._driver = driver
        self._module = module
        self._functions: dict[str, Any] = {}

    def launch(self, name: str, grid: tuple[int, int], threads: int, shared: int, *arguments: Argument) -> None:
        driver = self._driver
        if name not in self._functions:
            found = driver.bindings.cuModuleGetFunction(self._module, name.encode())
            self._functions[name] = driver.checked(found, f"looking up the kernel {name}")
        addresses = (ctypes.c_void_p * len(arguments))(*(ctypes.addressof(argument) for argument in arguments))
        stream = torch.cuda.current_stream(driver.device).cuda_stream
        launched = driver.bindings.cuLaunchKernel(
            self._functions[name], grid[0], grid[1], 1, threads, 1, 1, shared, stream, ctypes.addressof(addresses), 0
        )
        driver.checked(launched, f"starting the kernel {name}")


class CudaDriver:
    """An NVIDIA GPU. index: torch's number of it (default: torch's current device).

    Raises EngineError with the missing piece: torch without CUDA, no GPU, no bindings, too old a GPU or driver.
    """

    def __init__(self, index: int | None = None) -> None:
        if reason := missing_piece():
            raise EngineError(reason)
        self.bindings = _bindings()
        self.device = torch.device("cuda", torch.cuda.current_device() if index is None else index)
        try:
            with torch.cuda.device(self.device):
                torch.cuda.synchronize()  # creates torch's context, which the driver's calls then share
            properties = torch.cuda.get_device_properties(self.device)
        except (RuntimeError, AssertionError) as error:  # a wrong number, no memory for a context, a broken device
            raise EngineError(f"{self.device} cannot be used: {one_line(error)}") from error
        self._number = self.checked(self.bindings.cuDeviceGet(self.device.index), "asking for the device")
        self._context = self.checked(self.bindings.cuDevicePrimaryCtxRetain(self._number), "sharing torch's context")
        self.name = properties.name
        self.capability = (properties.major, properties.minor)
        self.memory = properties.total_memory
        self.shared_per_block = self._attribute("MAX_SHARED_MEMORY_PER_BLOCK")
        self.shared_per_sm = self._attribute("MAX_SHARED_MEMORY_PER_MULTIPROCESSOR")
        self.driver_version = int(self.checked(self.bindings.cuDriverGetVersion(), "asking for the driver's version"))
        self.architecture = ""
        if self.driver_version // 1000 < version()[0]:
            raise EngineError(
                f"the NVIDIA driver is too old: it supports CUDA {self.driver_version // 1000}, the compiler is for "
                f"CUDA {version()[0]}; update the driver, or install torch for the older CUDA"
            )

    def checked(self, result: tuple[Any, ...], doing: str) -> Any:
        """The value of a driver call. Raises EngineError for its error."""
        status, *rest = result
        if int(status) != 0:
            raise EngineError(f"the GPU failed while {doing}: {getattr(status, 'name', status)}")
        return rest[0] if rest else None

    def _attribute(self, name: str) -> int:
        attribute = getattr(self.bindings.CUdevice_attribute, f"CU_DEVICE_ATTRIBUTE_{name}")
        return int(self.checked(self.bindings.cuDeviceGetAttribute(attribute, self._number), f"asking for {name}"))

    def load(self, program: Program) -> Kernels:
        code, self.architecture = machine_code(program, self.capability)
        with self.active():
            module = self.checked(self.bindings.cuModuleLoadData(code), "loading the kernels (is the driver too old?)")
        return _LoadedKernels(self, module)

    def capture(self, body: Callable[[], None]) -> Callable[[], None]:
        # torch.cuda.graph() would collect garbage and wait for the device first, which costs more than many steps.
        graph = torch.cuda.CUDAGraph()
        stream = torch.cuda.Stream(self.device)
        stream.wait_stream(torch.cuda.current_stream(self.device))
        with torch.cuda.stream(stream):
            graph.capture_begin(capture_error_mode="thread_local")
            try:
                body()
            finally:
                graph.capture_end()
        torch.cuda.current_stream(self.device).wait_stream(stream)
        return graph.replay

    @contextmanager
    def active(self) -> Iterator[None]:
        with torch.cuda.device(self.device):
            # torch does not touch a device that is already the current one, so a new thread may have no context yet.
            if int(self.checked(self.bindings.cuCtxGetCurrent(), "asking for the context")) == 0:
                self.checked(self.bindings.cuCtxSetCurrent(self._context), "entering the context")
            yield

    def describe(self) -> dict[str, object]:
        return {
            "gpu": self.name, "capability": ".".join(map(str, self.capability)),
            "memory_gb": round(self.memory / 1e9, 1), "driver_cuda": f"{self.driver_version // 1000}."
            f"{self.driver_version % 1000 // 10}", "nvrtc": ".".join(map(str, version())), "torch": torch.__version__,
        }  # fmt: skip
