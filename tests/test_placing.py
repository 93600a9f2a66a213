"""Places of new restricted shapes."""

from __future__ import annotations

import numpy as np
import pytest

from cubicsplat_cli.photo.seeding import TRIES, Seeder, place_shapes
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.shapes import shape_points
from cubicsplat_cli.settings import FitSettings, Mode

GREY, RED = (0.4, 0.4, 0.4), (0.9, 0.2, 0.1)
# Long and slanting, so that no round patch covers them.
LONG = {
    "ellipse": [60.0, 40.0, 35.0, 20.0, 9.0], "rectangle": [60.0, 40.0, 35.0, 20.0, 6.0],
    "triangle": [20.0, 10.0, 100.0, 30.0, 60.0, 70.0], "polygon": [20.0, 15.0, 90.0, 40.0, 105.0, 65.0, 35.0, 40.0],
}  # fmt: skip


def drawn(points: np.ndarray, colours: np.ndarray, opacity: float = 1.0) -> np.ndarray:
    n = len(points)
    shares = np.full(n, opacity, np.float32)
    return render_scene(Scene(Mode.CLOSED, 120, 80, points, colours, shares, np.zeros(n, np.float32), GREY))


def pictures(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """With a long shape of a kind on grey, and the grey alone."""
    points = shape_points(kind, np.array([LONG[kind]], np.float32))
    return drawn(points, np.array([RED], np.float32)), np.full((80, 120, 3), GREY[0], np.float32)


def error(picture: np.ndarray, target: np.ndarray) -> float:
    return float(((picture - target) ** 2).sum())


def placed(kind: str, target: np.ndarray, plain: np.ndarray, n: int = 1, weights: np.ndarray | None = None):
    """What is placed with each of five series of random numbers: points and colours."""
    segments = {"triangle": 3}.get(kind, 4)
    for seed in range(5):
        centres = np.random.default_rng(seed).random((n, TRIES, 2)) * (120, 80)
        generator = np.random.default_rng(seed + 5)
        yield place_shapes(kind, segments, target, plain, weights, centres, 20.0, 0.99, generator)


def left(found, target: np.ndarray, plain: np.ndarray) -> float:
    """The median share of the error that is left."""
    return float(np.median([error(drawn(*each, 0.99), target) for each in found])) / error(plain, target)


@pytest.mark.parametrize("kind", LONG)
def test_a_shape_goes_where_it_takes_most_of_the_error_away(kind):
    target, plain = pictures(kind)
    assert left(placed(kind, target, plain), target, plain) < 0.5


def test_each_shape_sees_those_before_it_and_lies_in_front_of_them():
    """Of two bars the second shape takes the other one."""
    plain = np.full((80, 120, 3), GREY[0], np.float32)
    target = plain.copy()
    target[10:30, 20:100], target[50:70, 20:100] = RED, (0.1, 0.2, 0.9)
    assert left(placed("rectangle", target, plain, 2), target, plain) < 0.5


def test_only_what_counts_attracts_shapes():
    plain = np.full((80, 120, 3), GREY[0], np.float32)
    target = plain.copy()
    target[20:60, 10:40], target[20:60, 80:110] = RED, 1.0
    weights = np.zeros((80, 120), np.float32)
    weights[:, :60] = 1.0
    for _, colours in placed("rectangle", target, plain, weights=weights):
        np.testing.assert_allclose(colours[0], RED, atol=0.25)


@pytest.mark.parametrize("kind", LONG)
def test_a_fit_places_its_new_shapes_so(kind):
    """Over patches of similar error, half transparent as they begin, most would cover little of a long shape."""
    target, plain = pictures(kind)
    shares = []
    for seed in range(5):
        seeder = Seeder(
            FitSettings.from_preset("draft", shapes=kind, curves=20), np.random.default_rng(seed), GREY, target
        )
        picture = render_scene(seeder.seeds(1, plain).scene(opaque=False))
        shares.append(error(picture, target) / error(plain, target))
    assert np.median(shares) < 0.6
