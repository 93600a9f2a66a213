"""The scene: layout of its parameters, and every way in which it can be wrong."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import DEGENERATE, PAPER, TENSORS, random_scene, reference_render

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.scene import Scene, points_from_segments, segments_from_points
from cubicsplat_cli.settings import Mode


def test_mode_is_written_as_on_the_command_line():
    assert Mode("closed") is Mode.CLOSED
    assert Mode("open") is Mode.OPEN


@given(mode=st.sampled_from(list(Mode)), segments=st.integers(1, 50))
@settings(derandomize=True)
def test_points_and_segments_are_inverse(mode, segments):
    assert segments_from_points(mode, points_from_segments(mode, segments)) == segments


@pytest.mark.parametrize(("mode", "points", "segments"), [(Mode.CLOSED, 12, 4), (Mode.OPEN, 10, 3)])
def test_default_layouts(mode, points, segments):
    assert points_from_segments(mode, segments) == points
    assert segments_from_points(mode, points) == segments


@pytest.mark.parametrize(
    ("mode", "points"),
    [(Mode.CLOSED, 0), (Mode.CLOSED, 4), (Mode.CLOSED, -3), (Mode.OPEN, 1), (Mode.OPEN, 3), (Mode.OPEN, 12)],
)
def test_other_numbers_of_points_are_refused(mode, points):
    with pytest.raises(InputError, match=rf"{mode.value} curves need 3M.* not {points}"):
        segments_from_points(mode, points)


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize(("background", "channels"), [(PAPER, 3), (None, 4)])
def test_properties(mode, background, channels):
    scene = random_scene(mode, 5, 2, 30, 20, background=background)
    assert (scene.curves, scene.segments, scene.channels) == (5, 2, channels)
    assert scene.points_per_curve == points_from_segments(mode, 2)
    scene.validate()


def test_degenerate_scenes_are_valid_and_have_a_picture():
    for name, scene in DEGENERATE:
        scene.validate()
        picture = reference_render(scene, samples=2)
        assert picture.shape == (scene.height, scene.width, scene.channels), name
        assert bool(((picture >= 0.0) & (picture <= 1.0)).all()), name


def test_degenerate_names_are_unique_and_cover_both_modes_and_channel_counts():
    names = [name for name, _ in DEGENERATE]
    assert len(set(names)) == len(names)
    assert {(s.mode, s.channels) for _, s in DEGENERATE} == {(m, c) for m in Mode for c in (3, 4)}


def test_random_scene_depends_on_its_seed_only():
    first, again, other = (random_scene(Mode.OPEN, seed=seed) for seed in (3, 3, 4))
    assert torch.equal(first.points, again.points)
    assert torch.equal(first.half_widths, again.half_widths)
    assert not torch.equal(first.points, other.points)


def test_float64_and_gradients_are_allowed():
    scene = random_scene(Mode.OPEN)
    points = scene.points.double().requires_grad_()
    other = replace(scene, points=points)
    other.validate()
    picture = reference_render(other)
    assert torch.equal(picture, reference_render(scene))
    picture.sum().backward()
    assert points.grad.abs().sum() > 0.0


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_ends_of_the_ranges_are_allowed(value):
    scene = random_scene(Mode.CLOSED)
    scene = replace(
        scene,
        colours=torch.full_like(scene.colours, value),
        opacities=torch.full_like(scene.opacities, value),
        background=(value, value, value),
    )
    scene.validate()
    assert reference_render(scene).detach().numpy() == pytest.approx(value)


def set_value(tensor: torch.Tensor, index: tuple[int, ...], value: float) -> torch.Tensor:
    changed = tensor.clone()
    changed[index] = value
    return changed


GOOD = random_scene(Mode.OPEN, 4, 3, background=PAPER)
NAN, INFINITY = float("nan"), float("inf")
WRONG = {
    "mode": ({"mode": "open"}, "mode must be Mode"),
    "width-zero": ({"width": 0}, "width must be a whole number .* at least 1, not 0"),
    "width-float": ({"width": 24.0}, "width must be a whole number"),
    "height-negative": ({"height": -3}, "height must be a whole number"),
    "height-bool": ({"height": True}, "height must be a whole number"),
    "points-list": ({"points": [[1.0, 2.0]]}, "points must be a numpy array or a torch.Tensor, not list"),
    "points-dtype": ({"points": GOOD.points.half()}, "points must be float32 or float64"),
    "points-integer": ({"points": GOOD.points.long()}, "points must be float32 or float64"),
    "points-device": (
        {"colours": GOOD.colours.to("meta")},
        "colours is a torch.Tensor on meta but points a torch.Tensor on cpu: use one kind",
    ),
    "points-flat": ({"points": GOOD.points.flatten(1)}, r"points must have shape \(N, K, 2\)"),
    "points-3d": ({"points": torch.zeros(4, 10, 3)}, r"points must have shape \(N, K, 2\)"),
    "points-count": ({"points": torch.zeros(4, 9, 2)}, r"open curves need 3M \+ 1"),
    "points-nan": ({"points": set_value(GOOD.points, (2, 5, 1), NAN)}, "points must be finite.*curve 2"),
    "points-infinite": ({"points": set_value(GOOD.points, (3, 0, 0), INFINITY)}, "points must be finite"),
    "no-curves": ({"points": torch.zeros(0, 10, 2)}, "N >= 1"),
    "colours-shape": ({"colours": torch.zeros(4, 4)}, r"colours must have shape \(4, 3\).*not \(4, 4\)"),
    "colours-high": ({"colours": set_value(GOOD.colours, (1, 2), 1.01)}, "colours must be between 0 and 1"),
    "colours-low": ({"colours": set_value(GOOD.colours, (1, 2), -0.01)}, "colours.*curve 1 is outside"),
    "colours-nan": ({"colours": set_value(GOOD.colours, (0, 0), NAN)}, "colours must be finite"),
    "opacities-shape": ({"opacities": torch.zeros(4, 1)}, r"opacities must have shape \(4,\)"),
    "opacities-high": ({"opacities": set_value(GOOD.opacities, (3,), 1.5)}, "opacities must be between"),
    "opacities-nan": ({"opacities": set_value(GOOD.opacities, (3,), NAN)}, "opacities must be finite"),
    "half-widths-shape": ({"half_widths": torch.zeros(3)}, r"half_widths must have shape \(4,\)"),
    "half-widths-low": ({"half_widths": set_value(GOOD.half_widths, (1,), -0.1)}, "half_widths.*at least 0"),
    "half-widths-infinite": (
        {"half_widths": set_value(GOOD.half_widths, (1,), INFINITY)},
        "half_widths must be finite",
    ),
    "background-list": ({"background": [0.0, 0.0, 0.0]}, "background must be None or a tuple"),
    "background-short": ({"background": (0.0, 0.0)}, "background must be None or a tuple"),
    "background-high": ({"background": (0.0, 0.0, 255.0)}, "between 0 and 1"),
    "background-nan": ({"background": (0.0, NAN, 0.0)}, "between 0 and 1"),
    "background-text": ({"background": ("a", "b", "c")}, "between 0 and 1"),
}


@pytest.mark.parametrize(("change", "words"), list(WRONG.values()), ids=list(WRONG))
def test_what_is_wrong_is_named_in_one_line(change, words):
    with pytest.raises(InputError, match=words) as caught:
        replace(GOOD, **change).validate()
    assert "\n" not in str(caught.value)


def test_closed_curves_have_no_width():
    scene = random_scene(Mode.CLOSED, 3)
    with pytest.raises(InputError, match="half_widths must be 0 for closed curves, but curve 1"):
        replace(scene, half_widths=torch.tensor([0.0, 0.5, 0.0])).validate()


def test_construction_does_not_check():
    # Builders fill a scene step by step; only `validate` judges it.
    scene = Scene(Mode.OPEN, 0, 0, GOOD.points, GOOD.colours, GOOD.opacities, GOOD.half_widths)
    assert scene.background is None
    with pytest.raises(InputError, match="width"):
        scene.validate()


def test_the_form_is_judged_without_a_look_at_values():
    scene = replace(GOOD, **{name: getattr(GOOD, name).to("meta") for name in TENSORS})
    scene.validate_form()  # reading a value of a meta tensor would raise
    with pytest.raises(InputError, match="colours must have shape"):
        replace(scene, colours=scene.colours[:1]).validate_form()
