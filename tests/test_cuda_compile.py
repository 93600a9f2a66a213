"""The CUDA kernels compile with NVRTC for every kind of GPU, within stated limits; the cache never gets in the way."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path

import pytest
from conftest import rest_slow

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.files.write import cache_folder
from cubicsplat_cli.raster.cuda import compile as cuda_compile
from cubicsplat_cli.raster.cuda import nvrtc
from cubicsplat_cli.raster.cuda.compile import Program
from cubicsplat_cli.raster.cuda.frame import shared_bytes, slots_for
from cubicsplat_cli.settings import Mode

try:
    nvrtc.version()
except EngineError as error:
    pytest.skip(f"needs NVRTC: {error}", allow_module_level=True)

PROGRAMS = [Program(mode, channels) for mode in Mode for channels in (3, 4)]
# Of an architecture: bytes of shared memory and registers of a multiprocessor, and threads it holds.
MULTIPROCESSORS = {
    "sm_75": (64 * 1024, 65536, 1024),
    "sm_80": (164 * 1024, 65536, 2048),
    "sm_89": (100 * 1024, 65536, 1536),
    "sm_90": (228 * 1024, 65536, 2048),
    "sm_100": (228 * 1024, 65536, 2048),
}
# Most registers, and bytes spilled to local memory and read again, of each kernel.
LIMITS = {
    "set_step": (48, 0), "blunt": (64, 0), "flatten": (64, 0), "bin": (48, 0), "update": (64, 0),
    "raster_relaxed": (64, 320), "raster_exact": (80, 400),
}  # fmt: skip
MOST_CODE = {"raster_relaxed": 42_000, "raster_exact": 56_000}  # bytes, on sm_90: the walk over the curves stands once
# The largest program for every architecture, and all programs for one.
CASES = [("sm_90", PROGRAMS[-1]), ("sm_75", PROGRAMS[-1])]
CASES += [(architecture, PROGRAMS[-1]) for architecture in MULTIPROCESSORS]
CASES += [("sm_90", program) for program in PROGRAMS[:-1]]
# With gradients the largest program too, under limits of its own.
PAINTED = Program(Mode.CLOSED, 4, painted=True)
PAINTED_LIMITS = LIMITS | {"raster_relaxed": (64, 570), "raster_exact": (80, 440)}
PAINTED_CODE = {"raster_relaxed": 56_000, "raster_exact": 72_000}
CASES += [(architecture, PAINTED) for architecture in ("sm_75", "sm_90")]


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


def code_bytes(elf: bytes) -> dict[str, int]:
    """Bytes of each kernel's machine code, from the section table of a CUBIN (a 64-bit ELF file)."""
    (start,), (count, names) = struct.unpack_from("<Q", elf, 0x28), struct.unpack_from("<HH", elf, 0x3C)
    sections = [struct.unpack_from("<IIQQQQIIQQ", elf, start + 64 * i) for i in range(count)]
    at = sections[names][4]
    found = {elf[at + s[0] :].split(b"\0", 1)[0].decode(): s[5] for s in sections}
    return {name.removeprefix(".text."): size for name, size in found.items() if name.startswith(".text.")}


@pytest.mark.parametrize(("architecture", "program"), rest_slow(*CASES))
def test_kernels_stay_within_their_limits(architecture, program):
    code, log = cuda_compile.compile_text(program, architecture, ("--ptxas-options=-v",))
    found = resources(log)
    assert code[:4] == b"\x7fELF"
    assert set(found) == set(LIMITS)
    for name, (registers, spilled) in (PAINTED_LIMITS if program.painted else LIMITS).items():
        assert found[name].registers <= registers, name
        assert found[name].spilled <= spilled, name
        assert found[name].shared <= 512, f"{name} has static shared memory beside the dynamic"
    if architecture == "sm_90":
        most_code = PAINTED_CODE if program.painted else MOST_CODE
        assert all(code_bytes(code)[name] <= most for name, most in most_code.items())
    if program == PROGRAMS[-1]:
        enough_blocks_fit(architecture, "relaxed", found["raster_relaxed"].registers)
        enough_blocks_fit(architecture, "exact", found["raster_exact"].registers)


def enough_blocks_fit(architecture: str, coverage: str, taken: int) -> None:
    """At least 16 warps at once on a multiprocessor, and shared memory that no GPU has to be asked for."""
    shared, registers, threads = MULTIPROCESSORS[architecture]
    bytes_taken = shared_bytes(coverage, slots_for(coverage, 48 * 1024, shared))
    assert bytes_taken <= 48 * 1024
    resident = min(shared // (bytes_taken + 1024), registers // (taken * 256), threads // 256)
    assert resident >= 2
    if architecture in ("sm_80", "sm_90", "sm_100"):
        assert resident >= (4 if coverage == "relaxed" else 3)


@pytest.mark.parametrize("architecture", rest_slow("compute_80", "compute_89", "compute_100", fast=0))
def test_gradients_compile_for_the_other_architectures(architecture):
    """To intermediate code, which takes half the time of machine code."""
    code, _ = cuda_compile.compile_text(PAINTED, architecture)
    assert all(f".entry {name}".encode() in code for name in LIMITS)


def test_a_mistake_in_the_text_is_shown_with_its_line():
    broken = cuda_compile.sources() | {cuda_compile.MAIN: b"__global__ void f() { oops; }"}
    with pytest.raises(EngineError, match=r"do not compile for sm_90[\s\S]*raster\.cu\(1\)[\s\S]*oops"):
        cuda_compile.compile_text(PROGRAMS[0], "sm_90", text=broken)


def test_a_frame_that_differs_from_the_kernels_does_not_compile():
    with pytest.raises(EngineError, match=r"frame\.py differs"):
        cuda_compile.compile_text(PROGRAMS[0], "sm_90", ("-UCS_FRAME_BYTES", "-DCS_FRAME_BYTES=8"))


@pytest.mark.parametrize(
    ("capability", "architecture"),
    [((7, 5), "sm_75"), ((8, 6), "sm_86"), ((9, 0), "sm_90"), ((10, 0), "sm_100"), ((9, 9), "sm_90")],
)
def test_the_architecture_of_a_gpu(capability, architecture):
    assert cuda_compile.architecture_for(capability) == architecture


def test_gpus_too_old_are_named():
    with pytest.raises(EngineError, match=r"capability is 6\.1; the CUDA engine needs 7\.5 or newer"):
        cuda_compile.architecture_for((6, 1))


@pytest.mark.slow
def test_gpus_that_are_newer_get_intermediate_code():
    newest = cuda_compile.architecture_for((99, 0))
    assert newest.startswith("compute_")
    code, _ = cuda_compile.compile_text(PAINTED, newest)
    assert all(f".entry {name}".encode() in code for name in LIMITS)
    assert code.endswith(b"\0"), "the driver reads intermediate code up to a zero byte"


class Counting:
    """A compiler that only counts."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def __call__(self, program: Program, architecture: str) -> tuple[bytes, str]:
        self.calls.append(architecture)
        return f"code {len(self.calls)}".encode(), ""

    def code(self) -> bytes:
        """From the cache or this compiler."""
        return cuda_compile.machine_code(PROGRAMS[0], (9, 0), self)[0]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A cache of its own."""
    for name in ("XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.setenv(name, str(tmp_path))
    folder = tmp_path / "cubicsplat" / "cuda"
    assert cache_folder(cuda_compile.CACHE) == folder
    return folder


def test_the_cache_spares_the_compilation_and_the_line_about_it(folder, caplog):
    caplog.set_level("INFO", logger="cubicsplat")
    compiler = Counting()
    assert compiler.code() == compiler.code() == b"code 1"
    assert caplog.messages == ["compiling the CUDA kernels (closed, RGB) for sm_90, once on this machine"]
    assert compiler.calls == ["sm_90"]
    assert [path.suffix for path in folder.iterdir()] == [".bin"], "nothing temporary is left"


def test_the_cache_knows_programs_architectures_versions_and_texts_apart():
    text = cuda_compile.sources()
    usual = (PROGRAMS[0], "sm_90", (13, 0), text)
    others = [(PROGRAMS[1], *usual[1:]), (usual[0], "sm_80", *usual[2:]), (*usual[:2], (99, 9), text)]
    others += [(*usual[:3], text | {"pixel.h": text["pixel.h"] + b"\n"})]
    assert len({cuda_compile.cache_key(*given) for given in (usual, *others)}) == 5
    assert cuda_compile.cache_key(*usual) == cuda_compile.cache_key(*usual)


@pytest.mark.parametrize("damage", [b"", b"cubicsplat cache 1\nshort", None], ids=["empty", "short", "flipped"])
def test_a_damaged_cache_costs_a_compilation(folder, damage):
    compiler = Counting()
    compiler.code()
    (path,) = folder.iterdir()
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(bytes(data) if damage is None else damage)
    assert compiler.code() == compiler.code() == b"code 2", "and is mended"


def test_a_cache_that_cannot_be_written_costs_compilations(folder):
    folder.parent.write_bytes(b"a file where the folder should be")
    compiler = Counting()
    assert [compiler.code(), compiler.code()] == [b"code 1", b"code 2"]


def test_without_a_home_folder_kernels_are_compiled_each_time(folder, monkeypatch):
    """As in a container whose user is in no user database."""

    def homeless():
        raise RuntimeError("Could not determine home directory.")

    for name in ("XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name)
    monkeypatch.setattr(Path, "home", homeless)
    assert cache_folder(cuda_compile.CACHE) is None
    compiler = Counting()
    assert [compiler.code(), compiler.code()] == [b"code 1", b"code 2"]
