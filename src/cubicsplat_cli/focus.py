"""The part of a picture that matters most, as the user names it. Imports nothing heavy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

from cubicsplat_cli.errors import UsageError

USUAL_FACTOR = 4.0
_FORM = "must be X,Y,W,H or X,Y,W,H,FACTOR: a rectangle in pixels of the picture, and how much more it matters"


@dataclass(frozen=True)
class Focus:
    """A rectangle in px of the picture, and how many times as much as the rest its pixels matter.

    Raises UsageError for an empty rectangle, a factor that is not above 0, or values that are not finite.
    """

    left: float
    top: float
    width: float
    height: float
    factor: float = USUAL_FACTOR

    def __post_init__(self) -> None:
        values = astuple(self)
        if not all(math.isfinite(v) for v in values) or min(self.width, self.height, self.factor) <= 0:
            raise UsageError(f"{_FORM}, not {','.join(f'{v:g}' for v in values)!r}", "focus")


def parse_focus(given: str | Sequence[float] | Focus) -> Focus:
    """A focus from `X,Y,W,H` or `X,Y,W,H,FACTOR`, text or numbers. Raises UsageError for anything else."""
    if isinstance(given, Focus):
        return given
    parts = given.split(",") if isinstance(given, str) else given
    try:
        values = [float(part) for part in parts]
    except (TypeError, ValueError):
        values = []
    if len(values) not in (4, 5):
        raise UsageError(f"{_FORM}, not {given!r}", "focus")
    return Focus(*values)
