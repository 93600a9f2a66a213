"""Moving scenes: linear between knots, exact at knots, each track on its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.scene import Clip, MovingScene, Scene
from cubicsplat_cli.settings import Mode

CURVES, POINTS = 3, 6


def moving(seed: int, frames: int = 7, *, tracks: bool = False) -> MovingScene:
    """Random values at random times with random knots."""
    generator = np.random.default_rng(seed)

    def values(*shape: int) -> np.ndarray:
        return generator.random((frames, CURVES, *shape)).astype(np.float32)

    def some(of: np.ndarray) -> np.ndarray:
        chosen = of & (generator.random(of.shape) < 0.5)
        chosen[[0, -1]] = True
        return chosen

    times = np.cumsum(0.02 + generator.random(frames))
    knots = some(np.ones((frames, CURVES), bool))
    points, colours, opacities, still = 9 * values(POINTS, 2), values(3), values(), np.zeros_like(values())
    base = Scene(Mode.CLOSED, 9, 9, points[0], colours[0], opacities[0], still[0], (1.0, 1.0, 1.0))
    scene = MovingScene(base, times, float(times[-1] + 0.1), points, colours, opacities, still, knots)
    if tracks:
        own = {name: some(knots) for name in ("shapes", "offsets", "colours")}
        scene = replace(scene, offsets=values(2), track_knots=own)
    return scene


@given(st.integers(0, 10**6), st.integers(1, 9))
def test_a_frame_that_is_a_knot_is_exact_and_one_between_is_linear_in_time(seed: int, frames: int) -> None:
    scene = moving(seed, frames)
    for frame in range(frames):
        shown = scene.at(frame)
        for curve in range(CURVES):
            at = np.flatnonzero(scene.knots[:, curve])
            for axis in range(2):
                wanted = np.interp(scene.times[frame], scene.times[at], scene.points[at, curve, 2, axis])
                assert shown.points[curve, 2, axis] == pytest.approx(wanted, abs=1e-5)
            if scene.knots[frame, curve]:
                assert (shown.points[curve] == scene.points[frame, curve]).all()
                assert (shown.colours[curve] == scene.colours[frame, curve]).all()


def test_what_cannot_be_drawn_is_refused() -> None:
    scene = moving(1)
    bad = scene.knots.copy()
    bad[-1, 0] = False
    for changes, words in (
        ({"knots": bad}, "the last frame must be knots"),
        ({"times": scene.times[::-1]}, "times must rise"),
        ({"end": 0.0}, "end must come after"),
        ({"points": scene.points[:-1]}, "points must be float32 of shape"),
        ({"points": np.full_like(scene.points, np.nan)}, "points must be finite"),
        ({"track_knots": {"shape": scene.knots}}, "none of shapes"),
        ({"track_knots": {"shapes": np.ones_like(scene.knots)}}, "must be one of `knots`"),
    ):
        with pytest.raises(InputError, match=words):
            replace(scene, **changes).validate()


def test_a_clip_counts_frames_over_its_groups_which_must_follow_one_another() -> None:
    first = moving(1, 3)
    second = moving(2, 4)
    second = replace(second, times=second.times - second.times[0] + first.end, end=first.end + 99.0)
    clip = Clip(9, 9, (1.0, 1.0, 1.0), [first, second])
    clip.validate()
    assert clip.frames == 7
    assert clip.duration == pytest.approx(first.end + 99.0 - first.times[0])
    assert (clip.at(4).points == second.at(1).points).all()
    with pytest.raises(InputError, match="must begin when"):
        Clip(9, 9, (1.0, 1.0, 1.0), [first, replace(second, times=second.times + 1.0)]).validate()
    with pytest.raises(InputError, match="its canvas"):
        Clip(8, 9, (1.0, 1.0, 1.0), [first]).validate()
