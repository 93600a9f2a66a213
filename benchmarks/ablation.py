"""Ablations of the photo style: the same fits with one setting changed at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Annotated, Any

from benchmarks import main
from cubicsplat_cli.bench.quality import configuration_name
from cubicsplat_cli.bench.runs import FitJob, Runs
from cubicsplat_cli.cli.bench import (
    Cache,
    Csv,
    CurvesList,
    Folder,
    Limit,
    Markdown,
    ModeList,
    comma_parts,
    counts_of,
    end_with,
    modes_of,
    pictures_of,
    print_report,
    run_fits,
)
from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import Json, Quiet, check_csv, option, takes_options, write_csv
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.formatting import mean, number, text_table
from cubicsplat_cli.metrics import head
from cubicsplat_cli.settings import FitSettings

BASE = "base"
# Name of the row -> settings that differ from the preset's. A tolerance of 0 gives every cubic exactly `samples` edges,
# at least 24 in the exact finish; soft edges are as published only without the exact finish.
ABLATIONS: dict[str, dict[str, Any]] = {
    BASE: {},
    "no pruning": {"prune": False},
    "importance visibility": {"importance": "visibility"},
    "geometric regulariser": {"crossing_penalty": 0.01},
    "samples 8": {"samples": 8, "tolerance": 0.0},
    "samples 12": {"samples": 12, "tolerance": 0.0},
    "samples 24": {"samples": 24, "tolerance": 0.0},
    "samples 32": {"samples": 32, "finish_samples": 32, "tolerance": 0.0},
    "samples 48": {"samples": 48, "finish_samples": 48, "tolerance": 0.0},
    "flatten de-casteljau": {"flatten": "de-casteljau"},
    "edges soft": {"edges": "soft", "finish": 0.0},
    "opaque": {"opaque": True},
}


def chosen_rows(names: Sequence[str] | None) -> list[str]:
    """The rows of the table, the base first; None for all. Raises UsageError for a name that is no row."""
    if names is None:
        return list(ABLATIONS)
    for name in names:
        if name not in ABLATIONS:
            raise UsageError(f"unknown row {name!r}; choose from {', '.join(ABLATIONS)}")
    return [BASE, *(name for name in ABLATIONS if name in names and name != BASE)]


def row_configuration(row: str, mode: str, curves: int) -> str:
    """`closed 512, no pruning`."""
    return f"{configuration_name(mode, curves)}, {row}"


def jobs_of(
    pictures: Sequence[Path], rows: Sequence[str], modes: Sequence[str], curves: Sequence[int], fit: Mapping[str, Any]
) -> list[FitJob]:
    """Every picture for every row, mode and number of curves. A row's settings win over those of `fit`, by name."""
    jobs = []
    for mode, count, row in product(modes, curves, rows):
        settings = FitSettings.from_preset(mode=mode, curves=count, **{**fit, **ABLATIONS[row]})
        jobs += [FitJob(path, row_configuration(row, mode, count), settings) for path in pictures]
    return jobs


def figures(runs: Runs, row: str, mode: str, curves: int) -> dict[str, float | int | None]:
    """Means of a row in one configuration, and its change against the base: over the pictures that both have, so that
    one failed picture does not pass for an effect.
    """
    found = runs.of(row_configuration(row, mode, curves))
    base = {run.picture: run.psnr_db for run in runs.of(row_configuration(BASE, mode, curves))}
    pairs = [(run.psnr_db, base.get(run.picture)) for run in found]
    changes = [own - other for own, other in pairs if own is not None and other is not None]
    seconds = sum(run.fit_seconds for run in found)
    return {
        "pictures": len(found),
        "psnr_db": mean(run.psnr_db for run in found),
        "change_db": mean(changes),
        "gap_db": mean(run.gap_db for run in found),
        "steps_per_minute": 60.0 * sum(run.steps for run in found) / seconds if seconds > 0 else None,
    }


def report_of(runs: Runs, rows: Sequence[str], modes: Sequence[str], curves: Sequence[int]) -> dict[str, Any]:
    """The figures as JSON."""
    return {
        **head(),
        "bench": "ablation",
        "rows": [
            {"row": row, "settings": ABLATIONS[row], "mode": mode, "curves": count, **figures(runs, row, mode, count)}
            for mode, count, row in product(modes, curves, rows)
        ],
        "runs": [asdict(run) for run, _ in runs.done],
        "failed": runs.failures(),
    }


def table_of(runs: Runs, rows: Sequence[str], modes: Sequence[str], curves: Sequence[int], *, markdown: bool) -> str:
    """One line per row; for every mode and number of curves the SVG's PSNR, its change, its gap, and steps a minute."""
    columns = list(product(modes, curves))
    header = ["row"]
    for mode, count in columns:
        header += [f"{configuration_name(mode, count)} dB", "change", "own - SVG", "steps/min"]
    lines = []
    for row in rows:
        line = [row]
        for mode, count in columns:
            cell = figures(runs, row, mode, count)
            line += [
                number(cell["psnr_db"], 2),
                number(None if row == BASE else cell["change_db"], 2, sign=True),
                number(cell["gap_db"], 2, sign=True),
                number(cell["steps_per_minute"], 0),
            ]
        lines.append(line)
    return text_table(header, lines, markdown=markdown)


@takes_options("preset", "steps", "seed", "device", "threads", after=3)
def ablation(
    folder: Folder,
    curves: CurvesList = "256,512",
    mode: ModeList = "closed,open",
    limit: Limit = 4,
    rows: Annotated[str | None, option("--rows ROW,...", "Only these rows, and the base.  [default: all]")] = None,
    cache: Cache = None,
    json: Json = False,
    csv: Csv = None,
    markdown: Markdown = False,
    quiet: Quiet = False,
    **fit: Any,
) -> None:
    """The contribution of each part of the method.

    The same fits with one setting changed at a time; every row fits every picture once more for each mode and number of
    curves. Changes are of the PSNR of the files, over the pictures that both rows have.
    """
    counts, modes = counts_of(curves), modes_of(mode)
    check_csv(csv)
    pictures = pictures_of(folder, limit)
    chosen = chosen_rows(None if rows is None else comma_parts(rows))
    runs = run_fits(jobs_of(pictures, chosen, modes, counts, fit), cache, Reporter(quiet=quiet))
    table = table_of(runs, chosen, modes, counts, markdown=markdown)
    print_report(report_of(runs, chosen, modes, counts), table, json=json)
    write_csv(csv, [asdict(run) for run, _ in runs.done])
    end_with(runs.failed)


if __name__ == "__main__":
    main(ablation)
