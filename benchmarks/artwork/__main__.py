"""Drawings whose vector truth is known, by several tools: how close to the artist's file, in how many shapes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from benchmarks import main
from benchmarks.artwork.contact_sheet import sheet_png
from benchmarks.artwork.degradations import CLEAN, check_kind
from benchmarks.artwork.document import SIZE, Drawings, Only, Size, Skip, drawings_in
from benchmarks.artwork.scores import Scores, Truth, measure, run_tool
from benchmarks.tools import Tool, chosen_tools
from cubicsplat_cli.cli.bench import Csv, Limit, Markdown, check_limit, check_png, comma_parts, end_with, print_report
from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import Json, Quiet, check_csv, option, write_csv
from cubicsplat_cli.errors import CubicSplatError, InputError
from cubicsplat_cli.files.write import write_atomically
from cubicsplat_cli.formatting import number, one_line, text_table, titled
from cubicsplat_cli.metrics import head

# Member, heading, decimals.
_COLUMNS = (
    ("delta_e", "dE00", 3),
    ("psnr_1x_db", "1x dB", 1),
    ("psnr_4x_db", "4x dB", 1),
    ("edge_px", "edge px", 3),
    ("shapes_ratio", "shapes", 2),
    ("coordinates_ratio", "coord.", 2),
    ("bytes_ratio", "gz bytes", 2),
    ("exact_colours", "colours", 2),
    ("primitive_recall", "prim. found", 2),
    ("primitive_precision", "right", 2),
    ("completed", "completed", 2),
    ("visible_error", "vis. error", 3),
    ("leak_1x_px", "leak 1x", 2),
    ("leak_4x_px", "4x", 2),
    ("leak_16x_px", "16x px", 2),
    ("seconds", "s", 2),
    ("cpu_seconds", "CPU s", 2),
)
# Of these the worst tenth is the lowest one.
_MORE_IS_BETTER = {"psnr_1x_db", "psnr_4x_db", "exact_colours", "primitive_recall", "primitive_precision", "completed"}


@dataclass
class ScoredRuns:
    """done: the scores with the SVG of each. failed: (drawing, tool, error); the tool of a drawing that cannot be read
    is empty.
    """

    done: list[tuple[Scores, bytes]] = field(default_factory=list)
    failed: list[tuple[str, str, str]] = field(default_factory=list)

    def of(self, tool: str) -> list[Scores]:
        """The scores of one tool, in the order of the drawings."""
        return [scores for scores, _ in self.done if scores.tool == tool]


def run_all(
    paths: Sequence[Path], tools: Mapping[str, Tool], size: int, tell: Callable[[str], None], kind: str = CLEAN
) -> ScoredRuns:
    """Every drawing by every tool; a failure is recorded and the others go on.

    size: px of the input's longer side; kind: of the degradations; tell: gets a line for each.
    """
    runs = ScoredRuns()
    for path in paths:
        try:
            truth = Truth(path.read_bytes(), path.stem, size, kind)
        except (CubicSplatError, OSError) as error:
            runs.failed.append((path.stem, "", one_line(error)))
            tell(f"{path.stem}: failed: {one_line(error)}")
            continue
        for name, tool in tools.items():
            try:
                made = run_tool(tool, truth)
                scores = measure(truth, name, made)
            except Exception as error:
                # Whatever a tool raises is a failure of that tool, which is one of the results.
                kind_of_error = "" if isinstance(error, CubicSplatError) else f"{type(error).__name__}: "
                runs.failed.append((truth.name, name, kind_of_error + one_line(error)))
                tell(f"{truth.name}, {name}: failed: {runs.failed[-1][2]}")
                continue
            runs.done.append((scores, made.svg))
            tell(
                f"{truth.name}, {name}: dE00 {scores.delta_e:.3f}, {scores.psnr_1x_db:.1f} and "
                f"{scores.psnr_4x_db:.1f} dB, {scores.shapes} shapes of {scores.artist_shapes}, "
                f"{scores.coordinates} coordinates of {scores.artist_coordinates}, {scores.seconds:.1f} s"
            )
    return runs


def summary(scores: Sequence[Scores]) -> dict[str, dict[str, float | None]]:
    """Mean, median and p90 of each column; p90 is the bound that nine in ten drawings keep to (or reach)."""
    statistics: dict[str, dict[str, float | None]] = {"mean": {}, "median": {}, "p90": {}}
    for member, _, _ in _COLUMNS:
        values = [value for value in (getattr(each, member) for each in scores) if value is not None]
        worst = 10 if member in _MORE_IS_BETTER else 90
        statistics["mean"][member] = float(np.mean(values)) if values else None
        statistics["median"][member] = float(np.median(values)) if values else None
        statistics["p90"][member] = float(np.percentile(values, worst)) if values else None
    return statistics


def report_of(runs: ScoredRuns, tools: Sequence[str], size: int, kind: str) -> dict[str, Any]:
    """The scores as JSON."""
    return {
        **head(),
        "bench": "artwork",
        "size": size,
        "input": kind,
        "summary": {tool: summary(runs.of(tool)) for tool in tools},
        "runs": [asdict(scores) for scores, _ in runs.done],
        "failed": [{"drawing": drawing, "tool": tool, "error": error} for drawing, tool, error in runs.failed],
    }


def tables_of(runs: ScoredRuns, tools: Sequence[str], *, markdown: bool) -> str:
    """A table per tool with a row per drawing, then one that compares the tools."""
    header = tuple(heading for _, heading, _ in _COLUMNS)
    parts = []
    for tool in tools:
        rows = [_row(scores.picture, asdict(scores)) for scores in runs.of(tool)]
        parts.append(titled(tool, text_table(("drawing", *header), rows, markdown=markdown), markdown=markdown))
    rows = []
    for tool in tools:
        failures = sum(name == tool for _, name, _ in runs.failed)
        for kind, values in summary(runs.of(tool)).items():
            rows.append((*_row(f"{tool}, {kind}", values), str(failures)))
    title = f"all tools, {len({scores.picture for scores, _ in runs.done})} drawings"
    parts.append(titled(title, text_table(("", *header, "failed"), rows, markdown=markdown), markdown=markdown))
    return "\n".join(parts)


def _row(name: str, values: dict[str, Any]) -> tuple[str, ...]:
    return (name, *(number(values[member], decimals) for member, _, decimals in _COLUMNS))


def artwork(
    folder: Drawings,
    tools: Annotated[str, option("--tools TOOL,...", "Of ours, photo, vtracer, potrace and diffvg.")] = "ours",
    size: Size = 512,
    kind: Annotated[
        str, option("--input KIND", "clean, jpeg, webp, blurred, enlarged, reduced, noisy, palette or dithered.")
    ] = CLEAN,
    only: Only = None,
    skip: Skip = None,
    limit: Limit = None,
    keep: Annotated[Path | None, option("--keep DIR", "Write each SVG into this folder.")] = None,
    sheet: Annotated[
        Path | None,
        option(
            "--sheet FILE", "Also write a PNG to look at: input, SVG, truth, and outlines with anchors and handles."
        ),
    ] = None,
    json: Json = False,
    csv: Csv = None,
    markdown: Markdown = False,
    quiet: Quiet = False,
) -> None:
    """How close to artists' drawings each tool comes, in how much.

    Each drawing is drawn as a picture, and what a tool makes of that is held against the drawing itself.
    """
    SIZE.check("size", size)
    check_limit(limit)
    check_csv(csv)
    check_png(sheet, "sheet")
    check_kind(kind)
    chosen = chosen_tools(comma_parts(tools))
    paths = drawings_in(folder, only, skip, limit)
    runs = run_all(paths, chosen, size, Reporter(quiet=quiet).summary, kind)
    if not runs.done:
        raise InputError(f"no drawing could be measured: {runs.failed[0][0]}: {runs.failed[0][2]}")
    names = list(chosen)
    print_report(report_of(runs, names, size, kind), tables_of(runs, names, markdown=markdown), json=json)
    write_csv(csv, [asdict(scores) for scores, _ in runs.done])
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        for scores, svg in runs.done:
            write_atomically(keep / f"{scores.picture}-{scores.tool}.svg", svg)
    if sheet is not None:
        write_atomically(sheet, sheet_png(runs.done, {path.stem: path for path in paths}, size, kind))
    end_with(runs.failed)


if __name__ == "__main__":
    main(artwork)
