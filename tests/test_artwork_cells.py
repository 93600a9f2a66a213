"""Pixel art, QR codes and checkers: drawn along their cells, and told from drawings that were made larger."""

from __future__ import annotations

import io

import numpy as np
import pytest
import resvg_py
from PIL import Image
from skimage import data

from cubicsplat_cli.api import vectorize
from cubicsplat_cli.artwork.geometry.outlines import Rectangle
from cubicsplat_cli.artwork.input.cells import FEW_COLOURS, Cells, cells_of
from cubicsplat_cli.artwork.mosaic import mosaic
from cubicsplat_cli.artwork.style import choose_style
from cubicsplat_cli.files.convert import as_picture

COLOURS = np.array([[30, 30, 40], [220, 60, 60], [250, 220, 90], [90, 180, 90], [60, 90, 200]], np.uint8)
GREYS = np.repeat(np.array([[15], [85], [170], [240]], np.uint8), 3, axis=1)
FACE = (
    '<circle cx="8" cy="8" r="7" fill="#fc4"/><circle cx="5.3" cy="6" r="1.2" fill="#640"/>'
    '<path d="M4 10q4 4 8 0z" fill="#b13"/>'
)


def sprite(colours: np.ndarray = COLOURS, side: int = 16, seed: int = 5) -> np.ndarray:
    """(side, side, 3) 8-bit: a picture that is its own mirror image, as sprites are."""
    half = np.random.default_rng(seed).integers(0, len(colours), (side, side // 2))
    return colours[np.concatenate([half, half[:, ::-1]], axis=1)]


def larger(picture: np.ndarray, times: int) -> np.ndarray:
    return picture.repeat(times, axis=0).repeat(times, axis=1)


def found(picture: np.ndarray) -> Cells | None:
    return cells_of(as_picture(picture).target())


def drawn(svg: str, width: int) -> np.ndarray:
    """(H, width, 4) what resvg makes of an SVG."""
    image = Image.open(io.BytesIO(bytes(resvg_py.svg_to_bytes(svg_string=svg, width=width))))
    return np.asarray(image.convert("RGBA"))


@pytest.mark.parametrize("times", [1, 3, 8])
@pytest.mark.parametrize("colours", [COLOURS, GREYS, COLOURS[:2]], ids=["colours", "greys", "two"])
def test_every_cell_comes_back_to_the_last_level(colours, times):
    picture = larger(sprite(colours), times)
    done = vectorize(picture, measure=False)
    assert done.report.style == "artwork" and f"cells of {len(colours)} colours" in done.report.style_reason
    assert (drawn(done.svg, 16 * times)[..., :3] == picture).all()
    assert (drawn(done.svg, 64 * times)[..., :3] == larger(picture, 4)).all()
    assert any("16 x 16 pixels" in note for note in done.report.notes) == (times > 1)


def test_no_ground_shines_through_between_cells():
    svg = vectorize(larger(sprite(), 4), measure=False).svg
    assert drawn(svg, 149)[1:-1, 1:-1, 3].min() == 255


def test_what_is_clear_stays_clear_and_what_is_faint_faint():
    picture = np.zeros((12, 12, 4), np.uint8)
    picture[::2, ::2] = (200, 30, 60, 255)
    picture[1::2, 1::2] = (30, 200, 60, 128)
    done = vectorize(larger(picture, 5), measure=False)
    assert done.report.inks == ["#1ec83c80", "#c81e3cff"]
    # The renderer keeps colours multiplied by their opacity, in 8 bits.
    assert np.abs(drawn(done.svg, 60).astype(int) - larger(picture, 5)).max() <= 1


def test_a_grid_may_begin_anywhere():
    whole = larger(sprite(), 6)
    cells = found(whole[4:, 1:-3])
    assert cells is not None and cells.side == 6 and cells.numbers.shape == (16, 16)
    assert cells.y[:3].tolist() == [0, 2, 8] and cells.x[[0, 1, -2, -1]].tolist() == [0, 5, 89, 92]


def test_a_board_of_many_cells_is_one_path_on_its_ground():
    y, x = np.mgrid[:24, :24]
    svg = vectorize(larger(COLOURS[(x + y) % 2], 7), measure=False).svg
    assert svg.count("<rect") == 1 and svg.count("<path") == 1


def test_cutouts_abut_and_nothing_lies_beneath():
    picture = sprite()
    cells = found(larger(picture, 3))
    assert cells is not None
    drawing = mosaic(cells, abutting=True)
    assert drawing.abutting
    areas = [abs(_area(outline)) * (-1 if i else 1) for s in drawing.shapes for i, outline in enumerate(s.outlines)]
    assert sum(areas) == 48 * 48


def _area(outline) -> float:
    if isinstance(outline, Rectangle):
        return outline.width * outline.height
    x, y = outline.anchors.T
    return 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


@pytest.mark.parametrize("side", [16, 32, 48])
@pytest.mark.parametrize("times", [1, 4])
def test_a_smoothed_drawing_has_no_cells(side, times):
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16">{FACE}</svg>'
    assert found(larger(drawn(svg, side), times)) is None


def test_few_shapes_on_a_grid_and_photos_have_no_cells():
    flag = np.full((120, 180, 3), 255, np.uint8)
    flag[:40], flag[80:], flag[50:70, 20:40] = (0, 60, 150), (200, 30, 30), (0, 120, 60)
    assert found(flag) is None
    noise = np.random.default_rng(2).integers(0, 256, (40, 40, 3)).astype(np.uint8)
    assert found(noise) is None and found(larger(noise, 5)) is None
    assert choose_style(as_picture(larger(noise, 5)).target()).name == "photo"


@pytest.mark.parametrize("colours", [32, 64])
def test_a_photo_of_few_greys_has_no_cells(colours):
    # Each of this picture's pixels is there twice.
    greys = Image.fromarray(data.moon()).convert("RGB").quantize(colours).convert("RGB")
    picture = np.asarray(greys)
    assert found(picture) is None
    style = choose_style(as_picture(picture).target())
    assert style.name == "photo", style.reason


def test_sprites_of_many_colours_have_cells():
    colours = np.random.default_rng(3).integers(0, 256, (40, 3)).astype(np.uint8)
    assert len(colours) > FEW_COLOURS
    cells = found(larger(sprite(colours, 64), 3))
    assert cells is not None and len(cells.colours) == 40


def test_what_the_user_asks_for_is_done():
    picture = larger(sprite(), 4)
    some = vectorize(picture, style="artwork", palette=((0, 0, 0), (255, 255, 255)), measure=False)
    assert set(some.report.inks) == {"#000000ff", "#ffffffff"}
    assert vectorize(picture, style="artwork", curves=4, measure=False).report.shapes <= 4
