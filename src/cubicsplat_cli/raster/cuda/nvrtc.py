"""NVIDIA's run-time compiler NVRTC, called with ctypes: torch's own copy, so that their versions fit each other."""

from __future__ import annotations

import ctypes
import importlib.util
import re
import sys
from collections.abc import Sequence
from ctypes import byref, c_char_p, c_int, c_size_t, c_void_p, create_string_buffer
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.formatting import one_line

OLDEST_VERSION = 12
INSTALL = "torch's CUDA wheels bring it; else: pip install nvidia-cuda-nvrtc"
# The functions in use (nvrtc.h); each returns a status, 0 for success.
FUNCTIONS = (
    "nvrtcVersion", "nvrtcGetNumSupportedArchs", "nvrtcGetSupportedArchs", "nvrtcCreateProgram", "nvrtcCompileProgram",
    "nvrtcGetProgramLogSize", "nvrtcGetProgramLog", "nvrtcGetCUBINSize", "nvrtcGetCUBIN", "nvrtcGetPTXSize",
    "nvrtcGetPTX", "nvrtcDestroyProgram",
)  # fmt: skip
_PATTERNS = {"linux": ("libnvrtc.so.*", r"so\.(\d+)"), "win32": ("nvrtc64_*_0.dll", r"64_(\d+)\d_")}


def _packages() -> list[Path]:
    """Return the folders of torch, and of NVIDIA's packages."""
    nvidia = importlib.util.find_spec("nvidia")
    return [Path(torch.__file__).parent, *map(Path, (nvidia and nvidia.submodule_search_locations) or ())]


def library_names(
    packages: Sequence[Path] | None = None, cuda: str | None = torch.version.cuda, platform: str = sys.platform
) -> list[str]:
    """Return files of NVRTC, then names for the system's loader; those of torch's CUDA version first, then the newest.

    packages: folders of torch and of NVIDIA's packages (default: this Python's). cuda: the version of torch's CUDA.
    """
    pattern, version = _PATTERNS.get(platform, _PATTERNS["linux"])
    found = {}
    torchs, *nvidias = _packages() if packages is None else packages
    # torch/lib, nvidia/cuda_nvrtc/lib (12), nvidia/cu13/lib.
    folders = [path for place in nvidias for name in ("lib", "bin") for path in sorted(place.glob(f"*/{name}"))]
    for folder in (torchs / "lib", *folders):
        for path in sorted(folder.glob(pattern)):
            if match := re.search(version, path.name):
                found[str(path)] = int(match[1])
    of_torch = int((cuda or "0").split(".")[0])
    if platform == "linux":
        found |= {f"libnvrtc.so.{n}": n for n in {of_torch, 13, 12} if n >= OLDEST_VERSION}
    # Sorting keeps the order of equals: files before names.
    return sorted((f for f in found if found[f] >= OLDEST_VERSION), key=lambda f: (found[f] != of_torch, -found[f]))


@lru_cache(maxsize=1)
def nvrtc_library() -> Any:
    """Return the library. Raises EngineError if there is none that can be used."""
    return loaded(library_names())


def loaded(names: Sequence[str]) -> Any:
    """Return the first of these libraries that can be used. Raises EngineError if there is none."""
    why = "there is none"
    for name in names:
        try:
            found = ctypes.CDLL(name)
            for function in FUNCTIONS:
                getattr(found, function)
        except (OSError, AttributeError) as error:  # not there, or too old to have all functions
            why = one_line(error)
            continue
        return found
    raise EngineError(f"NVIDIA's run-time compiler NVRTC cannot be loaded ({why[:200]}); {INSTALL}")


def _checked(function: str, *arguments: object, library: Any = None) -> None:
    if status := int(getattr(library or nvrtc_library(), function)(*arguments)):
        raise EngineError(f"NVRTC failed in {function}: error {status}")


def version(of: Any = None) -> tuple[int, int]:
    """Return the version of an NVRTC (default: `nvrtc_library`). Raises EngineError if it is too old, or missing."""
    major, minor = c_int(), c_int()
    _checked("nvrtcVersion", byref(major), byref(minor), library=of)
    if major.value < OLDEST_VERSION:
        raise EngineError(f"NVRTC {major.value}.{minor.value} is too old; version 12 or newer is needed. {INSTALL}")
    return major.value, minor.value


def architectures(of: Any = None) -> list[int]:
    """Return the compute capabilities that an NVRTC (default: `nvrtc_library`) knows, 10 * major + minor, ascending."""
    count = c_int()
    _checked("nvrtcGetNumSupportedArchs", byref(count), library=of)
    numbers = (c_int * count.value)()
    _checked("nvrtcGetSupportedArchs", numbers, library=of)
    return sorted(numbers)


def _result(handle: c_void_p, size_of: str, get: str) -> bytes:
    size = c_size_t()
    _checked(size_of, handle, byref(size))
    text = create_string_buffer(max(1, size.value))
    _checked(get, handle, text)
    return text.raw[: size.value]


def compile_program(
    name: str, text: bytes, headers: dict[str, bytes], options: list[str], *, intermediate: bool = False
) -> tuple[bytes | None, str]:
    """Compile a text with its headers by name. Return the machine code, or PTX if `intermediate`, and the log.

    The code is None if the text has a mistake, which the log then shows.
    """
    handle = c_void_p()
    names = (c_char_p * len(headers))(*(header.encode() for header in headers))
    texts = (c_char_p * len(headers))(*headers.values())
    _checked("nvrtcCreateProgram", byref(handle), text, name.encode(), len(headers), texts, names)
    try:
        chosen = (c_char_p * len(options))(*(option.encode() for option in options))
        status = nvrtc_library().nvrtcCompileProgram(handle, len(options), chosen)
        log = _result(handle, "nvrtcGetProgramLogSize", "nvrtcGetProgramLog")
        kind = "PTX" if intermediate else "CUBIN"
        code = None if status else _result(handle, f"nvrtcGet{kind}Size", f"nvrtcGet{kind}")
        return code, log.rstrip(b"\0\n ").decode(errors="replace")
    finally:
        nvrtc_library().nvrtcDestroyProgram(byref(handle))
