"""What a drawing does not explain of its picture is found and drawn: areas, thin lines, dots and hatching."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from benchmarks.artwork.document import Document
from cubicsplat_cli.artwork import vectorize
from cubicsplat_cli.artwork.finish import added
from cubicsplat_cli.artwork.finish.state import goal_of
from cubicsplat_cli.artwork.geometry.outlines import Circle, Rectangle
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.evaluate.perceptual import mean_delta_e
from cubicsplat_cli.files.load import as_picture
from cubicsplat_cli.scene.paint import LinearGradient, Stop
from cubicsplat_cli.svg.drawing_writer import write_drawing

CLEAN = Condition()
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


HIDDEN = '<path d="M6 38L40 4L44 29z" fill="#ffa828"/>'


def plain() -> Drawing:
    """The drawing without any details."""
    boxes = (
        (WHITE, Rectangle(0.0, 0.0, 64.0, 48.0)),
        (BLUE, Rectangle(4.0, 4.0, 24.0, 40.0)),
        (RED, Rectangle(44.0, 32.0, 16.0, 12.0)),
    )
    return Drawing(64, 48, tuple(Shape(fill, (box,), "box") for fill, box in boxes))


def picture(document: Document) -> np.ndarray:
    return as_levels(as_picture(document.draw()).target()).astype(float) / 255.0


def delta_e(document: Document, drawing: Drawing) -> float:
    written = Document(write_drawing(drawing, title="", comment="").encode(), "ours")
    return mean_delta_e(document.draw(4), written.draw(4))


def painted(drawing: Drawing) -> np.ndarray:
    return picture(Document(write_drawing(drawing, title="", comment="").encode(), "ours"))


def explained(drawing: Drawing, target: np.ndarray, condition: Condition = CLEAN, **asked: Any) -> Drawing:
    return added.with_added(drawing, goal_of(target, condition.blur), condition, **{"detail": 1.0, **asked})


def new_shapes(drawing: Drawing) -> list[Shape]:
    return [shape for shape in drawing.shapes if shape not in plain().shapes]


@pytest.mark.parametrize(("details", "count"), [(DOTS, 15), (HATCH, 4)])
def test_lost_details_are_drawn_where_they_are_in_the_fill_colours_of_the_drawing(details: str, count: int) -> None:
    document = truth(details)
    drawing = explained(plain(), picture(document))
    assert [shape for shape in drawing.shapes if shape in plain().shapes] == list(plain().shapes)
    new = new_shapes(drawing)
    assert len(new) == count
    assert {shape.fill for shape in new} <= {WHITE, BLUE, RED}
    assert delta_e(document, drawing) < 0.1 * delta_e(document, plain())


def test_what_explains_most_of_an_area_stays_where_some_of_that_is_left() -> None:
    target = picture(truth('<path d="M34 20h24v3H34z" fill="#143cc8"/>'))
    y, x = np.mgrid[:48, :64]
    for middle in (33, 58):  # soft ends, which shapes do not explain
        share = 0.6 * np.clip(1.0 - np.hypot(x - middle, y - 21) / 3.0, 0.0, 1.0)[..., None]
        target += share * (np.array([1.0, 0.6, 0.0, 1.0]) - target)
    drawing = explained(plain(), target)
    assert new_shapes(drawing)
    left, before = (np.square(painted(each) - target).mean() for each in (drawing, plain()))
    assert left <= 0.5 * before


def test_an_area_of_a_lost_colour_is_drawn_in_it_beneath_what_lies_on_it() -> None:
    """A pale green box, from beneath the red one up, of which the drawing has nothing."""
    box = '<rect x="36" y="12" width="20" height="26" fill="#e6f5d8"/>'
    document = truth(box + RED_BOX)
    drawing = explained(plain(), picture(document))
    (new,) = new_shapes(drawing)
    assert new.fill == (230, 245, 216, 255)
    assert drawing.shapes.index(new) < [shape.fill for shape in drawing.shapes].index(RED)
    assert delta_e(document, drawing) < 0.05 * delta_e(document, plain())


def test_dots_of_several_colours_that_touch_have_each_its_own() -> None:
    pairs = "".join(
        f'<path d="M{x} {y}h2.4v2.6h-2.4z" fill="#143cc8"/><path d="M{x + 2.4} {y}h2.3v2.6h-2.3z" fill="#dc1e14"/>'
        for x, y in ((36.3, 6.2), (46.7, 10.4), (37.6, 20.3))
    )
    document = truth(pairs)
    drawing = explained(plain(), picture(document))
    assert sorted(shape.fill for shape in new_shapes(drawing)) == [BLUE] * 3 + [RED] * 3
    assert delta_e(document, drawing) < 0.4 * delta_e(document, plain())


@pytest.mark.parametrize("condition", [CLEAN, Condition(noise=3.0), Condition(noise=1.0, jpeg=True)])
def test_specks_go_that_explain_nothing(condition: Condition) -> None:
    speck = Shape((26, 64, 196, 255), (Circle(16.0, 20.0, 1.5),), "speck")
    dot = Shape(RED, (Circle(40.0, 12.0, 1.5),), "dot")
    target = picture(truth('<circle cx="40" cy="12" r="1.5" fill="#dc1e14"/>'))
    target[..., :3] += np.random.default_rng(0).normal(0.0, condition.noise / 255.0, target[..., :3].shape)
    drawing = explained(replace(plain(), shapes=(*plain().shapes, speck, dot)), target, condition)
    assert drawing.shapes == (*plain().shapes, dot)


def test_a_row_of_few_px_is_a_line() -> None:
    bars = '<path d="M36 10.4h3.6v.4h-3.6zM46.3 20h.5v3.2h-.5z" fill="#143cc8"/>'
    drawing = explained(plain(), picture(truth(bars)))
    sides = [(shape.outlines[0].width, shape.outlines[0].height) for shape in new_shapes(drawing)]
    assert np.abs(np.array(sides) - [(0.5, 3.2), (3.6, 0.4)]).max() < 0.25


def test_lines_are_found_in_noise_and_through_a_blur() -> None:
    line = '<path d="M32 6C44 2 50 26 60 22" fill="none" stroke="#143cc8" stroke-width="1.2"/>'
    rng = np.random.default_rng(5)
    clean = picture(truth(line))
    noisy = np.clip(clean + rng.normal(0.0, 0.012, clean.shape) * [1.0, 1.0, 1.0, 0.0], 0.0, 1.0)
    blurred = ndimage.gaussian_filter(clean, (1.2, 1.2, 0.0), mode="nearest")
    for target, condition in ((noisy, Condition(noise=3.0)), (blurred, Condition(blur=1.2))):
        drawing = explained(plain(), target, condition)
        assert 1 <= len(new_shapes(drawing)) <= 2
        assert delta_e(truth(line), drawing) < 0.5 * delta_e(truth(line), plain())


def test_dots_are_drawn_in_faint_noise() -> None:
    document, rng = truth(DOTS), np.random.default_rng(0)
    target = picture(document)
    target[..., :3] += rng.normal(0.0, 2.0 / 255.0, target[..., :3].shape)
    drawing = explained(plain(), target, Condition(noise=2.0))
    assert len(new_shapes(drawing)) == 15
    assert {shape.fill for shape in new_shapes(drawing)} <= {WHITE, BLUE, RED}
    assert delta_e(document, drawing) < 0.15 * delta_e(document, plain())


def test_lines_in_nearly_one_colour_have_one_fill() -> None:
    lines = "".join(
        f'<path d="M34 {6 + 6 * k}h24" stroke="#{red}a935" stroke-width="2"/>'
        for k, red in enumerate(["de", "e2", "e5"])
    )
    new = new_shapes(explained(plain(), picture(truth(lines)), Condition(1.0, jpeg=True)))
    assert len(new) == 3 and len({shape.fill for shape in new}) == 1


def test_of_a_damaged_picture_a_blend_that_no_area_shows_is_no_fill() -> None:
    lines = "".join(f'<path d="M{34 + 8 * k} 8.5h6" stroke="#8a9ee4"/>' for k in range(3))
    new = new_shapes(explained(plain(), picture(truth(lines)), Condition(1.0, jpeg=True)))
    assert len(new) == 3 and {shape.fill for shape in new} == {BLUE}


def test_of_a_damaged_picture_what_lies_on_the_rim_is_no_detail() -> None:
    document = truth('<path d="M34 47h30v1h-30z" fill="#888"/>')
    assert explained(plain(), picture(document), Condition(1.0, jpeg=True)) == plain()
    assert len(new_shapes(explained(plain(), picture(document)))) == 1


def test_a_line_that_its_picture_lacks_is_covered() -> None:
    line = Shape(BLUE, (Rectangle(34.0, 10.0, 24.0, 1.0),), "line")
    drawing = explained(replace(plain(), shapes=(*plain().shapes, line)), picture(truth("")))
    assert delta_e(truth(""), drawing) < 0.1 * delta_e(truth(""), replace(plain(), shapes=(*plain().shapes, line)))


def test_a_drawing_that_explains_its_picture_stays_as_it_is() -> None:
    drawing = plain()
    assert explained(drawing, picture(truth(""))) is drawing


def test_an_edge_that_is_slightly_off_gets_no_shape() -> None:
    drawing = plain()
    moved = replace(drawing.shapes[1], outlines=(Rectangle(4.08, 4.0, 24.0, 40.0),))
    off = replace(drawing, shapes=(drawing.shapes[0], moved, drawing.shapes[2]))
    assert explained(off, picture(truth(""))) is off


def test_what_an_edge_along_the_border_has_beyond_it_is_no_detail() -> None:
    # Where a disc touches the border there is no pixel beside its edge that shows the ground.
    ground = Shape(WHITE, (Rectangle(0.0, 0.0, 200.0, 200.0),), "ground")
    less, more = (Drawing(200, 200, (ground, Shape(BLUE, (Circle(100.0, 100.0, r),), "disc"))) for r in (99.5, 99.75))
    for one, other in ((less, more), (more, less)):
        assert explained(one, painted(other)) is one


def test_what_is_left_is_said(caplog: pytest.LogCaptureFixture) -> None:
    box = '<rect x="36" y="12" width="20" height="26" fill="#e6f5d8"/>'
    explained(plain(), picture(truth(box)))
    assert not caplog.messages
    explained(plain(), picture(truth(box)), most=3)
    (message,) = caplog.messages
    assert message.startswith("areas that differ visibly from the picture: 1, of 5")


def test_noise_is_explained_by_nothing() -> None:
    noise = np.random.default_rng(3).normal(0.0, 0.03, (48, 64, 1))
    target = picture(truth(""))
    target[..., :3] = np.clip(target[..., :3] + noise, 0.0, 1.0)
    drawing = plain()
    assert explained(drawing, target, Condition(noise=0.03 * 255.0)) == drawing


def test_less_detail_draws_fewer_shapes() -> None:
    target = picture(truth(DOTS))
    assert len(explained(plain(), target, detail=0.02).shapes) < len(explained(plain(), target).shapes) - 5


def test_large_shapes_only_and_no_more_than_asked_for() -> None:
    target = picture(truth(DOTS))
    assert len(explained(plain(), target, min_area=2.0).shapes) <= len(explained(plain(), target).shapes)
    assert len(explained(plain(), target, min_area=20.0).shapes) == 3
    assert len(explained(plain(), target, most=7).shapes) <= 7
    assert len(explained(plain(), target, most=3).shapes) == 3


@pytest.mark.parametrize("asked", [{"palette": (WHITE[:3], BLUE[:3], RED[:3])}, {"curves": 3}])
def test_what_was_given_up_on_request_is_no_detail(asked: dict[str, Any]) -> None:
    target = picture(truth(DOTS)).astype(np.float32)
    assert len(vectorize.draw(target, ArtworkSettings(**asked)).shapes) < len(vectorize.draw(target).shapes)


def test_a_small_picture_that_is_traced_by_pixels_gains_by_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vectorize, "or_finer", lambda outlined, *_: (outlined.unpainted, None))
    document = truth(DOTS + HATCH)
    target = picture(document).astype(np.float32)
    drawn = vectorize.draw(target)
    monkeypatch.setattr(vectorize, "with_added", lambda drawing, *_: drawing)
    assert delta_e(document, drawn) < 0.8 * delta_e(document, vectorize.draw(target))


def test_small_outlines_get_as_many_pieces_as_large_ones() -> None:
    places = ((4, 6, 0.6), (22.3, 5, 0.8), (45, 4, 1.0), (70, 6.4, 0.7))
    places += ((5, 30.2, 1.0), (30.4, 34.1, 0.6), (50.2, 32.3, 0.8), (72.7, 33, 0.9))
    leaf = "M0 8C1 2 5 0 8 3C11 -1 16 2 15 7L18 12L12 11C11 15 6 16 4 13L-2 14z"
    leaves = "".join(f'<path transform="translate({x} {y}) scale({s})" d="{leaf}"/>' for x, y, s in places)
    text = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 96 64"><path d="M0 0H96V64H0z" fill="#f4f1e8"/>'
    document = Document(f'{text}<g fill="#b3261e">{leaves}</g></svg>'.encode(), "x", 96)
    assert delta_e(document, vectorize.draw(as_picture(document.draw()).target())) < 0.14


def test_of_many_areas_the_worst_are_tried(monkeypatch, caplog):
    monkeypatch.setattr(added, "MOST_TRIED", 3)
    assert 3 < len(explained(plain(), picture(truth(DOTS))).shapes) <= 12
    assert "only the 3 largest are tried" in caplog.text


@pytest.mark.parametrize(("x", "count"), [(28.0, 0), (34.5, 5)])
def test_dots_smaller_than_a_pixel_are_drawn_but_for_those_on_an_edge(x: float, count: int) -> None:
    document = truth("".join(f'<circle cx="{x}" cy="{8.5 + 6 * k}" r="0.5" fill="#dc1e14"/>' for k in range(5)))
    assert len(new_shapes(explained(plain(), picture(document)))) == count


@pytest.mark.parametrize("pitch", [2.5, 2.75, 2.94, 3.3])
@pytest.mark.parametrize("known", [False, True])
def test_faint_dots_have_their_own_fill_and_not_less_of_a_strong_one(pitch: float, known: bool) -> None:
    faint = (176, 188, 236, 255)  # a blend of blue and white
    box = '<rect x="34" y="33" width="8" height="8" fill="#b0bcec"/>' if known else ""
    dots = "".join(f'<circle cx="{34.13 + pitch * k}" cy="12.5" r=".65" fill="#b0bcec"/>' for k in range(9))
    drawing = plain()
    if known:
        drawing = replace(drawing, shapes=(*drawing.shapes, Shape(faint, (Rectangle(34.0, 33.0, 8.0, 8.0),), "box")))
    found = explained(drawing, picture(truth(box + dots)))
    new = [shape for shape in found.shapes if isinstance(shape.outlines[0], Circle)]
    assert len(new) == 9 == len(found.shapes) - len(drawing.shapes)
    assert np.abs(np.array([shape.fill for shape in new]) - faint).max() < (1 if known else 24)


def test_the_seam_of_a_hidden_shape_along_the_edge_of_another_gets_no_dots() -> None:
    text = (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 64 48"><path d="M0 0H64V48H0z" fill="#fff"/>'
        '<path d="M50 2H60V12H50z" fill="#ffa828"/>{}<path d="M6 38L40 4L50 30z" fill="#e2e0e4"/></svg>'
    )
    document, seamed = (Document(text.format(each).encode(), "x", 64) for each in ("", HIDDEN))
    drawing = vectorize.draw(as_picture(document.draw()).target())
    assert explained(drawing, picture(seamed)) is drawing


@pytest.mark.parametrize("off", [(40.0, 0.0), (0.0, 60.0), (-30.0, 5.0), (40.0, 60.0)])
def test_what_lies_beyond_the_canvas_changes_no_pixel(off):
    shape = Shape(RED, (Rectangle(2.0 + off[0], 3.0 + off[1], 9.0, 6.0),), "red")
    window, own = added._changed(shape, 1, (24, 32))
    changed = np.zeros((24, 32), dtype=int)
    changed[window] += own
    assert not changed.any()


def test_a_drawing_of_gradients_alone_gets_what_it_lacks() -> None:
    stops = Stop(0.0, (250, 250, 250, 255)), Stop(1.0, (240, 240, 240, 255))
    page = Rectangle(0.0, 0.0, 64.0, 48.0)
    alone = Shape((245, 245, 245, 255), (page,), "page", gradient=LinearGradient(0.0, 0.0, 64.0, 0.0, stops))
    target = np.full((48, 64, 4), 245.0 / 255.0)
    target[..., 3] = 1.0
    target[20:30, 20:30, :3] = BLUE[0] / 255.0, BLUE[1] / 255.0, BLUE[2] / 255.0
    _, new = explained(Drawing(64, 48, (alone,)), target).shapes
    assert new.fill == BLUE
