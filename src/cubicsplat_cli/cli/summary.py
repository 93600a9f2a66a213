"""The words of results: the one line of a picture, and the table that closes a run over many."""

from __future__ import annotations

from dataclasses import dataclass, field

from cubicsplat_cli.formatting import counted, duration, file_size, mean, number, text_table
from cubicsplat_cli.jobs.run import DONE, FAILED, INTERRUPTED, UNCHANGED, Outcome
from cubicsplat_cli.metrics import Report


def summary_line(report: Report, status: str = DONE) -> str:
    """`out.svg  512 curves  61 kB  SVG 31.9 dB  SSIM 0.86  47 s  cpu`."""
    output = report.output
    parts = [output.svg or "stdout", report.style, _made(report), file_size(output.bytes), *_quality_parts(report)]
    if status == UNCHANGED:
        parts.append("unchanged")
    else:
        parts += [duration(report.timing.total_s), str(report.device["name"])]
    if status == INTERRUPTED:
        parts.append("interrupted")
    return "  ".join(parts)


def _made(report: Report) -> str:
    """`512 curves`, `5 shapes`, `27 shapes in 3 elements` of the file."""
    if report.shapes is None:
        return counted(report.output.paths, "curve")
    apart = report.shapes == report.output.paths
    return counted(report.shapes, "shape") + ("" if apart else f" in {counted(report.output.paths, 'element')}")


def _quality_parts(report: Report) -> list[str]:
    if report.quality is None:
        return ["not measured"]
    svg = report.quality.svg
    return [
        "SVG identical" if svg.psnr_db is None else f"SVG {svg.psnr_db:.1f} dB",
        "SSIM n/a" if svg.ssim is None else f"SSIM {svg.ssim:.2f}",
    ]


@dataclass
class _Row:
    """The pictures that ended alike."""

    pictures: int = 0
    reports: list[Report] = field(default_factory=list)

    def cells(self) -> list[str]:
        curves = sum(report.count() for report in self.reports)
        size = sum(report.output.bytes for report in self.reports)
        measured = [report.quality.svg for report in self.reports if report.quality is not None]
        decibels, similarity = mean(q.psnr_db for q in measured), mean(q.ssim for q in measured)
        return [
            str(self.pictures),
            str(curves or ""),
            file_size(size) if size else "",
            "" if decibels is None else number(decibels, 2),
            "" if similarity is None else number(similarity, 3),
        ]


class Tally:
    """Counts outcomes for the closing table."""

    def __init__(self) -> None:
        self.rows = {status: _Row() for status in (DONE, UNCHANGED, INTERRUPTED, FAILED)}

    def add(self, outcome: Outcome) -> None:
        """Count one outcome."""
        row = self.rows[outcome.status]
        row.pictures += 1
        if outcome.report is not None:
            row.reports.append(outcome.report)

    def settled(self) -> int:
        """How many pictures ended, in whatever way."""
        return sum(row.pictures for row in self.rows.values())

    def table(self, planned: int, seconds: float) -> list[str]:
        """The lines of the table; `planned` pictures there were to do, in so many seconds."""
        lines = [[status, *row.cells()] for status, row in self.rows.items() if row.pictures]
        if planned > self.settled():
            lines.append(["not begun", str(planned - self.settled()), "", "", "", ""])
        table = text_table(["", "pictures", "curves", "SVG", "mean dB", "mean SSIM"], lines)
        return [*table.splitlines(), f"{counted(planned, 'picture')} in {duration(seconds)}"]
