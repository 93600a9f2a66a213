"""Structure of what is written: groups, layers, overlaps, ground and physical size, read back by others."""

from __future__ import annotations

import itertools
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import rest_slow, smooth_pixels
from PIL import Image, ImageDraw
from scipy.ndimage import distance_transform_edt
from test_artwork_cutout import FILLS, SIZE, Circle, Ellipse, Rectangle, blob, drawing_of, masks, polygon, square

import cubicsplat_cli as cubicsplat
from cubicsplat_cli import UsageError
from cubicsplat_cli.artwork import structure
from cubicsplat_cli.artwork.geometry.stroke import Stroke, line_chain, outlines_of_stroke
from cubicsplat_cli.artwork.planar.cutout import cut_out, overlapping
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.evaluate.rerender import rerender, rerender_untrusted
from cubicsplat_cli.from_options import request_of
from cubicsplat_cli.request import length_text, parse_width
from cubicsplat_cli.svg.drawing_reader import read_drawing
from cubicsplat_cli.svg.drawing_writer import write_drawing
from cubicsplat_cli.svg.scene_reader import read_svg

SVG = "{http://www.w3.org/2000/svg}"
GROUND = Rectangle(0.0, 0.0, SIZE, SIZE)
RED, GREEN, BLUE, YELLOW, BLACK = FILLS
EYES = [
    GROUND, Circle(30, 50, 20), Circle(30, 50, 8), Circle(70, 50, 20), Circle(70, 50, 8), square(40, 5, 9),
    Rectangle(10, 85, 80, 6), blob(50, 88, 4, 5, 3, 4),
]  # fmt: skip
EYE_FILLS = [GREEN, RED, BLACK, RED, BLACK, YELLOW, BLUE, RED]


def pixels(svg: str, renderer: str = "resvg", size: tuple[int, int] = (SIZE, SIZE)) -> np.ndarray:
    """(H, W, 4) premultiplied, as another renderer draws an SVG."""
    drawn = rerender(svg.encode(), *size, renderer=renderer).pixels.astype(float)
    drawn[..., :3] *= drawn[..., 3:] / 255.0
    return drawn


def text(drawing: Drawing) -> str:
    return write_drawing(drawing, precision=2, title="t", comment="c")


def groups_of(svg: str) -> dict[str, list[str]]:
    """The colours of the shapes in each group of an SVG, by its id; those in none by an empty one."""
    root = ElementTree.fromstring(svg)
    found = {group.get("id"): [shape.get("fill") for shape in group] for group in root.findall(f"{SVG}g")}
    return {**found, "": [shape.get("fill") for shape in root if shape.tag not in (f"{SVG}g", f"{SVG}title")]}


def sign(side: int = 64, ground: str = "white") -> Image.Image:
    """A black ring on a ground, whose inside is a red disc with a dot of the ground's colour."""
    large = Image.new("RGB", (8 * side, 8 * side), ground)
    pen, unit = ImageDraw.Draw(large), side / 8
    for colour, reach in (("black", 24), ("#dd2211", 15), (ground, 6)):
        middle, radius = 4 * side, reach * unit
        pen.ellipse([middle - radius, middle - radius, middle + radius, middle + radius], colour)
    return large.resize((side, side), Image.Resampling.BOX)


# ---- Groups


@pytest.mark.parametrize("renderer", ["resvg", "cairosvg"])
def test_groups_by_colour_leave_every_pixel_and_are_as_few_as_the_order_leaves(renderer):
    drawing = drawing_of(*EYES, fills=EYE_FILLS)
    grouped = structure.grouped_by_colour(drawing)
    assert (pixels(text(grouped), renderer) == pixels(text(drawing), renderer)).all()
    assert {name: len(shapes) for name, shapes in groups_of(text(grouped)).items() if name} == {
        "color-008000": 1, "color-ff0000": 2, "color-141414": 2, "color-ffc800": 1, "color-0000ff": 1,
        "color-ff0000-2": 1,
    }  # fmt: skip
    assert [shape.fill for shape in read_drawing(text(grouped)).shapes] == [shape.fill for shape in grouped.shapes]
    assert read_svg(text(grouped)).curves == len(EYES)


def test_a_shape_never_goes_back_across_one_that_it_touches():
    # Red, blue and red again, each on the one before: no order but this one draws them.
    steps = [square(10 + 15 * i, 10 + 15 * i, 30) for i in range(4)]
    drawing = drawing_of(GROUND, *steps, fills=[GREEN, RED, BLUE, RED, BLUE])
    grouped = structure.grouped_by_colour(drawing)
    assert (pixels(text(grouped)) == pixels(text(drawing))).all()
    assert list(groups_of(text(grouped)))[1:-1] == ["color-ff0000", "color-0000ff", "color-ff0000-2", "color-0000ff-2"]


def test_random_drawings_in_groups_are_the_same_picture():
    for seed in range(6):
        random = np.random.default_rng(seed)
        shapes = [Circle(*random.uniform(5, 95, 2), random.uniform(2, 20)) for _ in range(25)]
        drawing = drawing_of(GROUND, *shapes, fills=[FILLS[i] for i in random.integers(0, 5, 26)])
        for grouped in (
            structure.grouped_by_colour(drawing),
            structure.grouped_by_object(drawing, drawing.shapes[0].fill),
        ):
            assert (pixels(text(grouped)) == pixels(text(drawing))).all()
            assert sorted(shape.name for shape in grouped.shapes) == sorted(shape.name for shape in drawing.shapes)


def test_strokes_and_fills_of_a_colour_are_in_one_group():
    lines = [Stroke(line_chain(np.array([[10.0, y], [90.0, y + 5.0]])), 4.0) for y in (10.0, 60.0)]
    strokes = [Shape(RED, outlines_of_stroke(line), f"line {i}", stroke=line) for i, line in enumerate(lines)]
    fills = drawing_of(GROUND, Circle(50, 35, 8), Circle(30, 85, 8), fills=[GREEN, BLUE, RED]).shapes
    drawing = Drawing(SIZE, SIZE, (fills[0], strokes[0], fills[1], strokes[1], fills[2]))
    grouped = structure.grouped_by_colour(drawing)
    assert (pixels(text(grouped)) == pixels(text(drawing))).all()
    assert [name for name in groups_of(text(grouped)) if name] == ["color-008000", "color-ff0000", "color-0000ff"]


def test_a_cutout_has_one_group_a_colour():
    cut = cut_out(drawing_of(*EYES, fills=EYE_FILLS), 2)
    names = [name for name in groups_of(text(structure.grouped_by_colour(cut))) if name]
    assert sorted(names) == sorted({structure.colour_group(shape.fill) for shape in cut.shapes})


@pytest.mark.parametrize("cut", [False, True])
def test_objects_are_shapes_with_what_lies_on_them(cut):
    drawing = drawing_of(*EYES, fills=EYE_FILLS)
    grouped = structure.grouped_by_object(drawing, GREEN)
    assert (pixels(text(grouped)) == pixels(text(drawing))).all()
    grouped = cut_out(grouped, 2) if cut else grouped
    names = {shape.name: shape.group for shape in grouped.shapes}
    assert names["shape 1"] == names["shape 2"] != names["shape 3"] == names["shape 4"] != ""
    assert names["shape 6"] == names["shape 7"] not in ("", names["shape 1"], names["shape 3"])
    assert names["shape 0"] == names["shape 5"] == "", "the ground, and what is alone"
    runs = [name for name, _ in itertools.groupby(shape.group for shape in grouped.shapes) if name]
    assert len(runs) == len(set(runs)) == 3


# ---- Overlaps


OVERLAPS = {
    "discs": [GROUND, Circle(40, 50, 25), Circle(62, 52, 22), Ellipse(50, 50, 40, 8, 0.5)],
    "bars": [GROUND, Rectangle(-5, 40, 120, 20), Rectangle(40, -5, 20, 120), square(42, 42, 16)],
    "no ground": [Circle(40, 50, 25), Circle(62, 52, 22), (Circle(50, 50, 12), Circle(50, 50, 2))],
    "corners": [GROUND, polygon(np.array([[5, 5], [60, 20], [20, 60]])), blob(60, 60, 30, 12, 30, 12, 30, 12)],
}


def grown(drawing: Drawing, reach: float) -> tuple[Drawing, Drawing]:
    cut = structure.by_lightness(cut_out(drawing, 2))
    return cut, overlapping(cut, reach, 2)


@pytest.mark.parametrize("name", OVERLAPS)
@pytest.mark.parametrize("reach", rest_slow(3.0, 0.5))
def test_shapes_reach_so_far_beneath_those_drawn_later_and_nowhere_else(name, reach):
    cut, lapped = grown(drawing_of(*OVERLAPS[name]), reach)
    by_paint = {}
    for drawing in (cut, lapped):
        shares = masks(drawing)
        paints = [shape.fill for shape in drawing.shapes]
        order = list(dict.fromkeys(paints))
        by_paint[drawing is cut] = {fill: shares[[p == fill for p in paints]].max(axis=0) for fill in order}
        assert paints == sorted(paints, key=order.index)
    own, wide = by_paint[True], by_paint[False]
    assert list(own) == list(wide), "the lightest first"
    for number, fill in enumerate(own):
        later = sum(itertools.islice(own.values(), number + 1, None), np.zeros((SIZE, SIZE)))
        distance = distance_transform_edt(own[fill] < 0.999)
        assert (wide[fill] >= own[fill] - 0.03).all(), "all that shows is still covered"
        assert (wide[fill][later < 1e-3] <= own[fill][later < 1e-3] + 0.03).all(), (
            "what is drawn earlier, or nothing, is free"
        )
        assert (wide[fill][(later > 0.999) & (distance < reach)] > 0.9).all(), "nothing of the reach is left out"
        # A mitre reaches farther at a corner, four times at most.
        outside = distance_transform_edt(own[fill] < 1e-3)
        assert (wide[fill][(later > 0.999) & (outside > 4.0 * reach + 1.5)] < 1e-3).all()


@pytest.mark.parametrize("renderer", ["resvg", "cairosvg"])
def test_an_overlap_closes_the_seams_that_renderers_leave(renderer):
    drawing = drawing_of(*OVERLAPS["corners"], fills=[YELLOW, RED, BLUE])
    stacked, (cut, lapped) = pixels(text(drawing), renderer), grown(drawing, 1.5)
    before, after = (np.abs(pixels(text(each), renderer) - stacked)[..., 3].max() for each in (cut, lapped))
    assert before > 40.0
    assert after <= 2.0


def test_a_gap_filler_is_an_overlap_of_one_px():
    assert request_of({"gap_filler": True}).overlap == 1.0
    assert request_of({"gap_filler": True, "overlap": 2.0}).overlap == 2.0
    assert request_of({"gap_filler": True}).artwork.stacking == "cutout"


def test_circles_and_rectangles_stay_such_when_they_grow():
    lapped = grown(drawing_of(GROUND, Circle(50, 50, 30), Rectangle(40, 40, 20, 20), fills=[BLACK, YELLOW, RED]), 2.0)[
        1
    ]
    found = {(type(outline), shape.fill) for shape in lapped.shapes for outline in shape.outlines}
    assert found == {(Circle, YELLOW), (Rectangle, YELLOW), (Rectangle, RED), (Rectangle, BLACK), (Circle, BLACK)}
    (disc,) = [shape for shape in lapped.shapes if shape.fill == YELLOW]
    assert [outline.r for outline in disc.outlines if isinstance(outline, Circle)] == [32.0]
    assert [outline.width for outline in disc.outlines if isinstance(outline, Rectangle)] == [16.0]


# ---- The ground


@pytest.mark.parametrize(
    ("ground", "stacking", "corner", "dot"),
    [
        ("remove", "stacked", (0, 0, 0, 0), (255, 255, 255, 255)),
        ("remove", "cutout", (0, 0, 0, 0), (0, 0, 0, 0)),
        ("teal", "stacked", (0, 128, 128, 255), (255, 255, 255, 255)),
        ("#008080", "cutout", (0, 128, 128, 255), (0, 128, 128, 255)),
        ("keep", "cutout", (255, 255, 255, 255), (255, 255, 255, 255)),
    ],
)
def test_grounds(ground, stacking, corner, dot):
    result = cubicsplat.vectorize(sign(), stacking=stacking, ground=ground, threads=1, measure=False)
    drawn = rerender(result.svg.encode(), 64, 64, renderer="resvg").pixels
    assert (tuple(drawn[3, 3]), tuple(drawn[32, 32]), tuple(drawn[32, 12])) == (corner, dot, (0, 0, 0, 255))


def test_what_has_no_ground_gets_one_or_a_note():
    alone = Image.fromarray(smooth_pixels(32, 32, alpha=True) // 255 * 255)
    removed = cubicsplat.vectorize(alone, ground="remove", threads=1)
    assert "there is no ground to remove: nothing fills the picture behind all else" in removed.report.notes
    painted = cubicsplat.vectorize(alone, ground="#123456", stacking="cutout", threads=1)
    assert tuple(rerender(painted.svg.encode(), 32, 32, renderer="resvg").pixels[1, 1]) == (0x12, 0x34, 0x56, 255)
    assert not [note for note in painted.report.notes if "far from" in note]


def test_a_picture_of_one_colour_is_its_ground():
    plain = Image.new("RGB", (8, 8), "#336699")
    assert "<rect" not in cubicsplat.vectorize(plain, ground="remove", threads=1, measure=False).svg
    assert '<g id="color-112233">' in cubicsplat.vectorize(plain, ground="#123", group_by="color", threads=1).svg


def sprite() -> Image.Image:
    """Pixel art of cells of 4 px: a face on a ground, with eyes of the ground's colour."""
    random = np.random.default_rng(5)
    cells = np.full((16, 16, 3), (240, 240, 240), np.uint8)
    cells[3:13, 3:13] = np.array([(200, 30, 30), (30, 30, 160), (30, 160, 30)])[random.integers(0, 3, (10, 10))]
    cells[6, 6] = cells[6, 9] = (240, 240, 240)
    return Image.fromarray(cells.repeat(4, axis=0).repeat(4, axis=1))


def test_pixel_art_has_a_group_a_colour_overlaps_and_holes_for_its_ground():
    given = np.asarray(sprite())
    drawn = {}
    for name, options in {
        "plain": {}, "grouped": {"group_by": "color"}, "lapped": {"overlap": 1.0}, "removed": {"ground": "remove"},
    }.items():  # fmt: skip
        result = cubicsplat.vectorize(sprite(), stacking="cutout", threads=1, measure=False, **options)
        assert result.report.style == "artwork" and "drawn as the 16 x 16" in result.report.notes[0]
        drawn[name] = result.svg, rerender(result.svg.encode(), 64, 64, renderer="resvg").pixels
    for name in ("plain", "grouped", "lapped"):
        assert (drawn[name][1][..., :3] == given).all(), name
    assert len(groups_of(drawn["grouped"][0])) == 5
    assert read_svg(drawn["grouped"][0]).curves == read_svg(drawn["plain"][0]).curves
    assert sum(masks(read_drawing(drawn["lapped"][0]))).max() > 1.9, "one lies beneath another"
    assert (drawn["removed"][1][..., 3] == np.where((given == 240).all(axis=-1), 0, 255)).all()


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"width": "80mm"}, ("80mm", "60mm")),
        ({"width": 3.2, "units": "in"}, ("3.2in", "2.4in")),
        ({"width": "400"}, ("400", "300")),
        ({"width": " 12.5 PX"}, ("12.5", "9.375")),
        ({"units": "mm"}, ("10.58333mm", "7.9375mm")),
        ({"units": "in"}, ("0.41667in", "0.3125in")),
        ({}, ("40", "30")),
    ],
)
def test_sizes(options, expected):
    assert request_of(options).size_text(40, 30) == expected
    assert length_text(2.0, "px") == "2" and parse_width(80) == "80"


@pytest.mark.parametrize("style", ["photo", "artwork"])
def test_a_physical_size_leaves_the_picture_and_is_that_of_pages_and_cutters(style, tmp_path):
    picture = Image.fromarray(smooth_pixels(40, 30)) if style == "photo" else sign(40).crop((0, 5, 40, 35))
    options = {"style": style, "threads": 1, **({"curves": 6, "steps": 20} if style == "photo" else {})}
    plain = cubicsplat.vectorize(picture, **options)
    sized = cubicsplat.vectorize(picture, width="80mm", **options)
    assert (
        re.search(r'width="80mm"', sized.svg)
        and re.search(r'height="60mm"', sized.svg)
        and 'viewBox="0 0 40 30"' in sized.svg
    )
    assert sized.report.quality == plain.report.quality
    assert (read_svg(sized.svg).points == read_svg(plain.svg).points).all()
    assert rerender_untrusted(sized.svg.encode(), source="x", renderer="resvg")[0].pixels.shape[:2] == (227, 302)
    sized.save(tmp_path / "a.pdf")
    (box,) = re.findall(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+)", (tmp_path / "a.pdf").read_bytes())
    assert [float(side) for side in box] == pytest.approx([80 / 25.4 * 72, 60 / 25.4 * 72], abs=0.01)
    if style == "artwork":
        ezdxf = pytest.importorskip("ezdxf")
        sized.save(tmp_path / "a.dxf")
        file = ezdxf.readfile(tmp_path / "a.dxf")
        reach = max(x for outline in file.modelspace() for x, _ in outline.get_points("xy"))
        assert (reach, file.units) == (pytest.approx(80.0, abs=0.01), ezdxf.units.MM)


def test_a_report_page_shows_what_is_grouped_and_sized(tmp_path, run_cli):
    sign(24).save(tmp_path / "a.png")
    run_cli("vectorize", tmp_path / "a.png", "--group-by", "color", "--width", "30mm", "--report", "--threads", 1)
    page = (tmp_path / "a.html").read_text()
    assert "--group-by color --width 30mm" in page and page.count('<g id="color-') == 4
    assert re.search(r'"losses": ?\[[-\d]', page)


# ---- Requests


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"group_by": "colour"}, "group_by must be none, color or object, not 'colour'"),
        ({"group_by": "color", "style": "photo"}, "group_by is for artwork, not for photos"),
        ({"ground": "remove", "style": "photo"}, "ground is for artwork, not for photos"),
        ({"overlap": 1.0, "fill": "linear"}, "overlap is for artwork, --fill for photos"),
        ({"overlap": 0.01}, "overlap must be a number from 0.1 to 1000, not 0.01"),
        ({"overlap": 1.0, "strokes": True}, "overlap is of cutouts, which have shapes only; leave out --strokes"),
        ({"gap_filler": True, "strokes": True}, "gap_filler is of cutouts, which have shapes only; leave out"),
        ({"gap_filler": True, "group_by": "object"}, "gap_filler is drawn colour by colour; leave out --group-by"),
        ({"layers": "x", "mode": "open"}, "layers is of cutouts, which have shapes only; leave out --mode open"),
        ({"layers": "x", "group_by": "object"}, "layers has a file for each colour; leave out --group-by object"),
        ({"overlap": 1.0, "group_by": "object"}, "overlap is drawn colour by colour; leave out --group-by object"),
        ({"group_by": "object", "style": "pixel"}, "group_by object is of shapes, but pixel art has one path a colour"),
        ({"ground": "whit"}, "ground must be keep, remove, a colour name or #rrggbb, not 'whit'; did you mean white?"),
        ({"width": "80cm"}, "width must be a length such as 80mm, 3in or 400px, of at most a million px, not '80cm'"),
        ({"width": "-3mm"}, "width must be a length"),
        ({"width": "0"}, "width must be a length"),
        ({"width": "80mm", "units": "in"}, "width 80mm says its own unit; leave out --units in"),
        ({"width": "80px", "units": "mm"}, "width 80px says its own unit; leave out --units mm"),
        ({"units": "cm"}, "units must be px, mm or in, not 'cm'"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_one_clear_line(options, said):
    with pytest.raises(UsageError, match=re.escape(said)):
        request_of(options)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-o", "-", "--layers", "x"], "--layers needs an SVG of which they are made"),
        (["--layers", __file__], "is a file; give a folder"),
        (["--ground", "whit"], "--ground must be keep, remove"),
        (["--width", "far"], "--width must be a length such as 80mm"),
        (["--layers", "x", "--style", "photo"], "--layers is for artwork, not for photos"),
    ],
)
def test_the_command_says_so_before_the_work(arguments, said, photo, run_cli):
    run_cli("vectorize", photo, *arguments, code=2, error=said)


def test_every_option_that_changes_the_file_is_in_its_fingerprint():
    usual = request_of({"style": "artwork"}).digest()
    changed = [
        {"group_by": "color"}, {"group_by": "object"}, {"overlap": 1.0}, {"overlap": 2.0}, {"ground": "remove"},
        {"ground": "red"}, {"units": "mm"}, {"width": "80mm"}, {"width": "80in"}, {"stacking": "cutout"},
    ]  # fmt: skip
    digests = [request_of({"style": "artwork", **options}).digest() for options in changed]
    assert len({usual, *digests}) == len(changed) + 1
    assert request_of({"style": "artwork", "layers": "x"}).digest() == digests[-1], "of a cutout without a new drawing"
    assert request_of({"ground": "RED"}).digest() == request_of({"ground": "#f00"}).digest()
