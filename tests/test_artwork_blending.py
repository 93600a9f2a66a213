"""Pictures whose edges were blended otherwise: for subpixels, in linear light, or not at all."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from benchmarks.artwork.document import Document
from cubicsplat_cli.artwork.channels import light_of_srgb
from cubicsplat_cli.artwork.geometry.outlines import Circle, pieces_of_rings
from cubicsplat_cli.artwork.input.linear_light import without_linear_light
from cubicsplat_cli.artwork.input.prepare import analysed, as_levels
from cubicsplat_cli.artwork.input.subpixels import without_subpixels
from cubicsplat_cli.artwork.regions.sampling import aliased, error_of_steps
from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.files.load import as_picture
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.raster.outlines import coverage


def _text(
    filtered: tuple[int, ...] | None, order: int, fill=(20, 60, 160), ground=(243, 243, 243), half=0.7
) -> np.ndarray:
    """(40, 96, 4) levels: rings and strokes, half of whose width is some px, smoothed by whole pixels, or for an LCD's
    subpixels by a filter of some taps, of which red or blue is the first.
    """
    y, x = (np.mgrid[0 : 40 * 4, 0 : 96 * 12] + 0.5) / np.array([4.0, 12.0])[:, None, None]
    drawn = np.zeros(x.shape, dtype=bool)
    for k in range(7):
        middle = 9.3 + 12.37 * k
        drawn |= np.abs(np.hypot(x - middle, y - 11.0) - 4.1) < half
        drawn |= (np.abs(x - middle - 0.3 * (y - 28.0)) < half + 0.1) & (np.abs(y - 28.0) < 5.2)
    thirds = drawn.reshape(40, 4, 96 * 3, 4).mean(axis=(1, 3))
    if filtered is None:
        shares = np.repeat(thirds.reshape(40, 96, 3).mean(axis=2, keepdims=True), 3, axis=2)
    else:
        taps = np.array(filtered) / sum(filtered)
        shares = np.stack([np.convolve(row, taps, "same") for row in thirds]).reshape(40, 96, 3)[:, :, ::order]
    colours = np.array(ground) + shares * (np.array(fill) - np.array(ground))
    return np.dstack([np.rint(colours), np.full((40, 96), 255.0)]).astype(np.float32)


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("taps", [(1, 1, 1), (8, 77, 86, 77, 8), (1, 2, 3, 2, 1)])
def test_text_for_an_lcd_becomes_text_for_whole_pixels(taps, order):
    plain = _text(None, 1)
    came = _text(taps, order)
    found = without_subpixels(came)
    assert np.abs(found - plain).mean() < 0.15 * np.abs(came - plain).mean()
    # All of its colours lie on the line between fill and ground.
    share = (243.0 - found[..., 0]) / (243.0 - 20.0)
    assert np.abs(found[..., :3] - (243.0 + share[..., None] * (np.array([20, 60, 160]) - 243.0))).max() <= 2.0


def test_thin_words_go_with_those_that_are_text_for_an_lcd_for_certain():
    """Of strokes below a px the slope of the coverage tells hardly half of the fringes."""
    came = _text((1, 1, 1), 1, half=0.3)
    found = without_subpixels(came)
    share = (243.0 - found[..., 0]) / (243.0 - 20.0)
    coloured = (
        np.abs(found[..., :3] - (243.0 + share[..., None] * (np.array([20, 60, 160]) - 243.0))).max(axis=-1) > 4.0
    )
    fringes = np.abs(came - _text(None, 1, half=0.3)).max(axis=-1) > 4.0
    assert coloured.sum() < 0.1 * fringes.sum()


@pytest.mark.parametrize(("lowest", "fill"), [(225.0, (20, 60, 160)), (130.0, (20, 30, 50))])
def test_text_for_an_lcd_on_a_button_that_gets_darker_downwards_and_whose_frame_it_touches(lowest, fill):
    rows = np.rint(np.linspace(243.0, lowest, 40))[:, None, None] * np.ones(3)
    plain, came = (_text(taps, 1, fill, rows) for taps in (None, (1, 2, 3, 2, 1)))
    for levels in (plain, came):
        levels[:, 92], levels[:, 93:] = [90.0, 90.0, 90.0, 255.0], [200.0, 210.0, 220.0, 255.0]
    found = without_subpixels(came)
    assert (found[:, 92:] == came[:, 92:]).all()
    assert np.abs(found - plain)[:, :80].mean() < 0.15 * np.abs(came - plain)[:, :80].mean()


def test_text_for_an_lcd_that_a_frame_goes_on_from():
    """As the name of a group of buttons."""
    plain, came = (np.pad(_text(taps, 1), ((0, 60), (0, 104), (0, 0)), mode="edge") for taps in (None, (1, 2, 3, 2, 1)))
    for levels in (plain, came):
        levels[28, 82:190], levels[28:90, 190] = [90.0, 90.0, 90.0, 255.0], [90.0, 90.0, 90.0, 255.0]
        levels[90, 4:191], levels[34:90, 4] = [90.0, 90.0, 90.0, 255.0], [90.0, 90.0, 90.0, 255.0]
    found = without_subpixels(came)
    assert (found[28:91, 92:] == came[28:91, 92:]).all()
    assert np.abs(found - plain)[:40, 70:91].mean() < 0.2 * np.abs(came - plain)[:40, 70:91].mean()


def test_text_for_an_lcd_has_one_fill_on_a_ground_that_changes_both_ways():
    """As in windows with a glow."""
    rows, columns = np.linspace(240.0, 210.0, 40)[:, None, None], np.linspace(0.0, 3.0, 96)[None, :, None]
    ground = np.rint(rows + columns) * np.ones(3)
    plain, came = (_text(taps, 1, (30, 60, 90), ground) for taps in (None, (1, 2, 3, 2, 1)))
    found = without_subpixels(came)
    # All of its colours lie on the lines between fill and ground.
    share = (ground - found[..., :3]) / (ground - [30.0, 60.0, 90.0])
    assert np.ptp(share, axis=-1).max() <= 0.05
    assert np.abs(found - plain).mean() < 0.15 * np.abs(came - plain).mean()


def test_text_for_an_lcd_in_a_window_with_a_translucent_shadow():
    plain, came = _text(None, 1), _text((1, 2, 3, 2, 1), 1)
    shadow = np.tile(np.linspace(0.0, 90.0, 12)[:, None] * [0.1, 0.2, 0.3, 1.0], (40, 1, 1)).astype(np.float32)
    whole = np.concatenate([shadow, came, shadow[:, ::-1]], axis=1)
    found = without_subpixels(whole)
    assert (found[:, :12] == shadow).all()
    assert (found[:, -12:] == shadow[:, ::-1]).all()
    assert np.abs(found[:, 12:-12] - plain).mean() < 0.15 * np.abs(came - plain).mean()


def test_texts_for_an_lcd_in_two_greys_keep_both():
    """As in a window of labels and buttons."""
    sides = [[_text(taps, 1, (grey,) * 3, (217,) * 3, 1.0) for grey in (62, 52)] for taps in (None, (1, 1, 1))]
    plain, came = (np.concatenate(side, axis=1) for side in sides)
    assert np.abs(without_subpixels(came) - plain).mean() < 0.002 * np.abs(came - plain).mean()


def test_a_picture_without_text_for_an_lcd_stays_as_it_is():
    red, blue, plain = _text(None, 1, (200, 20, 20)), _text(None, 1, (20, 20, 200)), _text(None, 1)
    sides = np.where(np.arange(96)[None, :, None] % 12 < 6, red, blue)  # letters of two colours
    photo = np.random.default_rng(0).uniform(0.0, 255.0, plain.shape).astype(np.float32)
    photo[..., 3] = 255.0
    grey = _text((1, 2, 3, 2, 1), 1, (0, 0, 0), (255, 255, 255))
    grey[..., :3] = grey[..., 1:2]
    specks = plain.copy()  # pairs of pixels in the order of an LCD's colours, as chance has them in shaded pictures
    specks[19:21, 8:92:12, :3], specks[19:21, 9:92:12, :3] = [217.0, 163.0, 130.0], [69.0, 78.0, 10.0]
    for levels in (plain, sides, photo, grey, specks):
        assert without_subpixels(levels) is levels


def test_text_for_an_lcd_is_drawn_in_its_fill():
    prepared = analysed(_text((8, 77, 86, 77, 8), 1) / 255.0)
    assert any("LCD" in note for note in prepared.notes)
    drawing = draw(_text((8, 77, 86, 77, 8), 1) / 255.0)
    assert len(drawing.fills) == 2


def disc_in_two_spaces(ink: tuple[int, int, int], ground: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Two (64, 64, 4) pictures in levels of a disc, blended as sRGB values and in linear light."""
    at = (np.arange(64 * 16) + 0.5) / 16
    fine = np.hypot(at[:, None] - 31.3, at - 32.1) < 24.7
    share = fine.reshape(64, 16, 64, 16).mean(axis=(1, 3))[..., None]
    light = share * light_of_srgb(np.array(ink) / 255.0) + (1.0 - share) * light_of_srgb(np.array(ground) / 255.0)
    values = np.arange(256)
    in_light = np.abs(light_of_srgb(values / 255.0) - light[..., None]).argmin(axis=-1)
    as_values = np.rint(share * ink + (1.0 - share) * ground)
    opaque = np.full((64, 64, 1), 255.0)
    return tuple(np.concatenate([each, opaque], axis=2).astype(np.float32) for each in (as_values, in_light))


@pytest.mark.parametrize(
    ("ink", "ground"), [((0, 0, 0), (255, 255, 255)), ((20, 60, 200), (250, 220, 60)), ((255, 170, 0), (40, 40, 60))]
)
def test_edges_blended_in_linear_light_are_blended_again_as_viewers_do(ink, ground):
    as_values, in_light = disc_in_two_spaces(ink, ground)
    assert without_linear_light(as_values) is as_values
    found = without_linear_light(in_light)
    # Of an edge's shares rounding leaves more in the dark, where light is told by fewer levels.
    assert np.abs(found - as_values).max() <= 8.0 < np.abs(in_light - as_values).max()
    assert np.abs(found - as_values).mean() < 0.1 * np.abs(in_light - as_values).mean()


def test_a_gradient_stays_as_it_is_where_linear_light_is_undone():
    _, in_light = disc_in_two_spaces((0, 0, 0), (255, 255, 255))
    y, x = np.mgrid[:40, :64]
    values = 20.0 + np.hypot(x - 30, y - 20)
    gradient = np.stack([values, 0.9 * values, 0.8 * values, np.full_like(values, 255.0)], axis=2)
    picture = np.concatenate([in_light, np.rint(gradient).astype(np.float32)])
    found = without_linear_light(picture)
    assert not np.array_equal(found[:64], picture[:64])
    assert np.array_equal(found[68:], picture[68:])


def test_level_edges_tell_linear_light_by_their_colours():
    rows = np.zeros((60, 64, 4), np.float32)
    rows[:20], rows[20], rows[21:40], rows[40], rows[41:] = (
        (*colour, 255) for colour in ((0, 205, 0), (177, 229, 177), (255, 255, 255), (137, 137, 219), (0, 0, 205))
    )
    assert np.abs(without_linear_light(rows)[20] - (112, 205 + 50 * 112 / 255, 112, 255)).max() < 2.0
    rows[20], rows[40] = (112, 227, 112, 255), (60, 60, 217, 255)
    assert without_linear_light(rows) is rows


def test_a_drawing_is_that_of_the_picture_blended_as_viewers_do():
    as_values, in_light = disc_in_two_spaces((255, 170, 0), (40, 40, 60))
    plain, found = (draw((each / 255.0)[..., :3]) for each in (as_values, in_light))
    assert analysed((in_light / 255.0)[..., :3]).notes == [
        "edges drawn where they are in linear light, in which they were blended"
    ]
    (one,), (other,) = (drawing.shapes[1].outlines for drawing in (plain, found))
    assert isinstance(one, Circle) and isinstance(other, Circle)
    assert abs(one.r - other.r) < 0.02


IN_STEPS = '<path d="M0 0H96V96H0z" fill="#fff"/><circle cx="34.3" cy="40.2" r="24.6" fill="#1a4fa0"/>'
LEVEL = "".join(f'<path d="M{12 * k} {8 * k}h11v{3 + k}h-11z" fill="#c03020"/>' for k in range(8))


def in_steps(body: str, *, smooth: bool) -> np.ndarray:
    """(96, 96, 4) float32 the picture of a drawing in [0, 1], with or without anti-aliasing."""
    text = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 96 96">{body}</svg>'
    return as_picture(Document(text.encode(), "x", 96).draw(smooth=smooth)).premultiplied()


def test_edges_without_anti_aliasing_are_known_by_their_steps():
    slanted = IN_STEPS + '<path d="M60 20L90 31L70 80z" fill="#f0a020"/>'
    for body, expected in ((IN_STEPS, True), (slanted, True), (LEVEL, False)):
        assert aliased(as_levels(in_steps(body, smooth=False))) is expected
        assert not aliased(as_levels(in_steps(body, smooth=True)))
    assert not aliased(np.repeat(np.repeat(as_levels(in_steps(IN_STEPS, smooth=False)), 3, axis=0), 3, axis=1))


def test_what_has_no_anti_aliasing_is_drawn_through_its_steps():
    drawing = draw(in_steps(IN_STEPS, smooth=False))
    ((circle,),) = (shape.outlines for shape in drawing.shapes[1:])
    assert isinstance(circle, Circle)
    assert max(abs(circle.cx - 34.3), abs(circle.cy - 40.2), abs(circle.r - 24.6)) < 0.15
    assert analysed(in_steps(IN_STEPS, smooth=False)).notes == [
        "drawn through the steps of its edges, which have no anti-aliasing"
    ]


@pytest.mark.parametrize("angle", [0.2, 0.5, 1.2, 2.0])
def test_the_error_of_steps_is_that_of_a_smooth_edge_at_its_place(angle):
    y, x = (np.mgrid[0 : 64 * 8, 0 : 64 * 8] + 0.5) / 8.0 - 32.0
    inside = np.abs(np.cos(angle) * x + np.sin(angle) * y) < 18.3
    share = inside.reshape(64, 8, 64, 8).mean(axis=(1, 3))
    steps = np.dstack([np.where(share > 0.5, 255.0, 0.0)] * 3 + [np.full((64, 64), 255.0)])
    error = 255.0 * np.sqrt(np.square(share - (share > 0.5)).mean())
    assert error_of_steps(steps) == pytest.approx(error, rel=0.25)


def test_level_and_upright_edges_have_no_steps():
    steps = np.full((64, 64, 4), 255.0)
    steps[10:50, 12:60, :3] = 0.0
    some = steps.copy()
    some[10, 12:30, :3] = 255.0
    assert error_of_steps(steps) < 12.0 and error_of_steps(steps) < error_of_steps(some)


def test_small_shapes_without_anti_aliasing_keep_their_corners():
    """Beside a disc: squares of 8 px without their corner pixels, and bars of 2 x 6 px, nearly opaque."""
    levels = np.zeros((128, 128, 4))
    fill, varied = np.array([92.0, 161.0, 255.0, 255.0]), np.random.default_rng(0).integers(0, 20, (128, 128))
    shown = np.hypot(np.arange(128)[:, None] - 63.7, np.arange(128) - 95.2) < 29.0
    for top, left in product(range(12, 128, 32), range(6, 60, 28)):
        shown[top : top + 8, left : left + 8] = True
        shown[np.ix_([top, top + 7], [left, left + 7])] = False
        for bar in range(10, 22, 4):
            shown[top + 1 : top + 7, left + bar : left + bar + 2] = True
    levels[shown] = fill * (255.0 - varied * (varied > 12))[shown, None] / 255.0
    drawing = draw((levels / 255.0).astype(np.float32))
    drawn = 255.0 * render_scene(scene_of(drawing))
    assert np.sqrt(np.square(drawn - levels)[:, :60].mean()) < 8.0
    assert len(drawing.shapes) <= 60


def test_letters_of_a_px_without_anti_aliasing_keep_all_of_their_strokes():
    y, x = np.mgrid[0:90, 0:160]
    levels = np.full((90, 160), 255.0)
    levels[np.abs(np.hypot(x - 50.2, y - 45.4) - 36.0) < 2.0] = 0.0
    letters = {"t": "..#..|..#..|#####|..#..|..#..|..#..|..#.#|..##.", "x": "#...#|#...#|.#.#.|..#..|.#.#.|#...#|#...#"}
    bars = [np.array([[cell == "#" for cell in row] for row in letters[name].split("|")]) for name in "txtx"]
    for k, bar in enumerate(bars):
        levels[40 : 40 + bar.shape[0], 100 + 12 * k : 100 + 12 * k + 5][bar] = 0.0
    picture = np.repeat(levels[..., None] / 255.0, 3, axis=2)
    assert analysed(picture).condition.aliased
    drawing = draw(picture)
    dark = [shape for shape in drawing.shapes if shape.fill == (0, 0, 0, 255)]
    covered = sum(coverage(*pieces_of_rings(shape.oriented()), 0, 0, 90, 160) for shape in dark)
    assert (covered[38:50, 98:] > 0.5).tolist() == (levels[38:50, 98:] < 128.0).tolist()
