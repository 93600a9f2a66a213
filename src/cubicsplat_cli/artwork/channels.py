"""Channels of pictures, the last axis of their arrays; what light their values stand for; blocks and windows."""

from __future__ import annotations

from functools import reduce

import numpy as np

FULL = 255.0  # levels of a channel that is whole
ROWS = 64  # of a picture, that are looked at in one go
LUMA = np.array([0.299, 0.587, 0.114])  # of red, green and blue, by Rec. 601


def largest(values: np.ndarray) -> np.ndarray:
    """(...) the largest of the channels of (..., C): numpy's own, of an axis so short, takes ten times as long."""
    return np.asarray(reduce(np.maximum, np.moveaxis(values, -1, 0)))


def summed(values: np.ndarray) -> np.ndarray:
    """(...) the sum of the channels of (..., C), as numpy's own to the last bit, in a third of its time."""
    return np.asarray(reduce(np.add, np.moveaxis(values, -1, 0)))


def packed(colours: np.ndarray) -> np.ndarray:
    """(...) int64 one number for each colour (..., C) of whole levels in 0..255."""
    return np.asarray(colours.astype(np.int64) @ (256 ** np.arange(colours.shape[-1])))


def light_of_srgb(values: np.ndarray) -> np.ndarray:
    """The linear light of sRGB values, both in [0, 1] (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def in_blocks(values: np.ndarray, side: int) -> np.ndarray:
    """(H // side, W // side, side, side, ...) the whole blocks of side x side px of values (H, W, ...)."""
    rows, columns = (length // side for length in values.shape[:2])
    part = values[: rows * side, : columns * side]
    return part.reshape(rows, side, columns, side, *values.shape[2:]).swapaxes(1, 2)


def widened(box: tuple[slice, ...], by: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """The rows and columns of a box, and so many px around it as far as pictures (H, W) of a shape go."""
    sides = zip(box, shape, strict=False)
    rows, columns = (slice(max(side.start - by, 0), min(side.stop + by, size)) for side, size in sides)
    return rows, columns


def blend_of(
    values: np.ndarray, first: np.ndarray, second: np.ndarray, *, most: float | None = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Colours (..., C) as blends of two others: the shares (...) of the second one, and what these leave (..., C).

    Shares lie from 0 to `most`, or, None, anywhere on the line through both. Where the two are alike shares are 0.
    """
    span, off = second - first, values - first
    share = summed(off * span) / np.maximum(summed(span * span), 1e-9)
    share = share if most is None else np.clip(share, 0.0, most)
    return share, off - share[..., None] * span
