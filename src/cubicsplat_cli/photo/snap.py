"""Colours and opacities that renderers with 8 bits per channel can keep.

Most SVG renderers composite premultiplied 8-bit values. cairo truncates the opacity and the premultiplied colour of
a path to 8 bits, half a level too dark on average; over a dozen translucent layers that is the larger part of the
difference between the engine's picture and the file's (docs/lab/photos.md). So a finished scene gets opacities of
k / 255 and, per channel, the nearest 8-bit colour whose truncated premultiplied value is the rounded one.
"""

from __future__ import annotations

from dataclasses import replace

from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import Array, namespace
from cubicsplat_cli.scene.gradients import FLAT

LEVELS = 255
OPACITY_STEPS = 1000  # the file's opacities have three decimals
# cairo keeps the high byte of a 16-bit value: an opacity o becomes floor(o * 65535 / 256).
HIGH_BYTE = 65535 / 256
_ROUNDING = 1e-9


def snapped(scene: Scene) -> Scene:
    """The scene with colours and opacities on the grid that 8-bit renderers keep; everything else as it is."""
    xp = namespace(scene.points)
    levels = xp.round(xp.astype(scene.opacities, xp.float64) * LEVELS)
    colours = xp.astype(_colours(xp.astype(scene.colours, xp.float64), levels[:, None]), xp.float32)
    opacities = xp.astype(_opacities(levels), xp.float32)
    if scene.gradients is not None:
        # Renderers composite gradients in finer steps.
        flat = scene.gradients.kinds == FLAT
        opacities = xp.where(flat, opacities, scene.opacities)
        colours = xp.where(flat[:, None], colours, scene.colours)
    return replace(scene, opacities=opacities, colours=colours)


def _opacities(levels: Array) -> Array:
    """The file's opacity nearest to level / 255 that becomes this level in cairo; (N,) of 0..255."""
    xp = namespace(levels)
    nearest = xp.round(levels / LEVELS * OPACITY_STEPS)
    least = xp.ceil(levels / HIGH_BYTE * OPACITY_STEPS - _ROUNDING)
    most = xp.clip(xp.floor((levels + 1) / HIGH_BYTE * OPACITY_STEPS - _ROUNDING), max=OPACITY_STEPS)
    return xp.minimum(xp.maximum(nearest, least), most) / OPACITY_STEPS


def _colours(colours: Array, levels: Array) -> Array:
    """Colours (N, 3) for opacities of `levels` (N, 1) of 255."""
    xp = namespace(colours)
    nearest = xp.round(colours * LEVELS)
    premultiplied = xp.round(colours * levels)
    least = xp.ceil(premultiplied * LEVELS / xp.clip(levels, min=1.0) - _ROUNDING)
    return xp.clip(xp.maximum(nearest, least), max=LEVELS) / LEVELS
