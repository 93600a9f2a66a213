"""The words of results: the one line of a picture, and the table that closes a run over many."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from cubicsplat_cli.cli.console import duration, file_size
from cubicsplat_cli.jobs.work import DONE, FAILED, INTERRUPTED, UNCHANGED, Outcome


def summary_line(report: Mapping[str, Any], status: str = DONE) -> str:
    """`out.svg  512 curves  61 kB  SVG 31.9 dB  SSIM 0.86  47 s  cpu` of a metrics JSON."""
    output, quality = report["output"], report["quality"]["svg"]
    parts = [
        output["svg"] or "stdout",
        f"{output['paths']} curves",
        file_size(output["bytes"]),
        "SVG identical" if quality["psnr_db"] is None else f"SVG {quality['psnr_db']:.1f} dB",
        "SSIM n/a" if quality["ssim"] is None else f"SSIM {quality['ssim']:.2f}",
    ]
    if status == UNCHANGED:
        parts.append("unchanged")
    else:
        parts += [duration(report["timing"]["total_s"]), str(report["device"]["name"])]
    return "  ".join(parts)


@dataclass
class _Row:
    """Sums over the pictures that ended alike."""

    pictures: int = 0
    curves: int = 0
    size: int = 0
    decibels: list[float] = field(default_factory=list)
    similarities: list[float] = field(default_factory=list)

    def add(self, report: Mapping[str, Any] | None) -> None:
        self.pictures += 1
        if report is None:
            return
        quality = report["quality"]["svg"]
        self.curves += report["output"]["paths"]
        self.size += report["output"]["bytes"]
        self.decibels += [] if quality["psnr_db"] is None else [quality["psnr_db"]]
        self.similarities += [] if quality["ssim"] is None else [quality["ssim"]]

    def cells(self) -> list[str]:
        return [
            str(self.pictures),
            str(self.curves or ""),
            file_size(self.size) if self.size else "",
            f"{_mean(self.decibels):.2f}" if self.decibels else "",
            f"{_mean(self.similarities):.3f}" if self.similarities else "",
        ]


class Tally:
    """Counts outcomes for the closing table."""

    def __init__(self) -> None:
        self.rows = {status: _Row() for status in (DONE, UNCHANGED, INTERRUPTED, FAILED)}

    def add(self, outcome: Outcome) -> None:
        """Count one outcome."""
        self.rows[outcome.status].add(outcome.report)

    def settled(self) -> int:
        """How many pictures ended, in whatever way."""
        return sum(row.pictures for row in self.rows.values())

    def table(self, planned: int, seconds: float) -> list[str]:
        """The lines of the table; `planned` pictures there were to do, in so many seconds."""
        head = ["", "pictures", "curves", "SVG", "mean dB", "mean SSIM"]
        lines = [head, *([status, *row.cells()] for status, row in self.rows.items() if row.pictures)]
        if planned > self.settled():
            lines.append(["not begun", str(planned - self.settled()), "", "", "", ""])
        widths = [max(len(line[column]) for line in lines) for column in range(len(head))]
        text = [
            "  ".join(cell.ljust(width) if column == 0 else cell.rjust(width) for column, (cell, width) in line_cells)
            for line_cells in ([*enumerate(zip(line, widths, strict=True))] for line in lines)
        ]
        return [*(line.rstrip() for line in text), f"{planned} pictures in {duration(seconds)}"]


def _mean(values: list[float]) -> float:
    return sum(values) / len(values)
