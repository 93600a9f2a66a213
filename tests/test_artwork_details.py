"""Details that a drawing lost are found in its pixels: dots, hatching and letters of a px or less."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.artwork.document import Document
from cubicsplat_cli.artwork import vectorize
from cubicsplat_cli.artwork.details import candidates as candidates_of
from cubicsplat_cli.artwork.details import spots
from cubicsplat_cli.artwork.details.shares import ink_shares
from cubicsplat_cli.artwork.details.spots import with_spots
from cubicsplat_cli.artwork.details.subpixels import SIDE, arranged
from cubicsplat_cli.artwork.finish.finish import goal_of
from cubicsplat_cli.artwork.geometry.outlines import Rectangle
from cubicsplat_cli.artwork.input.intake import as_levels
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.evaluate.colour import mean_delta_e
from cubicsplat_cli.files.convert import as_picture
from cubicsplat_cli.svg.drawing import write_drawing

WHITE, BLUE, RED = (255, 255, 255, 255), (20, 60, 200, 255), (220, 30, 20, 255)
GROUND = '<rect width="64" height="48" fill="#fff"/><rect x="4" y="4" width="24" height="40" fill="#143cc8"/>'
RED_BOX = '<rect x="44" y="32" width="16" height="12" fill="#dc1e14"/>'
DOTS = "".join(
    f'<circle cx="{36.3 + 5.4 * i}" cy="{7.2 + 6.1 * j}" r="{0.65 + 0.1 * i}" fill="#143cc8"/>'
    for i in range(4)
    for j in range(3)
) + "".join(f'<circle cx="{8.4 + 5.7 * i}" cy="14.6" r="0.8" fill="#dc1e14"/>' for i in range(3))
HATCH = "".join(f'<path d="M{7 + 4.3 * i} 24l3.2 16h1l-3.2-16z" fill="#fff"/>' for i in range(4))


def truth(details: str) -> Document:
    text = f'<svg xmlns="http://www.w3.org/2000/svg" width="64" height="48">{GROUND}{RED_BOX}{details}</svg>'
    return Document(text.encode(), "truth")


def plain() -> Drawing:
    """The drawing without any details."""
    boxes = (
        (WHITE, Rectangle(0.0, 0.0, 64.0, 48.0)),
        (BLUE, Rectangle(4.0, 4.0, 24.0, 40.0)),
        (RED, Rectangle(44.0, 32.0, 16.0, 12.0)),
    )
    return Drawing(64, 48, tuple(Shape(ink, (box,), "box") for ink, box in boxes))


def picture(document: Document) -> np.ndarray:
    return as_levels(as_picture(document.draw()).target()).astype(float) / 255.0


def delta_e(document: Document, drawing: Drawing) -> float:
    written = Document(write_drawing(drawing, title="", comment="").encode(), "ours")
    return mean_delta_e(document.draw(4), written.draw(4))


def test_shares_of_two_and_three_inks_are_those_that_they_were_mixed_with() -> None:
    palette = np.array([WHITE, BLUE, RED], dtype=float)
    shares = np.array([[1.0, 0.0, 0.0], [0.7, 0.3, 0.0], [0.0, 0.2, 0.8], [0.3, 0.3, 0.4]])
    found = ink_shares(shares @ palette, palette, np.ones((4, 3), dtype=bool))
    assert np.abs(found - shares).max() < 1e-6


def test_of_two_blends_that_explain_a_pixel_that_of_inks_near_is_taken() -> None:
    palette = np.array([[0.0, 0, 0, 255], [255.0, 255, 255, 255], [128.0, 128, 128, 255]])
    values = np.array([[200.0, 200, 200, 255]])
    black = ink_shares(values, palette, np.array([[True, True, False]]))
    grey = ink_shares(values, palette, np.array([[False, True, True]]))
    assert black[0].tolist() == pytest.approx([55 / 255, 200 / 255, 0.0])
    assert grey[0].tolist() == pytest.approx([0.0, 72 / 127, 55 / 127])


def test_half_a_column_shared_by_two_pixels_becomes_one_line_at_their_border() -> None:
    shares = np.zeros((6, 8, 2))
    shares[:, 3:5, 1] = 0.25
    shares[..., 0] = 1.0 - shares[..., 1]
    labels = arranged(shares, np.zeros((6 * SIDE, 8 * SIDE), dtype=int), shares[..., 1] > 0.0)
    expected = np.zeros(8 * SIDE, dtype=int)
    expected[4 * SIDE - 1 : 4 * SIDE + 1] = 1
    assert (labels == expected).all()


def test_every_pixel_keeps_its_shares_and_those_not_open_what_is_drawn() -> None:
    shares = np.random.default_rng(1).dirichlet((0.5, 0.5, 0.5), (7, 9))
    drawn = np.full((7 * SIDE, 9 * SIDE), 2)
    is_open = np.random.default_rng(2).random((7, 9)) < 0.6
    labels = arranged(shares, drawn, is_open).reshape(7, SIDE, 9, SIDE).transpose(0, 2, 1, 3).reshape(7, 9, -1)
    counts = (labels[..., None] == np.arange(3)).sum(axis=2)
    assert np.abs(counts / SIDE**2 - shares)[is_open].max() < 1.0 / SIDE**2
    assert (labels[~is_open] == 2).all()


@pytest.mark.parametrize(("details", "count"), [(DOTS, 15), (HATCH, 4)])
def test_lost_details_are_drawn_where_they_are(details: str, count: int) -> None:
    document = truth(details)
    drawing = with_spots(plain(), goal_of(picture(document)))
    assert drawing.shapes[:3] == plain().shapes
    spots = drawing.shapes[3:]
    assert count - 1 <= len(spots) <= count + 3
    assert {spot.ink for spot in spots} <= {WHITE, BLUE, RED}
    assert delta_e(document, drawing) < 0.4 * delta_e(document, plain())


def test_a_drawing_that_explains_its_picture_stays_as_it_is() -> None:
    drawing = plain()
    assert with_spots(drawing, goal_of(picture(truth("")))) is drawing


def test_an_edge_that_is_slightly_off_gets_no_spots() -> None:
    drawing = plain()
    moved = replace(drawing.shapes[1], outlines=(Rectangle(4.08, 4.0, 24.0, 40.0),))
    off = replace(drawing, shapes=(drawing.shapes[0], moved, drawing.shapes[2]))
    assert with_spots(off, goal_of(picture(truth("")))) == off


def test_less_detail_draws_fewer_spots() -> None:
    goal = goal_of(picture(truth(DOTS)))
    assert len(with_spots(plain(), goal, 0.02).shapes) < len(with_spots(plain(), goal).shapes) - 5


def test_large_spots_only_and_no_more_than_asked_for() -> None:
    goal = goal_of(picture(truth(DOTS)))
    assert len(with_spots(plain(), goal, min_area=2.0).shapes) in (6, 7, 8, 9, 10, 11)
    assert len(with_spots(plain(), goal, most=4).shapes) == 7
    assert len(with_spots(plain(), goal, most=0).shapes) == 3


@pytest.mark.parametrize("asked", [{"colors": 3}, {"palette": (WHITE[:3], BLUE[:3], RED[:3])}, {"curves": 3}])
def test_what_was_given_up_on_request_is_no_detail(asked: dict[str, Any]) -> None:
    target = picture(truth(DOTS)).astype(np.float32)
    assert len(vectorize.draw(target, ArtworkSettings(**asked)).shapes) < len(vectorize.draw(target).shapes)


def test_a_small_picture_gains_by_its_spots(monkeypatch: pytest.MonkeyPatch) -> None:
    document = truth(DOTS + HATCH)
    target = picture(document).astype(np.float32)
    drawn = vectorize.draw(target)
    monkeypatch.setattr(vectorize, "with_spots", lambda drawing, *_: drawing)
    assert delta_e(document, drawn) < 0.8 * delta_e(document, vectorize.draw(target))


def test_a_noisy_picture_gets_none(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> Drawing:
        raise AssertionError("noise is no detail")

    monkeypatch.setattr(vectorize, "with_spots", refused)
    noise = np.random.default_rng(3).normal(0.0, 0.03, (48, 64, 1))
    clean = picture(truth(""))
    clean[..., :3] = np.clip(clean[..., :3] + noise, 0.0, 1.0)
    assert vectorize.draw(clean.astype(np.float32)).shapes


def test_of_many_inks_only_those_of_a_place_are_tried_there(monkeypatch):
    side, many = 24, 60
    rng = np.random.default_rng(3)
    palette = np.column_stack([rng.integers(0, 256, (many, 3)), np.full(many, 255)]).astype(float)
    levels = np.tile(palette[0], (side, side, 1))
    levels[8:14, 8:14] = palette[1]
    unexplained = (levels != palette[0]).any(axis=2)
    looked = []
    shares = candidates_of.ink_shares
    monkeypatch.setattr(candidates_of, "ink_shares", lambda *given: looked.append(len(given[1])) or shares(*given))
    painted = np.zeros((SIDE * side, SIDE * side), dtype=np.uint16)
    (found,) = candidates_of.candidates(levels, palette, painted, unexplained)
    assert looked == [2]
    assert (found.ink, found.area) == (1, 36 * 16)


def test_a_large_place_is_looked_at_in_bands_with_the_same_result(monkeypatch):
    rng = np.random.default_rng(5)
    palette = np.column_stack([rng.integers(0, 256, (5, 3)), np.full(5, 255)]).astype(float)
    shares = rng.dirichlet(np.full(5, 0.3), (40, 24))
    shares[rng.random((40, 24)) < 0.3] = np.eye(5)[2]
    painted = np.full((SIDE * 40, SIDE * 24), 2, dtype=np.uint16)
    unexplained = rng.random((40, 24)) < 0.5
    found = []
    for band in (candidates_of.BAND, 3 * 24):
        monkeypatch.setattr(candidates_of, "BAND", band)
        some = candidates_of.candidates(shares @ palette, palette, painted, unexplained)
        found.append([(each.ink, each.area, each.corner.tolist(), each.mask.tolist()) for each in some])
    assert len(found[0]) > 20
    assert found[0] == found[1]


def test_what_is_painted_is_the_uppermost_shape_that_covers_most_of_a_subpixel():
    shapes = (*plain().shapes, Shape(WHITE, (Rectangle(8.0, 8.0, 4.13, 2.0),), "box"))
    painted = candidates_of.painted_inks(replace(plain(), shapes=shapes), [0, 1, 2, 3], 9)
    assert painted.shape == (SIDE * 48, SIDE * 64) and painted.dtype == np.uint16
    assert np.bincount(painted.ravel()).tolist() == [
        16 * (64 * 48 - 24 * 40 - 16 * 12),
        16 * 24 * 40 - 8 * 17,
        16 * 16 * 12,
        8 * 17,
    ]


def test_of_many_details_the_largest_are_tried(monkeypatch, caplog):
    goal = goal_of(picture(truth(DOTS)))
    monkeypatch.setattr(spots, "MOST_TRIED", 3)
    assert 3 < len(with_spots(plain(), goal).shapes) <= 6
    assert "details are too many: only the 3 largest are tried" in caplog.text
