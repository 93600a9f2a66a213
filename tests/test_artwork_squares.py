"""Fills of small pictures with noise."""

from __future__ import annotations

import numpy as np
import pytest
from image_files import by_resvg

from cubicsplat_cli.artwork.input.condition import condition_of
from cubicsplat_cli.artwork.input.palette import SMALL, square_fills
from cubicsplat_cli.artwork.vectorize import draw

GROUND = (255.0, 255.0, 255.0, 255.0)
# A face with eyes, a mouth and a collar of a few px each.
FACE = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 48 48"><rect width="48" height="48" fill="#fff"/>'
    '<circle cx="24" cy="22" r="16" fill="#fc4"/><circle cx="18" cy="19" r="2.5" fill="#542"/>'
    '<circle cx="30" cy="19" r="2.5" fill="#542"/><rect x="18" y="28" width="12" height="4" fill="#c24"/>'
    '<rect x="10" y="40" width="28" height="5" fill="#36a"/></svg>'
)
FILLS = {"eyes": (85, 68, 34), "mouth": (204, 34, 68), "collar": (51, 102, 170)}


def opaque(levels: np.ndarray) -> np.ndarray:
    return np.concatenate([levels, np.full_like(levels[..., :1], 255.0)], axis=2).astype(np.float32)


@pytest.mark.parametrize("sigma", [2.0, 4.0])
def test_parts_of_a_few_px_keep_their_fills(sigma):
    levels = np.asarray(by_resvg(FACE, 48).convert("RGB"), float)
    levels += np.random.default_rng(4).normal(0.0, sigma, (48, 48, 3))
    assert not condition_of(opaque(levels)).clean
    drawing = draw((np.clip(np.rint(levels), 0, 255) / 255).astype(np.float32))
    for part, fill in FILLS.items():
        off = min(np.abs(np.array(shape.fill[:3]) - fill).max() for shape in drawing.shapes)
        assert off <= 20, f"{part}: {off} levels off in {drawing.fills}"
    assert len(drawing.shapes) <= 12


def test_a_square_shows_a_fill_and_a_ramp_none():
    levels = np.full((24, 24, 4), 255.0, np.float32)
    levels[4:7, 4:7, :3] = (200.0, 30.0, 60.0)
    # Two columns of the blend between two grounds.
    levels[:, 14:, :3] = (20.0, 60.0, 120.0)
    levels[:, 12:14, :3] = 0.5 * (levels[0, 14, :3] + 255.0)
    known = np.array([GROUND, (20.0, 60.0, 120.0, 255.0)])
    found = square_fills(levels, levels, known, 2.0, 8.0, 8.0)
    assert found.tolist() == [[200.0, 30.0, 60.0, 255.0]]


def test_in_larger_pictures_none_are_sought():
    levels = np.full((SMALL + 1, SMALL + 1, 4), 255.0, np.float32)
    levels[40:44, 40:44, 0] = 0.0
    assert square_fills(levels, levels, np.array([GROUND]), 2.0, 8.0, 8.0).shape == (0, 4)
    assert len(square_fills(levels[:SMALL], levels[:SMALL], np.array([GROUND]), 2.0, 8.0, 8.0)) == 0
    small = levels[:SMALL, :SMALL]
    assert len(square_fills(small, small, np.array([GROUND]), 2.0, 8.0, 8.0)) == 1
