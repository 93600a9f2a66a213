"""Pen strokes: widths, centre lines, caps and joins found in pictures, written, and read back."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from conftest import rest_slow
from PIL import Image
from red_rings import dense
from scipy.spatial import cKDTree
from stroke_icons import ICONS, SIZE, Pen, line_of, picture_of, sampled_picture_of, svg_of

from cubicsplat_cli import vectorize
from cubicsplat_cli.artwork.finish.parameters import Constraints
from cubicsplat_cli.artwork.finish.state import goal_of
from cubicsplat_cli.artwork.geometry.outlines import Circle, Rectangle, points_at, polygon
from cubicsplat_cli.artwork.geometry.stroke import Chain, Stroke, line_chain, outlines_of_stroke, pieces_of
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing, Shape, scaled_drawing
from cubicsplat_cli.artwork.strokes import parameters as strokes
from cubicsplat_cli.artwork.strokes.centre_line import with_corners
from cubicsplat_cli.artwork.strokes.find import as_strokes
from cubicsplat_cli.artwork.strokes.parameters import StrokeParameters, fitted_strokes
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.raster.strokes import evenly_wide
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings
from cubicsplat_cli.svg.drawing_reader import read_drawing
from cubicsplat_cli.svg.drawing_writer import write_drawing
from cubicsplat_cli.svg.scene_reader import read_svg

FILL = (26, 43, 109, 255)


def strokes_in(picture: np.ndarray) -> list[Stroke]:
    drawing = draw(picture.astype(np.float32) / 255.0, ArtworkSettings(strokes=True))
    return [shape.stroke for shape in drawing.shapes if shape.stroke is not None]


def points_on(stroke: Stroke) -> np.ndarray:
    cubics, _ = pieces_of(stroke.path)
    return np.concatenate([points_at(cubic[None], np.linspace(0.0, 1.0, 2000)[None])[0] for cubic in cubics])


@pytest.mark.parametrize(
    ("name", "sampled"),
    rest_slow(("letter s", True), *product(sorted(ICONS), (False, True))),
)
def test_widths_and_centre_lines_of_icons(name, sampled):
    pens = ICONS[name]
    found = strokes_in(sampled_picture_of(pens) if sampled else picture_of(pens))
    assert len(found) == len(pens)
    widths = sorted(stroke.width for stroke in found)
    assert widths == pytest.approx(sorted(pen.width for pen in pens), abs=0.02)
    # A corner of a degree or two is drawn smoothly, and an end beneath another stroke lies anywhere near.
    lines = np.concatenate([line_of(pen) for pen in pens])
    off = cKDTree(lines).query(np.concatenate([points_on(stroke) for stroke in found]))[0]
    # Samples tell an edge to the standard deviation of a uniform error of a quarter pixel.
    assert np.percentile(off, 95) < (0.25 / math.sqrt(12.0) if sampled else 0.06) and off.max() < 0.2
    missed = cKDTree(np.concatenate([points_on(stroke) for stroke in found])).query(lines)[0]
    assert missed.max() < 0.35


def over_white(stroke: Stroke) -> Drawing:
    """A stroke of the fill over white."""
    ground = Shape((255, 255, 255, 255), (Rectangle(0.0, 0.0, SIZE, SIZE),), "ground")
    return Drawing(SIZE, SIZE, (ground, Shape(FILL, outlines_of_stroke(stroke), "line", stroke=stroke)))


def test_strokes_of_too_many_pieces_stay_as_they_are_with_a_word(monkeypatch, caplog):
    drawing = over_white(Stroke(line_chain(np.array([[50.6, 130.4], [104.5, 189.2], [210.3, 69.4]])), 13.2))
    monkeypatch.setattr(strokes, "MOST_COMPLETED", 1)
    assert fitted_strokes(drawing, goal_of(np.ones((SIZE, SIZE, 4)))) is drawing
    assert "strokes of 2 pieces are many" in caplog.text


def test_strokes_are_fitted_through_their_pixels():
    pen = Pen("M50 130L105 190L210 70", 14, "round", "round")
    picture = np.concatenate([picture_of([pen]) / 255.0, np.ones((SIZE, SIZE, 1))], axis=2)
    start = Stroke(line_chain(np.array([[50.6, 130.4], [104.5, 189.2], [210.3, 69.4]])), 13.2, "round", "round")
    fitted = fitted_strokes(over_white(start), goal_of(picture)).shapes[1]
    assert fitted.stroke is not None and fitted.stroke.width == pytest.approx(14.0, abs=0.005)
    assert isinstance(fitted.stroke.path, Chain)
    assert fitted.stroke.path.anchors == pytest.approx(np.array([[50, 130], [105, 190], [210, 70]]), abs=0.01)
    assert fitted.outlines[0].ring().cubics == pytest.approx(outlines_of_stroke(fitted.stroke)[0].ring().cubics)


@pytest.mark.parametrize("name", rest_slow("house", "letter s", "infinity", "gear", "circle", fast=2))
def test_outlines_move_with_their_centre_lines_as_the_jacobian_says(name):
    for shape in read_drawing(svg_of(ICONS[name])).shapes:
        if shape.stroke is None:
            continue
        parameters = StrokeParameters.of(shape.stroke, Constraints(SIZE, SIZE))
        told = dense(parameters.jacobian)
        for k, step in enumerate(1e-4 * np.eye(told.shape[1])):
            moved = (parameters.moved(step).cubics - parameters.moved(0.0 * step).cubics).ravel() / 1e-4
            assert np.abs(moved - told[:, k]).max() < 5e-3


@pytest.mark.parametrize(
    ("name", "caps", "joins"),
    rest_slow(
        ("checkmark with sharp ends", "butt", ("miter",)),
        ("checkmark", "round", ("round",)),
        ("round arrow", "round", ("round", "miter")),
        ("triangle", "butt", ("miter",)),
        fast=2,
    ),
)
def test_caps_and_joins(name, caps, joins):
    found = strokes_in(picture_of(ICONS[name]))
    assert {stroke.cap for stroke in found} == {caps} and {stroke.join for stroke in found} <= set(joins)


def test_lines_without_corners_have_the_join_of_the_pen_that_drew_others():
    ways = ("M30 60C60 10 90 110 130 60", "M30 120L60 170L120 110", "M30 220H120")
    found = strokes_in(picture_of([Pen(way, 12, "round", "round") for way in ways]))
    assert len(found) == 3 and {(stroke.cap, stroke.join) for stroke in found} == {("round", "round")}


def test_square_caps_are_butt_caps_of_a_longer_line():
    (found,) = strokes_in(picture_of([Pen("M60 200L128 60L190 200", 14, "square")]))
    assert found.cap == "butt" and isinstance(found.path, Chain)
    ends = np.array([[60.0, 200.0], [190.0, 200.0]])
    out = np.array([[60.0 - 128.0, 200.0 - 60.0], [190.0 - 128.0, 200.0 - 60.0]])
    longer = ends + 7.0 * out / np.hypot(*out.T)[:, None]
    assert np.sort(found.path.anchors[[0, -1]], axis=0) == pytest.approx(np.sort(longer, axis=0), abs=0.1)


@pytest.mark.slow
def test_widths_that_are_alike_become_one():
    found = strokes_in(picture_of(ICONS["grid"]))
    assert len({stroke.width for stroke in found}) == 1


def test_what_no_pen_drew_stays_a_shape():
    wedge = polygon(np.array([[20.0, 20.0], [200.0, 30.0], [60.0, 180.0]]))
    drawing = Drawing(SIZE, SIZE, (Shape(FILL, (wedge,), "wedge"), Shape(FILL, (Circle(200.0, 200.0, 20.0),), "disc")))
    assert as_strokes(drawing, 1.0, 0.0) == [(shape,) for shape in drawing.shapes]


def test_rings_and_bars_are_strokes_as_they_stand():
    ring = Shape(FILL, (Circle(60.0, 60.0, 40.0), Circle(60.0, 60.0, 34.0)), "ring")
    bar = Shape(FILL, (Rectangle(20.0, 150.0, 100.0, 8.0, 4.0),), "bar")
    found = [shape.stroke for (shape,) in as_strokes(Drawing(SIZE, SIZE, (ring, bar)), 1.0, 0.0)]
    assert found[0] is not None and found[0].path == Circle(60.0, 60.0, 37.0) and found[0].width == 6.0
    assert found[1] is not None and found[1].cap == "round"
    assert isinstance(found[1].path, Chain)
    assert found[1].path.anchors == pytest.approx(np.array([[24.0, 154.0], [116.0, 154.0]]))


def shares(text: str) -> np.ndarray:
    """(SIZE, SIZE) how much of each pixel an SVG covers, drawn by an independent renderer four times as large."""
    fine = rerender(text.encode(), 4 * SIZE, 4 * SIZE).pixels[..., 3].astype(float) / 255.0
    return fine.reshape(SIZE, 4, SIZE, 4).mean(axis=(1, 3))


WAVE = "M30 128C80 20 120 240 160 128S220 60 230 150"


# Its hole is smaller than the square that its inner side makes in the corner.
DROP = "M92 108V100C92 95.6 95.6 92 100 92C104.4 92 108 95.6 108 100C108 104.4 104.4 108 100 108z"
LINES = ["M40 200L128 60L200 200", "M128 40L220 210H36z", WAVE, ICONS["infinity"][0].d, "M40 40L200 60L60 62", DROP]
CAPS, JOINS = ["butt", "round", "square"], ["miter", "round", "bevel"]
# Each line with each kind of cap, and with each kind of join.
PAIRS = [(d, CAPS[(i + k) % 3], JOINS[(i + 2 * k) % 3]) for k in range(3) for i, d in enumerate(LINES)]


@pytest.mark.parametrize(("d", "cap", "join"), rest_slow(*PAIRS, *product(LINES, CAPS, JOINS), fast=len(LINES)))
def test_outlines_are_those_that_viewers_draw(d, cap, join):
    text = f'<svg xmlns="http://www.w3.org/2000/svg" width="{SIZE}" height="{SIZE}" viewBox="0 0 {SIZE} {SIZE}"><path '
    text += f'id="a" d="{d}" fill="none" stroke="#000" stroke-width="13" '
    text += f'stroke-linecap="{cap}" stroke-linejoin="{join}"/></svg>'
    (shape,) = read_drawing(text).shapes
    assert shape.stroke is not None
    filled = Drawing(SIZE, SIZE, (replace(shape, stroke=None),))
    off = np.abs(shares(write_drawing(filled, precision=4, title="t", comment="c")) - shares(text))
    assert off.max() < 0.06 and off.sum() < 8.0


def test_a_file_with_strokes_is_read_back():
    found = draw(picture_of(ICONS["house"]).astype(np.float32) / 255.0, ArtworkSettings(strokes=True))
    text = write_drawing(found, title="t", comment="c")
    again = read_drawing(text)
    assert write_drawing(again, title="t", comment="c") == text
    assert [s.stroke is None for s in again.shapes] == [s.stroke is None for s in found.shapes]
    assert read_svg(text).curves == len(found.shapes)


def test_strokes_alike_are_one_path_and_say_only_what_differs_from_the_usual():
    pen = {"width": 4.0, "cap": "butt", "join": "miter"}
    rows = [Stroke(line_chain(np.array([[10.0, y], [90.0, y]])), **pen) for y in (20.0, 40.0, 60.0)]
    shapes = [Shape(FILL, outlines_of_stroke(stroke), "line", stroke=stroke) for stroke in rows]
    dot = Stroke(line_chain(np.array([[50.0, 80.0], [60.0, 90.0]])), 4.0, "round", "round")
    shapes.append(Shape((0, 0, 0, 128), outlines_of_stroke(dot), "dash", stroke=dot))
    text = write_drawing(Drawing(100, 100, tuple(shapes)), precision=1, title="t", comment="c")
    assert '<path id="line" d="M10 20h80M10 40h80M10 60h80" fill="none" stroke="#1a2b6d" stroke-width="4"/>' in text
    assert (
        'stroke="#000" stroke-opacity=".502" stroke-width="4" stroke-linecap="round" stroke-linejoin="round"/>' in text
    )


def test_filled_shapes_of_few_colours_are_one_path_beside_strokes_too():
    stroke = Stroke(line_chain(np.array([[10.0, 90.0], [90.0, 90.0]])), 4.0)
    corners = np.array([[10.0, 10.0], [30.0, 12.0], [20.0, 40.0]])
    shapes = [Shape(FILL, (polygon(corners + np.array([x, 0.0])),), "part") for x in (0.0, 40.0)]
    shapes.append(Shape(FILL, outlines_of_stroke(stroke), "line", stroke=stroke))
    text = write_drawing(Drawing(100, 100, tuple(shapes)), precision=1, title="t", comment="c")
    assert text.count("<path") == 2


def test_a_scaled_stroke_stays_one_where_both_sides_grow_alike():
    stroke = Stroke(line_chain(np.array([[10.0, 10.0], [90.0, 50.0]])), 4.0)
    drawing = Drawing(100, 100, (Shape(FILL, outlines_of_stroke(stroke), "line", stroke=stroke),))
    twice = scaled_drawing(drawing, 200, 200).shapes[0].stroke
    assert twice is not None and twice.width == 8.0
    assert scaled_drawing(drawing, 200, 100).shapes[0].stroke is None


@pytest.mark.parametrize(
    ("attributes", "why"),
    [
        ('d="M0 0L5 5" stroke="#000" stroke-width="0"', "without a width"),
        ('d="M0 0L5 5" stroke="#000" stroke-linecap="flat"', "stroke-linecap 'flat'"),
        ('d="M0 0A5 5 0 0 1 5 5" stroke="#000"', "open path of other than"),
        ('d="M0 0L5 5" stroke="#000" stroke-miterlimit="9"', "unexpected attribute 'stroke-miterlimit'"),
        ('d="M0 0L5 5"', "has the colour"),
    ],
)
def test_strokes_of_others_are_refused(attributes, why):
    text = '<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9" viewBox="0 0 9 9">'
    with pytest.raises(InputError, match=re.escape(why)):
        read_drawing(f'{text}<path id="a" fill="none" {attributes}/></svg>')


# Shapes that no pen draws: a star, a moon, and a letter of thick and thin lines.
FILLED = [
    "M195 20L206 52L240 52L213 72L223 105L195 85L167 105L177 72L150 52L184 52z",
    "M60 190A30 30 0 1 1 60 240A30 24 0 1 0 60 190z",
]
FILLED += ["M140 150H168L205 218V150H215V240H200L155 160V240H140z"]


def with_pens(pens: list[Pen], filled: Sequence[str] = FILLED) -> np.ndarray:
    """A picture (SIZE, SIZE, 3) uint8 of pens beside filled paths."""
    paths = "".join(f'<path d="{d}" fill="#1a2b6d"/>' for d in filled)
    text = svg_of(pens).replace("</svg>", f"{paths}</svg>")
    fine = rerender(text.encode(), 4 * SIZE, 4 * SIZE).pixels[..., :3].astype(float)
    return np.rint(fine.reshape(SIZE, 4, SIZE, 4, 3).mean(axis=(1, 3))).astype(np.uint8)


WAVY = [Pen("M30 60C60 10 90 110 130 60", 10, "round", "round"), Pen("M30 120L60 170L120 110", 12, "round", "round")]


def test_pens_are_strokes_by_themselves_and_filled_shapes_are_none():
    result = vectorize(with_pens(WAVY), threads=1, measure=False)
    assert (result.report.style, result.report.shapes, result.report.strokes) == ("artwork", 6, 2)
    drawing = read_drawing(result.svg)
    assert sorted(round(s.stroke.width, 1) for s in drawing.shapes if s.stroke) == [10.0, 12.0]
    assert drawing.coordinates < read_drawing(vectorize(with_pens(WAVY), strokes=False, threads=1).svg).coordinates


def test_rings_are_strokes_and_bars_share_the_pen_of_others():
    bars = [Pen(f"M{30 + 25 * k} 130V{190 + 10 * k}", 10, "round", "round") for k in range(5)]
    ring = Pen("M165 190A30 30 0 1 1 225 190A30 30 0 1 1 165 190z", 10, "butt", "miter")
    for pens, widths in (
        ([WAVY[0], bars[0], ring], {10.0: 3}),
        ([replace(WAVY[0], width=12), bars[0]], {12.0: 1}),
        ([bars[0], ring], {10.0: 2}),
        ([replace(bars[0], width=12), ring], {10.0: 1}),
        (bars, {10.0: 5}),
    ):
        result = vectorize(with_pens(pens, FILLED[:1]), threads=1, measure=False)
        found = [shape.stroke.width for shape in read_drawing(result.svg).shapes if shape.stroke]
        assert result.report.style == "artwork" and len(set(found)) == len(widths)
        assert Counter(round(width, 1) for width in found) == widths


@pytest.mark.parametrize("without", [{"stacking": "cutout"}, {"curves": 2}])
def test_no_strokes_where_none_are_wanted_or_they_would_be_too_many_shapes(without):
    result = vectorize(picture_of(ICONS["arrow"]), style="artwork", threads=1, measure=False, **without)
    assert result.report.strokes == 0


def test_outlines_of_one_width_are_told_by_the_discs_within_them():
    way = line_chain(np.array([[20.0, 20.0], [90.0, 40.0]]))
    pen = [outline.ring().cubics for outline in outlines_of_stroke(Stroke(way, 8.0, "round"))]
    ring = [Circle(60.0, 60.0, radius).ring().cubics for radius in (40.0, 32.0)]
    moon = [ring[0], Circle(66.0, 60.0, 32.0).ring().cubics]
    wedge = [polygon(np.array([[20.0, 20.0], [200.0, 30.0], [60.0, 180.0]])).cubics]
    turned = [cubics[::-1, ::-1] for cubics in ring]
    widths = evenly_wide([pen, ring, moon, wedge, turned], share=0.05, px=0.2, beside=2.0)
    assert widths == pytest.approx([8.0, 8.0, 0.0, 0.0, 8.0], abs=0.05)
    assert not len(evenly_wide([], share=0.05, px=0.2, beside=2.0))


def test_a_line_that_turns_back_has_no_corner_far_away():
    there = np.stack([np.arange(20.0), np.zeros(20)], axis=1)
    back = np.stack([np.arange(20.0)[::-1], np.full(20, 4.0) - 1e-9 * np.arange(20.0)], axis=1)
    gaps = np.arange(40) == 19
    points, corners = with_corners(np.concatenate([there, back]), gaps, closed=False, width=4.0)
    assert len(points) == 40 and not len(corners)


def test_the_command_draws_strokes(run_cli, tmp_path):
    Image.fromarray(picture_of(ICONS["checkmark"])).save(tmp_path / "check.png")
    run_cli("vectorize", str(tmp_path / "check.png"), "--mode", "open", "--style", "artwork", "--threads", "1")
    text = (tmp_path / "check.svg").read_text()
    assert text.count("<path") == 1 and 'stroke-width="14" stroke-linecap="round" stroke-linejoin="round"' in text
    report = json.loads((tmp_path / "check.json").read_text())
    assert (report["shapes"], report["strokes"]) == (2, 1)
    assert report["quality"]["svg"]["psnr_db"] > 45.0
    run_cli("eval", str(tmp_path / "check.png"), str(tmp_path / "check.svg"))
    run_cli("render", str(tmp_path / "check.svg"), "-o", str(tmp_path / "drawn.png"))


@pytest.mark.slow
def test_the_library_draws_strokes_where_the_picture_is_flat():
    result = vectorize(picture_of(ICONS["triangle"]), mode="open", threads=1, measure=False)
    assert (result.report.style, result.report.strokes, result.report.segments) == ("artwork", 1, 7)


def test_cutouts_have_no_strokes():
    with pytest.raises(UsageError, match="leave out --mode open"):
        Request(artwork=ArtworkSettings(stacking="cutout"), settings=FitSettings.from_preset("standard", "open"))
