"""The shadow of things of any outline in even, translucent shapes, each within the one before, a step darker."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Outline
from cubicsplat_cli.artwork.layers.completion import outlines_of
from cubicsplat_cli.artwork.layers.extents import extents_of
from cubicsplat_cli.artwork.regions.sampling import share_positions
from cubicsplat_cli.artwork.shapes import Shape

# Levels of each step, of which half is the most by which a shadow is off. Renderers round after each translucent shape,
# so more of them are no nearer; but steps that are farther apart than so many px are seen, if they are not small.
STEPS, APART = (2, 6), 2.0
OFF = 1.0  # level that an outline may be off


def contoured(
    share: np.ndarray, shown: np.ndarray, colour: np.ndarray, ground: np.ndarray | None, name: str
) -> Iterator[Shape]:
    """The shapes of a shadow, back to front: opaque ones where all lies on one opaque ground, so that nothing is lost
    by rounding. share: (H, W) how much it darkens; shown: (H, W) bool where it is seen; colour, ground: (3,) levels.
    """
    whole = 255.0 if ground is None else float(np.abs(colour - ground).max())  # levels of a whole shade
    levels = whole * share
    slope = np.maximum(np.hypot(*np.gradient(levels)), 1e-3)
    values, slopes = levels[shown], slope[shown]
    most, error = float(values.max()), 255.0 * OFF / float(slopes.max())
    dark = 0.0
    while dark < most:
        near = np.abs(values - dark - STEPS[0]) < STEPS[0]
        step = int(np.clip(APART * np.median(slopes[near]), *STEPS)) if near.any() else STEPS[1]
        darker = dark + (step if ground is not None else (whole - dark) * step / whole)
        own = colour if ground is None else ground + min(darker / whole, 1.0) * (colour - ground)
        red, green, blue = (round(float(v)) for v in own)
        for outlines in _outlines(0.5 + (levels - 0.5 * (dark + darker)) / slope, error):
            yield Shape((red, green, blue, step if ground is None else 255), outlines, name)
        dark = darker


def _outlines(part: np.ndarray, error: float) -> Iterator[tuple[Outline, ...]]:
    """The outlines of the parts of what covers so much of each pixel (H, W), beyond 0..1 wholly, to an error in
    levels.
    """
    cover = part >= 0.5
    found = share_positions(np.clip(part, 0.0, 1.0), cover, error)
    if cover.any():
        for extent in extents_of(cover, np.zeros_like(cover), found):
            yield outlines_of(extent, cover.shape, 1.0)
