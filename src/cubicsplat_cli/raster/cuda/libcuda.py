"""NVIDIA's driver library, called with ctypes: the dozen functions that torch does not offer."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from ctypes import POINTER, byref, c_char_p, c_int, c_uint, c_void_p
from typing import Any

from cubicsplat_cli.errors import DeviceError, EngineError
from cubicsplat_cli.formatting import one_line

# Arguments of the functions in use (cuda.h); each returns a status, 0 for success.
PROTOTYPES: dict[str, list[Any]] = {
    "cuInit": [c_uint],
    "cuDriverGetVersion": [POINTER(c_int)],
    "cuGetErrorName": [c_int, POINTER(c_char_p)],
    "cuDeviceGet": [POINTER(c_int), c_int],
    "cuDeviceGetAttribute": [POINTER(c_int), c_int, c_int],
    "cuDevicePrimaryCtxRetain": [POINTER(c_void_p), c_int],
    "cuCtxGetCurrent": [POINTER(c_void_p)],
    "cuCtxPushCurrent_v2": [c_void_p],
    "cuCtxPopCurrent_v2": [POINTER(c_void_p)],
    "cuModuleLoadData": [POINTER(c_void_p), c_char_p],
    "cuModuleGetFunction": [POINTER(c_void_p), c_void_p, c_char_p],
    "cuFuncSetAttribute": [c_void_p, c_int, c_int],
    "cuLaunchKernel": [c_void_p, *[c_uint] * 7, c_void_p, POINTER(c_void_p), POINTER(c_void_p)],
}
# Numbers of CUdevice_attribute and CUfunction_attribute.
MAX_SHARED_MEMORY_PER_BLOCK = 8
MAX_SHARED_MEMORY_PER_MULTIPROCESSOR = 81
PREFERRED_SHARED_MEMORY_CARVEOUT = 9


def open_library(name: str = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1") -> Any:
    """The driver's library, which comes with the driver. Raises EngineError where it cannot be loaded."""
    try:
        return ctypes.CDLL(name)
    except OSError as error:
        raise EngineError(
            f"the NVIDIA driver's library {name} cannot be loaded ({one_line(error)}); install the driver, or use "
            "--device cpu"
        ) from error


def gpus(opened: Callable[[], Any] = open_library) -> int:
    """The number of GPUs that the driver shows this process; 0 where there is no driver, or it fails. Needs no
    torch."""
    try:
        library = opened()
    except EngineError:
        return 0
    count = c_int()
    if library.cuInit(c_uint(0)) or library.cuDeviceGetCount(byref(count)):
        return 0
    return count.value


class LibCuda:
    """The functions, as methods that return their value and raise DeviceError for their error."""

    def __init__(self) -> None:
        self._library = open_library()
        for function, arguments in PROTOTYPES.items():
            getattr(self._library, function).argtypes = arguments
        self._checked("starting", "cuInit", 0)

    def _checked(self, doing: str, function: str, *arguments: object) -> None:
        if status := int(getattr(self._library, function)(*arguments)):
            name = c_char_p()
            self._library.cuGetErrorName(status, byref(name))
            said = name.value.decode() if name.value else f"error {status}"
            raise DeviceError(f"the GPU failed while {doing}: {said}")

    def _value(self, kind: type[Any], doing: str, function: str, *arguments: object) -> Any:
        """The value, of this ctypes type, that a function writes to its first argument."""
        value = kind()
        self._checked(doing, function, byref(value), *arguments)
        return value

    def driver_version(self) -> int:
        """1000 major + 10 minor of the newest CUDA that the driver supports."""
        return int(self._value(c_int, "asking for the driver's version", "cuDriverGetVersion").value)

    def device(self, index: int) -> int:
        """Handle of the GPU that torch has under this number."""
        return int(self._value(c_int, "asking for the device", "cuDeviceGet", index).value)

    def attribute(self, device: int, attribute: int) -> int:
        return int(self._value(c_int, "asking for its properties", "cuDeviceGetAttribute", attribute, device).value)

    def primary_context(self, device: int) -> c_void_p:
        """The context that torch works in; held for the life of the process."""
        return self._value(c_void_p, "sharing torch's context", "cuDevicePrimaryCtxRetain", device)

    def current_context(self) -> int | None:
        """Address of the context that this thread's calls go to."""
        return self._value(c_void_p, "asking for the context", "cuCtxGetCurrent").value

    def push(self, context: c_void_p) -> None:
        self._checked("entering the context", "cuCtxPushCurrent_v2", context)

    def pop(self) -> None:
        self._value(c_void_p, "leaving the context", "cuCtxPopCurrent_v2")

    def load_module(self, code: bytes) -> c_void_p:
        """A module from machine code, or from intermediate code that ends with a zero byte."""
        return self._value(c_void_p, "loading the kernels (is the driver too old?)", "cuModuleLoadData", code)

    def function(self, module: c_void_p, name: str) -> c_void_p:
        return self._value(c_void_p, f"looking up the kernel {name}", "cuModuleGetFunction", module, name.encode())

    def carve_out(self, function: c_void_p, percent: int) -> None:
        """Hints how much of a multiprocessor's fast memory a kernel would like as shared memory."""
        self._checked("dividing its memory", "cuFuncSetAttribute", function, PREFERRED_SHARED_MEMORY_CARVEOUT, percent)

    def launch(
        self, name: str, function: c_void_p, grid: tuple[int, int], threads: int, shared: int, stream: int,
        arguments: tuple[ctypes.Structure | c_void_p, ...],
    ) -> None:  # fmt: skip
        """Queues a kernel. Its arguments are copied before this returns."""
        addresses = (c_void_p * len(arguments))(*(ctypes.addressof(argument) for argument in arguments))
        self._checked(
            f"starting the kernel {name}", "cuLaunchKernel",
            function, grid[0], grid[1], 1, threads, 1, 1, shared, stream, addresses, None,
        )  # fmt: skip
