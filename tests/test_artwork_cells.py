"""Pixel art, QR codes and checkers: drawn along their cells, and told from drawings that were made larger."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from conftest import rest_slow
from image_files import by_resvg, recoded
from PIL import Image, ImageDraw
from skimage import data

from cubicsplat_cli.api import vectorize
from cubicsplat_cli.artwork import style
from cubicsplat_cli.artwork.input import cells as cells_module
from cubicsplat_cli.artwork.input.cells import FEW_COLOURS, MOST_CELLS, Cells, cells_of, forced_cells
from cubicsplat_cli.artwork.mosaic import MOST_CORNERS, CellLayer, mosaic, outlines
from cubicsplat_cli.artwork.style import choose_style
from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.files.load import as_picture
from cubicsplat_cli.svg.drawing_reader import read_drawing

SAMPLES = Path(__file__).resolve().parents[1] / "samples"

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


def drawn(svg: str | Path, width: int) -> np.ndarray:
    return np.asarray(by_resvg(svg, width))


@pytest.mark.parametrize("times", [1, 3, 8])
@pytest.mark.parametrize("colours", [COLOURS, GREYS, COLOURS[:2]], ids=["colours", "greys", "two"])
def test_every_cell_comes_back_to_the_last_level(colours, times):
    picture = larger(sprite(colours), times)
    done = vectorize(picture, measure=False)
    assert done.report.style == "pixel" and f"cells of {len(colours)} colours" in done.report.style_reason
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
    assert svg.count("<path") == 2 and 'id="background"' in svg
    assert read_drawing(svg).fills == ((30, 30, 40, 255), (220, 60, 60, 255))


def test_cutouts_abut_and_nothing_lies_beneath():
    picture = sprite()
    cells = found(larger(picture, 3))
    masks = [layer.mask for layer in mosaic(cells, 48, 48, abutting=True).layers]
    assert sum(int(mask.sum()) for mask in masks) == 16 * 16


@pytest.mark.parametrize("side", [16, 32, 48])
@pytest.mark.parametrize("times", [1, 4])
def test_a_smoothed_drawing_has_no_cells(side, times):
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16">{FACE}</svg>'
    assert found(larger(drawn(svg, side), times)) is None


@pytest.mark.parametrize(
    ("filtered", "times"), rest_slow(("BILINEAR", 2.5), ("BICUBIC", 12), ("BILINEAR", 7.5), ("BICUBIC", 5), fast=2)
)
def test_cells_are_found_though_enlarging_blurred_them(filtered, times):
    picture = sprite(COLOURS, 24)
    side = round(len(picture) * times)
    image = Image.fromarray(picture).resize((side, side), Image.Resampling[filtered])
    cells = found(np.asarray(image))
    assert cells is not None and cells.x[-1] == cells.y[-1] == side
    off = np.abs(cells.colours[cells.numbers][..., :3] - picture)
    assert np.quantile(off, 0.95) <= 2.0


def test_a_code_is_found_though_enlarging_blurred_it():
    code = np.repeat(255 * np.random.default_rng(4).integers(0, 2, (37, 37, 1)).astype(np.uint8), 3, axis=2)
    cells = found(np.asarray(Image.fromarray(code).resize((133, 133), Image.Resampling.BILINEAR)))
    assert cells is not None and (cells.colours[cells.numbers][..., :3] == code).all()


def test_an_enlarged_drawing_with_anti_aliasing_has_no_cells():
    small = Image.fromarray(drawn(f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16">{FACE}</svg>', 32))
    assert found(np.asarray(small.resize((128, 128), Image.Resampling.BILINEAR))) is None


def test_few_shapes_on_a_grid_and_photos_have_no_cells():
    flag = np.full((120, 180, 3), 255, np.uint8)
    flag[:40], flag[80:], flag[50:70, 20:40] = (0, 60, 150), (200, 30, 30), (0, 120, 60)
    assert found(flag) is None
    noise = np.random.default_rng(2).integers(0, 256, (40, 40, 3)).astype(np.uint8)
    assert found(noise) is None and found(larger(noise, 5)) is None
    assert choose_style(as_picture(larger(noise, 5)).target()).name == "photo"


@pytest.mark.parametrize("colours", rest_slow(32, 64))
def test_a_photo_of_few_greys_has_no_cells(colours):
    # Each of this picture's pixels is there twice.
    greys = Image.fromarray(data.moon()[:300, :300]).convert("RGB").quantize(colours).convert("RGB")
    picture = np.asarray(greys)
    assert found(picture) is None
    chosen = choose_style(as_picture(picture).target())
    assert chosen.name == "photo", chosen.reason


def test_sprites_of_many_colours_have_cells():
    colours = np.random.default_rng(3).integers(0, 256, (40, 3)).astype(np.uint8)
    assert len(colours) > FEW_COLOURS
    cells = found(larger(sprite(colours, 64), 3))
    assert cells is not None and len(cells.colours) == 40


def test_what_the_user_asks_for_is_done():
    picture = larger(sprite(), 4)
    some = vectorize(picture, style="artwork", palette=((0, 0, 0), (255, 255, 255)), measure=False)
    assert set(some.report.inks) == {"#000000ff", "#ffffffff"} and some.report.style == "artwork"
    assert vectorize(picture, style="artwork", curves=4, measure=False).report.shapes <= 4
    few = vectorize(picture, colors=3, measure=False).report
    assert len(few.inks) == few.shapes == 3 and any("3 colours for 5" in note for note in few.notes)


def scene(width: int, height: int, seed: int = 4) -> np.ndarray:
    """(height, width, 3) 8-bit: a dithered sky above tiles, and a sprite, as games of 8 bits show them."""
    y, x = np.mgrid[:height, :width]
    t = 3.0 * y / height
    bayer = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]]) / 16.0
    numbers = t.astype(int) + (t % 1.0 > bayer[y % 4, x % 4])
    numbers = np.where(y > 0.6 * height, 4 + (np.random.default_rng(seed).random((8, 8)) < 0.3)[y % 8, x % 8], numbers)
    body = np.random.default_rng(seed).integers(6, 9, (16, 8))
    numbers[8:24, 8:24] = np.concatenate([body, body[:, ::-1]], axis=1)
    return np.random.default_rng(seed + 1).integers(0, 256, (9, 3)).astype(np.uint8)[numbers]


def nearest(picture: np.ndarray, factor: float) -> np.ndarray:
    height, width = (int(factor * side) for side in picture.shape[:2])
    rows, columns = ((np.arange(side) / factor).astype(int) for side in (height, width))
    return picture[rows][:, columns]


def test_a_sheet_of_sprites_has_cells_though_one_is_dithered():
    rows = [np.hstack([sprite(seed=8 * row + column) for column in range(8)]) for row in range(8)]
    sheet, ramp = np.vstack(rows), np.arange(40, dtype=np.uint8)
    dots = np.asarray(Image.fromarray(3 * np.add.outer(ramp, ramp)).convert("1"))  # by Floyd and Steinberg
    sheet[:40, :40] = COLOURS[dots.astype(int)]
    cells = found(sheet)
    assert cells is not None and cells.side == 1.0


@pytest.mark.parametrize("factor", [1.0, 2.0, 2.4, 3.5])
def test_scenes_of_any_size_and_factor_come_back_exactly(factor):
    picture = nearest(scene(144, 120), factor)
    done = vectorize(picture, measure=False)
    assert done.report.style == "pixel" and done.report.shapes == 8
    assert (drawn(done.svg, picture.shape[1])[..., :3] == picture).all()
    assert any("144 x 120 pixels" in note for note in done.report.notes) == (factor > 1.0)


def test_what_pillow_enlarges_by_halves_is_found():
    picture = Image.fromarray(sprite(side=32)).resize((112, 112), Image.Resampling.NEAREST)
    cells = found(np.asarray(picture))
    assert cells is not None and cells.numbers.shape == (32, 32) and 3.4 < cells.side < 3.6


@pytest.mark.parametrize(("times", "quality"), [(8, 85), (8, 60), (4, 90)])
def test_cells_beneath_a_jpegs_artefacts(times, quality):
    picture = sprite(side=32)
    cells = found(recoded(larger(picture, times), quality=quality))
    assert cells is not None and cells.numbers.shape == (32, 32) and len(cells.colours) <= 16
    off = np.abs(cells.colours[cells.numbers][..., :3] - picture).max(axis=2)
    assert np.median(off) <= 8.0


@pytest.mark.parametrize(
    ("name", "side"), rest_slow(("bird", 160), ("badge", 64), *product(("bird", "fish", "badge"), (64, 160)), fast=2)
)
def test_a_drawing_without_smoothing_has_no_cells(name, side):
    file = SAMPLES / "artwork" / f"{name}.svg"
    large = drawn(file, 8 * side)
    picture = np.where(large[4::8, 4::8, 3:] > 127, large[4::8, 4::8], 0)
    picture[..., 3] = np.where(picture[..., 3] > 0, 255, 0)
    assert found(picture) is None


def test_a_code_with_a_logo_on_it_has_no_cells():
    rng = np.random.default_rng(25)
    code = larger(np.repeat(rng.integers(0, 2, (29, 29, 1), np.uint8) * np.uint8(255), 3, axis=2), 8)
    assert found(recoded(code, quality=85)) is not None
    picture = Image.fromarray(code)
    logo = Image.new("RGB", (224, 224), "#2a6ad0")
    ImageDraw.Draw(logo).ellipse((24, 24, 200, 200), fill="#fff")
    picture.paste(logo.resize((56, 56), Image.Resampling.BOX), (88, 88))
    assert found(recoded(picture, quality=85)) is None


def test_photos_of_16_colours_and_their_jpegs_have_no_cells():
    with Image.open(SAMPLES / "chelsea.png") as photo:
        small = photo.convert("RGB").resize((192, 128))
    assert found(recoded(small, quality=75)) is None
    assert found(np.asarray(small.quantize(16).convert("RGB"))) is None


def test_cells_that_are_asked_for_are_drawn_whatever_the_picture_is():
    noise = np.random.default_rng(2).integers(0, 256, (24, 31, 3)).astype(np.uint8)
    done = vectorize(noise, style="pixel", measure=False)
    assert done.report.style == "pixel" and "pixel by pixel" in done.report.notes[0]
    assert (drawn(done.svg, 31)[..., :3] == noise).all()
    flag = np.full((120, 180, 3), 255, np.uint8)
    flag[:40], flag[80:] = (0, 60, 150), (200, 30, 30)
    assert vectorize(flag, style="pixel", measure=False).report.shapes == 3


def test_colours_of_very_many_cells_are_merged_and_too_many_cells_refused():
    picture = np.random.default_rng(2).integers(0, 256, (300, 300, 3)).astype(np.uint8)
    cells = forced_cells(as_picture(picture).target())
    assert len(cells.colours) < 1000 and "the likest of which were merged" in cells.notes[0]
    side = int(MOST_CELLS**0.5) + 1
    with pytest.raises(InputError, match=r"cells are too many.*--max-size"):
        forced_cells(np.random.default_rng(2).random((side, side, 1)).astype(np.float32))


def test_what_pixel_art_has_no_use_for_is_refused():
    for wrong, of in (({"min_area": 3.0}, "min_area"), ({"mode": "open"}, "mode"), ({"max_bytes": 900}, "max_bytes")):
        with pytest.raises(UsageError) as raised:
            vectorize(sprite(), style="pixel", measure=False, **wrong)
        assert raised.value.setting == of


def test_loops_follow_any_mask():
    mask = np.random.default_rng(7).random((41, 29)) < 0.5
    corners, ends = outlines(mask)
    x, y = corners.T
    after = np.arange(1, len(x) + 1)
    after[ends - 1] = np.concatenate([[0], ends[:-1]])
    assert 0.5 * (x * y[after] - x[after] * y).sum() == mask.sum()
    assert ((x == x[after]) != (y == y[after])).all()
    assert len(outlines(np.zeros((3, 4), dtype=bool))[1]) == 0


def test_parts_of_a_layer_cover_what_it_covers():
    mask = np.random.default_rng(7).random((90, 120)) < 0.5
    for alpha in (255, 100):
        layer = CellLayer((1, 2, 3, alpha), mask, np.arange(121.0), np.arange(91.0))
        covered = np.zeros(mask.shape, dtype=int)
        for part in layer.parts():
            assert len(part.loops[0]) <= MOST_CORNERS
            rows, columns = (slice(int(ends[0]), int(ends[-1])) for ends in (part.y, part.x))
            covered[rows, columns] += part.mask
        assert ((covered > 0) == mask).all() and (alpha == 255 or covered.max() == 1)


def test_cells_are_found_once(monkeypatch):
    count = []
    monkeypatch.setattr(style, "cells_of", lambda target: count.append(1) or cells_of(target))
    monkeypatch.setattr(cells_module, "cells_of", lambda target: count.append(1) or cells_of(target))
    vectorize(sprite(), measure=False)
    assert len(count) == 1
