"""Calls of the native library, which is loaded with ctypes and knows no headers of Python, numpy or torch.

Arrays go in as pointers, so each must be contiguous, of the right type, and must outlive the call.
"""

from __future__ import annotations

import ctypes
import sys
from ctypes import c_char, c_double, c_int32, c_int64
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.scene.arrays import Array, kind_of, namespace

ABI_VERSION = 18


@cache
def library() -> ctypes.CDLL:
    """Load the library. Raises EngineError with the way out if it is missing or of another version."""
    path = Path(__file__).with_name("_cubicsplat" + {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so"))
    try:
        lib = ctypes.CDLL(str(path))
    except OSError as error:
        advice = "reinstall with `pip install --force-reinstall cubicsplat` (from source this needs a C++17 compiler)"
        raise EngineError(f"the native engine {path.name} cannot be loaded ({error}); {advice}") from error
    if lib.cs_abi_version() != ABI_VERSION:
        raise EngineError(f"the native engine {path.name} is of another version; reinstall cubicsplat")
    return lib


@cache
def function(name: str, result: type | None) -> Any:
    """Return a function of the library, with the type of its result. Raises EngineError if the library is missing."""
    loaded = library()[name]
    loaded.restype = result
    return loaded


class Out:
    """An array of zeros that a native function fills: `native` passes it on, and returns it."""

    def __init__(self, shape: Any, dtype: Any = np.float64) -> None:
        self.array = np.zeros(shape, dtype)


def native(work: str, name: str, *given: Any, result: type | None = c_int32) -> Any:
    """Call a function of the library. Return the arrays of its `Out`s, a tuple if several, or else its result.

    given: contiguous arrays and `Out`s, passed as pointers; ints, which addresses are too, and bools, passed as int64;
    floats, passed as double; None, a null pointer; and objects of ctypes.
    result: c_int32, 0 unless the call fails; c_int64 or c_double, below 0 if it fails; c_void_p, null if it fails; or
    None. With c_int64 it is a count, and only so many first rows of each `Out` are returned.
    Raises EngineError without the library, for an array that is not contiguous, and without memory for the `work`.
    """
    value = function(name, result)(*map(_in_c, given))
    if result is not None and (value is None or value < 0 or (result is c_int32 and value)):
        raise EngineError(f"there is no memory for the {work} of the drawing; make the picture smaller")
    arrays = [argument.array for argument in given if argument.__class__ is Out]
    if not arrays:
        return value
    if result is c_int64:
        arrays = [array[:value].copy() for array in arrays]
    return tuple(arrays) if len(arrays) > 1 else arrays[0]


def _memory_of(array: np.ndarray) -> Any:
    """Return the first bytes of an array as an object of ctypes. Raises EngineError unless it is contiguous by rows."""
    if array.flags.carray:  # writeable too, as this way, five times faster than `array.ctypes`, needs it
        return _Memory.from_buffer(array.data)
    if not array.flags.c_contiguous:
        raise EngineError(f"expected an array that is contiguous by rows, not one of shape {array.shape}")
    return _Memory.from_address(array.ctypes.data)


def address_of(array: np.ndarray) -> int:
    """Return the address of an array. Raises EngineError unless it is contiguous by rows."""
    return ctypes.addressof(_memory_of(array))


def _in_c(given: Any) -> Any:
    """Convert an argument of `native`. The usual ones come first: there are a million in a large drawing."""
    kind = given.__class__
    if kind is np.ndarray:
        return _memory_of(given)
    if kind is int:
        return c_int64(given)
    if kind is Out:
        return _memory_of(given.array)
    if isinstance(given, float):
        return c_double(given)
    return c_int64(int(given)) if isinstance(given, (int, np.integer)) else given


_Memory = c_char * 0
# Contiguous arrays of one type, as the library takes them; an array that is one already stays the same object.
doubles, floats, int32s, int64s, bools = (
    partial(np.ascontiguousarray, dtype=t) for t in (np.float64, np.float32, np.int32, np.int64, bool)
)


def members(kind: Any, names: str) -> list[tuple[str, Any]]:
    """Return fields of a structure that are all of one kind. names: theirs, with spaces between them."""
    return [(name, kind) for name in names.split()]


def address_on(device: Any, array: Array, name: str, shape: tuple[int, ...], dtype: str = "float64") -> int | None:
    """Return the address of an array for an engine on a device, torch's or "cpu"; None for None.

    Raises EngineError, with the name, if the array is not contiguous, elsewhere, or of another shape or type.
    """
    if array is None:
        return None
    if tuple(array.shape) == shape and array.dtype == getattr(namespace(array), dtype):
        if isinstance(array, np.ndarray):
            if array.flags.c_contiguous and device == "cpu":
                return address_of(array)
        elif array.is_contiguous() and str(array.device) == str(device):
            return int(array.data_ptr())
    place = "the CPU" if str(device) == "cpu" else device
    given = f"{array.dtype} {tuple(array.shape)}, {kind_of(array)}"
    raise EngineError(f"{name} must be contiguous on {place}, {dtype} and of shape {shape}, not {given}")
