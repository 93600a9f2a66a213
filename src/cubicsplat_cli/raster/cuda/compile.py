"""The compiler of the CUDA kernels: no CUDA toolkit, no CUDA_HOME, no compiler but NVRTC, which comes with torch.

The kernels lie in the package as text. They are compiled when first needed on a kind of GPU, about a second for each of
the eight programs (fills or strokes, three or four channels, flat or with gradients), and read from the cache later.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import sizeof
from dataclasses import dataclass
from pathlib import Path

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.files.marks import sha256_of
from cubicsplat_cli.files.write import read_cache, write_cache
from cubicsplat_cli.progress import log
from cubicsplat_cli.raster.cuda import nvrtc
from cubicsplat_cli.raster.cuda.frame import COSTS, FIXED_SHARED, SIDE_BYTES, StepFrame, StepValues
from cubicsplat_cli.raster.engine import EngineScene
from cubicsplat_cli.settings import Mode

KERNELS = Path(__file__).parents[1] / "kernels"
MAIN = "raster.cu"
OLDEST = 75  # compute capability 7.5: the oldest that NVRTC 13 compiles for
CACHE = "cuda"  # kind of what is kept on disk


@dataclass(frozen=True)
class Program:
    """The variant of one compilation: 3 channels (RGB) or 4 (premultiplied RGBA); painted: curves with gradients."""

    mode: Mode
    channels: int
    painted: bool = False

    @classmethod
    def of(cls, scene: EngineScene) -> Program:
        """Return the program that draws a scene."""
        return cls(scene.mode, scene.channels, scene.gradients is not None)

    @property
    def name(self) -> str:
        painted = ", gradients" if self.painted else ""
        return f"{self.mode.value}, {'RGB' if self.channels == 3 else 'RGBA'}{painted}"

    def definitions(self) -> list[str]:
        return [
            f"-DCS_CLOSED={int(self.mode is Mode.CLOSED)}", f"-DCS_CHANNELS={self.channels}",
            f"-DCS_PAINTED={int(self.painted)}",
            f"-DCS_FRAME_BYTES={sizeof(StepFrame)}", f"-DCS_STEP_BYTES={sizeof(StepValues)}",
            f"-DCS_SHARED_BYTES={FIXED_SHARED}", f"-DCS_COSTS={COSTS}", f"-DCS_SIDE_BYTES={SIDE_BYTES}",
        ]  # fmt: skip


def sources(kernels: Path = KERNELS) -> dict[str, bytes]:
    """Return every file of the kernels by name. Raises EngineError if the package is incomplete."""
    headers = sorted(path for folder in ("cuda", "shared") for path in (kernels / folder).glob("*.*h"))
    try:
        return {path.name: path.read_bytes() for path in (kernels / "cuda" / MAIN, *headers)}
    except OSError as error:
        raise EngineError(f"the CUDA kernels are missing from the package ({error}); reinstall cubicsplat") from error


def options(program: Program, architecture: str) -> list[str]:
    """Return options of NVRTC. Divisions and roots may be off in the last places, and a * b + c may be rounded once."""
    return [
        f"--gpu-architecture={architecture}", "--std=c++17", "--ftz=true", "--prec-div=false", "--prec-sqrt=false",
        "--diag-suppress=128", *program.definitions(),
    ]  # fmt: skip


def architecture_for(capability: tuple[int, int]) -> str:
    """Return the target on a GPU of this compute capability: its own machine code, or the nearest that runs there.

    A GPU newer than the compiler gets intermediate code (compute_NN), which its driver finishes.
    """
    wanted = 10 * capability[0] + capability[1]
    if wanted < OLDEST:
        need = f"the CUDA engine needs {OLDEST // 10}.{OLDEST % 10} or newer: use --device cpu"
        raise EngineError(f"the GPU's compute capability is {capability[0]}.{capability[1]}; {need}")
    known = nvrtc.architectures()
    runnable = [n for n in known if n // 10 == wanted // 10 and n <= wanted]
    if runnable:
        return f"sm_{max(runnable)}"
    older = [n for n in known if n < wanted]
    if not older:
        raise EngineError(f"NVRTC {'.'.join(map(str, nvrtc.version()))} does not know compute capability {wanted / 10}")
    return f"compute_{max(older)}"


def compile_text(
    program: Program, architecture: str, extra: tuple[str, ...] = (), text: dict[str, bytes] | None = None
) -> tuple[bytes, str]:
    """Compile the kernels. Return the machine code (CUBIN, or PTX for compute_NN) and the compiler's log.

    extra: further options of NVRTC. text: as of `sources` (default: those).
    """
    text = dict(text or sources())
    main = text.pop(MAIN)
    chosen = [*options(program, architecture), *extra]
    code, said = nvrtc.compile_program(MAIN, main, text, chosen, intermediate=architecture.startswith("compute_"))
    if code is None:
        raise EngineError(f"the CUDA kernels do not compile for {architecture}:\n{said}")
    return code, said


def cache_key(program: Program, architecture: str, version: tuple[int, int], text: dict[str, bytes]) -> str:
    """Return a key that changes with the kernels' text, the options, the architecture and the compiler's version."""
    return sha256_of(repr((sorted(text.items()), options(program, architecture), version)).encode())


def machine_code(
    program: Program, capability: tuple[int, int], compiled: Callable[[Program, str], tuple[bytes, str]] = compile_text
) -> tuple[bytes, str]:
    """Return machine code for a GPU, from the cache or compiled now (which it logs), and its architecture."""
    architecture = architecture_for(capability)
    key = cache_key(program, architecture, nvrtc.version(), sources())
    code = read_cache(CACHE, key)
    if code is None:
        log.info("compiling the CUDA kernels (%s) for %s, once on this machine", program.name, architecture)
        code, _ = compiled(program, architecture)
        write_cache(CACHE, key, code)
    return code, architecture
