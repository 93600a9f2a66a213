"""Colours and opacities that renderers with 8 bits per channel can keep.

Most SVG renderers composite premultiplied 8-bit values. cairo truncates the opacity and the premultiplied colour of
a path to 8 bits, half a level too dark on average; over a dozen translucent layers that is the larger part of the
difference between the engine's picture and the file's (docs/quality.md). So a finished scene gets opacities of k / 255
and, per channel, the nearest 8-bit colour whose truncated premultiplied value is the rounded one.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from cubicsplat_cli.gradients import FLAT
from cubicsplat_cli.scene import Scene

LEVELS = 255
OPACITY_STEPS = 1000  # the file's opacities have three decimals
# cairo keeps the high byte of a 16-bit value: an opacity o becomes floor(o * 65535 / 256).
HIGH_BYTE = 65535 / 256
_ROUNDING = 1e-9


def snapped(scene: Scene) -> Scene:
    """The scene with colours and opacities on the grid that 8-bit renderers keep; everything else as it is."""
    levels = (scene.opacities.double() * LEVELS).round()
    colours = _colours(scene.colours.double(), levels.unsqueeze(1)).float()
    opacities = _opacities(levels).float()
    if scene.gradients is not None:
        # Renderers composite gradients in finer steps.
        flat = scene.gradients.kinds == FLAT
        opacities = torch.where(flat, opacities, scene.opacities)
        colours = torch.where(flat.unsqueeze(1), colours, scene.colours)
    return replace(scene, opacities=opacities, colours=colours)


def _opacities(levels: Tensor) -> Tensor:
    """The file's opacity nearest to level / 255 that becomes this level in cairo; (N,) of 0..255."""
    nearest = (levels / LEVELS * OPACITY_STEPS).round()
    least = (levels / HIGH_BYTE * OPACITY_STEPS - _ROUNDING).ceil()
    most = ((levels + 1) / HIGH_BYTE * OPACITY_STEPS - _ROUNDING).floor().clamp(max=OPACITY_STEPS)
    return nearest.maximum(least).minimum(most) / OPACITY_STEPS


def _colours(colours: Tensor, levels: Tensor) -> Tensor:
    """Colours (N, 3) for opacities of `levels` (N, 1) of 255."""
    nearest = (colours * LEVELS).round()
    premultiplied = (colours * levels).round()
    least = (premultiplied * LEVELS / levels.clamp(min=1) - _ROUNDING).ceil()
    return torch.maximum(nearest, least).clamp(max=LEVELS) / LEVELS
