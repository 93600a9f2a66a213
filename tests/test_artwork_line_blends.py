"""The blend that thin lines leave in many pixels is no fill; what looks like a blend but lies elsewhere is one."""

from __future__ import annotations

from io import BytesIO

import cairosvg
import numpy as np
import pytest
from PIL import Image, ImageDraw

from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.artwork.regions.fills import picture_fills
from cubicsplat_cli.artwork.regions.pen_lines import border_inks
from cubicsplat_cli.artwork.regions.regions import FlatPicture, find_regions, pixel_fills
from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.files.load import as_picture
from cubicsplat_cli.raster.engines import render_scene

FILL, HALF = [240.0, 80.0, 0.0, 255.0], [120.0, 40.0, 0.0, 127.5]


def lines(pairs: int, singles: int) -> np.ndarray:
    """Upright lines of a fill over nothing: so many that lie between two columns, so many that fill one."""
    levels = np.zeros((60, 80, 4), dtype=np.float32)
    levels[45:58, 10:70] = FILL
    for i in range(pairs + singles):
        x = 4 + 5 * i
        levels[5:45, x : x + 2] = HALF if i < pairs else [FILL, [0.0] * 4]
    return levels


def fills_of(levels: np.ndarray) -> list[list[float]]:
    found = find_regions(FlatPicture(levels, picture_fills(levels))).fills
    return sorted(np.unique(np.rint(found), axis=0).tolist())


def test_lines_between_two_columns_have_the_fill_of_those_in_one() -> None:
    levels = lines(2, 3)
    # Each leans over to the other column half way, as lines do that are not quite upright.
    for x in (4, 9):
        levels[10:18, x : x + 2] = [FILL, [0.0] * 4]
        levels[30:38, x : x + 2] = [[0.0] * 4, FILL]
    assert fills_of(levels) == [[0.0, 0.0, 0.0, 0.0], FILL]


def test_a_paler_fill_far_from_the_other_one_stays() -> None:
    levels = lines(0, 6)
    levels[5:40, 60:62] = HALF
    levels[5:40, 70:72] = HALF
    assert np.rint(HALF).tolist() in fills_of(levels)


def test_a_paler_fill_with_interiors_stays() -> None:
    levels = lines(1, 8)
    levels[20:40, 60:76] = HALF
    assert np.rint(HALF).tolist() in fills_of(levels)


def test_lines_too_thin_to_be_pure_anywhere_leave_no_fill() -> None:
    """Between two columns they leave half of each, and here and there more, but beside it nothing that is pure."""
    levels = lines(3, 6)
    for x in (4, 9, 14):
        levels[7:45:5, x] = 0.8 * np.array(FILL)
    assert fills_of(levels) == [[0.0, 0.0, 0.0, 0.0], FILL]


def test_lines_hardly_narrower_than_their_pixels_leave_no_fill() -> None:
    share = lines(0, 12)[..., 3:] / 255.0
    for x in (4, 9, 14):
        share[5:45, x : x + 2] = 0.94
    ground, ink = np.array([75.0, 146.0, 219.0, 255.0]), np.full(4, 255.0)
    levels = np.rint(ground + share * (ink - ground)).astype(np.float32)
    assert fills_of(levels) == [ground.tolist(), ink.tolist()]


def pen_drawing(lines: str, *, pen: str = "#000", width: float = 1.0, ground: str = "#fff") -> np.ndarray:
    """Slanted lines and a ring of a pen, and what else is drawn with it."""
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="160" height="120"><path d="M0 0H160V120H0z" fill="{ground}"/>'
        f'<g stroke="{pen}" stroke-width="{width}" fill="none"><path d="M8 110L40 60L76 112"/>'
        f'<circle cx="120" cy="85" r="24.3"/>{lines}</g></svg>'
    )
    png = cairosvg.svg2png(bytestring=svg.encode())
    return as_levels(as_picture(np.array(Image.open(BytesIO(png)).convert("RGB"))).target())


FRAME = '<path d="M10 10H150V50H10ZM80 10V50"/>'


@pytest.mark.parametrize(("pen", "ground"), [("#000", "#fff"), ("#fff", "#0d47a1"), ("#9e9e9e", "#fafafa")])
@pytest.mark.parametrize("width", [1.0, 1.2])
def test_level_lines_between_pixels_have_the_fill_of_slanted_ones(pen: str, ground: str, width: float) -> None:
    found = fills_of(pen_drawing(FRAME, pen=pen, width=width, ground=ground))
    assert len(found) == 2


def test_level_lines_of_several_shares_have_one_fill() -> None:
    rows = "".join(f'<path d="M{10 + 20 * k} {8 + 7.3 * k}h130"/>' for k in range(6))
    assert len(fills_of(pen_drawing(rows.replace("h130", "H150")))) == 2


def test_lines_around_areas_have_the_fill_of_other_lines() -> None:
    areas = '<path d="M10 10H70V50H10z" fill="#e8f0fe"/><path d="M90 10H150V50H90z" fill="#ffecb3"/>'
    assert len(fills_of(pen_drawing(areas, pen="#333"))) == 4


@pytest.mark.parametrize("grey", ["#808080", "#999", "#444"])
def test_grey_frames_in_whole_pixels_stay_grey_beside_black_lines(grey: str) -> None:
    frame = f'<path d="M10 10H70V50H10zM90 10H150V50H90z" stroke="{grey}" stroke-width="2"/>'
    found = fills_of(pen_drawing(frame))
    assert [float(int(grey[1:3] if len(grey) == 7 else 2 * grey[1], 16))] * 3 + [255.0] in found


def test_a_frame_between_pixels_is_drawn_in_one_fill_and_as_wide_as_it_was() -> None:
    levels = pen_drawing(FRAME)
    drawing = draw(levels / 255.0)
    assert len({shape.fill for shape in drawing.shapes}) == 2
    assert np.abs(255.0 * render_scene(scene_of(drawing)) - levels).mean() < 0.5


CROSSINGS = '<path d="M10 30H150"/><path d="M10 60H150"/><path d="M50 10V110"/><path d="M90 10V110"/>'


def level_drawing(lines: str, pen: str, width: float) -> np.ndarray:
    """Lines of a pen at whole coordinates, each a path of its own."""
    svg = (
        '<svg xmlns="http://www.w3.org/2000/svg" width="160" height="120"><path d="M0 0H160V120H0z" fill="#fff"/>'
        f'<g stroke="{pen}" stroke-width="{width}">{lines}</g></svg>'
    )
    png = cairosvg.svg2png(bytestring=svg.encode())
    return as_levels(as_picture(np.array(Image.open(BytesIO(png)).convert("RGB"))).target())


@pytest.mark.parametrize("pen", ["#000000", "#b71c1c", "#1a237e"])
@pytest.mark.parametrize("width", [1.0, 1.2, 1.5])
def test_what_shows_where_level_lines_cross_tells_their_ink(pen: str, width: float) -> None:
    white, ink = fills_of(level_drawing(CROSSINGS, pen, width))[::-1]
    assert white == [255.0] * 4
    assert ink[:3] == pytest.approx([int(pen[k : k + 2], 16) for k in (1, 3, 5)], abs=4.0)


def test_lines_that_fill_two_rows_keep_their_fill_where_they_cross() -> None:
    assert fills_of(level_drawing(CROSSINGS, "#999999", 2.0)) == [[153.0] * 3 + [255.0], [255.0] * 4]


def test_lines_that_cross_nowhere_stay_pale() -> None:
    alone = '<path d="M10 30H150"/><path d="M10 60H150"/><path d="M10 90H150"/>'
    assert fills_of(level_drawing(alone, "#000000", 1.0))[0][:3] == pytest.approx([127.5] * 3, abs=1.0)


def test_chosen_fills_gain_no_ink() -> None:
    levels, chosen = level_drawing(CROSSINGS, "#000000", 1.0), np.array([[255.0] * 4, [127.0, 127.0, 127.0, 255.0]])
    assert pixel_fills(FlatPicture(levels, chosen), most=2).palette.tolist() == chosen.tolist()
    assert pixel_fills(FlatPicture(levels, chosen)).palette.tolist() != chosen.tolist()


def bordered(boxes: list[tuple[str, str]], width: float) -> np.ndarray:
    """Boxes, each with its fill and the colour of its border, whose sides lie between pixels."""
    shown = "".join(
        f'<rect x="{20 + 45 * k}" y="20" width="30" height="70" fill="{fill}" stroke="{pen}" stroke-width="{width}"/>'
        for k, (fill, pen) in enumerate(boxes)
    )
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" width="190" height="110">{shown}</svg>'
    return as_picture(
        np.asarray(Image.open(BytesIO(cairosvg.svg2png(svg.encode(), background_color="white"))))
    ).target()


@pytest.mark.parametrize("width", [1.0, 1.5])
@pytest.mark.parametrize(
    "boxes",
    [
        [("#4682b4", "#333333"), ("#4682b4", "#333333")],
        [("#ff7f0e", "#000000"), ("#2ca02c", "#000000"), ("#1f77b4", "#000000")],
        [("#fde68a", "#b45309"), ("#bbf7d0", "#15803d")],
    ],
)
def test_borders_between_two_rows_have_the_ink_in_line_with_both(boxes: list[tuple[str, str]], width: float) -> None:
    drawing = draw(bordered(boxes, width))
    wanted = {colour for box in boxes for colour in box} | {"#ffffff"}
    fills = np.array(sorted(drawing.fills))[:, :3]
    known = np.array(sorted(tuple(bytes.fromhex(colour[1:])) for colour in wanted))
    assert fills.shape == known.shape
    assert np.abs(fills - known).max() <= 9  # levels: of what is known to a level, from half of a pixel on
    assert sum(shape.stroke is not None for shape in drawing.shapes) == len(boxes)


def test_borders_of_two_fills_in_whole_pixels_stay_two() -> None:
    """A button: a dark border around a light one, neither a blend."""
    image = Image.new("RGB", (160, 120), "white")
    pen = ImageDraw.Draw(image)
    for inset, colour in enumerate(["#8a8f98", "#eef4ff", "#c4d4f0"]):
        pen.rectangle([30 + inset, 30 + inset, 129 - inset, 89 - inset], colour)
    drawing = draw(as_picture(np.asarray(image)).target())
    assert {bytes(fill[:3]).hex() for fill in drawing.fills} == {"ffffff", "8a8f98", "eef4ff", "c4d4f0"}


def test_the_ink_of_borders_is_where_lines_through_their_colours_meet() -> None:
    areas, ink = (
        np.array([[255.0, 255.0, 255.0, 255.0], [70.0, 130.0, 180.0, 255.0]]),
        np.array([200.0, 20.0, 40.0, 255.0]),
    )
    shares = np.array([[0.3], [0.8]])
    palette = np.vstack([areas, areas + shares * (ink - areas)])
    labels = np.zeros((60, 60), dtype=np.int64)
    labels[11:40, 11:40], labels[12:39, 12:39], labels[13:38, 13:38] = 2, 3, 1
    thin = np.array([False, False, True, True])
    ((found, _, lines),) = border_inks(palette, labels, thin, ~thin)
    assert found == pytest.approx(ink) and lines == [2, 3]
    labels[10:41, 10:41] = np.where(labels[10:41, 10:41] == 0, 2, labels[10:41, 10:41])  # three rows are no such line
    assert border_inks(palette, labels, thin, ~thin) == []
