"""A sheet to look at: for each run the original, the SVG as an independent renderer draws it, and their difference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from cubicsplat_cli.bench.runs import Run
from cubicsplat_cli.evaluate import rerender
from cubicsplat_cli.evaluate.metrics import premultiplied
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.files.png import encode_png

ERROR_GAIN = 4
MAX_CELL = 768
_LEAST_COLUMN = 240  # px, so that labels have room
_LABEL = 18
_LETTERS = 12  # px
_MARGIN = 6


def sheet_png(runs: Sequence[tuple[Run, bytes]], paths: Mapping[str, Path]) -> bytes:
    """PNG bytes: one row per run, original | SVG | difference x 4; longer sides over 768 px are scaled down.

    runs: figures and SVG. paths: of the originals by the run's picture name. Transparency is shown over white.
    """
    rows = [_row(run, svg, paths[run.picture]) for run, svg in runs]
    width = max(row.width for row in rows)
    sheet = Image.new("RGB", (width, sum(row.height for row in rows)), "white")
    top = 0
    for row in rows:
        sheet.paste(row, (0, top))
        top += row.height
    pixels = np.asarray(sheet)
    return encode_png(np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)]))


def _row(run: Run, svg: bytes, path: Path) -> Image.Image:
    picture = load_picture(path)
    original = _over_white(picture.target())
    drawn = _over_white(premultiplied(rerender(svg, picture.width, picture.height).pixels))
    error = np.clip(ERROR_GAIN * np.abs(original - drawn), 0.0, 1.0)
    level = "identical" if run.psnr_db is None else f"{run.psnr_db:.2f} dB"
    labels = (run.picture, f"{run.configuration}: SVG {level}, {run.bytes / 1000:.0f} kB", f"error x {ERROR_GAIN}")
    cells = [_cell(values) for values in (original, drawn, error)]
    width, height = max(cells[0].width, _LEAST_COLUMN), cells[0].height
    row = Image.new("RGB", (3 * width + 4 * _MARGIN, height + _LABEL + _MARGIN), "white")
    draw, font = ImageDraw.Draw(row), ImageFont.load_default(_LETTERS)
    for index, (cell, label) in enumerate(zip(cells, labels, strict=True)):
        left = _MARGIN + index * (width + _MARGIN)
        # The built-in font may hold no other letters, and no label is worth a failure.
        draw.text((left, 3), label.encode("ascii", "replace").decode(), fill="black", font=font)
        row.paste(cell, (left, _LABEL))
    return row


def _over_white(values: np.ndarray) -> np.ndarray:
    return values[..., :3] + (1.0 - values[..., 3:]) if values.shape[2] == 4 else values


def _cell(values: np.ndarray) -> Image.Image:
    image = Image.fromarray(np.rint(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8))
    scale = min(1.0, MAX_CELL / max(image.size))
    return image.resize((max(1, round(image.width * scale)), max(1, round(image.height * scale))), Image.Resampling.BOX)
