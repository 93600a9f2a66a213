"""Folders of pictures by `cubicsplat vectorize`, each in a process of its own: time, memory, size and quality."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from PIL import Image

from benchmarks import main
from benchmarks.artwork.document import Document
from benchmarks.artwork.pixels import psnr
from benchmarks.artwork.scores import count
from cubicsplat_cli.bench.quality import cell, labelled_row, stacked
from cubicsplat_cli.cli.bench import Limit, end_with, pictures_of
from cubicsplat_cli.cli.options import argument, option
from cubicsplat_cli.errors import CubicSplatError, UsageError
from cubicsplat_cli.evaluate.perceptual import WHITE, mean_delta_e, over, straight_rgba
from cubicsplat_cli.evaluate.rerender import rerender_untrusted
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.files.write import write_atomically
from cubicsplat_cli.formatting import number, one_line

CELL, ROWS = 480, 6  # px of a picture's longer side on a contact sheet, and pictures on one sheet
# Decimals of the figures of a result. cpu_seconds: with those of child processes. peak_gb: resident, 10^9 bytes, of the
# largest process. psnr_db, delta_e: of the SVG at the picture's size, both over white.
FIGURES = {
    "seconds": 1, "cpu_seconds": 1, "peak_gb": 2, "shapes": 0, "coordinates": 0, "bytes": 0, "psnr_db": 2, "delta_e": 3
}  # fmt: skip
COLUMNS = ("picture", "version", "style", *FIGURES, "error")
ERROR = "cubicsplat: error: "
Result = dict[str, Any]  # of COLUMNS those that there are


def run_process(command: Sequence[str], pythonpath: str | None, seconds: float, gigabytes: float) -> tuple[str, Result]:
    """Run a command to its end, or kill it and its children after so many seconds.

    pythonpath: None for that of this process. gigabytes: of addresses that a process may have. Returns the standard
    output, and the result of the process: seconds, memory, and the reason of a failure, if it failed.
    """
    import resource  # Windows has none, but can show the help

    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        began = time.perf_counter()
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=errors,
            env=dict(os.environ) if pythonpath is None else {**os.environ, "PYTHONPATH": pythonpath},
            start_new_session=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (int(gigabytes * 1e9),) * 2),
        )
        timer = threading.Timer(seconds, os.killpg, (process.pid, signal.SIGKILL))
        timer.start()
        try:
            _, status, usage = os.wait4(process.pid, 0)
        except KeyboardInterrupt:
            os.killpg(process.pid, signal.SIGKILL)
            raise
        finally:
            timer.cancel()
        code = process.returncode = os.waitstatus_to_exitcode(status)
        wall = time.perf_counter() - began
        text, lines = (os.pread(stream.fileno(), 2**24, 0).decode(errors="replace") for stream in (output, errors))
        peak = usage.ru_maxrss * (1e-9 if sys.platform == "darwin" else 1.024e-6)  # bytes there, elsewhere kilobytes
        result: Result = {"seconds": wall, "cpu_seconds": usage.ru_utime + usage.ru_stime, "peak_gb": peak}
        if code == -signal.SIGKILL and wall >= seconds:
            result["error"] = f"took over {seconds:g} s"
        elif code:
            ours = [line.removeprefix(ERROR) for line in lines.splitlines() if line.startswith(ERROR)]
            result["error"] = one_line([f"ended with exit code {code}", *lines.strip().splitlines()[-1:], *ours][-1])
        return text, result


def measure(
    picture: Path, svg: Path, pythonpath: str | None, options: Sequence[str], seconds: float, gigabytes: float
) -> tuple[Result, np.ndarray | None]:
    """Vectorize a picture within these limits; the result, and the SVG's drawing (H, W, 3) uint8 over white, if any."""
    command = [sys.executable, "-m", "cubicsplat_cli", "vectorize", str(picture), "-o", str(svg), "--force", "--json"]
    output, result = run_process([*command, *options], pythonpath, seconds, gigabytes)
    result["picture"] = f"{picture.parent.name}/{picture.name}"
    if "error" in result:
        return result, None
    data = svg.read_bytes()
    report = json.loads(output.splitlines()[-1])
    result |= {"bytes": len(data), "style": report["style"]}
    # The other style stands in for one that failed, which nobody would see in the figures.
    if bugs := [note for note in report.get("notes", ()) if "this is a bug" in note]:
        return result | {"error": bugs[0]}, None
    try:
        original = _opaque(straight_rgba(load_picture(picture)))
        height, width = original.shape[:2]
        drawn = _opaque(rerender_untrusted(data, source=svg.name, width=width, height=height)[0].pixels)
        counts = count(Document(data, svg.name))
    except CubicSplatError as problem:
        return result | {"error": one_line(problem)}, None
    result |= {"shapes": counts.shapes, "coordinates": counts.coordinates}
    return result | {"psnr_db": psnr(original, drawn), "delta_e": mean_delta_e(original, drawn)}, drawn[..., :3]


def _opaque(pixels: np.ndarray) -> np.ndarray:
    """(H, W, 4) uint8 over white."""
    return np.dstack([over(pixels, WHITE), np.full(pixels.shape[:2], 255, np.uint8)])


def texts_of(result: Result) -> tuple[str, str, str]:
    """Version and style, time and memory, and the figures of the file or its error."""
    measured = [name for name in FIGURES if name in result]
    texts = [f"{name} {number(result[name], FIGURES[name])}" for name in measured]
    end = result.get("error") or "  ".join(texts[3:])
    return f"{result['version']}  {result.get('style', '')}".rstrip(), "  ".join(texts[:3]), end


def ratios(pairs: Sequence[tuple[Result, Result]]) -> str:
    """New over old: geometric means over the pictures that both versions did; of delta_e the mean difference."""
    done = [(new, old) for new, old in pairs if "error" not in new and "error" not in old]
    if not done:
        return "no picture that both versions did"
    parts = [f"new / old of {len(done)} pictures:"]
    for name in tuple(FIGURES)[:6]:
        logs = [math.log(max(new[name], 1e-9) / max(old[name], 1e-9)) for new, old in done]
        parts.append(f"{name} {math.exp(sum(logs) / len(logs)):.3f} ")
    return " ".join([*parts, f"delta_e {sum(new['delta_e'] - old['delta_e'] for new, old in done) / len(done):+.4f}"])


def sheet_row(picture: Path, results: Sequence[tuple[Result, np.ndarray | None]]) -> Image.Image:
    """Picture | drawing of each version, with the figures; grey where there is none."""
    blank = np.full((4, 16, 3), 224, np.uint8)
    try:
        shown = [over(straight_rgba(load_picture(picture)), WHITE)]
    except CubicSplatError:
        shown = [blank]  # the results hold the error
    labels = [results[0][0]["picture"]]
    for result, drawn in results:
        shown.append(blank if drawn is None else drawn)
        labels.append("\n".join(text[:75] for text in texts_of(result)))
    return labelled_row([cell(pixels, CELL, enlarge=True) for pixels in shown], labels, CELL)


def folder(
    folders: Annotated[list[Path], argument("DIR... [-- OPTION...]", "Pictures, and options of vectorize.")],
    compare: Annotated[str | None, option("--compare PATH", "Also run the version at this PYTHONPATH.")] = None,
    output: Annotated[Path, option("--output -o DIR", "For SVGs, table.tsv and contact sheets.")] = Path(
        "build/folder"
    ),
    time_limit: Annotated[float, option("--time-limit S", "Seconds a picture.")] = 300.0,
    memory_limit: Annotated[float, option("--memory-limit GB", "Of addresses, 10^9 bytes.")] = 16,
    limit: Limit = None,
) -> None:
    """Folders of pictures by the real command: time, memory, size, quality.

    With --compare both versions take turns, and their ratios follow. Failures are listed with their reasons, and make
    the exit code 1. Linux and macOS.
    """
    # The parser drops the "--" and takes what follows for further folders.
    options = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    pictures = [path for each in folders[: len(folders) - len(options)] for path in pictures_of(each, limit)]
    if min(time_limit, memory_limit) <= 0:
        raise UsageError("--time-limit and --memory-limit must be above 0")
    versions = {"new": None} if compare is None else {"new": None, "old": compare}
    for version in versions:
        (output / version).mkdir(parents=True, exist_ok=True)
    done: list[dict[str, Result]] = []
    rows: list[Image.Image] = []
    with (output / "table.tsv").open("w", encoding="utf-8") as table:
        print(*COLUMNS, sep="\t", file=table)
        for index, picture in enumerate(pictures):
            found = {}
            # The versions take turns: the second one finds the files in the system's cache.
            for version in list(versions)[:: -1 if index % 2 else 1]:
                svg = output / version / f"{picture.parent.name}-{picture.name}.svg"
                result, _ = found[version] = measure(picture, svg, versions[version], options, time_limit, memory_limit)
                result["version"] = version
                print(*(result.get(column, "") for column in COLUMNS), sep="\t", file=table, flush=True)
                typer.echo("  ".join(text for text in (result["picture"], *texts_of(result)) if text))
            done.append({version: result for version, (result, _) in found.items()})
            rows.append(sheet_row(picture, [found[version] for version in versions]))
            if len(rows) == ROWS or index + 1 == len(pictures):
                write_atomically(output / f"sheet-{index // ROWS + 1:02}.png", stacked(rows))
                rows = []
    if compare is not None:
        typer.echo(ratios([(each["new"], each["old"]) for each in done]))
    end_with([(r["picture"], r["version"], r["error"]) for each in done for r in each.values() if "error" in r])


if __name__ == "__main__":
    main(folder)
