"""A contact sheet: for each drawing and tool the input, the SVG and the truth enlarged, and the outlines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from cubicsplat_cli.bench.artwork.document import Document
from cubicsplat_cli.bench.artwork.figures import Figures
from cubicsplat_cli.bench.artwork.inputs import CLEAN, input_of, with_ground
from cubicsplat_cli.bench.artwork.wireframe import wireframe
from cubicsplat_cli.bench.cells import labelled_row, stacked
from cubicsplat_cli.evaluate.colour import WHITE, over

CELL = 640  # px, the longer side
_ENLARGED = 4
_PALE = 0.3  # how much of the picture shows under its outlines


def sheet_png(runs: Sequence[tuple[Figures, bytes]], paths: Mapping[str, Path], size: int, kind: str = CLEAN) -> bytes:
    """PNG bytes, a row per drawing and tool: input | SVG at 4x | truth at 4x | outlines, all over white.

    runs: figures and SVG. paths: the truth by its name. size: longer side of the input; kind: of `inputs`.
    """
    return stacked([_row(figures, svg, paths[figures.picture], size, kind) for figures, svg in runs])


def _row(figures: Figures, svg: bytes, path: Path, size: int, kind: str) -> Image.Image:
    truth, made = (Document(data, figures.picture, size) for data in (path.read_bytes(), svg))
    with_ground(truth, kind)
    cells = [_cell(input_of(truth, kind)), _cell(made.draw(_ENLARGED)), _cell(truth.draw(_ENLARGED)), _outlines(made)]
    labels = (
        f"{figures.picture}: input, {truth.width} x {truth.height}",
        f"{figures.tool}: dE00 {figures.delta_e:.3f}, {figures.psnr_1x_db:.1f} / {figures.psnr_4x_db:.1f} dB, "
        f"seams {figures.seam_4x_px:.2f} px",
        f"truth: {figures.artist_shapes} shapes, {figures.artist_coordinates} coordinates",
        f"{figures.shapes} shapes, {figures.coordinates} coordinates, {figures.primitives} primitives",
    )
    return labelled_row(cells, labels, CELL)


def _cell(pixels: np.ndarray) -> Image.Image:
    image = Image.fromarray(over(pixels, WHITE))
    scale = CELL / max(image.size)
    return image.resize(_scaled(image.size, scale), Image.Resampling.BOX if scale < 1 else Image.Resampling.NEAREST)


def _outlines(made: Document) -> Image.Image:
    scale = CELL / max(made.width, made.height)
    pale = _cell(made.draw(_ENLARGED))
    lines = Document(wireframe(made, 1 / scale), "outlines", max(made.width, made.height)).draw(scale)
    ground = Image.blend(Image.new("RGB", pale.size, "white"), pale, _PALE).convert("RGBA")
    front = Image.fromarray(lines).resize(pale.size)
    return Image.alpha_composite(ground, front).convert("RGB")


def _scaled(size: tuple[int, int], scale: float) -> tuple[int, int]:
    return max(1, round(size[0] * scale)), max(1, round(size[1] * scale))
