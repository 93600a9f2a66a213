"""`benchmarks.artwork`: each score against a case of known answer, and the command with a tool of known quality."""

from __future__ import annotations

import csv
import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from test_svg_drawing import segments_of

from benchmarks import tools
from benchmarks.artwork.contact_sheet import wireframe
from benchmarks.artwork.degradations import CLEAN, DEGRADATIONS, OPAQUE, degraded, with_background
from benchmarks.artwork.document import Document
from benchmarks.artwork.outlines import forms_of
from benchmarks.artwork.pieces import DrawingPieces, completed, pieces_of, visible_error
from benchmarks.artwork.pixels import MOST_DB, edge_displacement, exact_colours, leak_areas, opaque_inside, psnr
from benchmarks.artwork.primitives import primitive_counts
from benchmarks.artwork.scores import Truth, count, count_numbers, minified
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.perceptual import mean_delta_e


def svg(body: str, width: int = 64, height: int = 48, root: str = "") -> bytes:
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" {root}>'
    return f"{head}{body}</svg>".encode()


def document(body: str, **size: int) -> Document:
    return Document(svg(body, **size), "test.svg", 64)


BOX = '<rect x="8" y="8" width="40" height="30" fill="#c00"/>'


# --- documents ----------------------------------------------------------------------------------------------


def test_a_document_is_drawn_at_any_scale_and_in_parts():
    found = document(BOX)
    whole = found.draw(4)
    assert whole.shape == (192, 256, 4)
    assert (whole[100, 100] == (204, 0, 0, 255)).all()
    assert np.array_equal(found.draw(4, window=(5, 6, 20, 10)), whole[24:64, 20:100])


def test_the_canvas_loses_the_fraction_of_a_pixel():
    found = Document(svg("", 256, 295), "x", 512)
    assert (found.width, found.height) == (444, 512)
    assert Document(b'<svg xmlns="http://www.w3.org/2000/svg" width="30" height="20"/>', "x").unit == 1.0


def test_without_smoothing_every_pixel_is_on_or_off():
    slanted = document('<path d="M0 0L64 11V48H0z"/>')
    assert set(np.unique(slanted.draw(smooth=False)[..., 3])) == {0, 255}
    assert len(np.unique(slanted.draw()[..., 3])) > 4


# --- path data and counts -----------------------------------------------------------------------------------


def test_path_data_is_made_absolute():
    found = segments_of("m1 2h3v-1l1 1c1 0 2 1 2 2s1 3 2 2q1 1 2 0t2 0a2 3 0 012 4z")
    assert "".join(piece.command for piece in found) == "HVLCSQTAZ"
    assert [piece.end for piece in found] == [
        (4, 2),
        (4, 1),
        (5, 2),
        (7, 4),
        (9, 6),
        (11, 6),
        (13, 6),
        (15, 10),
        (1, 2),
    ]
    assert found[4].handles == ((7, 5), (8, 7))
    assert found[6].handles == ((12, 5),)
    assert (
        count_numbers("m1 2h3v-1l1 1c1 0 2 1 2 2s1 3 2 2q1 1 2 0t2 0a2 3 0 012 4z") == 2 + 1 + 1 + 2 + 6 + 4 + 4 + 2 + 5
    )
    assert count_numbers("M1-2.5.5 3") == 4
    for wrong in ("1 2", "M1", "M1 2C3 4", "M0 0z1", "M0 0 x", "M0 0a5 5 0 1 0 10z", "h3", "M0 0c" + "1 " * 7):
        with pytest.raises(InputError):
            segments_of(wrong)


def test_shapes_coordinates_and_primitives():
    body = (
        '<defs><circle id="a" r="3"/></defs><g fill="none"><path d="M0 0h1"/><path stroke="red" d="M0 0h1"/></g>'
        '<rect width="3" height="3" rx="1"/><ellipse rx="3" ry="2"/><use href="#a" x="1" y="2"/><use href="#a"/>'
        '<path style="fill:none" d="M0 0"/><clipPath><rect/></clipPath>'
    )
    found = count(document(body))
    assert (found.shapes, found.primitives) == (5, 4)
    assert found.coordinates == 3 + 3 + 3 + 5 + 4 + 2 + 2 + 2 + 4


def test_minified_keeps_what_is_seen():
    body = '<title>t</title><!-- c -->\n <g id="x"><path id="y" d="M0 0z"/></g>\n<use href="#y"/>'
    assert minified(document(body).root) == svg('<g><path id="y" d="M0 0z"/></g><use href="#y"/>').replace(b" >", b">")


# --- figures -------------------------------------------------------------------------------------------------


def test_equal_pictures_have_no_difference_and_the_worse_ground_counts():
    clear = np.zeros((8, 8, 4), np.uint8)
    white = np.full((8, 8, 4), 255, np.uint8)
    assert (psnr(white, white), mean_delta_e(white, white)) == (MOST_DB, 0.0)
    assert psnr(clear, white) == 0.0
    assert mean_delta_e(clear, white) == pytest.approx(100.0, abs=1e-3)


def test_delta_e_is_that_of_every_pixel():
    from skimage.color import deltaE_ciede2000, rgb2lab

    random = np.random.default_rng(3)
    first, second = (np.dstack([random.integers(0, 256, (20, 30, 3)), np.full((20, 30), 255)]) for _ in range(2))
    first, second = first.astype(np.uint8), second.astype(np.uint8)
    first[:9] = second[:9]
    expected = deltaE_ciede2000(rgb2lab(first[..., :3]), rgb2lab(second[..., :3])).mean()
    assert mean_delta_e(first, second) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("shift", [0.05, 0.25, 0.6])
def test_edge_displacement_of_a_shifted_disc(shift):
    disc = '<circle cx="{}" cy="24" r="15" fill="#{}"/>'
    truth, moved = (document(disc.format(x, "222")).draw(2) for x in (30, 30 + shift))
    # The mean of |cos| around a circle.
    assert edge_displacement(truth, moved, 2) == pytest.approx(shift * 2 / np.pi, rel=0.12)
    assert edge_displacement(truth, truth, 2) == 0.0
    blank = document("").draw(2)
    assert edge_displacement(blank, blank, 2) is None


def test_fill_colours_are_exact_or_not():
    truth = document(BOX).draw(2)
    assert exact_colours(truth, truth) == 1.0
    assert exact_colours(truth, document(BOX.replace("#c00", "#cc0001")).draw(2)) == 0.0
    assert exact_colours(document("").draw(2), truth) is None


def leaks(body: str, truth: str) -> tuple[float, ...]:
    made = document(body)
    return leak_areas(made, opaque_inside(document(truth)), {scale: made.draw(scale) for scale in (1, 4)})


def test_leaks_are_gaps_and_hairlines_and_nothing_else():
    truth = '<rect width="64" height="48" fill="#08f"/>'
    assert leaks(truth, truth) == (0.0, 0.0, 0.0)
    # A gap of half a px, 60 px of it inside, is as large at every scale.
    gap = '<rect width="64" height="20" fill="#08f"/><rect y="20.5" width="64" height="28" fill="#08f"/>'
    assert leaks(gap, truth) == pytest.approx((30.0, 30.0, 30.0), rel=0.02)
    # Neighbours that only touch on a slanted line: the ground shows through both smoothed edges, the less the larger.
    touching = '<path d="M0 0H20L29 48H0z" fill="#08f"/><path d="M20 0H64V48H29z" fill="#08f"/>'
    found = leaks(touching, truth)
    assert found[0] > found[1] > found[2] > 0
    # What lies under both closes it.
    assert leaks(truth + touching, truth) == (0.0, 0.0, 0.0)
    # A disc that touches the canvas from within, and an outline that is a px off, are no leaks.
    disc = '<circle cx="24" cy="24" r="{}" fill="#08f"/>'
    assert leaks(disc.format(23.9), disc.format(24)) == (0.0, 0.0, 0.0)
    assert leaks(BOX.replace('x="8"', 'x="9"'), BOX) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("body", "kinds"),
    [
        (
            '<circle cx="20" cy="20" r="9"/><ellipse cx="20" cy="20" rx="9" ry="5" transform="rotate(30)"/>',
            "round round",
        ),
        ('<path d="M29 20a9 9 0 1 0-18 0 9 9 0 0 0 18 0z"/>', "round"),
        ('<g transform="translate(9 3)scale(.5)"><path d="M10 10h40v30H10z"/></g>', "box"),
        ('<path d="M6 5h20a3 3 0 0 1 3 3v9a3 3 0 0 1-3 3H6a3 3 0 0 1-3-3V8a3 3 0 0 1 3-3z"/>', "rounded"),
        ('<rect x="9" y="9" width="20" height="9" rx="2" transform="rotate(20 20 20)"/>', "rounded"),
        ('<path d="M20 2 38 20 20 38 2 20zM3 3l9 2-5 9z"/><path d="M5 5C9 0 22 0 28 5S24 30 5 22z"/>', "box - -"),
        ('<path d="M3 20 20 3 37 20z"/><path d="M10 4l20 0 8 16-20 0z"/>', "- -"),
    ],
)
def test_primitives_are_known_however_they_are_written(body, kinds):
    assert [form.kind or "-" for form in forms_of(document(body))] == kinds.split()


def test_a_stroke_is_as_wide_as_its_root_or_its_style_says():
    drawing = Document(svg('<circle cx="9" cy="9" r="5"/>', root='stroke="red" stroke-width="3"'), "t", 64)
    assert [form.width for form in forms_of(drawing)] == [3.0]
    assert [f.width for f in forms_of(document('<circle r="5" style="stroke:red;stroke-width:2px"/>'))] == [2.0]


def test_a_symbol_is_where_and_as_large_as_its_use_says():
    symbol = '<symbol id="s" viewBox="0 0 10 10"><rect width="10" height="10" fill="red"/></symbol>'
    drawing = document(f'{symbol}<use href="#s" x="8" y="8" width="20" height="20"/>')
    (form,), (part,) = forms_of(drawing), pieces_of(drawing).parts
    assert (form.kind, form.points.max(axis=0).tolist()) == ("box", [28.0, 28.0])
    assert part.box == (slice(8, 28), slice(8, 28))


def counts(truth: str, made: str) -> tuple[int, int, int, int]:
    first, second = document(truth), document(made)
    return primitive_counts(first, pieces_of(first), second, pieces_of(second))


def test_recall_and_precision_of_primitives():
    truth = '<path d="M10 10h20v20H10z"/><circle cx="46" cy="20" r="9"/><path d="M5 40l20-5 3 9z"/>'
    assert counts(truth, truth) == (1, 2, 1, 1)
    made = '<rect x="10.2" y="10" width="20" height="20"/><rect x="37" y="11" width="18" height="18"/>'
    assert counts(truth, made) == (1, 2, 1, 2)
    # What hardly shows is not asked for.
    hidden = '<circle cx="20" cy="20" r="9"/><path fill="#fff" d="M0 0h23v48H0z"/>'
    assert counts(hidden, truth)[:2] == (0, 1)


def test_a_primitive_whose_outline_is_lost_in_its_own_fill_is_not_asked_for():
    box = '<rect x="9" y="9" width="30" height="20" fill="#08f"/>'
    disc = '<circle cx="35" cy="19" r="7" fill="{}"/>'
    assert counts(box + disc.format("#08f"), "")[1] == 1
    assert counts(box + disc.format("#fd0"), "")[1] == 2


def test_a_side_that_shows_nowhere_is_not_asked_for():
    box = '<rect x="9" y="9" width="{}" height="20" fill="#08f"/>'
    over = '<path d="M35 0H60V48H30z" fill="#fd0"/>'
    whole = counts(box.format(40) + over, box.format(30) + over)
    assert whole == (0, 0, 1, 1)
    # Nor what the canvas's border hides, or where a side is lost in its own fill; elsewhere it is.
    assert counts(box.format(55) + over.replace("60", "64"), "")[1] == 0
    assert counts(box.format(40) + over.replace("#fd0", "#08f"), "")[1] == 0
    assert counts(box.format(55) + over, box.format(55))[:2] == (1, 1)
    assert counts(box.format(40) + over, box.format(30).replace('y="9"', 'y="11"') + over)[2:] == (0, 1)
    # Of a circle any part tells of the rest.
    disc = '<circle cx="30" cy="20" r="{}" fill="#08f"/>'
    assert counts(disc.format(12) + over, disc.format(12) + over) == (1, 1, 1, 1)
    assert counts(disc.format(12) + over, disc.format(10) + over) == (0, 1, 0, 1)


def test_areas_that_show_as_primitives_are_right():
    stripes = '<path fill="#08f" d="M0 0h64v48H0z"/><path fill="#fd0" d="M0 20.5h64V40H0z"/>'
    assert counts(stripes, '<rect width="64" height="20.5" fill="#08f"/>')[2:] == (1, 1)
    wedge = '<path fill="#08f" d="M0 0h64v25.5H0z"/><path fill="#fd0" d="M0 20.5L64 22.5V40H0z"/>'
    assert counts(wedge, '<rect width="64" height="21.5" fill="#08f"/>')[2:] == (0, 1)
    # Too small to be told from others.
    assert counts(wedge, '<rect x="9" y="9" width="4" height="4"/>')[2:] == (0, 0)


def test_primitives_of_compound_paths_are_known_by_their_notation():
    truth = '<rect x="4" y="4" width="30" height="30"/><circle cx="20" cy="20" r="9" fill="#fff"/>'
    made = '<path d="M4 4h30v30H4zM11 20a9 9 0 1 0 18 0 9 9 0 1 0-18 0z"/>'
    assert counts(truth, made) == (2, 2, 2, 2)
    cubics = "M11 20c0 4.97 4.03 9 9 9s9-4.03 9-9-4.03-9-9-9-9 4.03-9 9z"
    assert counts(truth, f'<path d="M4 4h30v30H4z{cubics}"/>')[:2] == (1, 2)
    assert counts(truth, '<path d="M4 4h30v30H4z"/>')[0] == 0


def test_holes_are_right_by_the_sides_that_show():
    framed = '<path fill-rule="evenodd" d="M4 4h40v40H4zM{}z" fill="#08f"/>'
    hole = "10 10h20v14H10"
    assert counts(framed.format(hole), framed.format(hole))[2:] == (2, 2)
    assert counts(framed.format(hole), framed.format("10 10h20v18H10"))[2:] == (1, 2)


def test_the_outer_edge_of_a_ring_counts_whatever_lies_in_its_middle():
    # The artist's outline is none that is a primitive: half rings, and a bar from side to side.
    ring = '<path d="M14 24a18 18 0 0 1 36 0h-3a15 15 0 0 0-30 0zM14 24a18 18 0 0 0 36 0h-3a15 15 0 0 1-30 0z{}"/>'
    truth = ring.format("M16 22h33v4H16z")
    made = ring.format("M16 22h33v4H16z") + '<circle cx="32" cy="24" r="18" fill="#000"/>'
    assert counts(truth, made)[2:] == (1, 1)
    assert counts(truth, made.replace('r="18"', 'r="16.5"'))[2:] == (0, 1)


def test_what_no_picture_tells_is_not_judged():
    # A neck beneath a chin might be a circle; what shows of it must be right.
    chin = '<path d="M0 0h64v24H0z" fill="#c80"/>'
    neck = '<path d="M20 8V24a12 12 0 0 0 24 0V8z" fill="#08f"/>'
    disc = '<circle cx="32" cy="24" r="12" fill="#08f"/>'
    assert counts(neck + chin, disc + chin)[2:] == (0, 0)
    assert counts(neck + chin, disc.replace("24", "23") + chin)[2:] == (0, 1)
    # Of less than a third of it no circle is certain.
    lower = chin.replace("v24", "v31")
    assert counts(neck + lower, disc + lower)[2:] == (0, 1)
    # Nor is a turned rectangle, one end of which does not show.
    bar = '<rect x="10" y="20" width="{}" height="12" transform="rotate(20 32 26)" fill="#08f"/>'
    over = '<path d="M36 0h28v48H36z" fill="#c80"/>'
    assert counts(bar.format(40) + over, bar.format(36) + over)[2:] == (0, 0)
    assert counts(bar.format(40), bar.format(36))[2:] == (0, 1)


def both(truth: str, made: str) -> tuple[DrawingPieces, DrawingPieces]:
    return DrawingPieces(document(truth)), DrawingPieces(document(made))


BAR = '<path fill="#08f" d="M24 0h16v48H24z"/>'


def test_pieces_that_others_hide_are_whole_or_not():
    disc = '<circle cx="32" cy="24" r="18" fill="#c00"/>'
    halves = '<path fill="#c00" d="M24 7.9A18 18 0 0 0 24 40zM40 7.9A18 18 0 0 1 40 40z"/>'
    assert completed(*both(disc + BAR, disc + BAR)) == (1, 1)
    assert completed(*both(disc + BAR, halves + BAR)) == (0, 1)
    # Of the bar a part is covered by a translucent disc, which hides nothing.
    assert completed(*both(BAR + disc.replace("/>", ' opacity=".5"/>'), BAR)) == (0, 0)
    # A ground that fills the canvas does not count, nor what is hidden by its own fill.
    ground = '<rect width="64" height="48" fill="#fd0"/>'
    assert completed(*both(ground + BAR, BAR)) == (0, 0)
    assert completed(*both(disc + disc.replace("32", "36"), disc)) == (0, 0)


def test_a_use_and_a_stroke_are_pieces_of_their_own():
    body = f'<defs><g id="a"><rect width="9" height="9" stroke="red" stroke-width="2"/></g></defs>{BAR}'
    found = DrawingPieces(document(body + '<use href="#a" x="4" y="6"/><use href="#a" transform="translate(45 9)"/>'))
    assert len(found.seen) == 5
    assert [part.element for part in found.parts] == [0, 1, 1, 2, 2]


def test_what_shows_where_a_piece_is_taken_away():
    ground = '<rect x="4" y="4" width="56" height="40" fill="#fd0"/>'
    holed = '<path fill="#fd0" fill-rule="evenodd" d="M4 4h56v40H4zM24 4v40h16V4z"/>'
    bar = BAR.replace("0h16v48", "4h16v40")
    assert visible_error(*both(ground + bar, ground + bar)) == 0.0
    # Beneath the bar there is nothing; beneath the ground there is nothing in either.
    assert visible_error(*both(ground + bar, holed + bar)) == 0.5
    assert visible_error(*both(ground + bar, "")) == 1.0


# --- the command ---------------------------------------------------------------------------------------------


def traced(given: tools.Given) -> bytes:
    """A tool that knows the answer."""
    height, width = tools.pixels_of(given).shape[:2]
    return svg(BOX + '<path d="M50 2h10v10H50z" fill="#00f"/>', root=f'width="{width}" height="{height}"')


def broken(_pixels: np.ndarray) -> bytes:
    raise ZeroDivisionError("no such line")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setitem(tools.TOOLS, "exact", traced)
    monkeypatch.setitem(tools.TOOLS, "broken", broken)
    path = tmp_path / "drawings"
    path.mkdir()
    for name in ("a-one", "b-two"):
        (path / f"{name}.svg").write_bytes(svg(BOX + '<rect x="50" y="2" width="10" height="10" fill="#00f"/>'))
    return path


@pytest.fixture
def run(run_benchmark):
    return partial(run_benchmark, "artwork")


def test_a_perfect_tool_has_perfect_figures(run, folder, tmp_path):
    table, sheet, kept = tmp_path / "t.csv", tmp_path / "s.png", tmp_path / "kept"
    options = ("--size", 64, "--csv", table, "--sheet", sheet, "--keep", kept, "--json")
    done = run(folder, "--tools", "exact", *options)
    report = json.loads(done.stdout)
    assert [figures["picture"] for figures in report["runs"]] == ["a-one", "b-two"]
    found = report["runs"][0]
    assert (found["delta_e"], found["psnr_1x_db"], found["psnr_4x_db"]) == (0.0, MOST_DB, MOST_DB)
    assert (found["shapes_ratio"], found["coordinates"], found["artist_coordinates"]) == (1.0, 9, 8)
    assert (found["primitive_recall"], found["primitive_precision"]) == (0.5, 1.0)
    assert (found["completed"], found["visible_error"]) == (None, 0.0)
    assert (found["leak_16x_px"], found["edge_px"], found["exact_colours"]) == (0.0, 0.0, 1.0)
    assert report["summary"]["exact"]["median"]["coordinates_ratio"] == 9 / 8
    assert [row["picture"] for row in csv.DictReader(table.open())] == ["a-one", "b-two"]
    assert Image.open(sheet).size[0] > 2000
    assert sorted(path.name for path in kept.iterdir()) == ["a-one-exact.svg", "b-two-exact.svg"]


def test_failures_are_counted_and_the_rest_goes_on(run, folder):
    (folder / "c.svg").write_text("no drawing")
    done = run(folder, "--tools", "broken,exact", "--only", "b-*,c", "--markdown", "--size", 64, code=1)
    assert b"| exact, median" in done.stdout
    assert b"a-one" not in done.stdout
    assert b"cubicsplat: failed: b-two, broken: ZeroDivisionError: no such line" in done.stderr
    assert b"cubicsplat: failed: c: " in done.stderr


def test_wrong_usage_is_said(run, folder):
    for arguments, code, words in (
        ((folder, "--tools", "inkscape"), 2, b"--tools must be of ours, photo, vtracer"),
        ((folder, "--only", "z*"), 1, b"holds no SVG that is asked for"),
        ((folder / "none", "--tools", "exact"), 1, b"cannot be read"),
        ((folder, "--size", 8), 2, b"size must be"),
        ((folder, "--input", "fax"), 2, b"--input must be one of clean, jpeg"),
    ):
        done = run(*arguments, code=code)
        assert words in done.stderr, done.stderr


def test_the_wireframe_shows_anchors_where_the_transform_puts_them():
    made = document('<g transform="translate(4 2)"><path transform="scale(.5)" d="M20 20H60V60z"/></g>')
    drawn = Document(wireframe(made, 1.0), "lines", 64).draw()
    red = (drawn[..., 0] > 150) & (drawn[..., 2] < 90) & (drawn[..., 3] > 128)
    assert red[12, 14]
    assert red[12, 34]
    assert red[32, 34]
    assert not red[20:28, 4:12].any()


# --- inputs ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", list(DEGRADATIONS))
def test_every_input_is_a_worse_picture_of_the_drawing(kind):
    clean, found = document(BOX), document(BOX)
    with_background(found, kind)
    pixels = degraded(found, kind)
    assert pixels.shape == clean.draw().shape
    assert pixels.dtype == np.uint8
    level = psnr(found.draw(), pixels)
    assert level == MOST_DB if kind in (CLEAN, "palette", "dithered") else 20.0 < level < 45.0
    assert (pixels[..., 3].min() == 255) == (kind in OPAQUE)
    assert np.array_equal(pixels, degraded(found, kind))


def test_the_truth_lies_over_white_where_the_input_does():
    found = Truth(svg(BOX), "x", 64, "jpeg")
    assert found.drawn[1][0, 0].tolist() == [255, 255, 255, 255]
    assert found.counts.shapes == 1
    assert Truth(svg(BOX), "x", 64).drawn[1][0, 0, 3] == 0


def test_the_kind_of_input_is_told(run, folder, tmp_path):
    sheet = tmp_path / "s.png"
    done = run(folder, "--tools", "exact", "--input", "jpeg", "--size", 64, "--limit", 1, "--json", "--sheet", sheet)
    report = json.loads(done.stdout)
    assert report["input"] == "jpeg"
    # The tool knows nothing of the ground.
    assert report["runs"][0]["delta_e"] > 10.0
    assert sheet.stat().st_size > 0
