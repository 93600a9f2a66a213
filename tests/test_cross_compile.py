"""The native library compiles for every system that has a wheel, with the build file that users have.

Needs Debian's g++-aarch64-linux-gnu, and zig (`pip install ziglang`), which brings the headers of all systems and
compiles its C++ library for each at the first time. zig has no `__builtin_cpu_supports` to link with, so its libraries
for x86-64 hold the generic tiles alone; the wide ones are compiled, not linked.
"""

from __future__ import annotations

import importlib.util
import re
import shutil
import struct
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
GCC_FOR_ARM = "aarch64-linux-gnu-g++"


@dataclass(frozen=True)
class System:
    """What CMake calls a system and its processor, the name zig has for both, the library's name and how it begins."""

    name: str
    processor: str
    target: str
    library: str
    begins: bytes

    def compiler(self) -> list[str] | None:
        """The command that compiles C++ for it with zig, or None."""
        if zig := shutil.which("zig"):
            return [zig, "c++", "-target", self.target]
        if importlib.util.find_spec("ziglang") is not None:
            return [sys.executable, "-m", "ziglang", "c++", "-target", self.target]
        return None


def elf(machine: int) -> bytes:
    """The first bytes of a shared library of Linux, 64 bits, little-endian."""
    return b"\x7fELF\x02\x01\x01" + bytes(9) + struct.pack("<HH", 3, machine)


def mach_o(processor: int) -> bytes:
    """The first bytes of a program file of macOS, 64 bits."""
    return struct.pack("<II", 0xFEEDFACF, 0x01000000 | processor)


SYSTEMS = {
    "Linux aarch64": System("Linux", "aarch64", "aarch64-linux-gnu.2.28", "_cubicsplat.so", elf(183)),
    "macOS x86-64": System("Darwin", "x86_64", "x86_64-macos.11.0", "_cubicsplat.dylib", mach_o(7)),
    "macOS arm64": System("Darwin", "arm64", "aarch64-macos.11.0", "_cubicsplat.dylib", mach_o(12)),
    "Windows x86-64": System("Windows", "AMD64", "x86_64-windows-gnu", "_cubicsplat.dll", b"MZ"),
}
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not shutil.which("cmake") or not shutil.which("ninja"), reason="needs cmake and ninja"),
]


def build(system: System, compiler: list[str], folder: Path) -> bytes:
    """The library's bytes; a warning is an error."""
    options = [
        "-DCMAKE_BUILD_TYPE=Release",
        f"-DCMAKE_SYSTEM_NAME={system.name}",
        f"-DCMAKE_SYSTEM_PROCESSOR={system.processor}",
        f"-DCMAKE_CXX_COMPILER={';'.join(compiler)}",
        "-DCMAKE_CXX_FLAGS=-Werror",
    ]
    for command in (
        ["cmake", "-G", "Ninja", "-S", str(ROOT), "-B", str(folder), *options],
        ["ninja", "-C", str(folder)],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    return (folder / system.library).read_bytes()


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_library_compiles_for(name, tmp_path):
    system = SYSTEMS[name]
    compiler = system.compiler()
    if compiler is None:
        pytest.skip("zig is not installed (pip install ziglang)")
    data = build(system, compiler, tmp_path)
    assert data.startswith(system.begins)
    assert b"cs_abi_version" in data, "its interface is exported"


@pytest.mark.parametrize("name", [name for name in SYSTEMS if "x86-64" in name])
@pytest.mark.parametrize("isa", ["avx2", "avx512"])
def test_the_wide_tiles_compile_for(name, isa, tmp_path):
    compiler = SYSTEMS[name].compiler()
    if compiler is None:
        pytest.skip("zig is not installed (pip install ziglang)")
    text = (ROOT / "CMakeLists.txt").read_text()
    flags = re.search(rf"set\({isa}_flags ([^)]*)\)", text).group(1).split()
    options = ["-std=c++17", "-O3", "-Wall", "-Wextra", "-Wno-psabi", "-Werror", f"-DCS_ISA={isa}", *flags]
    source = ROOT / "src" / "cubicsplat_cli" / "raster" / "kernels" / "cpu" / "tile.cpp"
    command = [*compiler, *options, "-c", str(source), "-o", str(tmp_path / "tile.o")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(not shutil.which(GCC_FOR_ARM), reason=f"{GCC_FOR_ARM} is not installed (g++-aarch64-linux-gnu)")
def test_the_library_compiles_with_gcc_for_arm(tmp_path):
    system = SYSTEMS["Linux aarch64"]
    data = build(system, [GCC_FOR_ARM], tmp_path)
    assert data.startswith(system.begins)
    assert b"cs_abi_version" in data, "its interface is exported"
