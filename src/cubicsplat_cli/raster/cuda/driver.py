"""The little that the CUDA engine asks of a device: load kernels, launch them, capture launches in a graph.

`CudaDriver` does it with NVIDIA's driver, beside torch on torch's own streams and context. The tests have another one,
which runs the kernels on an emulator, so that everything above this file runs without a GPU as well.
"""

from __future__ import annotations

import ctypes
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from ctypes import c_int, c_void_p
from typing import Any, Protocol
from weakref import WeakSet

import torch
from torch import Tensor

from cubicsplat_cli.errors import DeviceError, EngineError
from cubicsplat_cli.formatting import one_line
from cubicsplat_cli.raster.cuda import libcuda, nvrtc
from cubicsplat_cli.raster.cuda.compile import Program, machine_code
from cubicsplat_cli.raster.cuda.frame import carve_out
from cubicsplat_cli.raster.cuda.libcuda import LibCuda

Argument = ctypes.Structure | c_void_p


class Kernels(Protocol):
    """The kernels of one program, ready to run."""

    def launch(self, name: str, grid: tuple[int, int], threads: int, shared: int, *arguments: Argument) -> None:
        """Queue a kernel of `grid` blocks with `threads` threads and `shared` bytes of dynamic shared memory each."""


class Driver(ABC):
    """A device with its memory and its queue, shared by all engines on it.

    device: torch's. shared_per_block: bytes of shared memory that a block may take without asking. shared_per_sm: bytes
    that the blocks of a multiprocessor share. tested: programs that have passed the self-test. lock: held while a
    program is loaded and tested, and while a graph is captured or dropped. turns: of `Engine.turn`.
    """

    device: torch.device
    shared_per_block: int
    shared_per_sm: int

    def __init__(self) -> None:
        self.tested: set[Program] = set()
        self.lock = threading.RLock()
        self.turns = threading.Lock()
        self._loaded: dict[Program, Kernels] = {}

    def kernels(self, program: Program) -> Kernels:
        """Return the kernels of a program, loaded once. Raises EngineError if they are not available."""
        with self.lock:
            if program not in self._loaded:
                self._loaded[program] = self._load(program)
            return self._loaded[program]

    @abstractmethod
    def _load(self, program: Program) -> Kernels:
        """Bring the kernels of a program to the device."""

    @abstractmethod
    def stream(self) -> int:
        """Return the address of the queue that launches go to now. Buffers of a queue must not be reused in another."""

    @abstractmethod
    def wait(self) -> None:
        """Wait until all that was launched in this queue is done."""

    @abstractmethod
    def capture(self, body: Callable[[], None]) -> Callable[[], None]:
        """Record the launches of `body` without running them. Return a function that runs them with these arguments.

        The caller holds the lock, here and where it drops the result: torch keeps a list of all graphs.
        """

    @abstractmethod
    def active(self) -> AbstractContextManager[Any]:
        """Return a context in which the device is torch's current one, and its failures are EngineErrors."""

    @abstractmethod
    def late_copy(self, source: Tensor) -> LateCopy:
        """Return a copy of a tensor that is read without waiting for the device."""

    @abstractmethod
    def describe(self) -> dict[str, object]:
        """Return its properties for the user, as plain values."""


class LateCopy:
    """Values of a small tensor on a device, some time after it had them, without waiting for the device.

    copy: a like tensor that the device can write to while the host goes on. event: None where copies are done at once.
    """

    def __init__(self, source: Tensor, copy: Tensor, event: torch.cuda.Event | None) -> None:
        self._source, self._copy, self._event = source, copy, event
        self._asked = False

    def poll(self) -> list[int] | None:
        """Return the values at the time of an earlier call, None while they are on their way. Ask for the next."""
        if self._asked and self._event is not None and not self._event.query():
            return None
        values = self._copy.tolist() if self._asked else None
        self._copy.copy_(self._source, non_blocking=True)
        if self._event is not None:
            self._event.record()
        self._asked = True
        return values


def missing_piece(cuda: str | None = torch.version.cuda) -> str | None:
    """Return why torch has no GPU here, and what to do, in one sentence; None if it has one. cuda: it is built for."""
    if cuda is None:
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


def require_gpu() -> None:
    """Raise EngineError, which says what to do, if torch has no GPU."""
    if reason := missing_piece():
        raise EngineError(reason)


class _LoadedKernels:
    """Functions of a module in the device's memory."""

    def __init__(self, driver: CudaDriver, module: c_void_p) -> None:
        self._driver = driver
        self._module = module
        self._functions: dict[str, c_void_p] = {}

    def _function(self, name: str, shared: int) -> c_void_p:
        if name not in self._functions:
            library = self._driver.library
            doing = f"looking up the kernel {name}"
            function = library.value(c_void_p, doing, "cuModuleGetFunction", self._module, name.encode())
            if shared:  # a hint how much of a multiprocessor's fast memory it would like as shared memory
                hint = libcuda.PREFERRED_SHARED_MEMORY_CARVEOUT, carve_out(name, shared, self._driver.shared_per_sm)
                library.call("dividing its memory", "cuFuncSetAttribute", function, *hint)
            self._functions[name] = function
        return self._functions[name]

    def launch(self, name: str, grid: tuple[int, int], threads: int, shared: int, *arguments: Argument) -> None:
        addresses = (c_void_p * len(arguments))(*map(ctypes.addressof, arguments))
        size, stream = (*grid, 1, threads, 1, 1, shared), self._driver.stream()
        given = self._function(name, shared), *size, stream, addresses, None
        self._driver.library.call(f"starting the kernel {name}", "cuLaunchKernel", *given)


class CudaDriver(Driver):
    """An NVIDIA GPU. index: torch's number of it (default: torch's current device). See `cuda_driver`.

    Raises EngineError with the missing piece: torch without CUDA, no GPU, no driver, too old a GPU or driver.
    """

    def __init__(self, index: int | None = None) -> None:
        super().__init__()
        require_gpu()
        try:
            number = torch.cuda.current_device() if index is None else index
            self.device = torch.device("cuda", number)
            with torch.cuda.device(self.device):
                torch.cuda.synchronize()  # creates torch's context, which the driver's calls then share
            properties = torch.cuda.get_device_properties(self.device)
        except (RuntimeError, AssertionError) as error:  # a wrong number, no memory for a context, a broken device
            name = "the current GPU" if index is None else f"cuda:{index}"
            raise EngineError(f"{name} cannot be used: {one_line(error)}") from error
        self._late_copies: WeakSet[LateCopy] = WeakSet()
        self.name = properties.name
        self.capability = (properties.major, properties.minor)
        self.memory = properties.total_memory
        self.library = library = LibCuda()
        device = library.value(c_int, "asking for the device", "cuDeviceGet", number)
        # The one that torch works in, held for the life of the process.
        self._context = library.value(c_void_p, "sharing torch's context", "cuDevicePrimaryCtxRetain", device)
        self.shared_per_block, self.shared_per_sm = (
            library.value(c_int, "asking for its properties", "cuDeviceGetAttribute", attribute, device).value
            for attribute in (libcuda.MAX_SHARED_MEMORY_PER_BLOCK, libcuda.MAX_SHARED_MEMORY_PER_MULTIPROCESSOR)
        )
        # 1000 major + 10 minor of the newest CUDA that it supports.
        self.driver_version = library.value(c_int, "asking for the driver's version", "cuDriverGetVersion").value
        if self.driver_version // 1000 < nvrtc.version()[0]:
            versions = f"it supports CUDA {self.driver_version // 1000}, the compiler is for CUDA {nvrtc.version()[0]}"
            advice = "update the driver, or install torch for the older CUDA"
            raise EngineError(f"the NVIDIA driver is too old: {versions}; {advice}")

    def _load(self, program: Program) -> Kernels:
        code, _ = machine_code(program, self.capability)
        with self.active():
            doing = "loading the kernels (is the driver too old?)"
            return _LoadedKernels(self, self.library.value(c_void_p, doing, "cuModuleLoadData", code))

    def stream(self) -> int:
        return torch.cuda.current_stream(self.device).cuda_stream

    def wait(self) -> None:
        torch.cuda.current_stream(self.device).synchronize()

    def capture(self, body: Callable[[], None]) -> Callable[[], None]:
        # torch.cuda.graph() would collect garbage and wait for the device first, which costs more than many steps.
        graph = torch.cuda.CUDAGraph()
        stream = torch.cuda.Stream(self.device)
        stream.wait_stream(torch.cuda.current_stream(self.device))
        with torch.cuda.stream(stream):
            graph.capture_begin(capture_error_mode="thread_local")
            try:
                body()
            except BaseException:
                # A failed launch spoils the capture, and ending it fails too: the first error is the one to tell.
                with suppress(RuntimeError):
                    graph.capture_end()
                raise
            graph.capture_end()
        torch.cuda.current_stream(self.device).wait_stream(stream)
        return graph.replay

    @contextmanager
    def active(self) -> Iterator[None]:
        try:
            with torch.cuda.device(self.device):
                # torch does not touch a device that is already the current one: a new thread may have no context yet,
                # and another library may have entered one of its own.
                now = self.library.value(c_void_p, "asking for the context", "cuCtxGetCurrent")
                entered = now.value != self._context.value
                if entered:
                    self.library.call("entering the context", "cuCtxPushCurrent_v2", self._context)
                try:
                    yield
                finally:
                    if entered:
                        self.library.value(c_void_p, "leaving the context", "cuCtxPopCurrent_v2")
        except DeviceError:
            self._give_up()
            raise
        except RuntimeError as error:  # of torch: an earlier kernel's failure, a lost device, also on the way out
            self._give_up()
            raise DeviceError(f"the GPU failed: {one_line(error)}; try again, or use --device cpu") from error

    def _give_up(self) -> None:
        """Keep the copies' memory for ever: to free it torch would ask the failed device, and end the process."""
        for copy in self._late_copies:
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(copy))

    def late_copy(self, source: Tensor) -> LateCopy:
        copy = LateCopy(source, torch.empty_like(source, device="cpu", pin_memory=True), torch.cuda.Event())
        self._late_copies.add(copy)
        return copy

    def describe(self) -> dict[str, object]:
        return {
            "gpu": self.name, "capability": ".".join(map(str, self.capability)),
            "memory_gb": round(self.memory / 1e9, 1), "driver_cuda": f"{self.driver_version // 1000}."
            f"{self.driver_version % 1000 // 10}", "nvrtc": ".".join(map(str, nvrtc.version())),
            "torch": torch.__version__,
        }  # fmt: skip


_drivers: dict[int | None, CudaDriver] = {}
_lock = threading.Lock()


def cuda_driver(index: int | None = None) -> CudaDriver:
    """Return this process's one driver of a GPU (default: torch's current one). Raises EngineError as `CudaDriver`."""
    with _lock:
        found = _drivers.get(index if index is not None else _current_device())
        if found is None:
            found = CudaDriver(index)
            _drivers[found.device.index] = found
        return found


def _current_device() -> int | None:
    """Return torch's current GPU; None if asking fails, which `CudaDriver` then reports."""
    try:
        return torch.cuda.current_device() if missing_piece() is None else None
    except (RuntimeError, AssertionError):
        return None
