"""Corners of loops, hulls and links, against their definitions."""

from __future__ import annotations

import time

import numpy as np
import pytest
from conftest import rest_slow
from outline_loops import corners_of, laid_out
from scipy import ndimage

from cubicsplat_cli.raster.outlines import Runs, fewest_links, hull_mask


def saw(teeth: int) -> np.ndarray:
    """(n, 2) points of a bar with so many teeth, two points a px."""
    x = np.arange(teeth * 8) / 2.0
    upper = np.stack([x, 4.0 * np.abs((x / 4.0) % 2.0 - 1.0)], axis=1)
    return np.concatenate([upper, np.stack([x[::-1], np.full(len(x), 40.0)], axis=1)])


def test_the_work_for_a_jagged_loop_grows_with_its_corners_and_not_with_their_square():
    seconds = []
    for teeth in (100, 400):
        points = saw(teeth)
        weights, tries = np.full(len(points), 400.0), []
        for _ in range(3):
            start = time.process_time()
            indices, positions, turns = corners_of(points, weights)
            given = indices, positions, turns, np.zeros(len(indices), dtype=bool)
            division = laid_out(points, weights, given, 3.0)[0]
            tries.append(time.process_time() - start)
        assert division.from_corner.sum() > 0.9 * teeth
        seconds.append(min(tries))
    # Four times as many corners; with all of them compared with all it would be 16 times the work.
    assert seconds[1] < 10.0 * seconds[0]


@pytest.mark.parametrize("seed", rest_slow(*range(4), fast=2))
def test_a_hull_holds_what_is_within_all_its_half_planes(seed):
    rng = np.random.default_rng(seed)
    labels = np.ascontiguousarray(rng.integers(0, 3, (23, 31)), np.int32)
    labels[rng.uniform(size=labels.shape) < 0.97] = 0
    own = labels[3:20, 2:29] == 1
    y, x = np.nonzero(own)
    corners = np.unique([(x + i, y + j) for i in (0, 1) for j in (0, 1)], axis=0).transpose(0, 2, 1).reshape(-1, 2)
    angles = np.linspace(0.0, 2.0 * np.pi, 400)
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    fine = np.stack(np.meshgrid(np.arange(27 * 8), np.arange(17 * 8)), axis=-1) / 8.0 + 1.0 / 16.0
    inside = (fine @ normals.T <= (corners @ normals.T).max(axis=0)).all(axis=2)
    share = inside.reshape(17, 8, 27, 8).mean(axis=(1, 3))
    hull = hull_mask(own)
    assert hull[own].all() and hull[share > 0.6].all() and not hull[share < 0.4].any()
    held, inner = Runs(labels).held_by_hull((slice(3, 20), slice(2, 29)), np.array([False, True, False]))
    view, deep = labels[3:20, 2:29], ndimage.binary_erosion(hull)
    for label in (0, 2):
        assert held[label] == (hull & (view == label)).sum()
        assert inner[label] == (hull & deep & (view == label)).sum()
    assert held[1] == inner[1] == 0


def test_the_fewest_lines_stay_hidden():
    # Around a corner of a corridor, whose ends may show.
    mask = np.zeros((20, 30), dtype=bool)
    mask[2:6, 2:28] = mask[2:18, 24:28] = True
    nodes = np.array([[3.0, 4.0], [10.0, 4.0], [26.0, 4.0], [26.0, 10.0], [26.0, 17.0]])
    hiding = (0, 0, 20, 30), (mask, mask, mask), nodes[[0, -1]], 6.0, 3.0
    path = fewest_links(nodes, np.arange(5.0), np.zeros(1), np.zeros(1), *hiding)
    assert path.tolist() == [0, 2, 4]
    mask[4:8, 20:24] = False
    mask[:, 15] = False
    assert fewest_links(nodes, np.arange(5.0), np.zeros(1), np.zeros(1), *hiding).tolist() == []
