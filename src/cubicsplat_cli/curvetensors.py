"""Tensors with a row for each curve, which are chosen, copied and moved together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from typing_extensions import Self


@dataclass
class CurveTensors:
    """A dataclass whose tensors, and those of the CurveTensors among its fields, have a row for each curve."""

    def tensors_by_name(self) -> dict[str, Tensor]:
        """The tensors that there are; `field.name` of a field's own."""
        found: dict[str, Tensor] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, CurveTensors):
                found |= {f"{f.name}.{name}": t for name, t in value.tensors_by_name().items()}
            elif isinstance(value, Tensor):
                found[f.name] = value
        return found

    def with_tensors(self, tensors: dict[str, Tensor]) -> Self:
        """The same with other tensors in the place of those of these names, as `tensors_by_name` gives them."""
        changes: dict[str, object] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, CurveTensors):
                own = {name.partition(".")[2]: t for name, t in tensors.items() if name.startswith(f"{f.name}.")}
                changes[f.name] = value.with_tensors(own)
            elif f.name in tensors:
                changes[f.name] = tensors[f.name]
        return replace(self, **changes)

    def changed(self, change: Callable[[Tensor], Tensor]) -> Self:
        """All tensors changed alike."""
        return self.with_tensors({name: change(t) for name, t in self.tensors_by_name().items()})

    def copy(self) -> Self:
        return self.changed(Tensor.clone)

    def to(self, device: torch.device | str) -> Self:
        """The curves on a device; the same tensors where they are there already."""
        return self.changed(lambda t: t.to(device))

    def chosen(self, index: Tensor) -> Self:
        """The curves of an index (n,) or a mask (N,), in their order."""
        return self.changed(lambda t: t[index].contiguous())

    def joined(self, behind: Self) -> Self:
        """These curves in front of others."""
        theirs = behind.tensors_by_name()
        return self.with_tensors({name: torch.cat((t, theirs[name])) for name, t in self.tensors_by_name().items()})

    def overwrite(self, other: Self) -> None:
        """Takes over other curves' values in place: a captured CUDA graph keeps the addresses."""
        theirs = other.tensors_by_name()
        for name, mine in self.tensors_by_name().items():
            mine.copy_(theirs[name])
