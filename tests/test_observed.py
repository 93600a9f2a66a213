"""What a picture tells of how it came to be, held against definitions in numpy and pictures that are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from cubicsplat_cli.raster.unmix import (
    distinct,
    edge_variances,
    off_palette,
    planes,
    second_differences,
    steps,
    unexplained,
)

LUMA = np.array([0.299, 0.587, 0.114, 0.7], np.float32)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def _step(sigma: float, side: int = 40) -> np.ndarray:
    """An upright edge between two colours, (side, side, 4), blurred: the mean of a sum of normal steps over pixels."""
    fine = np.arange(side * 64) / 64.0 - 0.5 * side + 1.0 / 128.0
    share = (fine > 0.0).astype(float)
    if sigma:
        kernel = np.exp(-0.5 * (np.arange(-640, 641) / 64.0 / sigma) ** 2)
        share = np.convolve(np.pad(share, 640, mode="edge"), kernel / kernel.sum(), mode="valid")
    pixels = share.reshape(side, 64).mean(axis=1)
    colours = np.array([[20.0, 40.0, 200.0, 255.0], [250.0, 200.0, 30.0, 255.0]])
    line = colours[0] + pixels[:, None] * (colours[1] - colours[0])
    return np.repeat(line[None], side, axis=0).astype(np.float32)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("sigma", [0.8, 1.2, 1.6])
def test_the_variance_of_an_edge_is_that_of_its_blur(sigma: float, turned: bool) -> None:
    levels = _step(sigma).swapaxes(0, 1) if turned else _step(sigma)
    found = edge_variances(levels, levels @ LUMA, 100, 2.0, 60.0, 0.1)
    # The pixel's own width is taken out once for the pixels, and once for the steps between them.
    assert len(found) == 40 and found == pytest.approx(sigma**2, rel=0.06)


def test_a_line_between_two_areas_has_its_own_edges_and_is_none_of_them() -> None:
    levels = _step(1.2)
    levels[:, 19:21] = [255.0, 255.0, 255.0, 255.0]
    assert edge_variances(levels, levels @ LUMA, 100, 2.0, 60.0, 0.1) == pytest.approx(0.0, abs=0.06)
    levels[:, 20] = levels[:, 30]
    assert not len(edge_variances(levels, levels @ LUMA, 100, 2.0, 60.0, 0.1))


@pytest.mark.parametrize("sigma", [0.0, 0.5, 0.8, 1.2])
@pytest.mark.parametrize("width", [6.0, 8.7])
def test_the_blur_of_lines_is_measured_where_nothing_between_them_is_even(sigma: float, width: float) -> None:
    # They hardly slant, so that their edges lie anywhere in the pixels, which are the means of 8 x 8 finer ones.
    y, x = np.mgrid[: 8 * 64, : 8 * 64] / 8.0
    fine = gaussian_filter(((x + 0.1 * y) // width % 2.0), 8.0 * sigma)
    levels = np.repeat(30.0 + 200.0 * fine.reshape(64, 8, 64, 8).mean((1, 3))[..., None], 4, axis=2).astype(np.float32)
    found = edge_variances(levels, levels @ LUMA, 1000, 2.0, 60.0, 0.1, cut=True)
    # Where lines are five standard deviations wide, the tails of their edges are lost.
    blur = np.sqrt(max(0.0, np.median(found)))
    assert len(found) >= 40 and blur == pytest.approx(sigma, rel=0.15 if width < 6.0 * sigma else 0.05, abs=0.2)


def test_no_more_edges_are_looked_at_than_asked_for() -> None:
    levels = _step(1.0)
    assert len(edge_variances(levels, levels @ LUMA, 7, 2.0, 60.0, 0.1)) == 7


@pytest.mark.parametrize("size", [3, 5])
@pytest.mark.parametrize("channels", [3, 4])
def test_planes_are_the_least_squares_of_windows(rng: np.random.Generator, size: int, channels: int) -> None:
    values = rng.uniform(0.0, 255.0, (6, 9, channels)).astype(np.float32)
    means, slopes = planes(values, size)
    half = size // 2
    padded = np.pad(values.astype(float), ((half, half), (half, half), (0, 0)), mode="edge")
    at = np.arange(size) - half
    for (y, x), slope in np.ndenumerate(slopes):
        part = padded[y : y + size, x : x + size]
        u = np.tensordot(part, at * np.ones((size, 1)), axes=([0, 1], [0, 1]))
        v = np.tensordot(part, at[:, None] * np.ones((1, size)), axes=([0, 1], [0, 1]))
        norm = size * (at * at).sum()
        assert slope == pytest.approx(np.hypot(u / norm, v / norm).max(), rel=1e-4)
        assert means[y, x] == pytest.approx(part.mean(axis=(0, 1)), rel=1e-4)


def test_second_differences_are_the_largest_of_both_directions(rng: np.random.Generator) -> None:
    levels = rng.uniform(0.0, 255.0, (5, 7, 4)).astype(np.float32)
    expected = np.zeros((5, 7), np.float32)
    across = np.abs(levels[:, 2:, :3] - 2 * levels[:, 1:-1, :3] + levels[:, :-2, :3]).max(axis=2)
    down = np.abs(levels[2:, :, :3] - 2 * levels[1:-1, :, :3] + levels[:-2, :, :3]).max(axis=2)
    expected[:, 1:-1] = across
    expected[1:-1] = np.maximum(expected[1:-1], down)
    assert second_differences(levels) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("kinds", [3, 5000])
def test_distinct_keys_are_those_of_numpy(rng: np.random.Generator, kinds: int) -> None:
    keys = (rng.integers(0, kinds, (60, 90)).astype(np.uint64) << np.uint64(37)) + np.uint64(5)
    first, numbers = distinct(keys)
    _, index, inverse = np.unique(keys, return_index=True, return_inverse=True)
    assert (first == index).all() and (numbers == inverse.reshape(keys.shape)).all()


def _unexplained(levels, painted, space, ringing, reach, seam, unlike, own, allowed):
    """The definition in numpy."""
    gap = np.abs(levels - painted).max(axis=2)
    rough, where = gap > own * unlike, np.zeros(gap.shape, dtype=bool)
    line = range(-2, 3)
    square = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    stencils = [square, *([(k * i, k * j) for k in line] for i, j in ((0, 1), (1, 0), (1, 1), (1, -1)))]

    def moved(values, rows, columns, most, **how):
        padded = np.pad(values, ((most, most), (most, most), (0, 0)), **how)
        return padded[most + rows :, most + columns :][: values.shape[0], : values.shape[1]]

    seen, drawn = levels @ space, painted @ space
    for one, other in ((seen, drawn), (drawn, seen)):
        window = [(i, j) for i in range(-reach, reach + 1) for j in range(-reach, reach + 1)]
        near = np.array([moved(other, *at, reach, mode="edge") for at in window])
        low, high = near.min(axis=0), near.max(axis=0)
        slack = np.where((high - low).max(axis=2) > unlike, seam, 0.0)[..., None]
        off = np.where(rough[..., None], one - np.clip(one, low - slack, high + slack), 0.0)
        large = np.abs(off).max(axis=2) > own * unlike
        for stencil in stencils:
            mean = np.mean([moved(off, *at, 2) for at in stencil], axis=0)
            found = (np.abs(mean) > allowed + ringing) & (off * np.sign(mean) > own * np.abs(mean))
            where |= large & found.any(axis=2)
    return gap, where


@pytest.mark.parametrize(("reach", "seam"), [(1, 8.0), (3, 0.0)])
def test_unexplained_pixels_are_those_of_the_definition(reach: int, seam: float, rng: np.random.Generator) -> None:
    painted = np.kron(rng.integers(0, 256, (5, 4, 4)), np.ones((8, 8, 1)))
    levels = (np.roll(painted, 1, axis=0) + rng.normal(0.0, 4.0, painted.shape)).astype(np.float32)
    levels[rng.random(levels.shape[:2]) < 0.04] = 90.0
    ringing = rng.uniform(0.0, 3.0, levels.shape).astype(np.float32)
    given = levels, painted, rng.normal(size=(4, 4)), ringing, reach, seam, 6.0, 0.5, 7.0
    gap, where = unexplained(*given)
    wanted = _unexplained(*given)
    assert np.array_equal(gap, wanted[0]) and np.array_equal(where, wanted[1])
    assert 30 < where.sum() < where.size - 30


@pytest.mark.parametrize("shape", [(7, 9, 4), (1, 5, 3), (6, 1, 4)])
def test_steps_are_the_largest_differences_of_neighbours(shape: tuple[int, ...], rng: np.random.Generator) -> None:
    levels = rng.uniform(0.0, 255.0, shape).astype(np.float32)
    for found, axis in zip(steps(levels), (0, 1), strict=True):
        np.testing.assert_array_equal(found, np.abs(np.diff(levels, axis=axis)).max(axis=2))
    turned = steps(levels.swapaxes(0, 1))
    np.testing.assert_array_equal(turned[0].T, steps(levels)[1])


def test_pixels_are_compared_with_the_colours_of_their_labels(rng: np.random.Generator) -> None:
    levels, palette = rng.uniform(0.0, 255.0, (5, 6, 4)).astype(np.float32), rng.uniform(0.0, 255.0, (3, 4))
    labels = rng.integers(0, 3, (5, 6))
    np.testing.assert_array_equal(off_palette(levels, palette, labels), np.abs(levels - palette[labels]).max(axis=2))


@pytest.mark.parametrize("angle", [0.0, 20.0, 40.0, 45.0, 70.0])
@pytest.mark.parametrize("blur", [0.8, 1.6])
def test_the_blur_of_an_edge_is_that_across_it_at_any_angle(angle, blur):
    y, x = np.mgrid[:60, :60] - 29.5
    way = np.deg2rad(angle)
    across = (x * np.cos(way) + y * np.sin(way)) / np.hypot(blur, np.sqrt(1 / 12))
    levels = np.full((60, 60, 4), 255.0, np.float32)
    levels[..., :3] = (30.0 + 200.0 * ndtr(across))[..., None]
    found = edge_variances(levels, levels @ LUMA, 1000, 2.0, 60.0, 0.1)
    assert len(found) >= 30 and np.sqrt(np.median(found)) == pytest.approx(blur, rel=0.04)
