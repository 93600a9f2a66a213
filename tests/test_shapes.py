"""`--shapes`: ellipses, rectangles and polygons in place of free curves."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import smooth_pixels

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.photo import fit
from cubicsplat_cli.photo.shapes import Shapes
from cubicsplat_cli.request import request_of
from cubicsplat_cli.scene.shapes import nearest_shape, shape_gradient, shape_points
from cubicsplat_cli.settings import FitSettings

KINDS = {"ellipse": 5, "rectangle": 5, "triangle": 6, "polygon": 10}


def random_values(kind: str, n: int = 6) -> np.ndarray:
    return np.random.default_rng(2).uniform(3.0, 40.0, (n, KINDS[kind]))


@pytest.mark.parametrize("kind", KINDS)
def test_the_parameters_come_back_from_the_points(kind):
    values = random_values(kind)
    np.testing.assert_allclose(nearest_shape(kind, shape_points(kind, values)), values, rtol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_are_those_of_finite_differences(kind):
    values = random_values(kind)
    pull = np.random.default_rng(4).normal(size=shape_points(kind, values).shape)
    found = shape_gradient(kind, values, pull)
    for column in range(KINDS[kind]):
        step = np.zeros_like(values)
        step[:, column] = 1e-4
        change = (shape_points(kind, values + step) - shape_points(kind, values - step)) / 2e-4
        np.testing.assert_allclose(found[:, column], (pull * change).sum((1, 2)), rtol=1e-4, atol=1e-4)


def test_an_ellipse_is_round_and_a_rectangle_has_right_angles():
    circle = shape_points("ellipse", np.array([[10.0, 20.0, 3.0, 4.0, 5.0]]))[0] - (10.0, 20.0)
    np.testing.assert_allclose(np.hypot(*circle[::3].T), 5.0, rtol=1e-6)
    anchors = shape_points("rectangle", np.array([[0.0, 0.0, 3.0, 4.0, 2.0]]))[0, ::3]
    sides = np.roll(anchors, -1, axis=0) - anchors
    np.testing.assert_allclose(np.hypot(*sides.T), [10, 4, 10, 4], rtol=1e-6)
    np.testing.assert_allclose((sides * np.roll(sides, -1, axis=0)).sum(1), 0.0, atol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_a_fit_of_shapes_gets_nearer_and_keeps_their_form(kind):
    target = (smooth_pixels(48, 32) / 255.0).astype(np.float32)
    settings = FitSettings.from_preset("draft", curves=12, steps=60, shapes=kind, threads=1)
    fitted = fit(target, settings)
    levels = [entry["psnr_db"] for entry in fitted.history]
    assert levels[-1] > levels[0] + 3.0
    points = fitted.scene.points
    np.testing.assert_allclose(shape_points(kind, nearest_shape(kind, points)), points, atol=2e-3)


@pytest.mark.parametrize("kind", ["ellipse", "polygon"])
def test_a_larger_picture_moves_the_parameters_with_it(kind):
    values = random_values(kind).astype(np.float32)
    shapes = Shapes.nearest(kind, shape_points(kind, values))
    shapes.resize(2.0, 2.0)
    np.testing.assert_allclose(shapes.points(), 2.0 * shape_points(kind, values), atol=1e-4)


@pytest.mark.parametrize("others", [{"mode": "open"}, {"fill": "linear"}, {"style": "artwork"}])
def test_what_restricted_shapes_cannot_be_is_refused(others):
    with pytest.raises(UsageError, match="shapes"):
        request_of({"shapes": "triangle", **others})
