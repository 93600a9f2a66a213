"""The native image operations give what scipy.ndimage gives, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import ndimage as theirs

from cubicsplat_cli.raster import ndimage as ours

SIDES = st.integers(1, 24)
MASKS = st.tuples(SIDES, SIDES).flatmap(lambda shape: arrays.arrays(bool, shape))
NUMBERS = st.sampled_from([bool, np.uint8, np.int32, np.int64, np.float32, np.float64])
FLOATS = st.sampled_from([np.float32, np.float64])
MODES = st.sampled_from(["reflect", "nearest", "constant"])
CROSS, SQUARE = theirs.generate_binary_structure(2, 1), np.ones((3, 3), dtype=bool)
STRUCTURES = st.sampled_from([None, CROSS, SQUARE])
LABELS = st.tuples(SIDES, SIDES).flatmap(lambda shape: arrays.arrays(np.int32, shape, elements=st.integers(0, 6)))


@st.composite
def pictures(draw, kinds):
    """Noise, of which some is turned so that it does not lie in order."""
    shape = draw(st.one_of(st.tuples(SIDES), st.tuples(SIDES, SIDES), st.tuples(SIDES, SIDES, st.integers(1, 4))))
    values = np.random.default_rng(draw(st.integers(0, 2**32))).uniform(0.0, 255.0, shape)
    values = (values > 128.0) if draw(st.booleans()) and len(shape) > 1 else values
    return values.astype(draw(kinds)).T if draw(st.booleans()) else values.astype(draw(kinds))


def same(found, known):
    assert found.dtype == known.dtype
    np.testing.assert_array_equal(found, known)


@given(pictures(NUMBERS), st.data(), MODES)
def test_extremes_of_neighbours(values, data, mode):
    sizes = data.draw(st.tuples(*[st.integers(1, 20)] * values.ndim))
    for name in ("maximum_filter", "minimum_filter"):
        same(getattr(ours, name)(values, sizes, mode=mode), getattr(theirs, name)(values, sizes, mode=mode))


@given(pictures(FLOATS), st.data(), MODES)
def test_means_and_sums_of_neighbours(values, data, mode):
    sizes = data.draw(st.tuples(*[st.integers(1, 20)] * values.ndim))
    same(ours.uniform_filter(values, sizes, mode=mode), theirs.uniform_filter(values, sizes, mode=mode))
    weights = data.draw(arrays.arrays(float, st.integers(1, 12), elements=st.floats(-3.0, 3.0)))
    for taps in (weights, weights + weights[::-1], weights - weights[::-1]):
        for axis in (0, -1):
            found = ours.correlate1d(values, taps, axis, mode=mode)
            same(found, theirs.correlate1d(values, taps, axis, mode=mode))
    sigmas = data.draw(st.tuples(*[st.sampled_from([0.0, 0.3, 1.0, 4.5])] * values.ndim))
    same(ours.gaussian_filter(values, sigmas, mode=mode), theirs.gaussian_filter(values, sigmas, mode=mode))
    same(ours.gaussian_filter(values, 0.8, truncate=2.5), theirs.gaussian_filter(values, 0.8, truncate=2.5))


@given(MASKS, STRUCTURES)
def test_parts_of_a_mask(mask, structure):
    found, count = ours.label(mask, structure)
    known, number = theirs.label(mask, structure)
    assert count == number
    same(found, known)
    assert ours.find_objects(found) == theirs.find_objects(found)
    assert ours.find_objects(found.astype(np.int64), 3) == theirs.find_objects(found, 3)


@given(MASKS)
def test_skeletons_are_thin_and_hang_together_as_their_masks_do(mask):
    found = ours.skeletonize(mask)
    assert not (found & ~mask).any()
    same(ours.skeletonize(found), found)
    assert 2 * theirs.binary_erosion(found).sum() <= found.sum()
    wide, thin = np.pad(mask, 1), np.pad(found, 1)
    parts, count = theirs.label(wide, SQUARE)
    assert count == theirs.label(thin, SQUARE)[1] == len(set(parts[thin]))
    assert theirs.label(~wide)[1] == theirs.label(~thin)[1]


def test_a_bar_has_one_line_for_its_skeleton():
    bar = np.zeros((20, 60), dtype=bool)
    bar[5:14, 4:56] = True
    found = ours.skeletonize(bar)
    assert (found.sum(axis=0)[10:50] == 1).all() and found[9, 10:50].all()


@given(MASKS, st.one_of(st.none(), arrays.arrays(bool, st.sampled_from([(3, 3), (1, 5), (5, 3), (7, 7)]))), st.data())
def test_dilation_and_erosion(mask, structure, data):
    rounds = data.draw(st.integers(1, 6))
    where = data.draw(arrays.arrays(bool, mask.shape))
    if structure is not None:
        structure[0, 0] = True  # scipy takes none that is empty
        rounds = rounds if structure.shape == (3, 3) else 1  # and is wrong about others, applied more than once
    same(ours.binary_dilation(mask, structure, rounds), theirs.binary_dilation(mask, structure, rounds))
    found = ours.binary_dilation(mask, structure, rounds, mask=where)
    same(found, theirs.binary_dilation(mask, structure, rounds, mask=where))
    for border in (0, 1):
        found = ours.binary_erosion(mask, structure, rounds, border_value=border)
        same(found, theirs.binary_erosion(mask, structure, rounds, border_value=border))
    same(ours.binary_opening(mask, structure), theirs.binary_opening(mask, structure))


@given(MASKS, STRUCTURES, st.data())
def test_what_is_linked_and_what_is_enclosed(mask, structure, data):
    where = data.draw(arrays.arrays(bool, mask.shape))
    few = mask & (np.cumsum(mask).reshape(mask.shape) % 5 == 0)
    same(ours.binary_propagation(few, structure, where), theirs.binary_propagation(few, structure, where))
    same(ours.binary_fill_holes(mask), theirs.binary_fill_holes(mask))


@given(MASKS, st.integers(1, 4), st.data())
def test_a_shape_reaches_its_surroundings_and_what_they_enclose_of_what_is_above(mask, steps, data):
    above, hull = (data.draw(arrays.arrays(bool, mask.shape)) for _ in range(2))
    shown = mask & (np.cumsum(mask).reshape(mask.shape) % 5 == 0)
    for within in (hull, None):
        known = shown | above & (theirs.binary_dilation(shown, iterations=steps) | (hull & (within is not None)))
        parts, count = theirs.label(np.pad(~known, 1, constant_values=True))
        beyond = np.pad(~above, 1, constant_values=True)
        holes = [k for k in range(1, count + 1) if not beyond[parts == k].any()]
        same(ours.reached(shown, above, within, steps), known | np.isin(parts[1:-1, 1:-1], holes))


@given(MASKS)
def test_distances(mask):
    mask[data_pixel(mask)] = False
    same(ours.distance_transform_edt(mask), theirs.distance_transform_edt(mask))
    found = ours.distance_transform_cdt(mask)
    same(found, theirs.distance_transform_cdt(mask, metric="chessboard"))


def data_pixel(mask):
    """Some pixel, so that there is one to be far from."""
    return np.unravel_index(int(mask.sum() * 7) % mask.size, mask.shape)


def test_without_a_pixel_that_is_0_nothing_is_at_a_distance():
    full = np.ones((3, 4), dtype=bool)
    assert np.isinf(ours.distance_transform_edt(full)).all()
    same(ours.distance_transform_cdt(full), np.full((3, 4), -1, np.int32))


@given(LABELS, FLOATS, st.lists(st.integers(0, 9), max_size=5))
def test_values_by_label(labels, kind, index):
    values = np.random.default_rng(labels.size).normal(size=(*labels.shape, 2)).astype(kind)[..., 0]
    index = np.array(index, dtype=int)
    same(ours.maximum(values, labels, index), np.array(theirs.maximum(values, labels, index), dtype=kind))
    own = np.intersect1d(index, labels[values > 0.0])
    found = np.reshape(ours.center_of_mass(values > 0.0, labels, own), (-1, 2))
    np.testing.assert_array_equal(found, np.array(theirs.center_of_mass(values > 0.0, labels, own)).reshape(-1, 2))


def test_arguments_that_mean_nothing_are_refused():
    picture = np.zeros((4, 4))
    with pytest.raises(ValueError, match="least size"):
        ours.maximum_filter(picture, 0)
    with pytest.raises(ValueError, match="0 times"):
        ours.binary_dilation(picture, iterations=0)
    with pytest.raises(ValueError, match="odd sides"):
        ours.binary_dilation(picture, np.ones((2, 3)))
    with pytest.raises(ValueError, match="mirror"):
        ours.uniform_filter(picture, 3, mode="mirror")
    with pytest.raises(TypeError, match="uint8"):
        ours.uniform_filter(picture.astype(np.uint8), 3)


@given(st.integers(8, 40), st.floats(1.2, 6.0), st.integers(1, 3), st.booleans(), st.integers(0, 2**32))
@example(40, 1.25, 3, False, 13055)  # the weights of a line go up to 8 in all, and take 35 levels around 127 beyond 255
def test_lines_before_they_were_enlarged(length, times, columns, beyond, seed):
    rows, random = round(length * times), np.random.default_rng(seed)
    at = (np.arange(rows) + 0.5) * length / rows - 0.5
    near = np.floor(at).astype(int)[:, None] + np.arange(-2, 4)
    off = np.abs(at[:, None] - near)
    weights = np.where((near >= 0) & (near < length) & (off < 2.0), np.cos(0.5 * np.pi * off) + 0.2 * (off < 1.0), 0.0)
    weights /= weights.sum(axis=1, keepdims=True)
    enlarging = np.zeros((rows, length))
    np.add.at(enlarging, (np.arange(rows)[:, None], near.clip(0, length - 1)), weights)
    most = int(127.0 / np.abs(enlarging).sum(axis=1).max())  # levels: nothing within these around 127 is cut off
    least, end = (0, 256) if beyond else (127 - most, 128 + most)
    small = random.integers(least, end, (length, columns))
    found, again = ours.before_enlarging(np.clip(enlarging @ small, 0.0, 255.0), length, near[:, 0], weights)
    np.testing.assert_allclose(again, enlarging @ found, atol=1e-9)
    if not beyond:  # else what was cut off at an end of the scale is not always found in six rounds
        same(found, small.astype(float))
    noisy = 127.0 + random.normal(0.0, 5.0, (rows, columns))
    nearest = np.linalg.lstsq(enlarging, noisy, rcond=None)[0].clip(0.0, 255.0)
    assert np.abs(ours.before_enlarging(noisy, length, near[:, 0], weights)[0] - nearest).max() <= 0.5 + 1e-6
