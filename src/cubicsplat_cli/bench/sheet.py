"""A sheet to look at: for each run the original, the SVG as an independent renderer draws it, and their difference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from cubicsplat_cli.bench.cells import labelled_row, stacked
from cubicsplat_cli.bench.runs import Run
from cubicsplat_cli.evaluate import rerender
from cubicsplat_cli.evaluate.layers import of_pixels
from cubicsplat_cli.files.load import load_picture

ERROR_GAIN = 4
MAX_CELL = 768
_LEAST_COLUMN = 240  # px, so that labels have room


def sheet_png(runs: Sequence[tuple[Run, bytes]], paths: Mapping[str, Path]) -> bytes:
    """PNG bytes: one row per run, original | SVG | difference x 4; longer sides over 768 px are scaled down.

    runs: figures and SVG. paths: of the originals by the run's picture name. Transparency is shown over white.
    """
    return stacked([_row(run, svg, paths[run.picture]) for run, svg in runs])


def _row(run: Run, svg: bytes, path: Path) -> Image.Image:
    picture = load_picture(path)
    original = _over_white(picture.target())
    drawn = _over_white(of_pixels(rerender(svg, picture.width, picture.height).pixels).rows(0, picture.height))
    error = np.clip(ERROR_GAIN * np.abs(original - drawn), 0.0, 1.0)
    level = "identical" if run.psnr_db is None else f"{run.psnr_db:.2f} dB"
    labels = (run.picture, f"{run.configuration}: SVG {level}, {run.bytes / 1000:.0f} kB", f"error x {ERROR_GAIN}")
    cells = [_cell(values) for values in (original, drawn, error)]
    return labelled_row(cells, labels, max(cells[0].width, _LEAST_COLUMN))


def _over_white(values: np.ndarray) -> np.ndarray:
    return values[..., :3] + (1.0 - values[..., 3:]) if values.shape[2] == 4 else values


def _cell(values: np.ndarray) -> Image.Image:
    image = Image.fromarray(np.rint(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8))
    scale = min(1.0, MAX_CELL / max(image.size))
    return image.resize((max(1, round(image.width * scale)), max(1, round(image.height * scale))), Image.Resampling.BOX)
