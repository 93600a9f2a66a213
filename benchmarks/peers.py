"""Photos by other tools and by ours at several sizes: the quality of each for its bytes and seconds."""

from __future__ import annotations

import gzip
import importlib.util
import io
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

from benchmarks import main
from benchmarks.tools import PEERS, Tool, chosen_tools, missing_piece, settings_of_peers
from cubicsplat_cli._version import __version__
from cubicsplat_cli.bench.quality import quality_jobs
from cubicsplat_cli.bench.runs import Runs
from cubicsplat_cli.cli.bench import (
    Cache,
    Csv,
    CurvesList,
    Folder,
    Limit,
    Markdown,
    check_png,
    comma_parts,
    counts_of,
    end_with,
    pictures_of,
    print_report,
    run_fits,
)
from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import Json, Quiet, check_csv, option, takes_options, write_csv
from cubicsplat_cli.errors import CubicSplatError, UsageError
from cubicsplat_cli.evaluate.comparison import compare_with
from cubicsplat_cli.evaluate.perceptual import straight_rgba
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.files.marks import PROGRAM
from cubicsplat_cli.files.write import write_atomically
from cubicsplat_cli.formatting import counted, mean, number, one_line, text_table
from cubicsplat_cli.metrics import head

OURS = "cubicsplat"
_HEADER = ("tool", "setting", "pictures", "SVG dB", "SSIM", "kB", "gz kB", "s")


@dataclass(frozen=True)
class Point:
    """One picture by one tool at one setting. psnr_db, ssim: of the SVG file, drawn by `renderer`. bytes: of the file;
    gzipped_bytes: compressed, as servers send it. seconds: from the pixels to the drawing, not those of measuring it.
    """

    picture: str
    tool: str
    setting: str
    psnr_db: float | None
    ssim: float | None
    bytes: int
    gzipped_bytes: int
    seconds: float
    renderer: str


@dataclass
class Points:
    """What came out; failures as (picture, tool and setting, error)."""

    done: list[Point] = field(default_factory=list)
    failed: list[tuple[str, str, str]] = field(default_factory=list)

    def of(self, tool: str, setting: str) -> list[Point]:
        """Those of one tool at one setting."""
        return [point for point in self.done if (point.tool, point.setting) == (tool, setting)]

    def settings(self) -> list[tuple[str, str]]:
        """Every tool with each of its settings, in the order in which they were measured."""
        return list(dict.fromkeys((point.tool, point.setting) for point in self.done))


def points_of(runs: Runs) -> Points:
    """Our own, from fits of a folder."""
    done = [
        Point(
            run.picture, OURS, f"{run.curves} curves", run.psnr_db, run.ssim, run.bytes, len(gzip.compress(svg)),
            run.fit_seconds, run.renderer,
        )
        for run, svg in runs.done
    ]  # fmt: skip
    return Points(done, list(runs.failed))


def run_peers(
    paths: Sequence[Path], tools: Mapping[tuple[str, str], Tool], points: Points, tell: Callable[[str], None]
) -> None:
    """Every picture by every tool, added to `points`; a failure is recorded and the others go on."""
    for path in paths:
        try:
            picture = load_picture(path)
        except CubicSplatError as error:
            points.failed.append((path.name, "", one_line(error)))
            continue
        pixels = straight_rgba(picture)
        for (tool, setting), make in tools.items():
            try:
                started = time.perf_counter()
                svg = make(pixels)
                seconds = time.perf_counter() - started
                found = compare_with(picture, path.name, svg, f"{path.name} by {tool}", is_svg=True)
            except Exception as error:
                # Whatever a tool raises is a failure of that tool, which is one of the figures.
                points.failed.append((path.name, f"{tool}, {setting}", one_line(error) or type(error).__name__))
                tell(f"{path.name}, {tool}, {setting}: failed: {one_line(error)}")
                continue
            quality, sizes = found.quality, (len(svg), len(gzip.compress(svg)))
            figures = quality.psnr_db, quality.ssim, *sizes, seconds, found.renderer or ""
            points.done.append(Point(path.name, tool, setting, *figures))
            tell(f"{path.name}, {tool}, {setting}: {number(quality.psnr_db, 2)} dB, {len(svg)} bytes, {seconds:.1f} s")


def means(points: Sequence[Point]) -> dict[str, float | None]:
    """Of one tool at one setting."""
    members = ("psnr_db", "ssim", "bytes", "gzipped_bytes", "seconds")
    return {member: mean(getattr(point, member) for point in points) for member in members}


def report_of(points: Points) -> dict[str, Any]:
    """The figures as JSON."""
    return {
        **head(),
        "bench": "peers",
        "means": [{"tool": t, "setting": s, **means(points.of(t, s))} for t, s in points.settings()],
        "points": [asdict(point) for point in points.done],
        "failed": [{"picture": p, "tool": t, "error": e} for p, t, e in points.failed],
    }


def table_of(points: Points, *, markdown: bool) -> str:
    """A row for each tool and setting."""
    rows = []
    for tool, setting in points.settings():
        of = points.of(tool, setting)
        found = means(of)
        kilobytes = [None if found[m] is None else found[m] / 1000 for m in ("bytes", "gzipped_bytes")]  # type: ignore[operator]
        rows.append(
            (
                tool, setting, str(len(of)), number(found["psnr_db"], 2), number(found["ssim"], 3),
                *(number(k, 1) for k in kilobytes), number(found["seconds"], 1),
            )
        )  # fmt: skip
    return text_table(_HEADER, rows, markdown=markdown)


def plotted(points: Points) -> bytes:
    """PNG bytes: PSNR and SSIM against bytes and seconds, a line per tool through the means of its settings."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7.5), layout="constrained")
    panels = figure.subplots(2, 2, sharex="col", sharey="row")
    for tool in dict.fromkeys(tool for tool, _ in points.settings()):
        levels = [means(points.of(t, s)) for t, s in points.settings() if t == tool]
        for row, up in enumerate(("psnr_db", "ssim")):
            for column, across in enumerate(("bytes", "seconds")):
                known = [(x, y) for v in levels if (x := v[across]) is not None and (y := v[up]) is not None]
                scale = 1000.0 if across == "bytes" else 1.0
                panels[row, column].plot([x / scale for x, _ in known], [y for _, y in known], "o-", label=tool)
    for panel in panels.flat:
        panel.set_xscale("log")
        panel.grid(alpha=0.3)
    panels[0, 0].set_ylabel("PSNR of the file, dB")
    panels[1, 0].set_ylabel("SSIM of the file")
    panels[1, 0].set_xlabel("size of the file, kB")
    panels[1, 1].set_xlabel("seconds")
    panels[0, 0].legend()
    figure.suptitle(f"means of {counted(len({point.picture for point in points.done}), 'picture')}")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": f"{PROGRAM} {__version__}"})
    return buffer.getvalue()


@takes_options("preset", "steps", "seed", "device", "threads", after=3)
def peers(
    folder: Folder,
    curves: CurvesList = "64,256,1024,4096",
    tools: Annotated[
        str | None, option("--tools TOOL,...", "Of vtracer, potrace and diffvg.  [default: those that are installed]")
    ] = None,
    limit: Limit = None,
    cache: Cache = None,
    plot: Annotated[
        Path | None, option("--plot FILE", "Also draw PSNR and SSIM against bytes and seconds, as a PNG.")
    ] = None,
    json: Json = False,
    csv: Csv = None,
    markdown: Markdown = False,
    quiet: Quiet = False,
    **fit: Any,
) -> None:
    """Other tools and ours on photos: quality, bytes, seconds.

    For drawings whose truth is known, benchmarks.artwork measures the same tools.
    """
    counts = counts_of(curves)
    check_csv(csv)
    if plot is not None and importlib.util.find_spec("matplotlib") is None:
        raise UsageError("--plot needs matplotlib; pip install 'cubicsplat[plots]'")
    check_png(plot, "plot")
    reporter = Reporter(quiet=quiet)
    pictures = pictures_of(folder, limit)
    others = settings_of_peers(_chosen(tools, reporter))
    points = points_of(run_fits(quality_jobs(pictures, ["closed"], counts, fit), cache, reporter))
    run_peers(pictures, others, points, reporter.summary)
    print_report(report_of(points), table_of(points, markdown=markdown), json=json)
    write_csv(csv, [asdict(point) for point in points.done])
    if plot is not None:
        write_atomically(plot, plotted(points))
    end_with(points.failed)


def _chosen(tools: str | None, reporter: Reporter) -> list[str]:
    """The tools asked for, or those that can run here, with a note on the others."""
    if tools is not None:
        return list(chosen_tools(comma_parts(tools), PEERS))
    missing = {name: missing_piece(name) for name in PEERS}
    for name, piece in missing.items():
        if piece is not None:
            reporter.note(f"without {name}: {piece}")
    return [name for name, piece in missing.items() if piece is None]


if __name__ == "__main__":
    main(peers)
