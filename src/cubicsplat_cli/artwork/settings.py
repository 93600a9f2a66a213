"""The user's choices for the artwork style. Imports nothing heavy, since the command line is built from it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.options import DRAWINGS, check_settings, parse_colour, setting

MOST_COLORS = 256
# Upper shapes lie on lower ones, or all abut and share their edges.
STACKED, CUTOUT = "stacked", "cutout"
# What upper shapes hide goes on beneath them, or ends there as shortly as it may.
ON, OFF = "on", "off"


@dataclass(frozen=True)
class ArtworkSettings:
    """Settings of the drawing of a flat picture. Raises UsageError on values that make no sense.

    colors: at most so many fills, 1..256, or None for as many as the picture has. palette: the fills to use, each
    8-bit sRGB or a colour's name, or text with commas between names; empty for the picture's own.
    palette_tolerance: in CIEDE2000, what is farther from all of these keeps its own fill; None for nothing. min_area:
    px^2, smaller regions join a neighbour. detail: 1 weighs outlines as the picture supports them, more follows it more
    closely, less draws with fewer pieces; 0.01..100. stacking: "stacked" or "cutout". completion: "on" or "off",
    whether outlines go on beneath what hides them as what shows suggests, and pieces of one fill are one shape there.
    strokes: whether lines of even width become strokes; None for those whose description is shorter for it, in stacked
    shapes. curves: at most so many shapes, or None.
    """

    colors: int | None = setting(
        None, "count", "Use at most this many colours.", least=1, most=MOST_COLORS, optional=True, group=DRAWINGS
    )
    palette: tuple[tuple[int, int, int], ...] = setting(
        (), "text", "Use these colours only: names or #rrggbb.", metavar="COLOUR,...", group=DRAWINGS
    )
    palette_tolerance: float | None = setting(
        None,
        "number",
        "Colours farther than this (CIEDE2000) from all of --palette stay.",
        least=0.0,
        most=200.0,
        optional=True,
        metavar="NUMBER",
        group=DRAWINGS,
        hidden=True,
    )
    min_area: float = setting(
        0.0, "number", "Smaller regions join a neighbour.", most=1e9, metavar="PX", group=DRAWINGS
    )
    detail: float = setting(
        1.0,
        "number",
        "Above 1: outlines follow the picture more closely; below 1: fewer segments.",
        least=0.01,
        most=100.0,
        metavar="NUMBER",
        group=DRAWINGS,
        by_set=True,
        hidden_option=True,
    )
    stacking: str = setting(
        STACKED, "choice", "Shapes overlap, or abut for cutters.", choices=(STACKED, CUTOUT), group=DRAWINGS
    )
    strokes: bool | None = setting(
        None,
        "flag",
        "Lines of even width become strokes.  [default: where that is shorter]",
        optional=True,
        group=DRAWINGS,
    )
    completion: str = setting(
        ON, "choice", "Do not guess the hidden parts of shapes.", choices=(ON, OFF), only_off=True, hidden=True,
        group=DRAWINGS,
    )  # fmt: skip
    curves: int | None = None

    def __post_init__(self) -> None:
        check_settings(self)
        given = self.palette.split(",") if isinstance(self.palette, str) else self.palette
        object.__setattr__(self, "palette", tuple(_triple(colour) for colour in given))
        if len(self.palette) > MOST_COLORS:
            raise UsageError(f"takes at most {MOST_COLORS} colours, not {len(self.palette)}", "palette")

        if self.palette_tolerance is not None and not self.palette:
            raise UsageError("is of the colours of --palette; give these too", "palette_tolerance")

    @property
    def free_fills(self) -> bool:
        """Whether fills are the picture's own, of which gradients and translucent shapes may be made."""
        return self.colors is None and not self.palette

    def public(self) -> dict[str, Any]:
        """Plain values for the metrics file and the settings hash."""
        return asdict(self) | {"palette": ["#{:02x}{:02x}{:02x}".format(*color) for color in self.palette]}


def _triple(colour: Any) -> tuple[int, int, int]:
    """8-bit sRGB of a colour's name, or of three numbers; UsageError for what is no colour."""
    if isinstance(colour, str):
        return parse_colour(colour, "palette", "must be colours such as #ffcc00 or teal, with commas between them")
    if not isinstance(colour, (tuple, list)) or len(colour) != 3 or not all(v in range(256) for v in colour):
        raise UsageError(f"takes colours of three values from 0 to 255, not {colour!r}", "palette")
    return int(colour[0]), int(colour[1]), int(colour[2])
