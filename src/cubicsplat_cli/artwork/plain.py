"""Pictures of one colour, which nothing need be fitted to."""

from __future__ import annotations

from cubicsplat_cli.artwork.names import shape_name
from cubicsplat_cli.artwork.outlines import Rectangle
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.paint import Ink

_ROWS = 64


def only_ink(picture: Picture) -> Ink | None:
    """The colour of every pixel, (0, 0, 0, 0) where all are transparent; None where there are several."""
    planes = [picture.rgb] if picture.alpha is None else [picture.rgb, picture.alpha[..., None]]
    for plane in planes:
        # Most pictures are known by their first rows.
        for top in range(0, picture.height, _ROWS):
            if (plane[top : top + _ROWS] != plane[0, 0]).any():
                return None
    red, green, blue = (round(255 * float(v)) for v in picture.rgb[0, 0])
    return red, green, blue, 255 if picture.alpha is None else round(255 * float(picture.alpha[0, 0]))


def plain_drawing(ink: Ink, width: int, height: int) -> Drawing:
    """A rectangle of one ink over the whole canvas; nothing where the ink is transparent."""
    outlines = (Rectangle(0.0, 0.0, float(width), float(height)),)
    shape = Shape(ink, outlines, shape_name(ink, outlines, width, height))
    return Drawing(width, height, (shape,) if ink[3] else ())
