"""Primitives: how many of the truth's the file has as such, and how many of the file's the truth has."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from skimage.draw import polygon2mask
from skimage.measure import find_contours

from benchmarks.artwork.document import Document
from benchmarks.artwork.outlines import NEAR_SHARE, OFF, Form, forms_of, kind_of
from benchmarks.artwork.pieces import LEAST_SEEN, DrawingPieces

SEEN = 0.5  # share of a primitive, and of its outline, that must show
BESIDE = 1.0  # px to either side of an outline at which what shows must differ
PLACE, PLACE_SHARE = 0.5, 0.01  # px, and share of its size, that each side of the box around a primitive may be off
SIDE_SEEN = 2.0  # px of a side that must show
ON_SIDE, CORNER = 0.75, 1.5  # px from a side in which a point lies on it, if it lies farther than CORNER from others
LEVEL = 0.1  # px by which a level side may rise
# A circle or an ellipse whose outline shows by more than the first share, and lies on edges of the truth by the second,
# is not judged: the picture does not show how the hidden rest goes on.
LEAST_VISIBLE, NEARLY_ALL = 1.0 / 3.0, 0.95
EVERY = np.ones(4, dtype=bool)  # sides
FINEST, WIDEST = 8, 2048  # most times that flat areas of the truth are enlarged, and most px across then
STEP = 0.75  # of these px, to which their edges are known
MARGIN = 3  # px of the truth around an outline
WITHIN = 0.5  # px inside an outline, where its area is sampled

Box = tuple[str, np.ndarray]


def primitive_counts(
    truth: Document, pieces: DrawingPieces, made: Document, own_pieces: DrawingPieces
) -> tuple[int, int, int, int]:
    """(recalled, expected, right, written): recalled / expected is the recall, right / written the precision.

    Primitives are circles and ellipses, rectangles, and rounded rectangles, in the truth also where they are written
    as paths; two are the same if their kinds and bounding boxes agree. Expected are those of the truth that mostly
    show, with most of their outline; recalled are those that the file has as primitives. Written are the file's that
    show; right are those that match an outline of the truth, or a flat area visible in it. A side of a rectangle that
    shows nowhere might be anywhere: a rectangle of the truth with such a side is not expected, and of the file's only
    the other sides must agree; turned ones are left out. So are circles and ellipses of which a third or more shows,
    all on edges of the truth: the picture does not show how they go on.
    """
    forms = [form for form in forms_of(truth) if form.near]
    every = [form for form in forms_of(made) if form.written and form.near]
    size = np.array([truth.width, truth.height], dtype=float)
    expected = [form for form in forms if form.kind and _shows(form, pieces)]
    written = [form for form in every if _matters(form, own_pieces)]
    boxes = [(form.near, box) for form in every for box in _boxes(form, size)]
    recalled = sum(_among(form.near, _boxes(form, size), boxes) for form in expected)
    candidates = [(form.near, box) for form in forms for box in _boxes(form, size)]
    right = judged = 0
    for form in written:
        own, visible = _boxes(form, size), visible_sides(form, own_pieces)
        if not visible.any():
            continue
        view = View(truth, form.points)
        good = _among(form.near, own, candidates, visible) or _among(
            form.near, own, _areas_seen(form, view, size), visible
        )
        right += good
        judged += good or not _open(form, own_pieces, view)
    return recalled, len(expected), right, judged


def _shows(form: Form, pieces: DrawingPieces) -> bool:
    """Whether most of a primitive and of its outline on the canvas shows, and all sides of its bounding box do."""
    mask = _mask(form, pieces)
    if (mask & (pieces.element == form.element)).sum() < max(LEAST_SEEN, SEEN * mask.sum()):
        return False
    _, on_canvas, _, edge = _edge(form, pieces)
    return bool(not on_canvas.any() or edge[on_canvas].mean() >= SEEN) and bool(visible_sides(form, pieces).all())


def visible_sides(form: Form, pieces: DrawingPieces) -> np.ndarray:
    """(4,) bool: whether the picture shows where the left, top, right and bottom of a primitive's bounding box are.

    Of an upright rectangle: the sides of which a part shows or lies on the canvas's border. Of a turned one: all or
    none. Of a round one: all, since any part determines the others.
    """
    if form.near not in ("box", "rounded"):
        return EVERY
    points, on_canvas, own, edge = _edge(form, pieces)
    along = np.roll(form.points, -1, axis=0) - form.points
    direction = along[int(np.hypot(*along.T).argmax())]
    level = np.abs(direction).min() < LEVEL
    direction = np.array([1.0, 0.0]) if level else direction / np.hypot(*direction)
    turned = points @ np.array([[direction[0], -direction[1]], [direction[1], direction[0]]])
    ends = np.concatenate([turned.min(axis=0), turned.max(axis=0)])
    off = np.abs(np.tile(turned, 2) - ends)
    # A corner belongs to both of its sides and tells of neither.
    near = (off <= ON_SIDE) & (np.minimum(off[:, [1, 0, 1, 0]], off[:, [3, 2, 3, 2]]) > CORNER)
    seen = near & (edge | (own & ~on_canvas))[:, None]
    # Points are half a px apart.
    visible = seen.sum(axis=0) >= np.minimum(2.0 * SIDE_SEEN, 0.5 * near.sum(axis=0))
    return visible if level else np.full(4, visible.all())


def _edge(form: Form, pieces: DrawingPieces) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, 2) along a form's outline; which of them lie well on the canvas, at which of them it shows, and shows
    against something else, (n,) bool each.
    """
    points, inwards = _evenly(form.points)
    inner, outer = (np.floor(points - inwards * (0.5 * form.width + side)).astype(int) for side in (-BESIDE, BESIDE))
    size = np.array(pieces.shape[::-1])
    inside, around = (((place >= 0) & (place < size)).all(axis=1) for place in (inner, outer))
    (column, row), (outer_column, outer_row) = (np.clip(place, 0, size - 1).T for place in (inner, outer))
    # A hole's element lies around it.
    within = inside & (pieces.element[row, column] == form.element)
    own: np.ndarray = within | (around & (pieces.element[outer_row, outer_column] == form.element))
    edge = own & inside & around & (pieces.shown[row, column] != pieces.shown[outer_row, outer_column])
    return points, np.asarray(inside & around), own, edge


def _evenly(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 2) about half a px apart along a closed outline, and the unit vectors (n, 2) inwards there."""
    closed = np.vstack([points, points[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    at = np.linspace(0.0, along[-1], max(8, int(2.0 * along[-1])), endpoint=False)
    even = np.stack([np.interp(at, along, closed[:, c]) for c in (0, 1)], axis=1)
    direction = np.roll(even, -1, axis=0) - np.roll(even, 1, axis=0)
    x, y = even.T
    clockwise = float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) > 0.0
    left = np.stack([-direction[:, 1], direction[:, 0]], axis=1) / np.maximum(np.hypot(*direction.T), 1e-9)[:, None]
    return even, left if clockwise else -left


def _matters(form: Form, pieces: DrawingPieces) -> bool:
    """Whether enough of a primitive shows, within it or, where it is a hole, around it."""
    mask = _mask(form, pieces)
    near = ndimage.binary_dilation(mask, iterations=2) & (pieces.element == form.element)
    return bool(min(mask.sum(), near.sum()) >= LEAST_SEEN)


def _mask(form: Form, pieces: DrawingPieces) -> np.ndarray:
    return polygon2mask(pieces.shape, form.points[:, ::-1] - 0.5)


def _boxes(form: Form, size: np.ndarray) -> list[np.ndarray]:
    """(4,) left, top, right, bottom on the canvas; of a stroke those of its outer and its inner edge too."""
    half = 0.5 * form.width
    return [_box(form.points, size, offset) for offset in ((0.0, half, -half) if half else (0.0,))]


def _box(points: np.ndarray, size: np.ndarray, offset: float = 0.0) -> np.ndarray:
    return np.clip([points.min(axis=0) - offset, points.max(axis=0) + offset], 0.0, size).ravel()


def _areas_seen(form: Form, view: View, size: np.ndarray) -> list[Box]:
    """The kinds of, and the boxes around, the areas of one colour that show in the truth in a form's place."""
    points, inwards = _evenly(form.points)
    return [(kind, _box(around, size)) for kind, around in view.areas(points, inwards)]


def _open(form: Form, pieces: DrawingPieces, view: View) -> bool:
    """Whether the truth has edges all along what shows of a circle or an ellipse, a third of it at least."""
    points, _, _, edge = _edge(form, pieces)
    if form.near != "round" or edge.mean() < LEAST_VISIBLE:
        return False
    off = OFF + NEAR_SHARE * float(np.ptp(form.points, axis=0).max())
    return bool(view.edges(points[edge], _evenly(form.points)[1][edge], off).mean() >= NEARLY_ALL)


def _among(kind: str, boxes: list[np.ndarray], others: list[Box], visible: np.ndarray = EVERY) -> bool:
    """Whether a box agrees with another one of its kind. visible: (4,) bool, the sides that must."""
    same_kind = [other for other_kind, other in others if other_kind == kind]
    return any(
        bool((np.abs(box - other) <= PLACE + PLACE_SHARE * float((box[2:] - box[:2]).max()))[visible].all())
        for box in boxes
        for other in same_kind
    )


class View:
    """The truth about an outline, enlarged and without smoothing. colours: (h, w) uint32, empty off the canvas."""

    def __init__(self, truth: Document, points: np.ndarray) -> None:
        """points: (n, 2) px along the outline."""
        size = np.array([truth.width, truth.height], dtype=float)
        self.low = np.clip(np.floor(points.min(axis=0)) - MARGIN, 0.0, size)
        extent = (np.clip(np.ceil(points.max(axis=0)) + MARGIN, 0.0, size) - self.low).astype(int)
        self.colours = np.zeros((0, 0), dtype=np.uint32)
        if (extent > 0).all():
            self.scale = max(1, min(FINEST, WIDEST // int(extent.max())))
            window = (int(self.low[0]), int(self.low[1]), int(extent[0]), int(extent[1]))
            pixels = truth.draw(self.scale, window=window, smooth=False)
            self.colours = np.ascontiguousarray(pixels).view(np.uint32)[..., 0]

    def areas(self, points: np.ndarray, inwards: np.ndarray) -> list[tuple[str, np.ndarray]]:
        """The kind of, and the points (n, 2) px around, the areas of one colour that fill most of an outline's middle
        and most of its rim, as a ring does; holes count as filled. inwards: (n, 2) unit.
        """
        if not self.colours.size:
            return []
        middle = polygon2mask(self.colours.shape, (points - self.low)[:, ::-1] * self.scale - 0.5)
        rim = np.zeros_like(middle)
        rim[self._places(points + WITHIN * inwards)] = True
        return [self._area(inside) for inside in (middle, rim) if inside.any()]

    def edges(self, points: np.ndarray, inwards: np.ndarray, off: float) -> np.ndarray:
        """(n,) bool: whether colours differ between `off` px within and without points of an outline."""
        if not self.colours.size:
            return np.zeros(len(points), dtype=bool)
        inner, outer = (self.colours[self._places(points + way * inwards)] for way in (off, -off))
        return inner != outer

    def _places(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        place = np.floor((points - self.low) * self.scale).astype(int)
        height, width = self.colours.shape
        return np.clip(place[:, 1], 0, height - 1), np.clip(place[:, 0], 0, width - 1)

    def _area(self, inside: np.ndarray) -> tuple[str, np.ndarray]:
        values, counts = np.unique(self.colours[inside], return_counts=True)
        labels, _ = ndimage.label(self.colours == values[counts.argmax()])
        area = labels == np.bincount(labels[inside & (labels > 0)]).argmax()
        # The outermost contour; a ring of px of other colour makes it closed along the window.
        edges = find_contours(np.pad(ndimage.binary_fill_holes(area), 1).astype(float), 0.5)
        points = (max(edges, key=len)[:-1, ::-1] - 0.5) / self.scale + self.low
        return kind_of(points, NEAR_SHARE, STEP / self.scale), points
