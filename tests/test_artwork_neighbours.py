"""Which regions enclose others, held against the holes of their masks."""

from __future__ import annotations

import numpy as np
import pytest

from cubicsplat_cli.artwork.regions.neighbours import enclosures, on_the_border, touching
from cubicsplat_cli.raster.ndimage import holes_of
from cubicsplat_cli.raster.unmix import components


def _by_masks(labels: np.ndarray) -> dict[int, set[int]]:
    held = {k: set(np.unique(labels[holes_of(labels == k)]).tolist()) for k in range(labels.max() + 1)}
    return {k: found for k, found in held.items() if found}


@pytest.mark.parametrize("seed", range(8))
def test_what_a_region_encloses_lies_in_the_holes_of_its_mask(seed: int) -> None:
    values = np.random.default_rng(seed).integers(0, 2, (16, 24))
    labels, _ = components(values.repeat(2, axis=0))
    assert enclosures(touching(labels), on_the_border(labels)) == _by_masks(labels) != {}


def test_rings_enclose_all_within_them() -> None:
    y, x = np.indices((21, 21))
    labels = np.minimum(np.maximum(abs(x - 10), abs(y - 10)), 9)  # the outermost ring is two px wide
    assert enclosures(touching(labels), on_the_border(labels)) == {k: set(range(k)) for k in range(1, 10)}


def test_a_stripe_across_the_canvas_encloses_nothing() -> None:
    labels = np.repeat([0, 1, 2], 4)[:, None].repeat(9, axis=1)
    assert enclosures(touching(labels), on_the_border(labels)) == {}
