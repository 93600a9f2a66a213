"""The user's choices for the artwork style. Imports nothing heavy, since the command line is built from it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.options import DRAWINGS, check_settings, parse_colour, setting

MOST_COLORS = 256
STACKED, CUTOUT = "stacked", "cutout"  # upper shapes lie on lower ones, or all abut and share their edges
ON, OFF = "on", "off"  # shapes continue beneath those that hide them, or end there as soon as possible


@dataclass(frozen=True)
class ArtworkSettings:
    """Settings of the drawing of a flat picture. Raises UsageError for senseless values.

    colors: the most fills, 1..256, or None for as many as the picture has. palette: the fills to use, each 8-bit sRGB
    or a colour's name, or text with commas between names; empty for the picture's own. palette_tolerance: CIEDE2000;
    fills farther from all of the palette stay; None for any distance. min_area: px^2; smaller regions join a neighbour.
    detail: 0.01..100; above 1 outlines follow the picture more closely, below 1 they have fewer pieces. stacking:
    "stacked" or "cutout". completion: "on" or "off": hidden parts of shapes are guessed, and visible pieces joined
    beneath what hides them. strokes: True for strokes in place of all lines of even width; None for those in stacked
    shapes whose description becomes shorter. curves: the most shapes, or None.
    """

    colors: int | None = setting(
        None, "count", "Use at most this many colours.", least=1, most=MOST_COLORS, optional=True, group=DRAWINGS
    )
    palette: tuple[tuple[int, int, int], ...] = setting(
        (), "text", "Use these colours only: names or #rrggbb.", metavar="COLOUR,...", group=DRAWINGS
    )
    palette_tolerance: float | None = setting(
        None, "number", "Colours farther than this (CIEDE2000) from all of --palette stay.", least=0.0, most=200.0,
        optional=True, metavar="NUMBER", group=DRAWINGS, hidden=True,
    )  # fmt: skip
    min_area: float = setting(
        0.0, "number", "Smaller regions join a neighbour.", most=1e9, metavar="PX", group=DRAWINGS
    )
    detail: float = setting(
        1.0, "number", "Above 1: outlines follow the picture more closely; below 1: fewer segments.", least=0.01,
        most=100.0, metavar="NUMBER", group=DRAWINGS, by_set=True, hidden_option=True,
    )  # fmt: skip
    stacking: str = setting(
        STACKED, "choice", "Shapes overlap, or abut for cutters.", choices=(STACKED, CUTOUT), group=DRAWINGS
    )
    strokes: bool | None = setting(
        None, "flag", "Lines of even width become strokes.  [default: where that is shorter]", optional=True,
        group=DRAWINGS,
    )  # fmt: skip
    completion: str = setting(
        ON, "choice", "Do not guess the hidden parts of shapes.", choices=(ON, OFF), hidden=True, group=DRAWINGS
    )
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
    def may_overlap(self) -> bool:
        """True if shapes may show others through: not with chosen fills, nor in a cutout."""
        return self.free_fills and self.stacking != CUTOUT

    @property
    def free_fills(self) -> bool:
        """True if fills are the picture's own, so that gradients and translucent shapes are possible."""
        return self.colors is None and not self.palette

    def public(self) -> dict[str, Any]:
        """Return plain values for the metrics file and the settings hash."""
        return asdict(self) | {"palette": ["#{:02x}{:02x}{:02x}".format(*color) for color in self.palette]}


def _triple(colour: Any) -> tuple[int, int, int]:
    """Return the 8-bit sRGB of a colour's name, or of three numbers. Raises UsageError for others."""
    if isinstance(colour, str):
        return parse_colour(colour, "palette", "must be colours such as #ffcc00 or teal, with commas between them")
    if not isinstance(colour, (tuple, list)) or len(colour) != 3 or not all(v in range(256) for v in colour):
        raise UsageError(f"takes colours of three values from 0 to 255, not {colour!r}", "palette")
    return int(colour[0]), int(colour[1]), int(colour[2])
