"""Lines of a pixel or two, hardly a pixel of which is purely theirs: they keep their fill, and lie where they are."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from conftest import rest_slow

from cubicsplat_cli.artwork.regions.fills import picture_fills
from cubicsplat_cli.artwork.regions.hidden_fills import hidden_fills
from cubicsplat_cli.artwork.regions.pixel_lines import joined_at_corners
from cubicsplat_cli.artwork.regions.regions import FlatPicture, Regions, find_regions, pixel_fills
from cubicsplat_cli.artwork.regions.sampling import edge_positions


def regions_of(line: np.ndarray) -> Regions:
    """A white picture with a line (40, 1 or 3) in levels down column 30 and a black block far from it."""
    levels = np.full((60, 60, 4), 255.0, dtype=np.float32)
    levels[10:50, 30, :3] = line
    levels[5:20, 5:20, :3] = 0.0
    return find_regions(FlatPicture(levels, picture_fills(levels)))


def test_a_faint_line_has_the_fill_that_it_is_a_blend_of() -> None:
    # No grey is common enough along the line to be a fill of its own.
    regions = regions_of(np.linspace(120.0, 180.0, 40)[:, None])
    assert regions.count == 3
    assert regions.fills[regions.labels[30, 30]].tolist() == [0.0, 0.0, 0.0, 255.0]


def test_a_short_pale_stroke_has_the_pale_fill_though_a_common_dark_one_explains_it_as_well() -> None:
    levels = np.full((60, 90, 4), 255.0, dtype=np.float32)
    levels[5:35, 5:35, :3], levels[45:55, 5:15, :3] = 0.0, 190.0
    y, x = np.mgrid[0:60, 40:90]
    share = np.clip(1.0 - np.abs(x - 65.0 - 0.31 * (y - 30.0)), 0.0, 1.0) * (np.abs(y - 30) <= 3)
    levels[:, 40:, :3] = np.rint(255.0 - 65.0 * share)[..., None]
    regions = find_regions(FlatPicture(levels, picture_fills(levels)))
    found = regions.fills[regions.labels[:, 40:]][..., 0]
    assert set(found.ravel().tolist()) == {255.0, 190.0}
    assert (found[share > 0.7] == 190.0).all()


def test_a_line_adds_the_fill_that_only_it_has() -> None:
    regions = regions_of(np.tile([200.0, 0.0, 0.0], (40, 1)))
    assert regions.fills[regions.labels[30, 30]].tolist() == [200.0, 0.0, 0.0, 255.0]


def test_pale_pixels_beside_a_line_are_blends_of_it_though_another_shape_has_their_colour():
    levels = np.full((60, 60, 4), [190.0, 190.0, 190.0, 255.0], dtype=np.float32)
    # A line of a px that is nowhere black.
    levels[5:55, 20, :3], levels[5:55, [19, 21], :3] = 38.0, 171.0
    levels[2:12, 50:58, :3], levels[2:12, 40:48, :3] = 171.0, 0.0
    regions = find_regions(FlatPicture(levels, picture_fills(levels)))
    found = regions.fills[regions.labels][..., 0]
    assert (found[:, :39] != 171.0).all() and (found[2:12, 50:58] == 171.0).all()


def test_a_row_on_the_rim_is_no_line() -> None:
    levels = np.full((60, 60, 4), 255.0, dtype=np.float32)
    levels[20:40, 20:40, :3] = 0.0
    levels[0, :, :] = 150.0
    assert find_regions(FlatPicture(levels, picture_fills(levels))).count == 2


def test_a_fill_that_no_pixel_shows_pure_is_the_least_blended_colour() -> None:
    # Red lines of two thirds of a px, and of all widths below, so that no colour is common.
    line = np.linspace(90.0, 255.0, 40)[:, None] * [0.0, 1.0, 1.0] + [255.0, 0.0, 0.0]
    regions = regions_of(line)
    red = regions.fills[regions.labels[12, 30]]
    assert regions.count == 3
    assert red[0] == 255.0 and 90.0 <= red[1] <= 110.0


def test_a_fill_over_nothing_is_opaque_where_no_pixel_shows_it_pure() -> None:
    levels = np.zeros((60, 60, 4), dtype=np.float32)
    levels[10:50, 30, 3] = np.linspace(180.0, 100.0, 40)
    levels[5:20, 5:20] = 255.0
    regions = find_regions(FlatPicture(levels, picture_fills(levels)))
    assert regions.fills[regions.labels[15, 30]].tolist() == [0.0, 0.0, 0.0, 255.0]


def test_a_small_shape_of_three_fills_in_a_pixel_is_no_fill() -> None:
    fills = np.array([[255.0, 0.0, 0.0, 255.0], [0.0, 255.0, 0.0, 255.0], [0.0, 0.0, 255.0, 255.0]])
    values = np.repeat([[85.0, 85.0, 85.0, 255.0], [255.0, 255.0, 0.0, 255.0]], 8, axis=0)
    assert hidden_fills(values, fills, 40.0, 24.0, 4).tolist() == [[255.0, 255.0, 0.0, 255.0]]


WHITE, BLUE, DARK = (255.0, 255.0, 255.0), (40.0, 110.0, 200.0), (30.0, 30.0, 30.0)


def test_a_thin_fill_between_two_others_that_never_meet_it_stays() -> None:
    # A road with grey casings, and a label whose ink, which no pixel shows pure, makes the same grey with the ground.
    fine, ground, grey, ink = 8, 240.0, 189.0, 60.0
    y, x = (np.mgrid[: 96 * fine, : 96 * fine] + 0.5) / fine
    picture = np.full(y.shape, ground)
    off = np.abs(y - 0.02 * x - 50.0)
    picture[off <= 4.2] = grey
    picture[off <= 3.0] = 255.0
    for k in range(9):
        picture[(np.abs(x - 0.2 * y - 12.0 - 6.0 * k) <= 0.4) & (y < 14.0)] = ink
    colours = picture.reshape(96, fine, 96, fine).mean(axis=(1, 3))
    levels = np.dstack([colours] * 3 + [np.full((96, 96), 255.0)]).astype(np.float32)
    regions = find_regions(FlatPicture(levels, picture_fills(levels)))
    assert np.abs(regions.fills[:, 0] - grey).min() <= 6.0


def slanted(degrees: float, width: float, below: tuple[float, ...], height: float = 20.3, fine: int = 16) -> np.ndarray:
    """White above and `below` below a dark line through (0, height), a dark block far from it: (96, 96, 4) levels.

    fine: samples a pixel in each direction.
    """
    y, x = (np.mgrid[: 96 * fine, : 96 * fine] + 0.5) / fine
    off = (y - height) * math.cos(math.radians(degrees)) - x * math.sin(math.radians(degrees))
    image = np.where((off > 0.0)[..., None], below, WHITE)
    image = np.where((np.abs(off) <= 0.5 * width)[..., None] | ((y < 9) & (x < 9))[..., None], DARK, image)
    colours = image.reshape(96, fine, 96, fine, 3).mean(axis=(1, 3))
    return np.dstack([colours, np.full((96, 96), 255.0)]).astype(np.float32)


@pytest.mark.parametrize(("degrees", "below"), rest_slow((20.0, BLUE), *product((20.0, 40.0, 45.0), (WHITE, BLUE))))
def test_a_slanting_line_is_one_region(degrees, below):
    levels = slanted(degrees, 1.3, below)
    regions = find_regions(FlatPicture(levels, picture_fills(levels)))
    # The block, the line, and what is on either side of it.
    assert regions.count == 4
    assert sorted(regions.areas)[1] > 90


@pytest.mark.parametrize(("width", "below"), rest_slow((1.0, BLUE), *product((1.0, 1.3, 1.8), (WHITE, BLUE))))
def test_both_edges_of_a_thin_line_lie_right(width, below):
    levels = slanted(25.0, width, below)
    found = edge_positions(levels, regions := find_regions(FlatPicture(levels, picture_fills(levels))))
    dark = (regions.fills[:, 2] < 60)[regions.labels]
    dark[:12, :12] = False
    off = []
    for x in range(20, 76):
        rows = np.flatnonzero(dark[:, x])
        middle, half = 20.3 + (x + 0.5) * math.tan(math.radians(25.0)), 0.5 * width / math.cos(math.radians(25.0))
        off += [found.rows[rows[0], x] - middle + half, found.rows[rows[-1] + 1, x] - middle - half]
    assert np.abs(off).max() < 0.1


def test_a_level_line_over_two_rows_between_two_grounds_has_its_own_fill():
    # Both rows are of one colour each, which no other pixel has.
    levels = slanted(0.0, 1.5, BLUE, height=40.0)
    regions = find_regions(FlatPicture(levels, picture_fills(levels)))
    for row in (39, 40):
        assert regions.fills[regions.labels[row, 20]].tolist() == [30.0, 30.0, 30.0, 255.0]


def test_what_a_shallow_line_leaves_of_two_rows_is_no_fill():
    # Where it passes from a row to the next, 2 x 2 px have one blend.
    levels = slanted(3.0, 1.5, WHITE, fine=4)
    assert set(find_regions(FlatPicture(levels, picture_fills(levels))).fills[:, 0]) == {255.0, 30.0}


def test_a_thin_box_of_a_fill_of_its_own_keeps_it():
    levels = np.full((60, 60, 4), 255.0, dtype=np.float32)
    levels[40:50, 5:50, :3] = 0.0
    levels[20:22, 10:40, :3] = 90.0
    assert find_regions(FlatPicture(levels, picture_fills(levels))).fills[:, 0].tolist().count(90.0) == 1


@pytest.mark.parametrize("dot", [[[0.3, 1.0, 0.3], [0.3, 1.0, 0.3]], [[0.6, 0.7], [0.75, 0.65]]])
def test_dots_of_a_pixel_or_two_amid_a_fill_are_regions(dot):
    """Where there are many of them, as in a tone."""
    levels = np.full((140, 140, 4), 255.0, np.float32)
    levels[126:138, 8:50, :3] = 0.0
    rows, columns = np.shape(dot)
    for y in range(3, 123, 6):
        for x in range(6, 134, 6):
            levels[y : y + rows, x : x + columns, :3] = 255.0 * (1.0 - np.array(dot))[..., None]
    assert find_regions(FlatPicture(levels, picture_fills(levels))).count == 2 + 20 * 22


def test_a_few_faint_or_blurred_dots_are_left_to_the_finished_drawing():
    levels = np.full((60, 60, 4), 255.0, np.float32)
    levels[40:52, 8:50, :3] = 0.0
    levels[6, 6:8, :3] = 128.0
    levels[12, 12, :3] = 240.0
    levels[18:20, 18, :3] = 0.0
    assert (
        find_regions(FlatPicture(levels, np.array([[255.0] * 4, [0.0, 0.0, 0.0, 255.0], [240.0] * 3 + [255.0]]))).count
        == 3
    )


def ring_without_anti_aliasing() -> np.ndarray:
    """(90, 90, 4) levels: a black ring of a px across on white."""
    at = np.arange(90) + 0.5
    drawn = np.abs(np.hypot(at[:, None] - 45.3, at - 44.6) - 38.2) <= 0.5
    return np.dstack([*[255.0 * ~drawn] * 3, np.full((90, 90), 255.0)]).astype(np.float32)


def test_a_thin_ring_without_anti_aliasing_stays_in_one_piece():
    levels = ring_without_anti_aliasing()
    regions = find_regions(FlatPicture(levels, np.array([[255.0, 255.0, 255.0, 255.0], [0.0, 0.0, 0.0, 255.0]])))
    assert (regions.fills[:, 0] < 128.0).sum() == 1


def test_a_line_of_half_a_px_is_joined_where_it_has_little_of_the_corner():
    palette = np.array([[255.0, 255.0, 255.0, 255.0], [0.0, 0.0, 0.0, 255.0]])
    share = np.zeros((9, 9))
    share[np.arange(9), np.arange(9)] = 0.5
    share[np.arange(8), np.arange(1, 9)] = 0.06
    levels = np.dstack([*[255.0 * (1.0 - share)] * 3, np.full((9, 9), 255.0)])
    fills = joined_at_corners((share >= 0.5).astype(np.int32), levels, palette)
    assert (fills[np.arange(8), np.arange(1, 9)] == 1).all()
    faint = np.where(share == 0.06, 0.02, share)[..., None] * [-255.0, -255.0, -255.0, 0.0] + 255.0
    assert (joined_at_corners((share >= 0.5).astype(np.int32), faint, palette) == (share >= 0.5)).all()


def test_a_line_of_one_px_is_joined_where_skia_leaves_a_tenth_at_the_corner():
    palette = np.array([[255.0, 255.0, 255.0, 255.0], [0.0, 0.0, 0.0, 255.0]])
    share = np.diag(np.full(9, 0.93))
    share[np.arange(1, 9), np.arange(8)] = 0.085
    levels = np.dstack([*[255.0 * (1.0 - share)] * 3, np.full((9, 9), 255.0)])
    fills = joined_at_corners((share >= 0.5).astype(np.int32), levels, palette)
    assert (fills[np.arange(1, 9), np.arange(8)] == 1).all()


def test_squares_of_a_chess_board_stay_apart():
    board = np.kron(np.indices((6, 6)).sum(axis=0) % 2, np.ones((8, 8)))
    levels = np.dstack([*[255.0 * board] * 3, np.full(board.shape, 255.0)]).astype(np.float32)
    regions = find_regions(FlatPicture(levels, np.array([[0.0, 0.0, 0.0, 255.0], [255.0, 255.0, 255.0, 255.0]])))
    assert regions.count == 36


def test_no_thin_line_has_a_fill_that_stands_for_a_gradient():
    """A line of half black over a grey is nearer to another grey, which shows elsewhere."""
    levels = np.full((40, 60, 4), 255.0, np.float32)
    levels[:, :30, :3], levels[:, 30:, :3] = 200.0, 100.0
    levels[:10, :10, :3] = 0.0
    levels[14:, 14, :3] = 100.0
    palette = np.array([[grey, grey, grey, 255.0] for grey in (200.0, 100.0, 0.0)])
    for standing, fill in ((np.zeros((0, 4)), 1), (palette[1:2], 2)):
        fills = pixel_fills(FlatPicture(levels, palette, standing=standing)).fills
        assert (fills[20:, 14] == fill).all()


@pytest.mark.parametrize("degrees", [7.0, 20.0, 45.0])
def test_pixels_of_a_line_that_happen_to_have_another_fill_are_its_blends(degrees):
    levels = slanted(degrees, 1.2, WHITE)
    levels[80:87, 80:87, :3] = 128.0  # a fill that blends of the line have too
    fills = pixel_fills(FlatPicture(levels, picture_fills(levels)))
    grey = np.flatnonzero(np.abs(fills.palette[:, 0] - 128.0) < 1.0)
    assert len(grey) == 1 and (np.argwhere(fills.fills == grey[0]) >= 80).all()
