"""The shadow of a box, or of what is round, in gradients: four strips, four corners and a middle, or one radial.

The pieces lie on whole pixels and abut. Along a side the shadow changes in one direction only; around a corner it is
nearly round, so there it is the circular or elliptic gradient nearest to what shows of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import ndimage

from cubicsplat_cli.artwork.geometry.outlines import Ellipse, Outline, Rectangle
from cubicsplat_cli.artwork.gradients.shades import gradient_of, shade_of
from cubicsplat_cli.artwork.shapes import Shape
from cubicsplat_cli.scene.paint import Gradient, mean_ink, painted

NAME = "shadow"
FAINT = 0.5  # levels of shade that a piece begins at
CORNER = 1.75  # sigmas, besides the radius, from a side to where its corner ends
SHOWN = 48  # px of a piece that show, for it to be fitted to these alone
ALIKE, RADII = 0.6, 33  # px by which an outline may be off a box or an ellipse in the mean; radii tried
# Levels that what shows may be off in its worst hundredth: for a shadow to be drawn in these pieces, and for corners
# not to be tried with less room.
WORST, GOOD, NARROW = 8.0, 3.5, 1.1


@dataclass(frozen=True)
class Cast:
    """What one thing shades. share: (h, w) 0..1; shown: (h, w) bool where that is seen; colour: (3,) levels; own:
    (h, w) coverage of the silhouette, moved; sigma: px; corner: (x, y) of the window in the picture."""

    share: np.ndarray
    shown: np.ndarray
    colour: np.ndarray
    own: np.ndarray
    sigma: float
    corner: tuple[int, int]


def sliced(cast: Cast) -> list[Shape] | None:
    """The shapes of a shadow, which do not overlap; None where what casts it is neither a box nor round."""
    circle = _round(cast.own)
    box = None if circle else _box(cast.own)
    if not circle and box is None:
        return None
    rows, columns = np.nonzero(255.0 * cast.share > FAINT)
    if len(rows) == 0:
        return []
    frame = (int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1)
    if box is None:
        shapes = _whole(cast, frame)
        return shapes if _worst(cast, shapes) <= WORST else None
    trials: list[tuple[float, int, list[Shape]]] = []
    for corner in (CORNER, NARROW):
        shapes = _nine(cast, frame, box, corner)
        trials.append((_worst(cast, shapes), len(trials), shapes))
        if trials[-1][0] <= GOOD:
            break
    worst, _, shapes = min(trials)
    return shapes if worst <= WORST else None


def _nine(
    cast: Cast, frame: tuple[int, int, int, int], box: tuple[float, float, float, float, float], corner: float
) -> list[Shape]:
    """Nine pieces, or fewer where there is no room for all."""
    left, top, right, bottom, radius = box
    reach = radius + corner * cast.sigma
    xs = _cuts(frame[0], frame[2], left, right, reach)
    ys = _cuts(frame[1], frame[3], top, bottom, reach)
    return [
        _piece(cast, Rectangle(float(x0), float(y0), float(x1 - x0), float(y1 - y0)))
        for y0, y1 in pairwise(ys)
        for x0, x1 in pairwise(xs)
        if x1 > x0 and y1 > y0
    ]


def _cuts(first: int, last: int, low: float, high: float, reach: float) -> list[int]:
    """Where a shadow from `first` to `last` of a box from `low` to `high` is cut: its ends, and where corners end."""
    middle = 0.5 * (low + high)
    one, other = round(min(low + reach, middle)), round(max(high - reach, middle))
    inner = [int(np.clip(cut, first, last)) for cut in (one, max(other, one))]
    return [first, *inner, last]


def _whole(cast: Cast, frame: tuple[int, int, int, int]) -> list[Shape]:
    x0, y0, x1, y1 = frame
    return [_piece(cast, Ellipse(0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (x1 - x0) + 1.0, 0.5 * (y1 - y0) + 1.0))]


def _piece(cast: Cast, outline: Rectangle | Ellipse) -> Shape:
    """One piece, in px of the window, as a shape in px of the picture."""
    rows, columns = np.nonzero(_covered(outline, cast.share.shape) & cast.shown)
    if len(rows) < SHOWN:
        rows, columns = np.nonzero(_covered(outline, cast.share.shape))
    alpha = cast.share[rows, columns]
    values = np.column_stack([alpha[:, None] * cast.colour, 255.0 * alpha])
    dx, dy = cast.corner
    gradient: Gradient | None = None
    if 255.0 * float(np.ptp(alpha)) > 2.0 * FAINT:
        gradient = gradient_of(shade_of(columns + dx + 0.5, rows + dy + 0.5, values))
        ink = mean_ink(gradient)
    else:
        red, green, blue = (round(float(v)) for v in cast.colour)
        ink = (red, green, blue, round(255.0 * float(alpha.mean())))
    moved: Outline
    if isinstance(outline, Rectangle):
        moved = Rectangle(outline.x + dx, outline.y + dy, outline.width, outline.height)
    else:
        moved = Ellipse(outline.cx + dx, outline.cy + dy, outline.rx, outline.ry)
    return Shape(ink, (moved,), NAME, gradient)


def _covered(outline: Outline, shape: tuple[int, ...]) -> np.ndarray:
    """(h, w) bool the pixels whose middles an outline holds."""
    y, x = np.arange(shape[0])[:, None] + 0.5, np.arange(shape[1])[None] + 0.5
    if isinstance(outline, Rectangle):
        inside_x = (x > outline.x) & (x < outline.x + outline.width)
        return inside_x & (y > outline.y) & (y < outline.y + outline.height)
    assert isinstance(outline, Ellipse)
    return ((x - outline.cx) / outline.rx) ** 2 + ((y - outline.cy) / outline.ry) ** 2 < 1.0


def _worst(cast: Cast, shapes: list[Shape]) -> float:
    """Levels by which the worst hundredth of what shows is off."""
    rows, columns = np.nonzero(cast.shown)
    dx, dy = cast.corner
    alpha = np.zeros(cast.share.shape)
    for shape in shapes:
        (outline,) = shape.outlines
        if isinstance(outline, Rectangle):
            own = _covered(Rectangle(outline.x - dx, outline.y - dy, outline.width, outline.height), alpha.shape)
        else:
            assert isinstance(outline, Ellipse)
            own = _covered(Ellipse(outline.cx - dx, outline.cy - dy, outline.rx, outline.ry), alpha.shape)
        y, x = np.nonzero(own)
        if shape.gradient is None:
            alpha[own] = shape.ink[3] / 255.0
        else:
            alpha[own] = painted(shape.gradient, x + dx + 0.5, y + dy + 0.5)[:, 3]
    off = 255.0 * np.abs(alpha - cast.share)[rows, columns]
    return float(np.percentile(off[255.0 * cast.share[rows, columns] > FAINT], 99)) if len(off) else 0.0


def _box(own: np.ndarray) -> tuple[float, float, float, float, float] | None:
    """Left, top, right and bottom side and radius of the level box that a coverage (h, w) is; None where it is none."""
    if float(own.sum()) < 9.0:
        return None
    row, column = (round(float(v)) for v in ndimage.center_of_mass(own))
    across = _extent(own[max(row - 1, 0) : row + 2].mean(axis=0))
    down = _extent(own[:, max(column - 1, 0) : column + 2].mean(axis=1))
    if across is None or down is None:
        return None
    (left, right), (top, bottom) = across, down
    half = 0.5 * np.array([right - left, bottom - top])
    x = np.abs(np.arange(own.shape[1])[None] + 0.5 - 0.5 * (left + right)) - half[0]
    y = np.abs(np.arange(own.shape[0])[:, None] + 0.5 - 0.5 * (top + bottom)) - half[1]
    best, least = 0.0, math.inf
    for radius in np.linspace(0.0, float(half.min()), RADII):
        beyond = np.hypot(np.maximum(x + radius, 0.0), np.maximum(y + radius, 0.0))
        distance = beyond + np.minimum(np.maximum(x, y) + radius, 0.0) - radius
        off = float(np.abs(np.clip(0.5 - distance, 0.0, 1.0) - own).sum())
        if off < least:
            best, least = float(radius), off
    return (left, top, right, bottom, best) if least <= ALIKE * 4.0 * float(half.sum()) else None


def _extent(line: np.ndarray) -> tuple[float, float] | None:
    """Where a line of coverages (n,) goes up through a half first, and down last."""
    inside = np.flatnonzero(line >= 0.5)
    if len(inside) < 3:
        return None
    padded = np.concatenate([[0.0], line, [0.0]])
    first, last = int(inside[0]) + 1, int(inside[-1]) + 1
    low = first - (padded[first] - 0.5) / max(float(padded[first] - padded[first - 1]), 0.5)
    high = last + (padded[last] - 0.5) / max(float(padded[last] - padded[last + 1]), 0.5)
    # Middles of pixels lie half a px from their sides.
    return low - 0.5, high - 0.5


def _round(own: np.ndarray) -> bool:
    """Whether a coverage (h, w) is an ellipse, which its moments tell."""
    total = float(own.sum())
    if total < 9.0:
        return False
    cy, cx = ndimage.center_of_mass(own)
    y, x = np.arange(own.shape[0])[:, None] - cy, np.arange(own.shape[1])[None] - cx
    xx, yy, xy = (float((own * v).sum()) / total for v in (x * x, y * y, x * y))
    form = np.linalg.inv(4.0 * np.array([[xx, xy], [xy, yy]]))
    whole = form[0, 0] * x * x + 2.0 * form[0, 1] * x * y + form[1, 1] * y * y <= 1.0
    return float(np.abs(whole - own).sum()) <= ALIKE * 4.0 * (math.sqrt(xx) + math.sqrt(yy)) * 1.6
