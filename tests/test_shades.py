"""Gradients, blends and even parts by the native library, against their definitions in numpy."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
import pytest

from cubicsplat_cli.artwork.gradients.areas import gradient_areas
from cubicsplat_cli.artwork.gradients.flattening import flattened
from cubicsplat_cli.artwork.gradients.parts import Patch, joined, smooth_parts
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import (
    IN_LARGE,
    ON_EDGE,
    Pixels,
    bends_and_steps,
    best_colours,
    best_stops,
    blends,
    colours_at,
    colours_off,
    fitted,
    grown,
    misfits,
    nearest_paints,
    part_spreads,
    reach,
    scatter,
    slopes,
    trimmed_range,
)

KNOTS = np.array([0.2, 0.5, 1.1])
COLOURS = np.array([[20.0, 30.0, 200.0, 255.0], [220.0, 90.0, 10.0, 255.0], [60.0, 60.0, 60.0, 128.0]])
ROUND = np.array([[0.02, 0.004, -0.8, 0.0], [-0.003, 0.03, -0.6, 0.0]])
FOCAL = np.array([[0.02, 0.004, -0.8, 0.3], [-0.003, 0.03, -0.6, -0.5]])
LINE = np.array([[0.015, 0.01, -0.3, 0.0], [0.0, 0.0, 0.0, 0.0]])


def places(width: int = 40, height: int = 30) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[:height, :width] + 0.5
    return x.ravel(), y.ravel()


def defined(frame: np.ndarray, radial: bool, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(n, 4) by interpolation along t."""
    first, second = frame[:, :3] @ np.stack([x, y, np.ones_like(x)])
    t = np.hypot(first, second) + frame[0, 3] * first + frame[1, 3] * second if radial else first
    return np.stack([np.interp(t, KNOTS, COLOURS[:, k]) for k in range(4)], axis=1)


@pytest.mark.parametrize(("frame", "radial"), [(LINE, False), (ROUND, True), (FOCAL, True)])
def test_colours_follow_straight_lines_between_stops(frame, radial):
    x, y = places()
    truth = defined(frame, radial, x, y)
    assert colours_at((frame, radial, KNOTS, COLOURS), x, y) == pytest.approx(truth, abs=1e-9)
    assert colours_off((frame, radial, KNOTS, COLOURS), Pixels(x, y, truth + 3.0)) == pytest.approx(-3.0)


@pytest.mark.parametrize(("frame", "radial"), [(LINE, False), (ROUND, True), (FOCAL, True)])
def test_stops_are_found_again_in_rounded_pixels(frame, radial):
    x, y = places(80, 60)
    pixels = Pixels(x, y, np.rint(defined(frame, radial, x, y)))
    assert best_colours(frame, radial, KNOTS, pixels) == pytest.approx(COLOURS, abs=0.3)
    knots, colours = best_stops(frame, radial, pixels, 8, 25.0)
    inner = np.abs(knots - KNOTS[1]).argmin()
    assert knots[inner] == pytest.approx(KNOTS[1], abs=0.05)
    assert np.abs(colours[inner] - COLOURS[1]).max() < 20.0
    assert scatter(frame, radial, pixels) < 10.0 < scatter(frame[:, [1, 0, 2, 3]], radial, pixels)


@pytest.mark.parametrize(("truth", "parameters"), [(ROUND, 5), (FOCAL, 7)])
def test_a_fit_goes_back_to_an_ellipse_that_was_moved(truth, parameters):
    x, y = places(80, 60)
    pixels = Pixels(x, y, defined(truth, True, x, y))
    lean = 0.02 if parameters == 7 else 0.0
    began = truth + np.array([[0.0001, -0.0001, 0.006, lean], [0.0001, 0.0001, -0.004, lean]])
    frame, knots, colours = fitted(began, parameters, KNOTS + np.array([0.0, 0.005, 0.0]), COLOURS, pixels)
    assert np.abs(colours_off((frame, True, knots, colours), pixels)).max() < 0.5
    middle = np.linalg.solve(frame[:, :2], -frame[:, 2])
    assert middle == pytest.approx(np.linalg.solve(truth[:, :2], -truth[:, 2]), abs=0.1)
    assert frame[:, 3] == pytest.approx(truth[:, 3], abs=0.01)


def test_slopes_of_blocks_are_those_of_planes():
    x, y = places(20, 15)
    plane = np.stack([2.0 * x, 3.0 * y, x - y, np.full_like(x, 255.0)], axis=1)
    middles, changes, means, weights = slopes(Pixels(x, y, plane), 5, 5)
    assert middles == pytest.approx(np.stack([x, y], axis=1).reshape(3, 5, 4, 5, 2).mean(axis=(1, 3)).reshape(-1, 2))
    weight = 5.0 * np.sqrt(2.0)  # the root of 25 px, and of the spread 2 of five neighbouring places
    assert weights == pytest.approx(weight) and means[:, 3] == pytest.approx(255.0)
    assert means[:, 2] == pytest.approx(middles[:, 0] - middles[:, 1])
    assert changes / weight == pytest.approx(np.repeat([[[2, 0], [0, 3], [1, -1], [0, 0]]], 12, axis=0), abs=1e-9)


def test_bends_and_spreads_of_parts():
    levels = np.random.default_rng(1).uniform(0, 255, (9, 12, 4)).astype(np.float32)
    around = np.pad(levels, ((1, 1), (1, 1), (0, 0)), mode="reflect", reflect_type="odd")
    bends, steps = np.zeros((9, 12)), np.zeros((9, 12))
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        after, before = (around[1 + s * dy :, 1 + s * dx :][:9, :12] for s in (1, -1))
        bends = np.maximum(bends, np.abs(after - 2.0 * levels + before).max(axis=2))
        steps = np.maximum(steps, np.abs(after - before).max(axis=2))
    found = bends_and_steps(levels)
    assert found[0] == pytest.approx(bends, abs=1e-3) and found[1] == pytest.approx(steps, abs=1e-3)
    parts = np.zeros((9, 12), dtype=np.int32)
    parts[2:5, 3:9], parts[7:, :2] = 1, 2
    sizes, boxes, spreads = part_spreads(levels, parts, 2)
    assert sizes.tolist() == [18, 4] and boxes.tolist() == [[2, 4, 3, 8], [7, 8, 0, 1]]
    assert spreads == pytest.approx([np.ptp(levels[parts == k], axis=0).max() for k in (1, 2)])
    values = levels.reshape(-1, 4)
    low, high = np.percentile(values, (2, 98), axis=0, method="nearest")
    assert trimmed_range(values, 0.02) == pytest.approx((high - low).max(), abs=8.0)


def test_an_edge_pixel_is_a_blend_of_the_paints_beside_it():
    paint = np.full((5, 7), -1, dtype=np.int32)
    paint[:, :3], paint[:, 4:] = 0, 5
    paints, spots = nearest_paints(paint, np.array([2 * 7 + 3]), 3, 4)
    assert paints.tolist() == [[0, 5, -1, -1]] and spots[0, :2].tolist() == [2 * 7 + 2, 2 * 7 + 4]
    rng = np.random.default_rng(0)
    colours, others = rng.uniform(0, 255, (2, 50, 3, 4))
    share = rng.uniform(0, 1, 50)[:, None]
    values = colours[:, 1] + share * (colours[:, 0] - colours[:, 1]) + rng.normal(size=(50, 4))
    flat, left = blends(values, np.repeat([[3, 1, 2]], 50, axis=0), colours, others, False)
    for i in range(50):
        costs = []
        for a, b in combinations_with_replacement(range(3), 2):
            span = colours[i, a] - colours[i, b]
            own = np.clip((values[i] - colours[i, b]) @ span / max(span @ span, 1e-9), 0, 1)
            rest = values[i] - colours[i, b] - own * span
            costs.append((np.abs(rest).max() + 1.5 * (a + b), np.abs(rest).max(), a, b, own, rest))
        _, gap, a, b, own, rest = min(costs, key=lambda c: c[0])
        assert left[i] == pytest.approx(gap)
        assert flat[i] == pytest.approx(others[i, b] + own * (others[i, a] - others[i, b]) + rest)


def test_patches_join_and_grow():
    one, other = Patch(2, 3, np.ones((4, 5), bool)), Patch(4, 6, np.ones((6, 2), bool))
    both = joined([one, other])
    assert (both.top, both.left, both.mask.shape, both.size) == (2, 3, (8, 5), 28)
    assert one.grown(2, (30, 30)).window == (slice(0, 8), slice(1, 10)) and one.grown(2, (30, 30)).size == 72


def test_more_than_a_hundred_gradients_are_found():
    cell, count = 14, 11
    levels = np.zeros((count * cell, count * cell, 4), dtype=np.float32)
    levels[..., 3] = 255.0
    along = np.arange(10) * 9.0
    for k in range(count * count):
        top, left = 2 + k // count * cell, 2 + k % count * cell
        tile = levels[top : top + 10, left : left + 10]
        tile[..., k % 3] = 60.0 + (along if k % 2 else along[:, None])
        tile[..., (k + 1) % 3] = 5.0 * (k % 40)
    parts = smooth_parts(levels)
    assert parts.count >= count * count
    assert len(flattened(levels).gradients) > 100
    assert gradient_areas(parts, most=100) == []


@pytest.mark.parametrize(("frame", "radial"), [(LINE, False), (ROUND, True), (FOCAL, True)])
def test_misfits_of_groups_and_the_reach_of_pixels(frame, radial):
    random, (x, y) = np.random.default_rng(0), places()
    space = random.normal(size=(4, 4))
    pixels = Pixels(x, y, random.uniform(0.0, 255.0, (len(x), 4)))
    off = defined(frame, radial, x, y) - pixels.values
    sums = [((part @ space) ** 2).sum() for part in np.split(off, [7, 500])]
    ends = np.array([7, 500, len(x)])
    assert misfits((frame, radial, KNOTS, COLOURS), pixels, ends, space) == pytest.approx(np.array(sums))
    first, second = frame[:, :3] @ np.stack([x, y, np.ones_like(x)])
    t = np.hypot(first, second) + frame[0, 3] * first + frame[1, 3] * second if radial else first
    middle, beyond = np.median(t), []
    (least, most), squares = reach((frame, radial, KNOTS - KNOTS[1] + middle, COLOURS), pixels)
    assert (least, most) == pytest.approx((t.min(), t.max()))
    for end, beside, there in ((0, 1, t < KNOTS[0] - KNOTS[1] + middle), (2, 1, t > KNOTS[2] - KNOTS[1] + middle)):
        slope, at = (COLOURS[end] - COLOURS[beside]) / (KNOTS[end] - KNOTS[beside]), KNOTS[end] - KNOTS[1] + middle
        flat = COLOURS[end] - pixels.values[there]
        beyond.append([(flat**2).sum(), ((flat + slope * (t[there] - at)[:, None]) ** 2).sum()])
    assert squares == pytest.approx(np.array(beyond))


def grown_by_definition(off: np.ndarray, kinds: np.ndarray, inside: np.ndarray, most: tuple[float, ...], on: bool):
    """Return the area after the same growth, by passes over the whole picture. off: (H, W, 4) levels."""
    near, size = ndimage.binary_dilation(inside, ndimage.SQUARE, iterations=5), int(inside.sum())
    while True:
        ring = ndimage.binary_dilation(inside, ndimage.SQUARE, iterations=5) & ~inside
        like = ring & (np.linalg.norm(off, axis=2) <= most[1])
        share = ndimage.uniform_filter(like.astype(float), 5, mode="constant")
        mean = ndimage.uniform_filter(np.where(like[..., None], off, 0.0), (5, 5, 1), mode="constant")
        even = like & (kinds == ON_EDGE) & (np.abs(mean).max(axis=2) <= most[2] * share)
        wide = ndimage.binary_propagation(inside, None, inside | (ring & ((np.abs(off).max(axis=2) <= most[0]) | even)))
        before, size = size, int(wide.sum())
        if not on or size <= before:
            return wide
        inside = inside | (wide & ((kinds != IN_LARGE) | near))


@pytest.mark.parametrize("on", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_areas_grow_by_what_their_gradient_explains(on, seed):
    random, shape = np.random.default_rng(seed), (60, 80)
    x, y = places(80, 60)
    truth = defined(ROUND, True, x, y).reshape(*shape, 4)
    blobs = ndimage.gaussian_filter(random.normal(size=shape), 2.0)
    off = (random.normal(size=(*shape, 4)) + 12.0 * blobs[..., None]).astype(np.float32).astype(float)
    levels = (truth - off).astype(np.float32)
    kinds = np.where(blobs > 0.1, ON_EDGE, np.where(x.reshape(shape) > 60, IN_LARGE, 0)).astype(np.uint8)
    inside = np.zeros(shape, dtype=bool)
    inside[20:30, 30:40] = inside[0:3, 2:9] = True
    most = 2.2, 6.0, 1.5
    wide = grown_by_definition(truth - levels, kinds, inside, most, on)
    edges = most[1], most[2], np.eye(4), np.eye(4)
    given = (ROUND, True, KNOTS, COLOURS), inside.copy(), most[0], edges
    assert inside.sum() < wide.sum() < wide.size
    np.testing.assert_array_equal(grown(levels, kinds, *given, on=on), wide)
