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
    """Return the driver's library. Raises EngineError if it cannot be loaded."""
    try:
        return ctypes.CDLL(name)
    except OSError as error:
        text = f"the NVIDIA driver's library {name} cannot be loaded ({one_line(error)})"
        raise EngineError(f"{text}; install the driver, or use --device cpu") from error


def gpus(opened: Callable[[], Any] = open_library) -> int:
    """Return the number of GPUs that the driver shows this process; 0 without a driver, or if it fails."""
    try:
        library = opened()
    except EngineError:
        return 0
    count = c_int()
    failed = library.cuInit(c_uint(0)) or library.cuDeviceGetCount(byref(count))
    return 0 if failed else count.value


class LibCuda:
    """The driver's library, whose calls raise DeviceError for an error."""

    def __init__(self) -> None:
        self._library = open_library()
        for function, arguments in PROTOTYPES.items():
            getattr(self._library, function).argtypes = arguments
        self.call("starting", "cuInit", 0)

    def call(self, doing: str, function: str, *arguments: object) -> None:
        """Call a function. doing: for the message of the error."""
        if status := int(getattr(self._library, function)(*arguments)):
            name = c_char_p()
            self._library.cuGetErrorName(status, byref(name))
            said = name.value.decode() if name.value else f"error {status}"
            raise DeviceError(f"the GPU failed while {doing}: {said}")

    def value(self, kind: type[Any], doing: str, function: str, *arguments: object) -> Any:
        """Return the value, of this ctypes type, that a function writes to its first argument."""
        value = kind()
        self.call(doing, function, byref(value), *arguments)
        return value
