"""Chains in fewer points: which are kept, and that those left out are near."""

import numpy as np
import pytest
from conftest import rest_slow

from cubicsplat_cli.raster.outlines import fewer_points


def wave(count, seed):
    rng = np.random.default_rng(seed)
    x = np.linspace(0.0, 40.0, count)
    return np.stack([x + rng.normal(0.0, 0.1, count), 5.0 * np.sin(0.3 * x) + rng.normal(0.0, 0.3, count)], axis=1)


@pytest.mark.parametrize("seed", rest_slow(*range(20), fast=1))
@pytest.mark.parametrize("tolerance", rest_slow(1.0, 0.2, 3.0))
def test_the_points_kept_are_those_of_another_program(seed, tolerance):
    from skimage.measure import approximate_polygon

    points = wave(150, seed)
    for chain in (points, np.vstack([points, points[:1]])):
        assert fewer_points(chain, tolerance) == pytest.approx(approximate_polygon(chain, tolerance))


def test_straight_chains_keep_their_ends():
    line = np.stack([np.arange(9.0), 2.0 * np.arange(9.0)], axis=1)
    assert fewer_points(line, 0.01).tolist() == [[0.0, 0.0], [8.0, 16.0]]


@pytest.mark.parametrize("count", [1, 2])
def test_what_has_no_points_between_its_ends_stays(count):
    assert fewer_points(np.ones((count, 2)), 0.5).tolist() == [[1.0, 1.0]] * count


def test_a_square_of_cracks_keeps_its_corners():
    side = np.arange(10.0)
    none, full = np.zeros(10), np.full(10, 10.0)
    sides = [(side, none), (full, side), (10.0 - side, full), (none, 10.0 - side)]
    loop = np.concatenate([np.stack(each, axis=1) for each in sides])
    kept = fewer_points(np.vstack([loop, loop[:1]]), 0.6)
    assert kept.tolist() == [[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]]
