"""Soft shadows of boxes and of what is round: found, taken off the picture, and drawn as gradients."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from conftest import rest_slow
from image_files import encode
from PIL import Image, ImageDraw
from scipy import ndimage

from benchmarks.artwork.pixels import srgb_of_light
from cubicsplat_cli.artwork.channels import light_of_srgb
from cubicsplat_cli.artwork.input.prepare import analysed
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shadows.boxes import BlurredBox, Box, box_of, shaded
from cubicsplat_cli.artwork.shadows.lifting import lifted
from cubicsplat_cli.artwork.shadows.noisy import noisy_lifted
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.artwork.vectorize import draw, prepare, versions
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.load import Picture, as_picture
from cubicsplat_cli.scene.paint import RadialGradient
from cubicsplat_cli.svg.drawing_writer import write_drawing

WIDTH, HEIGHT = 200, 150
WHITE, BLUE = (255, 255, 255), (40, 90, 200)
CARD = (50, 40, 150, 100)
FINE = 8  # samples a px each way


def box(left: float, top: float, right: float, bottom: float, radius: float = 0.0) -> np.ndarray:
    """(H, W) coverage of a box with round corners."""
    x = (np.arange(WIDTH * FINE) + 0.5) / FINE
    y = (np.arange(HEIGHT * FINE) + 0.5) / FINE
    across = np.abs(x - 0.5 * (left + right)) - 0.5 * (right - left) + radius
    down = np.abs(y - 0.5 * (top + bottom)) - 0.5 * (bottom - top) + radius
    beyond = np.hypot(np.maximum(across, 0.0)[None], np.maximum(down, 0.0)[:, None])
    inside = np.minimum(np.maximum(across[None], down[:, None]), 0.0) + beyond <= radius
    return inside.reshape(HEIGHT, FINE, WIDTH, FINE).mean(axis=(1, 3))


def stored(picture: np.ndarray, times: int = 1) -> np.ndarray:
    """(H, W, C) float32 as a file has it, of levels; the mean of so many px each way makes one px."""
    height, width, channels = picture.shape
    levels = picture.reshape(height // times, times, width // times, times, channels).mean(axis=(1, 3))
    return np.rint(levels).astype(np.float32) / np.float32(255)


def over(picture: np.ndarray, cover: np.ndarray, fill: tuple[int, int, int]) -> np.ndarray:
    return picture + cover[..., None] * (np.array(fill) - picture)


def shadow(shape: np.ndarray, dx: float, dy: float, sigma: float, alpha: float) -> np.ndarray:
    """(H, W) how much a blurred silhouette darkens."""
    wide = ndimage.shift(np.pad(shape, 80), (dy, dx), order=1)
    return alpha * ndimage.gaussian_filter(wide, sigma, truncate=5.0)[80:-80, 80:-80]


def card(ground=WHITE, fill=BLUE, radius=8.0, shade=(0.0, 5.0, 6.0, 0.3), colour=(0, 0, 0), below=()) -> np.ndarray:
    """(H, W, 3) float32: a card with a shadow over a ground and some boxes (coverage, fill) on it."""
    picture = np.zeros((HEIGHT, WIDTH, 3)) + ground
    for cover, own in below:
        picture = over(picture, cover, own)
    shape = box(*CARD, radius)
    picture = over(over(picture, shadow(shape, *shade), colour), shape, fill)
    return stored(picture)


def drawn(drawing, renderer: str = "resvg") -> np.ndarray:
    text = write_drawing(drawing, title="t", comment="c")
    pixels = np.asarray(rerender(text.encode(), drawing.width, drawing.height, renderer=renderer).pixels).astype(float)
    return pixels[..., :3] * pixels[..., 3:] / 255 + 255 - pixels[..., 3:]


def off(drawing, picture: np.ndarray, renderer: str = "resvg") -> np.ndarray:
    """(H, W) levels by which the file is off the picture, but for the card's own outline."""
    gap = np.abs(drawn(drawing, renderer) - 255 * picture).max(axis=2)
    edge = box(CARD[0] - 2, CARD[1] - 2, CARD[2] + 2, CARD[3] + 2) - box(
        CARD[0] + 4, CARD[1] + 4, CARD[2] - 4, CARD[3] - 4
    )
    return np.where(edge > 0, 0.0, gap)


def shadows(drawing) -> list:
    return [shape for shape in drawing.shapes if shape.name == "shadow"]


@pytest.fixture(scope="module")
def plain_card() -> Drawing:
    """The drawing of `card()`."""
    return draw(card())


def levels_of(picture: np.ndarray) -> np.ndarray:
    return analysed(picture).levels


@pytest.mark.slow
@pytest.mark.parametrize("radii", rest_slow(((9.0, 9.0),), ((0.0, 0.0),), ((50.0, 30.0),)))
def test_a_layer_shades_as_a_blurred_box_does(radii):
    own = Box(50, 40, 150, 100, *radii)
    x, y = (np.arange(size * FINE) / FINE + 0.5 / FINE for size in (WIDTH, HEIGHT))
    rx, ry = max(radii[0], 1e-9), max(radii[1], 1e-9)
    across = np.maximum(np.abs(x - 100) - 50 + rx, 0.0) / rx
    down = np.maximum(np.abs(y - 70) - 30 + ry, 0.0) / ry
    inside = (np.hypot(across[None], down[:, None]) <= 1.0).astype(float)
    blurred = ndimage.gaussian_filter(np.pad(inside, 240), 6.0 * FINE, truncate=5.0)[240:-240, 240:-240]
    field = shaded(own, [BlurredBox(0.0, 0.0, 0.0, 0.0, 6.0, 0.4)], x, y)
    assert np.abs(field - 0.4 * blurred).max() < 1e-3


def test_moved_and_larger_boxes_and_layers_that_multiply():
    x, y = np.arange(60) + 0.5, np.arange(50) + 0.5
    own = Box(20, 20, 40, 30, 4, 4)
    one, two = BlurredBox(3, 1, 0, 0, 3, 0.3), BlurredBox(0, 4, 2, 1, 6, 0.2)
    both = shaded(own, [one, two], x, y)
    assert both == pytest.approx(1 - (1 - shaded(own, [one], x, y)) * (1 - shaded(own, [two], x, y)))
    assert shaded(own, [two], x, y) == pytest.approx(
        shaded(Box(18, 22, 42, 36, 7, 7), [BlurredBox(0, 0, 0, 0, 6, 0.2)], x, y)
    )
    resting = shaded(own, [BlurredBox(0, 0, 0, 0, 3, 0.3)], x, y)
    assert shaded(own, [one], x, y)[1:, 3:] == pytest.approx(resting[:-1, :-3])


def test_boxes_and_ellipses_are_told_from_other_silhouettes():
    found = box_of(box(*CARD, 12.0) > 0.5)
    assert (found.left, found.top, found.right, found.bottom) == CARD and found.rx == pytest.approx(12.0, abs=1.0)
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    ellipse = box_of(((x - 100) / 60) ** 2 + ((y - 75) / 40) ** 2 <= 1.0)
    assert ellipse.round and (ellipse.rx, ellipse.ry) == pytest.approx((60, 40), abs=1.0)
    assert box_of(np.abs(x - 100) + np.abs(y - 75) < 50) is None
    assert box_of((box(*CARD) > 0.5) & ~(box(80, 40, 120, 70) > 0.5)) is None
    # What the canvas cuts off goes on beyond it.
    bar = box_of(box(-10, -10, 210, 30) > 0.5)
    assert bar.left < -200 and bar.top < -200 and bar.right > WIDTH + 200 and bar.bottom == 30


@pytest.mark.parametrize(("sigma", "dy", "alpha", "radius"), rest_slow((11.0, 8.0, 0.25, 16.0), (6.0, 5.0, 0.3, 8.0)))
def test_the_shadow_of_a_box_is_found_and_taken_off(sigma, dy, alpha, radius):
    levels = levels_of(card(radius=radius, shade=(2.0, dy, sigma, alpha)))
    found = lifted(levels)
    (cast,) = found.shadow.casts
    (layer,) = cast.layers
    assert (layer.dx, layer.dy) == pytest.approx((2.0, dy), abs=0.25)
    assert layer.sigma == pytest.approx(sigma, rel=0.15) and layer.alpha == pytest.approx(alpha, rel=0.15)
    flat = np.abs(found.levels[..., :3] - 255.0).max(axis=2)
    away = box(CARD[0] - 2, CARD[1] - 2, CARD[2] + 2, CARD[3] + 2) == 0
    assert flat[away].max() <= 1.0 < 255 * 0.05 < (255 - levels[..., 0])[away].max()


@pytest.mark.parametrize("renderer", ["resvg", "cairosvg"])
def test_a_card_and_its_shadow_in_gradients(plain_card, renderer):
    picture, drawing = card(), plain_card
    assert len(drawing.shapes) - len(shadows(drawing)) == 2 and 8 <= len(shadows(drawing)) <= 9
    gap = off(drawing, picture, renderer)
    assert gap.max() <= 3.0 and gap.mean() < 0.3
    # Along the sides the shadow is exact to a level or so.
    assert gap[:, 80:120].max() <= 2.0 and gap[60:75].max() <= 2.0


def test_pieces_of_a_shadow_abut_on_whole_pixels(plain_card):
    boxes = [shape.outlines[0] for shape in shadows(plain_card)]
    count = np.zeros((HEIGHT, WIDTH), dtype=int)
    for one in boxes:
        sides = np.array([one.x, one.y, one.x + one.width, one.y + one.height])
        assert (sides == np.rint(sides)).all()
        left, top, right, bottom = sides.astype(int)
        count[top:bottom, left:right] += 1
    rows, columns = np.nonzero(count)
    assert (count[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1] == 1).all()


def test_a_shadow_over_two_grounds_is_one_shadow():
    picture = card(ground=(250, 220, 120), fill=WHITE, below=[(box(0, 80, 200, 150), (60, 160, 120))])
    drawing = draw(picture)
    assert {shape.fill for shape in drawing.shapes if shape.name != "shadow"} == {
        (250, 220, 120, 255),
        (60, 160, 120, 255),
        (255, 255, 255, 255),
    }
    assert len(drawing.shapes) - len(shadows(drawing)) == 3
    fills = [stop.colour[:3] for shape in shadows(drawing) if shape.gradient for stop in shape.gradient.stops]
    assert np.abs(fills).max() <= 6
    gap = off(drawing, picture)[:, :]
    assert np.percentile(gap, 99) <= 3.0


@pytest.mark.slow
def test_a_white_card_on_white_is_not_lost():
    picture = card(fill=WHITE)
    drawing = draw(picture)
    assert [shape.fill for shape in drawing.shapes if shape.name != "shadow"] == [(255, 255, 255, 255)] * 2
    assert drawing.shapes[-1].name == "white" and off(drawing, picture).max() <= 3.0


@pytest.mark.slow
def test_cards_of_different_elevation_beside_each_other():
    boxes, shades = [(20, 40, 80, 100), (115, 40, 175, 100)], [(0, 2, 2.0, 0.25), (0, 9, 9.0, 0.3)]
    picture = np.full((HEIGHT, WIDTH, 3), 250.0)
    for place, shade in zip(boxes, shades, strict=True):
        shape = box(*place, 6.0)
        picture = over(over(picture, shadow(shape, *shade), (0, 0, 0)), shape, WHITE)
    found = lifted(levels_of(stored(picture)))
    for cast, place, (_, dy, sigma, alpha) in zip(found.shadow.casts, boxes, shades, strict=True):
        (layer,) = cast.layers
        own = layer.of(cast.box)
        assert (own.left, own.top) == pytest.approx((place[0], place[1] + dy), abs=1.0)
        assert layer.sigma == pytest.approx(sigma, rel=0.15) and layer.alpha == pytest.approx(alpha, rel=0.15)


@pytest.mark.slow
def test_a_button_on_a_card_each_with_its_own_shadow():
    lower, upper = box(40, 30, 160, 110, 8.0), box(70, 70, 130, 92, 11.0)
    picture = over(np.full((HEIGHT, WIDTH, 3), 225.0), shadow(lower, 0, 6, 8, 0.3), (0, 0, 0))
    picture = over(over(picture, lower, WHITE), shadow(upper, 0, 2, 3, 0.3), (0, 0, 0))
    picture = stored(over(picture, upper, BLUE))
    drawing = draw(picture)
    names = [shape.name == "shadow" for shape in drawing.shapes]
    fills = [shape.fill[:3] for shape in drawing.shapes if shape.name != "shadow"]
    assert fills == [(225, 225, 225), WHITE, BLUE]
    # Shadow, card, shadow, button, from below.
    assert sum(one != other for one, other in pairwise(names)) == 4 and not names[0] and not names[-1]
    gap = np.abs(drawn(drawing) - 255 * picture).max(axis=2)
    assert np.percentile(gap, 99) <= 3.0


@pytest.mark.slow
def test_a_dark_small_shadow_with_sharp_corners():
    picture = card(radius=0.0, shade=(2.0, 4.0, 3.0, 0.4))
    (cast,) = lifted(levels_of(picture)).shadow.casts
    (layer,) = cast.layers
    assert layer.sigma == pytest.approx(3.0, rel=0.1) and layer.alpha == pytest.approx(0.4, rel=0.1)
    assert (layer.dx, layer.dy) == pytest.approx((2.0, 4.0), abs=0.75)


@pytest.mark.slow
def test_a_coloured_shadow():
    picture = card(shade=(0.0, 6.0, 9.0, 0.4), colour=BLUE)
    drawing = draw(picture)
    assert len(shadows(drawing)) >= 6 and off(drawing, picture).max() <= 3.0


def test_the_shadow_of_a_circle_is_one_gradient():
    shape = box(60, 35, 140, 115, 40.0)
    picture = over(over(np.full((HEIGHT, WIDTH, 3), 255.0), shadow(shape, 2, 6, 7, 0.3), (0, 0, 0)), shape, BLUE)
    drawing = draw(stored(picture))
    (one,) = shadows(drawing)
    assert isinstance(one.gradient, RadialGradient) and len(drawing.shapes) == 3


@pytest.mark.slow
def test_two_layers_as_pages_have_them():
    shape = box(*CARD, 8.0)
    dark = 1 - (1 - shadow(shape, 0, 9, 9, 0.16)) * (1 - shadow(shape, 0, 2, 2.5, 0.14))
    picture = over(over(np.full((HEIGHT, WIDTH, 3), 248.0), dark, (0, 0, 0)), shape, WHITE)
    found = lifted(levels_of(stored(picture)))
    assert found.shadow is not None and [len(cast.layers) for cast in found.shadow.casts] == [2]


@pytest.mark.parametrize("kind", rest_slow("glow", "plain", "ramp"))
def test_cards_and_gradients_without_a_shadow_stay_as_they_are(kind):
    shape = box(*CARD, 8.0)
    plain = over(np.full((HEIGHT, WIDTH, 3), 240.0), shape, BLUE)
    ramp = np.linspace(120.0, 250.0, WIDTH)[None, :, None] * np.ones((HEIGHT, 1, 3))
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    glow = 255.0 - 120.0 * np.clip(1.0 - np.hypot(x - 100, y - 70) / 60.0, 0.0, 1.0)[..., None] * np.array([0, 1, 1])
    pictures = {"plain": plain, "ramp": over(ramp, shape, BLUE), "glow": over(glow, box(90, 60, 110, 80), BLUE)}
    levels = levels_of(stored(pictures[kind]))
    found = lifted(levels)
    assert found.shadow is None and found.levels is levels


@pytest.mark.slow
def test_a_shadow_takes_no_more_shapes_than_there_may_be():
    drawing = draw(card(shade=(0.0, 2.0, 2.0, 0.3)), ArtworkSettings(curves=6))
    assert len(drawing.shapes) <= 6 and not shadows(drawing)


@pytest.mark.parametrize("settings", rest_slow(ArtworkSettings(stacking="cutout"), ArtworkSettings(colors=6)))
def test_no_gradients_where_shapes_abut_or_fills_are_chosen(settings):
    assert not shadows(draw(card(shade=(0.0, 2.0, 2.0, 0.3)), settings))


def star(points: int = 5, far: float = 55.0, near: float = 24.0) -> np.ndarray:
    """(H, W) coverage of a star."""
    turns = np.arange(2 * points) * np.pi / points - np.pi / 2
    radii = np.where(np.arange(2 * points) % 2, near, far)
    corners = np.stack([95 + radii * np.cos(turns), 70 + radii * np.sin(turns)], axis=1) * FINE
    image = Image.new("L", (WIDTH * FINE, HEIGHT * FINE))
    ImageDraw.Draw(image).polygon([tuple(corner) for corner in corners.tolist()], fill=1)
    return np.asarray(image, dtype=float).reshape(HEIGHT, FINE, WIDTH, FINE).mean(axis=(1, 3))


def test_the_shadow_of_any_outline_is_even_shapes_within_each_other():
    shape, dark = star(), shadow(star(), 2.0, 5.0, 6.0, 0.4)
    alpha = 1.0 - (1.0 - shape) * (1.0 - dark)
    picture = stored(np.dstack([shape[..., None] * BLUE, 255 * alpha]), 2)
    drawing = draw(picture)
    steps = shadows(drawing)
    assert len(drawing.shapes) == len(steps) + 1 and all(one.fill[:3] == (0, 0, 0) for one in steps)
    gap = np.abs(drawn(drawing) - 255 * (picture[..., :3] + 1 - picture[..., 3:])).max(axis=2)
    assert np.percentile(gap, 99) <= 8.0 and (gap**2).mean() <= 3.0


def test_what_a_shadow_of_any_outline_is_made_of():
    shape = star()
    picture = over(over(np.full((HEIGHT, WIDTH, 3), 255.0), shadow(shape, 2.0, 5.0, 4.0, 0.4), (0, 0, 0)), shape, BLUE)
    levels = levels_of(stored(picture))
    found = lifted(levels)
    (area,) = found.areas
    assert (area.colour == [0, 0, 0, 255]).all() and not (area.mask & (shape > 0.99)).any()
    assert np.abs(area.share - shadow(shape, 2.0, 5.0, 4.0, 0.4))[area.mask].max() <= 0.01
    plain = over(np.full((HEIGHT, WIDTH, 3), 255.0), shape, BLUE)
    assert np.percentile(np.abs(found.levels[..., :3] - plain), 99) <= 8.0


@pytest.mark.parametrize("shade", [(4.0, 4.0, 4.0, 0.6), (2.0, 5.0, 4.0, 0.4)])
def test_a_grey_shadow_on_nothing_is_one_area_on_all_sides_of_its_caster(shade):
    shape, dark = star(), shadow(star(), *shade)
    # Programs that cut decimals off premultiplied colours make pale pixels darker.
    grey = np.floor(120.0 * dark * (1.0 - shape))
    alpha = np.rint(255.0 * (1.0 - (1.0 - shape) * (1.0 - dark)))
    levels = np.dstack([shape[..., None] * BLUE + grey[..., None], alpha]).astype(np.float32)
    (area,) = lifted(levels).areas
    assert np.abs(area.colour - [120, 120, 120, 255]).max() <= 8.0
    assert np.abs(area.share - dark)[area.mask].max() <= 0.02


def open_ring() -> np.ndarray:
    """(H, W) a ring with a bar across its middle and a mouth below, as of a letter e."""
    ring = box(45, 20, 125, 120, 40.0) - box(65, 40, 105, 100, 20.0)
    return np.clip(ring + box(60, 62, 115, 75) - box(95, 75, 126, 88), 0.0, 1.0)


@pytest.mark.parametrize(
    ("shape", "ground", "colour", "shade", "seen", "error"),
    [
        (star, (255, 255, 255), (32, 32, 96), (6.0, 8.0, 8.0, 0.6), 0.98, 0.02),
        (open_ring, (255, 251, 232), (96, 32, 128), (4.0, 6.0, 4.0, 0.6), 0.94, 0.03),
    ],
)
def test_a_shadow_of_which_pale_pixels_lose_their_colour_is_one_area_without_specks(
    shape, ground, colour, shade, seen, error
):
    """Filters of SVG blur in linear light, and round premultiplied colours there, unless told otherwise."""
    form, dark, opacity = shape(), shadow(shape(), *shade), shade[3]
    alpha = np.rint(255.0 * dark / opacity)
    light = np.rint(light_of_srgb(np.array(colour) / 255.0) * alpha[..., None])
    share = np.clip(light / np.maximum(alpha, 1.0)[..., None], 0.0, 1.0)
    shaded = ground + opacity * alpha[..., None] * (srgb_of_light(share) - np.array(ground) / 255.0)
    levels = np.rint(shaded * (1.0 - form[..., None]) + BLUE * form[..., None])
    levels = np.dstack([levels, np.full(dark.shape, 255.0)]).astype(np.float32)
    (area,) = lifted(levels).areas
    shown = (form == 0.0) & (alpha > 4.0)
    assert area.mask[shown].mean() > seen
    gap = np.abs(area.share * area.scale / np.abs(np.array(ground) - colour).max() - dark)
    assert gap[shown & area.mask].max() <= 0.02 and np.percentile(gap[shown], 99) <= error


@pytest.mark.slow
def test_a_glow_is_opaque_and_goes_through_holes():
    ring = box(40, 25, 140, 125, 20.0) - box(66, 51, 114, 99, 8.0)
    night, gold = (16, 20, 48), (255, 226, 122)
    dark = np.zeros((HEIGHT, WIDTH, 3)) + night
    picture = stored(over(over(dark, shadow(ring, 0.0, 0.0, 6.0, 0.9), (255, 157, 0)), ring, gold))
    drawing = draw(picture)
    assert shadows(drawing) and all(one.fill[3] == 255 for one in drawing.shapes)
    gap = np.abs(drawn(drawing) - 255 * picture).max(axis=2)
    assert gap[60:90, 75:105].max() <= 6.0 and np.percentile(gap, 99) <= 8.0


def blot() -> np.ndarray:
    """(H, W) a soft area that no blurred box, and no copy of anything else in a picture, makes."""
    bent = np.clip(box(40, 30, 160, 70, 20.0) + box(40, 30, 90, 125, 20.0), 0.0, 1.0)
    return shadow(bent, 0.0, 0.0, 9.0, 0.6)


def test_a_soft_area_of_free_form_over_nothing_is_few_even_shapes():
    shape = box(100, 60, 130, 110, 6.0)
    alpha = 1.0 - (1.0 - shape) * (1.0 - blot())
    picture = stored(np.dstack([shape[..., None] * BLUE, 255 * alpha]), 2)
    drawing = draw(picture)
    steps = shadows(drawing)
    assert 10 <= len(steps) <= 120 and len(drawing.shapes) == len(steps) + 1
    gap = np.abs(drawn(drawing) - 255 * (picture[..., :3] + 1 - picture[..., 3:])).max(axis=2)
    assert np.percentile(gap, 99) <= 6.0 and (gap**2).mean() <= 8.0


def test_a_light_of_free_form_on_a_colour_is_few_even_shapes():
    picture = over(np.zeros((HEIGHT, WIDTH, 3)) + BLUE, blot(), (255, 255, 160))
    picture = stored(over(picture, box(20, 60, 60, 110, 6.0), (220, 40, 40)), 2)
    drawing = draw(picture)
    steps = shadows(drawing)
    assert 10 <= len(steps) <= 120 and len(drawing.shapes) == len(steps) + 2
    gap = np.abs(drawn(drawing) - 255 * picture).max(axis=2)
    assert np.percentile(gap, 99) <= 6.0 and (gap**2).mean() <= 3.0


def test_soft_areas_are_not_taken_for_ringing():
    picture = over(np.full((HEIGHT, WIDTH, 3), 250.0), blot(), (120, 40, 20))
    prepared = analysed(stored(over(picture, star(), BLUE)))
    assert prepared.condition.clean


def test_lights_that_would_shine_beyond_their_ground_are_left_alone():
    heart = star(far=60.0, near=45.0)
    light = np.clip(shadow(box(20, 20, 95, 60, 10.0) + box(20, 20, 60, 120, 10.0), 0.0, 0.0, 7.0, 0.7), 0.0, 0.7)
    picture = over(np.zeros((HEIGHT, WIDTH, 3)) + BLUE, heart, (180, 20, 30))
    picture += (heart * light)[..., None] * (255.0 - picture)
    picture = stored(picture, 2)
    gap = np.abs(drawn(draw(picture)) - 255 * picture).max(axis=2)
    assert gap[heart.reshape(75, 2, 100, 2).max(axis=(1, 3)) == 0.0].mean() <= 2.0


def test_a_soft_area_that_explains_its_picture_worse_is_left_out():
    """Where it shows through small holes alone, what it is between them is a guess."""
    y, x = np.mgrid[:110, :120]
    disc = ((x - 75) / 30.0) ** 2 + ((y - 70) / 25.0) ** 2 < 1.0
    picture = over(np.full((110, 120, 3), 255.0), ndimage.gaussian_filter(disc.astype(float), 5.0), (70, 70, 70))
    lattice = (((x + y) % 7 < 4) | ((x - y) % 7 < 4)) & (np.abs(x - 70) < 16) & (np.abs(y - 66) < 17)
    picture[lattice] = (120, 70, 30)
    picture = stored(picture)
    assert lifted(np.dstack([255 * picture, np.full(disc.shape, 255.0)]).astype(np.float32)).areas
    drawing = draw(picture)
    assert not shadows(drawing)
    assert ((drawn(drawing) - 255 * picture) ** 2).mean() <= 10.0


@pytest.mark.parametrize("fill", rest_slow((BLUE,), ((0, 0, 0),)))
def test_what_is_opaque_and_fades_to_nothing_is_no_shadow(fill):
    alpha = np.clip(1.0 - blot() / 0.6, 0.0, 1.0)
    picture = stored(255 * np.dstack([alpha[..., None] * np.array(fill) / 255, alpha]), 2)
    assert not lifted(255 * picture)
    assert draw(picture).shapes


def test_no_sketch_without_its_shadow_is_shown():
    """It would be far from its picture, and end the drawing for a photo."""
    sketches: list[Drawing] = []
    drawing = next(versions(starred(star()), on_sketch=sketches.append))
    assert [len(shadows(sketch)) for sketch in sketches] == [len(shadows(drawing))] != [0]


def jpeg_of(picture: np.ndarray, quality: int = 85) -> Picture:
    """The JPEG file of a picture (H, W, 3) in [0, 1], as read."""
    return as_picture(encode(Image.fromarray(np.rint(255 * picture).astype(np.uint8)), "JPEG", quality=quality))


def starred(shape: np.ndarray, ground=WHITE, colour=(0, 0, 0), shade=(3.0, 6.0, 6.0, 0.5)) -> np.ndarray:
    """(H, W, 3) float32: a red star with a white spot and a soft shadow or light."""
    picture = over(np.zeros((HEIGHT, WIDTH, 3)) + ground, shadow(shape, *shade), colour)
    return stored(over(over(picture, shape, (211, 47, 47)), box(88, 62, 102, 80), WHITE))


@pytest.mark.parametrize(
    ("ground", "colour", "shade"),
    rest_slow((WHITE, (0, 0, 0), (3.0, 6.0, 6.0, 0.5)), ((20, 60, 160), WHITE, (0.0, 0.0, 8.0, 0.7))),
)
def test_a_shadow_in_a_jpeg_is_found_as_it_was_made(ground, colour, shade):
    shape = star()
    read = jpeg_of(starred(shape, ground, colour, shade))
    prepared = analysed(read.target(), read.compression)
    assert not prepared.condition.blur, "what is soft is no blur of the picture"
    found = noisy_lifted(prepared.levels, prepared.condition)
    (area,) = found.areas
    assert np.abs(area.colour[:3] - colour).max() <= 24.0
    seen = np.abs(area.share - shadow(shape, *shade)) * area.scale
    assert np.percentile(seen[area.mask], 99) <= 8.0 and not (area.mask & (shape > 0.99)).any()
    lit = over(np.zeros((HEIGHT, WIDTH, 3)) + ground, shape, (211, 47, 47))
    gap = np.abs(found.levels[..., :3] - lit)[shape < 0.01].max(axis=1)
    assert (gap > 8.0).mean() <= 0.05


def test_a_shadow_in_a_jpeg_is_drawn_without_bands():
    picture = starred(star())
    read = jpeg_of(picture)
    drawing = draw(read.target(), prepared=prepare(read.target(), read.compression))
    steps = shadows(drawing)
    assert len(steps) >= 8 and len(drawing.shapes) <= len(steps) + 5
    gap = np.abs(drawn(drawing) - 255 * picture).max(axis=2)
    assert np.percentile(gap, 97) <= 10.0 and gap[66:76, 92:98].max() <= 3.0, "the spot has not the ground's shade"


@pytest.mark.parametrize("quality", rest_slow(0, 90))
def test_shadows_tell_the_order_of_layered_papers(quality):
    """Their edges tell nothing, and in a JPEG a shade of one paper may go over into the next."""
    papers = [(208, 232, 243), (143, 185, 204), (79, 143, 168), (200, 90, 60)]
    picture = np.zeros((HEIGHT, WIDTH, 3)) + papers[0]
    y, x = (np.mgrid[: HEIGHT * FINE, : WIDTH * FINE] + 0.5) / FINE
    for k, fill in enumerate(papers[1:]):
        below = y > 30.0 + 36.0 * k + 8.0 * np.sin(x / 25.0 + k)
        paper = below.reshape(HEIGHT, FINE, WIDTH, FINE).mean(axis=(1, 3))
        dark = shadow(np.pad(paper, ((0, 40), (40, 40)), mode="edge"), 0.0, 0.0, 4.0, 0.35)[:HEIGHT, 40:-40]
        picture = over(over(picture, dark, (0, 0, 0)), paper, fill)
    picture = stored(picture)
    read = jpeg_of(picture, quality) if quality else None
    target = read.target() if read else picture
    drawing = draw(target, prepared=prepare(target, read.compression if read else None))
    plain = [one for one in drawing.shapes if one.name != "shadow"]
    assert len(plain) == len(papers) and len(shadows(drawing)) >= 9
    for one, fill in zip(plain, papers, strict=True):
        assert np.abs(np.subtract(one.fill[:3], fill)).max() <= (3 if quality else 0)
    gap = np.abs(drawn(drawing) - 255 * picture).max(axis=2)
    assert np.percentile(gap, 97) <= 10.0


def test_a_jpeg_without_a_shadow_is_left_as_it_is():
    for picture in (
        card(shade=(0.0, 0.0, 1.0, 0.0)),
        stored(np.linspace(60, 200, WIDTH)[None, :, None] * np.ones((HEIGHT, 1, 3))),
    ):
        read = jpeg_of(picture, 75)
        prepared = analysed(read.target(), read.compression)
        found = noisy_lifted(prepared.levels, prepared.condition)
        assert not found and found.levels is prepared.levels
