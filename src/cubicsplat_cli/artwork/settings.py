"""What the user chooses of the artwork style."""

from __future__ import annotations

from dataclasses import dataclass

from cubicsplat_cli.errors import UsageError

MOST_COLORS = 256


@dataclass(frozen=True)
class ArtworkSettings:
    """How a flat picture is drawn. Raises UsageError on values that make no sense.

    colors: at most so many inks, 1..256, or None for as many as the picture has. palette: the inks to use, 8-bit sRGB
    or empty for the picture's own. min_area: px^2, smaller regions join a neighbour. detail: 1 weighs outlines as
    the picture supports them, more follows it more closely, less draws with fewer pieces; 0.01..100. curves: at most
    so many shapes, or None.
    """

    colors: int | None = None
    palette: tuple[tuple[int, int, int], ...] = ()
    min_area: float = 0.0
    detail: float = 1.0
    curves: int | None = None

    def __post_init__(self) -> None:
        _whole("colors", self.colors, MOST_COLORS)
        _whole("curves", self.curves, 1_000_000)
        if not 0.0 <= self.min_area < 1e9:
            raise UsageError(f"min-area must be a number of pixels from 0, not {self.min_area}")
        if not 0.01 <= self.detail <= 100.0:
            raise UsageError(f"detail must lie between 0.01 and 100, not {self.detail}")
        if len(self.palette) > MOST_COLORS:
            raise UsageError(f"palette takes at most {MOST_COLORS} colours, not {len(self.palette)}")
        for color in self.palette:
            if len(color) != 3 or not all(isinstance(v, int) and 0 <= v <= 255 for v in color):
                raise UsageError(f"palette takes colours of three values from 0 to 255, not {color!r}")


def _whole(name: str, value: int | None, most: int) -> None:
    if value is not None and (isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= most):
        raise UsageError(f"{name} must be a whole number between 1 and {most}, not {value!r}")
