"""Weights of a picture's pixels: a grey mask, and a rectangle in focus."""

from __future__ import annotations

import numpy as np
from PIL import Image

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.load import Picture, PictureLike, as_picture
from cubicsplat_cli.options import Focus
from cubicsplat_cli.record import record
from cubicsplat_cli.settings import MAX_PIXELS

GREY = np.array([0.2126, 0.7152, 0.0722], np.float32)  # shares of the channels in a mask's brightness


@record
class Mask:
    """A picture's brightness (H, W), float32 in [0, 1], not all 0: the weights of the pixels of another picture."""

    grey: np.ndarray
    name: str
    sha256: str


def load_mask(source: PictureLike, *, max_pixels: int = MAX_PIXELS) -> Mask:
    """Load a mask from any picture; transparent pixels count as black. Raises InputError if all is black."""
    picture = as_picture(source, max_pixels=max_pixels)
    grey = np.ascontiguousarray(picture.premultiplied()[..., :3] @ GREY)
    if not grey.max() > 0.0:
        raise InputError(f"{picture.source}: the mask is all black; paint white what matters")
    return Mask(grey, picture.source, picture.sha256)


def pixel_weights(picture: Picture, mask: Mask | None, focus: Focus | None, full: tuple[int, int]) -> np.ndarray | None:
    """Return the weights (H, W) float32 of a picture's pixels, of mean 1; None if all weigh the same.

    full: width and height, in px, of the full picture if this one is a smaller copy; the focus is in its px. A mask is
    scaled to the picture. Raises InputError for a mask of another shape, a focus outside the picture, or weights of 0
    everywhere.
    """
    if mask is None and focus is None:
        return None
    weights = np.ones((picture.height, picture.width), np.float32)
    if mask is not None:
        weights *= _scaled(mask, picture, full)
    if focus is not None:
        weights *= 1.0 + (focus.factor - 1.0) * _inside(focus, picture, full)
    mean = float(weights.mean(dtype=np.float64))
    if not mean > 0.0:
        raise InputError(f"{picture.source}: the mask leaves nothing of the picture that matters")
    return weights / np.float32(mean)


def _scaled(mask: Mask, picture: Picture, full: tuple[int, int]) -> np.ndarray:
    """Return the mask at the size of the picture."""
    height, width = mask.grey.shape
    # Pictures that were scaled down have sides of whole pixels, so the shapes may differ by a percent.
    if abs(width * picture.height / (height * picture.width) - 1.0) > 0.01:
        misfit = f"which the mask {mask.name} with {width} x {height} does not fit; give one of the same shape"
        raise InputError(f"{picture.source}: has {full[0]} x {full[1]} pixels, {misfit}")
    image = Image.fromarray(mask.grey).resize((picture.width, picture.height), Image.Resampling.BILINEAR)
    return np.clip(np.asarray(image), 0.0, 1.0)


def _inside(focus: Focus, picture: Picture, full: tuple[int, int]) -> np.ndarray:
    """Return the share (H, W) of each pixel that lies in the rectangle."""
    across = _covered(focus.left, focus.width, full[0], picture.width)
    down = _covered(focus.top, focus.height, full[1], picture.height)
    if not (across.any() and down.any()):
        text = f"{picture.source}: the focus lies outside of its {full[0]} x {full[1]} pixels"
        raise InputError(f"{text}; give a rectangle within")
    return down[:, None] * across


def _covered(start: float, length: float, full: int, pixels: int) -> np.ndarray:
    """Return the share of each pixel of one axis that lies in a span. start, length: px of the full size."""
    scale = pixels / full
    left = np.arange(pixels)
    overlap = np.minimum(left + 1, (start + length) * scale) - np.maximum(left, start * scale)
    return np.clip(overlap, 0.0, 1.0).astype(np.float32)
