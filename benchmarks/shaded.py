"""Pictures of shaded objects: ours with shading beside our photo style at equal bytes, and beside vtracer."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import numpy as np
import typer
from PIL import Image

from benchmarks import Threads, main
from benchmarks.tools import vtracer_svg
from cubicsplat_cli import vectorize
from cubicsplat_cli.bench.quality import cell, labelled_row, stacked
from cubicsplat_cli.cli.bench import Folder, Limit, Markdown, pictures_of, print_report
from cubicsplat_cli.cli.options import Json, option
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.perceptual import WHITE, mean_delta_e, over
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.read import gzip_size
from cubicsplat_cli.formatting import mean, number, text_table
from cubicsplat_cli.metrics import head
from cubicsplat_cli.svg.drawing_reader import read_drawing
from cubicsplat_cli.svg.drawing_writer import drawn_elements

ENLARGED = 4  # times
CELL = 420  # px of the sheet's pictures
PHOTO_CURVES = 128  # of the photo whose bytes are the budget of a shaded picture
COLUMNS = (
    ("de00", "dE00", 3), ("psnr_db", "dB", 2), ("de00_4x", "dE00 4x", 3), ("psnr_4x_db", "dB 4x", 2),
    ("edge_px", "edge px", 3), ("bytes", "gz bytes", 0), ("shapes", "elements", 0), ("objects", "objects", 0),
    ("cpu_s", "CPU s", 1),
)  # fmt: skip


def scores(pixels: np.ndarray, svg: str) -> dict[str, Any]:
    """The figures of an SVG against a picture (H, W, 4) uint8: at its size, and four times as large against the picture
    enlarged with Lanczos's filter; and how far the silhouette is off, px: of the area between both for each px of it.
    """
    height, width = pixels.shape[:2]
    large = np.asarray(Image.fromarray(pixels).resize((ENLARGED * width, ENLARGED * height), Image.Resampling.LANCZOS))
    drawn = rerender(svg.encode(), width, height).pixels
    drawn_large = rerender(svg.encode(), ENLARGED * width, ENLARGED * height).pixels
    share = drawn_large[..., 3].reshape(height, ENLARGED, width, ENLARGED).mean(axis=(1, 3)) / 255.0
    alpha = pixels[..., 3] / 255.0
    length = float(np.hypot(*np.gradient(alpha)).sum())
    try:
        objects = len(read_drawing(svg).shapes)
    except InputError:  # which is none of our drawings
        objects = None
    return {
        "de00": mean_delta_e(pixels, drawn), "psnr_db": psnr_db(pixels, drawn),
        "de00_4x": mean_delta_e(large, drawn_large), "psnr_4x_db": psnr_db(large, drawn_large),
        "edge_px": float(np.abs(share - alpha).sum()) / length if length else None,
        "bytes": gzip_size(svg), "shapes": drawn_elements(svg), "objects": objects,
    }  # fmt: skip


def psnr_db(first: np.ndarray, second: np.ndarray) -> float:
    """PSNR in dB of two straight RGBA pictures over white."""
    error = np.square((over(first, WHITE).astype(float) - over(second, WHITE)) / 255.0).mean()
    return float(-10.0 * np.log10(max(error, 1e-12)))


def rows_of(path: Path, threads: int) -> list[tuple[dict[str, Any], str]]:
    """The figures and the SVG of each tool of one picture."""
    pixels = np.asarray(Image.open(path).convert("RGBA"))
    made: list[tuple[dict[str, Any], str]] = []

    def add(tool: str, make: Callable[[], str]) -> str:
        began = time.process_time()
        svg = make()
        seconds = time.process_time() - began
        made.append(({"picture": path.name, "tool": tool, **scores(pixels, svg), "cpu_s": seconds}, svg))
        return svg

    def ours(**options: Any) -> str:
        return vectorize(pixels, threads=threads, measure=False, **options).svg

    shaded = add("shaded", lambda: ours(shading="auto"))
    add(f"photo, {PHOTO_CURVES} curves", lambda: ours(style="photo", curves=PHOTO_CURVES))
    add("photo, equal bytes", lambda: ours(style="photo", max_bytes=f"{gzip_size(shaded)}gz"))
    add("vtracer", lambda: vtracer_svg(pixels).decode())
    return made


def shaded(
    folder: Folder,
    threads: Threads = 1,
    limit: Limit = None,
    sheet: Annotated[Path | None, option("--sheet OUT.png", "Also a contact sheet.")] = None,
    json: Json = False,
    markdown: Markdown = False,
) -> None:
    """Quality, size and structure of pictures of shaded objects."""
    paths, runs = pictures_of(folder, limit), []
    for path in paths:
        runs.append(rows_of(path, threads))
        for row, _ in runs[-1]:
            typer.echo(f"{row['picture']}, {row['tool']}: {', '.join(_figures(row))}", err=True)
    if sheet is not None:
        sheet.write_bytes(sheet_png(paths, runs))
    rows = [row for run in runs for row, _ in run]
    tools = list(dict.fromkeys(row["tool"] for row in rows))
    table = [[tool, *_means([row for row in rows if row["tool"] == tool])] for tool in tools]
    text = text_table(("", *(title for _, title, _ in COLUMNS)), table, markdown=markdown)
    print_report({**head(), "bench": "shaded", "rows": rows}, text, json=json)


def sheet_png(paths: Sequence[Path], runs: Sequence[Sequence[tuple[dict[str, Any], str]]]) -> bytes:
    """PNG bytes, a row for each picture: the picture and each tool's SVG, enlarged, over white."""
    rows = []
    for path, run in zip(paths, runs, strict=True):
        pixels = np.asarray(Image.open(path).convert("RGBA"))
        cells, labels = [cell(over(pixels, WHITE), CELL, enlarge=True)], [path.name]
        for row, svg in run:
            side = CELL / max(pixels.shape[:2])
            drawn = rerender(svg.encode(), round(side * pixels.shape[1]), round(side * pixels.shape[0])).pixels
            cells.append(cell(over(drawn, WHITE), CELL))
            labels.append(f"{row['tool']}: dE00 {row['de00']:.3f}, {row['psnr_db']:.1f} dB, {row['bytes']} bytes")
        rows.append(labelled_row(cells, labels, CELL))
    return stacked(rows)


def _figures(row: dict[str, Any]) -> list[str]:
    return [f"{title} {number(row[name], digits)}" for name, title, digits in COLUMNS if row[name] is not None]


def _means(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The means of the columns over pictures; of shapes and objects the medians."""
    cells = []
    for name, _, digits in COLUMNS:
        values = [row[name] for row in rows if row[name] is not None]
        of_all = median if name in ("shapes", "objects") else mean
        cells.append(number(of_all(values), digits) if values else "")
    return cells


if __name__ == "__main__":
    main(shaded)
