"""The functions of scipy.ndimage that drawings need, natively: with its names, arguments and results.

It takes half a second to import scipy.ndimage, as long as a small drawing takes. Arrays are pictures (H, W) or
(H, W, C), or lines. All raise EngineError where the native library or the memory is missing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from ctypes import c_int64
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from cubicsplat_cli.raster.cpu import bools, doubles, native

_native = partial(native, "filters")
_Line: TypeAlias = "tuple[int, int, int, np.ndarray | None]"  # an axis, the neighbours before and after, and weights
# The numbers that kernels/cpu/line_filters.cpp has for them.
_SMALLEST, _LARGEST, _MEAN, _SUM = range(4)
_FLOATS = {np.dtype(np.float32): 3, np.dtype(np.float64): 4}
_NUMBERS = {np.dtype(t): k for t, k in ((bool, 0), (np.uint8, 0), (np.int32, 1), (np.int64, 2))} | _FLOATS
_MODES = ("reflect", "nearest", "constant")
_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=bool)
SQUARE = np.ones((3, 3), dtype=bool)  # the structure of a pixel and the eight around it


def maximum_filter(values: np.ndarray, size: int | Sequence[int], *, mode: str = "reflect") -> np.ndarray:
    """The largest of the neighbours in a box, `size` along all axes or along each, of which size // 2 come before.

    values: bools, uint8, int32, int64 or floats. mode: what lies beyond the ends: "reflect" (c b a | a b c | c b a),
    "nearest" (a a a | a b c | c c c) or "constant", which is 0.
    """
    return _filtered(_LARGEST, values, _boxes(size, values.ndim), mode)


def minimum_filter(values: np.ndarray, size: int | Sequence[int], *, mode: str = "reflect") -> np.ndarray:
    """The smallest of the neighbours in a box; see maximum_filter."""
    return _filtered(_SMALLEST, values, _boxes(size, values.ndim), mode)


def alike(values: np.ndarray, size: int | Sequence[int]) -> np.ndarray:
    """(H, W) bool: whether all neighbours in a box, see maximum_filter, have one value. None of scipy's."""
    return np.asarray(maximum_filter(values, size) == minimum_filter(values, size))


def uniform_filter(values: np.ndarray, size: int | Sequence[int], *, mode: str = "reflect") -> np.ndarray:
    """The mean of the neighbours in a box, of floats and in their type; see maximum_filter."""
    return _filtered(_MEAN, values, _boxes(size, values.ndim), mode)


def correlate1d(values: np.ndarray, weights: np.ndarray, axis: int = -1, *, mode: str = "reflect") -> np.ndarray:
    """The sum of the neighbours along an axis times weights (n,), of floats and in their type; see maximum_filter."""
    return _filtered(_SUM, values, [_weighted(weights, axis)], mode)


def gaussian_filter(
    values: np.ndarray, sigma: float | Sequence[float], *, mode: str = "reflect", truncate: float = 4.0
) -> np.ndarray:
    """Floats through a Gaussian, in their type. sigma: px, along all axes or along each, 0 for none; truncate: sigmas
    beyond which it is cut off; mode: see maximum_filter."""
    wide = [(own, axis) for own, axis in _per_axis(sigma, values.ndim) if own > 0.0]
    return _filtered(_SUM, values, [_weighted(_gaussian(own, truncate), axis) for own, axis in wide], mode)


def label(pixels: np.ndarray, structure: np.ndarray | None = None) -> tuple[np.ndarray, int]:
    """The parts of what is not 0 in (H, W), numbered (H, W) int32 from 1 on in the order of their first pixels, and how
    many there are. structure: (3, 3), whose corners are set where pixels touch diagonally too, as they do not without.
    """
    mask = _mask(pixels)
    found = np.empty(mask.shape, np.int32)
    diagonally = structure is not None and bool(structure[0, 0])
    return found, _native("cs_label", *mask.shape, mask, diagonally, found, result=c_int64)


def large_parts(pixels: np.ndarray, least: int) -> tuple[np.ndarray, int]:
    """The same of at least so many pixels, numbered (H, W) int32 from 1 on, 0 elsewhere. None of scipy's."""
    labels, count = label(pixels)
    kept = np.bincount(labels.ravel(), minlength=count + 1) >= least
    kept[0] = False
    return (np.cumsum(kept, dtype=np.int32) * kept)[labels], int(kept.sum())


def find_objects(labels: np.ndarray, max_label: int = 0) -> list[Any]:
    """The least box around the pixels of each label from 1 to the largest in (H, W) integers, or to max_label: the
    slices of its rows and columns, None where there are none."""
    labels = np.ascontiguousarray(labels, dtype=np.int64 if labels.dtype == np.int64 else np.int32)
    boxes = np.empty((max_label or max(0, int(labels.max(initial=0))), 4), np.int64)
    _native("cs_boxes", *labels.shape, labels, labels.dtype == np.int64, len(boxes), boxes, result=None)
    return [(slice(y, bottom), slice(x, right)) if bottom else None for y, x, bottom, right in boxes.tolist()]


def binary_dilation(
    pixels: np.ndarray, structure: np.ndarray | None = None, iterations: int = 1, mask: np.ndarray | None = None
) -> np.ndarray:
    """(H, W) bool: pixels that are not 0, with their neighbours in a structure (h, w) of odd sides, by default those
    along edges; `iterations` times. mask: which pixels may change."""
    return _dilated(_mask(pixels), _structure(structure)[::-1, ::-1], iterations, mask, False)


def binary_erosion(
    pixels: np.ndarray, structure: np.ndarray | None = None, iterations: int = 1, *, border_value: int = 0
) -> np.ndarray:
    """(H, W) bool: pixels that are not 0, and whose neighbours in a structure are not either; see binary_dilation.

    border_value: what lies beyond the picture.
    """
    return ~_dilated(~_mask(pixels), _structure(structure), iterations, None, not border_value)


def binary_opening(pixels: np.ndarray, structure: np.ndarray | None = None) -> np.ndarray:
    """(H, W) bool: pixels that are not 0, as far as structures lie within them; see binary_dilation."""
    return binary_dilation(binary_erosion(pixels, structure), structure)


def skeletonize(pixels: np.ndarray) -> np.ndarray:
    """(H, W) bool: the skeleton of what is not 0, one pixel wide, with the same parts, which touch diagonally too, and
    the same holes. None of scipy's."""
    thinned = np.pad(_mask(pixels), 1)
    _native("cs_thin", *thinned.shape, thinned)
    return thinned[1:-1, 1:-1]


def binary_propagation(pixels: np.ndarray, structure: np.ndarray | None, mask: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels that are not 0, with those linked to them through a mask; structure: see label."""
    pixels = _mask(pixels)
    parts, count = label(pixels | mask, structure)
    linked = np.zeros(count + 1, dtype=bool)
    linked[parts[pixels]] = True
    return linked[parts]


def binary_fill_holes(pixels: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels that are not 0, and those that they enclose; see holes_of."""
    mask = _mask(pixels)
    return mask | holes_of(mask)


def holes_of(mask: np.ndarray) -> np.ndarray:
    """(H, W) bool: what a mask's pixels enclose without being it, connected along the sides of pixels. Of scipy's
    functions the nearest is binary_fill_holes, which has the mask in it."""
    mask = bools(mask)
    holes = np.empty_like(mask)
    _native("cs_holes", mask, *mask.shape, holes)
    return holes


def reached(shown: np.ndarray, above: np.ndarray, hull: np.ndarray | None, steps: int) -> np.ndarray:
    """(H, W) bool: a mask, what of another one lies within so many steps along rows and columns of it or in a third
    one, None for none, and holes in all this that are of the other one alone; each (H, W) bool. None of scipy's.
    """
    masks = [None if mask is None else bools(mask) for mask in (shown, above, hull)]
    out = np.empty(shown.shape, bool)
    _native("cs_reach", *shown.shape, *masks, steps, out)
    return out


def distance_transform_edt(pixels: np.ndarray) -> np.ndarray:
    """(H, W) px: the distance of each pixel to the nearest that is 0; inf where none is."""
    mask = _mask(pixels)
    found = np.empty(mask.shape)
    _native("cs_distances", *mask.shape, mask, found)
    return found


def distance_transform_cdt(pixels: np.ndarray) -> np.ndarray:
    """The same by the larger of the distances along rows and columns, int32; -1 where no pixel is 0."""
    mask = _mask(pixels)
    found = np.empty(mask.shape, np.int32)
    _native("cs_chessboard", *mask.shape, mask, found, result=None)
    return found


def maximum(values: np.ndarray, labels: np.ndarray, index: np.ndarray) -> np.ndarray:
    """(n,) the largest of the floats (H, W) with each of the labels in index (n,), all >= 0; 0 where there are none."""
    count = int(max(labels.max(initial=0), index.max(initial=0))) + 1
    found = np.full(count, -np.inf, values.dtype)
    np.maximum.at(found, labels.ravel(), values.ravel())
    return np.where(np.bincount(labels.ravel(), minlength=count) > 0, found, 0)[index]


def center_of_mass(values: np.ndarray, labels: np.ndarray, index: np.ndarray) -> list[tuple[float, float]]:
    """The mean y and x of the pixels (H, W) with each of the labels in index (n,), all >= 0, weighted by values."""
    y, x = np.nonzero(values)
    own, weights = labels[y, x], values[y, x].astype(float)
    count = int(index.max(initial=0)) + 1
    mass, down, across = (np.bincount(own, weights * at, count)[index] for at in (1.0, y, x))
    return [*zip((down / mass).tolist(), (across / mass).tolist(), strict=True)]


def _per_axis(size: Any, count: int) -> list[tuple[Any, int]]:
    return [*zip(np.broadcast_to(size, count).tolist(), range(count), strict=True)]


def _gaussian(sigma: float, truncate: float) -> np.ndarray:
    reach = int(truncate * sigma + 0.5)
    weights = np.exp(-0.5 / (sigma * sigma) * np.arange(-reach, reach + 1) ** 2)
    return weights / weights.sum()


def _boxes(size: int | Sequence[int], count: int) -> list[_Line]:
    return [_line(own, axis) for own, axis in _per_axis(size, count)]


def _line(size: int, axis: int) -> _Line:
    if size < 1:
        raise ValueError(f"there are no {size} neighbours; the least size is 1")
    return axis, size // 2, (size - 1) // 2, None


def _weighted(weights: np.ndarray, axis: int) -> _Line:
    return axis, len(weights) // 2, (len(weights) - 1) // 2, doubles(weights)


def _filtered(operation: int, values: np.ndarray, lines: Iterable[_Line], mode: str) -> np.ndarray:
    out = np.array(values, order="C")
    kinds = _NUMBERS if operation in (_SMALLEST, _LARGEST) else _FLOATS
    if out.dtype not in kinds:
        raise TypeError(f"there is no such filter of {out.dtype}, but of {', '.join(str(each) for each in kinds)}")
    if mode not in _MODES:
        raise ValueError(f"there is no mode {mode!r}, but {', '.join(_MODES)}")
    for axis, before, after, weights in lines:
        if out.size and (before or after or weights is not None):
            shape = math.prod(out.shape[:axis]), out.shape[axis], math.prod(out.shape[axis:][1:])
            given = operation, kinds[out.dtype], _MODES.index(mode), *shape, before, after, weights
            _native("cs_filter_lines", *given, out)
    return out


def _mask(pixels: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(pixels if pixels.dtype == bool else pixels != 0)


def _structure(structure: np.ndarray | None) -> np.ndarray:
    found = _CROSS if structure is None else np.asarray(structure, dtype=bool)
    if not (found.shape[0] % 2 and found.shape[1] % 2):
        raise ValueError(f"a structure has odd sides, not {found.shape}")
    return found


def _dilated(
    mask: np.ndarray, structure: np.ndarray, iterations: int, where: np.ndarray | None, border: bool
) -> np.ndarray:
    if iterations < 1:
        raise ValueError(f"nothing is dilated {iterations} times; the least is 1")
    out, structure = np.empty_like(mask), np.ascontiguousarray(structure)
    where = None if where is None else _mask(where)
    high, wide = (side // 2 for side in structure.shape)
    _native("cs_dilate", *mask.shape, mask, high, wide, structure, where, iterations, border, out)
    return out
