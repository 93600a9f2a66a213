"""Derivatives of the reference renderer: finite differences, and the rules where no derivative exists."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import pytest
import reference
import reference_coverage
import torch
from conftest import rest_slow
from reference import MAX_ALPHA
from scenes import (
    COVERAGES,
    MODES,
    PAPER,
    TENSORS,
    ZERO,
    assert_close,
    in_double,
    point,
    polyline,
    random_scene,
    random_target,
    rectangle,
    reference_render,
    reverse_ring,
    scene_of,
    slopes,
    straight,
)
from torch import Tensor

from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode


def gradients(scene: Scene, objective: Callable[[Scene], Tensor], names: tuple[str, ...]) -> dict[str, Tensor]:
    scene = in_double(scene, requires_grad=True)
    values = torch.autograd.grad(objective(scene), [getattr(scene, n) for n in names])
    return dict(zip(names, values, strict=True))


def finite_differences(scene: Scene, objective: Callable[[Scene], Tensor], name: str) -> Tensor:
    """Central differences of the objective for every value of one tensor."""
    scene = in_double(scene)
    values = getattr(scene, name)
    found = slopes(lambda changed: objective(replace(scene, **{name: changed})), values, 1e-6)
    return torch.tensor(list(found.values()), dtype=torch.float64).view_as(values)


@pytest.mark.parametrize(
    ("mode", "background", "edge_width"),
    rest_slow((Mode.OPEN, None, 0.8), *product(MODES, (PAPER, None), (0.8, 3.0))),
)
def test_relaxed_gradients_match_finite_differences(mode, background, edge_width):
    scene = random_scene(mode, 4, 2, 13, 11, seed=7, background=background, opacity=(0.3, 0.8), scale=0.3)
    target = random_target(scene).double()
    names = TENSORS if mode is Mode.OPEN else TENSORS[:3]

    def objective(candidate: Scene) -> Tensor:
        return reference.image_loss(reference_render(candidate, edge_width=edge_width), target)

    for name, exact in gradients(scene, objective, names).items():
        numeric = finite_differences(scene, objective, name)
        largest = exact.abs().view(scene.curves, -1).amax(dim=1)
        assert largest.min() > 1e-4, f"every curve should have a gradient for {name}"
        assert_close(exact, numeric, rtol=2e-5, atol=2e-6 * float(exact.abs().max()))


@pytest.mark.parametrize("mode", MODES)
def test_exact_gradients_of_colours_and_opacities_match_finite_differences(mode):
    scene = random_scene(mode, 4, 2, 13, 11, seed=8, opacity=(0.3, 0.8), scale=0.3)
    target = random_target(scene).double()

    def objective(candidate: Scene) -> Tensor:
        return reference.image_loss(reference_render(candidate, "exact"), target)

    for name, exact in gradients(scene, objective, ("colours", "opacities")).items():
        assert exact.abs().min() > 0.0
        numeric = finite_differences(scene, objective, name)
        assert_close(exact, numeric, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("mode", MODES)
def test_exact_mode_takes_the_geometry_derivative_of_the_relaxed_edge(mode):
    """With one curve the picture is linear in its coverage, so both modes must give the same derivative."""
    scene = random_scene(mode, 1, 3, 15, 14, seed=3, scale=0.4)
    weights = torch.rand(14, 15, 4, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    names = ("points", "half_widths") if mode is Mode.OPEN else ("points",)
    relaxed, exact = (
        gradients(scene, lambda s, c=coverage: (weights * reference_render(s, c, 1.7)).sum(), names)
        for coverage in COVERAGES
    )
    for name in names:
        assert relaxed[name].abs().max() > 0.1
        assert_close(exact[name], relaxed[name], rtol=1e-12, atol=1e-12)
    assert not torch.allclose(reference_render(scene, "relaxed", 1.7), reference_render(scene, "exact", 1.7), atol=1e-3)


@pytest.mark.parametrize("reverse", [False, True], ids=["clockwise", "anticlockwise"])
def test_outline_through_pixel_centres_has_the_normal_as_gradient(reverse):
    """The left side of the rectangle runs through the centres of column 2: coverage 1/2, slope 1 / w."""
    points = rectangle(2.5, 1.0, 8.0, 9.0).double()
    if reverse:
        points = reverse_ring(points)
    points.requires_grad_()
    vertices = polyline(points)
    at = point(2.5, 5.5)
    covered = reference_coverage.coverage_relaxed(vertices, ZERO, at, Mode.CLOSED, 1.25)
    assert_close(covered.detach(), torch.tensor([0.5], dtype=torch.float64))
    (gradient,) = torch.autograd.grad(covered.sum(), points)
    left = (points[:, 0] == 2.5).nonzero().squeeze(1)
    # Moving the side by one pixel to the right takes 1 / w of coverage; sideways movement changes nothing.
    assert gradient[left, 0].sum().item() == pytest.approx(-1.0 / 1.25, rel=1e-7)
    assert gradient[:, 1].abs().max() == 0.0

    def moved(step: float) -> Tensor:
        shifted = points.detach().clone()
        shifted[left, 0] += step
        return reference_coverage.coverage_relaxed(polyline(shifted), ZERO, at, Mode.CLOSED, 1.25)

    numeric = (moved(1e-5) - moved(-1e-5)).item() / 2e-5
    assert numeric == pytest.approx(-1.0 / 1.25, rel=1e-6)


@pytest.mark.parametrize("shape", ["point", "sliver"])
def test_outline_without_a_normal_has_no_gradient(shape):
    line = straight([(1.5, 2.5), (7.5, 2.5)], closed=True)
    points = (line if shape == "sliver" else torch.full((6, 2), 4.5)).double().requires_grad_()
    at = torch.stack((torch.arange(1.5, 8.0), torch.full((7,), 2.5 if shape == "sliver" else 4.5)), dim=1)
    u = reference_coverage.signed_distance(polyline(points), at.double())
    on_line = u.detach().abs() < 1e-6
    assert on_line.sum() == (7 if shape == "sliver" else 1)
    (gradient,) = torch.autograd.grad(u[on_line].sum(), points)
    assert gradient.abs().max() == 0.0


def test_stroke_through_pixel_centres_has_a_width_gradient_only():
    points = straight([(1.0, 4.5), (9.0, 4.5)], closed=False).double().requires_grad_()
    half_width = torch.tensor(0.3, dtype=torch.float64, requires_grad=True)
    covered = reference_coverage.coverage_relaxed(
        polyline(points, Mode.OPEN), half_width, point(5.5, 4.5), Mode.OPEN, 1.0
    )
    of_points, of_width = torch.autograd.grad(covered.sum(), (points, half_width))
    assert of_points.abs().max() == 0.0
    z = 0.3 / 1.5 + 0.5
    assert covered.item() == pytest.approx(2.0 * z * z * (3.0 - 2.0 * z) - 1.0)
    assert of_width.item() == pytest.approx(2.0 * 6.0 * z * (1.0 - z) / 1.5)


def test_curve_of_no_width_can_grow():
    scene = replace(random_scene(Mode.OPEN, 3, 2, 16, 16, seed=2), half_widths=torch.zeros(3))
    found = gradients(scene, lambda s: reference_render(s)[..., 3].sum(), ("points", "half_widths"))
    assert (found["half_widths"] > 0.1).all()
    assert found["points"].abs().max() == 0.0


def test_limited_alpha_has_no_gradient():
    # Inside the square alpha is limited to MAX_ALPHA; the canvas sees nothing but its inside.
    scene = scene_of(Mode.CLOSED, [rectangle(-20.0, -20.0, 30.0, 30.0)], 6, 5, opacity=1.0)
    picture = reference_render(scene)
    assert_close(picture[..., 3], torch.full((5, 6), MAX_ALPHA, dtype=torch.float64))
    found = gradients(scene, lambda s: reference_render(s).sum(), ("points", "opacities", "colours"))
    assert found["points"].abs().max() == 0.0
    assert found["opacities"].abs().max() == 0.0
    assert_close(found["colours"], torch.full((1, 3), 30 * MAX_ALPHA, dtype=torch.float64))


def test_alpha_gradient_is_the_single_pass_formula():
    """dF.g/dalpha_i = T_before <c_i, g> - <F - acc_i, g> / (1 - alpha_i), with acc_i including i."""
    generator = torch.Generator().manual_seed(5)
    alphas = 0.8 * torch.rand(5, 4, 3, generator=generator, dtype=torch.float64)
    colours = torch.rand(5, 3, generator=generator, dtype=torch.float64)
    g = torch.randn(4, 3, 3, generator=generator, dtype=torch.float64)
    background = torch.tensor(PAPER, dtype=torch.float64)
    alphas.requires_grad_()
    picture = reference.composite(alphas, colours, background)
    (automatic,) = torch.autograd.grad((picture * g).sum(), alphas)
    for i, layer in enumerate(reference.front_to_back(alphas.detach(), colours)):
        behind = ((picture.detach() - layer.after) * g).sum(-1)
        formula = layer.transmittance * (colours[i] * g).sum(-1) - behind / (1.0 - layer.alpha)
        assert formula.abs().min() > 0.0
        assert_close(automatic[i], formula)
