"""Cusps and slivers of SVGs of the photo style, whether other curves hide them or not."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from benchmarks import main
from cubicsplat_cli.artwork.geometry.outlines import points_at
from cubicsplat_cli.cli.bench import Markdown, print_report
from cubicsplat_cli.cli.options import Json, argument
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.images import TILE_PIXELS, Tile, tiles
from cubicsplat_cli.files.read import read_file
from cubicsplat_cli.formatting import mean, number, printable, text_table
from cubicsplat_cli.metrics import head
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.scene_reader import read_svg

CUSP = math.radians(150.0)  # radians
EDGES = 32  # of a segment, between whose directions turns are measured
SCALE = 12  # enlargement at which slivers are sought: a third of a px is then 4 px
_SHORTEST = 1e-3  # px: what is shorter has no direction, since files have two decimals
_MARGIN = 1  # px around a curve, or around the canvas, outside of which it is not looked at


@dataclass(frozen=True)
class Spikes:
    """cusps: turns by over 150 degrees. slivers: px^2 thinner than 1/3 px, each curve's times its opacity."""

    cusps: int
    slivers: float


def spikes_of(scene: Scene) -> Spikes:
    """Cusps and slivers of all curves as far as they lie on the canvas."""
    scene = scene.as_numpy()
    scene.validate()
    return Spikes(cusps_of(scene), sum(_slivers(scene, curve) for curve in range(scene.curves)))


def cusps_of(scene: Scene) -> int:
    """Turns of over 150 degrees, of outlines or of the centre lines of strokes, on the canvas."""
    return sum(_turns_back(line, scene) for curve in range(scene.curves) for line in _polylines(scene, curve))


def _polylines(scene: Scene, curve: int) -> Iterator[np.ndarray]:
    """(V, 2) px of each ring, its first vertex again at its end, or of the stroke."""
    for ring in scene.rings(curve):
        points = ring.astype(np.float64)
        if scene.mode is Mode.CLOSED:
            points = np.concatenate((points, points[:1]))
        cubics = np.stack([points[k : len(points) - 3 + k : 3] for k in range(4)], axis=1)
        yield np.concatenate((points_at(cubics, np.arange(EDGES) / EDGES).reshape(-1, 2), points[-1:]))


def _turns_back(line: np.ndarray, scene: Scene) -> int:
    edges = np.diff(line, axis=0)
    long = np.hypot(*edges.T) > _SHORTEST
    edges, at = edges[long], line[1:][long]
    if len(edges) < 2:
        return 0
    closed = scene.mode is Mode.CLOSED
    after = np.roll(edges, -1, axis=0) if closed else edges[1:]
    before, at = (edges, at) if closed else (edges[:-1], at[:-1])
    turn = np.abs(np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1)))
    shown = ((at >= 0) & (at <= (scene.width, scene.height))).all(axis=1)
    return int(((turn > CUSP) & shown).sum())


def _slivers(scene: Scene, curve: int) -> float:
    """px^2, times its opacity, of what no disc 1/3 px across that lies within the curve covers."""
    half_width, rings = float(scene.half_widths[curve]), scene.rings(curve)
    points, reach = np.concatenate(rings), half_width + _MARGIN
    low = np.maximum(np.floor(points.min(axis=0) - reach), -_MARGIN).astype(int)
    high = np.minimum(np.ceil(points.max(axis=0) + reach), (scene.width + _MARGIN, scene.height + _MARGIN))
    width, height = (int(side) - 2 * _MARGIN for side in high - low)
    if min(width, height) <= 0:
        return 0.0
    found = 0
    for tile in tiles(width, height, SCALE, TILE_PIXELS):
        part = Tile(tile.left + low[0], tile.top + low[1], tile.width + 2 * _MARGIN, tile.height + 2 * _MARGIN)
        inside = _drawn(rings, half_width, part)
        margin = slice(_MARGIN * SCALE, -_MARGIN * SCALE)
        found += int(np.count_nonzero((inside & ~opened(inside))[margin, margin]))
    return found / SCALE**2 * float(scene.opacities[curve])


def _drawn(rings: list[np.ndarray], half_width: float, part: Tile) -> np.ndarray:
    """(H, W) bool: the pixels whose middles lie in a curve, a stroke if it has a half-width, `SCALE` times as large."""
    cairo = importlib.import_module("cairosvg.surface").cairo
    surface = cairo.ImageSurface(cairo.FORMAT_A8, part.width * SCALE, part.height * SCALE)
    context = cairo.Context(surface)
    context.set_antialias(cairo.ANTIALIAS_NONE)
    context.scale(SCALE, SCALE)
    context.translate(-part.left, -part.top)
    for ring in rings:
        context.move_to(*ring[0])
        corners = ring[1:] if half_width else np.concatenate((ring[1:], ring[:1]))
        for first, second, end in corners.reshape(-1, 3, 2).tolist():
            context.curve_to(*first, *second, *end)
    if half_width:
        context.set_line_width(2 * half_width)
        context.set_line_cap(cairo.LINE_CAP_ROUND)
        context.set_line_join(cairo.LINE_JOIN_ROUND)
        context.stroke()
    else:
        context.fill()
    surface.flush()
    rows = np.frombuffer(surface.get_data(), np.uint8).reshape(surface.get_height(), surface.get_stride())
    return rows[:, : surface.get_width()] > 0


def opened(inside: np.ndarray) -> np.ndarray:
    """What discs 4 px across cover that lie within (H, W) bool: 4 x 4 px without their corners."""
    # A px is not covered where none of the discs around it lies within.
    return ~_fitting(np.pad(~_fitting(inside), 3, constant_values=True))


def _fitting(inside: np.ndarray) -> np.ndarray:
    """(H - 3, W - 3): whether the disc whose box begins at this pixel lies within."""
    two = inside[1:] & inside[:-1]
    two = two[:, 1:] & two[:, :-1]
    return two[1:-1, :-2] & two[1:-1, 2:] & two[:-2, 1:-1] & two[2:, 1:-1]


def spikes(
    files: Annotated[list[Path], argument("SVG...", "Files that the photo style wrote, .svg or .svgz.")],
    json: Json = False,
    markdown: Markdown = False,
) -> None:
    """Cusps and slivers of SVGs of the photo style.

    The flaws that show when a file is enlarged: turns by over 150 degrees, and parts thinner than a third of a pixel.
    """
    rows: list[dict[str, Any]] = []
    for path in files:
        try:
            scene = read_svg(read_file(path))
        except InputError as error:
            shown = printable(str(path))
            raise error if str(error).startswith(shown) else InputError(f"{shown}: {error}") from error
        rows.append({"file": path.name, "curves": scene.curves, **asdict(spikes_of(scene))})
    means = {name: mean(row[name] for row in rows) for name in ("curves", "cusps", "slivers")}
    table = [*rows, {"file": f"mean of {len(rows)}", **means}]
    cells = [
        [row["file"], *(number(row[n], 0) for n in ("curves", "cusps")), number(row["slivers"], 1)] for row in table
    ]
    text = text_table(("file", "curves", "cusps", "slivers px^2"), cells, markdown=markdown)
    print_report({**head(), "bench": "spikes", "means": means, "files": rows}, text, json=json)


if __name__ == "__main__":
    main(spikes)
