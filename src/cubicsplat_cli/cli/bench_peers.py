"""`cubicsplat bench peers`: photos and drawings by other people's tools and by ours, in one run."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from cubicsplat_cli.cli.bench_options import (
    Cache,
    Csv,
    CurvesList,
    Folder,
    Limit,
    Markdown,
    check_csv,
    check_plot,
    counts_of,
    end_with,
    parts_of,
    pictures_of,
    run_fits,
    write_csv,
)
from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import Json, Quiet, takes_fit_options
from cubicsplat_cli.errors import UsageError


@takes_fit_options("preset", "steps", "seed", "device", "threads", after=3)
def peers(
    folder: Folder,
    curves: CurvesList = "64,256,1024,4096",
    tools: Annotated[
        str | None,
        typer.Option(
            "--tools", metavar="TOOL,...", help="Of vtracer, potrace and diffvg.  [default: those that are installed]"
        ),
    ] = None,
    limit: Limit = None,
    cache: Cache = None,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", metavar="FILE", help="Also draw PSNR and SSIM against bytes and seconds, as a PNG."),
    ] = None,
    json: Json = False,
    csv: Csv = None,
    markdown: Markdown = False,
    quiet: Quiet = False,
    **fit: Any,
) -> None:
    """Other tools and ours on photos: quality, bytes, seconds.

    For drawings whose truth is known, `bench artwork --tools` measures the same tools.
    """
    counts = counts_of(curves)
    check_csv(csv)
    check_plot(plot)
    reporter = Reporter(quiet=quiet)
    pictures = pictures_of(folder, limit)
    from cubicsplat_cli.bench import peers as benchmark
    from cubicsplat_cli.bench.quality import quality_jobs
    from cubicsplat_cli.bench.tools import peers as settings_of_tools

    others = settings_of_tools(_chosen(tools, reporter))
    points = benchmark.points_of(run_fits(quality_jobs(pictures, ["closed"], counts, fit), cache, reporter))
    benchmark.run_peers(pictures, others, points, reporter.summary)
    if json:
        from cubicsplat_cli.report import to_json

        typer.echo(to_json(benchmark.peers_report(points)), nl=False)
    else:
        typer.echo(benchmark.peers_table(points, markdown=markdown), nl=False)
    write_csv(csv, [asdict(point) for point in points.done])
    if plot is not None:
        from cubicsplat_cli.files.atomic import write_atomically

        write_atomically(plot, benchmark.plot(points))
    end_with(points.failed)


def _chosen(tools: str | None, reporter: Reporter) -> list[str]:
    """The names asked for, or those that can run here, with a note on the others."""
    from cubicsplat_cli.bench.tools import PEERS, chosen_tools, missing_piece

    if tools is not None:
        names = parts_of(tools)
        if not set(names) <= set(PEERS):
            raise UsageError(f"--tools must be of {', '.join(PEERS)}, with commas between them, not {tools!r}")
        return list(chosen_tools(names))
    missing = {name: missing_piece(name) for name in PEERS}
    for name, piece in missing.items():
        if piece is not None:
            reporter.note(f"without {name}: {piece}")
    return [name for name, piece in missing.items() if piece is None]
