"""Objects of a shaded picture: areas within strong edges, however much the colours within change.

`objects_of` finds them. `silhouettes` gives them flat fills, from which their outlines follow. `shown` tells their
shares of pixels, and `base_paint` their flat fill or linear gradient. Where text and lines lie on smooth shading,
`surfaces_of` finds that alone, and `without_surfaces` the picture without it, of which all else is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.gradients.flattening import placeholders, with_placeholders
from cubicsplat_cli.artwork.gradients.noisy import roughness
from cubicsplat_cli.artwork.gradients.parts import smooth_parts
from cubicsplat_cli.artwork.gradients.shade import CLOSE, Ramp, Shade, gradient_of
from cubicsplat_cli.artwork.gradients.shades import shade_of
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.palette import calm_pixels
from cubicsplat_cli.artwork.regions.fills import OPAQUE, SEEN
from cubicsplat_cli.artwork.regions.regions import FlatPicture
from cubicsplat_cli.artwork.shadows.noisy import BLUR, SOFT_BEND
from cubicsplat_cli.artwork.shadows.soft import inwards
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import Pixels, best_colours, blends, nearest_paints
from cubicsplat_cli.raster.unmix import STRANGE
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.arrays import with_channels
from cubicsplat_cli.scene.paint import Gradient, Rgba

STEEP = 8.0  # levels per px of an edge of 20 levels after the blur, steeper than shading
LEAST_AREA = 24  # px of an object away from edges
# An edge changes as much within NEAR px to both sides as within FAR; a ramp changes by NEAR / FAR of that. An edge
# exceeds a ramp by LEAST_STEP levels.
NEAR, FAR, LEAST_STEP = 2.0, 5.0, 16.0
EDGE = 2  # px on both sides of a border with blended pixels
REACH, SLOTS = 4, 3  # px to the objects of a blend, and the most objects that meet
SURE = np.array([1.0, 1.0, 1.0, 8.0])  # the weights of the channels: opacity is reliable within shading too
CLEAR = 128.0  # levels of opacity, below which an object is the transparent ground
ANGLES, STOPS = 16, 4
LEAST_GAIN = 4.0  # levels^2 of mean square error that each stop of a gradient must save, since less is invisible
FEWEST = 8  # px that a gradient is fitted to
FULL = 0.995  # share of a pixel that counts as all of it
LEAST_SURFACE = 0.02  # share of a picture; smaller ones are drawn as all else
RINGING = 4  # px beside edges in which a JPEG's ringing is strongest, half of its blocks


def objects_of(levels: np.ndarray) -> np.ndarray:
    """Return (H, W) int32 the object of each pixel, numbered from 0 on, of a picture (H, W, 4), premultiplied levels.
    Thin lines and small spots belong to the object below them; clear ones belong to the ground.
    """
    from skimage.segmentation import watershed  # few pictures need it

    size, directions = _slopes(levels)
    areas, count = ndimage.large_parts(size < STEEP, LEAST_AREA)
    if not count:
        return np.zeros(levels.shape[:2], np.int32)
    areas[levels[..., 3] < 1.0] = count + 1
    labels = watershed(size, areas)
    while len(weak := _weak_borders(levels, labels, directions)):
        labels = _united(labels, weak)
    _, labels = np.unique(labels, return_inverse=True)
    return np.asarray(labels.reshape(levels.shape[:2]), np.int32)


def _slopes(levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the steepest channel's slope (H, W) in levels per px, and its direction (2, H, W), across and down."""
    # 0.8 px, about the blur of an anti-aliased edge.
    smooth = ndimage.gaussian_filter(levels, (0.8, 0.8, 0.0), mode="nearest")
    down, across = np.gradient(smooth, axis=(0, 1))
    sizes = np.hypot(across, down)
    steepest = sizes.argmax(axis=2)[..., None]
    size, u, v = (np.take_along_axis(each, steepest, 2)[..., 0] for each in (sizes, across, down))
    return size, np.stack([u, v]) / np.maximum(size, 1e-6)


def _weak_borders(levels: np.ndarray, labels: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return (n, 2) the pairs of neighbouring labels with a ramp, no edge, between them, the weakest first."""
    height, width = labels.shape
    pairs, steps = [], []
    for dy, dx in ((0, 1), (1, 0)):
        first, second = labels[: height - dy, : width - dx], labels[dy:, dx:]
        y, x = np.nonzero(first != second)
        pairs.append(np.sort(np.stack([first[y, x], second[y, x]], axis=1), axis=1))
        steps.append(_steps(levels, directions[:, y, x], y + 0.5 * dy, x + 0.5 * dx))
    step = np.concatenate(steps)
    borders, which = np.unique(np.concatenate(pairs), axis=0, return_inverse=True)
    order = np.lexsort((step, which := which.reshape(-1)))
    ends = np.searchsorted(which[order], np.arange(len(borders) + 1))
    medians = step[order][(ends[:-1] + ends[1:] - 1) // 2]
    weakest = np.argsort(medians, kind="stable")
    return borders[weakest[medians[weakest] < LEAST_STEP]]


def _steps(levels: np.ndarray, directions: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return (n,) levels by which the picture changes along directions (2, n) at y, x, beyond the change of a ramp."""
    height, width = levels.shape[:2]

    def at(reach: float) -> np.ndarray:
        row = np.clip(np.rint(y + reach * directions[1]), 0, height - 1).astype(int)
        return levels[row, np.clip(np.rint(x + reach * directions[0]), 0, width - 1).astype(int)]

    def change(reach: float) -> np.ndarray:
        return np.asarray(np.abs(at(reach) - at(-reach)).max(axis=1))

    return change(NEAR) - NEAR / FAR * change(FAR)


def _united(labels: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Return the labels with each of these pairs united, unless one of the two was united before."""
    becomes, used = np.arange(labels.max() + 1), set()
    for first, second in pairs.tolist():
        if first not in used and second not in used:
            used |= {first, second}
            becomes[second] = first
    return becomes[labels]


def silhouettes(levels: np.ndarray, labels: np.ndarray) -> FlatPicture:
    """Return a picture (H, W, 4) of premultiplied levels with its objects, labels (H, W), in placeholder fills. The
    shares of objects in a pixel follow from the colours of each a few px away.
    """
    count = int(labels.max()) + 1
    alpha = np.bincount(labels.ravel(), levels[..., 3].ravel(), count) / np.bincount(labels.ravel(), minlength=count)
    fills = _fills(alpha >= CLEAR)
    inside = _insides(labels)
    y, x = np.nonzero(~inside)
    paint = np.where(inside, labels, -1).astype(np.int32)
    paints, places = nearest_paints(paint, np.flatnonzero(~inside), REACH, SLOTS)
    colours = _continued(levels, paint, y, x, places)
    flat, _ = blends(levels[y, x] * SURE, paints, colours * SURE, fills[np.maximum(paints, 0)], True)
    out = fills[labels]
    out[y, x] = np.clip(flat, 0.0, 255.0)
    return FlatPicture(out.astype(np.float32), fills, labels)


def _insides(labels: np.ndarray) -> np.ndarray:
    """Return (H, W) bool, true for pixels of one object alone, and for the middle of objects too thin for these."""
    inside = ndimage.alike(labels, 2 * EDGE + 1)
    y, x = np.nonzero(~inside)
    paints, _ = nearest_paints(np.where(inside, labels, -1).astype(np.int32), np.flatnonzero(~inside), REACH, SLOTS)
    thin = (paints != labels[y, x, None]).all(axis=1)
    y, x = y[thin], x[thin]
    depth = ndimage.distance_transform_edt(np.pad(ndimage.alike(labels, 3), 1))[1:-1, 1:-1]
    inside[y, x] = (depth >= ndimage.maximum_filter(depth, 3))[y, x]
    return inside


def _continued(levels: np.ndarray, paint: np.ndarray, y: np.ndarray, x: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return (n, slots, 4) the colours of objects at y, x (n,), extrapolated from their pixels `places` (n, slots)."""
    height, width = paint.shape
    row, column = np.divmod(places, width)
    behind = 2 * row - y[:, None], 2 * column - x[:, None]
    far = tuple(np.clip(each, 0, most - 1) for each, most in zip(behind, (height, width), strict=True))
    own = paint[far] == paint[row, column]
    far = np.where(own, far[0], row), np.where(own, far[1], column)
    near = levels[row, column].astype(float)
    out = np.clip(2.0 * near - levels[far], 0.0, 255.0)
    out[..., 3] = near[..., 3]
    return np.asarray(out)


def _fills(opaque: np.ndarray) -> np.ndarray:
    """Return (n, 4) different fills in whole levels for opaque objects (n,) bool, and clear ones for others. They lie
    on a sphere, so that none is a blend of two others, about equally far apart.
    """
    count, fills = int(opaque.sum()), np.zeros((len(opaque), 4))
    number = np.arange(count)
    height = 1.0 - (2.0 * number + 1.0) / count
    turn = math.pi * (3.0 - math.sqrt(5.0)) * number
    radius = np.sqrt(1.0 - height**2)
    sphere = np.stack([height, radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    fills[opaque, :3] = np.rint(127.5 + 127.0 * sphere)
    fills[opaque, 3] = 255.0
    return fills


@record
class Surface:
    """Smooth shading that no gradient explains. mask: (H, W) bool, the pixels that show it; colours: (H, W, 4) levels,
    continued beneath what lies on it."""

    mask: np.ndarray
    colours: np.ndarray

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the colours (n, 4) at columns and rows (n,)."""
        return self.colours[y, x]


def surfaces_of(levels: np.ndarray, condition: Condition) -> list[Surface]:
    """Return the opaque surfaces of a picture (H, W, 4), premultiplied levels, of a condition, the largest first."""
    rough = 1.0 if condition.clean else roughness(condition)
    if not condition.clean:
        levels = ndimage.gaussian_filter(levels, (BLUR, BLUR, 0.0), mode="nearest")
    parts = smooth_parts(levels) if condition.clean else smooth_parts(levels, SOFT_BEND, np.inf)
    numbers, (sizes, *_) = parts.numbers, parts.measured
    out, free = list[Surface](), levels[..., 3] >= OPAQUE
    for number in parts.uneven(math.ceil(LEAST_SURFACE * numbers.size), LEAST_STEP):
        part = parts.part(number)
        mask = (numbers == number) & free
        if mask.sum() < sizes[number - 1] or (shade_of(part.pixels).off(part.pixels) <= CLOSE * rough).mean() >= 0.5:
            continue
        # Letters have holes, in which it goes on.
        off = largest(np.abs(inwards(levels, mask) - levels))
        means = np.bincount(numbers.ravel(), off.ravel(), parts.count + 1) / np.append(np.inf, sizes)
        mask |= (means <= LEAST_STEP)[numbers] & (numbers > 0) & free
        if not condition.clean:
            mask = ndimage.binary_erosion(mask, ndimage.SQUARE, iterations=RINGING, border_value=1)
        colours = inwards(levels, mask)
        alike = free & (largest(np.abs(colours - levels)) <= SEEN * rough)
        mask = ndimage.binary_propagation(mask, None, mask | alike)
        free &= ~mask
        out.append(Surface(mask, colours))
    return out


def without_surfaces(
    levels: np.ndarray, surfaces: Sequence[Surface], condition: Condition
) -> tuple[np.ndarray, np.ndarray]:
    """Return a picture (H, W, 4) in levels, of a condition, with placeholders for its surfaces, and these (n, 4)."""
    if condition.clean:
        parts, line = smooth_parts(levels).numbers, SEEN
    else:
        parts, line = ndimage.large_parts(calm_pixels(levels, condition.noise)[0], LEAST_AREA)[0], STRANGE
    means = [np.rint(levels[surface.mask].mean(axis=0)) for surface in surfaces]
    fills = np.array(placeholders(means, levels.reshape(-1, 4)))
    paint = np.where(parts > 0, parts + len(surfaces) - 1, -1).astype(np.int32)
    for number, surface in enumerate(surfaces):
        paint[surface.mask] = number
    return with_placeholders(levels, paint, [surface.at for surface in surfaces], fills, line), fills


def shown(drawing: Drawing) -> list[np.ndarray]:
    """Return for each shape the share (H, W) of each pixel that it covers and no shape above does."""
    clear = np.ones((drawing.height, drawing.width))
    shares = []
    for shape in reversed(drawing.shapes):
        own = shape.coverage(0, 0, drawing.height, drawing.width)
        shares.append(own * clear)
        clear = clear * (1.0 - own * (shape.fill[3] / 255.0))
    return shares[::-1]


def base_paint(values: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[Rgba, Gradient | None]:
    """Return the opaque fill nearest to straight levels (n, 3), n >= 1, at x and y, and a gradient if it is nearer."""
    middle = values.mean(axis=0)
    red, green, blue = (int(np.clip(round(v), 0, 255)) for v in middle.tolist())
    fill = (red, green, blue, 255)
    if len(x) < FEWEST:
        return fill, None
    pixels = Pixels(x + 0.5, y + 0.5, with_channels(values, 4, 255.0))
    shades = [_along(math.pi * k / ANGLES, stops, pixels) for k in range(ANGLES) for stops in (2, STOPS)]

    def cost(shade: Shade) -> float:
        return float((shade.residuals(pixels)[:, :3] ** 2).mean()) + LEAST_GAIN * len(shade.ramp.knots)

    best = min(shades, key=cost)
    return fill, gradient_of(best) if cost(best) < float(((values - middle) ** 2).mean()) else None


def _along(angle: float, stops: int, pixels: Pixels) -> Shade:
    """Return the gradient at an angle with so many stops, evenly between the outermost pixels."""
    frame = np.array([[math.cos(angle), math.sin(angle), 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    t = frame[0, 0] * pixels.x + frame[0, 1] * pixels.y
    knots = np.linspace(float(t.min()), float(t.max()) + 1e-3, stops)
    colours = np.clip(best_colours(frame, False, knots, pixels), 0.0, 255.0)
    colours[:, 3] = 255.0
    return Shade(frame, False, Ramp(knots, colours), 2)
