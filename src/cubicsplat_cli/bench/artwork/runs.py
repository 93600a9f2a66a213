"""Every drawing of a folder by every tool; a failure is recorded and the others go on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path

from cubicsplat_cli.bench.artwork.figures import Figures, Truth, measure, run_tool
from cubicsplat_cli.bench.artwork.inputs import CLEAN
from cubicsplat_cli.bench.tools import Tool
from cubicsplat_cli.errors import CubicSplatError, InputError
from cubicsplat_cli.words import one_line


@dataclass
class Runs:
    """done: the figures with the SVG of each. failed: (drawing, tool, what was wrong); the tool of a drawing that
    cannot be read is empty.
    """

    done: list[tuple[Figures, bytes]] = field(default_factory=list)
    failed: list[tuple[str, str, str]] = field(default_factory=list)

    def of(self, tool: str) -> list[Figures]:
        """The figures of one tool, in the order of the drawings."""
        return [figures for figures, _ in self.done if figures.tool == tool]


def drawings_in(folder: Path, only: str | None, skip: str | None, limit: int | None) -> list[Path]:
    """The SVG files right in a folder by name, those whose stem matches `only` and not `skip` (shell patterns, several
    with commas between them).
    """
    try:
        found = sorted(path for path in folder.iterdir() if path.suffix.lower() == ".svg" and path.is_file())
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror}); check the path") from error
    chosen = [p for p in found if (only is None or _matches(p, only)) and not (skip is not None and _matches(p, skip))]
    if not chosen:
        raise InputError(f"{folder}: holds no SVG that is asked for; give a folder of drawings")
    return chosen[:limit]


def _matches(path: Path, patterns: str) -> bool:
    return any(fnmatch(path.stem, pattern.strip()) for pattern in patterns.split(","))


def run_all(
    paths: Sequence[Path], tools: Mapping[str, Tool], size: int, tell: Callable[[str], None], kind: str = CLEAN
) -> Runs:
    """Every drawing by every tool. size: px of the input's longer side; kind: of `inputs`; tell: gets a line each."""
    runs = Runs()
    for path in paths:
        try:
            truth = Truth(path.read_bytes(), path.stem, size, kind)
        except (CubicSplatError, OSError) as error:
            runs.failed.append((path.stem, "", one_line(error)))
            tell(f"{path.stem}: failed: {one_line(error)}")
            continue
        for name, tool in tools.items():
            _run(runs, truth, name, tool, tell)
    return runs


def _run(runs: Runs, truth: Truth, name: str, tool: Tool, tell: Callable[[str], None]) -> None:
    try:
        made = run_tool(tool, truth)
        figures = measure(truth, name, made)
    except Exception as error:
        # Whatever a tool raises is a failure of that tool, which is one of the figures.
        reason = one_line(error) if isinstance(error, CubicSplatError) else f"{type(error).__name__}: {one_line(error)}"
        runs.failed.append((truth.name, name, reason))
        tell(f"{truth.name}, {name}: failed: {reason}")
        return
    runs.done.append((figures, made.svg))
    tell(
        f"{truth.name}, {name}: dE00 {figures.delta_e:.3f}, {figures.psnr_1x_db:.1f} and {figures.psnr_4x_db:.1f} dB, "
        f"{figures.shapes} shapes of {figures.artist_shapes}, {figures.coordinates} coordinates of "
        f"{figures.artist_coordinates}, {figures.seconds:.1f} s"
    )
