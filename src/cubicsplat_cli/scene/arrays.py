"""Arrays of two kinds for one code: numpy's, on which the CPU works, and torch's, for a GPU and for autograd.

Both are spoken to in the terms of the array API standard (https://data-apis.org/array-api), which numpy follows by
itself, and torch through array-api-compat. torch takes seconds to import, so nothing here imports it before there is a
tensor of it. On a GPU `xp.where` and `xp.clip` take plain numbers without waiting for it, `xp.maximum` does not.
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
    """Whether it is an array of either kind."""
    torch = sys.modules.get("torch")
    return isinstance(value, np.ndarray) or (torch is not None and isinstance(value, torch.Tensor))


def namespace(array: Array) -> Any:
    """The functions for arrays of this kind, under the standard's names."""
    if isinstance(array, np.ndarray):
        return np
    # Its import of numpy's names takes as long as half of torch's, and numpy 2 has them itself.
    import array_api_compat.torch

    return array_api_compat.torch


def kind_of(array: Array) -> str:
    """Kind and place of an array, for messages."""
    return "a numpy array" if isinstance(array, np.ndarray) else f"a torch.Tensor on {array.device}"


def like(array: Array, values: Any, dtype: str | None = None) -> Array:
    """Numbers from the host as an array of another's kind, in its place, and of its type or the one named.

    A GPU is waited for.
    """
    xp = namespace(array)
    return xp.asarray(values, dtype=getattr(xp, dtype) if dtype else array.dtype, device=array.device)


def copied(array: Array) -> Array:
    """The same values in a place of their own."""
    return array.copy() if isinstance(array, np.ndarray) else array.clone()


def with_channels(picture: Array, channels: int, whole: float = 1.0) -> Array:
    """A picture (H, W, 3) or (H, W, 4) with so many channels at least: of RGB alone the fourth is a whole opacity."""
    xp = namespace(picture)
    if picture.shape[-1] >= channels:
        return picture
    return xp.concat([picture, xp.full_like(picture[..., :1], whole)], axis=-1)


def contiguous(array: Array) -> Array:
    """The same values row after row; the same array where they are."""
    return np.ascontiguousarray(array) if isinstance(array, np.ndarray) else array.contiguous()


def as_numpy(array: Array) -> np.ndarray:
    """The values on the host, without autograd; in the same memory where they are there already."""
    return array if isinstance(array, np.ndarray) else array.detach().cpu().numpy()


def as_torch(array: Array, device: torch.device | str = "cpu") -> torch.Tensor:
    """The values as a tensor on a device; in the same memory where they are there already."""
    import torch

    return torch.as_tensor(array, device=device)


def sigmoid(values: Array) -> Array:
    """1 / (1 + exp(-x)), by the hyperbolic tangent, which cannot overflow."""
    return 0.5 + 0.5 * namespace(values).tanh(0.5 * values)


def logit(shares: Array) -> Array:
    """The inverse of `sigmoid`, for values in (0, 1)."""
    return namespace(shares).log(shares / (1.0 - shares))


def padded(points: Array, used: Array, room: int | None = None) -> Array:
    """(N, K, 2): the control points (P, 2) of N curves, `used` (N,) int64 of them each, in rows that end with zeros.

    room: K, by default as many as the longest curve needs. The inverse of `Scene.unpadded`.
    """
    room = int(used.max()) if room is None else room
    if room * used.shape[0] == points.shape[0]:
        return points.reshape(-1, room, 2)
    rows = _zeros((used.shape[0] * room, 2), points)
    rows[places_used(used, room)] = points
    return rows.reshape(-1, room, 2)


def _zeros(shape: tuple[int, int], array: Array) -> Array:
    """Zeros of another's kind, type and place, which on the host take no memory before they are written.

    The padding of a drawing with one long shape is most of it. numpy asks for huge pages, of which each row fills one.
    """
    if not isinstance(array, np.ndarray):
        return namespace(array).zeros(shape, dtype=array.dtype, device=array.device)
    return np.ndarray(shape, array.dtype, buffer=mmap.mmap(-1, math.prod(shape) * array.itemsize))


def places_used(used: Array, room: int) -> Array:
    """(P,) int64: the rows of (N K, 2) that are in use, where the first `used` (N,) of every `room`, K, are."""
    counts = as_numpy(used)
    ends = counts.cumsum()
    before = np.arange(len(counts)) * room - (ends - counts)
    return like(used, np.arange(ends[-1]) + before.repeat(counts), "int64")


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Within, torch computes on the calling thread alone, where it is in use at all.

    The few tensor operations between the engine's steps are small, and OpenMP's threads go on spinning after each of
    them: on two cores that took 8 % of a fit.
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
    """A dataclass whose arrays, and those of the CurveArrays among its fields, have a row for each curve.

    They are all numpy's, or all torch's and on one device.
    """

    def arrays_by_name(self) -> dict[str, Array]:
        """The arrays that there are; `field.name` of a field's own."""
        found: dict[str, Array] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, CurveArrays):
                found |= {f"{f.name}.{name}": t for name, t in value.arrays_by_name().items()}
            elif is_array(value):
                found[f.name] = value
        return found

    def with_arrays(self, tensors: dict[str, Array]) -> Self:
        """The same with other arrays in the place of those of these names, as `arrays_by_name` gives them."""
        changes: dict[str, object] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, CurveArrays):
                own = {name.partition(".")[2]: t for name, t in tensors.items() if name.startswith(f"{f.name}.")}
                changes[f.name] = value.with_arrays(own)
            elif f.name in tensors:
                changes[f.name] = tensors[f.name]
        return replace(self, **changes)

    def changed(self, change: Callable[[Array], Array]) -> Self:
        """All arrays changed alike."""
        return self.with_arrays({name: change(t) for name, t in self.arrays_by_name().items()})

    def copy(self) -> Self:
        return self.changed(copied)

    def as_numpy(self) -> Self:
        """The same in numpy arrays on the host, without autograd; in the same memory where it is there already."""
        return self.changed(as_numpy)

    def as_torch(self, device: torch.device | str = "cpu") -> Self:
        """The same in torch tensors on a device; in the same memory where it is there already."""
        return self.changed(lambda t: as_torch(t, device))

    def as_kind_of(self, array: Array) -> Self:
        """The same in arrays of another's kind, in its place."""
        return self.as_numpy() if isinstance(array, np.ndarray) else self.as_torch(array.device)

    def chosen(self, index: Array | slice) -> Self:
        """The curves of an index (n,), a mask (N,) or a slice, in their order."""
        return self.changed(lambda t: contiguous(t[index]))

    def joined(self, behind: Self) -> Self:
        """These curves in front of others."""
        theirs = behind.arrays_by_name()
        return self.with_arrays(
            {name: namespace(t).concat((t, theirs[name])) for name, t in self.arrays_by_name().items()}
        )

    def overwrite(self, other: Self) -> None:
        """Takes over other curves' values in place: a captured CUDA graph keeps the addresses."""
        theirs = other.arrays_by_name()
        for name, mine in self.arrays_by_name().items():
            mine[...] = theirs[name]
