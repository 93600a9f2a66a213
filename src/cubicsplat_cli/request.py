"""What is asked for of one picture or many: everything that decides a result. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cubicsplat_cli.artwork.settings import CUTOUT, ArtworkSettings
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.marks import settings_hash
from cubicsplat_cli.files.paths import MOVING
from cubicsplat_cli.focus import Focus
from cubicsplat_cli.settings import MAX_PIXELS, PRECISION, FitSettings, Mode, Setting

if TYPE_CHECKING:
    from cubicsplat_cli.files.weights import Mask
    from cubicsplat_cli.svg.initial import InitialDrawing

STYLE = Setting(
    "choice",
    "What to make: blended curves (photo), few opaque shapes (artwork), square cells (pixel), or what suits it.",
    choices=("auto", "photo", "artwork", "pixel"),
)
# Values other than the defaults imply a style: the photo's are of `Request` and of its `settings`.
PHOTO_SETTINGS = ("loss", "fill")
PHOTO_OPTIONS = ("weights", "focus", "init", "max_bytes", "target_psnr", *PHOTO_SETTINGS)
ARTWORK_OPTIONS = ("colors", "palette", "min_area", "detail", "stacking", "completion")
PHOTO_PRECISION = 2
_CHECKS = {
    "style": STYLE,
    "precision": PRECISION,
    "max_size": Setting("count", "", least=1, most=1_000_000, optional=True),
    "max_pixels": Setting("count", "", least=1),
    "max_bytes": Setting("count", "", least=1, optional=True),
    "target_psnr": Setting("number", "", least=1, most=60, optional=True),
    "frame": Setting("count", "", least=1, most=1_000_000, optional=True),
}


@dataclass(frozen=True)
class Request:
    """What the options ask for, the same for every input. Raises UsageError for values that make no sense.

    settings: of a photo; artwork: of flat artwork; style: "auto", "photo", "artwork" or "pixel". precision: decimals of
    the coordinates (None: 2, and for artwork by its size). max_size: fit a copy of at most so many pixels a side.
    max_pixels: larger pictures are refused. frame: of files with several, from 1. png, report, page, animation (a file,
    or None), compress, force: of the files. suffix: what names made of the picture's get at their end. skip_existing:
    leave pictures alone that have an SVG, whatever made it. measure: whether the SVG is drawn by an independent
    renderer and measured. weights, focus: how much the pixels matter to the fit of a photo; masks: a folder in
    which each picture has weights of its own. init: the drawing that it
    begins with; freeze: whose curves stay as they are. max_bytes, target_psnr: of the file; the number of curves is
    found for it. The style "auto" is "photo" where any of PHOTO_OPTIONS is given, "artwork" for ARTWORK_OPTIONS.
    """

    settings: FitSettings = field(default_factory=FitSettings)
    artwork: ArtworkSettings = field(default_factory=ArtworkSettings)
    style: str = "auto"
    precision: int | None = None
    max_size: int | None = None
    max_pixels: int = MAX_PIXELS
    frame: int | None = None
    png: bool = True
    report: bool = True
    page: bool = False
    animation: Path | None = None
    weights: Mask | None = None
    masks: Path | None = None
    focus: Focus | None = None
    init: InitialDrawing | None = None
    freeze: bool = False
    max_bytes: int | None = None
    target_psnr: float | None = None
    compress: bool = False
    suffix: str = ""
    force: bool = False
    skip_existing: bool = False
    measure: bool = True

    def __post_init__(self) -> None:
        for name, known in _CHECKS.items():
            if name != "precision" or self.precision is not None:
                known.check(name, getattr(self, name))
        if self.style in ("artwork", "pixel") and self.of_photos():
            raise UsageError(
                f"is for photos, not for {self.style}; leave it out, or use style photo", self.of_photos()[0]
            )
        if self.style == "pixel" and self.artwork.min_area:
            raise UsageError(
                "joins small regions, which pixel art keeps; use style artwork, or leave it out", "min_area"
            )
        if self.style == "pixel" and self.settings.mode is Mode.OPEN:
            raise UsageError("open is for strokes, which pixel art has none of; leave it out", "mode")
        if self.style == "photo" and self.of_artwork():
            raise UsageError("is for artwork, not for photos; leave it out, or use style artwork", self.of_artwork()[0])
        if self.of_photos() and self.of_artwork():
            other = self.of_photos()[0].replace("_", "-")
            raise UsageError(f"is for artwork, --{other} for photos; give one of them", self.of_artwork()[0])
        if self.artwork.stacking == CUTOUT and self.settings.mode is Mode.OPEN:
            raise UsageError("cutout has shapes only; leave out --mode open, which is for strokes", "stacking")
        if self.freeze and self.init is None:
            raise UsageError("needs a drawing whose curves stay as they are; give it with --init", "freeze")
        budgets = [name for name in ("max_bytes", "target_psnr") if getattr(self, name) is not None]
        if len(budgets) > 1:
            raise UsageError("and --target-psnr are two budgets; give one of them", "max_bytes")
        if budgets and (self.freeze or self.init is not None or self.settings.curves is not None):
            raise UsageError("finds the number of curves itself; leave out --curves, --init and --freeze", budgets[0])
        if self.animation is not None and self.animation.suffix.lower() not in MOVING:
            raise UsageError(f"must end in {' or '.join(MOVING)}, not {str(self.animation)!r}", "animation")
        if set(self.suffix) & set("/\\\0"):
            raise UsageError(f"must be the end of a file's name, not {self.suffix!r}", "suffix")
        if self.force and self.skip_existing:
            raise UsageError("--force makes anew what --skip-existing leaves alone; give one of them")

    def of_photos(self) -> list[str]:
        """What is asked for that only the fit of a photo can do."""
        asked = {name: getattr(self, name) for name in PHOTO_OPTIONS if hasattr(self, name)}
        asked["weights"] = self.masks or self.weights
        found = [name for name, value in asked.items() if value is not None]
        return found + [name for name in PHOTO_SETTINGS if getattr(self.settings, name) != getattr(FitSettings, name)]

    def of_artwork(self) -> list[str]:
        """What is asked for that only a drawing can have."""
        usual = ArtworkSettings()
        return [name for name in ARTWORK_OPTIONS if getattr(self.artwork, name) != getattr(usual, name)]

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
            "frame": self.frame,
            "weights": _source(self.weights),
            "focus": None if self.focus is None else [float(value) for value in astuple(self.focus)],
            "init": _source(self.init),
            "freeze": self.freeze,
            "max_bytes": self.max_bytes,
            "target_psnr": self.target_psnr,
        }

    def describe(self) -> str:
        """The settings as a line; the recipe's numbers are in the JSON."""
        chosen = {"style": self.style, **self.settings.public()}
        return ", ".join(f"{name} {value}" for name, value in chosen.items() if name != "recipe" and value is not None)

    def digest(self) -> str:
        """The settings hash that the files will carry."""
        # Files are the same under any name.
        named = {"weights": self.weights, "init": self.init}
        return settings_hash({**self.deciding(), **{name: each and each.sha256 for name, each in named.items()}})


def _source(given: Mask | InitialDrawing | None) -> dict[str, str] | None:
    return None if given is None else {"name": given.name, "sha256": given.sha256}
