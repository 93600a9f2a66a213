"""The CPU engine as 64-bit ARM machines run it: compiled by Debian's cross compiler, run by qemu, called from here.

The engine runs in a process of its own, tests/arm/driver.cpp, which gets each call with all that it points to.
"""

from __future__ import annotations

import ctypes
import shutil
import struct
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

from cubicsplat_cli.raster.cpu import CpuEngine

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build" / "arm"
DRIVER = ROOT / "tests" / "arm" / "driver.cpp"
COMPILER, EMULATOR, LIBRARIES = "aarch64-linux-gnu-g++", "qemu-aarch64", "/usr/aarch64-linux-gnu"
NEEDED = (COMPILER, EMULATOR, "cmake", "ninja")
FUNCTIONS = ("render", "gradients", "run")


def missing() -> list[str]:
    """What of the tools this machine lacks."""
    return [tool for tool in NEEDED if not shutil.which(tool)]


@cache
def driver() -> Path:
    """The driver with the engine beside it, built by the project's own build file and kept in build/arm, by one test
    process at a time.
    """
    import fcntl  # Windows has none, and no need of it

    BUILD.mkdir(parents=True, exist_ok=True)
    with (BUILD / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return _built()


def _built() -> Path:
    options = [
        "-DCMAKE_BUILD_TYPE=Release", "-DCMAKE_SYSTEM_NAME=Linux", "-DCMAKE_SYSTEM_PROCESSOR=aarch64",
        f"-DCMAKE_CXX_COMPILER={COMPILER}", "-DCMAKE_CXX_FLAGS=-Werror",
    ]  # fmt: skip
    kernels = ROOT / "src" / "cubicsplat_cli" / "raster" / "kernels" / "cpu"
    program = BUILD / "driver"
    for command in (
        ["cmake", "-G", "Ninja", "-S", ROOT, "-B", BUILD, *options],
        ["ninja", "-C", BUILD],
        [COMPILER, "-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", f"-I{kernels}", DRIVER, BUILD / "_cubicsplat.so",
         f"-Wl,-rpath,{BUILD}", "-o", program],
    ):  # fmt: skip
        done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    return program


class _Library:
    """Stands in for the loaded library: as many functions of the C interface as `CpuEngine` calls."""

    def __init__(self, threads: int, isa: str) -> None:
        command = [EMULATOR, "-L", LIBRARIES, str(driver()), str(threads), isa]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._read(1) == b"y", f"no engine for {isa}"
        self._isa, self._error = isa.encode(), b""
        self._timings, self._counts = bytes(32), bytes(32)

    def cs_render(self, _: Any, *structures: ctypes.Structure) -> int:
        return self._call("render", *structures)

    def cs_gradients(self, _: Any, *structures: ctypes.Structure) -> int:
        return self._call("gradients", *structures)

    def cs_run(self, _: Any, *structures: ctypes.Structure) -> int:
        structures[-1].done = 1  # one step, which is what the tests do
        return self._call("run", *structures)

    def cs_isa(self, _: Any) -> bytes:
        return self._isa

    def cs_error(self, _: Any) -> bytes:
        return self._error

    def cs_timings(self, _: Any, seconds: ctypes.Array[Any]) -> None:
        ctypes.memmove(seconds, self._timings, len(self._timings))

    def cs_counts(self, _: Any, counts: ctypes.Array[Any]) -> None:
        ctypes.memmove(counts, self._counts, len(self._counts))

    def cs_destroy(self, _: Any) -> None:
        self._process.stdin.close()
        self._process.stdout.close()
        self._process.wait()

    def _call(self, function: str, *structures: ctypes.Structure) -> int:
        sizes = _sizes(structures[0])
        buffers = [
            (owner, getattr(type(given), name).offset, getattr(given, name), sizes[name])
            for owner, given in enumerate(structures)
            for name, kind in given._fields_
            if kind is ctypes.c_void_p and getattr(given, name) is not None
        ]
        self._write(struct.pack("<i", FUNCTIONS.index(function)))
        for i in range(6):
            self._send(bytes(structures[i]) if i < len(structures) else b"")
        self._write(struct.pack("<Q", len(buffers)))
        for owner, place, address, size in buffers:
            self._write(struct.pack("<QQ", owner, place))
            self._send(ctypes.string_at(address, size))
        self._process.stdin.flush()
        status, length = struct.unpack("<iQ", self._read(12))
        self._error, self._timings, self._counts = self._read(length), self._read(32), self._read(32)
        for _, _, address, size in buffers:
            ctypes.memmove(address, self._read(size), size)
        return status

    def _send(self, data: bytes) -> None:
        self._write(struct.pack("<Q", len(data)) + data)

    def _write(self, data: bytes) -> None:
        self._process.stdin.write(data)

    def _read(self, count: int) -> bytes:
        data = self._process.stdout.read(count)
        assert len(data) == count, "the emulated engine has died"
        return data


def _sizes(scene: Any) -> dict[str, int]:
    """Bytes behind the pointers of the C interface, which mean the same in every structure."""
    n, k, pixels = scene.curves, 3 * scene.segments + (0 if scene.closed else 1), scene.width * scene.height
    picture = 4 * pixels * scene.channels
    return {
        "ring_ends": 4 * n * scene.rings, "points": 8 * n * k, "colours": 12 * n, "opacities": 4 * n,
        "half_widths": 4 * n, "edge_widths": 4 * n, "target": picture, "weights": 4 * pixels, "gradient": picture,
        "image": picture, "loss": 8, "importance": 4 * n, "background": 4 * scene.channels,
        "moments": 16 * n * (2 * k + 5), "edge_moments": 16 * n, "ages": 4 * n, "points_gradient": 8 * n * k,
        "rate_scale": 20 * n, "kinds": 4 * n, "counts": 4 * n, "frames": 32 * n, "offsets": 4 * n * scene.most_stops,
        "stops": 16 * n * scene.most_stops, "paces": 24, "losses": 8,
    }  # fmt: skip


class ArmEngine(CpuEngine):
    """The CPU engine of an emulated ARM machine."""

    def __init__(self, threads: int, isa: str) -> None:
        self.threads, self.isa, self._handle = threads, isa, 1
        self._library: Any = _Library(threads, isa)

    def _call(self, name: str, result: type | None, *given: Any) -> Any:
        return getattr(self._library, name)(None, *given)
