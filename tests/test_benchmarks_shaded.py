"""`benchmarks.shaded`: figures of an SVG against its picture."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from benchmarks.shaded import scores
from cubicsplat_cli.evaluate.rerender import rerender

DISC = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><circle cx="16" cy="16" r="{}" fill="#f80"/></svg>'


def test_a_picture_of_an_svg_has_nearly_no_error_and_its_edge_is_there():
    pixels = rerender(DISC.format(10).encode(), 32, 32).pixels
    found = scores(pixels, DISC.format(10))
    assert found["de00"] == 0.0
    assert found["edge_px"] < 0.03
    assert (found["bytes"], found["shapes"], found["objects"]) == (
        len(gzip.compress(DISC.format(10).encode(), 9, mtime=0)),
        1,
        None,
    )


def test_a_silhouette_that_is_too_large_is_off_by_as_much():
    pixels = np.ascontiguousarray(rerender(DISC.format(10).encode(), 32, 32).pixels)
    assert scores(pixels, DISC.format(10.5))["edge_px"] == pytest.approx(0.5, abs=0.08)
