"""What is asked for of one picture or many: everything that decides a result. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.marks import settings_hash
from cubicsplat_cli.files.ownership import MOVING
from cubicsplat_cli.settings import MAX_PIXELS, PRECISION, FitSettings, Setting

STYLE = Setting(
    "choice",
    "What to make: curves that blend (photo), few opaque shapes (artwork), or what the picture is.",
    choices=("auto", "photo", "artwork"),
)
PHOTO_PRECISION = 2
_CHECKS = {
    "style": STYLE,
    "precision": PRECISION,
    "max_size": Setting("count", "", least=1, most=1_000_000, optional=True),
    "max_pixels": Setting("count", "", least=1),
}


@dataclass(frozen=True)
class Request:
    """What the options ask for, the same for every input. Raises UsageError for values that make no sense.

    settings: of a photo; artwork: of flat artwork; style: "auto", "photo" or "artwork". precision: decimals of the
    coordinates (None: 2, and for artwork by its size). max_size: fit a copy of at most so many pixels a side.
    max_pixels: larger pictures are refused. png, page, animation (a file, or None), compress, force: of the files.
    measure: whether the SVG is drawn by an independent renderer and measured.
    """

    settings: FitSettings = field(default_factory=FitSettings)
    artwork: ArtworkSettings = field(default_factory=ArtworkSettings)
    style: str = "auto"
    precision: int | None = None
    max_size: int | None = None
    max_pixels: int = MAX_PIXELS
    png: bool = True
    page: bool = False
    animation: Path | None = None
    compress: bool = False
    force: bool = False
    measure: bool = True

    def __post_init__(self) -> None:
        for name, known in _CHECKS.items():
            if name != "precision" or self.precision is not None:
                known.check(name, getattr(self, name))
        if self.animation is not None and self.animation.suffix.lower() not in MOVING:
            raise UsageError(f"must end in {' or '.join(MOVING)}, not {str(self.animation)!r}", "animation")

    def with_threads(self, threads: int | None) -> Request:
        """The same with so many threads; None: as asked for."""
        return self if threads is None else replace(self, settings=self.settings.with_(threads=threads))

    def deciding(self) -> dict[str, Any]:
        """Everything that decides the file, and what it is computed with, as plain values."""
        return {
            **self.settings.public(),
            "style": self.style,
            "artwork": self.artwork.public(),
            "precision": self.precision,
            "max_size": self.max_size,
        }

    def describe(self) -> str:
        """The settings as a line; the recipe's numbers are in the JSON."""
        chosen = {"style": self.style, **self.settings.public()}
        return ", ".join(f"{name} {value}" for name, value in chosen.items() if name != "recipe")

    def digest(self) -> str:
        """The settings hash that the files will carry."""
        return settings_hash(self.deciding())
