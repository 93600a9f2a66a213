"""What each curve takes in a file."""

from __future__ import annotations

from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.pathdata import path_strings
from cubicsplat_cli.svg.quantise import to_grid

# Bytes of a path beside its data: its tag, colour, opacity and width.
MARKUP = {Mode.CLOSED: 36, Mode.OPEN: 66}


def bytes_by_curve(scene: Scene, precision: int) -> list[int]:
    """Bytes of each curve's path, uncompressed, coordinates with `precision` decimals of a px."""
    grid = to_grid(scene, precision)
    return [
        MARKUP[scene.mode] + len(data)
        for data in path_strings(grid.points, grid.ring_ends, closed=scene.mode is Mode.CLOSED)
    ]
