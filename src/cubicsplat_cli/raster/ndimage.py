"""The functions of scipy.ndimage that drawings need, natively: with its names, arguments and results.

It takes half a second to import scipy.ndimage, as long as a small drawing takes. Arrays are pictures (H, W) or
(H, W, C), or lines; masks may be of any type, and are true if not 0. scipy has no alike, ranges, before_enlarging,
large_parts, renumbered, skeletonize, holes_of and reached.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from ctypes import c_int64
from functools import partial
from typing import Any

import numpy as np

from cubicsplat_cli.raster.native import Out, bools, doubles, int32s, native

_native = partial(native, "filters")
# The numbers that kernels/cpu/line_filters.cpp has for them.
_SMALLEST, _LARGEST, _MEAN, _SUM = range(4)
_FLOATS = {np.dtype(np.float32): 3, np.dtype(np.float64): 4}
_NUMBERS = {np.dtype(t): k for t, k in ((bool, 0), (np.uint8, 0), (np.int32, 1), (np.int64, 2))} | _FLOATS
_MODES = ("reflect", "nearest", "constant")
_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=bool)
SQUARE = np.ones((3, 3), dtype=bool)  # the structure of a pixel and the eight around it


def maximum_filter(values: np.ndarray, size: int | Sequence[int], *, mode: str = "reflect") -> np.ndarray:
    """Return the largest of the neighbours in a box of `size` (for all axes or each), of which size // 2 come before.

    values: bools, uint8, int32, int64 or floats. mode: the values beyond the ends: "reflect" (c b a | a b c | c b a),
    "nearest" (a a a | a b c | c c c) or "constant", which is 0.
    """
    return _filtered(_LARGEST, values, _boxes(size, values.ndim), mode)


def minimum_filter(values: np.ndarray, size: int | Sequence[int], *, mode: str = "reflect") -> np.ndarray:
    """Return the smallest of the neighbours in a box; see maximum_filter."""
    return _filtered(_SMALLEST, values, _boxes(size, values.ndim), mode)


def alike(values: np.ndarray, size: int | Sequence[int]) -> np.ndarray:
    """Return (H, W) bool: true if all neighbours in a box, see maximum_filter, have one value."""
    return np.asarray(maximum_filter(values, size) == minimum_filter(values, size))


def ranges(values: np.ndarray, size: int | Sequence[int]) -> np.ndarray:
    """Return the largest of the neighbours in a box, see maximum_filter, less the smallest."""
    return maximum_filter(values, size) - minimum_filter(values, size)


def uniform_filter(values: np.ndarray, size: int | Sequence[int], *, mode: str = "reflect") -> np.ndarray:
    """Return the mean of the neighbours in a box, of floats and in their type; see maximum_filter."""
    return _filtered(_MEAN, values, _boxes(size, values.ndim), mode)


def correlate1d(values: np.ndarray, weights: np.ndarray, axis: int = -1, *, mode: str = "reflect") -> np.ndarray:
    """Return the sum of neighbours along an axis times weights (n,), of floats, in their type; see maximum_filter."""
    return _filtered(_SUM, values, [(axis, len(weights), weights)], mode)


def gaussian_filter(
    values: np.ndarray, sigma: float | Sequence[float], *, mode: str = "reflect", truncate: float = 4.0
) -> np.ndarray:
    """Blur floats by a Gaussian, in their type. sigma: px, along all axes or along each, 0 for none; truncate: sigmas
    beyond which it is cut off; mode: see maximum_filter."""
    windows = []
    for axis, width in enumerate(np.broadcast_to(sigma, values.ndim).tolist()):
        if width > 0.0:
            reach = int(truncate * width + 0.5)
            weights = np.exp(-0.5 / (width * width) * np.arange(-reach, reach + 1) ** 2)
            windows.append((axis, len(weights), weights / weights.sum()))
    return _filtered(_SUM, values, windows, mode)


def before_enlarging(
    lines: np.ndarray, length: int, first: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (length, ...) whole levels, 0 to 255, that are nearest to lines (n, ...) once they are enlarged; and (n,
    ...) these. Values that enlarging takes beyond an end of the scale are clipped there; six rounds find them. first:
    (n,) the first of six rows that each line holds; weights: (n, 6) of these, 0 for those that there are not."""
    columns, shape = lines[0].size, lines.shape[1:]
    given = len(lines), length, columns, int32s(first), doubles(weights), doubles(lines)
    return _native("cs_before_enlarging", *given, Out((length, *shape)), Out(lines.shape))


def label(pixels: np.ndarray, structure: np.ndarray | None = None) -> tuple[np.ndarray, int]:
    """Return the parts of a mask (H, W), numbered (H, W) int32 from 1 on in the order of their first pixels, and their
    number. structure: (3, 3); if its corners are set, pixels also touch diagonally.
    """
    labels = np.empty(pixels.shape, np.int32)
    return labels, _native("cs_label", *pixels.shape, _mask(pixels), _diagonally(structure), labels, result=c_int64)


def large_parts(pixels: np.ndarray, least: int) -> tuple[np.ndarray, int]:
    """Return the same for parts of at least so many pixels, as of `renumbered`."""
    labels, count = label(pixels)
    return renumbered(labels, np.bincount(labels.ravel(), minlength=count + 1) >= least)


def renumbered(labels: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, int]:
    """Return labels (H, W) int32 of the parts kept (count + 1,) bool, from 1 on and 0 elsewhere, and their count."""
    kept = kept & (np.arange(len(kept)) > 0)
    return (np.cumsum(kept, dtype=np.int32) * kept)[labels], int(kept.sum())


def find_objects(labels: np.ndarray, max_label: int = 0) -> list[Any]:
    """Return the least box around the pixels of each label from 1 to the largest in (H, W) integers, or to max_label:
    the slices of its rows and columns, None for a label without pixels."""
    labels = np.ascontiguousarray(labels, dtype=np.int64 if labels.dtype == np.int64 else np.int32)
    out = Out((max_label or max(0, int(labels.max(initial=0))), 4), np.int64)
    boxes = _native("cs_boxes", *labels.shape, labels, labels.dtype == np.int64, len(out.array), out, result=None)
    return [(slice(y, bottom), slice(x, right)) if bottom else None for y, x, bottom, right in boxes.tolist()]


def binary_dilation(
    pixels: np.ndarray, structure: np.ndarray | None = None, iterations: int = 1, mask: np.ndarray | None = None
) -> np.ndarray:
    """Return (H, W) bool: a mask, with the neighbours of its pixels in a structure (h, w) of odd sides, by default the
    neighbours along edges; `iterations` times. mask: pixels that may change."""
    return _dilated(_mask(pixels), _structure(structure)[::-1, ::-1], iterations, mask, False)


def binary_erosion(
    pixels: np.ndarray, structure: np.ndarray | None = None, iterations: int = 1, *, border_value: int = 0
) -> np.ndarray:
    """Return (H, W) bool: the pixels of a mask whose neighbours in a structure are in it too; see binary_dilation.
    border_value: the mask beyond the picture."""
    return ~_dilated(~_mask(pixels), _structure(structure), iterations, None, not border_value)


def binary_opening(pixels: np.ndarray, structure: np.ndarray | None = None) -> np.ndarray:
    """Return (H, W) bool: the part of a mask that structures within it cover; see binary_dilation."""
    return binary_dilation(binary_erosion(pixels, structure), structure)


def skeletonize(pixels: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: a mask's skeleton, one pixel wide, with its holes and parts, which touch diagonally too."""
    thinned = np.pad(_mask(pixels), 1)
    _native("cs_thin", *thinned.shape, thinned)
    return thinned[1:-1, 1:-1]


def binary_propagation(pixels: np.ndarray, structure: np.ndarray | None, mask: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: the pixels, with those linked to them through a mask; structure: see label."""
    pixels = _mask(pixels)
    given = pixels, _mask(pixels | mask), _diagonally(structure)
    return _native("cs_propagate", *pixels.shape, *given, Out(pixels.shape, bool))


def binary_fill_holes(pixels: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: a mask, with the pixels that it encloses; see holes_of."""
    mask = _mask(pixels)
    return mask | holes_of(mask)


def holes_of(mask: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: the pixels that a mask encloses and that are not in it, connected along their sides."""
    return _enclosed(~bools(mask))


def reached(shown: np.ndarray, above: np.ndarray, hull: np.ndarray | None, steps: int) -> np.ndarray:
    """Return (H, W) bool: the mask `shown`; the pixels of `above` within so many steps along rows and columns of it, or
    in `hull`, None for none; and the holes in all this that lie wholly in `above`.
    """
    shown, above = bools(shown), bools(above)
    near = binary_dilation(shown, iterations=steps)
    out = shown | above & (near if hull is None else near | bools(hull))
    return out | _enclosed(~out, ~above)


def distance_transform_edt(pixels: np.ndarray) -> np.ndarray:
    """Return (H, W) px: the distance of each pixel to the nearest that is 0; inf if there is none."""
    return _native("cs_distances", *pixels.shape, _mask(pixels), Out(pixels.shape))


def distance_transform_cdt(pixels: np.ndarray) -> np.ndarray:
    """Return the same by the larger of the distances along rows and columns, int32; -1 if no pixel is 0."""
    return _native("cs_chessboard", *pixels.shape, _mask(pixels), Out(pixels.shape, np.int32), result=None)


def maximum(values: np.ndarray, labels: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return (n,): the largest of the floats (H, W) with each label >= 0 in index (n,); 0 for one without pixels."""
    count = int(max(labels.max(initial=0), index.max(initial=0))) + 1
    largest = np.full(count, -np.inf, values.dtype)
    np.maximum.at(largest, labels.ravel(), values.ravel())
    return np.where(np.bincount(labels.ravel(), minlength=count) > 0, largest, 0)[index]


def center_of_mass(values: np.ndarray, labels: np.ndarray, index: np.ndarray) -> list[tuple[float, float]]:
    """Return the mean y and x, weighted by values (H, W), of the pixels with each label >= 0 in index (n,)."""
    y, x = np.nonzero(values)
    own, weights = labels[y, x], values[y, x].astype(float)
    count = int(index.max(initial=0)) + 1
    mass, down, across = (np.bincount(own, weights * at, count)[index] for at in (1.0, y, x))
    return [*zip((down / mass).tolist(), (across / mass).tolist(), strict=True)]


# A window of a filter along a line: its axis, its size, and its weights if it has any.
_Window = tuple[int, int, "np.ndarray | None"]


def _boxes(size: int | Sequence[int], count: int) -> Iterable[_Window]:
    return [(axis, side, None) for axis, side in enumerate(np.broadcast_to(size, count).tolist())]


def _filtered(operation: int, values: np.ndarray, windows: Iterable[_Window], mode: str) -> np.ndarray:
    out = np.array(values, order="C")
    kinds = _NUMBERS if operation in (_SMALLEST, _LARGEST) else _FLOATS
    if out.dtype not in kinds:
        raise TypeError(f"there is no such filter of {out.dtype}, but of {', '.join(str(each) for each in kinds)}")
    if mode not in _MODES:
        raise ValueError(f"there is no mode {mode!r}, but {', '.join(_MODES)}")
    for axis, size, weights in windows:
        if size < 1:
            raise ValueError(f"there are no {size} neighbours; the least size is 1")
        if out.size and (size > 1 or weights is not None):
            shape = math.prod(out.shape[:axis]), out.shape[axis], math.prod(out.shape[axis:][1:])
            given = operation, kinds[out.dtype], _MODES.index(mode), *shape, size // 2, (size - 1) // 2
            _native("cs_filter_lines", *given, None if weights is None else doubles(weights), out)
    return out


def _enclosed(pixels: np.ndarray, outside: np.ndarray | None = None) -> np.ndarray:
    """Return (H, W) bool: the parts of a mask that reach neither the border nor the pixels `outside`, None for none."""
    opened = np.zeros(pixels.shape, dtype=bool) if outside is None else outside.copy()
    opened[:1] = opened[-1:] = opened[:, :1] = opened[:, -1:] = True
    return pixels & ~binary_propagation(opened & pixels, None, pixels)


def _mask(pixels: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(pixels if pixels.dtype == bool else pixels != 0)


def _diagonally(structure: np.ndarray | None) -> bool:
    return structure is not None and bool(structure[0, 0])


def _structure(structure: np.ndarray | None) -> np.ndarray:
    structure = _CROSS if structure is None else np.asarray(structure, dtype=bool)
    if not (structure.shape[0] % 2 and structure.shape[1] % 2):
        raise ValueError(f"a structure has odd sides, not {structure.shape}")
    return structure


def _dilated(
    mask: np.ndarray, structure: np.ndarray, iterations: int, where: np.ndarray | None, border: bool
) -> np.ndarray:
    if iterations < 1:
        raise ValueError(f"nothing is dilated {iterations} times; the least is 1")
    where, (high, wide) = None if where is None else _mask(where), (side // 2 for side in structure.shape)
    given = *mask.shape, mask, high, wide, bools(structure), where, iterations, border
    return _native("cs_dilate", *given, Out(mask.shape, bool))
