"""A contact sheet: for each drawing and tool the input, the SVG and the truth enlarged, and the SVG's outlines."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from PIL import Image

from benchmarks.artwork.degradations import CLEAN, degraded, with_background
from benchmarks.artwork.document import Document
from benchmarks.artwork.scores import Scores
from cubicsplat_cli.bench.quality import cell, labelled_row, stacked
from cubicsplat_cli.evaluate.perceptual import WHITE, over
from cubicsplat_cli.svg.elements import SVG, StyledShape
from cubicsplat_cli.svg.paths import PathSegment, subpaths

CELL = 640  # px, the longer side
_ENLARGED = 4  # times
_PALE = 0.3  # opacity of the picture under its outlines
_CURVE, _PRIMITIVE, _HANDLE, _ANCHOR = "#1747d1", "#0a8f3c", "#e08a00", "#d11717"


def sheet_png(runs: Sequence[tuple[Scores, bytes]], paths: Mapping[str, Path], size: int, kind: str = CLEAN) -> bytes:
    """PNG bytes, a row per drawing and tool: input | SVG at 4x | truth at 4x | outlines, all over white.

    runs: scores and SVG. paths: the truth by its name. size: longer side of the input, px; kind: of the degradations.
    """
    return stacked([_row(scores, svg, paths[scores.picture], size, kind) for scores, svg in runs])


def _row(scores: Scores, svg: bytes, path: Path, size: int, kind: str) -> Image.Image:
    truth, made = (Document(data, scores.picture, size) for data in (path.read_bytes(), svg))
    with_background(truth, kind)
    pixels = degraded(truth, kind), made.draw(_ENLARGED), truth.draw(_ENLARGED)
    cells = [*(cell(over(each, WHITE), CELL, enlarge=True) for each in pixels), _outlines(made)]
    labels = (
        f"{scores.picture}: input, {truth.width} x {truth.height}",
        f"{scores.tool}: dE00 {scores.delta_e:.3f}, {scores.psnr_1x_db:.1f} / {scores.psnr_4x_db:.1f} dB, "
        f"leaks {scores.leak_4x_px:.2f} px",
        f"truth: {scores.artist_shapes} shapes, {scores.artist_coordinates} coordinates",
        f"{scores.shapes} shapes, {scores.coordinates} coordinates, {scores.primitives} primitives",
    )
    return labelled_row(cells, labels, CELL)


def _outlines(made: Document) -> Image.Image:
    scale = CELL / max(made.width, made.height)
    pale = cell(over(made.draw(_ENLARGED), WHITE), CELL, enlarge=True)
    lines = Document(wireframe(made, 1 / scale), "outlines", max(made.width, made.height)).draw(scale)
    background = Image.blend(Image.new("RGB", pale.size, "white"), pale, _PALE).convert("RGBA")
    return Image.alpha_composite(background, Image.fromarray(lines).resize(pale.size)).convert("RGB")


def wireframe(document: Document, pixel: float) -> bytes:
    """An SVG of the document's size with all its outlines; primitives in green, handles in orange, anchors in red.

    pixel: length of one px of the picture that will be drawn, in px of the document's canvas.
    """
    size = {"width": str(document.width), "height": str(document.height)}
    root = ElementTree.Element(f"{SVG}svg", size | {"viewBox": f"0 0 {document.width} {document.height}"})
    marks: list[ElementTree.Element] = []
    for shape in document.shapes():
        root.append(_outline(shape, pixel))
        if shape.name == "path":
            segments = [segment for subpath in subpaths(shape.path_data()) for segment in subpath]
            marks += _marks(segments, shape.matrix, pixel)
    root.extend(marks)
    return ElementTree.tostring(root)


def _outline(shape: StyledShape, unit: float) -> ElementTree.Element:
    scale = math.sqrt(abs(np.linalg.det(shape.matrix[:2, :2]))) or 1.0
    return _path(
        shape.path_data(),
        fill="none",
        stroke=_CURVE if shape.name == "path" else _PRIMITIVE,
        transform="matrix({})".format(" ".join(f"{value:.9g}" for value in shape.matrix[:2].T.ravel())),
        **{"stroke-width": f"{unit / scale:.6g}"},
    )


def _marks(found: list[PathSegment], matrix: np.ndarray, unit: float) -> list[ElementTree.Element]:
    """Lines to the handles with a dot each, and a square at every anchor."""
    lines, dots, squares = [], [], []
    for piece in found:
        start, end, *handles = ((matrix @ (*point, 1.0))[:2] for point in (piece.start, piece.end, *piece.handles))
        squares.append(_square(end, 1.8 * unit))
        for handle, anchor in zip(handles, (start, end) if len(handles) == 2 else (start,), strict=False):
            lines.append(f"M{anchor[0]:.6g} {anchor[1]:.6g}L{handle[0]:.6g} {handle[1]:.6g}")
            dots.append(_square(handle, unit))
    return [
        _path("".join(lines), fill="none", stroke=_HANDLE, **{"stroke-width": f"{0.6 * unit:.6g}"}),
        _path("".join(dots), fill=_HANDLE),
        _path("".join(squares), fill=_ANCHOR),
    ]


def _square(middle: np.ndarray, half: float) -> str:
    x, y = middle
    return f"M{x - half:.6g} {y - half:.6g}h{2 * half:.6g}v{2 * half:.6g}h{-2 * half:.6g}z"


def _path(d: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.Element(f"{SVG}path", {"d": d, **attributes})
