"""Bezier mathematics: bases, flattening and its error bound, subdivision."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_coverage import bernstein, polyline_basis, segment_indices
from scenes import MODES, assert_close, random_scene
from torch import Tensor

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.scene import points_from_segments, segments_from_points
from cubicsplat_cli.settings import Mode

quick = settings(derandomize=True)
coordinate = st.floats(-1000.0, 1000.0, allow_nan=False, width=32)
parameter = st.floats(0.0, 1.0)


@st.composite
def control_points(draw, mode: Mode, max_segments: int = 4) -> Tensor:
    """(1, K, 2) float64 control points of one curve."""
    count = points_from_segments(mode, draw(st.integers(1, max_segments)))
    values = draw(st.lists(coordinate, min_size=2 * count, max_size=2 * count))
    return torch.tensor(values, dtype=torch.float64).view(1, count, 2)


def segment() -> st.SearchStrategy[Tensor]:
    """(4, 2) float64 control points of one cubic."""
    return st.lists(coordinate, min_size=8, max_size=8).map(
        lambda values: torch.tensor(values, dtype=torch.float64).view(4, 2)
    )


def curve_at(points: Tensor, t: Tensor) -> Tensor:
    """Points of a cubic (4, D) at parameters t (S,), by repeated interpolation rather than by the basis."""
    level = points.expand(len(t), *points.shape)
    while level.shape[1] > 1:
        level = level[:, :-1] + t.view(-1, 1, 1) * (level[:, 1:] - level[:, :-1])
    return level[:, 0]


def segment_points(points: Tensor, mode: Mode) -> Tensor:
    """(N, K, 2) to the control points of each segment, (N, M, 4, 2)."""
    return points[:, segment_indices(mode, segments_from_points(mode, points.shape[1]))]


def deviation(points: Tensor, mode: Mode, samples: int, dense: int = 20) -> Tensor:
    """(M,): the largest distance between curve and polyline at equal parameters, over a dense set of them.

    Every point of either lies within this of a point of the other, so it bounds the Hausdorff distance.
    """
    t = torch.arange(samples * dense + 1, dtype=torch.float64) / (samples * dense)
    steps = torch.arange(samples + 1, dtype=torch.float64) / samples
    fraction = torch.arange(dense, dtype=torch.float64).view(1, -1, 1) / dense
    worst = []
    for cubic in segment_points(points, mode)[0]:
        ends = curve_at(cubic, steps)
        chords = ((1.0 - fraction) * ends[:-1, None] + fraction * ends[1:, None]).flatten(0, 1)
        worst.append((curve_at(cubic, t)[:-1] - chords).norm(dim=-1).max())
    return torch.stack(worst)


def test_bernstein_is_a_partition_of_unity_with_the_right_ends():
    t = torch.linspace(0.0, 1.0, 11, dtype=torch.float64)
    values = bernstein(t)
    assert values.shape == (11, 4)
    assert (values >= 0.0).all()
    assert_close(values.sum(dim=1), torch.ones(11, dtype=torch.float64))
    assert values[0].tolist() == [1.0, 0.0, 0.0, 0.0]
    assert values[-1].tolist() == [0.0, 0.0, 0.0, 1.0]
    assert values[5].tolist() == [0.125, 0.375, 0.375, 0.125]


def test_segment_indices_close_the_ring_and_chain_the_open_curve():
    assert segment_indices(Mode.CLOSED, 2).tolist() == [[0, 1, 2, 3], [3, 4, 5, 0]]
    assert segment_indices(Mode.CLOSED, 1).tolist() == [[0, 1, 2, 0]]
    assert segment_indices(Mode.OPEN, 2).tolist() == [[0, 1, 2, 3], [3, 4, 5, 6]]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("segments", [1, 2, 4])
@pytest.mark.parametrize("samples", [1, 5, 12])
def test_polyline_vertices_lie_on_the_curve_at_uniform_parameters(mode, segments, samples):
    points = random_scene(mode, 2, segments, 50, 40, seed=segments).points.double()
    basis = polyline_basis(mode, segments, samples)
    count = segments * samples + (mode is Mode.OPEN)
    assert basis.shape == (count, points.shape[1])
    assert basis.dtype == torch.float64
    vertices = basis @ points
    t = torch.arange(samples, dtype=torch.float64) / samples
    for curve, cubics in enumerate(segment_points(points, mode)):
        expected = torch.cat([curve_at(cubic, t) for cubic in cubics])
        assert_close(vertices[curve, : segments * samples], expected)
    if mode is Mode.OPEN:
        assert torch.equal(vertices[:, -1], points[:, -1])


@pytest.mark.parametrize("mode", MODES)
@given(data=st.data(), matrix=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6))
@quick
def test_flattening_commutes_with_affine_maps(mode, data, matrix):
    points = data.draw(control_points(mode))
    linear = torch.tensor(matrix[:4], dtype=torch.float64).view(2, 2)
    shift = 100.0 * torch.tensor(matrix[4:], dtype=torch.float64)
    segments = len(segment_points(points, mode)[0])
    basis = polyline_basis(mode, segments, 7)
    mapped_after = (basis @ points) @ linear + shift
    mapped_before = basis @ (points @ linear + shift)
    assert_close(mapped_after, mapped_before, rtol=1e-12, atol=1e-8)


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: polyline_basis(Mode.OPEN, 3, 0), UsageError, "samples"),
        (lambda: polyline_basis(Mode.OPEN, 0, 4), InputError, "segment"),
    ],
)
def test_wrong_arguments_are_named(call, error, words):
    with pytest.raises(error, match=words):
        call()
