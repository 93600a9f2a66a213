"""The request for an animation of a clip, a table of options, and the figures of the result. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.marks import settings_hash
from cubicsplat_cli.metrics import Figures, Input
from cubicsplat_cli.options import check_settings, parse_bytes, setting, settings_of
from cubicsplat_cli.settings import MAX_PIXELS, PRECISION, FitSettings

STYLES = AUTO, PHOTO, ARTWORK = "auto", "photo", "artwork"
FORMATS = SMIL, LOTTIE, FRAMES = "smil", "lottie", "frames"
# The settings of the fit that `animate` takes.
FIT_SETTINGS = ("curves", "preset", "steps", "time_limit", "threads", "seed", "background")


@dataclass(frozen=True)
class ClipRequest:
    """The values of all options. Raises UsageError for values that make no sense.

    settings: of the fit. format: None: by the output's name, SVG with SMIL by default. loop: True to repeat the
    animation for ever; None: as often as the clip says.
    """

    settings: FitSettings = field(default_factory=FitSettings)
    style: str = setting(AUTO, "choice", "Curves that blend, or few opaque shapes.", choices=STYLES)
    format: str | None = setting(
        None, "choice", "SVG with SMIL, Lottie, or an SVG a frame.  [default: by OUT]", choices=FORMATS
    )
    fps: float | None = setting(None, "number", "Take so many frames a second.  [default: all]", least=0.1, most=240)
    frames: int | None = setting(None, "count", "Take the first so many frames only.", least=2, most=1_000_000)
    loop: bool | None = setting(None, "flag", "Repeat for ever.  [default: as the clip does]")
    max_bytes: int | None = setting(
        None, "count", "As much as fits: 200k, or 60kgz after gzip.", least=1, parse=parse_bytes
    )
    precision: int = setting(1, "count", "Decimals of coordinates.", most=PRECISION.most)
    max_size: int | None = setting(
        None, "count", "Work on frames with this longer side.", metavar="PX", least=1, most=1_000_000
    )
    max_pixels: int = setting(MAX_PIXELS, "count", "Refuse larger frames.", least=1, decides=False)
    html_report: bool = setting(False, "flag", "Also write OUT.html with a player.", option="report", decides=False)
    force: bool = setting(False, "flag", "Replace files of other programs.", decides=False)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.style == ARTWORK and self.max_bytes is not None:
            raise UsageError("is for curves, not for artwork; leave it out, or use style photo", "max_bytes")
        if self.style == ARTWORK and self.format == LOTTIE:
            raise UsageError("lottie is for curves, not for artwork; write an SVG, or use style photo", "format")
        if self.max_bytes is not None and self.settings.curves is not None:
            raise UsageError("finds the number of curves itself; leave out --curves", "max_bytes")

    def plays(self, of_clip: int) -> int:
        """Return the number of times that the animation is shown, 0 for ever. of_clip: the number of the clip."""
        return of_clip if self.loop is None else 0 if self.loop else 1

    def deciding(self) -> dict[str, Any]:
        """Return everything that decides the file, as plain values."""
        own = {each.name: getattr(self, each.name) for each, spec in settings_of(ClipRequest) if spec.decides}
        return {**self.settings.public(), **own}

    def digest(self) -> str:
        """Return the settings hash that the file carries."""
        return settings_hash(self.deciding())


@dataclass(frozen=True)
class ClipInput(Input):
    """The clip. frames, seconds: of the part that was taken. plays: the times that it asks to be shown, 0 for ever."""

    frames: int
    seconds: float
    plays: int


@dataclass(frozen=True)
class ClipOutput:
    """The animation. path: of the file, or of the folder of frames, or None. bytes, compressed_bytes: of all files, and
    after gzip. groups: of frames without a cut between them. curves: of all groups, or shapes. knots: of all values
    that change, or changes of shapes.
    """

    format: str
    bytes: int
    compressed_bytes: int
    sha256: str
    groups: int
    curves: int
    knots: int
    path: str | None = None


@dataclass(frozen=True)
class ClipQuality:
    """Quality of the animation as it is played, drawn by our renderer from the numbers of the file.

    psnr_db: mean of the frames (None: every frame is identical). worst_psnr_db: of the worst frame. frames: the
    `psnr_db` of each frame, and the time `time_s` at which it is exact.
    """

    psnr_db: float | None
    worst_psnr_db: float | None
    frames: list[dict[str, float | None]]


@dataclass(frozen=True)
class ClipReport(Figures):
    """The figures of an animation. style: "photo" or "artwork"; style_reason: why. timing: seconds: `total_s`, `fit_s`,
    and `frame_s` of the fit for a frame.
    """

    input: ClipInput
    output: ClipOutput
    settings: dict[str, Any]
    settings_hash: str
    style: str
    style_reason: str
    device: dict[str, Any]
    timing: dict[str, float]
    quality: ClipQuality
    interrupted: bool = False
    notes: list[str] = field(default_factory=list)
