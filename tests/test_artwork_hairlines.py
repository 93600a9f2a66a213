"""Lines of less than a pixel, whose ink no pixel near them shows."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.inks import picture_inks
from cubicsplat_cli.artwork.regions import Regions, find_regions


def regions_of(line: np.ndarray) -> Regions:
    """A white picture with a line (40, 1 or 3) in levels down column 30 and a black block far from it."""
    levels = np.full((60, 60, 4), 255.0, dtype=np.float32)
    levels[10:50, 30, :3] = line
    levels[5:20, 5:20, :3] = 0.0
    return find_regions(levels, picture_inks(levels))


def test_a_faint_line_has_the_ink_that_it_is_a_blend_of() -> None:
    # No grey is common enough along the line to be an ink of its own.
    regions = regions_of(np.linspace(120.0, 180.0, 40)[:, None])
    assert regions.count == 3
    assert regions.inks[regions.labels[30, 30]].tolist() == [0.0, 0.0, 0.0, 255.0]


def test_a_line_adds_the_ink_that_only_it_has() -> None:
    regions = regions_of(np.tile([200.0, 0.0, 0.0], (40, 1)))
    assert regions.inks[regions.labels[30, 30]].tolist() == [200.0, 0.0, 0.0, 255.0]


def test_a_row_on_the_rim_is_no_line() -> None:
    levels = np.full((60, 60, 4), 255.0, dtype=np.float32)
    levels[20:40, 20:40, :3] = 0.0
    levels[0, :, :] = 150.0
    assert find_regions(levels, picture_inks(levels)).count == 2
