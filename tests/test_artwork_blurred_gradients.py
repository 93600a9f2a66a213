"""Gradients in pictures that are blurred: found as in sharp ones, up to the tips of shapes, without fringes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from cubicsplat_cli.artwork.gradients.noisy import without_blurred_gradients
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.prepare import PreparedInput
from cubicsplat_cli.artwork.input.restore import restored
from cubicsplat_cli.artwork.vectorize import draw

SIDE, FINE, BLUR = 192, 4, 1.2
RED, GOLD, PALE, BLUE, FILL = (
    np.array(c)
    for c in (
        (230.0, 60.0, 40.0),
        (250.0, 210.0, 60.0),
        (240.0, 240.0, 255.0),
        (60.0, 120.0, 200.0),
        (40.0, 90.0, 20.0),
    )
)


def ramp(t: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    t = np.clip(t, 0.0, 1.0)[..., None]
    return (1.0 - t) * first + t * last


def drawing() -> tuple[np.ndarray, np.ndarray]:
    """(SIDE, SIDE, 4) float32 levels, blurred, and (SIDE, SIDE) what lies in the middle of pixels.

    Two gradients (1, 2) that abut on white (0), the second with a tip, a square over both, and a bar (3).
    """
    y, x = (np.mgrid[: SIDE * FINE, : SIDE * FINE] + 0.5) / FINE
    disc = np.hypot(x - 96, y - 96) < 70
    tip = (np.abs(y - 96) < 0.4 * (188 - x)) & (x > 120)
    place = np.where(disc | tip, np.where(x < 96, 1, 2), 0)
    place = np.where((np.abs(x - 96) < 22) & (np.abs(y - 60) < 18), 3, place)
    place = np.where((np.abs(x - 96) < 80) & (np.abs(y - 184.3) < 4), 3, place)
    colours = [np.full((*x.shape, 3), 255.0), ramp((y - 26) / 140, RED, GOLD), ramp((x - 96) / 92, PALE, BLUE)]
    image = np.select([place[..., None] == k for k in range(3)], colours, FILL)
    small = image.reshape(SIDE, FINE, SIDE, FINE, 3).mean(axis=(1, 3))
    sharp = np.dstack([small, np.full((SIDE, SIDE), 255.0)])
    soft = ndimage.gaussian_filter(sharp, (BLUR, BLUR, 0.0), mode="nearest")
    return np.rint(soft).astype(np.float32), place[FINE // 2 :: FINE, FINE // 2 :: FINE]


def test_each_gradient_becomes_one_fill_up_to_its_edges_and_tips():
    soft, place = drawing()
    flat = without_blurred_gradients(soft, BLUR)
    assert len(flat.gradients) == 2
    done = restored(flat.levels, Condition(0.0, False, BLUR)).levels
    middle = ndimage.minimum_filter(place, 3) == ndimage.maximum_filter(place, 3)
    for k in range(4):
        own = done[middle & (place == k)]
        fill = np.median(own, axis=0)
        assert (np.abs(own - fill).max(axis=1) > 24.0).mean() < 0.003, k


@pytest.mark.slow
def test_what_is_drawn_has_a_shape_for_each_gradient():
    prepared = PreparedInput(drawing()[0], Condition(0.0, False, BLUR), (1.0, 1.0), 1.0, SIDE, SIDE)
    shapes = draw(prepared.levels / np.float32(255.0), prepared=prepared).shapes
    # The last px of the tip, which show the gradient nowhere, may be two more.
    assert len(shapes) <= 7
    assert sum(shape.gradient is not None for shape in shapes) == 2


def test_a_flat_drawing_that_is_blurred_has_no_gradients():
    soft = np.full((96, 96, 4), 255.0, dtype=np.float32)
    soft[30:60, 20:70, :3] = (200.0, 40.0, 90.0)
    soft[50:80, 50:90, :3] = (30.0, 90.0, 190.0)
    soft = np.rint(ndimage.gaussian_filter(soft, (BLUR, BLUR, 0.0)))
    assert without_blurred_gradients(soft, BLUR).gradients == ()


@pytest.mark.slow
@pytest.mark.parametrize("blur", [0.8, 2.0])
def test_other_blurs(blur):
    soft, _ = drawing()
    more = ndimage.gaussian_filter(soft, (blur, blur, 0.0), mode="nearest")
    assert len(without_blurred_gradients(np.rint(more), float(np.hypot(blur, BLUR))).gradients) == 2
