"""Arrays of two kinds for one code: numpy's, on which the CPU works, and torch's, for a GPU and for autograd.

Code uses the functions of the array API standard (https://data-apis.org/array-api), which numpy has by itself, and
torch through array-api-compat. torch takes seconds to import, so nothing here imports it before there is a tensor of
it. On a GPU `xp.where` and `xp.clip` take plain numbers without waiting for it, `xp.maximum` does not.
"""

from __future__ import annotations

import math
import mmap
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:
    import torch
    from typing_extensions import Self

Array: TypeAlias = Any  # a numpy array or a torch tensor, whose types have no common ground


def is_array(value: object) -> bool:
    """Return whether a value is an array of either kind."""
    torch = sys.modules.get("torch")
    return isinstance(value, np.ndarray) or (torch is not None and isinstance(value, torch.Tensor))


def namespace(array: Array) -> Any:
    """Return the functions for arrays of this kind, under the standard's names."""
    if isinstance(array, np.ndarray):
        return np
    # Its import of numpy's names takes as long as half of torch's, and numpy 2 has them itself.
    import array_api_compat.torch

    return array_api_compat.torch


def kind_of(array: Array) -> str:
    """Return the kind and device of an array, for messages."""
    return "a numpy array" if isinstance(array, np.ndarray) else f"a torch.Tensor on {array.device}"


def like(array: Array, values: Any, dtype: str | None = None) -> Array:
    """Return numbers of the host as an array of another's kind, device and type, or the type named. Waits for a GPU."""
    xp = namespace(array)
    return xp.asarray(values, dtype=getattr(xp, dtype) if dtype else array.dtype, device=array.device)


def copied(array: Array) -> Array:
    """Return the same values in memory of their own."""
    return array.copy() if isinstance(array, np.ndarray) else array.clone()


def with_channels(picture: Array, channels: int, whole: float = 1.0) -> Array:
    """Return a picture (H, W, 3) or (H, W, 4) with at least so many channels: RGB gets a whole opacity."""
    xp = namespace(picture)
    if picture.shape[-1] >= channels:
        return picture
    return xp.concat([picture, xp.full_like(picture[..., :1], whole)], axis=-1)


def block_means(values: np.ndarray, side: int) -> np.ndarray:
    """Return (h, w, C) float32: the means of the whole blocks of side x side px of (H, W, C) uint8 or float."""
    height, width = values.shape[0] // side, values.shape[1] // side
    blocks = values[: height * side, : width * side].reshape(height, side, width, side, -1)
    # Whole numbers add up exactly; float32 means lose nothing that matters.
    total = blocks.sum(axis=(1, 3), dtype=np.uint32 if values.dtype == np.uint8 else np.float32)
    return (total / np.float32(side * side)).astype(np.float32)


def contiguous(array: Array) -> Array:
    """Return the same values row after row; the same array if they are."""
    return np.ascontiguousarray(array) if isinstance(array, np.ndarray) else array.contiguous()


def as_numpy(array: Array) -> np.ndarray:
    """Return the values on the host, without autograd; in the same memory if they are there already."""
    return array if isinstance(array, np.ndarray) else array.detach().cpu().numpy()


def as_torch(array: Array, device: torch.device | str = "cpu") -> torch.Tensor:
    """Return the values as a tensor on a device; in the same memory if they are there already."""
    import torch

    return torch.as_tensor(array, device=device)


def sigmoid(values: Array) -> Array:
    """Return 1 / (1 + exp(-x)), by the hyperbolic tangent, which cannot overflow."""
    return 0.5 + 0.5 * namespace(values).tanh(0.5 * values)


def logit(shares: Array) -> Array:
    """Return the inverse of `sigmoid`, for values in (0, 1)."""
    return namespace(shares).log(shares / (1.0 - shares))


def padded(points: Array, used: Array, room: int | None = None) -> Array:
    """Return (N, K, 2): the control points (P, 2) of N curves, `used` (N,) int64 of each, in rows that end with zeros.

    room: K, by default the points of the longest curve. The inverse of `Scene.unpadded`.
    """
    room = int(used.max()) if room is None else room
    if room * used.shape[0] == points.shape[0]:
        return points.reshape(-1, room, 2)
    shape = used.shape[0] * room, 2
    if isinstance(points, np.ndarray):
        # Pages that take no memory before they are written: most of the padding of a drawing with one long shape is
        # never touched. numpy's own zeros take huge pages, of which each row fills one.
        rows = np.ndarray(shape, points.dtype, buffer=mmap.mmap(-1, math.prod(shape) * points.itemsize))
    else:
        rows = namespace(points).zeros(shape, dtype=points.dtype, device=points.device)
    rows[places_used(used, room)] = points
    return rows.reshape(-1, room, 2)


def places_used(used: Array, room: int) -> Array:
    """Return (P,) int64: the rows of (N K, 2) in use, which are the first `used` (N,) of every `room`, K."""
    counts = as_numpy(used)
    ends = counts.cumsum()
    before = np.arange(len(counts)) * room - (ends - counts)
    return like(used, np.arange(ends[-1]) + before.repeat(counts), "int64")


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Let torch, if it is in use, compute on the calling thread alone within this context.

    The few tensor operations between the engine's steps are small, and OpenMP's threads spin on after each: on two
    cores that took 8 % of a fit.
    """
    torch = sys.modules.get("torch")
    if torch is None:
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@dataclass(eq=False)
class CurveArrays:
    """A dataclass whose arrays, and its CurveArrays', have a row for each curve, and are of one kind and device."""

    def arrays_by_name(self) -> dict[str, Array]:
        """Return the arrays by name, without missing ones; those of a field's arrays as `field.name`."""
        found: dict[str, Array] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, CurveArrays):
                found |= {f"{f.name}.{name}": t for name, t in value.arrays_by_name().items()}
            elif is_array(value):
                found[f.name] = value
        return found

    def changed(self, change: Callable[..., Array], *others: Self) -> Self:
        """Return the same, with `change` of each array, and of those of `others` in its place, instead of the array."""
        changes: dict[str, object] = {}
        for f in fields(self):
            value, *theirs = (getattr(each, f.name) for each in (self, *others))
            if isinstance(value, CurveArrays):
                changes[f.name] = value.changed(change, *theirs)
            elif is_array(value):
                changes[f.name] = change(value, *theirs)
        return replace(self, **changes)

    def copy(self) -> Self:
        return self.changed(copied)

    def as_numpy(self) -> Self:
        """Return the same in numpy arrays on the host, without autograd; in the same memory if it is there already."""
        return self.changed(as_numpy)

    def as_torch(self, device: torch.device | str = "cpu") -> Self:
        """Return the same in torch tensors on a device; in the same memory if it is there already."""
        return self.changed(lambda t: as_torch(t, device))

    def as_kind_of(self, array: Array) -> Self:
        """Return the same in arrays of another's kind, on its device."""
        return self.as_numpy() if isinstance(array, np.ndarray) else self.as_torch(array.device)

    def chosen(self, index: Array | slice) -> Self:
        """Return the curves of an index (n,), a mask (N,) or a slice, in their order."""
        return self.changed(lambda t: contiguous(t[index]))

    def joined(self, behind: Self) -> Self:
        """Return these curves in front of others."""
        return self.changed(lambda mine, theirs: namespace(mine).concat((mine, theirs)), behind)

    def overwrite(self, other: Self) -> None:
        """Take over other curves' values in place: a captured CUDA graph keeps the addresses."""
        theirs = other.arrays_by_name()
        for name, mine in self.arrays_by_name().items():
            mine[...] = theirs[name]
