"""`--shapes`: ellipses, rectangles and polygons in place of free curves."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from cli_runs import strict_json
from conftest import smooth_pixels

from cubicsplat_cli import read_svg, vectorize
from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.from_options import request_of
from cubicsplat_cli.photo.fills import Shapes
from cubicsplat_cli.photo.loop import fit
from cubicsplat_cli.raster.engine import Rates
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.shapes import nearest_shape, shape_gradient, shape_points
from cubicsplat_cli.settings import FitSettings, Mode
from cubicsplat_cli.svg.scene_writer import geometrize_list

DRAWING = b'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><path d="M1 1h5v5z"/></svg>'
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


@pytest.mark.parametrize(("kind", "unmoved"), [("ellipse", True), ("rectangle", True), ("triangle", False)])
def test_only_kinds_that_can_have_spikes_are_penalised_for_them(kind, unmoved):
    target = np.random.default_rng(3).random((12, 16, 3), np.float32)  # its shapes become thinner than a third of a px
    settings = FitSettings.from_preset("draft", curves=40, steps=60, shapes=kind, threads=1)
    free, held = (fit(target, settings.with_(recipe=replace(settings.recipe, spike_penalty=w))) for w in (0.0, 300.0))
    assert np.array_equal(free.scene.points, held.scene.points) == unmoved


@pytest.mark.parametrize("kind", ["ellipse", "polygon"])
def test_a_larger_picture_moves_the_parameters_with_it(kind):
    values = random_values(kind).astype(np.float32)
    shapes = Shapes.nearest(kind, shape_points(kind, values))
    shapes.resize(2.0, 2.0)
    np.testing.assert_allclose(shapes.points(), 2.0 * shape_points(kind, values), atol=1e-4)


TAGS = {"ellipse": "ellipse", "rectangle": "rect", "triangle": "polygon", "polygon": "polygon"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_of_shapes_comes_back(kind):
    segments = 5 if kind == "polygon" else None
    drawn = vectorize(smooth_pixels(48, 32), shapes=kind, curves=9, steps=40, threads=1, segments=segments)
    text = drawn.svg
    assert (text.count(f"<{TAGS[kind]} "), "<path" in text) == (9 + (kind == "rectangle"), False)
    scene = read_svg(text)
    assert scene.curves == drawn.scene.curves == 9
    np.testing.assert_allclose(scene.points[:, ::3].mean(1), drawn.scene.points[:, ::3].mean(1), atol=0.02)
    difference = render_scene(scene) - render_scene(drawn.scene)
    assert np.abs(difference).max() < 0.02
    assert drawn.report.quality.gap_db < 0.3, "renderers draw what was fitted"


@pytest.mark.parametrize(
    "element",
    [
        '<ellipse cx="1" cy="2" rx="3"/>',
        '<rect x="0" y="0" width="2" height="-2"/>',
        '<polygon points="1 2 3 4"/>',
        '<ellipse cx="1" cy="2" rx="3" ry="4" transform="scale(2)"/>',
        '<circle cx="1" cy="1" r="2"/>',
    ],
)
def test_other_elements_in_a_photo_are_refused(element):
    text = (
        '<svg width="9" height="9"><g fill-rule="nonzero">' + element.replace("/>", ' fill="#000000"/>') + "</g></svg>"
    )
    with pytest.raises(InputError):
        read_svg(text)


def test_the_list_of_geometrize(run_cli, photo, tmp_path):
    listed = tmp_path / "shapes.json"
    command = ("vectorize", photo, "--curves", 6, "--steps", 30, "--threads", 1, "--no-png", "-q")
    for kind, number, length in (("ellipse", 4, 5), ("rectangle", 1, 5), ("triangle", 2, 6)):
        run_cli(*command, "--shapes", kind, "--geometrize", listed)
        background, *shapes = json.loads(listed.read_text())
        size = strict_json(photo.with_suffix(".json").read_bytes())["input"]
        assert (background["type"], background["data"]) == (0, [0, 0, size["width"], size["height"]])
        assert [(s["type"], len(s["data"]), len(s["color"])) for s in shapes] == [(number, length, 4)] * len(shapes)
        assert background["score"] > 1.5 * shapes[-1]["score"] > 0.0
    unchanged = run_cli(*command, "--shapes", kind, "--geometrize", listed, "--json")
    assert strict_json(unchanged.stdout)["status"] == "unchanged"


def test_a_rectangle_of_the_list_turns_to_that_of_the_file():
    """As Geometrize draws it: corners turned around the middle by degrees, clockwise as seen."""
    values = np.array([[30.0, 20.0, 8.0, 6.0, 5.0]], np.float32)
    points = shape_points("rectangle", values)
    scene = Scene(
        Mode.CLOSED, 60, 40, points, np.full((1, 3), 0.5, np.float32), np.ones(1, np.float32), np.zeros(1, np.float32)
    )
    shape = json.loads(geometrize_list("rectangle", scene, [1.0, 0.5], {}))[1]
    x1, y1, x2, y2, degrees = shape["data"]
    assert shape["data"] == [20, 15, 40, 25, 37]
    turn, half = np.radians(degrees), np.array([x2 - x1, y2 - y1]) / 2
    corner = (30, 20) + np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ half
    assert np.hypot(*(points[0, ::3] - corner).T).min() < 0.1


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({}, "choose one of them"), ({"shapes": "polygon"}, "choose one of them"),
        ({"shapes": "triangle", "max_bytes": "400gz"}, "choose one of them"),
        ({"shapes": "ellipse", "geometrize": Path("x.txt")}, "must end in .json"),
    ],
)  # fmt: skip
def test_lists_that_cannot_be_are_refused(options, why):
    with pytest.raises(UsageError, match=why):
        request_of({"geometrize": Path("x.json"), **options})


@pytest.mark.parametrize("kind", KINDS)
def test_torch_gives_what_numpy_gives(kind):
    values = random_values(kind).astype(np.float32)
    points = shape_points(kind, values)
    tensors = torch.from_numpy(values), torch.from_numpy(points)
    np.testing.assert_allclose(shape_points(kind, tensors[0]).numpy(), points, atol=1e-4)
    pulled = shape_gradient(kind, *tensors).numpy()
    np.testing.assert_allclose(pulled, shape_gradient(kind, values, points), rtol=1e-4, atol=1e-2)
    moved = [Shapes.nearest(kind, each) for each in (points, tensors[1])]
    for shapes, pull in zip(moved, (points, tensors[1]), strict=True):
        shapes.learn(pull, Rates(0.5, 0.1, 0.1, 0.1))
    np.testing.assert_allclose(moved[1].values.numpy(), moved[0].values, atol=1e-3)
    assert np.abs(moved[0].values - values).max() > 0.1


@pytest.mark.parametrize(
    "others", [{"mode": "open"}, {"fill": "linear"}, {"style": "artwork"}, {"segments": 5}, {"init": DRAWING}]
)
def test_what_restricted_shapes_cannot_be_is_refused(others):
    with pytest.raises(UsageError, match="shapes"):
        request_of({"shapes": "triangle", **others})
