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

from ..scene import Scene

LEVELS = 255
OPACITY_STEPS = 1000  # the file's opacities have three decimals
_ROUNDING = 1e-9


def settle(scene: Scene) -> Scene:
    """The scene with colours and opacities on the grid that 8-bit renderers keep; everything else as it is."""
    levels = (scene.opacities.double() * LEVELS).round()
    # Upwards to the file's decimals, so that truncation finds the level again.
    opacities = (levels / LEVELS * OPACITY_STEPS - _ROUNDING).ceil() / OPACITY_STEPS
    colours = _colours(scene.colours.double(), levels.unsqueeze(1))
    return replace(scene, opacities=opacities.float().clamp(0, 1), colours=colours.float())


def _colours(colours: Tensor, levels: Tensor) -> Tensor:
    """Colours (N, 3) for opacities of `levels` (N, 1) of 255."""
    nearest = (colours * LEVELS).round()
    premultiplied = (colours * levels).round()
    least = (premultiplied * LEVELS / levels.clamp(min=1) - _ROUNDING).ceil()
    return torch.maximum(nearest, least).clamp(max=LEVELS) / LEVELS
