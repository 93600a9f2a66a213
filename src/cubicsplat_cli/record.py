"""Classes that hold values and do not change."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

_T = TypeVar("_T")

if TYPE_CHECKING:
    from typing_extensions import dataclass_transform

    @dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field,))
    def record(cls: type[_T]) -> type[_T]: ...

else:
    # A frozen dataclass compiles six methods while it is imported: with some 170 classes a tenth of the time that a
    # small drawing takes. A record compiles its constructor alone; that nobody assigns to its fields mypy checks.
    record = dataclass(eq=False, repr=False)
