"""What each curve takes in a file."""

from __future__ import annotations

from xml.etree import ElementTree

from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.paint import Gradient
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.gradients import gradient_element
from cubicsplat_cli.svg.gridgradients import gradient_decimals
from cubicsplat_cli.svg.pathdata import path_strings
from cubicsplat_cli.svg.quantise import to_grid

# Bytes of a path beside its data: its tag, colour and width; and its opacity, where that is not said for all at once.
MARKUP = {Mode.CLOSED: 28, Mode.OPEN: 50}
OPACITY_MARKUP = {Mode.CLOSED: 20, Mode.OPEN: 22}
# Those of a gradient beside what `gradient_element` writes: its name, twice, and transform in place of its units.
GRADIENT_MARKUP = 34


def bytes_by_curve(scene: Scene, precision: int) -> list[int]:
    """Bytes of each curve's path and gradient, uncompressed, coordinates with `precision` decimals of a px."""
    grid = to_grid(scene, precision)
    paths = path_strings(grid.points, grid.ring_ends, closed=scene.mode is Mode.CLOSED)
    gradients = grid.gradients or [None] * scene.curves
    markup = MARKUP[scene.mode] + (0 if grid.one_opacity else OPACITY_MARKUP[scene.mode])
    return [
        markup + len(data) + _of_gradient(gradient, precision) for data, gradient in zip(paths, gradients, strict=True)
    ]


def _of_gradient(gradient: Gradient | None, precision: int) -> int:
    if gradient is None:
        return 0
    element = gradient_element(gradient, gradient_decimals(precision))
    return GRADIENT_MARKUP + len(ElementTree.tostring(element))
