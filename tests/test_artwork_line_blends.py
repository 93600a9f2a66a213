"""The blend that thin lines leave in many pixels is no fill; what looks like a blend but lies elsewhere is one."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.regions.fills import picture_fills
from cubicsplat_cli.artwork.regions.regions import FlatPicture, find_regions

FILL, HALF = [240.0, 80.0, 0.0, 255.0], [120.0, 40.0, 0.0, 127.5]


def lines(pairs: int, singles: int) -> np.ndarray:
    """Upright lines of a fill over nothing: so many that lie between two columns, so many that fill one."""
    levels = np.zeros((60, 80, 4), dtype=np.float32)
    levels[45:58, 10:70] = FILL
    for i in range(pairs + singles):
        x = 4 + 5 * i
        levels[5:45, x : x + 2] = HALF if i < pairs else [FILL, [0.0] * 4]
    return levels


def fills_of(levels: np.ndarray) -> list[list[float]]:
    found = find_regions(FlatPicture(levels, picture_fills(levels))).fills
    return sorted(np.unique(np.rint(found), axis=0).tolist())


def test_lines_between_two_columns_have_the_fill_of_those_in_one() -> None:
    levels = lines(2, 3)
    # Each leans over to the other column half way, as lines do that are not quite upright.
    for x in (4, 9):
        levels[10:18, x : x + 2] = [FILL, [0.0] * 4]
        levels[30:38, x : x + 2] = [[0.0] * 4, FILL]
    assert fills_of(levels) == [[0.0, 0.0, 0.0, 0.0], FILL]


def test_a_paler_fill_far_from_the_other_one_stays() -> None:
    levels = lines(0, 6)
    levels[5:40, 60:62] = HALF
    levels[5:40, 70:72] = HALF
    assert np.rint(HALF).tolist() in fills_of(levels)


def test_a_paler_fill_with_interiors_stays() -> None:
    levels = lines(1, 8)
    levels[20:40, 60:76] = HALF
    assert np.rint(HALF).tolist() in fills_of(levels)


def test_lines_too_thin_to_be_pure_anywhere_leave_no_fill() -> None:
    """Between two columns they leave half of each, and here and there more, but beside it nothing that is pure."""
    levels = lines(3, 6)
    for x in (4, 9, 14):
        levels[7:45:5, x] = 0.8 * np.array(FILL)
    assert fills_of(levels) == [[0.0, 0.0, 0.0, 0.0], FILL]


def test_lines_hardly_narrower_than_their_pixels_leave_no_fill() -> None:
    share = lines(0, 12)[..., 3:] / 255.0
    for x in (4, 9, 14):
        share[5:45, x : x + 2] = 0.94
    ground, ink = np.array([75.0, 146.0, 219.0, 255.0]), np.full(4, 255.0)
    levels = np.rint(ground + share * (ink - ground)).astype(np.float32)
    assert fills_of(levels) == [ground.tolist(), ink.tolist()]
