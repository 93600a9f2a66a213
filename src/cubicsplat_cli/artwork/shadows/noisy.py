"""The soft shadows and glows of pictures with noise or JPEG artefacts: blurred copies of what stands on even grounds.

Noise hides where a shadow ends, and ringing what it is like beside the shapes that cast it. So it is not taken from the
pixels, as in a clean picture, but fitted to them as programs make it: the silhouettes M_k on the ground, moved by d and
blurred by a Gaussian of standard deviation sigma, leave shares s(p) = sum_k alpha_k (G_sigma * M_k)(p - d) of a colour.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from cubicsplat_cli.artwork.channels import commonest, in_blocks, largest
from cubicsplat_cli.artwork.gradients.noisy import roughness
from cubicsplat_cli.artwork.gradients.parts import LEAST_AREA as LEAST_EVEN
from cubicsplat_cli.artwork.gradients.parts import LEAST_PLATEAU, RING, smooth_parts
from cubicsplat_cli.artwork.gradients.shade import CLOSE
from cubicsplat_cli.artwork.input.condition import NEAR_EDGES, Condition
from cubicsplat_cli.artwork.input.palette import calm_pixels
from cubicsplat_cli.artwork.input.restore import seen_as
from cubicsplat_cli.artwork.shadows.casters import LEAST_RANGE, end_of
from cubicsplat_cli.artwork.shadows.lifting import Lifted, without_areas
from cubicsplat_cli.artwork.shadows.shadow import BLURS, MOST_MOVED
from cubicsplat_cli.artwork.shadows.soft import LEAST_AREA, Line, SoftArea
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import STRANGE

BLUR = 1.0  # px by which noise is smoothed
SOFT_BEND = 4.0  # levels of a second difference after that, which no edge of 20 levels or more falls short of
RIM = 2  # px by which edges are wider after that, on either side
# Times the error up to which shade is a shadow's foot, and the rounds in which all of it is found from that.
FOOT, ROUNDS = 3.0, 3
MOST_CASTERS = 6  # with an opacity of their own; the smaller ones share one
FITTED, SAMPLES = 256, 2000  # px of the longer side of what shadows are fitted to; shaded pixels of it, and others
MOVED = 5.0  # px of the first offsets
# Share of the shade by which the nearest of these may be off, and of its pixels that a fit must explain at least, since
# ringing hides some.
MISFIT, SHOWN = 0.5, 0.75


def noisy_lifted(levels: np.ndarray, condition: Condition, areas: tuple[SoftArea, ...] | None = None) -> Lifted:
    """Return a picture (H, W, 4), premultiplied levels, of a condition without its soft shadows; the same array if it
    has none. areas: those to remove, if they are known."""
    if areas is None:
        areas = tuple(_areas(levels, condition)) if levels[..., 3].min() == 255.0 else ()
    if not areas:
        return Lifted(levels)
    even, _ = ndimage.large_parts(calm_pixels(levels, condition.noise)[0], LEAST_EVEN)
    return without_areas(levels, even, areas, roughness(condition), STRANGE)


def _areas(levels: np.ndarray, condition: Condition) -> Iterator[SoftArea]:
    """Yield the soft areas of an opaque picture (H, W, 4) in levels and of a condition."""
    rough = roughness(condition)
    seen = ndimage.gaussian_filter(levels, (BLUR, BLUR, 0.0), mode="nearest")
    parts = smooth_parts(seen, SOFT_BEND, np.inf)
    sizes, _, spreads = parts.measured
    uneven = np.append(False, (sizes >= LEAST_AREA) & (spreads > LEAST_RANGE * rough))
    if not uneven.any():
        return
    for fill in _grounds(seen[calm_pixels(levels, condition.noise)[0]], int(LEAST_PLATEAU * parts.numbers.size), rough):
        work().at()
        if (area := _area(seen - fill, fill, parts.numbers, uneven, CLOSE * rough, seen_as(condition))) is not None:
            yield area


def _grounds(values: np.ndarray, least: int, rough: float) -> Iterator[np.ndarray]:
    """Yield the commonest colours (4,) of even pixels (n, 4), each of at least so many."""
    while len(values) >= least:
        near = largest(np.abs(values - commonest(np.rint(values).astype(float), 1, 1))) <= rough
        if near.sum() < least:
            return
        yield np.rint(np.median(values[near], axis=0)).astype(float)
        values = values[~near]


def _area(
    off: np.ndarray, fill: np.ndarray, parts: np.ndarray, uneven: np.ndarray, error: float, told: np.ndarray
) -> SoftArea | None:
    """Return the soft area on a ground of a fill, to an error in levels; None if no blur of what stands there is one.
    off: (H, W, 4) levels from the fill. parts: (H, W) their numbers; uneven: (n,) bool, which of them are. told:
    (4, 4) as of `seen_as`."""
    far = largest(np.abs(off))
    smooth = (uneven & (np.bincount(parts[far <= error], minlength=len(uneven)) > 0))[parts]
    even = smooth & (far <= error)
    # All pixels tell the colour of a shade best; where it meets others as dark, only its foot tells it.
    for most in (np.inf, FOOT * error):
        on_ground = _on_ground(off, fill, even, smooth, smooth & (far <= most), error)
        if on_ground is None or (best := _best(*on_ground)) is None:
            continue
        line, (shown, field, _) = on_ground[0], best
        # Beside edges luma rings, and chroma is blurred.
        rim = ndimage.binary_dilation(shown, ndimage.SQUARE, iterations=RING)
        rim &= np.linalg.norm(line.apart(field) @ told, axis=2) <= NEAR_EDGES * error
        shown = ndimage.binary_propagation(shown, None, rim)
        return SoftArea(fill, shown, fill + line.way, field, error / CLOSE)
    return None


def _on_ground(
    off: np.ndarray, fill: np.ndarray, even: np.ndarray, smooth: np.ndarray, ground: np.ndarray, error: float
) -> tuple[Line, np.ndarray, np.ndarray] | None:
    """Return the line of colours from a ground to its shade, and (H, W) bool the pixels of the ground, and all, on it;
    None without a shadow that ends on the ground. off, fill, error: as of `_area`. even: (H, W) bool, pixels of the
    fill; smooth: what hangs together with them; ground: those of them that may show the ground."""
    among, following = off[smooth], np.zeros_like(smooth)
    for _ in range(ROUNDS):
        shaded = ground & ~even
        if min(shaded.sum(), even.sum()) < LEAST_AREA:
            return None
        way = end_of(fill, off[shaded].sum(axis=0, dtype=float)) - fill
        following[smooth] = Line(among, way, error).shaded
        ground = ndimage.binary_propagation(even, None, following)
    line = Line(off, way, error)
    return line, ground, line.shaded


def _best(line: Line, ground: np.ndarray, on_line: np.ndarray) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Return the best of what is `_tried` for pixels that may show a ground, (H, W) bool; None if none is good enough.
    on_line: (H, W) bool, pixels that have colours of the line."""
    # Dark shadows end in edges of their own beside a shape, and glows have its colour.
    beside = on_line & ndimage.binary_dilation(ground, ndimage.SQUARE, iterations=RING)
    near, wide = (ndimage.binary_propagation(ground, None, others) for others in (beside, on_line))
    masks = [ground, near] if np.array_equal(near, wide) else [ground, near, wide]
    tried = [each for each in (_tried(line, shown) for shown in masks) if each[2] > SHOWN]
    # A rim alone may also show where a much darker shadow ends.
    return max(tried, key=lambda each: (each[1].max() < 1.0, each[2]), default=None)


def _tried(line: Line, shown: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return (H, W) bool the pixels of a ground, (H, W) the shares of the shadow fitted to them, and the share of the
    dark ones that it explains."""
    clear = ndimage.binary_erosion(shown, ndimage.SQUARE, iterations=RIM, border_value=1)
    field = _fitted(line, _silhouettes(shown), clear)
    if not field.any():
        return shown, field, 0.0
    dark = clear & (line.scale * np.maximum(line.shares, field) > line.error)
    explained = line.near(field) & (line.scale * field > 0.5 * line.error)
    return shown, field, float(explained[dark].mean()) if dark.any() else 0.0


def _fitted(line: Line, casters: np.ndarray, clear: np.ndarray) -> np.ndarray:
    """Return (H, W) the shares, 0 to 1, of a shadow, fitted to those seen in pixels that are clear, (H, W) bool; zeros
    if nothing casts one, or too few pixels show it. casters: (H, W) as of `_silhouettes`."""
    seen, scale, step = line.shares, line.scale, -(-max(clear.shape) // FITTED)
    wanted, usable = (in_blocks(each.astype(np.float32), step).mean((2, 3)).ravel() for each in (seen, clear))
    wanted, order, count = scale * wanted, np.random.default_rng(0), int(casters.max()) + 1
    dark, usable = wanted > LEAST_RANGE, usable == 1.0
    if not count or not (usable & dark).any():
        return np.zeros(seen.shape)
    from scipy.optimize import least_squares, nnls  # takes a while to import, and few pictures need it

    blocks = in_blocks(casters, step)
    places = np.arange(blocks[..., 0, 0].size).reshape(*blocks.shape[:2], 1, 1) * count + blocks
    shown = np.bincount(places[blocks >= 0], minlength=len(wanted) * count).reshape(*blocks.shape[:2], count)
    small = (shown / step**2).astype(np.float32)
    at = np.concatenate([order.permutation(np.flatnonzero(usable & some))[:SAMPLES] for some in (dark, ~dark)])
    wanted = wanted[at]

    def parts(place: Sequence[float] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the opacities (K,) with which a shadow is nearest, and the levels (n, K) that these give it."""
        blurred = scale * _blurred(small, *place).reshape(-1, count)[at].astype(float)
        found, _ = nnls(blurred, wanted.astype(float))
        return found, blurred * found

    def off(place: Sequence[float] | np.ndarray) -> np.ndarray:
        return parts(place)[1].sum(axis=1) - wanted

    def unlike(place: tuple[float, float, float]) -> float:
        return float(np.abs(off(place)).sum())

    # The best blur right below the casters, then the best offset with it.
    moved = (-MOVED / step, 0.0, MOVED / step)
    log_blur = min((math.log(blur / step) for blur in BLURS), key=lambda blur: unlike((0.0, 0.0, blur)))
    begin = min(product(moved, moved, [log_blur]), key=unlike)
    if unlike(begin) > MISFIT * float(np.abs(wanted).sum()):
        return np.zeros(seen.shape)
    ends = np.array([MOST_MOVED / step, MOST_MOVED / step, math.log(MOST_MOVED / step)])
    least = np.append(-ends[:2], -math.log(step))
    fit = least_squares(off, begin, bounds=(least, ends), diff_step=0.02, loss="soft_l1", f_scale=CLOSE, max_nfev=12)
    dx, dy, blur = fit.x
    found, seen_parts = parts(fit.x)
    # What shades no pixel plainly casts no shadow.
    strong = np.append(np.where(seen_parts.max(axis=0) > CLOSE, found, 0.0), 0.0).astype(np.float32)[casters]
    return np.clip(_blurred(strong[..., None], dx * step, dy * step, blur + math.log(step))[..., 0], 0.0, 1.0)


def _silhouettes(ground: np.ndarray) -> np.ndarray:
    """Return (H, W) the numbers, from 0 on, of the largest shapes on a ground (H, W) bool, and the next one of all
    others; -1 elsewhere."""
    inner = ndimage.binary_erosion(~ground, ndimage.SQUARE, iterations=RIM, border_value=1)
    labels, count = ndimage.label(inner, ndimage.SQUARE)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    rank = np.argsort(np.argsort(-sizes, kind="stable"))
    return np.append(-1, np.minimum(rank, MOST_CASTERS))[labels]


def _blurred(masks: np.ndarray, dx: float, dy: float, log_blur: float) -> np.ndarray:
    """Return masks (H, W, K) moved by dx, dy px and blurred by a Gaussian of standard deviation exp(log_blur) px."""
    blur = math.exp(log_blur)
    for axis, moved in ((0, dy), (1, dx)):
        reach = math.ceil(4.0 * blur + abs(moved))
        weights = np.exp(-0.5 * ((np.arange(-reach, reach + 1) + moved) / blur) ** 2)
        masks = ndimage.correlate1d(masks, weights / weights.sum(), axis=axis, mode="nearest")
    return masks
