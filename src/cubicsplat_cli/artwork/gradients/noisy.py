"""Gradients of pictures with noise, JPEG artefacts or blur: found in the means of windows that a plane explains.

The mean of a window is what a linear ramp has at its middle, and much less noisy than a pixel. In a picture that is
only blurred they are sought as in clean ones, away from edges, or in windows, where these show clearly more; and
followed up to the edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.gradients.areas import gradient_areas
from cubicsplat_cli.artwork.gradients.flattening import Flattened, without_areas
from cubicsplat_cli.artwork.gradients.parts import Patch, smooth_parts
from cubicsplat_cli.artwork.gradients.shade import Shade, ShadedArea
from cubicsplat_cli.artwork.input.chroma import LUMA_CHROMA
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.palette import UNLIKE, calm_pixels
from cubicsplat_cli.artwork.input.restore import JPEG_TIMES, MISFIT, seen_as
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import Pixels
from cubicsplat_cli.raster.unmix import STRANGE

WINDOW = 7  # px
# What a plane leaves of a window: times the noise, of which what is white or black shows half, but in a JPEG it is that
# near edges; and levels. Levels per px, beyond which a ramp may be two fills.
LEFT, JPEG_LEFT, LEFT_LEVELS, STEEPEST = 1.6, 1.25, 0.7, 6.0
# A ramp that does most of its change within so many px is an edge between two fills.
SHORTEST, MOST_CHANGE = 12.0, 0.5
# Times as far as in a clean picture are windows off their gradient: of a JPEG; and of noise, per level beyond once.
JPEG_ROUGH, NOISE_ROUGH = 3.0, 0.5
LEAST_RANGE, LEAST_AREA = 12.0, 400  # levels across a gradient, and px of windows that show it
# Px by which windows stay away from edges, within which pixels are the gradient's that are off by so many times the
# noise and levels; in a JPEG noise near edges is greater; and times what restoring it expects there.
GROWN, NEAR, NEAR_LEVELS, JPEG_NEAR, RESTORED = 5, 3.0, 2.0, 6.0, 2.0
# Px of a hole in a gradient that belongs to it, where no pixel is off by more levels: the tip of a radial one.
LARGEST_HOLE, MOST_OFF = 150, 64.0
MEAN = 5  # px each way, of whose mean chroma tells as much as luma
LEAST_EVEN = 40  # px of what is even: less is the rest of a gradient at its rim
# Px that a gradient is followed for where there is no noise, and the share of an even part beside it that it must
# explain for that to be its own.
FARTHEST, MOSTLY = 40, 0.9
EDGE = 6.0  # standard deviations of a blur, which an edge is wide
MORE = 1.5  # times the pixels that windows must show gradients in


def without_noisy_gradients(
    levels: np.ndarray,
    condition: Condition,
    found: Sequence[ShadedArea] | None = None,
    known: Sequence[ShadedArea] = (),
) -> Flattened:
    """A picture (H, W, 4), premultiplied levels, of a condition, without its gradients. found: those that it is known
    to have beside those known, which are as a result has them, or in place of what of these they cover; by default
    those that windows show.
    """
    calm, _ = calm_pixels(levels, condition.noise)
    even, covered = ndimage.large_parts(calm, LEAST_EVEN)[0], np.zeros(levels.shape[:2], dtype=bool)
    new = plane_areas(levels, condition) if found is None else found
    for area in new:
        covered[area.patch.window] |= area.patch.mask
    areas = [area for area in known if 2 * covered[area.patch.window][area.patch.mask].sum() < area.patch.size]
    areas += [_grown(levels, area, condition, even) for area in new]
    flat = without_areas(levels, even, _to_the_nearest(levels, areas, condition), STRANGE)
    return replace(flat, areas=tuple(areas))


def plane_areas(levels: np.ndarray, condition: Condition) -> list[ShadedArea]:
    """The gradients of a picture (H, W, 4), premultiplied levels, and the windows that show them."""
    means, smooth = _planes(levels.astype(np.float64), condition)
    parts, count = _ramps(means, smooth)
    rough = roughness(condition)
    found = gradient_areas(means / np.float32(rough), parts, count)
    shades = {id(shade): shade.times(rough) for shade in (area.shade for area in found)}
    areas = [replace(area, shade=shades[id(area.shade)]) for area in found if area.patch.size >= LEAST_AREA]
    # Where a ramp fades into its ground noise hides the end, so such areas end where their windows do.
    return [replace(area, ground=None) for area in areas if not is_step(area.shade)]


def roughness(condition: Condition) -> float:
    """Times as far as in a clean picture that pixels are off their gradient."""
    return JPEG_ROUGH if condition.jpeg else 1.0 + NOISE_ROUGH * condition.noise


def _planes(levels: np.ndarray, condition: Condition) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 4) float32 the means of windows, and (H, W) bool whether they are planes but for the noise."""
    size = (WINDOW, WINDOW, 1)
    means = ndimage.uniform_filter(levels, size, mode="nearest")
    left = ndimage.uniform_filter(levels * levels, size, mode="nearest") - means * means
    at = np.arange(WINDOW) - WINDOW // 2
    spread = float((at * at).mean())
    slope = np.zeros_like(left)
    for axis, across in enumerate(((1, WINDOW, 1), (WINDOW, 1, 1))):
        along = ndimage.correlate1d(levels, at / (WINDOW * spread), axis=axis, mode="nearest")
        own = ndimage.uniform_filter(along, across, mode="nearest")
        left -= spread * own * own
        slope += own * own
    most = (JPEG_LEFT if condition.jpeg else LEFT) * condition.noise + LEFT_LEVELS
    plane = (left <= most**2) & (slope <= STEEPEST**2)
    return means.astype(np.float32), plane.all(axis=-1)


def _ramps(means: np.ndarray, smooth: np.ndarray) -> tuple[np.ndarray, int]:
    """(H, W) int32 numbers from 1 on of the connected windows among which colours change, 0 elsewhere; how many."""
    labels, count = ndimage.label(ndimage.binary_opening(smooth, ndimage.SQUARE))
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    number = np.zeros(count + 1, dtype=np.int32)
    for k, box in enumerate(ndimage.find_objects(labels), start=1):
        if box is None or sizes[k] < LEAST_AREA:
            continue
        low, high = np.percentile(means[box][labels[box] == k], (2, 98), axis=0)
        if (high - low).max() >= LEAST_RANGE:
            number[k] = number.max() + 1
    return number[labels], int(number.max())


def is_step(shade: Shade, shortest: float = SHORTEST) -> bool:
    """Whether a ramp is an edge between two fills: does most of its change within less than `shortest` px."""
    length = np.diff(shade.ramp.knots) / max(float(np.hypot(*shade.frame[0, :2])), 1e-9)
    change = np.abs(np.diff(shade.ramp.colours, axis=0)).max(axis=1)
    return bool((change[length < shortest] >= MOST_CHANGE * np.ptp(shade.ramp.colours, axis=0).max()).any())


def _grown(levels: np.ndarray, area: ShadedArea, condition: Condition, even: np.ndarray) -> ShadedArea:
    """The area with the pixels around it that its gradient explains too; in a JPEG as far as these go on, but for large
    parts of one colour. even: (H, W) int32 numbers from 1 on of what is of one colour, 0 elsewhere.
    """
    wide = (_widest if condition.jpeg else _wider)(levels, area.shade, area.patch, condition, even)
    mask = wide.mask
    inner = Patch(wide.top, wide.left, ndimage.holes_of(mask))
    holes, count = ndimage.label(inner.mask)
    worst = np.zeros(count + 1)
    np.maximum.at(worst, holes[inner.mask], off_extended(area.shade, levels, inner))
    filled = (worst <= MOST_OFF) & (np.bincount(holes.ravel(), minlength=count + 1) <= LARGEST_HOLE)
    filled[0] = False
    return replace(area, patch=replace(wide, mask=mask | filled[holes]))


def _widest(levels: np.ndarray, shade: Shade, patch: Patch, condition: Condition, even: np.ndarray) -> Patch:
    """The patch made wider until it grows no more; in large parts of one colour no further than GROWN px."""
    sizes, near = np.bincount(even.ravel()), patch.grown(GROWN, levels.shape)
    wide, size = patch, 0
    while wide.size > size:
        size = wide.size
        wide = _wider(levels, shade, wide, condition, even)
        y, x = wide.places()
        part, mask = even[y, x], wide.mask.copy()
        mask[wide.mask] = (part == 0) | (sizes[part] < LEAST_AREA) | near.at(y, x)
        wide = replace(wide, mask=mask)
    return wide


def _wider(levels: np.ndarray, shade: Shade, patch: Patch, condition: Condition, even: np.ndarray) -> Patch:
    """The pixels of a patch, and those around it that a gradient explains and that hang together with them."""
    wide, near = _with_surroundings(patch, GROWN, levels.shape)
    mask = wide.mask.copy()
    off = off_extended(shade, levels, near)
    known = off <= (JPEG_NEAR if condition.jpeg else NEAR) * condition.noise + NEAR_LEVELS
    if condition.jpeg:
        known |= (even[near.places()] == 0) & _explained_at_edges(levels, shade, near, condition)
    mask[near.mask] = known
    labels, _ = ndimage.label(mask)
    return replace(wide, mask=np.isin(labels, np.unique(labels[wide.mask])))


def _explained_at_edges(levels: np.ndarray, shade: Shade, patch: Patch, condition: Condition) -> np.ndarray:
    """(n,) bool: the pixels near the edges of a JPEG that a gradient explains: chroma tells less of one of them, and as
    much as luma of several.
    """
    rest = np.zeros((*patch.mask.shape, 4))
    y, x = patch.places()
    rest[patch.mask] = (levels[y, x] - shade.extended().at(x + 0.5, y + 0.5)) @ LUMA_CHROMA
    known = patch.mask.copy()
    known[patch.mask] = _unlike(levels, shade, patch, condition) <= RESTORED * (JPEG_TIMES * condition.noise + MISFIT)
    share = np.maximum(ndimage.uniform_filter(known.astype(np.float64), MEAN), 1e-3)
    sums = ndimage.uniform_filter(np.where(known[..., None], rest, 0.0), (MEAN, MEAN, 1))
    return np.asarray((known & (np.abs(sums).max(axis=-1) <= UNLIKE * share))[patch.mask])


def _unlike(levels: np.ndarray, shade: Shade, patch: Patch, condition: Condition) -> np.ndarray:
    """(n,) levels by which pixels are off a gradient, carried on, as colours are told apart in a condition."""
    y, x = patch.places()
    return np.asarray(
        np.linalg.norm((levels[y, x] - shade.extended().at(x + 0.5, y + 0.5)) @ seen_as(condition), axis=1)
    )


def _to_the_nearest(levels: np.ndarray, areas: list[ShadedArea], condition: Condition) -> list[ShadedArea]:
    """The areas with each pixel in that of the gradient that it is nearest to."""
    least, owner = np.full(levels.shape[:2], np.inf), np.full(levels.shape[:2], -1)
    for k, area in enumerate(areas):
        y, x = area.patch.places()
        off = _unlike(levels, area.shade, area.patch, condition)
        nearer = off < least[y, x]
        least[y[nearer], x[nearer]], owner[y[nearer], x[nearer]] = off[nearer], k
    return [
        replace(area, patch=replace(area.patch, mask=area.patch.mask & (owner[area.patch.window] == k)))
        for k, area in enumerate(areas)
    ]


def _with_surroundings(patch: Patch, by: int, shape: tuple[int, ...]) -> tuple[Patch, Patch]:
    """A patch of a picture (H, W), and what is within so many px around it, in one box."""
    wide = patch.padded(by, shape)
    return wide, replace(wide, mask=ndimage.binary_dilation(wide.mask, ndimage.SQUARE, iterations=by) & ~wide.mask)


def off_extended(shade: Shade, levels: np.ndarray, patch: Patch) -> np.ndarray:
    """(n,) levels by which pixels are off a gradient, carried on."""
    y, x = patch.places()
    return shade.extended().off(Pixels(x + 0.5, y + 0.5, levels[y, x]))


def without_blurred_gradients(levels: np.ndarray, blur: float) -> Flattened:
    """A picture (H, W, 4), premultiplied levels, without its gradients. blur: px, standard deviation."""
    parts, count = smooth_parts(levels)
    if not count:
        return Flattened(levels)
    # The rims of what is smooth are the last of blurred edges.
    rim = max(1, round(blur))
    inner = ndimage.binary_erosion(parts > 0, ndimage.SQUARE, iterations=rim, border_value=1)
    found = [area for area in gradient_areas(levels, *ndimage.label(inner)) if not is_step(area.shade, EDGE * blur)]
    planes = plane_areas(levels, Condition(blur=blur))
    if sum(area.patch.size for area in planes) > MORE * sum(area.patch.size for area in found):
        areas = [_followed(levels, parts, area, GROWN) for area in planes]
    else:
        areas = [area if area.ground is not None else _followed(levels, parts, area, 1 + rim) for area in found]
    free = parts > 0
    for area in areas:
        free[area.patch.window] &= ~area.patch.mask
    return without_areas(levels, ndimage.large_parts(free, LEAST_EVEN)[0], areas, STRANGE, blur)


def _followed(levels: np.ndarray, parts: np.ndarray, area: ShadedArea, rim: int) -> ShadedArea:
    """The area with what hangs on it that its gradient explains too: pixels within `rim` px, and tips."""
    wide, near = _with_surroundings(area.patch, FARTHEST, levels.shape)
    explained = np.zeros_like(wide.mask)
    explained[near.mask] = off_extended(area.shade, levels, near) <= NEAR_LEVELS
    # A neighbour of about the colour in which the gradient ends is none of it, nor what goes on farther.
    rests, count = ndimage.label((parts[wide.window] > 0) & ~wide.mask)
    sizes = np.maximum(np.bincount(rests.ravel(), minlength=count + 1), 1)
    own = np.bincount(rests.ravel(), explained.ravel(), count + 1) >= MOSTLY * sizes
    own[0] = False
    rimmed = ndimage.binary_dilation(wide.mask, ndimage.SQUARE, iterations=rim)
    mask = wide.mask | (explained & (rimmed | own[rests]))
    return replace(area, patch=replace(wide, mask=ndimage.binary_propagation(wide.mask, None, mask)))
