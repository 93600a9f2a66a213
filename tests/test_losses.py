"""`--loss`: what the fit of a photo minimises, pixel by pixel in the engine and by autograd."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import torch
from cli_runs import strict_json
from conftest import rest_slow
from test_fit import picture, settings

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.options import LOSSES, listed, loss_text, parse_loss
from cubicsplat_cli.photo.evaluator import ABSOLUTE, Objective
from cubicsplat_cli.photo.loop import fit
from cubicsplat_cli.photo.ms_ssim import MsSsim
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.settings import FitSettings

MIXTURES = ["l2", "l1", "huber", "ms-ssim", "l2:0.7,ms-ssim:0.3", "l2:1,huber:1"]


def random_picture(seed: int, *shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize(
    ("loss", "alpha"),
    rest_slow(("huber", False), ("l2:0.7,ms-ssim:0.3", True), *product(MIXTURES, (False, True)), fast=2),
)
def test_a_fit_lowers_the_loss_that_it_is_asked_for(loss, alpha):
    target = picture(alpha=alpha)
    objective = Objective(loss, torch.from_numpy(target), None)
    early, late = (fit(target, settings(loss=loss, steps=steps)) for steps in (2, 60))
    before, after = (float(objective.of(torch.from_numpy(render_scene(f.scene, threads=1)))) for f in (early, late))
    assert after < 0.7 * before
    assert late.history[-1]["psnr_db"] > early.history[-1]["psnr_db"]


@pytest.mark.parametrize("loss", MIXTURES)
def test_the_gradient_is_that_of_finite_differences(loss):
    image, goal = random_picture(1, 40, 36, 4).double(), random_picture(2, 40, 36, 4).double()
    objective = Objective(loss, goal, random_picture(3, 40, 36).double())
    value, gradient = objective.gradient(image)
    assert float(value) == pytest.approx(float(objective.of(image)))
    direction = torch.randn(image.shape, generator=torch.Generator().manual_seed(4)).double()
    change = float(objective.of(image + 1e-6 * direction) - objective.of(image - 1e-6 * direction)) / 2e-6
    assert float((gradient * direction).sum()) == pytest.approx(change, rel=2e-3)


@pytest.mark.parametrize("loss", LOSSES)
def test_every_loss_counts(loss):
    image, goal = random_picture(1, 40, 36, 3), random_picture(2, 40, 36, 3)
    assert float(Objective(loss, goal, None).of(image)) > 1.0


def test_absolute_and_huber_are_what_their_names_say():
    goal = torch.zeros(1, 2, 3)
    image = torch.tensor([[[0.3, 0.0, 0.0], [0.0, -0.02, 0.0]]])
    assert float(Objective("l1", goal, None).of(image)) == pytest.approx(ABSOLUTE * 0.32, rel=0.01)
    assert float(Objective("huber", goal, None).of(image)) == pytest.approx(0.02**2 + 0.05 * (0.6 - 0.05), rel=1e-4)


def test_the_structure_is_that_of_an_independent_implementation():
    """Two scales by hand, from scikit-image's SSIM at each."""
    from skimage.metrics import structural_similarity

    goal = random_picture(1, 23, 40, 3).double().numpy()
    image = np.clip(goal + 0.2 * random_picture(2, 23, 40, 3).double().numpy(), 0, 1)
    found = 1.0 - float(MsSsim(torch.from_numpy(goal)).loss(torch.from_numpy(image)))
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1.0}
    assert min(goal.shape[:2]) >> 1 == 11, "the second scale has one row of windows"
    half = [p[:22].reshape(11, 2, 20, 2, 3).mean((1, 3)) for p in (goal, image)]
    # Without its brightness term the first scale is SSIM of equal means: shift the picture's local means away.
    whole = structural_similarity(*half, channel_axis=2, win_size=11, **options)
    assert 0.0 < found < 1.0
    assert found == pytest.approx(_contrast(goal, image) ** (0.0448 / 0.3304) * whole ** (0.2856 / 0.3304), rel=1e-6)


def _contrast(goal: np.ndarray, image: np.ndarray) -> float:
    """Mean contrast and structure by direct sums over every window."""
    place = np.arange(11) - 5
    window = np.exp(-0.5 * (place / 1.5) ** 2)
    window = np.outer(window, window) / window.sum() ** 2
    views = [np.lib.stride_tricks.sliding_window_view(p, (11, 11), (0, 1)) for p in (goal, image)]
    means = [np.einsum("abcij,ij->abc", v, window) for v in views]
    moment = [np.einsum("abcij,abcij,ij->abc", views[i], views[j], window) for i, j in ((0, 0), (1, 1), (0, 1))]
    variances, shared = [moment[i] - means[i] ** 2 for i in (0, 1)], moment[2] - means[0] * means[1]
    return float(((2 * shared + 9e-4) / (variances[0] + variances[1] + 9e-4)).mean())


@pytest.mark.parametrize("size", [(1, 1), (2, 9), (10, 11), (12, 30), (176, 178)])
def test_the_structure_of_any_size_is_none_for_equal_pictures(size):
    goal = random_picture(5, *size, 3)
    structure = MsSsim(goal, random_picture(6, *size))
    assert float(structure.loss(goal)) == pytest.approx(0.0, abs=1e-5)
    assert float(structure.loss(1.0 - goal)) > 0.05


def test_mixtures_are_read_and_written():
    assert parse_loss(" MS-SSIM:3 , l2 ") == {"l2": 1.0, "ms-ssim": 3.0}
    assert loss_text({"l2": 1.0, "ms-ssim": 3.0}) == "l2:0.25,ms-ssim:0.75"
    assert FitSettings(loss="l2:7").loss == "l2"


@pytest.mark.parametrize("text", ["", "l3", "l2:0", "l2:-1", "l2:nan", "l2:x", "l2,l2", "l2;l1", "l1,huber", 3])
def test_no_mixture_is_a_usage_error(text):
    with pytest.raises(UsageError, match=r"loss (must be|takes)"):
        FitSettings(loss=text)


def test_the_real_command_takes_a_loss(photo, run_cli):
    done = run_cli(
        "vectorize", photo, "--curves", 8, "--steps", 20, "--threads", 1, "--loss", "l1,ms-ssim", "--json", "-q"
    )
    found = strict_json(done.stdout)
    assert found["settings"]["loss"] == "l1:0.5,ms-ssim:0.5"
    assert (found["style"], found["style_reason"]) == ("photo", "asked for by loss")
    run_cli("vectorize", photo, "--loss", "l4", code=2, error=f"--loss must be {listed(LOSSES)}")
