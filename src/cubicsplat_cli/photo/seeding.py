"""Places of new curves: all over the picture at the start of a fit, later at high errors.

There they are ellipses over connected patches in which the fit errs in one way. LIVE (Ma et al., CVPR 2022) starts its
paths at connected components of the error; here the patch around a drawn pixel is described by the moments of its
residual, which needs no labelling and treats all pixels at once. That says nothing about how well a shape of a kind
covers a patch: of restricted shapes many are tried, and those taken that take away most of the error.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from cubicsplat_cli.photo import initial
from cubicsplat_cli.photo.initial import colour_to_logits, control_points, picture_colours_at
from cubicsplat_cli.photo.state import Background, FitCurves
from cubicsplat_cli.raster.native import native
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.arrays import Array, as_numpy, block_means, contiguous, like, namespace
from cubicsplat_cli.scene.shapes import TEMPLATES, polygon_points
from cubicsplat_cli.settings import ANY, FitSettings, Mode

RESIDUAL_BLUR = 5  # px; a single pixel's residual is noise
GRID = 12  # samples of a patch on each side of its centre
GRID_REACH = 2.0  # of the window's sigma
SIZE_SPREAD = 0.6  # of the logarithm of the window's sigma, so that all sizes are tried
LEAST_SIGMA = 1.5  # px
LEAST_VARIANCE = 0.5  # px^2, added: no patch is thinner than a pixel or so
# A uniform ellipse has semi-axes of 2 standard deviations; the window cuts patches off, hence a little less.
AXES = 1.6
STROKE_WOBBLE = 0.3  # px
TRIES, MOVES = 200, 100  # of each shape; four times as many make fits no better (docs/lab/photos.md)
LEAST, MOST = 1.0 / 16.0, 4.0  # half-axes of what is tried, in length units
FINENESS = 16.0  # px: a length unit in the copy of the picture on which shapes are tried
ROUND = 16  # corners of an ellipse there


@record
class Seeder:
    """Makes new curves for a fit to a target (H, W, C).

    generator: draws all random numbers on the host, so that they are the same for every device. background: of the
    curves. weights: (H, W), of the pixels. The arrays are on one device, which does the work.
    """

    settings: FitSettings
    generator: np.random.Generator
    background: Background
    target: Array
    weights: Array | None = None

    @cached_property
    def unit(self) -> float:
        """The unit of the recipe's lengths, px."""
        height, width, _ = self.target.shape
        return self.settings.recipe.unit(width, height, self.settings.curves) * spread_of(self.weights) ** 0.5

    def first(self) -> FitCurves:
        """Return the usual start of a fit: discs or strokes at random places."""
        centres = random_centres(self.settings.curves, self.target, self.generator, self.weights)
        points = control_points(centres, self.settings.recipe.start_size * self.unit, self.settings, self.generator)
        return self._curves(points, picture_colours_at(centres, self.target))

    def seeds(self, count: int, image: Array) -> FitCurves:
        """Return new curves at places where the picture (H, W, C) is far from the target."""
        recipe = self.settings.recipe
        density = error_density(image, self.target, recipe.seed_blur, recipe.seed_power, self.weights)
        if self.settings.shapes != ANY and self.target.shape[2] == 3:
            return self._placed(count, image, density)
        centres = draw_pixels(density, count, self.generator)
        size = recipe.seed_size * self.unit
        if recipe.seeding == "blobs":
            places, axes, colours = find_blobs(centres, image, self.target, size, self.generator, self.weights)
            return self._curves(blob_points(places, axes, self.settings, self.generator), colours)
        points = control_points(centres, size, self.settings, self.generator)
        return self._curves(points, picture_colours_at(centres, self.target))

    def _placed(self, count: int, image: Array, density: Array) -> FitCurves:
        """Return restricted shapes, tried on the host at places of this density (H, W)."""
        settings, weights = self.settings, None if self.weights is None else as_numpy(self.weights)
        centres = as_numpy(draw_pixels(density, count * TRIES, self.generator)).reshape(count, TRIES, 2)
        opacity = 1.0 / (1.0 + math.exp(-initial.first_opacity(settings.recipe)))
        points, colours = place_shapes(
            settings.shapes, settings.segments, as_numpy(self.target), as_numpy(image), weights, centres, self.unit,
            opacity, self.generator,
        )  # fmt: skip
        return self._curves(like(image, points), colour_to_logits(like(image, colours)))

    def _curves(self, points: Array, colours: Array) -> FitCurves:
        height, width, _ = self.target.shape
        half_width = self.settings.recipe.half_width_size * self.unit
        return initial.new_curves(points, colours, half_width, self.settings, (width, height), self.background)


def spread_of(weights: Array | None) -> float:
    """Return the share of the picture over which curves will spread: 1 for even weights; if one region alone has
    weight, its share. It is the square of the weights' mean over the mean of their squares.
    """
    if weights is None:
        return 1.0
    values = namespace(weights).astype(weights, namespace(weights).float64)
    return float(values.mean()) ** 2 / float((values * values).mean())


def error_density(image: Array, target: Array, blur: int, power: float, weights: Array | None = None) -> Array:
    """Return the density (H, W) of new curves: weighted squared error, blurred by a box of `blur` px, to a power."""
    difference = image - target
    difference *= difference
    error = sum(difference[..., channel] for channel in range(target.shape[2]))  # a sum over an axis takes longer
    return box_mean(error if weights is None else error * weights, blur) ** power


def random_centres(count: int, target: Array, generator: np.random.Generator, weights: Array | None = None) -> Array:
    """Return random places (n, 2) px, by the pixels' weights and opacities."""
    xp, (height, width, channels) = namespace(target), target.shape
    if channels == 4 or weights is not None:
        there = xp.clip(target[..., 3], min=1e-6) if channels == 4 else xp.ones_like(target[..., 0])
        return draw_pixels(there if weights is None else there * weights, count, generator)
    return like(target, generator.random((count, 2)) * (width, height))


def draw_pixels(density: Array, count: int, generator: np.random.Generator) -> Array:
    """Return centres (count, 2) of pixels drawn, with replacement, in proportion to a density (H, W) >= 0."""
    xp, (height, width) = namespace(density), density.shape
    total = xp.cumulative_sum(xp.reshape(density, (-1,)), dtype=xp.float64)
    share = like(total, generator.random(count))
    pixels = height * width
    pixel = xp.clip(xp.searchsorted(total, share * total[-1], side="right"), max=pixels - 1)
    # Without any density all are alike; decided without a look at the value, which would wait for a GPU.
    pixel = xp.where(total[-1] > 0, pixel, xp.clip(xp.astype(share * pixels, pixel.dtype), max=pixels - 1))
    return xp.astype(xp.stack([pixel % width, pixel // width], axis=-1), xp.float32) + 0.5


def find_blobs(
    seeds: Array, image: Array, target: Array, sigma: float, generator: np.random.Generator,
    weights_of_pixels: Array | None = None,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return patches around seeds (n, 2) px in which image and target (H, W, C) differ as they do at the seed: centres
    (n, 2) px; semi-axes (n, 2, 2) px as columns, the shorter first; and logits (n, 3) of the target's mean colour.

    The weight of a pixel is the share of its residual along the seed's, squared, times a Gaussian window of about
    `sigma` px, times its own weight (H, W).
    """
    xp, (height, width) = namespace(seeds), target.shape[:2]
    spread = np.exp(SIZE_SPREAD * generator.standard_normal(len(seeds)))
    windows = like(seeds, np.clip(sigma * spread, LEAST_SIGMA, 0.1 * min(width, height) + LEAST_SIGMA))
    steps = np.arange(-GRID, GRID + 1) * (GRID_REACH / GRID)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(1, -1, 2)
    places = seeds[:, None] + like(seeds, offsets) * windows[:, None, None]
    whole = xp.astype(xp.floor(places), xp.int64)
    x, y = whole[..., 0], whole[..., 1]
    on_canvas = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    x, y = xp.clip(x, 0, width - 1), xp.clip(y, 0, height - 1)
    residual, own = _blurred(target - image), xp.astype(seeds, xp.int64)
    likeness = _likeness(residual[y, x], residual[own[:, 1], own[:, 0]])
    window = on_canvas * like(seeds, np.exp(-0.5 * np.square(offsets).sum(axis=-1)))
    if weights_of_pixels is not None:
        window = window * (weights_of_pixels[y, x] + 1e-6)  # a seed drawn beside all that matters keeps its patch
    weights = window * likeness * likeness
    # A seed drawn beside an error, in its blur, has no residual of its own: then the window is the patch.
    weights = xp.where(xp.sum(weights, axis=1, keepdims=True) > 1e-3, weights, window)
    weights = weights / xp.sum(weights, axis=1, keepdims=True)
    centres = xp.sum(weights[..., None] * places, axis=1)
    away = places - centres[:, None]
    covariance = xp.permute_dims(weights[..., None] * away, (0, 2, 1)) @ away
    colours = xp.sum(weights[..., None] * target[y, x], axis=1)
    return centres, AXES * _principal_axes(covariance), colour_to_logits(colours)


def blob_points(centres: Array, axes: Array, settings: FitSettings, generator: np.random.Generator) -> Array:
    """Return control points (n, K, 2): rings around the patches, or strokes along their longer axes."""
    n = len(centres)
    if settings.mode is Mode.CLOSED:
        ring = like(centres, initial.random_ring(n, 3 * settings.segments, generator))
        return contiguous(centres[:, None] + ring @ namespace(centres).permute_dims(axes, (0, 2, 1)))
    k = 3 * settings.segments + 1
    along = like(centres, np.linspace(-1.0, 1.0, k))[None, :, None] * axes[:, None, :, 1]
    wobble = like(centres, STROKE_WOBBLE * generator.standard_normal((n, k, 2)))
    return contiguous(centres[:, None] + along + wobble)


def box_mean(planes: Array, size: int) -> Array:
    """Return the mean of the pixels in the window of `size` x `size` px (odd) around each pixel of (..., H, W).

    On the CPU one axis after the other, by adding shifted copies: torch's pooling takes fifteen times as long there. On
    a GPU it is one call in place of thirty, each of which costs more than the work.
    """
    if not isinstance(planes, np.ndarray):
        from torch.nn.functional import avg_pool2d

        stack = planes.reshape(1, -1, *planes.shape[-2:])
        return avg_pool2d(stack, size, 1, size // 2, count_include_pad=False).reshape(planes.shape)
    half = size // 2
    for axis in (-1, -2):
        total = planes.copy()
        values, sums = planes.swapaxes(axis, -1), total.swapaxes(axis, -1)
        length = values.shape[-1]
        for shift in range(1, min(half, length - 1) + 1):
            sums[..., :-shift] += values[..., shift:]
            sums[..., shift:] += values[..., :-shift]
        index = np.arange(length)
        sums /= (np.minimum(index + half, length - 1) - np.maximum(index - half, 0) + 1).astype(planes.dtype)
        planes = total
    return planes


def _principal_axes(covariance: Array) -> Array:
    """Return the principal axes of covariances (n, 2, 2) times their standard deviations, as columns; shorter first.

    In closed form: a solver's start on a GPU takes longer than the whole reallocation.
    """
    xp = namespace(covariance)
    xx, xy, yy = covariance[:, 0, 0] + LEAST_VARIANCE, covariance[:, 0, 1], covariance[:, 1, 1] + LEAST_VARIANCE
    middle, half_range = 0.5 * (xx + yy), xp.hypot(0.5 * (xx - yy), xy)
    angle = 0.5 * xp.atan2(xy, 0.5 * (xx - yy))  # of the longer axis
    cos, sin = xp.cos(angle), xp.sin(angle)
    longer = xp.stack([cos, sin], axis=-1) * xp.sqrt(middle + half_range)[:, None]
    variance = xp.clip(middle - half_range, min=LEAST_VARIANCE)  # never less, but for rounding
    shorter = xp.stack([-sin, cos], axis=-1) * xp.sqrt(variance)[:, None]
    return xp.stack([shorter, longer], axis=-1)


def _blurred(residual: Array) -> Array:
    xp = namespace(residual)
    if residual.shape[-1] == 4:
        # Over black and over white, as the loss sees it: black on nothing differs in alpha alone.
        residual = xp.concat([residual[..., :3], residual[..., :3] - residual[..., 3:]], axis=-1)
    planes = contiguous(xp.permute_dims(residual, (2, 0, 1)))
    return xp.permute_dims(box_mean(planes, RESIDUAL_BLUR), (1, 2, 0))


def _likeness(residuals: Array, own: Array) -> Array:
    """Return the share of each pixel's residual (n, p, 3) along the seed's (n, 3), in units of that, in [0, 1]."""
    xp = namespace(own)
    along = xp.sum(residuals * own[:, None], axis=-1)
    return xp.clip(along / xp.clip(xp.sum(own * own, axis=-1, keepdims=True), min=1e-8), 0.0, 1.0)


def place_shapes(
    kind: str, segments: int, target: np.ndarray, image: np.ndarray, weights: np.ndarray | None,
    centres: np.ndarray, unit: float, opacity: float, generator: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return shapes of a kind that bring a picture (H, W, 3) nearer to the target when they go in front of it, by the
    pixels' weights (H, W): control points (n, K, 2) px and colours (n, 3). centres: (n, `TRIES`, 2) px, the places at
    which each is tried. unit: the length unit, px.
    """
    count, scale = len(centres), max(1, min(int(unit / FINENESS), *target.shape[:2]))
    goal, canvas = block_means(target, scale), block_means(image, scale)
    importance = None if weights is None else block_means(weights[..., None], scale)
    ring = TEMPLATES[kind][:, 1:] if kind in TEMPLATES else polygon_points(_circle(segments)[None])[0]
    outline = np.ascontiguousarray(_circle(ROUND) if kind == "ellipse" else ring[::3], np.float32)
    sizes = math.log(unit / scale) + generator.uniform(math.log(LEAST), math.log(MOST), (count, TRIES, 2))
    angles = generator.uniform(0.0, 2.0 * math.pi, (count, TRIES, 2))
    moves = generator.standard_normal((count, MOVES, 6)).astype(np.float32)
    if kind in TEMPLATES:  # the outline stays in line with the axes
        angles[..., 1], moves[..., 5] = 0.0, 0.0
    tries = np.concatenate((centres / scale, angles[..., :1], sizes, angles[..., 1:]), axis=-1).astype(np.float32)
    found = np.empty((count, 9), np.float32)
    native(
        "placing", "cs_place", goal, importance, canvas, *goal.shape[:2], outline, len(outline), float(opacity), tries,
        TRIES, moves, MOVES, count, found, result=None,
    )  # fmt: skip
    found = found[::-1]  # from front to back
    axes = scale * np.exp(found[:, None, 3:5])
    points = found[:, None, :2] * scale + (ring @ _turned(found[:, 5]) * axes) @ _turned(found[:, 2])
    return points.astype(np.float32), found[:, 6:]


def _circle(corners: int) -> np.ndarray:
    """Return points (n, 2) evenly on the unit circle."""
    angles = np.arange(corners) * (2.0 * math.pi / corners)
    return np.stack((np.cos(angles), np.sin(angles)), axis=1)


def _turned(angles: np.ndarray) -> np.ndarray:
    """Return the matrices (n, 2, 2) that turn rows of coordinates by angles (n,)."""
    c, s = np.cos(angles), np.sin(angles)
    return np.stack((c, s, -s, c), axis=1).reshape(-1, 2, 2)
