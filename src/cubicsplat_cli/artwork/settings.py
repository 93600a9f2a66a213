"""What the user chooses of the artwork style. Imports nothing heavy, since the command line is built from it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.settings import setting, settings_of

MOST_COLORS = 256
# Upper shapes lie on lower ones, or all abut and share their edges.
STACKED, CUTOUT = "stacked", "cutout"
# What upper shapes hide goes on beneath them, or ends there as shortly as it may.
ON, OFF = "on", "off"


@dataclass(frozen=True)
class ArtworkSettings:
    """How a flat picture is drawn. Raises UsageError on values that make no sense.

    colors: at most so many inks, 1..256, or None for as many as the picture has. palette: the inks to use, 8-bit sRGB
    or empty for the picture's own. min_area: px^2, smaller regions join a neighbour. detail: 1 weighs outlines as
    the picture supports them, more follows it more closely, less draws with fewer pieces; 0.01..100. stacking:
    "stacked" or "cutout". completion: "on" or "off", whether outlines go on beneath what hides them as what shows
    suggests, and pieces of one ink are one shape there. curves: at most so many shapes, or None.
    """

    colors: int | None = setting(
        None, "count", "Artwork: at most so many inks.", least=1, most=MOST_COLORS, optional=True, group="Quality"
    )
    palette: tuple[tuple[int, int, int], ...] = ()
    min_area: float = setting(
        0.0, "number", "Artwork: regions smaller than this join a neighbour.", most=1e9, metavar="PX", group="Quality"
    )
    detail: float = setting(
        1.0,
        "number",
        "Artwork: more follows the picture more closely, less has fewer pieces.",
        least=0.01,
        most=100.0,
        group="Quality",
    )
    stacking: str = setting(
        STACKED,
        "choice",
        "Artwork: shapes that reach beneath others (stacked), or abut (cutout), for cutters.",
        choices=(STACKED, CUTOUT),
        group="Quality",
    )
    completion: str = setting(
        ON,
        "choice",
        "Artwork: hidden parts go on as what shows of them suggests (on), or end shortly (off).",
        choices=(ON, OFF),
        group="Quality",
    )
    curves: int | None = None

    def __post_init__(self) -> None:
        for each, known in settings_of(ArtworkSettings):
            known.check(each.name, getattr(self, each.name))
        if len(self.palette) > MOST_COLORS:
            raise UsageError(f"takes at most {MOST_COLORS} colours, not {len(self.palette)}", "palette")
        for color in self.palette:
            if len(color) != 3 or not all(isinstance(v, int) and 0 <= v <= 255 for v in color):
                raise UsageError(f"takes colours of three values from 0 to 255, not {color!r}", "palette")

    @property
    def free_inks(self) -> bool:
        """Whether inks are the picture's own, of which gradients and translucent shapes may be made."""
        return self.colors is None and not self.palette

    def public(self) -> dict[str, Any]:
        """Plain values for the metrics file and the settings hash."""
        return asdict(self) | {"palette": ["#{:02x}{:02x}{:02x}".format(*color) for color in self.palette]}


def parse_palette(text: str) -> tuple[tuple[int, int, int], ...]:
    """Colours with commas between them, #rgb, #rrggbb or CSS names; UsageError for anything else."""
    from PIL import ImageColor

    colours: list[tuple[int, int, int]] = []
    for part in text.split(","):
        colour: tuple[int, ...]
        try:
            colour = ImageColor.getrgb(part.strip().lower())
        except ValueError:
            colour = ()
        if len(colour) != 3:
            raise UsageError(f"must be colours such as #ffcc00 with commas between them, not {text!r}", "palette")
        colours.append((colour[0], colour[1], colour[2]))
    return tuple(colours)
