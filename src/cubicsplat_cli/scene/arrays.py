"""Arrays of two kinds for one code: numpy's, on which the CPU works, and torch's, for a GPU and for autograd.

Both are spoken to in the terms of the array API standard (https://data-apis.org/array-api), which numpy follows by
itself, and torch through array-api-compat. torch takes seconds to import, so nothing here imports it before there is a
tensor of it. On a GPU `xp.where` and `xp.clip` take plain numbers without waiting for it, `xp.maximum` does not.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:
    import torch

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
