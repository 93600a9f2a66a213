"""Settings of a fit: presets, overrides, what makes no sense; and the course that they give a fit."""

from __future__ import annotations

import json
import math
import re
from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cubicsplat_cli import vectorize
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.options import listed
from cubicsplat_cli.photo.stepper import Schedule
from cubicsplat_cli.request import STYLES
from cubicsplat_cli.settings import PRESETS, USUAL_CURVES, FitSettings, Mode, Recipe

SHARES = st.floats(0.0, 1.0, exclude_max=True)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("curves", 0), ("curves", -1), ("curves", 1_000_001), ("curves", 1.5), ("curves", True), ("steps", 0),
        ("steps", 10_000_001), ("segments", 0), ("segments", 17), ("samples", 3), ("samples", 65),
        ("finish_samples", 0), ("threads", 0), ("threads", 1025), ("device", "tpu"), ("background", "#12"),
        ("background", "#xyzxyz"), ("background", ""), ("time_limit", 0.0), ("time_limit", -1.0),
        ("time_limit", math.nan),
    ],
)  # fmt: skip
def test_senseless_settings_are_refused_by_name(name, value):
    said = name.replace("_", "[-_]")
    with pytest.raises(UsageError, match=said):
        FitSettings(**{name: value})
    with pytest.raises(UsageError, match=said):
        FitSettings.from_preset("standard", **{name: value})


def test_subdivision_is_refused_on_cuda():
    with pytest.raises(UsageError, match="de-casteljau runs on the CPU only; use device cpu or auto"):
        FitSettings.from_preset("standard", device="cuda", flatten="de-casteljau")
    assert FitSettings.from_preset("standard", flatten="de-casteljau").device == "auto"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("importance", "none"), ("edges", "blurred"), ("flatten", "adaptive"), ("rate_course", "linear"),
        ("prune_rule", "never"), ("crossing_penalty", -1.0), ("crossing_penalty", math.nan), ("finish", 1.0),
        ("finish", -0.1),
    ],
)  # fmt: skip
def test_senseless_recipes_are_refused_by_name(name, value):
    with pytest.raises(UsageError, match=name.replace("_", "[-_]")):
        FitSettings.from_preset("standard", **{name: value})


def test_unknown_presets_and_settings_are_refused():
    with pytest.raises(UsageError, match=r"draft.*best"):
        FitSettings.from_preset("best")
    with pytest.raises(UsageError, match="colour"):
        FitSettings.from_preset("draft", colour=3)


@pytest.mark.parametrize("mode", ["closed", "open"])
@pytest.mark.parametrize("preset", list(PRESETS))
def test_explicit_values_win_over_every_preset(preset, mode):
    plain = FitSettings.from_preset(preset, mode)
    assert (plain.preset, plain.mode) == (preset, Mode(mode))
    changed = FitSettings.from_preset(
        preset, mode, steps=77, segments=5, samples=9, prune=False, rate_colours=0.125, background="none"
    )
    assert (changed.steps, changed.segments, changed.samples, changed.background) == (77, 5, 9, "none")
    assert (changed.recipe.prune, changed.recipe.rate_colours) == (False, 0.125)
    for field in fields(Recipe):
        if field.name not in ("prune", "rate_colours", "tolerance"):
            assert getattr(changed.recipe, field.name) == getattr(plain.recipe, field.name), field.name


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("preset", list(PRESETS))
def test_a_default_given_explicitly_changes_nothing(preset, mode):
    plain = FitSettings(preset=preset, mode=mode)
    assert plain == FitSettings.from_preset(preset, mode)
    for field in fields(FitSettings):
        given = {"preset": preset, "mode": mode, field.name: getattr(plain, field.name)}
        assert FitSettings(**given) == plain, field.name
    numbers = {field.name: getattr(plain.recipe, field.name) for field in fields(Recipe)}
    assert FitSettings.from_preset(preset, mode, **numbers) == plain


def test_the_finish_is_at_least_as_fine_as_the_fit():
    assert FitSettings(samples=8).finish_samples == FitSettings().finish_samples == 48
    assert FitSettings(samples=64).finish_samples == 64
    assert FitSettings(samples=64, finish_samples=24).finish_samples == 24


def test_none_means_the_presets_value():
    assert FitSettings.from_preset("high", steps=None, threads=None) == FitSettings.from_preset("high")


def test_presets_differ_in_effort_and_the_published_one_is_as_published():
    steps = [FitSettings.from_preset(name).steps for name in ("draft", "standard", "high")]
    assert steps == sorted(set(steps))
    for mode, samples in (("closed", 12), ("open", 24)):
        paper = FitSettings.from_preset("paper", mode)
        recipe = paper.recipe
        assert (paper.steps, paper.segments, paper.samples) == (10_000, 3, samples)
        assert (recipe.importance, recipe.edges, recipe.finish, recipe.tolerance) == ("visibility", "soft", 0.0, 0.0)
        assert (recipe.prune_rule, recipe.gini_threshold) == ("gini", 0.35)


def test_public_settings_are_plain_and_complete():
    settings = FitSettings.from_preset("draft", "open", curves=3, time_limit=2.5)
    plain = settings.public()
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    assert (plain["mode"], plain["curves"], plain["time_limit"]) == ("open", 3, 2.5)
    assert set(plain) == {field.name for field in fields(FitSettings)}
    assert set(plain["recipe"]) == {field.name for field in fields(Recipe)}
    assert settings.with_(curves=4).curves == 4


def test_backgrounds_are_read():
    assert FitSettings().background_colour is None
    assert FitSettings(background="none").background_colour is None
    assert FitSettings(background="#ff0080").background_colour == (1.0, 0.0, 128 / 255)
    assert FitSettings(background="#f08").background_colour == (1.0, 0.0, 136 / 255)


# --- the course of a fit -----------------------------------------------------------------------------------


def schedule(steps: int = 500, **changes) -> Schedule:
    return Schedule(FitSettings.from_preset("standard", steps=steps, **changes))


@given(first=SHARES, second=SHARES)
def test_edges_only_become_narrower_and_steps_smaller_until_the_finish(first, second):
    course = schedule()
    early, late = course.phase(min(first, second)), course.phase(max(first, second))
    if not late.exact:
        assert not early.exact, "the exact phase is the last one"
        assert early.edge_width >= late.edge_width
    if early.exact == late.exact:
        assert early.rate >= late.rate
    assert 0 < late.rate <= 1
    assert late.edge_width > 0


def test_edge_width_runs_from_its_start_to_its_end():
    course = schedule(edge_start=4.0, edge_end=0.8, anneal=0.6, finish=0.15, finish_edge_width=1.25)
    assert course.phase(0.0).edge_width == 4.0
    assert course.phase(0.6 * 0.85 + 1e-9).edge_width == pytest.approx(0.8)
    assert course.phase(0.84).edge_width == pytest.approx(0.8)
    assert course.phase(0.3 * 0.85).edge_width == pytest.approx(math.sqrt(4.0 * 0.8)), "half-way, geometrically"
    assert course.phase(0.9).edge_width == 1.25
    assert schedule(anneal=0.0).phase(0.0).edge_width == pytest.approx(0.8)


@pytest.mark.parametrize("finish", [0.0, 0.1, 0.15, 0.5])
@pytest.mark.parametrize("steps", [20, 500, 1501])
def test_the_exact_phase_has_its_share_of_the_steps(finish, steps):
    course = schedule(steps, finish=finish)
    exact = sum(course.phase(step / steps).exact for step in range(steps))
    assert abs(exact - finish * steps) <= 1


def test_published_rates_are_a_staircase():
    course = schedule(rate_course="published", finish=0.0)
    assert [course.phase(share).rate for share in (0.0, 0.49, 0.5, 0.6, 0.89, 0.9, 0.99)] == [
        1.0, 1.0, 0.5, 0.2, 0.2, 0.1, 0.1,
    ]  # fmt: skip


@pytest.mark.parametrize("steps", [30, 500, 2000])
def test_reallocations_are_evenly_spaced_each_due_once_and_end_before_the_finish(steps):
    course = schedule(steps)
    due = [step for step in range(steps) if course.take_reallocation(step / steps)]
    assert len(due) == pytest.approx(course.reallocations, abs=1)
    assert len(due) >= 3
    gaps = [second - first for first, second in pairwise(due)]
    assert max(gaps) - min(gaps) <= 1
    assert max(due) / steps < course.reallocations_end <= course.finish_start
    assert not any(course.phase(step / steps).exact for step in due)


def test_without_pruning_none_is_due():
    course = schedule(prune=False)
    assert not any(course.take_reallocation(step / 100) for step in range(100))


@given(first=SHARES, second=SHARES)
def test_the_replaced_fraction_falls_to_nothing(first, second):
    course = schedule(prune_fraction=0.4)
    early, late = course.reallocation(min(first, second)), course.reallocation(max(first, second))
    assert 0.4 >= early >= late >= 0
    assert course.reallocation(0.0) == pytest.approx(0.4)
    assert course.reallocation(0.99) == 0
    assert course.reallocation(0.99, idle=0.3) == 0.3
    assert course.reallocation(0.0, idle=0.3) == pytest.approx(0.4)


def test_the_published_rule_waits_for_inequality():
    course = schedule(prune_rule="gini", prune_fraction=0.2, gini_threshold=0.35)
    assert course.reallocation(0.3, 0.35) == 0
    assert course.reallocation(0.3, 0.1, idle=0.3) == 0
    assert course.reallocation(0.3, 0.6) == pytest.approx(0.1)
    assert course.reallocation(0.3, 0.99) == pytest.approx(0.2)


@pytest.mark.parametrize("finish", [0.0, 0.15])
def test_a_clock_that_overtakes_the_last_step_does_no_harm(finish):
    recipe = Recipe(finish=finish)
    phase = Schedule(FitSettings(recipe=recipe, steps=100)).phase(1.001)
    assert phase.exact is (finish > 0.0)
    assert 0.0 < phase.rate <= 1.0


def test_names_that_are_wrong_are_told_apart_from_those_that_were_meant():
    for asked, said in (
        ({"colour": 3}, "unknown setting 'colour'; did you mean colors?"),
        ({"time_limits": 3}, "unknown setting 'time_limits'; did you mean time_limit?"),
        ({"style": "artwrk"}, f"style must be {listed(STYLES)}, not 'artwrk'"),
        ({"mode": "opn"}, "mode must be closed or open, not 'opn'"),
        ({"background": "wite"}, "#rrggbb, not 'wite'; did you mean white?"),
        ({"palette": ["red", "whte"]}, "not 'whte'; did you mean white?"),
        ({"curves": "many"}, "curves must be a whole number from 1 to 1000000, or auto, not 'many'"),
    ):
        with pytest.raises(UsageError, match=re.escape(said)):
            vectorize(np.zeros((4, 4, 3), np.uint8), **asked)
    assert FitSettings(curves="auto") == FitSettings()
    assert ArtworkSettings(palette="red, #fff") == ArtworkSettings(palette=[(255, 0, 0), "white"])


@pytest.mark.parametrize(
    ("side", "curves"), [(1, 1), (16, 16), (32, 64), (64, 64), (96, 96), (200, 416), (1000, USUAL_CURVES)]
)
def test_a_small_picture_has_fewer_curves_but_enough_for_an_icon(side, curves):
    assert FitSettings().for_size(side, side).curves == curves
