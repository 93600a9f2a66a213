"""Cutouts: the same picture in abutting shapes that share their edges to the last digit."""

from __future__ import annotations

import itertools
import json
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import rest_slow
from PIL import Image

from cubicsplat_cli import vectorize
from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Rectangle, Ring, polygon, ring_of_cubics
from cubicsplat_cli.artwork.planar.cutout import cut_out
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.raster.outlines import coverage
from cubicsplat_cli.request import Request
from cubicsplat_cli.svg.drawing_reader import read_drawing
from cubicsplat_cli.svg.drawing_writer import write_drawing
from cubicsplat_cli.svg.paths import subpaths

SIZE = 100
FILLS = [(255, 0, 0, 255), (0, 128, 0, 255), (0, 0, 255, 255), (255, 200, 0, 255), (20, 20, 20, 255)]
GROUND = Rectangle(0.0, 0.0, SIZE, SIZE)


def drawing_of(*outlines, fills=FILLS) -> Drawing:
    """One shape of each outline, or of a tuple of an outline and its holes, back to front."""
    rows = [outline if isinstance(outline, tuple) else (outline,) for outline in outlines]
    shapes = [Shape(fills[i % len(fills)], row, f"shape {i}") for i, row in enumerate(rows)]
    return Drawing(SIZE, SIZE, tuple(shapes))


def masks(drawing: Drawing) -> np.ndarray:
    """(shapes, H, W) the exact share of each pixel that each shape covers."""
    found = []
    for shape in drawing.shapes:
        rings = shape.oriented()
        cubics = np.concatenate([ring.cubics for ring in rings])
        lines = np.concatenate([ring.lines for ring in rings])
        found.append(coverage(cubics, lines, 0, 0, drawing.height, drawing.width))
    return np.array(found)


def top_of(drawing: Drawing) -> np.ndarray:
    """(H, W, 4) the picture where one shape covers a pixel fully or none does, NaN elsewhere."""
    picture = np.zeros((drawing.height, drawing.width, 4))
    for shape, mask in zip(drawing.shapes, masks(drawing), strict=True):
        picture[mask > 1.0 - 1e-6] = shape.fill
        picture[(mask > 1e-6) & (mask <= 1.0 - 1e-6)] = np.nan
    return picture


def cubics_of(d: str) -> list[list[tuple]]:
    """Of each subpath its pieces as control points rounded to a millionth of a px."""
    rows = []
    for ring in subpaths(d):
        row = []
        for piece in ring:
            if np.hypot(*np.subtract(piece.start, piece.end)) > 1e-9:
                points = [(round(x, 6), round(y, 6)) for x, y in (piece.start, *piece.handles, piece.end)]
                row.append((tuple(points), piece.numbers))
        rows.append(row)
    return rows


def edges_in(drawing: Drawing, precision: int = 2) -> list[tuple[tuple, tuple]]:
    """Every line, cubic and arc of the file's paths, and the same run through the other way."""
    root = ElementTree.fromstring(write_drawing(drawing, precision=precision, title="t", comment="c"))
    found = []
    for element in root:
        if element.tag.endswith("path"):
            for points, arc in itertools.chain.from_iterable(cubics_of(element.get("d"))):
                back = (*arc[:4], 1.0 - arc[4]) if arc else ()
                found.append(((points, arc), (points[::-1], back)))
        elif element.tag.endswith("rect"):
            x, y, width, height = (float(element.get(name, "0")) for name in ("x", "y", "width", "height"))
            right, bottom = round(x + width, 6), round(y + height, 6)
            corners = [(x, y), (right, y), (right, bottom), (x, bottom)]
            found += [(((a, b), ()), ((b, a), ())) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
        elif element.tag.endswith("circle"):
            x, y, r = (float(element.get(name, "0")) for name in ("cx", "cy", "r"))
            ends = (round(x - r, 6), y), (round(x + r, 6), y)
            for a, b in (ends, ends[::-1]):
                found.append((((a, b), (r, r, 0.0, 1.0, 1.0)), ((b, a), (r, r, 0.0, 1.0, 0.0))))
    return found


def on_border(points) -> bool:
    a, b = points[0], points[-1]
    return any(p == q and p in (0.0, SIZE) for p, q in zip(a, b, strict=True))


def check(drawing: Drawing, *, alone: bool = False) -> Drawing:
    """The cutout, once it holds what a cutout promises. alone: the ground is bare, so that edges may have one side."""
    cut = cut_out(drawing, 2)
    shares = masks(cut)
    inner = slice(1, -1)
    # No overlaps: covers add up to what the stack covers. Edges are a hundredth of a px off at most.
    assert shares.sum(axis=0).max() < 1.02
    covered = 1.0 - np.prod(1.0 - masks(drawing), axis=0)
    bare_or_full = (covered < 1e-6) | (covered > 1.0 - 1e-6)
    assert np.abs(shares.sum(axis=0) - covered)[bare_or_full].max() < 0.02
    before, after = top_of(drawing), top_of(cut)
    both = ~np.isnan(before).any(axis=2) & ~np.isnan(after).any(axis=2)
    assert both[inner, inner].mean() > 0.5
    assert (before[both] == after[both]).all()
    edges = edges_in(cut)
    ways = [way for way, _ in edges]
    assert len(set(ways)) == len(ways)
    if not alone:
        assert {way for way, _ in edges if not on_border(way[0])} == {b for _, b in edges if not on_border(b[0])}
    return cut


def blob(cx: float, cy: float, *radii: float) -> Ring:
    """A smooth ring through points at these distances from its middle."""
    angle = np.arange(len(radii)) * (2.0 * np.pi / len(radii))
    out = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    at = np.array(radii)[:, None] * out + [cx, cy]
    reach = np.array(radii)[:, None] * 4.0 / 3.0 * np.tan(np.pi / 2.0 / len(radii))
    way = reach * np.stack([-out[:, 1], out[:, 0]], axis=1)
    following = np.roll(np.arange(len(radii)), -1)
    return ring_of_cubics(np.stack([at, at + way, (at - way)[following], at[following]], axis=1))


def square(x: float, y: float, side: float) -> Ring:
    return polygon(np.array([[x, y], [x + side, y], [x + side, y + side], [x, y + side]]))


def triangle(*numbers: float) -> Ring:
    return polygon(np.array(numbers).reshape(3, 2))


@pytest.mark.parametrize(
    ("outlines", "regions"),
    [
        pytest.param([Circle(50.0, 50.0, 30.0)], 2, id="a disc on a ground"),
        pytest.param([Circle(40.3, 50.1, 25.0), Circle(65.2, 52.4, 22.0)], 3, id="one disc over another"),
        pytest.param([Ellipse(50, 50, 40, 10, 0.4), Ellipse(50, 50, 40, 10, 1.9)], 4, id="turned ellipses"),
        pytest.param([(Circle(50.0, 50.0, 40.0), Circle(50.0, 50.0, 20.0))], 3, id="a ring"),
        pytest.param([Rectangle(-5, 40, 120, 20), Rectangle(40, -5, 20, 120)], 7, id="bars"),
        pytest.param([square(20, 20, 30), square(50, 50, 30)], 3, id="touching corners"),
        pytest.param([square(20, 20, 30), square(50, 20, 30), square(35, 50, 30)], 4, id="three in a point"),
        pytest.param([Rectangle(10, 10, 60, 60), triangle(40, 40, 90, 20, 60, 95)], 3, id="a corner over another"),
        pytest.param([triangle(5, 50, 95, 49.7, 95, 50.3), Circle(50, 50, 8.0)], 4, id="a sliver behind a disc"),
        pytest.param([Circle(50, 50, 30), Circle(55, 50, 25)], 3, id="touching from within"),
        pytest.param([Circle(50, 50, 30), Circle(50, 50, 30)], 2, id="one exactly over another"),
        pytest.param([blob(50, 50, 40, 20, 35, 22, 40, 18), blob(48, 52, 20, 40, 22, 36)], None, id="blobs"),
        pytest.param([Rectangle(20, 20, 60, 40, 8), Rectangle(30, 30, 60, 60, 12, 0.3)], 3, id="rounded"),
    ],
)
def test_a_cutout_is_the_same_picture_without_overlaps(outlines, regions):
    cut = check(drawing_of(GROUND, *outlines))
    assert regions is None or len(cut.shapes) == regions
    assert cut.abutting


@pytest.mark.parametrize("seed", rest_slow(*range(12), fast=4))
def test_random_heaps_of_shapes(seed):
    random = np.random.default_rng(seed)
    outlines = [GROUND]
    for _ in range(10):
        x, y = random.uniform(10.0, 90.0, 2)
        outlines.append(
            [
                Circle(x, y, random.uniform(3.0, 30.0)),
                Rectangle(np.rint(x), np.rint(y), *np.rint(random.uniform(5.0, 60.0, 2))),
                blob(x, y, *random.uniform(4.0, 30.0, random.integers(3, 9))),
                triangle(*random.uniform(0.0, 100.0, 6)),
            ][random.integers(4)]
        )
    check(drawing_of(*outlines))


def test_shapes_of_one_fill_become_one_and_what_is_bare_stays_bare():
    red, blue = FILLS[0], FILLS[2]
    drawing = drawing_of(square(10, 10, 40), Circle(50, 30, 15), Circle(25, 25, 5), fills=[red, red, blue])
    cut = check(drawing, alone=True)
    assert [shape.fill for shape in cut.shapes] == [red, blue]
    assert len(cut.shapes[0].outlines) == 2


def test_what_lies_beyond_the_canvas_is_cut_off():
    cut = check(drawing_of(Circle(0.0, 50.0, 30.0), fills=[FILLS[2]]), alone=True)
    points = np.concatenate([ring.anchors for ring in cut.shapes[0].oriented()])
    assert points.min() == 0.0


def test_circles_stay_circles_where_nothing_cuts_them():
    cut = cut_out(drawing_of(GROUND, Circle(50.004, 40.0, 20.0)), 2)
    assert cut.shapes[0].outlines[1] is cut.shapes[1].outlines[0]
    text = write_drawing(cut, precision=2, title="t", comment="c")
    assert 'cx="50" cy="40" r="20"' in text and "M30 40a20 20 0 1 0 40 0 20 20 0 1 0-40 0z" in text


def test_a_cutout_is_read_back():
    cut = check(drawing_of(GROUND, Circle(40.3, 50.1, 25.0), Circle(65.2, 52.4, 22.0)))
    again = read_drawing(write_drawing(cut, precision=2, title="t", comment="c"))
    assert [shape.fill for shape in again.shapes] == [shape.fill for shape in cut.shapes]
    assert np.abs(masks(again) - masks(cut)).max() < 1e-6


def test_names_are_those_of_the_stack():
    cut = cut_out(drawing_of(GROUND, Rectangle(-1.0, 40.0, 110.0, 20.0)), 2)
    text = write_drawing(cut, precision=2, title="t", comment="c")
    assert [shape.name for shape in cut.shapes] == ["shape 0", "shape 0", "shape 1"]
    assert text.count('id="shape-0') == 2 and text.count("<rect") == 3


def picture() -> np.ndarray:
    """A white ground with a red disc and a blue bar over it, drawn with 8 x 8 samples a pixel."""
    y, x = (np.mgrid[0:512, 0:512] + 0.5) / 8.0
    out = np.full((512, 512, 3), 255.0)
    out[np.hypot(x - 30.0, y - 30.0) <= 20.0] = (255, 0, 0)
    out[np.abs(y - 0.4 * x - 20.0) <= 5.0] = (0, 0, 255)
    return np.rint(out.reshape(64, 8, 64, 8, 3).mean(axis=(1, 3))).astype(np.uint8)


def test_the_library_cuts_out():
    stacked = vectorize(picture(), style="artwork", threads=1)
    cut = vectorize(picture(), stacking="cutout", threads=1)
    assert cut.report.style == "artwork" and cut.report.style_reason == "asked for by stacking"
    assert cut.report.settings["artwork"]["stacking"] == "cutout"
    assert cut.report.settings_hash != stacked.report.settings_hash
    # A bar over a disc: the disc and the ground are in two parts.
    assert (stacked.report.shapes, cut.report.shapes) == (3, 5)
    # Along shared edges viewers let the ground through; all else is alike.
    difference = np.abs(stacked.pixels.astype(int) - cut.pixels.astype(int)).max(axis=2)
    flat = (np.abs(np.diff(picture().astype(int), axis=0, append=255)) == 0).all(axis=2)
    assert difference[flat].mean() < 2.0 and np.median(difference) == 0


def test_the_command_cuts_out_and_makes_anew_what_was_stacked(run_cli, tmp_path):
    Image.fromarray(picture()).save(tmp_path / "logo.png")
    arguments = (str(tmp_path / "logo.png"), "--style", "artwork", "--threads", "1")
    run_cli("vectorize", *arguments)
    stacked = (tmp_path / "logo.svg").read_bytes()
    run_cli("vectorize", *arguments, "--stacking", "cutout")
    cut = (tmp_path / "logo.svg").read_bytes()
    assert cut != stacked
    assert json.loads((tmp_path / "logo.json").read_text())["settings"]["artwork"]["stacking"] == "cutout"
    run_cli("vectorize", *arguments, "--stacking", "cutout")
    assert (tmp_path / "logo.svg").read_bytes() == cut
    run_cli("eval", str(tmp_path / "logo.png"), str(tmp_path / "logo.svg"))
    run_cli("render", str(tmp_path / "logo.svg"), "-o", str(tmp_path / "drawn.png"))


def test_what_contradicts_a_cutout_is_refused():
    with pytest.raises(UsageError, match="stacking"):
        ArtworkSettings(stacking="piled")
    cutout = ArtworkSettings(stacking="cutout")
    with pytest.raises(UsageError, match="is for artwork"):
        Request(artwork=cutout, style="photo")
    with pytest.raises(UsageError, match="give one of them"):
        Request(artwork=cutout, freeze=True)
