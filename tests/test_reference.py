"""The reference renderer against analytic values and naive loops."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import pytest
import reference
import reference_coverage
import torch
from conftest import rest_slow
from reference import MAX_ALPHA, MIN_TRANSMITTANCE
from scenes import (
    BACKGROUNDS,
    COVERAGES,
    DEGENERATE,
    MODES,
    PAPER,
    TENSORS,
    ZERO,
    assert_close,
    circle,
    figure_eight,
    in_double,
    only,
    point,
    polyline,
    random_scene,
    random_target,
    rectangle,
    reference_render,
    reverse_ring,
    scene_of,
    straight,
)
from torch import Tensor

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode

# --- distance, winding -------------------------------------------


def test_distance_to_a_segment():
    vertices = torch.tensor([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]], dtype=torch.float64)
    at = torch.tensor([[2.0, -1.5], [-3.0, 4.0], [5.0, 2.0], [4.0, 7.0], [4.0, 0.0]], dtype=torch.float64)
    expected = torch.tensor([1.5, 5.0, 1.0, 4.0, 0.0], dtype=torch.float64)
    assert_close(reference_coverage.distance(vertices, at), expected)
    # Closed, the edge from the last vertex back to the first counts too: the point lies 0.8 px from it.
    triangle = reference_coverage.nearest(vertices, point(1.0, 1.75), Mode.CLOSED)
    assert_close(triangle.distance, torch.tensor([0.8], dtype=torch.float64))


def test_signed_distance_is_positive_inside_whatever_the_orientation():
    points = rectangle(2.0, 2.0, 8.0, 8.0)
    at = torch.tensor([[5.0, 3.0], [5.0, 0.5]], dtype=torch.float64)
    for ring in (points, reverse_ring(points)):
        u = reference_coverage.signed_distance(polyline(ring), at)
        assert_close(u, torch.tensor([1.0, -1.5], dtype=torch.float64))


def test_winding_of_a_figure_eight_is_nonzero_in_both_lobes():
    vertices = polyline(figure_eight(Mode.CLOSED, 20.0, 20.0))
    left, right, above = point(3.0, 10.0), point(17.0, 10.0), point(10.0, 3.0)
    values = [int(reference_coverage.winding(vertices, at)) for at in (left, right, above)]
    assert sorted(values[:2]) == [-1, 1]
    assert values[2] == 0
    assert (reference_coverage.signed_distance(vertices, torch.cat((left, right))) > 0.0).all()
    assert reference_coverage.signed_distance(vertices, above) < 0.0


def test_winding_of_a_double_loop_is_two():
    ring = circle(10.0, 10.0, 6.0)
    inner = circle(10.0, 10.0, 3.0)
    centre = point(10.2, 9.7)
    twice = polyline(torch.cat((ring, inner)))
    assert abs(int(reference_coverage.winding(twice, centre))) == 2
    assert int(reference_coverage.winding(twice.flip(0), centre)) == -int(reference_coverage.winding(twice, centre))
    assert reference_coverage.signed_distance(twice, centre) > 0.0
    assert float(reference_coverage.coverage_exact(twice, ZERO, Mode.CLOSED, 20, 20)[9, 10]) == pytest.approx(1.0)
    # Opposite turns cancel: the nonzero rule leaves a hole.
    hole = polyline(torch.cat((ring, reverse_ring(inner))))
    assert int(reference_coverage.winding(hole, centre)) == 0
    assert reference_coverage.signed_distance(hole, centre) < 0.0
    assert float(reference_coverage.coverage_exact(hole, ZERO, Mode.CLOSED, 20, 20)[9, 10]) == pytest.approx(0.0)


def test_vertex_on_the_scan_line_counts_once():
    diamond = polyline(straight([(5.5, 1.5), (9.5, 5.5), (5.5, 9.5), (1.5, 5.5)], closed=True))
    row = torch.stack((torch.arange(12) + 0.5, torch.full((12,), 5.5)), dim=1).double()
    inside = (reference_coverage.winding(diamond, row) != 0).tolist()
    # A crossing at the point itself counts, so the left corner is inside and the right one outside.
    assert inside == [1.5 <= x < 9.5 for x in row[:, 0].tolist()]
    for y in (1.5, 9.5):
        tip = torch.stack((torch.arange(12) + 0.5, torch.full((12,), y)), dim=1).double()
        assert (reference_coverage.winding(diamond, tip) == 0).all()


def test_horizontal_edges_count_at_the_top_and_not_at_the_bottom():
    vertices = torch.tensor([[2.0, 1.5], [8.0, 1.5], [8.0, 6.5], [2.0, 6.5]], dtype=torch.float64)
    column = torch.stack((torch.full((9,), 4.5), torch.arange(9) + 0.5), dim=1).double()
    assert (reference_coverage.winding(vertices, column) != 0).tolist() == [
        1.5 <= y < 6.5 for y in column[:, 1].tolist()
    ]


# --- coverage ----------------------------------------------------


def test_smooth_step_ends_slope_and_symmetry():
    u = torch.tensor([-9.0, -1.5, 0.0, 1.5, 9.0], dtype=torch.float64, requires_grad=True)
    values = reference_coverage.smooth_step(u, 2.0)
    assert values.tolist() == [0.0, 0.0, 0.5, 1.0, 1.0]
    (slope,) = torch.autograd.grad(values.sum(), u)
    assert_close(slope, torch.tensor([0.0, 0.0, 0.5, 0.0, 0.0], dtype=torch.float64))
    either_side = reference_coverage.smooth_step(torch.tensor([0.7, -0.7]), 2.0)
    assert either_side.sum().item() == pytest.approx(1.0)


def overlap(low: float, high: float, count: int) -> Tensor:
    """Length of [low, high] in each of the unit cells 0 .. count - 1."""
    cell = torch.arange(count, dtype=torch.float64)
    return (torch.clamp(cell + 1.0, max=high) - torch.clamp(cell, min=low)).clamp(min=0.0)


@pytest.mark.parametrize(
    ("left", "top", "right", "bottom"),
    [
        (2.0, 3.0, 7.0, 8.0),
        (2.3, 3.25, 7.85, 8.5),
        (2.31, 3.27, 7.87, 8.53),
        (4.1, 5.0, 4.3, 6.0),  # thinner than a pixel
        (-5.5, -3.0, 30.0, 4.75),  # over the canvas edge on three sides
    ],
)
def test_exact_coverage_of_a_rectangle_is_its_area(left, top, right, bottom):
    vertices = polyline(rectangle(left, top, right, bottom), samples=5)
    covered = reference_coverage.coverage_exact(vertices, ZERO, Mode.CLOSED, 12, 11)
    area = overlap(top, bottom, 11).unsqueeze(1) * overlap(left, right, 12)
    assert area.max() > 0.1
    assert (covered - area).abs().max() <= 1e-5  # the vertices are made in single precision


def test_exact_coverage_of_a_disc_sums_to_its_area():
    vertices = polyline(circle(15.3, 14.2, 9.7), samples=24)
    covered = reference_coverage.coverage_exact(vertices, ZERO, Mode.CLOSED, 30, 28)
    assert covered.sum().item() == pytest.approx(float(reference_coverage.signed_area(vertices)), rel=1e-9)
    assert covered.sum().item() == pytest.approx(math.pi * 9.7**2, rel=1e-3)
    assert float(covered[14, 15]) == pytest.approx(1.0)
    assert covered[0, 0] == 0.0


@pytest.mark.parametrize("seed", rest_slow(*range(3)))
def test_exact_coverage_of_a_fill_matches_supersampled_winding(seed):
    scene = random_scene(Mode.CLOSED, 1, 4, 14, 12, seed=seed, scale=0.6)
    vertices = reference_coverage.flatten(scene.points, Mode.CLOSED, 8)[0]
    x = (torch.arange(14 * 24, dtype=torch.float64) + 0.5) / 24
    y = (torch.arange(12 * 24, dtype=torch.float64) + 0.5) / 24
    grid = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
    inside = (reference_coverage.winding(vertices, grid) != 0).double().view(12, 24, 14, 24).mean(dim=(1, 3))
    covered = reference_coverage.coverage_exact(vertices, ZERO, Mode.CLOSED, 14, 12)
    assert 0.05 < covered.mean() < 0.95
    assert (covered - inside).abs().max() < 1.0 / 64.0
    assert (covered - inside).abs().mean() < 1e-3


@pytest.mark.parametrize("half_width", [0.05, 0.2, 0.45])
@pytest.mark.parametrize("y", [5.5, 5.37, 6.0])
def test_thin_horizontal_stroke_covers_twice_its_half_width(half_width, y):
    vertices = polyline(straight([(-5.0, y), (25.0, y)], closed=False), Mode.OPEN)
    width = torch.tensor(half_width, dtype=torch.float64)
    covered = reference_coverage.coverage_exact(vertices, width, Mode.OPEN, 10, 12)
    assert_close(covered.sum(0), torch.full((10,), 2.0 * half_width, dtype=torch.float64), rtol=1e-5, atol=1e-6)
    if y == 5.5:
        assert (covered[5] > 0.0).all()
        assert covered.sum().item() == pytest.approx(covered[5].sum().item())


def test_relaxed_coverage_of_a_thin_stroke_is_linear_in_its_width():
    vertices = polyline(straight([(-5.0, 5.5), (25.0, 5.5)], closed=False), Mode.OPEN)
    centres = reference_coverage.pixel_centres(10, 12)
    for half_width in (1e-3, 2e-3):
        width = torch.tensor(half_width, dtype=torch.float64)
        covered = reference_coverage.coverage_relaxed(vertices, width, centres, Mode.OPEN, 1.0)
        # Through the centres: 2 r phi'(0) = 2 r.
        assert_close(covered[5], torch.full((10,), 2.0 * half_width, dtype=torch.float64), rtol=1e-4, atol=0.0)


@pytest.mark.parametrize("radius", [0.4, 3.3])
def test_exact_coverage_of_a_dot_is_the_area_of_its_disc(radius):
    vertices = torch.tensor([[8.13, 7.71]], dtype=torch.float64).expand(4, 2)
    width = torch.tensor(radius, dtype=torch.float64)
    covered = reference_coverage.coverage_exact(vertices, width, Mode.OPEN, 16, 15)
    # Smoothing a disc's edge over h adds h^2 / 12 to its mean squared radius.
    area = math.pi * (radius**2 + 0.25**2 / 12.0)
    assert covered.sum().item() == pytest.approx(area, rel=0.01)


def test_exact_stroke_coverage_matches_supersampling():
    scene = random_scene(Mode.OPEN, 1, 3, 16, 14, seed=1, scale=0.5)
    vertices = reference_coverage.flatten(scene.points, Mode.OPEN, 8)[0]
    width = torch.tensor(1.7, dtype=torch.float64)
    x, y = ((torch.arange(n * 24, dtype=torch.float64) + 0.5) / 24 for n in (16, 14))
    fine = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
    inside = (reference_coverage.distance(vertices, fine) < width).double().view(14, 24, 16, 24).mean(dim=(1, 3))
    covered = reference_coverage.coverage_exact(vertices, width, Mode.OPEN, 16, 14)
    assert covered.mean() > 0.05
    assert (covered - inside).abs().max() < 0.04
    assert (covered - inside).abs().mean() < 0.003


def test_relaxed_coverage_falls_from_one_to_zero_over_the_edge_width():
    vertices = polyline(rectangle(4.0, -50.0, 80.0, 50.0))
    at = torch.stack((torch.linspace(0.0, 8.0, 81), torch.zeros(81)), dim=1).double()
    covered = reference_coverage.coverage_relaxed(vertices, ZERO, at, Mode.CLOSED, 2.0)
    assert (covered.diff() >= 0.0).all()
    assert ((covered == 0.0) == (at[:, 0] <= 2.5)).all()
    assert ((covered == 1.0) == (at[:, 0] >= 5.5)).all()
    assert covered[40].item() == pytest.approx(0.5)


# --- compositing -------------------------------------------------


def over_loop(alphas: Tensor, colours: Tensor, background: Tensor) -> Tensor:
    """Back to front with Porter and Duff's "over", a different order of work from the renderer's."""
    picture = background.expand(*alphas.shape[1:], -1).clone()
    for alpha, colour in zip(alphas.flip(0), colours.flip(0), strict=True):
        picture = alpha.unsqueeze(-1) * colour + (1.0 - alpha.unsqueeze(-1)) * picture
    return picture


@pytest.mark.parametrize("channels", [3, 4])
def test_composite_is_over_from_back_to_front(channels):
    generator = torch.Generator().manual_seed(channels)
    alphas = 0.7 * torch.rand(5, 6, 7, generator=generator, dtype=torch.float64)
    colours = torch.rand(5, channels, generator=generator, dtype=torch.float64)
    background = torch.rand(channels, generator=generator, dtype=torch.float64)
    picture = reference.composite(alphas, colours, background)
    assert picture.shape == (6, 7, channels)
    assert_close(picture, over_loop(alphas, colours, background))


def test_the_first_curve_is_in_front():
    scene = scene_of(
        Mode.CLOSED, [rectangle(0, 0, 8, 8), rectangle(-2, -2, 10, 10)], 8, 8, background=PAPER, opacity=1.0
    )
    middle = reference_render(scene)[4, 4]
    assert (middle - scene.colours[0]).abs().max() < 1.0 - MAX_ALPHA + 1e-6


def test_a_pixel_stops_when_little_light_is_left():
    colours = torch.eye(3, dtype=torch.float64)
    alphas = torch.tensor([[[MAX_ALPHA, 0.99]], [[0.5, 0.5]], [[0.5, 0.5]]], dtype=torch.float64)
    picture = reference.composite(alphas, colours, torch.zeros(3, dtype=torch.float64))
    assert 1.0 - MAX_ALPHA < MIN_TRANSMITTANCE
    assert picture[0, 0].tolist() == [MAX_ALPHA, 0.0, 0.0]
    assert_close(picture[0, 1], torch.tensor([0.99, 0.005, 0.0025], dtype=torch.float64))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("coverage", COVERAGES)
def test_rgba_over_a_background_is_the_rgb_picture(mode, coverage):
    transparent = random_scene(mode, 8, 3, 18, 17, seed=6, opacity=(0.2, 1.0))
    rgba = reference_render(transparent, coverage)
    rgb = reference_render(replace(transparent, background=PAPER), coverage)
    assert rgba.shape == (17, 18, 4)
    assert rgb.shape == (17, 18, 3)
    assert 0.1 < rgba[..., 3].mean() < 0.95
    behind = torch.tensor(PAPER, dtype=torch.float64)
    assert_close(rgba[..., :3] + (1.0 - rgba[..., 3:]) * behind, rgb)


def test_render_is_the_composite_of_its_coverages():
    scene = random_scene(Mode.OPEN, 5, 2, 15, 12, seed=9, background=PAPER, opacity=(0.2, 0.8))
    centres = reference_coverage.pixel_centres(15, 12)
    assert centres[2, 3].tolist() == [3.5, 2.5]
    alphas = torch.stack(
        [
            opacity * reference_coverage.coverage_relaxed(vertices, half_width, centres, Mode.OPEN, 1.0)
            for vertices, half_width, opacity in zip(
                reference_coverage.flatten(scene.points, Mode.OPEN, 6),
                scene.half_widths.double(),
                scene.opacities.double(),
                strict=True,
            )
        ]
    )
    background = torch.tensor(PAPER, dtype=torch.float64)
    assert_close(reference_render(scene), over_loop(alphas, scene.colours.double(), background))


# --- loss and importance -----------------------------------------


def test_loss_of_rgb_is_the_sum_of_squares():
    image, target = torch.rand(2, 5, 4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    assert float(reference.image_loss(image, target)) == pytest.approx(float(((image - target) ** 2).sum()))


def test_loss_of_rgba_is_the_mean_over_black_and_over_white():
    image, target = torch.rand(2, 5, 4, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(2))

    def on(picture: Tensor, level: float) -> Tensor:
        return picture[..., :3] + (1.0 - picture[..., 3:]) * level

    expected = sum(((on(image, level) - on(target, level)) ** 2).sum() for level in (0.0, 1.0)) / 2.0
    assert float(reference.image_loss(image, target)) == pytest.approx(float(expected))


def importance(scene: Scene, coverage: str, **options: object) -> Tensor:
    return reference.importance(scene, RasterSettings(coverage, 1.0, 6), **options)


def without(scene: Scene, removed: int) -> Scene:
    return only(scene, [i for i in range(scene.curves) if i != removed])


@pytest.mark.parametrize(
    ("mode", "background", "coverage"),
    rest_slow(
        (Mode.CLOSED, None, "exact"),
        (Mode.OPEN, PAPER, "relaxed"),
        *product(MODES, (PAPER, None), COVERAGES),
        fast=2,
    ),
)
def test_leave_one_out_importance_is_what_removing_costs(mode, background, coverage):
    # Five curves of opacity 0.7 at most leave 0.3^5 of the light: no pixel stops early.
    scene = random_scene(mode, 5, 3, 20, 18, seed=11, background=background, opacity=(0.3, 0.7), scale=0.35)
    assert (1.0 - scene.opacities).prod() > MIN_TRANSMITTANCE
    target = random_target(scene)
    found = importance(scene, coverage, target=target)
    loss = reference.image_loss(reference_render(scene, coverage), target)
    removed = [
        reference.image_loss(reference_render(without(scene, i), coverage), target) - loss for i in range(scene.curves)
    ]
    assert found.abs().min() > 1e-2
    assert_close(found, torch.stack(removed), rtol=1e-9, atol=1e-9)


def test_leave_one_out_importance_tells_good_from_bad():
    """A curve that matches the target has positive importance, one of the wrong colour negative."""
    shapes = [rectangle(1, 1, 6, 6), rectangle(8, 8, 14, 14)]
    scene = scene_of(Mode.CLOSED, shapes, 16, 16, background=(1.0, 1.0, 1.0), opacity=0.9)
    target = torch.ones(16, 16, 3)
    target[1:6, 1:6] = scene.colours[0]
    target[8:14, 8:14] = 1.0
    good, bad = importance(scene, "exact", target=target)
    assert good > 1.0
    assert bad < -1.0


@pytest.mark.parametrize("coverage", COVERAGES)
def test_visibility_is_the_light_each_curve_returns(coverage):
    scene = random_scene(Mode.CLOSED, 5, 3, 20, 18, seed=12, opacity=(0.3, 0.9), scale=0.35)
    found = importance(scene, coverage, kind="visibility")
    # With colour (1, 0, 0) for one curve and black for the others, the red channel is its T alpha.
    for i in range(scene.curves):
        red = torch.zeros(scene.curves, 3)
        red[i, 0] = 1.0
        seen = reference_render(replace(scene, colours=red), coverage)[..., 0].sum()
        assert seen > 0.1
        assert_close(found[i], seen)


def test_a_hidden_curve_is_not_visible():
    scene = scene_of(
        Mode.CLOSED, [rectangle(-9, -9, 20, 20), rectangle(2, 2, 5, 5)], 8, 8, background=PAPER, opacity=1.0
    )
    front, hidden = importance(scene, "exact", kind="visibility")
    assert front.item() == pytest.approx(64 * MAX_ALPHA)
    assert hidden == 0.0
    assert importance(scene, "exact", target=torch.zeros(8, 8, 3))[1] == 0.0


# --- degenerate scenes and wrong arguments -----------------------


EACH_IN_ONE = [(name, COVERAGES[i // 2 % 2]) for i, (name, _) in enumerate(DEGENERATE)]


@pytest.mark.parametrize(
    ("name", "coverage"),
    rest_slow(*EACH_IN_ONE[::2], *product(dict(DEGENERATE), COVERAGES), fast=len(EACH_IN_ONE[::2])),
)
def test_degenerate_scenes_render_finitely(name, coverage):
    scene = dict(DEGENERATE)[name]
    leaves = in_double(scene, requires_grad=True)
    picture = reference_render(leaves, coverage)
    target = random_target(scene)
    assert picture.shape == (scene.height, scene.width, scene.channels)
    assert torch.isfinite(picture).all()
    assert picture.min() >= 0.0
    assert picture.max() <= 1.0 + 1e-12
    values = torch.autograd.grad(
        reference.image_loss(picture, target), [getattr(leaves, n) for n in TENSORS], materialize_grads=True
    )
    assert all(torch.isfinite(value).all() for value in values)
    for options in ({"target": target}, {"kind": "visibility"}):
        assert torch.isfinite(importance(scene, coverage, **options)).all()


@pytest.mark.parametrize("background", BACKGROUNDS)
@pytest.mark.parametrize("name", ["opacity-0", "all-off-canvas", "stroke-0.0"])
def test_what_covers_nothing_leaves_the_background(name, background):
    wanted = f"open-{'rgba' if background is None else 'rgb'}-{name}"
    scene = dict(DEGENERATE)[wanted]
    expected = torch.tensor(background or (0.0, 0.0, 0.0, 0.0), dtype=torch.float64)
    for coverage in COVERAGES:
        assert (reference_render(scene, coverage) == expected).all()


@pytest.mark.parametrize("name", ["coincident-points", "zero-area", "folded-back"])
def test_a_fill_without_area_covers_nothing_exactly(name):
    scene = dict(DEGENERATE)[f"closed-rgba-{name}"]
    first = only(scene, [0])
    assert reference_render(first, "exact").abs().max() < 1e-6
    assert reference_render(first, "relaxed").max() > 0.1, "the relaxed edge shows it as a hairline"


def test_render_keeps_float32_inputs_differentiable():
    scene = random_scene(Mode.CLOSED)
    points = scene.points.requires_grad_()
    picture = reference_render(replace(scene, points=points))
    assert picture.dtype == torch.float64
    (gradient,) = torch.autograd.grad(picture.sum(), points)
    assert gradient.dtype == torch.float32
    assert gradient.abs().max() > 0.0


def test_wrong_arguments_are_named():
    scene = random_scene(Mode.CLOSED)
    with pytest.raises(InputError, match="opacities"):
        reference_render(replace(scene, opacities=scene.opacities + 2.0))
    with pytest.raises(InputError, match="image and target"):
        reference.image_loss(torch.zeros(2, 2, 3), torch.zeros(2, 3, 3))
    with pytest.raises(InputError, match="image and target"):
        importance(scene, "relaxed", target=torch.zeros(20, 24, 3))
    with pytest.raises(UsageError, match="needs a target"):
        importance(scene, "relaxed")
    with pytest.raises(UsageError, match="'loo' or 'visibility'"):
        importance(scene, "relaxed", kind="gini")
