"""Compiles the CUDA kernels with NVRTC and keeps the result on disk: no CUDA toolkit, no CUDA_HOME, no compiler.

The kernels lie in the package as text. They are compiled when they are first needed on a kind of GPU, about a second
for each of the four programs (fills or strokes, three or four channels), and read from the cache afterwards. The cache
is a convenience: a damaged file or a folder that cannot be written costs another compilation and nothing else.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import re
import sys
import tempfile
from ctypes import sizeof
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cuda.frame import FIXED_SHARED, Frame, StepValues
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.words import one_line

KERNELS = Path(__file__).parents[1] / "kernels"
MAIN = "raster.cu"
OLDEST = 75  # compute capability 7.5: the oldest that NVRTC 13 compiles for
INSTALL = "torch 2.10 or newer for Linux with CUDA brings it; else: pip install cuda-bindings nvidia-cuda-nvrtc"
_log = logging.getLogger("cubicsplat")
_MAGIC = b"cubicsplat cubin 1\n"


@dataclass(frozen=True)
class Program:
    """What one compilation is made for: 3 channels (RGB) or 4 (premultiplied RGBA)."""

    mode: Mode
    channels: int

    @property
    def name(self) -> str:
        return f"{self.mode.value}, {'RGB' if self.channels == 3 else 'RGBA'}"

    def definitions(self) -> list[str]:
        return [
            f"-DCS_CLOSED={int(self.mode is Mode.CLOSED)}", f"-DCS_CHANNELS={self.channels}",
            f"-DCS_FRAME_BYTES={sizeof(Frame)}", f"-DCS_STEP_BYTES={sizeof(StepValues)}",
            f"-DCS_SHARED_BYTES={FIXED_SHARED}",
        ]  # fmt: skip


def sources() -> dict[str, bytes]:
    """Every file of the kernels by name. Raises EngineError where the package is incomplete."""
    headers = sorted(path for folder in ("cuda", "shared") for path in (KERNELS / folder).glob("*.*h"))
    try:
        return {path.name: path.read_bytes() for path in (KERNELS / "cuda" / MAIN, *headers)}
    except OSError as error:
        raise EngineError(f"the CUDA kernels are missing from the package ({error}); reinstall cubicsplat") from error


def options(program: Program, architecture: str) -> list[str]:
    """Options of NVRTC. Division and square root may be off in the last places; sums and products are as written."""
    return [
        f"--gpu-architecture={architecture}", "--std=c++17", "--ftz=true", "--prec-div=false", "--prec-sqrt=false",
        "--diag-suppress=128", *program.definitions(),
    ]  # fmt: skip


@lru_cache(maxsize=1)
def nvrtc() -> ModuleType:
    """The compiler's bindings. Raises EngineError where they or the compiler itself are missing."""
    try:
        from cuda.bindings import nvrtc as bindings
    except ImportError as error:
        raise EngineError(f"the CUDA engine needs the Python package cuda-bindings ({error}); {INSTALL}") from error
    try:
        status, major, minor = bindings.nvrtcVersion()
    except (RuntimeError, OSError) as error:  # what the loader of the library raises differs between versions
        text = one_line(error)
        raise EngineError(f"NVIDIA's run-time compiler NVRTC cannot be loaded ({text[:200]}); {INSTALL}") from error
    if int(status) != 0 or major < 12:
        raise EngineError(f"NVRTC {major}.{minor} is too old; version 12 or newer is needed. {INSTALL}")
    return bindings


def version() -> tuple[int, int]:
    """Version of NVRTC."""
    _, major, minor = nvrtc().nvrtcVersion()
    return int(major), int(minor)


def architecture_for(capability: tuple[int, int]) -> str:
    """What to compile for on a GPU of this compute capability: its own machine code, or the nearest that runs there.

    A GPU newer than the compiler gets intermediate code (compute_NN), which its driver finishes.
    """
    wanted = 10 * capability[0] + capability[1]
    if wanted < OLDEST:
        raise EngineError(
            f"the GPU's compute capability is {capability[0]}.{capability[1]}; the CUDA engine needs "
            f"{OLDEST // 10}.{OLDEST % 10} or newer: use --device cpu"
        )
    known = [int(n) for n in nvrtc().nvrtcGetSupportedArchs()[1]]
    runnable = [n for n in known if n // 10 == wanted // 10 and n <= wanted]
    if runnable:
        return f"sm_{max(runnable)}"
    older = [n for n in known if n < wanted]
    if not older:
        raise EngineError(f"NVRTC {'.'.join(map(str, version()))} does not know compute capability {wanted / 10}")
    return f"compute_{max(older)}"


def _checked(result: tuple[Any, ...], doing: str) -> Any:
    status, *rest = result
    if int(status) != 0:
        raise EngineError(f"NVRTC failed while {doing}: {getattr(status, 'name', status)}")
    return rest[0] if rest else None


def _messages(compiler: ModuleType, handle: Any) -> str:
    size = _checked(compiler.nvrtcGetProgramLogSize(handle), "reading its log")
    text = bytearray(size)
    _checked(compiler.nvrtcGetProgramLog(handle, text), "reading its log")
    return text.rstrip(b"\0\n ").decode(errors="replace")


def compile_text(program: Program, architecture: str, extra: tuple[str, ...] = ()) -> tuple[bytes, str]:
    """Compiles the kernels: the machine code (CUBIN, or PTX for compute_NN) and the compiler's log."""
    compiler = nvrtc()
    text = sources()
    main = text.pop(MAIN)
    names = list(text)
    handle = _checked(
        compiler.nvrtcCreateProgram(
            main, MAIN.encode(), len(names), [text[name] for name in names], [name.encode() for name in names]
        ),
        "starting",
    )
    try:
        chosen = [option.encode() for option in (*options(program, architecture), *extra)]
        status = compiler.nvrtcCompileProgram(handle, len(chosen), chosen)[0]
        log = _messages(compiler, handle)
        if int(status) != 0:
            raise EngineError(f"the CUDA kernels do not compile for {architecture} ({status.name}):\n{log}")
        intermediate = architecture.startswith("compute_")
        size_of, get = (
            (compiler.nvrtcGetPTXSize, compiler.nvrtcGetPTX)
            if intermediate
            else (compiler.nvrtcGetCUBINSize, compiler.nvrtcGetCUBIN)
        )
        code = bytearray(_checked(size_of(handle), "asking for the code"))
        _checked(get(handle, code), "fetching the code")
        return bytes(code), log
    finally:
        compiler.nvrtcDestroyProgram(handle)


@dataclass(frozen=True)
class Resources:
    """What a kernel takes, from the compiler's report. spilled: bytes stored and loaded again."""

    registers: int
    spilled: int
    shared: int


def resources(log: str) -> dict[str, Resources]:
    """Reads the log of a compilation with --ptxas-options=-v."""
    found: dict[str, Resources] = {}
    name, spilled = "", 0
    for line in log.splitlines():
        if match := re.search(r"Compiling entry function '(\w+)'", line):
            name = match[1]
        elif match := re.search(r"(\d+) bytes spill stores, (\d+) bytes spill loads", line):
            spilled = int(match[1]) + int(match[2])
        elif match := re.search(r"Used (\d+) registers", line):
            shared = re.search(r"(\d+) bytes smem", line)
            found[name] = Resources(int(match[1]), spilled, int(shared[1]) if shared else 0)
    return found


def cache_folder() -> Path:
    """Where the compiled kernels lie, by the custom of the platform."""
    if sys.platform == "win32" and os.environ.get("LOCALAPPDATA"):
        base = Path(os.environ["LOCALAPPDATA"])
    elif os.environ.get("XDG_CACHE_HOME"):
        base = Path(os.environ["XDG_CACHE_HOME"])
    else:
        base = Path("~/Library/Caches" if sys.platform == "darwin" else "~/.cache").expanduser()
    return base / "cubicsplat" / "cuda"


def cache_key(program: Program, architecture: str) -> str:
    """Changes with the kernels' text, the options, the architecture and the compiler's version."""
    digest = hashlib.sha256()
    parts = [(name, text) for name, text in sorted(sources().items())]
    parts += [("options", "\n".join(options(program, architecture)).encode())]
    parts += [("nvrtc", ".".join(map(str, version())).encode())]
    for name, text in parts:
        digest.update(f"{name} {len(text)}\n".encode())
        digest.update(text)
    return digest.hexdigest()


def _read_cache(path: Path) -> bytes | None:
    """The code in a cache file, or None where there is none that is whole."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    head = len(_MAGIC) + hashlib.sha256().digest_size
    code = data[head:]
    return code if code and data[:head] == _MAGIC + hashlib.sha256(code).digest() else None


def _write_cache(path: Path, code: bytes) -> None:
    """Writes beside the place and moves, so that no reader ever sees half a file; gives up where it may not write."""
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=".new-")
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(_MAGIC + hashlib.sha256(code).digest() + code)
            Path(temporary).replace(path)
        except OSError:
            Path(temporary).unlink(missing_ok=True)


def machine_code(program: Program, capability: tuple[int, int]) -> tuple[bytes, str]:
    """Machine code of the kernels for a GPU, from the cache or compiled now (which it logs), and its architecture."""
    architecture = architecture_for(capability)
    path = cache_folder() / f"{cache_key(program, architecture)}.bin"
    code = _read_cache(path)
    if code is None:
        _log.info("compiling the CUDA kernels (%s) for %s, once on this machine", program.name, architecture)
        code, _ = compile_text(program, architecture)
        _write_cache(path, code)
    return code, architecture
