"""Quality over a folder of pictures: the tables of `bench quality`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cubicsplat_cli.bench.runs import Fit, Run, Runs
from cubicsplat_cli.report import head
from cubicsplat_cli.settings import FitSettings
from cubicsplat_cli.tables import mean, number, text_table

_HEADER = ("picture", "SVG dB", "SSIM", "own dB", "gap dB", "agreement dB", "s", "kB", "paths")


def configuration_name(mode: str, curves: int) -> str:
    """`closed 512`."""
    return f"{mode} {curves}"


def quality_jobs(
    pictures: Sequence[Path], modes: Sequence[str], curves: Sequence[int], fit: Mapping[str, Any]
) -> list[Fit]:
    """Every picture with every mode and number of curves; all pictures of one configuration, then of the next.

    fit: settings by name, as `FitSettings.from_preset` takes them.
    """
    jobs = []
    for mode in modes:
        for count in curves:
            settings = FitSettings.from_preset(mode=mode, curves=count, **fit)
            jobs += [Fit(path, configuration_name(mode, count), settings) for path in pictures]
    return jobs


def means(runs: Sequence[Run]) -> dict[str, float | int | None]:
    """Means of one configuration; the worst agreement is given too, since a mean hides it."""
    agreements = [run.agreement_db for run in runs if run.agreement_db is not None]
    return {
        "pictures": len(runs),
        "psnr_db": mean(run.psnr_db for run in runs),
        "ssim": mean(run.ssim for run in runs),
        "own_psnr_db": mean(run.own_psnr_db for run in runs),
        "gap_db": mean(run.gap_db for run in runs),
        "agreement_db": mean(agreements),
        "worst_agreement_db": min(agreements, default=None),
        "seconds": mean(run.seconds for run in runs),
        "bytes": mean(run.bytes for run in runs),
        "paths": mean(run.paths for run in runs),
    }


def quality_report(runs: Runs, configurations: Sequence[str]) -> dict[str, Any]:
    """The JSON of `bench quality`."""
    return {
        **head(),
        "bench": "quality",
        "means": {name: means(runs.of(name)) for name in configurations},
        "runs": [asdict(run) for run, _ in runs.done],
        "failed": [
            {"picture": picture, "configuration": configuration, "error": error}
            for picture, configuration, error in runs.failed
        ],
    }


def quality_tables(runs: Runs, configurations: Sequence[str], *, markdown: bool) -> str:
    """A table per configuration, each ending with its mean row, and one of all means."""
    parts = []
    for name in configurations:
        found = runs.of(name)
        rows = [_row(run.picture, asdict(run)) for run in found]
        rows.append(_row(f"mean of {len(found)}", means(found)))
        parts.append(_titled(name, text_table(_HEADER, rows, markdown=markdown), markdown))
    if len(configurations) > 1:
        rows = [_row(name, means(runs.of(name))) for name in configurations]
        parts.append(_titled("means", text_table(("configuration", *_HEADER[1:]), rows, markdown=markdown), markdown))
    return "\n".join(parts)


def _titled(title: str, table: str, markdown: bool) -> str:
    return f"### {title}\n\n{table}" if markdown else f"{title}\n{table}"


def _row(name: str, figures: Mapping[str, Any]) -> tuple[str, ...]:
    size = figures["bytes"]
    return (
        name,
        number(figures["psnr_db"], 2),
        number(figures["ssim"], 3),
        number(figures["own_psnr_db"], 2),
        number(figures["gap_db"], 3, sign=True),
        number(figures["agreement_db"], 1),
        number(figures["seconds"], 1),
        number(None if size is None else size / 1000, 1),
        number(figures["paths"], 0),
    )
