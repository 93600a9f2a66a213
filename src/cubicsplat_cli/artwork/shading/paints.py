"""What shows of objects, and their base paints: flat, or the linear gradient that comes nearest to it."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.geometry.coverage import coverage
from cubicsplat_cli.artwork.geometry.outlines import pieces_of_rings
from cubicsplat_cli.artwork.gradients.shade import Ramp, Shade, gradient_of
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.raster.shades import Pixels, best_colours, colours_off
from cubicsplat_cli.scene.paint import Gradient, Rgba

ANGLES, STOPS = 16, 4
# Mean square in levels^2 that a gradient must be nearer than a flat fill, as nobody sees less, for each stop.
LEAST_GAIN = 4.0
FEWEST = 8  # px that a gradient is fitted to
FULL = 0.995  # of a pixel that a shape covers: all of it


def shown(drawing: Drawing) -> list[np.ndarray]:
    """For each shape, all opaque, (H, W) the share of each pixel that it covers and no shape above it does."""
    clear = np.ones((drawing.height, drawing.width))
    shares = []
    for shape in reversed(drawing.shapes):
        own = coverage(*pieces_of_rings(shape.oriented()), 0, 0, drawing.height, drawing.width)
        shares.append(own * clear)
        clear = clear * (1.0 - own)
    return shares[::-1]


def base_paint(values: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[Rgba, Gradient | None]:
    """The opaque fill nearest to pixels of straight colours (n, 3) in levels at columns x and rows y, n >= 1, and the
    gradient that is nearer, if one is.
    """
    middle = values.mean(axis=0)
    red, green, blue = (int(np.clip(round(v), 0, 255)) for v in middle.tolist())
    fill = (red, green, blue, 255)
    if len(x) < FEWEST:
        return fill, None
    opaque = np.concatenate([values, np.full((len(values), 1), 255.0)], axis=1)
    pixels = Pixels(x + 0.5, y + 0.5, opaque)
    shades = [_along(math.pi * k / ANGLES, stops, pixels) for k in range(ANGLES) for stops in (2, STOPS)]
    flat = float(((values - middle) ** 2).mean())
    costs = [_misfit(shade, pixels) + LEAST_GAIN * len(shade.ramp.knots) for shade in shades]
    best = int(np.argmin(costs))
    return fill, gradient_of(shades[best]) if costs[best] < flat else None


def _along(angle: float, stops: int, pixels: Pixels) -> Shade:
    """The gradient in one direction with so many stops, evenly between the pixels' ends."""
    frame = np.array([[math.cos(angle), math.sin(angle), 0.0], [0.0, 0.0, 0.0]])
    t = frame[0, 0] * pixels.x + frame[0, 1] * pixels.y
    knots = np.linspace(float(t.min()), float(t.max()) + 1e-3, stops)
    colours = np.clip(best_colours(frame, False, knots, pixels), 0.0, 255.0)
    colours[:, 3] = 255.0
    return Shade(frame, False, Ramp(knots, colours), 2)


def _misfit(shade: Shade, pixels: Pixels) -> float:
    """The mean square in levels^2 of three channels."""
    off = colours_off(shade.frame, False, shade.ramp.knots, shade.ramp.colours, pixels)
    return float((off[:, :3] ** 2).mean())
