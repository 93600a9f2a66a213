"""Names of shapes for an editor's list of layers."""

from __future__ import annotations

import colorsys

from cubicsplat_cli.artwork.geometry.outlines import Outline, Rectangle
from cubicsplat_cli.scene.paint import Rgba

# Hues in degrees up to which a colour has this name.
_HUES = ((15, "red"), (42, "orange"), (68, "yellow"), (160, "green"), (195, "teal"), (255, "blue"), (290, "purple"))
_HUES_END = ((335, "pink"), (361, "red"))


def shape_name(fill: Rgba, outlines: tuple[Outline, ...], width: int, height: int) -> str:
    """ "background" for a rectangle over the whole canvas, else the plain name of the fill's colour."""
    first = outlines[0]
    if isinstance(first, Rectangle) and first.width >= width - 0.5 and first.height >= height - 0.5:
        return "background"
    return colour_name(fill)


def colour_group(fill: Rgba) -> str:
    """The name of a group of one colour, `color-ff8800`, with two more digits where it is translucent."""
    return "color-{:02x}{:02x}{:02x}".format(*fill[:3]) + ("" if fill[3] == 255 else f"{fill[3]:02x}")


def colour_name(fill: Rgba) -> str:
    """The plain name of a colour: black, white, grey, brown, pink or a hue."""
    hue, lightness, saturation = colorsys.rgb_to_hls(*(v / 255.0 for v in fill[:3]))
    if lightness < 0.08:
        return "black"
    if lightness > 0.95:
        return "white"
    if saturation < 0.12:
        return "grey"
    name = next(word for end, word in _HUES + _HUES_END if hue * 360.0 < end)
    if name in ("red", "orange") and lightness < 0.35:
        return "brown"
    return "pink" if name == "red" and lightness > 0.75 else name
