"""Tracks: linear between knots, exact at knots, each on its own."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cubicsplat_cli.motion.tracks import KnotTrack

CURVES = 3


@given(st.integers(0, 10**6), st.integers(1, 9))
def test_a_frame_that_is_a_knot_is_exact_and_one_between_is_linear_in_time(seed: int, frames: int) -> None:
    generator = np.random.default_rng(seed)
    knots, still = generator.random((frames, CURVES)) < 0.5, np.array([False, False, True])
    knots[[0, -1]] = True
    values, times = 9 * generator.random((frames, CURVES, 2)).astype(np.float32), np.cumsum(generator.random(frames))
    lines = KnotTrack(values, knots, still).lines(times)
    for frame in range(frames):
        shown = lines.at(values, frame)
        for curve in range(CURVES):
            at = [0] if still[curve] else np.flatnonzero(knots[:, curve])
            for axis in range(2):
                wanted = np.interp(times[frame], times[at], values[at, curve, axis])
                assert shown[curve, axis] == pytest.approx(wanted, abs=1e-5)
            if frame in at:
                assert (shown[curve] == values[frame, curve]).all()
