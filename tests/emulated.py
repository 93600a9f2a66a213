"""The CUDA kernels on an emulator: a driver for `CudaEngine` that needs no GPU. See cuda_emulator/README.md."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
from collections.abc import Callable
from contextlib import nullcontext
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from cubicsplat_cli.raster.cuda.compile import KERNELS, Program, sources
from cubicsplat_cli.raster.cuda.driver import Driver, LateCopy
from cubicsplat_cli.raster.cuda.frame import StepFrame

EMULATOR = Path(__file__).with_name("cuda_emulator")
LIBRARIES = Path(__file__).parent.parent / "build" / "emulator"
OPTIONS = ["-std=c++17", "-fPIC", "-ffp-contract=off", "-Wall", "-Wextra", "-Wno-unknown-pragmas"]

# Arithmetic as a GPU may do it, where the CPU can.
APPROXIMATE = ("-ffp-contract=fast", "-DEMULATOR_APPROXIMATE", *(["-mfma"] if platform.machine() == "x86_64" else []))


def compiler() -> str | None:
    """A C++ compiler that knows GCC's extensions, or None."""
    return next((found for name in ("g++", "clang++", "c++") if (found := shutil.which(name))), None)


@cache
def build(program: Program, extra: tuple[str, ...] = ()) -> Path:
    """The emulated kernels as a shared library, compiled once per text and kept in build/emulator; the emulator itself
    is compiled once for all programs.
    """
    emulator = _made("emulator.o", ["-O2", "-c", *extra, str(EMULATOR / "emulator.cpp")])
    folders = [f"-I{KERNELS / folder}" for folder in ("cuda", "shared")]
    kernels = ["-Og", "-shared", *extra, *program.definitions(), *folders, str(EMULATOR / "kernels.cpp")]
    name = f"{program.mode.value}-{program.channels}{'-painted' * program.painted}.so"
    return _made(name, [*kernels, str(emulator)], b"".join(sources().values()))


def _made(name: str, arguments: list[str], text: bytes = b"") -> Path:
    """What the compiler makes with arguments, or made when it last had them for the same text of kernels."""
    command = [compiler() or "g++", *OPTIONS, f"-I{EMULATOR}", *arguments]
    digest = hashlib.sha256("\n".join(command).encode() + text)
    for path in sorted(EMULATOR.glob("*.*")):
        digest.update(path.read_bytes())
    stem, suffix = name.split(".")
    made = LIBRARIES / f"{stem}-{digest.hexdigest()[:24]}.{suffix}"
    if not made.exists():
        LIBRARIES.mkdir(parents=True, exist_ok=True)
        part = made.with_suffix(f".{os.getpid()}.part")
        done = subprocess.run([*command, "-o", str(part)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        part.replace(made)
    return made


class EmulatedKernels:
    """Launches run at once, block after block. Arguments are copied first, as a GPU's queue does."""

    def __init__(self, driver: EmulatedDriver, library: ctypes.CDLL) -> None:
        self._driver = driver
        self._library = library
        library.emulator_launch.restype = ctypes.c_char_p
        library.emulator_launch.argtypes = [
            ctypes.c_char_p, *[ctypes.c_uint] * 3, ctypes.c_size_t, ctypes.POINTER(StepFrame), ctypes.c_uint,
        ]  # fmt: skip

    def launch(self, name: str, grid: tuple[int, int], threads: int, shared: int, *arguments) -> None:
        copies = [type(argument).from_buffer_copy(argument) for argument in arguments]
        if self._driver.recording is not None:
            self._driver.recording.append(lambda: self._run(name, grid, threads, shared, *copies))
        else:
            self._run(name, grid, threads, shared, *copies)

    def _run(self, name: str, grid: tuple[int, int], threads: int, shared: int, *arguments) -> None:
        self._driver.launches.append((name, grid, threads, shared))
        if name == "set_step":
            self._library.emulator_set_step(ctypes.byref(arguments[0]), arguments[1])
            return
        error = self._library.emulator_launch(
            name.encode(), *grid, threads, shared, ctypes.byref(arguments[0]), self._driver.order
        )
        assert error is None, error.decode()


_TESTED: dict[tuple[object, ...], set[Program]] = {}


class EmulatedDriver(Driver):
    """A device in the CPU's memory. order: seed of the order in which its threads run; 0: as they are numbered."""

    def __init__(self, shared_per_sm: int = 228 * 1024, order: int = 0, extra: tuple[str, ...] = ()) -> None:
        super().__init__()
        # What has passed the self-test on such a device once in this process has.
        self.tested = _TESTED.setdefault((shared_per_sm, order, extra), set())
        self.device = torch.device("cpu")
        self.shared_per_block = 48 * 1024
        self.shared_per_sm = shared_per_sm
        self.order = order
        self.extra = extra
        self.launches: list[tuple] = []
        self.recording: list[Callable[[], None]] | None = None

    def _load(self, program: Program) -> EmulatedKernels:
        return EmulatedKernels(self, ctypes.CDLL(str(build(program, self.extra))))

    def capture(self, body: Callable[[], None]) -> Callable[[], None]:
        recorded: list[Callable[[], None]] = []
        self.recording = recorded
        try:
            body()
        finally:
            self.recording = None

        def replay() -> None:
            for launch in recorded:
                launch()

        return replay

    def stream(self) -> int:
        return 0

    def wait(self) -> None:
        pass

    def late_copy(self, source: Tensor) -> LateCopy:
        return LateCopy(source, torch.empty_like(source), None)

    def active(self) -> nullcontext:
        return nullcontext()

    def describe(self) -> dict[str, object]:
        return {"gpu": "emulated"}
