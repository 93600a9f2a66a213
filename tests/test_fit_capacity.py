"""Which curves go, where new ones come, and what they look like."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from conftest import rest_slow
from hypothesis import given
from hypothesis import strategies as st

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.photo.initial import control_points, new_curves, picture_colours_at
from cubicsplat_cli.photo.inputs import NO_INPUTS, FitInputs
from cubicsplat_cli.photo.loop import FitLoop, fit
from cubicsplat_cli.photo.seeding import (
    Seeder,
    blob_points,
    box_mean,
    draw_pixels,
    error_density,
    find_blobs,
    random_centres,
)
from cubicsplat_cli.photo.state import FitState
from cubicsplat_cli.photo.stepper import gini
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.settings import FitSettings

MODES = pytest.mark.parametrize("mode", ["closed", "open"])
VALUES = st.lists(st.floats(-10, 1e6, allow_nan=False, width=32), min_size=1, max_size=30)


def random_numbers(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def settings(mode: str = "closed", **changes) -> FitSettings:
    return FitSettings.from_preset("standard", mode, curves=10, threads=1, **changes)


# --- inequality --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([1, 1, 1, 1], 0.0), ([0, 0, 0, 1], 0.75), ([1, 3], 0.25), ([3, 1], 0.25), ([1, 2, 3], 2 / 9),
        ([-5, 1], 0.5), ([0, 0], 0.0), ([-1, -2], 0.0), ([7], 0.0), ([], 0.0),
    ],
)  # fmt: skip
def test_gini_by_hand(values, expected):
    assert gini(torch.tensor(values, dtype=torch.float32)) == pytest.approx(expected, abs=1e-9)


@given(values=VALUES, factor=st.floats(0.01, 100))
def test_gini_lies_between_equal_and_one_takes_all_whatever_the_unit_and_order(values, factor):
    found = gini(torch.tensor(values, dtype=torch.float64))
    assert -1e-12 <= found <= 1 - 1 / len(values) + 1e-12
    assert gini(torch.tensor(values[::-1], dtype=torch.float64) * factor) == pytest.approx(found, abs=1e-9)


# --- where new curves are wanted ---------------------------------------------------------------------------


def test_error_density_is_the_squared_error_blurred_and_raised():
    target = torch.zeros(9, 9, 3)
    target[4, 4, 0] = 2.0
    assert error_density(torch.zeros_like(target), target, 1, 1.0)[4, 4] == 4.0
    blurred = error_density(torch.zeros_like(target), target, 3, 0.5)
    assert blurred[3:6, 3:6].flatten().tolist() == pytest.approx([(4 / 9) ** 0.5] * 9)
    assert blurred.sum() == pytest.approx(9 * (4 / 9) ** 0.5)
    corner = torch.zeros(9, 9, 3)
    corner[0, 0, 0] = 2.0
    assert error_density(torch.zeros_like(corner), corner, 3, 1.0)[0, 0] == 1.0, "a mean of the pixels that exist"


@given(size=st.sampled_from([1, 3, 5, 9]), height=st.integers(1, 14), width=st.integers(1, 14))
def test_the_box_mean_is_that_of_the_pixels_that_exist(size, height, width):
    planes, half = random_numbers(height * 20 + width).random((2, height, width), np.float32), size // 2
    windows = [[planes[:, max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1] for x in range(width)]
               for y in range(height)]  # fmt: skip
    means = np.stack([[window.mean((1, 2)) for window in row] for row in windows]).transpose(2, 0, 1)
    for kind in (planes, torch.from_numpy(planes)):
        assert box_mean(kind, size) == pytest.approx(means, abs=1e-6)


def test_pixels_are_drawn_in_proportion():
    density = torch.tensor([[0.0, 1.0, 0.0], [3.0, 0.0, 0.0]])
    drawn = draw_pixels(density, 4000, random_numbers())
    places, counts = drawn.unique(dim=0, return_counts=True)
    assert places.tolist() == [[0.5, 1.5], [1.5, 0.5]]
    assert int(counts[0]) / 4000 == pytest.approx(0.75, abs=0.03)
    everywhere = draw_pixels(torch.zeros(2, 3), 600, random_numbers())
    assert len(everywhere.unique(dim=0)) == 6, "without any error every pixel is as good"


# --- reallocation ------------------------------------------------------------------------------------------


def population(mode: str, count: int = 10) -> FitState:
    """Curves and optimiser states that can be told apart by their numbers."""
    chosen = settings(mode)
    points = control_points(torch.full((count, 2), 20.0), 3.0, chosen, random_numbers())
    colours = torch.arange(3.0 * count).reshape(count, 3) / 100
    state = FitState.unmoved(new_curves(points, colours, 1.5, chosen, (50, 40)))
    state.optimiser.ages += torch.arange(1, count + 1, dtype=torch.int32)
    return state


def reallocated(state: FitState, importance, image, target, count: int, chosen: FitSettings) -> FitState:
    """With the least important curves replaced by new ones."""
    return state.without_least(importance, count).with_seeds(
        Seeder(chosen, random_numbers(2), None, target).seeds(count, image)
    )


@MODES
@pytest.mark.parametrize("replaced", [1, 3, 9])
def test_the_least_important_are_replaced_and_the_others_keep_their_order(mode, replaced):
    state = population(mode)
    importance = torch.tensor([5.0, -1.0, 3.0, 9.0, 0.5, 7.0, 8.0, 2.0, 6.0, 4.0])
    target = torch.tensor(random_numbers(1).random((40, 50, 3), np.float32))
    both = reallocated(state, importance, torch.zeros_like(target), target, replaced, settings(mode))
    before, after, states = state.curves, both.curves, both.optimiser
    assert after.curves == 10
    gone = set(importance.argsort()[:replaced].tolist())
    kept = [index for index in range(10) if index not in gone]
    assert (after.points[replaced:] == before.points[kept]).all()
    assert (after.colours[replaced:] == before.colours[kept]).all()
    assert states.ages.tolist() == [0] * replaced + [index + 1 for index in kept]
    assert (states.moments[:replaced] == 0).all()
    assert torch.isfinite(after.points).all()
    assert not any((after.points[0] == points).all() for points in before.points)


@MODES
@pytest.mark.parametrize("channels", [3, 4])
def test_new_curves_come_where_the_error_is_in_the_pictures_colour(mode, channels):
    target = torch.zeros(60, 80, channels)
    target[35:50, 50:70] = torch.tensor([0.8, 0.3, 0.1, 1.0][:channels])
    state = population(mode, 40)
    after = reallocated(state, torch.arange(40.0), torch.zeros_like(target), target, 20, settings(mode)).curves
    centres = after.points[:20].mean(1)
    assert ((centres - torch.tensor([60.0, 42.5])).abs() < torch.tensor([16.0, 13.0])).all()
    colours = after.colours[:20].sigmoid()
    # One drawn beside the patch, in the blur of its error, is a mixture.
    assert (colours - torch.tensor([0.8, 0.3, 0.1])).abs().max(1).values.median() < 0.15


@MODES
@pytest.mark.parametrize("seeding", rest_slow("discs", "blobs"))
def test_reallocation_stays_on_the_device_and_never_waits_for_it(mode, seeding):
    """torch's "meta" device stands for a GPU: it has no values to wait for, and refuses to be mixed with the CPU."""
    target, importance = torch.rand(40, 50, 3, device="meta"), torch.rand(10, device="meta")
    chosen = settings(mode, seeding=seeding)
    after = reallocated(population(mode).as_torch("meta"), importance, target, target, 5, chosen)
    for tensor in after.arrays_by_name().values():
        assert tensor.device.type == "meta"
        assert len(tensor) == 10


def test_patches_follow_the_shape_of_the_error():
    """A long bar gives long ellipses along it; a picture without error gives small ones where they were drawn."""
    target = torch.zeros(80, 80, 3)
    target[38:42, 10:70] = 1.0
    seeds = torch.tensor([[40.5, 40.5]]).expand(20, 2)
    centres, axes, _ = find_blobs(seeds, torch.zeros_like(target), target, 8.0, random_numbers())
    short, long = axes[:, :, 0].norm(dim=1), axes[:, :, 1].norm(dim=1)
    assert (long > 1.5 * short).float().mean() >= 0.9, "windows of all sizes are tried"
    direction = axes[:, :, 1] / long[:, None]
    assert (direction[:, 0].abs() > 0.99).all()
    assert (centres - seeds).abs().max() < 3
    rings = blob_points(centres, axes, settings("closed"), random_numbers())
    assert rings.shape == (20, 12, 2)
    assert (rings.mean(1) - centres).abs().max() < 1e-3
    strokes = blob_points(centres, axes, settings("open"), random_numbers())
    assert strokes.shape == (20, 10, 2)
    assert ((strokes[:, -1] - strokes[:, 0]).abs()[:, 0] > 5).all()


@pytest.mark.parametrize("channels", [3, 4])
def test_patches_stay_at_their_seeds_where_nothing_differs(channels):
    target = torch.full((30, 40, channels), 0.5)
    seeds = torch.tensor([[30.5, 20.5], [5.5, 6.5]])
    centres, *_ = find_blobs(seeds, target.clone(), target, 5.0, random_numbers())
    assert (centres - seeds).abs().max() < 1


def test_patches_see_what_differs_in_alpha_alone():
    target = torch.zeros(40, 40, 4)
    target[20:30, 5:15, 3] = 1.0
    seeds = torch.tensor([[10.5, 25.5]])
    centres, *_ = find_blobs(seeds, torch.zeros_like(target), target, 4.0, random_numbers())
    assert (centres - torch.tensor([10.0, 25.0])).abs().max() < 2


# --- first curves ------------------------------------------------------------------------------------------


def test_first_curves_are_discs_or_bent_strokes_of_the_asked_size():
    centres = torch.tensor([[10.0, 20.0], [30.0, 5.0]])
    discs = control_points(centres, 4.0, settings("closed", segments=3), random_numbers())
    assert discs.shape == (2, 9, 2)
    assert (discs - centres[:, None]).norm(dim=-1) == pytest.approx(torch.full((2, 9), 4.0), abs=1e-4)
    strokes = control_points(centres, 4.0, settings("open", segments=3), random_numbers())
    assert strokes.shape == (2, 10, 2)
    assert ((strokes[:, -1] - strokes[:, 0]).norm(dim=-1) - 12).abs().max() < 4


def test_first_curves_of_a_transparent_picture_lie_on_it_and_have_its_straight_colour():
    target = torch.zeros(20, 30, 4)
    target[4:8, 10:16] = torch.tensor([0.4, 0.2, 0.1, 0.5])
    centres = random_centres(50, target, random_numbers())
    assert ((centres > torch.tensor([10.0, 4.0])) & (centres < torch.tensor([16.0, 8.0]))).all()
    assert (picture_colours_at(centres, target).sigmoid() - torch.tensor([0.8, 0.4, 0.2])).abs().max() < 1e-4
    opaque = random_centres(500, torch.zeros(20, 30, 3), random_numbers())
    assert opaque.min() >= 0
    assert (opaque.max(0).values - torch.tensor([30.0, 20.0])).abs().max() < 1


def test_black_and_white_stay_within_reach_of_the_optimiser():
    target = torch.stack([torch.zeros(1, 3), torch.ones(1, 3)])
    logits = picture_colours_at(torch.tensor([[0.5, 0.5], [0.5, 1.5], [9.0, -3.0]]), target)
    assert logits.abs().max() < 4
    assert (logits[2] == logits[0]).all(), "places off the canvas take the nearest pixel"


# --- parameters --------------------------------------------------------------------------------------------


def test_the_first_bad_value_is_named_by_curve_and_parameter():
    parameters = population("closed").curves
    assert parameters.first_non_finite() is None
    parameters.opacities[2] = float("inf")
    assert parameters.first_non_finite() == (2, "opacities")
    parameters.points[6, 3, 1] = float("nan")
    assert parameters.first_non_finite() == (6, "points")


def test_copies_are_copies_and_scenes_are_activated():
    parameters = population("open").curves
    copy = parameters.copy()
    copy.points += 1
    assert (copy.points != parameters.points).all()
    scene = parameters.scene(opaque=False)
    assert scene.colours[1].tolist() == pytest.approx(torch.tensor([0.03, 0.04, 0.05]).sigmoid().tolist())
    assert (parameters.scene(opaque=True).opacities == 1).all()
    assert (population("closed").curves.scene(opaque=False).half_widths == 0).all()


# --- another number of curves on the way -----------------------------------------------------------------------


def resized(picture, *counts: int, at=(0.3, 0.6), kind=FitLoop, **changes):
    """A short fit of ten curves, of which the most useful stay, with so many in all."""
    fitting = kind(picture, settings(steps=60, **changes))
    for share, count in zip(at, counts, strict=False):
        if fitting.relax(share):
            fitting.resize(np.argsort(-fitting.importance())[:count], count)
    return fitting.finish()


@MODES
def test_a_fit_grows_and_shrinks_on_its_way(mode):
    picture = np.random.default_rng(2).random((12, 16, 3)).repeat(3, 0).repeat(3, 1).astype(np.float32)
    plain = fit(picture, settings(mode, steps=60))
    # The gradient of the penalty on spikes is held for some steps, which begin anew with each resizing.
    unheld = fit(picture, settings(mode, steps=60, spike_penalty=0.0))
    same = resized(picture, 10, 10, mode=mode, spike_penalty=0.0)
    assert all(np.array_equal(getattr(same.scene, n), getattr(unheld.scene, n)) for n in ("points", "colours"))
    for counts in ((25, 14), (4, 14), (3,)):
        found = resized(picture, *counts, mode=mode)
        assert counts[-1] - 2 <= found.scene.curves + found.dropped <= counts[-1]
        assert found.steps == 60 and found.history[-1]["step"] == 60
    grown, shrunk = resized(picture, 25, mode=mode), resized(picture, 3, mode=mode)
    assert shrunk.history[-1]["psnr_db"] < plain.history[-1]["psnr_db"] < grown.history[-1]["psnr_db"]


def test_an_interrupt_right_after_curves_were_added_returns_what_was_before():
    picture = np.zeros((36, 48, 4), np.float32)
    picture[8:28, 10:40] = (0.8, 0.3, 0.1, 1.0)
    losses = []

    class Interrupted(FitLoop):
        def advance(self, until: float = 0.0) -> None:
            if self.settings.curves == 25:
                losses.append(self.evaluator.loss(self.state.curves))
                raise KeyboardInterrupt
            super().advance(until)
            losses.append(self.evaluator.loss(self.state.curves))

    found = resized(picture, 25, kind=Interrupted)
    *_, before, after = losses
    assert found.interrupted
    assert after > 2.0 * before
    error = render_scene(found.scene, threads=1) - picture  # over black and over white
    assert 0.5 * (error[..., :3] ** 2 + (error[..., :3] - error[..., 3:]) ** 2).sum() < 1.02 * before


def test_a_fit_to_a_smaller_copy_takes_its_number_of_curves_along():
    whole = np.random.default_rng(2).random((12, 16, 3)).repeat(6, 0).repeat(6, 1).astype(np.float32)
    fitting = FitLoop(whole, settings(steps=60), FitInputs(rough=(whole[::2, ::2].copy(), NO_INPUTS)))
    assert fitting.relax(0.5)
    fitting.resize(np.arange(fitting.scene().curves), 17)
    found = fitting.finish()
    assert found.scene.curves + found.dropped == 17
    assert (found.scene.width, found.scene.height) == (96, 72)


@pytest.mark.parametrize("shared", [0.0, 0.75])
def test_curves_share_an_opacity_where_the_recipe_says_so(shared):
    picture = np.random.default_rng(2).random((12, 16, 3)).repeat(3, 0).repeat(3, 1).astype(np.float32)
    opacities = fit(picture, settings(steps=30, shared_opacity=shared)).scene.opacities
    if shared:
        assert len(np.unique(opacities)) == 1
        assert 0.003 < abs(float(opacities[0]) - shared) < 0.2  # learnt
    else:
        assert opacities.std() > 0.01
    with pytest.raises(UsageError, match=r"shared_opacity must be a number from 0 to 0\.999"):
        settings(shared_opacity=1.0)
