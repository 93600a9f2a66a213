"""Gradients of pictures with noise, JPEG artefacts or blur: found in the means of windows that a plane explains.

The mean of a window is the colour of a linear ramp at its middle, with much less noise than a pixel. In a picture that
is only blurred, gradients are sought away from edges as in clean pictures, and are followed up to the edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from cubicsplat_cli.artwork.channels import largest, summed
from cubicsplat_cli.artwork.gradients.areas import EXPLAINED, LONGEST_TIP, gradient_areas
from cubicsplat_cli.artwork.gradients.flattening import Flattened, without_areas
from cubicsplat_cli.artwork.gradients.parts import LARGE_AREA, LEAST_AREA, Part, Parts, joined, patches_of, smooth_parts
from cubicsplat_cli.artwork.gradients.shade import CLOSE, MOST_CHI, Ramp, Shade, ShadedArea, alike, by_gradient, covered
from cubicsplat_cli.artwork.gradients.shades import shade_of
from cubicsplat_cli.artwork.input.chroma import LUMA_CHROMA
from cubicsplat_cli.artwork.input.condition import MISFIT, OUTLIER, Condition
from cubicsplat_cli.artwork.input.palette import UNLIKE, calm_pixels
from cubicsplat_cli.artwork.input.restore import BLUR_REACH, JPEG_TIMES, seen_as
from cubicsplat_cli.artwork.regions.fills import BLEND
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import IN_LARGE, ON_EDGE, Pixels, grown
from cubicsplat_cli.raster.unmix import STRANGE

WINDOW = 7  # px of the means, and within which an edge between two fills does half of its change
NEAR, RESTORED = 6.0, 2.0  # times the noise by which pixels there may differ, and times the restored error
MOST_OFF = 64.0  # levels by which a small hole may differ from the gradient around it: the tip of a radial one
TOLD = 3.0 / 64.0  # numbers that a pixel of a JPEG tells of a channel's gradient: a block its mean and two slopes


def without_noisy_gradients(
    levels: np.ndarray, condition: Condition, new: Sequence[ShadedArea] | None = None, old: Sequence[ShadedArea] = ()
) -> Flattened:
    """Return a picture (H, W, 4), premultiplied levels, of a condition, without its gradients. new: areas of gradients,
    by default those that windows show. old: the areas of an earlier result; those of which new ones cover half are left
    out."""
    even, _ = ndimage.large_parts(calm_pixels(levels, condition.noise)[0], LEAST_AREA)
    new = plane_areas(levels, condition) if new is None else new
    taken = covered(new, levels.shape)
    areas = [area for area in old if 2 * taken[area.patch.window][area.patch.mask].sum() < area.patch.size]
    kind_of = np.zeros(int(even.max()) + 1, dtype=np.uint8)
    if condition.jpeg:
        kind_of[np.bincount(even.ravel()) >= LARGE_AREA] = IN_LARGE
        kind_of[0] = ON_EDGE
    areas += _united(levels, new, condition, kind_of[even])
    flat = without_areas(levels, even, _to_the_nearest(levels, areas, condition), STRANGE)
    return replace(flat, areas=tuple(areas))


def with_exact_gradients(levels: np.ndarray, noise: float) -> np.ndarray:
    """Return a picture (H, W, 4), premultiplied levels, in which pixels that show a gradient through noise, in levels,
    have its colours; the same array if it has no gradients."""
    condition, kinds = Condition(noise), np.zeros(levels.shape[:2], np.uint8)
    areas = _united(levels, plane_areas(levels, condition), condition, kinds)
    out = levels.copy() if areas else levels
    for area in _to_the_nearest(levels, areas, condition):
        shade, (y, x) = area.shade.extended(), area.patch.places()
        colours = np.clip(np.rint(shade.at(x + 0.5, y + 0.5)), 0.0, 255.0)
        near = largest(np.abs(colours - levels[y, x])) <= OUTLIER * noise
        out[y[near], x[near]] = colours[near]
    return out


def plane_areas(levels: np.ndarray, condition: Condition) -> list[ShadedArea]:
    """Return the gradients of a picture (H, W, 4), premultiplied levels, with the windows that show them."""
    means, smooth = _planes(levels.astype(np.float64), condition)
    parts = ndimage.large_parts(ndimage.binary_opening(smooth, ndimage.SQUARE), LARGE_AREA)
    rough = roughness(condition)
    found = gradient_areas(Parts(means / np.float32(rough), *parts))
    shades = {s: replace(s, ramp=Ramp(s.ramp.knots, s.ramp.colours * rough)) for s in {area.shade for area in found}}
    # Noise hides the end of a ramp that fades into its ground, so an area ends with its windows.
    areas = [replace(area, shade=shades[area.shade], ground=None) for area in found]
    strong = [area for area in areas if np.ptp(area.shade.ramp.colours, axis=0).max() >= BLEND]
    return [area for area in strong if area.patch.size >= LARGE_AREA and not is_step(area.shade)]


def roughness(condition: Condition) -> float:
    """Return how many times as much pixels differ from their gradient as in a clean picture."""
    return 3.0 if condition.jpeg else 1.0 + 0.5 * condition.noise


def _planes(levels: np.ndarray, condition: Condition) -> tuple[np.ndarray, np.ndarray]:
    """Return (H, W, 4) float32 the means of windows, and (H, W) bool: True for windows that are planes with noise, off
    these by 1.25 times the noise and 0.7 levels at most."""
    size, at = (WINDOW, WINDOW, 1), np.arange(WINDOW) - WINDOW // 2
    means = ndimage.uniform_filter(levels, size, mode="nearest")
    left = ndimage.uniform_filter(levels * levels, size, mode="nearest") - means * means
    spread = float((at * at).mean())
    for axis, across in enumerate(((1, WINDOW, 1), (WINDOW, 1, 1))):
        along = ndimage.correlate1d(levels, at / (WINDOW * spread), axis=axis, mode="nearest")
        left -= spread * ndimage.uniform_filter(along, across, mode="nearest") ** 2
    return means.astype(np.float32), largest(left) <= (1.25 * condition.noise + 0.7) ** 2


def is_step(shade: Shade, shortest: float = WINDOW) -> bool:
    """Return True if a ramp is an edge between two fills: half of its change happens within `shortest` px."""
    change = steepest(shade.ramp, shortest * float(np.hypot(*shade.frame[0, :2])))
    return change >= 0.5 * float(np.ptp(shade.ramp.colours, axis=0).max())


def steepest(ramp: Ramp, length: float) -> float:
    """Return the levels by which a ramp changes within a length of t at most."""
    starts = np.concatenate([ramp.knots, ramp.knots - length])
    return float(np.abs(ramp.at(starts + length) - ramp.at(starts)).max())


def _grown(levels: np.ndarray, area: ShadedArea, condition: Condition, kinds: np.ndarray) -> ShadedArea:
    """Return the area with the pixels around it that its gradient explains too, and its small holes. In a JPEG it grows
    as far as these go on, but into large parts of one colour only 5 px. kinds: (H, W) as of `grown`, 0 in others."""
    shade, mask, off = area.shade.extended(), covered([area], levels.shape), NEAR * condition.noise + CLOSE
    edges = RESTORED * (JPEG_TIMES * condition.noise + MISFIT), UNLIKE, seen_as(condition), LUMA_CHROMA
    (wide,) = patches_of(grown(levels, kinds, shade.given, mask, off, edges, on=condition.jpeg).view(np.uint8))
    holes = replace(wide, mask=ndimage.holes_of(wide.mask))
    labels, count = ndimage.label(holes.mask)
    worst = np.zeros(count + 1)
    np.maximum.at(worst, labels[holes.mask], shade.off(holes.pixels(levels)))
    filled = (worst <= MOST_OFF) & (np.bincount(labels.ravel(), minlength=count + 1) <= LARGE_AREA)
    filled[0] = False
    return replace(area, patch=replace(wide, mask=wide.mask | filled[labels]))


def _united(
    levels: np.ndarray, areas: Sequence[ShadedArea], condition: Condition, kinds: np.ndarray
) -> list[ShadedArea]:
    """Return the areas, `_grown`, with one gradient for two that are side by side, or alike, if its description is
    shorter: noise may show a gradient in pieces. kinds: as of `grown`."""
    groups = by_gradient(_grown(levels, area, condition, kinds) for area in areas)
    pairs = list(combinations(groups, 2))
    while pairs:
        first, second = pairs.pop()
        near = first.patch.at(*second.patch.grown(2, levels.shape).places()).any()
        if not near and alike(first.shade.ramp, second.shade.ramp) > roughness(condition) * CLOSE:
            continue
        work().at()
        patch = joined([first.patch, second.patch])
        pixels, (y, x) = patch.pixels(levels), patch.places()
        shade = shade_of(pixels, [first.shade, second.shade])
        one, *two = (_squares(each, pixels, condition) for each in (shade, first.shade, second.shade))
        # Of pixels that either explains, the mean: the lower error would be that of a ragged border.
        shown = [area.patch.at(y, x) for area in (first, second)]
        before = np.average(two, axis=0, weights=shown)
        variance = float(before.mean()) / 3.0 + 1e-9
        worse = float((np.minimum(one, MOST_CHI * variance) - np.minimum(before, MOST_CHI * variance)).sum())
        if 0.5 * TOLD * worse / variance < first.shade.price + second.shade.price - shade.price:
            both = _grown(levels, ShadedArea(shade, patch), condition, kinds)
            others = [group for group in groups if group not in (first, second)]
            left = [pair for pair in pairs if {first, second}.isdisjoint(pair)]  # others were refused
            groups, pairs = [both, *others], [*((both, other) for other in others), *left]
    return groups


def _squares(shade: Shade, pixels: Pixels, condition: Condition) -> np.ndarray:
    """Return the squared errors (n,) that a gradient leaves of pixels, as the condition lets colours be told."""
    off = shade.extended().residuals(pixels) @ seen_as(condition)
    return summed(off * off)


def _to_the_nearest(levels: np.ndarray, areas: list[ShadedArea], condition: Condition) -> list[ShadedArea]:
    """Return the areas without overlaps: each pixel stays with the gradient that is nearest to it."""
    least, owner = np.full(levels.shape[:2], np.inf), np.full(levels.shape[:2], -1)
    for k, area in enumerate(areas):
        y, x = area.patch.places()
        off = _squares(area.shade, area.patch.pixels(levels), condition)
        nearer = off < least[y, x]
        least[y[nearer], x[nearer]], owner[y[nearer], x[nearer]] = off[nearer], k
    return [area.kept(owner == k) for k, area in enumerate(areas)]


def without_blurred_gradients(levels: np.ndarray, blur: float) -> Flattened:
    """Return a picture (H, W, 4), premultiplied levels, without its gradients. blur: standard deviation, px."""
    parts = smooth_parts(levels).numbers
    # The rims of even parts are the ends of blurred edges.
    rim = max(1, round(blur))
    inner = ndimage.binary_erosion(parts > 0, ndimage.SQUARE, iterations=rim, border_value=1)
    found, edge = gradient_areas(Parts(levels, *ndimage.label(inner))), 2.0 * BLUR_REACH * blur
    found = [area for area in found if not is_step(area.shade, edge)]
    areas = [area if area.ground is not None else _followed(levels, parts, area, 1 + rim) for area in found]
    free = (parts > 0) & ~covered(areas, parts.shape)
    return without_areas(levels, ndimage.large_parts(free, LEAST_AREA)[0], areas, STRANGE, blur)


def _followed(levels: np.ndarray, parts: np.ndarray, area: ShadedArea, rim: int) -> ShadedArea:
    """Return the area with the connected pixels that its gradient explains too: those within `rim` px, and tips."""
    wide, near = area.patch.padded(LONGEST_TIP, levels.shape), Part(levels, area.patch.ring(LONGEST_TIP, levels.shape))
    explained = near.within(area.shade.extended().explains(near.pixels)).mask
    # Neither a neighbour of about the last colour of the ramp belongs to it, nor a part that goes on farther.
    rests, count = ndimage.label((parts[wide.window] > 0) & ~wide.mask)
    sizes = np.bincount(rests.ravel(), minlength=count + 1)
    belongs = np.bincount(rests.ravel(), explained.ravel(), count + 1) >= EXPLAINED * sizes
    belongs[0] = False
    rimmed = ndimage.binary_dilation(wide.mask, ndimage.SQUARE, iterations=rim)
    more = explained & (rimmed | belongs[rests])
    return replace(area, patch=replace(wide, mask=ndimage.binary_propagation(wide.mask, None, more)))
