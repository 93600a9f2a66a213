"""Arrays with a row for each curve, which are chosen, copied and moved together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from cubicsplat_cli.scene.arrays import Array, as_numpy, as_torch, contiguous, copied, is_array, namespace

if TYPE_CHECKING:
    import torch
    from typing_extensions import Self


@dataclass
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
