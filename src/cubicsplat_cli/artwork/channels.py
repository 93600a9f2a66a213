"""Channels of pictures (the last axis of their arrays), their linear light, and blocks and windows of pixels."""

from __future__ import annotations

from functools import reduce

import numpy as np

FULL = 255.0  # levels, the most of a channel
ROWS = 64  # of a picture that are read at a time
LUMA = np.array([0.299, 0.587, 0.114])  # of red, green and blue, by Rec. 601


def largest(values: np.ndarray) -> np.ndarray:
    """Return the largest channel of (..., C): numpy's own reduction takes ten times as long for so short an axis."""
    return np.asarray(reduce(np.maximum, np.moveaxis(values, -1, 0)))


def summed(values: np.ndarray) -> np.ndarray:
    """Return the sum of the channels of (..., C), equal to numpy's to the last bit, in a third of its time."""
    return np.asarray(reduce(np.add, np.moveaxis(values, -1, 0)))


def packed(colours: np.ndarray) -> np.ndarray:
    """Return one int64 number (...) for each colour (..., C) of whole levels in 0..255."""
    return np.asarray(colours.astype(np.int64) @ (256 ** np.arange(colours.shape[-1])))


def are_few(numbers: np.ndarray, most: int) -> bool:
    """Return True if there are at most so many different numbers (H, W). Some rows tell of most pictures."""
    return all(len(np.unique(some)) <= most for some in (numbers[::16], numbers))


def unpacked(numbers: np.ndarray) -> np.ndarray:
    """Return the colours (n, 4) of the numbers (n,) that `packed` gives them, float64."""
    return np.asarray(numbers[:, None] // 256 ** np.arange(4) % 256, dtype=np.float64)


def commonest(colours: np.ndarray, most: int, fewest: float) -> np.ndarray:
    """Return the commonest of the colours (n, C) of pixels, at most so many, each of at least `fewest` pixels."""
    _, first, counts = np.unique(packed(colours), return_index=True, return_counts=True)
    order = np.argsort(-counts, kind="stable")[:most]
    return colours[first[order[counts[order] >= fewest]]]


def light_of_srgb(values: np.ndarray) -> np.ndarray:
    """Return the linear light of sRGB values, both in [0, 1] (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def in_blocks(values: np.ndarray, side: int) -> np.ndarray:
    """Return the whole blocks of side x side px of values (H, W, ...): (H // side, W // side, side, side, ...)."""
    rows, columns = (length // side for length in values.shape[:2])
    part = values[: rows * side, : columns * side]
    return part.reshape(rows, side, columns, side, *values.shape[2:]).swapaxes(1, 2)


def widened(box: tuple[slice, ...], by: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the rows and columns of a box widened by `by` px, within pictures of shape (H, W)."""
    sides = zip(box, shape, strict=False)
    rows, columns = (slice(max(side.start - by, 0), min(side.stop + by, size)) for side, size in sides)
    return rows, columns


def blend_of(
    values: np.ndarray, first: np.ndarray, second: np.ndarray, *, most: float | None = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return colours (..., C) as blends of two others: the shares (...) of the second, and the errors (..., C). Shares
    lie from 0 to `most`; with None, anywhere on the line through both. They are 0 if the two are alike.
    """
    span, off = second - first, values - first
    share = summed(off * span) / np.maximum(summed(span * span), 1e-9)
    share = share if most is None else np.clip(share, 0.0, most)
    return share, off - share[..., None] * span
