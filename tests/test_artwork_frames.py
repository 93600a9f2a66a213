"""Fills with a stroke around them: found in pictures, written as one element and read back."""

from __future__ import annotations

import math
import re
from io import BytesIO

import cairosvg
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from cubicsplat_cli.artwork.finish.state import goal_of
from cubicsplat_cli.artwork.geometry.outlines import Circle, Rectangle, polygon
from cubicsplat_cli.artwork.geometry.stroke import Stroke, line_chain
from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing, Shape, ground_shape, is_framed
from cubicsplat_cli.artwork.strokes.frames import with_frames
from cubicsplat_cli.artwork.strokes.leftover import left_of
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.raster.strokes import ring_widths
from cubicsplat_cli.svg.drawing_reader import read_drawing
from cubicsplat_cli.svg.drawing_writer import write_drawing

WHITE, BLACK, GOLD, BLUE = (255, 255, 255, 255), (0, 0, 0, 255), (255, 210, 60, 255), (40, 90, 200, 255)
SIDE = 160


def picture(body: str, side: int = SIDE) -> np.ndarray:
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" width="{side}" height="{side}">{body}</svg>'
    png = cairosvg.svg2png(bytestring=svg.encode(), background_color="white")
    return np.asarray(Image.open(BytesIO(png)).convert("RGB"), np.float32) / 255.0


def written(drawing: Drawing) -> str:
    return write_drawing(drawing, title="a", comment="b")


def both(svg: str) -> list[str]:
    """The elements that have a fill and a stroke."""
    return [
        each
        for each in re.findall(r"<(?:path|rect|circle|ellipse)[^>]*>", svg)
        if "stroke=" in each and 'fill="#' in each
    ]


def number(element: str, name: str) -> float:
    return float(re.search(rf' {name}="([^"]*)"', element)[1])


@pytest.mark.parametrize(
    ("body", "numbers"),
    [
        ('<rect x="30" y="40" width="90" height="60"', {"x": 30, "y": 40, "width": 90, "height": 60}),
        ('<rect x="30" y="40" width="90" height="60" rx="9"', {}),
        ('<circle cx="80.3" cy="77.6" r="51.2"', {"cx": 80.3, "cy": 77.6, "r": 51.2}),
        ('<ellipse cx="80" cy="80" rx="60" ry="35"', {"cx": 80, "cy": 80, "rx": 60, "ry": 35}),
        ('<path d="M80 15L140 130L20 120z"', {}),
        ('<path d="M30 40C90 0 130 40 130 90S60 150 40 120S0 70 30 40z"', {}),
    ],
)
@pytest.mark.parametrize("width", [2.0, 5.0])
def test_a_fill_and_its_stroke_are_one_element(body: str, numbers: dict[str, float], width: float) -> None:
    drawing = draw(picture(f'{body} fill="#ffd23c" stroke="#1a1a1a" stroke-width="{width}"/>'))
    svg = written(drawing)
    (element,) = both(svg)
    assert 'fill="#ffd23c"' in element and 'stroke="#1a1a1a"' in element
    assert number(element, "stroke-width") == pytest.approx(width, abs=0.06)
    assert {name: number(element, name) for name in numbers} == pytest.approx(numbers, abs=0.12)
    assert len(drawing.shapes) == 3 and svg.count("fill=") == 2  # the ground, and these


@given(st.floats(22.0, 40.0), st.floats(1.5, 5.0), st.floats(0.0, 1.0))
@settings(max_examples=12)
def test_a_disc_has_its_stroke_at_any_place_and_width(radius: float, width: float, at: float) -> None:
    disc = (
        f'<circle cx="{50 + at}" cy="{48 - at}" r="{radius}" fill="#285ac8" stroke="#101010" stroke-width="{width}"/>'
    )
    (element,) = both(written(draw(picture(disc, 100))))
    assert number(element, "r") == pytest.approx(radius, abs=0.06)
    assert number(element, "stroke-width") == pytest.approx(width, abs=0.1)


def linked_boxes() -> np.ndarray:
    box = 'width="50" height="30" fill="#ffd23c" stroke="#1a1a1a" stroke-width="2"/>'
    line = '<path d="M60 35V130" stroke="#1a1a1a" stroke-width="2"/>'
    return picture(f'{line}<rect x="35" y="20" {box}<rect x="35" y="110" {box}')


def test_lines_between_boxes_are_left_of_their_ink() -> None:
    given = linked_boxes()
    drawing = draw(given)
    assert len(both(written(drawing))) == 2
    made = render_scene(scene_of(drawing))[..., :3]
    assert np.abs(made - given).max() < 0.06


def test_strokes_around_fills_keep_to_the_number_of_shapes() -> None:
    assert len(draw(linked_boxes()).shapes) > 4
    few = draw(linked_boxes(), ArtworkSettings(curves=4))
    assert len(few.shapes) == 4 and not both(written(few))


def test_rings_of_a_target_stay_discs() -> None:
    rings = "".join(
        f'<circle cx="80" cy="80" r="{r}" fill="{c}"/>' for r, c in ((70, "#c00"), (48, "#fff"), (26, "#c00"))
    )
    assert not both(written(draw(picture(rings))))


def framed(*shapes: Shape) -> Drawing:
    """A drawing of shapes on white, with frames where it has any."""
    drawing = Drawing(SIDE, SIDE, (ground_shape(WHITE, SIDE, SIDE), *shapes))
    goal = goal_of(render_scene(scene_of(drawing)).astype(float))
    return with_frames(drawing, goal, 1.0, 0.0, sampled=False)


RING = Shape(BLACK, (Circle(80.0, 80.0, 52.0), Circle(80.0, 80.0, 48.0)), "black")
DISC = Shape(GOLD, (Circle(80.2, 80.0, 50.3),), "yellow")


def test_a_fill_that_shows_in_a_hole_ends_beneath_the_stroke_around_that() -> None:
    _, fill, stroke = framed(DISC, RING).shapes
    assert is_framed(fill, stroke) and fill.fill == GOLD and stroke.fill == BLACK
    assert stroke.stroke.width == pytest.approx(4.0, abs=0.02) and fill.outlines[0].r == pytest.approx(50.0, abs=0.02)


def test_a_closed_stroke_is_that_of_the_fill_beneath() -> None:
    stroke = RING.stroked(Stroke(Circle(80.0, 80.0, 50.0), 4.0))
    _, fill, around = framed(DISC, stroke).shapes
    assert is_framed(fill, around)


def test_nothing_is_hidden_by_a_fill_that_moves_up_or_a_stroke_that_does() -> None:
    dot = Shape(BLUE, (Circle(80.0, 80.0, 10.0),), "blue")
    for shapes in [
        (DISC, dot, RING),
        (replaced(DISC, BLACK, 52.0), Shape(BLUE, (Circle(130.0, 80.0, 6.0),), "blue"), replaced(DISC, GOLD, 48.0)),
    ]:
        assert framed(*shapes).shapes[1:] == shapes


def replaced(shape: Shape, fill: tuple[int, int, int, int], radius: float) -> Shape:
    return Shape(fill, (Circle(80.0, 80.0, radius),), shape.name)


def pairs(*places: float) -> tuple[Shape, ...]:
    """Gold triangles with black strokes of 2 px."""
    out = []
    for x in places:
        path = polygon(np.array([[x, 20.0], [x + 20.0, 60.0], [x - 20.0, 60.0]]))
        fill = Shape(GOLD, (path,), "yellow")
        out += [fill, Shape(BLACK, (), "black").stroked(Stroke(path, 2.0, join="round"))]
    return tuple(out)


def test_a_pair_is_read_back_as_it_was_written() -> None:
    drawing = Drawing(SIDE, SIDE, pairs(40.0))
    svg = written(drawing)
    assert svg.count("<path") == 1 and 'stroke-linejoin="round"' in svg
    again = read_drawing(svg)
    assert [shape.fill for shape in again.shapes] == [GOLD, BLACK]
    assert is_framed(*again.shapes) and sorted(again.shapes[0].outlines[0].anchors.tolist()) == [
        [20, 60],
        [40, 20],
        [60, 60],
    ]
    assert len(both(written(again))) == 1
    assert drawing.coordinates == again.coordinates == 6  # of three corners, and a width


def test_pairs_of_a_colour_do_not_join() -> None:
    svg = written(Drawing(SIDE, SIDE, pairs(30.0, 60.0, 90.0, 120.0, 140.0)))
    assert svg.count("<path") == len(both(svg)) == 5
    assert [shape.fill for shape in read_drawing(svg).shapes] == 5 * [GOLD, BLACK]


@pytest.mark.parametrize("change", ["moved", "hole", "group", "order"])
def test_other_fills_are_no_pairs(change: str) -> None:
    fill, stroke = pairs(40.0)
    others = {
        "moved": (pairs(40.5)[0], stroke),
        "hole": (Shape(GOLD, (*fill.outlines, Rectangle(38.0, 45.0, 4.0, 4.0)), "yellow"), stroke),
        "group": (Shape(GOLD, fill.outlines, "yellow", group="a"), stroke),
        "order": (stroke, fill),
    }
    assert not is_framed(*others[change])
    assert len(both(written(Drawing(SIDE, SIDE, others[change])))) == 0


def test_a_stroke_of_a_path_of_several_outlines_is_refused() -> None:
    svg = written(Drawing(SIDE, SIDE, pairs(40.0)))
    with pytest.raises(InputError, match="a stroke around several outlines"):
        read_drawing(svg.replace('z" fill', 'zM100 20h10v10z" fill'))


@given(st.floats(10.0, 60.0), st.floats(0.5, 5.0))
def test_the_width_along_a_ring_is_its_distance_to_the_next(radius: float, width: float) -> None:
    around, face = (Circle(80.0, 80.0, r).ring().cubics for r in (radius + width, radius))
    widths, even = ring_widths([around, face[::-1, ::-1]], 0.05, 0.2)
    assert widths == pytest.approx(width, rel=0.06) and even == pytest.approx(1.0)


def test_a_ring_that_is_not_in_the_middle_has_one_width_in_part():
    around, face = (Circle(x, 80.0, r).ring().cubics for x, r in ((80.0, 44.0), (82.0, 40.0)))
    widths, even = ring_widths([around, face[::-1, ::-1]], 0.05, 0.2)
    assert widths == pytest.approx(4.0, abs=0.5)
    assert even == pytest.approx(2.0 / np.pi * np.arcsin(0.4 / 2.0), abs=0.08)  # where x is off by a tenth of the width


def test_what_is_left_of_a_cross_is_its_arms() -> None:
    arms = polygon(np.array([[70, 10], [90, 10], [90, 150], [70, 150.0]]))
    cross = Shape(BLACK, (arms,), "black")

    parts = left_of(cross, [Circle(80.0, 80.0, 30.0).ring()], 4.0)
    rows = sorted(
        (float(part.outlines[0].anchors[:, 1].min()), float(part.outlines[0].anchors[:, 1].max())) for part in parts
    )
    ends = 80.0 - math.sqrt(900.0 - 100.0) + 4.0
    assert np.array(rows) == pytest.approx(np.array([[10.0, ends], [160.0 - ends, 150.0]]), abs=0.3)
    assert left_of(cross, [Rectangle(60.0, 0.0, 40.0, 160.0).ring()], 4.0) == []


def test_a_ring_that_nothing_covers_is_left_as_it_is() -> None:
    (left,) = left_of(RING, [Circle(80.0, 80.0, 20.0).ring()], 1.0)
    assert np.allclose(left.coverage(0, 0, SIDE, SIDE), RING.coverage(0, 0, SIDE, SIDE))


def test_open_strokes_have_no_fill() -> None:
    line = Shape(BLACK, (), "black").stroked(Stroke(line_chain(np.array([[20.0, 80.0], [140.0, 80.0]])), 4.0))
    assert framed(DISC, line).shapes[1:] == (DISC, line)
