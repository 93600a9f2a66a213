"""Pictures that artwork is not made for: they end in bounded work, with a word about it."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import rest_slow
from image_files import by_resvg

from cubicsplat_cli.artwork import limits, plan, vectorize
from cubicsplat_cli.artwork.finish import polish
from cubicsplat_cli.artwork.finish.parameters import Constraints
from cubicsplat_cli.artwork.finish.state import begin, goal_of
from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Rectangle, polygon
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.layers import completion
from cubicsplat_cli.artwork.regions.regions import FlatPicture
from cubicsplat_cli.artwork.regularities import regularities
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing, Shape, scaled_drawing


def checkers(side: int, cell: int = 1) -> np.ndarray:
    y, x = np.mgrid[:side, :side] // cell
    return np.repeat(((x + y) % 2)[..., None], 3, axis=2).astype(np.float32)


@pytest.mark.parametrize("shape", [(1, 1, 3), (1, 40, 3), (40, 1, 4), (2, 2, 4)])
@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_tiny_pictures(shape, value):
    drawing = vectorize.draw(np.full(shape, value, np.float32))
    assert (drawing.height, drawing.width) == shape[:2]
    assert len(drawing.shapes) == (0 if shape[2] == 4 and value == 0.0 else 1)


def test_too_many_regions_join_their_neighbours(monkeypatch, caplog):
    """Until what is left of the picture is drawn."""
    monkeypatch.setattr(plan, "MOST_REGIONS", 12)
    monkeypatch.setattr(vectorize, "with_added", lambda drawing, *_: drawing)
    picture = checkers(64, cell=8)
    picture[:32] = 0.5
    drawing = vectorize.draw(picture)
    assert 1 <= len(drawing.shapes) <= 12
    assert "regions are too many to draw" in caplog.text


def test_what_must_be_blurred_keeps_very_many_regions(caplog):
    noise = np.random.default_rng(0).integers(0, 256, (160, 160, 4)).astype(np.float32)
    noise[..., 3] = 255.0
    soft, _, regions = plan._regions(FlatPicture(noise), 4.0)
    assert np.ptp(soft) < np.ptp(noise) and regions.count > 1000
    assert not caplog.text


@pytest.mark.parametrize("error", rest_slow(12.0, 0.0))  # levels
def test_no_region_of_a_page_is_lost_whatever_happened_to_the_picture(error, caplog):
    """And of all it is sought which lie beneath which."""
    cells = np.random.default_rng(0).integers(0, 6, (60, 60))
    palette = np.array([[40.0 * k, 255.0 - 40.0 * k, 90.0, 255.0] for k in range(6)])
    labels = np.kron(cells, np.ones((6, 6), dtype=int)).astype(np.int32)
    page = FlatPicture(palette[labels].astype(np.float32), palette, labels)
    assert plan.planned(page, ArtworkSettings(), Condition(noise=error)).regions.count > 2000
    assert not caplog.text


@pytest.mark.slow
def test_regularities_are_sought_in_a_page_of_very_many_shapes(monkeypatch, caplog):
    """Of 900 like letters all but one are copies."""
    letters = 900
    dots = tuple(Circle(10.0 * (k % 30) + 5.2, 10.0 * (k // 30) + 5.3, 3.1) for k in range(letters))
    drawing = Drawing(300, 300, tuple(Shape((0, 0, 0, 255), (dot,), "dot") for dot in dots))
    assert limits.few_enough(drawing)
    goal = goal_of(begin(drawing, goal_of(np.zeros((300, 300, 4)))).image)
    monkeypatch.setattr(regularities, "_tied", lambda state, tied, *_: tied if len(tied) > 1 else state)
    constraints = Constraints(300, 300)
    copies = regularities.with_copies(begin(drawing, goal), constraints, 1.0)
    assert len(copies) == letters - 1 and not caplog.text
    monkeypatch.setattr(limits, "MOST_POLISHED", letters - 1)
    assert not limits.few_enough(drawing) and "symmetries and copies are not sought" in caplog.text


@pytest.mark.parametrize(
    ("limit", "left"), [("CHANGED", "not merged, cut and rounded"), ("MOST", "not fitted to the pixels")]
)
def test_outlines_of_too_many_pieces_are_said_to_be_left_as_they_are(monkeypatch, caplog, limit, left):
    wedge, moved = (polygon(np.array([(3.0, 4.0), (20.0, 5.0), (9.0, 18.0)]) + off) for off in (0.0, 0.2))
    aim, drawing = (Drawing(32, 24, (Shape((0, 0, 0, 255), (each,), "wedge"),)) for each in (wedge, moved))
    goal = goal_of(begin(aim, goal_of(np.zeros((24, 32, 4)))).image)
    polish.polish(drawing, goal)
    assert not caplog.text
    for each in {"CHANGED", limit}:
        monkeypatch.setattr(polish, each, 2)
    done = polish.polish(drawing, goal)
    assert left in caplog.text
    assert (done is drawing) == (limit == "MOST")


@pytest.mark.slow
def test_all_of_many_regions_are_drawn_with_bounded_work_for_each(monkeypatch, caplog):
    monkeypatch.setattr(limits, "MOST_POLISHED", 20)
    fits = []
    fit = completion.fit_outlines
    monkeypatch.setattr(completion, "fit_outlines", lambda points, *given: fits.extend(points) or fit(points, *given))
    parcels, size = 12, 9
    rng = np.random.default_rng(1)
    fills = np.repeat(np.repeat(rng.integers(0, 8, (parcels, parcels, 3)) / 7.0, size, axis=0), size, axis=1)
    drawing = vectorize.draw(fills.astype(np.float32))
    assert len(drawing.shapes) > 0.95 * parcels**2
    # A fit that goes astray is tried again, closer to its points.
    assert len(fits) <= 3 * sum(len(shape.outlines) for shape in drawing.shapes)
    assert "shapes are many" in caplog.text
    target = np.concatenate([fills, np.ones((*fills.shape[:2], 1))], axis=2)
    assert np.abs(begin(drawing, goal_of(target)).image - target).mean() < 0.01


def test_a_large_picture_is_drawn_smaller_and_enlarged(caplog):
    picture = np.zeros((1600, 2000, 3), np.float32)
    picture[200:600, 300:900] = 1.0
    drawing = vectorize.draw(picture)
    assert (drawing.width, drawing.height) == (2000, 1600)
    box = drawing.shapes[-1].outlines[0].ring().anchors
    assert np.abs(box.min(axis=0) - [300, 200]).max() < 0.1
    assert np.abs(box.max(axis=0) - [900, 600]).max() < 0.1
    assert "drawn at 1/2 of its size" in caplog.text


def test_every_outline_is_enlarged():
    outlines = (Circle(1, 2, 3), Ellipse(1, 2, 3, 4, 0.5), Rectangle(1, 2, 9, 8, 2, 0.5), polygon(np.eye(3)[:, :2]))
    drawing = Drawing(5, 5, tuple(Shape((1, 2, 3, 255), (outline,), "x") for outline in outlines))
    for one, other in zip(scaled_drawing(drawing, 15, 15).shapes, drawing.shapes, strict=True):
        assert np.allclose(one.outlines[0].ring().cubics, 3 * other.outlines[0].ring().cubics)


@pytest.mark.parametrize("colors", rest_slow(3, 2, 4))
def test_fills_of_lines_count_among_the_colours_asked_for(colors):
    body = (
        '<rect width="120" height="90" fill="#fff"/><circle cx="40" cy="45" r="30" fill="#d32"/>'
        '<rect x="70" y="20" width="40" height="50" fill="#26c"/>'
        '<path d="M5 85L115 60M5 5L115 30" stroke="#092"/><path d="M8 40L60 88" stroke="#c0c" stroke-width="1.2"/>'
    )
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 120 90">{body}</svg>'
    picture = np.asarray(by_resvg(svg).convert("RGB"), np.float32) / 255.0
    assert len(vectorize.draw(picture, ArtworkSettings(colors=colors)).fills) == colors
    assert len(vectorize.draw(picture).fills) == 5
