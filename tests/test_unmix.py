"""Shares of fill colours in pixels, held against their definitions in numpy."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import (
    SLOTS,
    best_blend,
    blend_with,
    components,
    distance_to_blends,
    fills_of_lines,
    joined_fills,
    line_sections,
    near_fills,
    nearest_fills,
    part_facts,
    part_fills,
    relabelled,
    residual_of_three,
    spread,
    with_joined_parts,
)

WHITE, BLACK, RED, BLUE = (np.array(c, float) for c in ((255,) * 4, (0, 0, 0, 255), (255, 0, 0, 255), (0, 0, 255, 255)))
FILLS = np.stack([WHITE, BLACK, RED, BLUE])


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def _values(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(0.0, 255.0, (count, 4)).astype(np.float32)


def _two(value: np.ndarray, one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """The share of one colour in its blend with another, and the residual."""
    span = one - other
    share = float(np.clip((value - other) @ span / max(span @ span, 1e-9), 0.0, 1.0))
    return share, float(np.abs(value - other - share * span).max())


@pytest.mark.parametrize("window", [(1, 5), (5, 1), (3, 3), (5, 5), (9, 7)])
@pytest.mark.parametrize("channels", [3, 4])
def test_spread_is_that_of_the_window(rng: np.random.Generator, window: tuple[int, int], channels: int) -> None:
    values = rng.uniform(0.0, 255.0, (7, 6, channels)).astype(np.float32)
    up, left = window[0] // 2, window[1] // 2
    for (y, x), found in np.ndenumerate(spread(values, *window)):
        part = values[max(0, y - up) : y + up + 1, max(0, x - left) : x + left + 1]
        assert found == np.ptp(part, axis=(0, 1)).max()


def test_the_nearest_fill_is_that_of_the_least_greatest_channel(rng: np.random.Generator) -> None:
    values = _values(rng, 500).repeat(2, axis=0)
    index, gap = nearest_fills(values, FILLS)
    gaps = np.abs(values[:, None] - FILLS.astype(np.float32)).max(axis=2)
    assert (index == gaps.argmin(axis=1)).all() and (gap == gaps.min(axis=1)).all()


def test_near_fills_come_in_the_order_of_their_distance() -> None:
    fills = np.full((9, 9), -1)
    fills[4, 4], fills[4, 6], fills[1, 4], fills[3, 3], fills[8, 8] = 5, 5, 2, 7, 1
    near = near_fills(fills, np.array([4, 0]), np.array([4, 0]), 3)
    assert near.tolist() == [[5, 7, 2, -1], [7, -1, -1, -1]]
    assert near_fills(fills, np.array([4]), np.array([4]), 1).tolist() == [[5, 7, -1, -1]]


def test_the_best_pair_explains_a_pixel_and_lies_near(rng: np.random.Generator) -> None:
    values = _values(rng, 200)
    near = np.array([[0, 1, 2, 3], [2, 0, -1, -1], [3, -1, -1, -1], [-1, -1, -1, -1]], np.int32)[np.arange(200) % 4]
    winner, residual = best_blend(values, FILLS, near)
    for value, own, fill, rest in zip(values, near, winner, residual, strict=True):
        pairs = [(a, b) for a in range(4) for b in range(a, 4) if own[a] >= 0 and own[b] >= 0]
        tried = [(*_two(value, FILLS[own[a]], FILLS[own[b]]), a, b) for a, b in pairs]
        if not tried:
            assert fill == -1 and rest == np.inf
            continue
        share, left, a, b = min(tried, key=lambda each: each[1] + 1.5 * (each[2] + each[3]))
        assert fill == own[a if share >= 0.5 else b] and rest == pytest.approx(left, abs=1e-9)


def test_three_fills_explain_what_two_do_not(rng: np.random.Generator) -> None:
    shares = rng.dirichlet((1.0, 1.0, 1.0), 50)
    values = (shares @ FILLS[:3]).astype(np.float32)
    near = np.tile(np.array([3, 0, 1, 2], np.int32), (50, 1))
    two = best_blend(values, FILLS, near)[1]
    three = residual_of_three(values, FILLS, near)
    # Two that are about as good, to two levels, are taken.
    assert three.max() < 2.01 and two.max() > 20.0
    assert (residual_of_three(values, FILLS, near[:, [0, 1, 2, 2]] * [1, 1, 0, 0] - [0, 0, 1, 1]) == np.inf).all()


def test_a_blend_of_three_tells_the_share_of_its_fill() -> None:
    shares = np.array([[0.3, 0.4, 0.3], [0.6, 0.0, 0.4], [0.0, 0.5, 0.5], [1.0, 0.0, 0.0]])
    share, residual = blend_with(shares @ FILLS[:3], FILLS[0], FILLS[1], FILLS[2])
    assert share == pytest.approx(shares[:, 0]) and residual == pytest.approx(0.0, abs=1e-9)
    # Off their plane as far as the channel says that no fill has.
    assert blend_with(WHITE - [0.0, 0.0, 0.0, 80.0], WHITE, BLACK, RED)[1] == pytest.approx(80.0, abs=1.0)


def test_a_line_keeps_its_fill_along_a_window() -> None:
    # Blends of red with white, but for one pixel that black explains as well.
    x = np.arange(9)
    values = (0.4 * RED + 0.6 * WHITE)[None].repeat(9, axis=0)
    values[4] = 0.4 * BLACK + 0.6 * WHITE
    beside = WHITE[None].repeat(9, axis=0)
    costs = (40.0, 0.0, 0.1)
    fill, share, residual = fills_of_lines(values, (np.zeros(9), x), FILLS, (beside, beside), 7, costs)
    assert (fill == 2).all() and share[:4] == pytest.approx(0.4) and residual[4] > 50.0
    alone, share, residual = fills_of_lines(values, (np.zeros(9), x), FILLS, (beside, beside), 1, costs)
    assert alone[4] == 1 and share == pytest.approx(0.4) and residual == pytest.approx(0.0, abs=1e-4)


def test_distance_to_blends_is_that_to_the_nearest_segment(rng: np.random.Generator) -> None:
    values = _values(rng, 60)
    found = distance_to_blends(values, FILLS)
    along = np.linspace(0.0, 1.0, 1001)[:, None]
    segments = np.concatenate([a + along * (b - a) for a, b in combinations(FILLS, 2)])
    assert found == pytest.approx(np.linalg.norm(values[:, None] - segments, axis=2).min(axis=1), abs=0.2)
    assert (distance_to_blends(values, FILLS, 3) >= found).all()


def test_a_part_shows_its_commonest_colour_or_median_or_bands() -> None:
    levels, owner = np.zeros((1, 12, 4), np.float32), np.zeros((1, 12), np.int32)
    levels[0, :, 0] = [9, 8, 9, 7, 6, 1, 2, 3, 4, 5, 0, 200]
    owner[0] = [2, 2, 2, 2, 2, 1, 1, 1, 1, 1, 3, 3]
    fills, sizes = part_fills(levels, owner, 14.0, 24.0)
    assert fills[:, 0].tolist() == [3.0, 9.0, 0.0, 200.0] and sizes.tolist() == [5.0, 5.0, 1.0, 1.0]


def test_fills_join_the_nearest_before_them() -> None:
    fills = np.array([[0.0] * 4, [10.0] * 4, [7.0] * 4, [90.0] * 4, [200.0] * 4])
    kept, weights = joined_fills(fills, np.arange(1.0, 6.0), 3.5, 3)
    assert kept[:, 0].tolist() == [0.0, 10.0, 90.0] and weights.tolist() == [1.0, 5.0, 4.0]


def test_components_are_numbered_by_value_and_first_pixel() -> None:
    values = np.array([[2, 0, 2, 2], [2, 0, -1, 2], [2, 2, 2, 2], [0, 1, 0, 1]])
    labels, count = components(values)
    assert labels.tolist() == [[6, 1, 6, 6], [6, 1, 0, 6], [6, 6, 6, 6], [2, 4, 3, 5]] and count == 7
    sizes, marks, value = part_facts(labels, values, values > 0)
    assert sizes.tolist() == [1, 2, 1, 1, 1, 1, 9] and value.tolist() == [-1, 0, 0, 0, 1, 1, 2]
    assert marks.tolist() == [0, 0, 0, 0, 1, 1, 9]


def test_holes_are_what_no_way_along_pixels_leaves() -> None:
    mask = np.ones((6, 6), bool)
    mask[1, 1] = mask[2, 2] = False  # each of them enclosed, since they only touch at a corner
    mask[4, 4:] = False
    holes = ndimage.holes_of(mask)
    assert np.argwhere(holes).tolist() == [[1, 1], [2, 2]] and not ndimage.holes_of(np.ones((2, 3), bool)).any()


@pytest.mark.parametrize("bounded", [False, True])
def test_labels_are_chosen_by_their_blends_and_their_neighbours(rng, bounded):
    shape, scale, most, neighbour, unsure = (24, 30), 300.0, 40.0, 0.7, 3.0
    fills = rng.uniform(0.0, 255.0, (6, 4))
    truth = np.repeat(np.repeat(rng.integers(0, 6, (4, 5)), 6, axis=0), 6, axis=1)
    seen = (fills[truth] + rng.normal(0.0, 25.0, (*shape, 4))).astype(np.float32)
    labels = rng.integers(0, 6, shape).astype(np.int32)
    y, x = np.nonzero(rng.uniform(size=shape) < 0.7)
    candidates = np.array([rng.permutation(6) for _ in y])[:, : SLOTS + 1]
    candidates[rng.uniform(size=candidates.shape) < 0.1] = -1
    candidates[:, 0] = truth[y, x]
    first, second = fills[candidates][:, :, None], fills[candidates][:, None]
    off, span = seen[y, x][:, None, None] - first, second - first
    share = np.clip((off * span).sum(axis=3) / np.maximum((span**2).sum(axis=3), 1e-9), 0.0, 0.5)
    cost = ((off - share[..., None] * span) ** 2).sum(axis=3) / scale
    listed = candidates >= 0
    cost[~(listed[:, :, None] & listed[:, None])] = np.inf
    prior = np.where(listed, np.where(np.arange(SLOTS + 1) < SLOTS, 0.0, unsure), np.inf)
    expected, alone = labels.copy(), cost.diagonal(axis1=1, axis2=2)[:, :, None]
    for _ in range(6):
        padded = np.pad(expected, 1, mode="edge")
        around = [padded[y + dy, x + dx] for dy in range(3) for dx in range(3) if (dy, dx) != (1, 1)]
        alike = np.sum([other[:, None] == candidates for other in around], axis=0)
        left = np.where(alike[:, None] > 0, cost, alone) if bounded else np.minimum(cost, most)
        score = left.min(axis=2) + prior - neighbour * alike
        expected[y, x] = candidates[np.arange(len(y)), score.argmin(axis=1)]
    assert (expected != labels).any()
    costs = scale, most, neighbour, unsure
    found = relabelled(labels, seen, fills, (y, x), candidates, costs, bounded=bounded)
    np.testing.assert_array_equal(found, expected)


def _cost(labels: np.ndarray, seen: np.ndarray, neighbour: float, sigma: float) -> float:
    """Nats of a picture in FILLS: of its pixels, and of its borders."""
    (height, width), total = labels.shape, 0.0
    for y, x in np.ndindex(labels.shape):
        own, left = FILLS[labels[y, x]], []
        for down, right in np.ndindex(3, 3):
            v, u = y + down - 1, x + right - 1
            if 0 <= v < height and 0 <= u < width:
                step = FILLS[labels[v, u]] - own
                share = np.clip((seen[y, x] - own) @ step / max(step @ step, 1e-9), 0.0, 0.5)
                left.append((((seen[y, x] - own - share * step) / sigma) ** 2).sum())
                if labels[v, u] != labels[y, x]:
                    total += 0.5 * neighbour * (1.0 if down == 1 or right == 1 else np.sqrt(0.5))
        total += np.log1p(min(left)) + 0.5 * max(min(left) - 16.0, 0.0)
    return total


@pytest.mark.parametrize("near", [300.0, 1000.0])
def test_small_parts_join_neighbours_until_none_costs_less_so(rng: np.random.Generator, near: float) -> None:
    shown = np.kron(rng.integers(0, 4, (4, 4)), np.ones((3, 3), int)).astype(np.int32)
    labels = np.where(rng.random((12, 12)) < 0.2, rng.integers(0, 4, (12, 12)), shown).astype(np.int32)
    seen = (FILLS[shown] + rng.normal(0.0, 30.0, (12, 12, 4))).astype(np.float32)
    part, neighbour, sigma, most = 12.0, 0.7, 60.0, 20
    found = with_joined_parts(labels, seen, FILLS, most, (part, neighbour, sigma**2, 16.0, near))
    assert (found != labels).any()
    before, after = _cost(labels, seen, neighbour, sigma), _cost(found, seen, neighbour, sigma)
    assert after + part * components(found)[1] < before + part * components(labels)[1]
    parts, count = components(found)
    for number in range(count):
        own = parts == number
        around = ndimage.binary_dilation(own) & ~own
        for label in np.unique(found[around]) if own.sum() <= most else ():
            if np.linalg.norm(FILLS[label] - FILLS[found[own][0]]) <= near:
                assert _cost(np.where(own, label, found), seen, neighbour, sigma) > after + part - 1e-6


def test_sections_of_lines_are_sums_of_shares_between_two_areas() -> None:
    """A level line over two rows, an upright one on one column, and a slanting one, between white and red."""
    levels, areas = np.full((30, 40, 4), 255.0, np.float32), np.zeros((30, 40), np.int32)
    levels[:, 20:], areas[:, 20:] = RED, 2
    share = np.zeros((30, 40))
    share[5:7, 3:17] = [[0.25], [0.75]]
    share[12:25, 6] = 1.0
    for k in range(8):
        share[12 + k, 26 + k : 28 + k] = 0.6, 0.4
    levels += (share[..., None] * (BLUE - levels)).astype(np.float32)
    areas[share > 0.0] = -1
    areas[12, 34] = -1  # between no two areas that blends explain
    levels[12, 34] = BLACK
    found, across, down, whole = line_sections(levels, areas, FILLS, BLUE, 2.0, 0.95)
    np.testing.assert_allclose(found, share, atol=1e-6)
    assert (across[5, 3:17] == pytest.approx(14 * 0.25)) and (down[5:7, 3:17] == pytest.approx(1.0))
    assert (across[12:25, 6] == pytest.approx(1.0)) and (down[12:25, 6] == pytest.approx(13.0))
    assert (across[13, 27:29] == pytest.approx(1.0)) and (down[13, 27:29] == pytest.approx([1.0, 1.0]))
    np.testing.assert_array_equal(whole, share == 1.0)
    assert not across[12, 34] and not down[12, 34]
