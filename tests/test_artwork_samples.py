"""Drawings of our own, vectorized and held against their truth: what every stage together must keep up."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from conftest import rest_slow

SAMPLES = Path(__file__).parent.parent / "samples" / "artwork"
SIZE = 256
# Most dE00, least dB at four times the size, most coordinates: a fifth beyond what they are, and 1.2 dB or more.
BOUNDS = {
    "bird": (0.038, 41.5, 135),
    "chart": (0.060, 34.5, 250),
    "face": (0.027, 45.0, 115),
    "fish": (0.060, 39.5, 195),
    "flag": (0.006, 50.0, 56),
    "house": (0.018, 48.0, 126),
    "letters": (0.076, 37.3, 145),
    "wheel": (0.018, 49.0, 62),
}


@pytest.mark.parametrize("name", rest_slow(*BOUNDS))
def test_a_drawing_comes_as_near_in_as_much(run_benchmark, name):
    most, least, coordinates = BOUNDS[name]
    done = run_benchmark("artwork", SAMPLES, "--size", SIZE, "--only", name, "--json")
    (run,) = json.loads(done.stdout)["runs"]
    assert run["delta_e"] <= most
    assert run["psnr_4x_db"] >= least
    assert run["coordinates"] <= coordinates
    # No ground shows where the drawing is opaque.
    assert [run[f"leak_{scale}x_px"] for scale in (1, 4, 16)] == [0.0, 0.0, 0.0]
