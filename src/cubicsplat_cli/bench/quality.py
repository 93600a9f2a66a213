"""`cubicsplat bench quality`: the tables and the contact sheet of the quality over a folder of pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from cubicsplat_cli.bench.runs import FitFigures, FitJob, Runs
from cubicsplat_cli.evaluate.perceptual import WHITE, over, straight_rgba
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.files.write import encode_png
from cubicsplat_cli.formatting import level_text, mean, number, text_table, titled
from cubicsplat_cli.metrics import head
from cubicsplat_cli.scene.arrays import with_channels
from cubicsplat_cli.settings import FitSettings

ERROR_GAIN = 4
MAX_CELL = 768  # px, the longer side
_LEAST_COLUMN = 240  # px, so that labels have room
_LABEL, _LETTERS, _MARGIN = 18, 12, 6  # px: a line of text, its letters, and the space about a cell

_DECIMALS = {
    "psnr_db": 2, "ssim": 3, "own_psnr_db": 2, "gap_db": 3, "agreement_db": 1, "seconds": 1, "bytes": 1, "paths": 0,
}  # fmt: skip
_HEADER = ("picture", "SVG dB", "SSIM", "own dB", "gap dB", "agreement dB", "s", "kB", "paths")


def configuration_name(mode: str, curves: int) -> str:
    """Return `closed 512`."""
    return f"{mode} {curves}"


def quality_jobs(
    pictures: Sequence[Path], modes: Sequence[str], curves: Sequence[int], fit: Mapping[str, Any]
) -> list[FitJob]:
    """Return a fit of every picture with every mode and number of curves. fit: settings of all of them, by name."""
    return [
        FitJob(path, configuration_name(mode, count), FitSettings.from_preset(mode=mode, curves=count, **fit))
        for mode, count, path in product(modes, curves, pictures)
    ]


def means(runs: Sequence[FitFigures]) -> dict[str, float | int | None]:
    """Return the means of one configuration, and the worst agreement, which a mean hides."""
    agreements = [run.agreement_db for run in runs if run.agreement_db is not None]
    figures: dict[str, float | int | None] = {"pictures": len(runs)}
    for name in _DECIMALS:
        figures[name] = mean(getattr(run, name) for run in runs)
        if name == "agreement_db":
            figures["worst_agreement_db"] = min(agreements, default=None)
    return figures


def quality_report(runs: Runs, configurations: Sequence[str]) -> dict[str, Any]:
    """Return the JSON of `bench quality`."""
    return {
        **head(),
        "bench": "quality",
        "means": {name: means(runs.of(name)) for name in configurations},
        "runs": [asdict(run) for run, _ in runs.done],
        "failed": runs.failures(),
    }


def quality_tables(runs: Runs, configurations: Sequence[str], *, markdown: bool) -> str:
    """Return a table per configuration, whose last row has the means, and a table of all means."""
    parts = []
    for name in configurations:
        fits = runs.of(name)
        rows = [_row(run.picture, asdict(run)) for run in fits]
        rows.append(_row(f"mean of {len(fits)}", means(fits)))
        parts.append(titled(name, text_table(_HEADER, rows, markdown=markdown), markdown=markdown))
    if len(configurations) > 1:
        rows = [_row(name, means(runs.of(name))) for name in configurations]
        table = text_table(("configuration", *_HEADER[1:]), rows, markdown=markdown)
        parts.append(titled("means", table, markdown=markdown))
    return "\n".join(parts)


def _row(name: str, figures: Mapping[str, Any]) -> tuple[str, ...]:
    size = figures["bytes"]
    shown = {**figures, "bytes": None if size is None else size / 1000}
    return name, *(number(shown[f], decimals, sign=f == "gap_db") for f, decimals in _DECIMALS.items())


def sheet_png(runs: Sequence[tuple[FitFigures, bytes]], paths: Mapping[str, Path]) -> bytes:
    """Return a PNG with one row per run: original | SVG | difference x 4; longer sides over 768 px are scaled down.

    runs: figures and SVG. paths: of the originals by the run's picture name. Transparency is shown over white.
    """
    return stacked([_sheet_row(run, svg, paths[run.picture]) for run, svg in runs])


def _sheet_row(run: FitFigures, svg: bytes, path: Path) -> Image.Image:
    picture = load_picture(path)
    original = over(straight_rgba(picture), WHITE)
    drawn = over(rerender(svg, picture.width, picture.height).pixels, WHITE)
    error = np.minimum(ERROR_GAIN * np.abs(original.astype(int) - drawn), 255).astype(np.uint8)
    about = f"{run.configuration}: SVG {level_text(run.psnr_db)}, {run.bytes / 1000:.0f} kB"
    cells = [cell(pixels, MAX_CELL) for pixels in (original, drawn, error)]
    return labelled_row(cells, (run.picture, about, f"error x {ERROR_GAIN}"), max(cells[0].width, _LEAST_COLUMN))


def cell(pixels: np.ndarray, longest: int, *, enlarge: bool = False) -> Image.Image:
    """Return (H, W, 3) uint8 as an image whose longer side has at most `longest` px, or exactly with `enlarge`."""
    image = Image.fromarray(pixels)
    scale = longest / max(image.size)
    if not enlarge:
        scale = min(1.0, scale)
    width, height = (max(1, round(side * scale)) for side in image.size)
    return image.resize((width, height), Image.Resampling.BOX if scale < 1 else Image.Resampling.NEAREST)


def labelled_row(cells: Sequence[Image.Image], labels: Sequence[str], width: int) -> Image.Image:
    """Return the cells in columns of `width` px, each below its label of one or more lines."""
    lines = max(label.count("\n") + 1 for label in labels)
    height = max(cell.height for cell in cells) + lines * _LABEL + _MARGIN
    row = Image.new("RGB", (len(cells) * (width + _MARGIN) + _MARGIN, height), "white")
    draw, font = ImageDraw.Draw(row), ImageFont.load_default(_LETTERS)
    for index, (image, label) in enumerate(zip(cells, labels, strict=True)):
        left = _MARGIN + index * (width + _MARGIN)
        for place, line in enumerate(label.split("\n")):
            text = line.encode("ascii", "replace").decode()  # the built-in font may lack other letters
            draw.text((left, 3 + place * _LABEL), text, fill="black", font=font)
        row.paste(image, (left, lines * _LABEL))
    return row


def stacked(rows: Sequence[Image.Image]) -> bytes:
    """Return a PNG of the rows below one another."""
    sheet = Image.new("RGB", (max(row.width for row in rows), sum(row.height for row in rows)), "white")
    top = 0
    for row in rows:
        sheet.paste(row, (0, top))
        top += row.height
    return encode_png(with_channels(np.asarray(sheet), 4, 255))
