"""Primitives that their pixels do not bear out, given up for rings.

Points of thin and small shapes are known to a tenth of a px or worse, and then a leaf is as good as an ellipse. The
pixels know better: what they hold against a primitive may be worth more than the parameters that a ring has besides.
"""

from __future__ import annotations

from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Rectangle, Ring

# Half of the excess of chi^2 that a pixel must have on average: twice as much as by chance. Over the many pixels of a
# large circle even what one of its neighbours spoils is worth a ring's parameters.
CLEARLY = 0.5


def as_path(shape: Circle | Ellipse | Rectangle, chi: float, price: float, crossed: int) -> Ring | None:
    """The ring to try in a primitive's place; None where all that its pixels hold against it, half of the excess of
    chi^2, is worth less than the ring's further parameters at so many nats each, or is little for the pixels crossed.

    Rectangles that stand level stay: drawing programs with few samples a pixel know their sides to a quarter of one,
    and sides that slant would fit that better than they fit the drawing.
    """
    if isinstance(shape, Rectangle) and shape.angle == 0.0:
        return None
    ring = shape.ring()
    return ring if chi > max(price * (ring.parameters - shape.parameters), CLEARLY * crossed) else None
