"""The areas and lines in which a picture differs visibly from its drawing.

A pixel is unexplained by as much as it lies outside of all colours that are drawn within a px or so of it: edges that
are a little off are none. What is left is averaged over squares and along short lines, so that noise goes and lines of
one px stay.
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.channels import widened
from cubicsplat_cli.artwork.input.chroma import LUMA_CHROMA
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.palette import UNLIKE, ringing
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.observed import unexplained
from cubicsplat_cli.record import record

SIDE = 5  # px, of the lines along which residuals are averaged
OWN = 0.5  # of the mean around it that a pixel is off itself
NOISY = 3.0  # standard deviations of the noise, in the mean of SIDE px
SEAM = 8.0  # levels that edges of a clean picture may be off: half of one of 4 x 4 samples a pixel
MARGIN = 5  # px around an area that are looked at with it
# Px times levels of an area that people see, and px of a shape, in a clean picture: a dot of a px; and in one with
# noise: 60 px of what is just unlike, or a short line.
LEAST_CLEAN, SMALLEST_CLEAN = 160.0, 1
LEAST, SMALLEST = 60.0 * UNLIKE, 6


@record
class Area:
    """rows, columns: its window on the canvas. where: (h, w) bool, its pixels. weight: what it adds to the error."""

    rows: slice
    columns: slice
    where: np.ndarray
    weight: float


@record
class ErrorModel:
    """The errors that a picture may have beside its drawing.

    noise: standard deviation in levels; error: that of pixels on edges. jpeg: whether edges ring. blur: standard
    deviation, px. least: px times levels of an area. smallest: px of a shape. seam: levels by which what lies beneath
    shows through on edges.
    """

    noise: float
    error: float
    jpeg: bool
    blur: float
    least: float
    smallest: float
    seam: float

    @property
    def clean(self) -> bool:
        """Whether every difference is one of the drawing."""
        return self.seam > 0.0

    @classmethod
    def of(cls, condition: Condition, min_area: float) -> ErrorModel:
        sharp, seam = condition.clean and not condition.aliased, SEAM if condition.clean else 0.0
        least, smallest = (LEAST_CLEAN, SMALLEST_CLEAN) if sharp else (LEAST, SMALLEST)
        errors = condition.noise, condition.edge_error, condition.jpeg, condition.blur
        return cls(*errors, least, max(smallest, min_area), seam)


@record
class TargetPicture:
    """The picture that drawings are compared with. levels: (H, W, 4); model: of its errors; ringing: (H, W, 4) levels
    by which a JPEG's edges are off in luma and chroma, else 0.
    """

    levels: np.ndarray
    model: ErrorModel
    ringing: np.ndarray

    @classmethod
    def of(cls, levels: np.ndarray, model: ErrorModel) -> TargetPicture:
        """A picture with such errors."""
        seen = levels @ LUMA_CHROMA
        return cls(levels, model, ringing(seen) if model.jpeg else np.zeros(seen.shape, np.float32))


def areas(picture: TargetPicture, painted: np.ndarray) -> list[Area]:
    """The areas in which a picture is unlike what is painted, (H, W, 4) in levels, the worst first."""
    model = picture.model
    allowed = UNLIKE + NOISY * model.noise / SIDE**0.5
    judged = 1 + math.ceil(model.blur), model.seam, UNLIKE, OWN, allowed
    gap, where = unexplained(picture.levels, painted, LUMA_CHROMA, picture.ringing, *judged)
    if gap[where].sum() < model.least:
        return []
    reach = MARGIN + math.ceil(2.0 * model.blur)
    parts, _ = ndimage.label(ndimage.binary_dilation(where, ndimage.SQUARE), ndimage.SQUARE)
    found = []
    for number, box in enumerate(ndimage.find_objects(parts), start=1):
        rows, columns = widened(box, reach, gap.shape)
        own = where[rows, columns] & (parts[rows, columns] == number)
        off = gap[rows, columns][own]
        if off.sum() >= model.least:
            found.append(Area(rows, columns, own, float((off**2).sum())))
    return sorted(found, key=lambda area: -area.weight)
