"""Photos as few shapes of one kind, by `--shapes` and by M. Fogleman's primitive with `-r 256`."""

from __future__ import annotations

import math
import os
import re
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from PIL import Image

from benchmarks import main
from cubicsplat_cli import compare, vectorize
from cubicsplat_cli.cli.bench import CurvesList, Folder, Markdown, counts_of, pictures_of
from cubicsplat_cli.cli.options import option, takes_options
from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.formatting import number, text_table

SIDE = 300  # px, the longer of a photo
MODES = {"triangle": 1, "rectangle": 5, "ellipse": 7}  # primitive's, all of them turned
HEADER = ("shapes", "count", "primitive dB", "cubicsplat dB", "primitive CPU s", "cubicsplat CPU s", "below +1 dB")

Made = tuple[str, float]  # an SVG, and its CPU seconds
Binary = Annotated[str, option("--primitive FILE", "primitive's program.")]


def primitive(photo: Image.Image, mode: int, counts: Sequence[int], binary: str) -> list[Made]:
    """The SVG of each number of shapes and the CPU seconds until then, by one run, since it only ever adds shapes."""
    with tempfile.TemporaryDirectory() as folder:
        made = [Path(folder, f"{count}.svg") for count in counts]
        photo.save(f"{folder}/given.png")
        files = ("-i", f"{folder}/given.png", "-o", f"{folder}/%d.svg", "-nth", math.gcd(*counts))
        options = (*files, "-m", mode, "-n", max(counts), "-r", 256, "-j", 1)
        process, ended, seconds = subprocess.Popen([binary, *map(str, options)]), False, [0.0] * len(counts)
        while not ended:
            time.sleep(0.05)
            # Its times can be read for as long as nobody has waited for it.
            ended = os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is not None
            ticks = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")")[1].split()[11:13]
            now = sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")
            seconds = [known or now * path.exists() for known, path in zip(seconds, made, strict=True)]
        if code := process.wait():
            raise EngineError(f"primitive ended with code {code}")
        # It rounds the sides of its smaller copy; stretched, the file leaves no border on the picture.
        root, filled = r'width="(\d+)" height="(\d+)"', r'viewBox="0 0 \1 \2" preserveAspectRatio="none"'
        return [(re.sub(root, filled, path.read_text(), count=1), s) for path, s in zip(made, seconds, strict=True)]


@takes_options("preset", "steps", "seed", after=3)
def shapes(
    folder: Folder, binary: Binary = "primitive", curves: CurvesList = "50,100,200", markdown: Markdown = False,
    **fit: Any,
) -> None:  # fmt: skip
    """Photos as shapes of one kind, by primitive and by ours, on one thread."""
    counts, table, paths = counts_of(curves), [], pictures_of(folder, None)
    photos = [Image.open(path).convert("RGB") for path in paths]
    for photo in photos:
        photo.thumbnail((SIDE, SIDE), Image.Resampling.LANCZOS)
    for kind, mode in MODES.items():
        theirs = [primitive(photo, mode, counts, binary) for photo in photos]
        for count, made in zip(counts, zip(*theirs, strict=True), strict=True):
            options = fit | {"shapes": kind, "curves": count}
            rows = [figures(np.asarray(photo), options, own) for photo, own in zip(photos, made, strict=True)]
            below = [path.stem for path, row in zip(paths, rows, strict=True) if row[1] < row[0] + 1.0]
            means = [number(float(value), 2) for value in np.mean(rows, axis=0)]
            table.append([kind, str(count), *means, " ".join(below)])
    typer.echo(text_table(HEADER, table, markdown=markdown), nl=False)


def figures(pixels: np.ndarray, options: dict[str, Any], theirs: Made) -> list[float]:
    """PSNR in dB of primitive's SVG and of ours, and the CPU seconds of both."""
    began = time.process_time()
    ours = vectorize(pixels, **options, style="photo", threads=1, measure=False)
    seconds = theirs[1], time.process_time() - began
    return [*(compare(pixels, svg).psnr_db or math.inf for svg in (theirs[0], ours)), *seconds]


if __name__ == "__main__":
    main(shapes)
