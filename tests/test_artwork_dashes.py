"""Dashed strokes: lines cut into dashes, rows of dashes found in pictures, written, and read back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cubicsplat_cli.artwork.geometry.outlines import extent_of, points_at, signed_area
from cubicsplat_cli.artwork.geometry.stroke import Chain, Stroke, dashed, line_chain, outlines_of_stroke
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing, Shape, scaled_drawing
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.svg.drawing_reader import read_drawing
from cubicsplat_cli.svg.drawing_writer import write_drawing
from cubicsplat_cli.svg.initial import load_initial_drawing

ROOT = '<svg xmlns="http://www.w3.org/2000/svg" width="240" height="160" viewBox="0 0 240 160">'
GROUND = '<rect width="240" height="160" fill="#fff"/>'
CURVE = '<path d="M20 120C60 10 150 10 220 130" fill="none" stroke="#d22" stroke-width="5" stroke-dasharray="{}" {}/>'
LENGTHS = st.floats(0.5, 30.0)
POINTS = st.tuples(st.floats(0.0, 100.0), st.floats(0.0, 100.0))


def picture_of(body: str) -> np.ndarray:
    return rerender(f"{ROOT}{GROUND}{body}</svg>".encode(), 240, 160).pixels[..., :3]


def drawing_of(body: str, settings: ArtworkSettings | None = None) -> Drawing:
    return draw(picture_of(body).astype(np.float32) / 255.0, settings)


def dashed_in(drawing: Drawing) -> list[Stroke]:
    return [shape.stroke for shape in drawing.shapes if shape.stroke is not None and shape.stroke.dashes]


def length_of(cubics: np.ndarray) -> float:
    points = points_at(cubics, np.linspace(0.0, 1.0, 400)).reshape(-1, 2)
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


@given(st.lists(POINTS, min_size=2, max_size=6), st.lists(LENGTHS, min_size=2, max_size=4), st.floats(-50.0, 50.0))
def test_dashes_of_lines_are_where_svg_has_them(corners, lengths, offset):
    cubics = line_chain(np.array(corners)).cubics
    whole = sum(np.hypot(*(b - a)) for a, b in zip(cubics[:, 0], cubics[:, 3], strict=True))
    pattern = [*lengths, *lengths][: 2 * len(lengths)] if len(lengths) % 2 else lengths
    parts = dashed(cubics, pattern, offset)
    # By walking along the line in small steps.
    at = (np.arange(20_000) + 0.5) / 20_000 * whole
    place = (at + offset) % sum(pattern)
    on = np.searchsorted(np.cumsum(pattern), place, side="right") % 2 == 0
    assert sum(map(length_of, parts)) == pytest.approx(on.mean() * whole, abs=1e-3 * whole + 0.01)
    seen = np.count_nonzero(np.diff(on.astype(int), prepend=0) == 1)
    # The steps may miss a shorter dash, at an end of the line.
    assert sum(length_of(part) > 1e-4 * whole for part in parts) <= seen <= len(parts) or whole < 1.0


@given(POINTS, POINTS, POINTS, POINTS, LENGTHS, LENGTHS)
def test_dashes_of_a_curve_are_parts_of_it(a, b, c, d, drawn, left_out):
    cubic = np.array([[a, b, c, d]])
    whole, points = length_of(cubic), points_at(cubic, np.linspace(0.0, 1.0, 2000))[0]
    parts = dashed(cubic, (drawn, left_out))
    periods, rest = divmod(whole, drawn + left_out)
    assert sum(map(length_of, parts)) == pytest.approx(periods * drawn + min(rest, drawn), abs=0.02 * whole + 0.01)
    for part in parts:
        seen = points_at(part, np.linspace(0.0, 1.0, 5)).reshape(-1, 2)
        assert np.hypot(*(seen[:, None] - points).transpose(2, 0, 1)).min(axis=1).max() < 0.2


def test_a_dashed_stroke_covers_its_dashes():
    stroke = Stroke(line_chain(np.array([[10.0, 20.0], [110.0, 20.0]])), 4.0, dashes=(12.0, 8.0), offset=5.0)
    outlines = outlines_of_stroke(stroke)
    boxes = [np.array(extent_of([outline.ring()])) for outline in outlines]
    assert [box[:, 0].round(6).tolist() for box in boxes][:2] == [[10.0, 17.0], [25.0, 37.0]]
    assert len(boxes) == 6 and all(box[:, 1].round(6).tolist() == [18.0, 22.0] for box in boxes)
    dots = outlines_of_stroke(replace(stroke, cap="round", dashes=(0.0, 10.0), offset=-5.0))
    assert [abs(signed_area(dot.ring())) for dot in dots] == pytest.approx([4.0 * np.pi] * 10, rel=2e-3)
    with pytest.raises(InputError, match="65535 dashes"):
        outlines_of_stroke(replace(stroke, dashes=(1e-6, 1e-6)))


@pytest.mark.parametrize(
    ("pattern", "more", "cap"),
    [
        ((14.0, 9.0), "", "butt"),
        ((16.0, 6.0, 4.0, 6.0), "", "butt"),
        ((0.0, 11.0), 'stroke-linecap="round"', "round"),
    ],
)
def test_a_row_of_dashes_is_one_stroke_and_reads_back(pattern, more, cap):
    body = CURVE.format(" ".join(map(str, pattern)), more) + '<circle cx="120" cy="110" r="20"/>'
    drawing = drawing_of(body)
    (stroke,) = dashed_in(drawing)
    assert len(drawing.shapes) <= 4  # the ground, the disc, the stroke, and at most what is cut off at its end
    assert stroke.cap == cap and stroke.width == pytest.approx(5.0, abs=0.1)
    start = int(np.argmin(np.abs(np.array(stroke.dashes) - pattern[0]))) // 2 * 2  # the line may run the other way
    assert np.roll(stroke.dashes, -start).tolist() == pytest.approx(pattern, abs=0.15)
    svg = write_drawing(drawing, title="", comment="")
    assert svg.count("stroke-dasharray") == 1
    again = read_drawing(svg)
    (read,) = dashed_in(again)
    assert isinstance(read.path, Chain) and read.cap == cap
    assert read.dashes == pytest.approx(stroke.dashes, abs=1e-4) and read.offset == pytest.approx(
        stroke.offset, abs=1e-4
    )
    assert write_drawing(again, title="", comment="") == svg
    off = np.abs(rerender(svg.encode(), 240, 160).pixels[..., :3] - picture_of(body).astype(float))
    assert off.mean() < 0.3
    twice = dashed_in(scaled_drawing(drawing, 480, 320))[0]
    assert twice.dashes == pytest.approx([2.0 * length for length in stroke.dashes])
    assert twice.offset == pytest.approx(2.0 * stroke.offset)


def test_dashes_hidden_in_part_go_on_beneath():
    line = '<path d="M10 80H230" stroke="#27c" stroke-width="4" stroke-dasharray="10 6"/>'
    drawing = drawing_of(line + '<rect x="92" y="30" width="51" height="100" fill="#fb3"/>')
    (stroke,) = dashed_in(drawing)
    assert [shape.name for shape in drawing.shapes] == ["background", "blue", "orange"]
    assert stroke.dashes == pytest.approx((10.0, 6.0), abs=0.05)
    low, high = stroke.path.anchors.min(axis=0), stroke.path.anchors.max(axis=0)
    assert low[0] == pytest.approx(10.0, abs=2.0) and high[0] == pytest.approx(230.0, abs=6.0)


def bars(*boxes: tuple[int, int, int, int]) -> str:
    return "".join(f'<rect x="{x}" y="{y}" width="{w}" height="{h}" fill="#36a"/>' for x, y, w, h in boxes)


@pytest.mark.parametrize(
    "body",
    [
        bars(*((20 + 14 * k, 40, 5, 60) for k in range(14))),
        bars(*((20 + 30 * k, 20 + 30 * n, 18, 18) for k in range(6) for n in range(4))),
        bars(*((20 + 28 * k, 20 + 14 * n, 20, 6) for k in range(6) for n in range(7))),
        bars(*((10 + 24 * k + 12 * (n % 2), 20 + 12 * n, 20, 8) for k in range(8) for n in range(8))),
        bars(*((x, 80, width, 5) for x, width in ((10, 30), (50, 8), (64, 44), (115, 20), (141, 61), (208, 9)))),
        bars(*((20 + 36 * k, 20 + 30 * n, 18, 18) for k in range(6) for n in range(4))),
        "".join(f'<circle cx="40" cy="{15 + 26 * k}" r="2" fill="#a33"/>' for k in range(6)),
        "".join(f'<circle cx="{40 + 42 * k}" cy="80" r="16" fill="#a33"/>' for k in range(5)),
    ],
    ids=[
        "rungs of a ladder",
        "windows of a house",
        "lines of a text",
        "bricks",
        "words",
        "more windows",
        "bullets of a list",
        "wheels",
    ],
)
def test_what_is_no_row_of_dashes_stays(body):
    drawing = drawing_of(body)
    assert len(drawing.shapes) == 1 + body.count("/>") and not dashed_in(drawing)


def test_dotted_lines_that_cross_run_straight_on():
    lines = '<path d="M12 80H228M120 12V150" stroke="#444" stroke-width="3" stroke-linecap="round" {}/>'
    drawing = drawing_of(lines.format('fill="none" stroke-dasharray="0 6.5"'))
    found = dashed_in(drawing)
    assert len(found) >= 2 and len(drawing.shapes) <= 8
    for stroke in found:
        assert np.ptp(stroke.path.anchors, axis=0).min() < 0.1
    longest = [np.ptp(stroke.path.anchors, axis=0).max() for stroke in found]
    assert sum(longest) > 300.0


def test_parts_of_a_row_are_found_where_it_is_none_as_a_whole():
    dots = [f'<circle cx="{20 + 5 * k}" cy="{80 + 1.5 * (k == 20)}" r="1.2" fill="#333"/>' for k in range(41)]
    drawing = drawing_of("".join(dots))
    assert len(dashed_in(drawing)) == 2 and len(drawing.shapes) < 6


def test_no_strokes_means_no_dashes():
    assert not dashed_in(drawing_of(CURVE.format("14 9", ""), ArtworkSettings(strokes=False)))


@pytest.mark.parametrize("pattern", ["1", "1 -2", "0 0", "1 x", "1 2 3"])
def test_patterns_of_others_are_refused(pattern):
    path = f'<path id="a" fill="none" d="M0 0L5 5" stroke="#000" stroke-dasharray="{pattern}"/>'
    with pytest.raises(InputError, match=r"stroke-dasharray|number"):
        read_drawing(f"{ROOT}{path}</svg>")


@pytest.mark.slow
def test_files_of_too_many_dashes_are_refused():
    path = '<path id="a" fill="none" d="M0 0L90 0" stroke="#000" stroke-dasharray=".002 .001"/>'
    with pytest.raises(InputError, match="is one of more than 65535 dashes"):
        read_drawing(f"{ROOT}{path * 3}</svg>")
    assert len(read_drawing(f"{ROOT}{path}</svg>").shapes[0].outlines) == 30_000


HELD = '<rect width="9" height="9"/>'


@pytest.mark.parametrize(
    ("attributes", "dashes"),
    [
        ('stroke-dasharray="10,5"', 6),
        ('stroke-dasharray="10"', 5),
        ('stroke-dasharray="10% 5%"', 3),
        ('stroke-dasharray="1" pathLength="18"', 9),
        ('stroke-dasharray="10" pathLength="0"', 5),
        ('stroke-dasharray="0 0"', 1),
        ('stroke-dasharray="5 -1"', 1),
        ('stroke-dasharray="5 1000" stroke-dashoffset="20"', 0),
        ('stroke-dasharray="5 1e300" stroke-dashoffset="-20"', 1),
    ],
)
@pytest.mark.filterwarnings("error")
def test_dashes_of_other_programs_are_drawn(attributes, dashes):
    line = f'<path d="M10 50H100" stroke="red" stroke-width="4" {attributes}/>'
    found = load_initial_drawing(f"{ROOT}{HELD}{line}</svg>".encode())
    assert found.scene.curves == 1 + dashes and not found.notes


@pytest.mark.parametrize(
    "attributes",
    [
        'stroke-dasharray="5 x"',
        'stroke-dasharray="5" stroke-dashoffset="1 2"',
        'stroke-dasharray="5" pathLength="x"',
        'stroke-dasharray="5" pathLength="1e-320"',
        'stroke-dasharray="1e308 1e308"',
        'stroke-dasharray="1e-9"',
    ],
)
@pytest.mark.filterwarnings("error")
def test_dashes_that_cannot_be_drawn_are_left_out_and_said(attributes):
    line = f'<path d="M10 50H100" stroke="red" stroke-width="4" {attributes}/>'
    found = load_initial_drawing(f"{ROOT}{HELD}{line}</svg>".encode())
    assert found.scene.curves == 1
    assert found.notes == ("the SVG: left out of the drawing to begin with: 1 path that cannot be read",)


def test_lines_of_too_many_dashes_are_refused():
    line = f'<path d="{"M10 50H100" * 800}" stroke="red" stroke-dasharray="1 0.05"/>'
    with pytest.raises(InputError, match="more than 65535 dashes"):
        load_initial_drawing(f"{ROOT}{HELD}{line}</svg>".encode())


def test_dashes_count_when_paths_are_joined():
    line = line_chain(np.array([[10.0, 20.0], [110.0, 20.0]]))
    steps = [np.array([0.0, 12.0 * n]) for n in range(8)]
    paths = [replace(line, anchors=line.anchors + step, controls=line.controls + step) for step in steps]
    strokes = [Stroke(path, 4.0, dashes=(9.0, 5.0) if n >= 4 else ()) for n, path in enumerate(paths)]
    shapes = [Shape((0, 0, 0, 255), outlines_of_stroke(stroke), "black", stroke=stroke) for stroke in strokes]
    svg = write_drawing(Drawing(120, 120, tuple(shapes)), title="", comment="")
    assert svg.count("<path") == 2 and svg.count('stroke-dasharray="9 5"') == 1
