"""The report of `bench artwork`: a table per tool, and one of all tools' means, medians and ninth deciles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from cubicsplat_cli.bench.artwork.figures import Figures
from cubicsplat_cli.bench.artwork.runs import Runs
from cubicsplat_cli.report import head
from cubicsplat_cli.tables import number, text_table

# Member, heading, decimals.
_COLUMNS = (
    ("delta_e", "dE00", 3),
    ("psnr_1x_db", "1x dB", 1),
    ("psnr_4x_db", "4x dB", 1),
    ("edge_px", "edge px", 3),
    ("shapes_ratio", "shapes", 2),
    ("coordinates_ratio", "coord.", 2),
    ("bytes_ratio", "gz bytes", 2),
    ("exact_inks", "inks", 2),
    ("primitive_recall", "prim. found", 2),
    ("primitive_precision", "right", 2),
    ("restored", "whole", 2),
    ("exposed", "exposed", 3),
    ("seam_1x_px", "seam 1x", 2),
    ("seam_4x_px", "4x", 2),
    ("seam_16x_px", "16x px", 2),
    ("seconds", "s", 2),
    ("cpu_seconds", "CPU s", 2),
)
# Of these the worst tenth is the lowest one.
_MORE_IS_BETTER = {"psnr_1x_db", "psnr_4x_db", "exact_inks", "primitive_recall", "primitive_precision", "restored"}


def summary(figures: Sequence[Figures]) -> dict[str, dict[str, float | None]]:
    """Mean, median and p90 of each column; p90 is what nine in ten drawings keep to (dB and inks: reach)."""
    found: dict[str, dict[str, float | None]] = {"mean": {}, "median": {}, "p90": {}}
    for member, _, _ in _COLUMNS:
        values = [value for value in (getattr(figure, member) for figure in figures) if value is not None]
        worst = 10 if member in _MORE_IS_BETTER else 90
        found["mean"][member] = float(np.mean(values)) if values else None
        found["median"][member] = float(np.median(values)) if values else None
        found["p90"][member] = float(np.percentile(values, worst)) if values else None
    return found


def artwork_report(runs: Runs, tools: Sequence[str], size: int, kind: str) -> dict[str, Any]:
    """The JSON of `bench artwork`."""
    return {
        **head(),
        "bench": "artwork",
        "size": size,
        "input": kind,
        "summary": {tool: summary(runs.of(tool)) for tool in tools},
        "runs": [asdict(figures) for figures, _ in runs.done],
        "failed": [{"drawing": drawing, "tool": tool, "error": error} for drawing, tool, error in runs.failed],
    }


def artwork_tables(runs: Runs, tools: Sequence[str], *, markdown: bool) -> str:
    """A table per tool with a row per drawing, then one that compares the tools."""
    header = tuple(heading for _, heading, _ in _COLUMNS)
    parts = []
    for tool in tools:
        rows = [_row(figures.picture, asdict(figures)) for figures in runs.of(tool)]
        parts.append(_titled(tool, text_table(("drawing", *header), rows, markdown=markdown), markdown))
    rows = []
    for tool in tools:
        failures = sum(name == tool for _, name, _ in runs.failed)
        for kind, values in summary(runs.of(tool)).items():
            rows.append((*_row(f"{tool}, {kind}", values), str(failures)))
    title = f"all tools, {len({figures.picture for figures, _ in runs.done})} drawings"
    parts.append(_titled(title, text_table(("", *header, "failed"), rows, markdown=markdown), markdown))
    return "\n".join(parts)


def _titled(title: str, table: str, markdown: bool) -> str:
    return f"### {title}\n\n{table}" if markdown else f"{title}\n{table}"


def _row(name: str, values: dict[str, Any]) -> tuple[str, ...]:
    return (name, *(number(values[member], decimals) for member, _, decimals in _COLUMNS))
