"""Scans of pen drawings made by program: uneven light on noisy, slightly tinted paper, soft edges, JPEG."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image
from scipy import ndimage
from stroke_icons import Pen, svg_of

from cubicsplat_cli.evaluate.rerender import rerender

PAPER = np.array([244.0, 240.0, 229.0])  # levels


def scan_of(
    pens: list[Pen],
    side: int,
    *,
    seed: int = 1,
    texture: float = 5.0,
    light: float = 0.15,
    blur: float = 1.0,
    quality: int | None = 85,
) -> np.ndarray:
    """(side, side, 3) uint8: an icon of SIZE px drawn on paper and scanned.

    texture: levels, the standard deviation of what the paper is uneven by, alike over 1.5 px; light: how much darker
    the far corner is, and half as much all corners; blur: standard deviation in px; quality: of the JPEG, or None.
    """
    drawn = rerender(svg_of(pens).encode(), side, side).pixels[..., :3].astype(float) / 255.0
    soft = ndimage.gaussian_filter(drawn, (blur, blur, 0.0), mode="nearest")
    y, x = np.mgrid[:side, :side] / (side - 1.0)
    shade = 1.0 - light * (0.6 * x + 0.4 * y) - 0.5 * light * ((2.0 * x - 1.0) ** 2 + (2.0 * y - 1.0) ** 2) / 2.0
    grain = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(side, side)), 1.5)
    rough = soft * PAPER * shade[..., None] + texture * (grain / grain.std())[..., None]
    picture = np.clip(np.rint(rough), 0.0, 255.0).astype(np.uint8)
    if quality is None:
        return picture
    with io.BytesIO() as file:
        Image.fromarray(picture).save(file, "JPEG", quality=quality)
        return np.array(Image.open(file))


def target_of(pixels: np.ndarray) -> np.ndarray:
    """Levels as the artwork style takes them, float32 in [0, 1]."""
    return pixels.astype(np.float32) / np.float32(255.0)


def scaled_pens(pens: list[Pen], width: float) -> list[Pen]:
    """The same lines with pens of a width, in px of the icon."""
    return [Pen(pen.d, width, pen.cap, pen.join) for pen in pens]
