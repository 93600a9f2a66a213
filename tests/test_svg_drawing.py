"""Artwork as SVG: elements, path data, numbers, names; what the file shows equals what was drawn."""

from __future__ import annotations

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import agreement_db
from hypothesis import given
from hypothesis import strategies as st

from cubicsplat_cli.artwork.geometry.outlines import (
    Circle,
    Ellipse,
    Rectangle,
    Ring,
    polygon,
    ring_of_cubics,
    signed_area,
)
from cubicsplat_cli.artwork.geometry.steps import suggested_precision
from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.drawing_paths import grid_rings
from cubicsplat_cli.svg.drawing_reader import holds_drawing, read_drawing
from cubicsplat_cli.svg.drawing_writer import write_drawing
from cubicsplat_cli.svg.own import own_elements
from cubicsplat_cli.svg.paths import commands, subpaths
from cubicsplat_cli.svg.scene_reader import read_svg

RED, BLACK, GLASS = (255, 0, 0, 255), (0, 0, 0, 255), (0, 18, 171, 51)


def segments_of(d: str):
    return [segment for subpath in subpaths(d) for segment in subpath]


def written(*shapes: Shape, precision: int | None = 2, size: tuple[int, int] = (200, 100)) -> list[ElementTree.Element]:
    """The elements behind the title."""
    text = write_drawing(Drawing(*size, shapes), precision=precision, title="a title", comment="a comment")
    return list(ElementTree.fromstring(text))[1:]


def shape(*outlines, fill=RED, name="shape") -> Shape:
    return Shape(fill, outlines, name)


def path_of(*outlines, **options) -> str:
    return written(shape(*outlines), **options)[0].get("d")


def test_primitives_are_elements_of_their_own():
    found = written(
        shape(Rectangle(0, 0, 200, 100), name="background"),
        shape(Circle(10.004, 20.5, 5.25), fill=(255, 255, 254, 255)),
        shape(Ellipse(50, 40, 10, 5, math.radians(30))),
        shape(Rectangle(100, 10, 40, 20, 2.5), fill=GLASS),
        shape(Rectangle(100.25, 50, 40.5, 20, 0, -math.pi / 6)),
    )
    assert [re.sub("{.*}", "", element.tag) for element in found] == ["rect", "circle", "ellipse", "rect", "rect"]
    assert found[0].attrib == {"id": "background", "width": "200", "height": "100", "fill": "red"} | {"fill": "#f00"}
    assert found[1].attrib == {"id": "shape", "cx": "10", "cy": "20.5", "r": "5.25", "fill": "#fffffe"}
    assert found[2].get("transform") == "rotate(30 50 40)"
    assert (found[3].get("rx"), found[3].get("fill"), found[3].get("fill-opacity")) == ("2.5", "#0012ab", ".2")
    assert found[4].get("transform") == "rotate(-30 120.5 60)"


def test_a_rectangle_without_straight_sides_is_a_circle():
    found = written(shape(Rectangle(10, 20, 40, 40.004, 20, 0.7)))[0]
    assert found.attrib == {"id": "shape", "cx": "30", "cy": "40", "r": "20", "fill": "#f00"}


def test_a_polygon_is_written_as_an_artist_would():
    corners = polygon(np.array([[10.0, 10.0], [50.0, 10.0], [62.5, 30.0], [62.5, 55.5], [10.0, 55.5]]))
    # The slanted side is the longest to write, so closing the path draws it.
    assert path_of(corners) == "M62.5 30v25.5H10V10h40z"
    assert path_of(polygon(np.array([[0.5, 0.25], [1.5, 0.75], [0.0, 99.5]]))) == "M0 99.5.5.25l1 .5z"


def test_mirrored_handles_are_left_out():
    d = path_of(Circle(50, 50, 30).ring())
    assert d == "M80 50c0 16.57-13.43 30-30 30S20 66.57 20 50s13.43-30 30-30 30 13.43 30 30z"
    assert sum(len(numbers) for _, numbers in commands(d)) == 2 + 6 + 3 * 4


def test_holes_run_the_other_way_and_round_ones_are_arcs():
    assert (
        path_of(Circle(50, 50, 40), Circle(50, 50, 10))
        == "M10 50a40 40 0 1 1 80 0 40 40 0 1 1-80 0zm30 0a10 10 0 1 0 20 0 10 10 0 1 0-20 0z"
    )
    square = polygon(np.array([[0.0, 0.0], [0.0, 50.0], [50.0, 50.0], [50.0, 0.0]]))
    hole = polygon(np.array([[20.0, 20.0], [30.0, 20.0], [30.0, 30.0], [20.0, 30.0]]))
    ends = [piece.end for piece in segments_of(path_of(square, hole))]
    areas = [
        sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(r, r[1:] + r[:1], strict=True)) for r in (ends[:4], ends[4:])
    ]
    assert areas[0] > 0 > areas[1]


def letters(count: int, fill=RED, x: float = 0.0) -> list[Shape]:
    """Rings with a round hole, beside each other."""
    corners = np.array([[1.0, 1.0], [9.0, 1.0], [9.0, 9.0], [1.5, 9.5]])
    return [
        Shape(fill, (polygon(corners + np.array([x + 10 * i, 0])), Circle(x + 5 + 10 * i, 5, 2)), f"letter-{i}")
        for i in range(count)
    ]


OTHERS = [shape(Circle(5 + 12 * i, 90, 4), fill=(0, 80 + 40 * i, 0, 255)) for i in range(4)]


def test_four_paths_of_one_fill_are_a_compound_path():
    assert len(written(*OTHERS, *letters(3))) == len(OTHERS) + 3
    found = written(*letters(4), *OTHERS)
    assert [element.get("id") for element in found[: -len(OTHERS)]] == ["letter-0"]
    assert len(written(*letters(4, fill=GLASS))) == 4, "translucent shapes are not one where they overlap"
    read = read_drawing(svg_of(*letters(4))).shapes
    assert [len(one.outlines) for one in read] == [2, 2, 2, 2]
    assert all(isinstance(one.outlines[1], Circle) for one in read)


def test_rounded_boxes_that_are_written_as_paths_join_those_of_their_fill():
    bars = [shape(Rectangle(5 + 24 * i, 30, 10, 40, 5, 0.2 * i)) for i in range(4)]
    plain = shape(Rectangle(105, 30, 10, 40, 0, 0.2))
    assert len(written(*letters(2), *bars, plain, *OTHERS)) == 2 + len(OTHERS)
    assert len(written(*bars, *OTHERS)) == len(bars) + len(OTHERS), "alone they stay boxes"


def test_what_lies_beneath_the_last_of_four_paths_does_not_keep_it_apart():
    first, second, third, _, last = letters(5)
    beneath = shape(Ellipse(45, 8, 2, 3), fill=BLACK)
    assert len(written(first, second, third, beneath, last, *OTHERS)) == 2 + len(OTHERS)


def test_a_hole_that_rounding_turned_round_is_still_a_hole():
    body = '<path id="red" fill="#f00" d="M0 0h20v20h-20zM5 5h2v.01zM8 8v8h8v-8z"/>'
    (found,) = read_drawing(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="20" height="20" viewBox="0 0 20 20">{body}</svg>'
    ).shapes
    assert [signed_area(ring) > 0.0 for ring in found.oriented()] == [True, False, False]


def test_in_a_drawing_of_few_fills_each_is_one_path_unless_it_is_primitives_alone():
    dot, bar = shape(Circle(45, 5, 3)), shape(Rectangle(60, 0, 4, 10))
    assert len(written(*letters(1), dot, bar)) == 1
    assert len(written(dot, *letters(2), *OTHERS[:3])) == 1 + 3, "of four fills"
    assert len(written(dot, *letters(2), *OTHERS)) == 3 + 4, "five are too many"
    assert [element.tag.rpartition("}")[2] for element in written(dot, bar)] == ["circle", "rect"]
    drawn = [
        rerender(svg.encode(), 800, 400, renderer="resvg").pixels for svg in (svg_of(dot, *letters(1)), svg_of(dot))
    ]
    assert np.array_equal(drawn[0][:, 160:], drawn[1][:, 160:])


def test_a_ring_that_crosses_itself_cuts_no_hole_into_another_of_its_fill():
    bow = shape(polygon(np.array([[10.0, 10.0], [60.0, 50.0], [60.0, 30.0], [10.0, 60.0]])))
    box = shape(polygon(np.array([[50.0, 28.0], [70.0, 28.0], [70.0, 52.0], [49.0, 52.0]])))
    assert len(written(bow, box, *letters(2))) == 2
    assert len(written(bow, *letters(2))) == 1, "there it lies on none"
    drawn = rerender(svg_of(bow, box).encode(), 200, 100, renderer="resvg").pixels
    assert (drawn[40, 55:60] == [255, 0, 0, 255]).all()


def test_what_lies_between_shapes_keeps_them_apart():
    first, *rest = letters(3)
    apart = shape(Ellipse(5, 80, 5, 3), fill=BLACK)
    assert len(written(first, apart, *rest)) == 2
    within_second = shape(Ellipse(15, 8, 5, 3), fill=BLACK)
    assert len(written(first, within_second, *rest)) == 2, "it shares no pixel with the first"
    over_second = shape(Ellipse(15, 8, 9, 3), fill=BLACK)
    assert len(written(first, over_second, *rest)) == 3
    assert len(written(first, over_second, *rest, *OTHERS)) == 4 + len(OTHERS)
    first, *rest = letters(4)
    assert len(written(first, over_second, *rest, *OTHERS)) == 3 + len(OTHERS), "of four all that can join do"
    orders = ((first, apart, *rest), (first, *rest, apart))
    drawn = [rerender(svg_of(*order).encode(), 800, 400, renderer="resvg").pixels for order in orders]
    assert np.array_equal(*drawn)


def test_dots_join_paths_of_their_fill_since_pixels_do_not_tell_their_form():
    small, large = (shape(Circle(150, 50, radius)) for radius in (0.9, 3))
    assert len(written(*letters(3), small, *OTHERS)) == 1 + len(OTHERS)
    assert len(written(*letters(4), large, *OTHERS)) == 2 + len(OTHERS)


def test_nests_beside_each_other_are_written_together():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    fills = (BLACK, RED, BLACK)
    one, other = (
        [shape(polygon(square * (40 - 16 * k) + [x + 8 * k, 8 * k]), fill=fill) for k, fill in enumerate(fills)]
        for x in (0, 50)
    )
    both = [*one, *other]
    assert len(written(*both)) == 3
    drawn = [rerender(svg_of(*each).encode(), 800, 400, renderer="resvg").pixels for each in (both, one, other)]
    assert np.array_equal(drawn[0], np.where(np.arange(800)[:, None] < 180, drawn[1], drawn[2]))


def test_what_is_smaller_than_a_step_is_left_out():
    tiny = [Circle(5, 5, 0.004), Rectangle(5, 5, 0.004, 9), Ellipse(5, 5, 9, 0.001), polygon(np.full((3, 2), 5.001))]
    assert written(*(shape(outline) for outline in tiny)) == []
    assert path_of(Rectangle(1, 1, 20, 20), Circle(5, 5, 0.001)) == path_of(Rectangle(1, 1, 20, 20).ring())


def test_names_become_unique_identifiers():
    names = ["sky", "sky", "sky-2", "sky", "1 <b>", "", "été"]
    found = written(*(shape(Circle(5, 5, 2), name=name) for name in names))
    identifiers = [element.get("id") for element in found]
    assert identifiers == ["sky", "sky-2", "sky-2-2", "sky-3", "_1-b", "shape", "t"]
    assert len(set(identifiers)) == len(names)


def test_title_and_comment_are_safe():
    text = write_drawing(Drawing(1, 1, ()), title="a <b> & \x00", comment="1 -- 2 --- 3-")
    assert "<!-- 1 - - 2 - - - 3- -->" in text
    assert "<title>a &lt;b&gt; &amp; \ufffd</title>" in text
    ElementTree.fromstring(text)


def test_decimals_follow_the_size():
    assert [suggested_precision(size, 1) for size in (16, 64, 128, 512, 1024, 4096, 100_000)] == [4, 3, 3, 2, 2, 1, 0]
    assert path_of(polygon(np.array([[0, 0], [1, 0], [0.26, 1]])), precision=1) == "M.3 1 0 0h1z"
    with pytest.raises(UsageError):
        write_drawing(Drawing(1, 1, ()), precision=7, title="", comment="")


def smooth_ring(seed: int, joints: int) -> Ring:
    """A wavy ring whose tangents are continuous everywhere."""
    random = np.random.default_rng(seed)
    angles = 2 * np.pi * np.arange(joints) / joints + 0.4 * random.random(joints)
    anchors = 50 + (20 + 25 * random.random((joints, 1))) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    tangents = angles + np.pi / 2 + 0.5 * random.standard_normal(joints)
    unit = np.stack([np.cos(tangents), np.sin(tangents)], axis=1)
    lengths = random.uniform(0.6, 12, (joints, 2, 1))
    after = anchors + lengths[:, 0] * unit
    before = np.roll(anchors - lengths[:, 1] * unit, -1, axis=0)
    ends = np.roll(anchors, -1, axis=0)
    return ring_of_cubics(np.stack([anchors, after, before, ends], axis=1))


@given(st.integers(0, 10_000), st.integers(2, 9), st.integers(1, 3))
def test_the_path_says_what_the_grid_says(seed, joints, precision):
    ring = smooth_ring(seed, joints)
    grid = grid_rings([ring], precision)[0]
    found = segments_of(path_of(ring, precision=precision))[:-1]
    unit = 10.0**-precision
    assert len(found) == grid.pieces
    for piece, control, end in zip(found, grid.controls, np.roll(grid.anchors, -1, axis=0), strict=True):
        assert np.allclose(piece.end, end * unit, atol=1e-9)
        # A mirrored handle may be a step off.
        assert np.abs(np.array(piece.handles) - control * unit).max() < 1.01 * unit


@given(st.integers(0, 10_000), st.integers(2, 9))
def test_rounding_keeps_joints_smooth(seed, joints):
    ring = smooth_ring(seed, joints)
    grid = grid_rings([ring], 2)[0]
    rounded = np.rint(100 * np.stack([np.roll(ring.controls[:, 1], 1, axis=0), ring.controls[:, 0]], axis=1))
    kept = np.stack([np.roll(grid.controls[:, 1], 1, axis=0), grid.controls[:, 0]], axis=1)
    turns = [np.abs(_turn(controls - grid.anchors[:, None])) for controls in (rounded, kept)]
    assert turns[1].max() <= turns[0].max() + 1e-12
    # A place within a step of the handle is at most half a step off the other's line, and costs at most 1 + (6 / 2)^2,
    # so the one that is taken is at most sqrt(10) / 6 of a step off it; handles are 60 steps long at least.
    assert turns[1].max() < math.sqrt(10) / 6 / 58
    assert np.abs(kept - rounded).max() <= 2


def _turn(handles: np.ndarray) -> np.ndarray:
    back, ahead = -handles[:, 0], handles[:, 1]
    cross = back[:, 0] * ahead[:, 1] - back[:, 1] * ahead[:, 0]
    return np.arctan2(cross, (back * ahead).sum(axis=1))


def test_lines_along_the_axes_and_shared_anchors_survive_rounding():
    # The same coordinate up to the noise of float arithmetic, on the border between two steps.
    ring = polygon(np.array([[1.005, 2.0], [9.0, 2.0], [9.0, 7.0], [1.005 + 1e-12, 7.0]]))
    assert len(segments_of(path_of(ring))) == 4
    assert "l" not in path_of(ring).lower()


@pytest.mark.parametrize("renderer", ["resvg", "cairosvg"])
def test_the_file_shows_the_drawing(renderer):
    wavy = smooth_ring(5, 6)
    shapes = (
        shape(Rectangle(0, 0, 200, 100)),
        shape(wavy, Circle(50, 50, 8), fill=GLASS),
        shape(Ellipse(150, 50, 40, 20, 1), fill=BLACK),
    )
    drawing = Drawing(200, 100, shapes)
    text = write_drawing(drawing, title="t", comment="c")
    plain = "".join(
        f'<path fill="rgb{s.fill[:3]}" fill-opacity="{s.fill[3] / 255}" d="'
        + "".join(_plain(ring) for ring in s.oriented())
        + '"/>'
        for s in shapes
    )
    head = '<svg xmlns="http://www.w3.org/2000/svg" width="200" height="100" viewBox="0 0 200 100">'
    drawn, wanted = (
        rerender(data.encode(), 800, 400, renderer=renderer).pixels.astype(int)
        for data in (text, f"{head}{plain}</svg>")
    )
    assert np.abs(drawn - wanted).mean() < 0.05
    assert np.abs(drawn - wanted).max() <= 30


def _plain(ring: Ring) -> str:
    cubics = "".join("C" + " ".join(f"{v:.9f}" for v in cubic[1:].ravel()) for cubic in ring.cubics)
    return "M{:.9f} {:.9f}".format(*ring.anchors[0]) + cubics + "z"


# --- reading back --------------------------------------------------------------------------------------------


def svg_of(*shapes: Shape, precision: int | None = 2) -> str:
    return write_drawing(Drawing(200, 100, shapes), precision=precision, title="a <g> title", comment="c")


def some_shapes() -> tuple[Shape, ...]:
    square = polygon(np.array([[20.0, 20.0], [30.0, 20.0], [30.0, 30.0], [20.0, 30.0]]))
    return (
        shape(Rectangle(0, 0, 200, 100), name="background"),
        shape(smooth_ring(3, 5), Circle(50, 50, 8), square, fill=GLASS, name="b"),
        shape(Circle(10.5, 20.25, 7), name="c"),
        shape(Ellipse(50, 40, 10, 5, math.radians(30)), fill=BLACK, name="d"),
        shape(
            Ellipse(50, 40, 10, 5, math.radians(-20)), Rectangle(48, 38, 4, 4).ring(), fill=(0, 99, 0, 255), name="e"
        ),
        shape(Rectangle(100, 10, 40, 20, 4, math.radians(12.5)), name="f"),
        shape(Rectangle(100, 10, 40, 20, 4), Rectangle(105, 12, 20, 6), fill=(0, 0, 99, 255), name="g"),
    )


def test_what_was_written_is_read_back():
    shapes = some_shapes()
    found = read_drawing(svg_of(*shapes))
    assert (found.width, found.height) == (200, 100)
    assert [(s.fill, s.name) for s in found.shapes] == [(s.fill, s.name) for s in shapes]
    for one, other in zip(found.shapes, shapes, strict=True):
        for ring, wanted in zip(one.oriented(), other.oriented(), strict=True):
            assert ring.pieces == wanted.pieces
            assert sorted(map(tuple, ring.anchors.round(1))) == sorted(map(tuple, wanted.anchors.round(1)))
            assert signed_area(ring) == pytest.approx(signed_area(wanted), rel=2e-3)
            assert ring.smooth.sum() == wanted.smooth.sum()
    assert found.shapes[0].outlines[0] == shapes[0].outlines[0]
    assert found.shapes[2].outlines[0] == shapes[2].outlines[0]
    assert [type(outline) for s in found.shapes for outline in s.outlines][:5] == [
        Rectangle,
        Ring,
        Circle,
        Ring,
        Circle,
    ]


@given(st.integers(0, 10_000), st.integers(1, 9), st.integers(1, 4))
def test_reading_gives_the_numbers_of_the_file(seed, joints, precision):
    text = svg_of(shape(smooth_ring(seed, joints)), precision=precision)
    ring = read_drawing(text).shapes[0].outlines[0]
    found = segments_of(ElementTree.fromstring(text)[1].get("d"))[:-1]
    assert np.array_equal(ring.anchors, [piece.start for piece in found])
    assert np.array_equal(ring.controls, [piece.handles for piece in found])


def test_artwork_is_told_from_curves():
    assert holds_drawing(own_elements(svg_of(*some_shapes())))
    assert holds_drawing(own_elements(svg_of(shape(Rectangle(0, 0, 200, 100)))))
    size = 'width="9" height="9" viewBox="0 0 9 9"'
    assert not holds_drawing(own_elements(f'<svg {size}><title>t</title><rect/><g id="curves"><path/></g></svg>'))


@pytest.mark.parametrize("renderer", ["resvg", "cairosvg"])
def test_the_engine_draws_what_viewers_draw(renderer):
    text = svg_of(*some_shapes())
    scene = read_svg(text)
    assert (scene.curves, scene.mode, scene.background) == (7, Mode.CLOSED, None)
    own = render_scene(scene, coverage="exact", samples=48)
    assert agreement_db(own, rerender(text.encode(), 200, 100, renderer=renderer).pixels) > 42


def test_a_drawing_without_shapes_is_no_scene():
    with pytest.raises(InputError):
        scene_of(Drawing(9, 9, ()))
    assert read_drawing(svg_of()).shapes == ()


HEAD = '<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9" viewBox="0 0 9 9">'


@pytest.mark.parametrize(
    "body",
    [
        '<path d="M0 0h1v1" fill="#fff"/>',
        '<path d="M0 0q1 1 2 2z" fill="#fff"/>',
        '<path d="M0 0a1 1 0 1 1 2 0z" fill="#fff"/>',
        '<path d="M0 0a1 1 0 1 1 2 0 1 1 0 1 1-3 0z" fill="#fff"/>',
        '<path d="M0 0h1e999v1z" fill="#fff"/>',
        '<path d="M0 0h9999999v1z" fill="#fff"/>',
        '<path d="nonsense" fill="#fff"/>',
        '<path d="" fill="#fff"/>',
        '<path d="M0 0h1v1z" fill="white"/>',
        '<path d="M0 0h1v1z" fill="#fff" fill-opacity="2"/>',
        '<path d="M0 0h1v1z" fill="#fff" stroke-width="2"/>',
        '<path d="M0 0h1v1z" fill="#fff" stroke="white"/>',
        '<path d="M0 0h1v1z" fill="#fff" stroke="#000" stroke-width="0"/>',
        '<path d="M0 0h1v1zM3 0h1v1z" fill="#fff" stroke="#000"/>',
        '<circle r="-1" fill="#fff"/>',
        '<circle cx="1" fill="#fff"/>',
        '<rect width="1" height="0" fill="#fff"/>',
        '<rect width="1" height="2" fill="#fff" transform="skewX(3)"/>',
        '<rect width="1" height="nan" fill="#fff"/>',
        '<g><path d="M0 0h1v1z"/></g>',
        '<g id="a"><g opacity=".5"><rect width="1" height="2" fill="#fff"/></g></g>',
        '<g id="a"><polygon points="0 0 1 0 1 1" fill="#fff"/></g>',
        '<image href="file:///etc/passwd"/>',
        "<script/>",
    ],
)
def test_other_drawings_are_refused_with_the_line(body):
    with pytest.raises(InputError, match="not written by cubicsplat or was edited: line 2"):
        read_drawing(f"{HEAD}\n{body}</svg>")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "<svg",
        '<svg width="9"/>',
        HEAD.replace("0 0 9 9", "0 0 9 8") + "</svg>",
        f'<!DOCTYPE svg [<!ENTITY a "b">]>{HEAD}</svg>',
    ],
)
def test_what_is_no_file_of_ours_is_refused(text):
    with pytest.raises(InputError):
        read_drawing(text)


ROUNDED = [
    Rectangle(10, 20, 120, 60, 25),
    Rectangle(10, 20, 120, 60, 30),
    Rectangle(40, 10, 50, 80, 25),
    Rectangle(40, 10, 50.01, 80, 25.005),
    Rectangle(10.01, 20.01, 120, 60.01, 30),
    Rectangle(40.5, 10.25, 90, 70, 8.13, 0.4),
]


@pytest.mark.parametrize("box", ROUNDED)
def test_ends_that_are_half_circles_are_one_arc(box):
    sides = sum(side > 2.0 * box.radius + 0.02 for side in (box.width, box.height))
    assert len(re.findall("[Aa]", path_of(box))) == 2 * sides


@pytest.mark.parametrize("box", ROUNDED)
def test_viewers_agree_about_round_corners(box):
    text = write_drawing(Drawing(200, 100, (shape(box),)), title="t", comment="c")
    exact = render_scene(read_svg(text), coverage="exact", samples=48)
    for renderer in ("cairosvg", "resvg"):
        drawn = rerender(text.encode(), 200, 100, renderer=renderer).pixels
        assert agreement_db(exact, drawn) > 45.0


@pytest.mark.parametrize(
    "outlines", [*((box,) for box in ROUNDED), *((Rectangle(2, 2, 196, 96, 9), b) for b in ROUNDED[:-1])]
)
def test_rounded_rectangles_are_read_back(outlines):
    text = write_drawing(Drawing(200, 100, (shape(*outlines),)), title="t", comment="c")
    (found,) = read_drawing(text).shapes
    assert write_drawing(Drawing(200, 100, (found,)), title="t", comment="c") == text
    assert all(isinstance(outline, Rectangle) and outline.radius > 0.0 for outline in found.outlines)


def test_only_rounded_rectangles_among_paths_are_turned():
    text = write_drawing(Drawing(200, 100, (shape(ROUNDED[-1]),)), title="t", comment="c")
    with pytest.raises(InputError, match="transform of a path other than a rounded rectangle"):
        read_drawing(re.sub(' d="[^"]*"', ' d="M9 9h9v9z"', text))


def test_small_round_corners_stay_a_rect():
    assert [e.tag.rpartition("}")[2] for e in written(shape(Rectangle(5, 5, 20, 9, 3)))] == ["rect"]


def test_a_radius_that_rounds_to_nothing_leaves_a_rectangle():
    text = write_drawing(
        Drawing(200, 100, (shape(Rectangle(2, 2, 196, 96, 9), Rectangle(10, 10, 20, 30, 1e-3)),)),
        title="t",
        comment="c",
    )
    hole = read_drawing(text).shapes[0].outlines[1].ring()
    assert hole.lines.all() and sorted(map(tuple, hole.anchors)) == [(10, 10), (10, 40), (30, 10), (30, 40)]
