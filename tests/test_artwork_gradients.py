"""Gradients in drawings whose truth is known: their kind, geometry, stops, and no bands."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import rest_slow
from scipy import ndimage
from skimage.data import astronaut

from cubicsplat_cli.artwork.finish.colours import recoloured
from cubicsplat_cli.artwork.geometry.outlines import Circle, Rectangle
from cubicsplat_cli.artwork.gradients.areas import _largest, gradient_areas, with_tips
from cubicsplat_cli.artwork.gradients.flattening import Flattened
from cubicsplat_cli.artwork.gradients.layers import Between, with_layers
from cubicsplat_cli.artwork.gradients.parts import Part, Patch, smooth_parts
from cubicsplat_cli.artwork.gradients.shade import gradient_of
from cubicsplat_cli.artwork.gradients.shades import shade_of
from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.artwork.style import choose_style
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.raster.shades import Pixels
from cubicsplat_cli.scene.paint import LinearGradient, RadialGradient, Stop, painted
from cubicsplat_cli.svg.drawing_writer import write_drawing

WIDTH, HEIGHT = 256, 192


def svg(body: str) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" viewBox="0 0 256 192">{body}</svg>'
    )


def straight(text: str) -> np.ndarray:
    return np.asarray(rerender(text.encode(), WIDTH, HEIGHT, renderer="resvg").pixels)


def picture(body: str) -> np.ndarray:
    """(H, W, 4) premultiplied float32."""
    pixels = straight(svg(body)).astype(np.float32) / 255
    pixels[..., :3] *= pixels[..., 3:]
    return pixels


def difference(drawing, body: str) -> np.ndarray:
    """(H, W) levels by which the file and the truth differ over white."""
    text = write_drawing(drawing, title="t", comment="c")
    files = [straight(t).astype(float) for t in (text, svg(body))]
    over = [f[..., :3] * f[..., 3:] / 255 + 255 - f[..., 3:] for f in files]
    return np.abs(over[0] - over[1]).max(axis=2)


LINEAR = '<linearGradient id="a" x1="40" y1="30" x2="200" y2="150" gradientUnits="userSpaceOnUse">{}</linearGradient>'
TWO = '<stop stop-color="#d0202c"/><stop offset="1" stop-color="#2850c8"/>'
THREE = (
    '<stop offset=".1" stop-color="#ffe040"/><stop offset=".4" stop-color="#f09020"/>'
    '<stop offset="1" stop-color="#c03060"/>'
)
ROUND = '<radialGradient id="a" cx="120" cy="80" r="110" gradientUnits="userSpaceOnUse">{}</radialGradient>'
OVAL = (
    '<radialGradient id="a" cx="0" cy="0" r="1" gradientTransform="matrix(90 30 -15 45 120 90)" '
    'gradientUnits="userSpaceOnUse">{}</radialGradient>'
)
BLOB = '<path fill="url(#a)" d="M30 90C30 40 80 20 130 20s100 30 100 80-60 80-110 80S30 140 30 90z"/>'
GROUND = '<rect width="256" height="192" fill="#103050"/>'


def test_a_linear_gradient_over_a_ground():
    body = LINEAR.format(TWO) + GROUND + BLOB
    drawing = draw(picture(body))
    ground, blob = drawing.shapes
    assert ground.gradient is None and ground.fill == (16, 48, 80, 255)
    found = blob.gradient
    assert isinstance(found, LinearGradient) and len(found.stops) == 2
    angle = math.atan2(found.y2 - found.y1, found.x2 - found.x1) % math.pi
    assert angle == pytest.approx(math.atan2(120, 160), abs=0.003)
    truth = LinearGradient(40, 30, 200, 150, (Stop(0.0, (208, 32, 44, 255)), Stop(1.0, (40, 80, 200, 255))))
    x, y = np.array([60.0, 130.0, 200.0]), np.array([80.0, 100.0, 120.0])
    assert 255 * np.abs(painted(found, x, y) - painted(truth, x, y)).max() < 1.0
    assert np.percentile(difference(drawing, body), 99) <= 2 and difference(drawing, body).mean() < 0.4


@pytest.mark.parametrize(
    ("markup", "kind"), rest_slow((OVAL, RadialGradient), (LINEAR, LinearGradient), (ROUND, RadialGradient))
)
def test_three_stops_of_every_kind(markup, kind):
    body = markup.format(THREE) + BLOB
    drawing = draw(picture(body))
    (shape,) = drawing.shapes
    assert isinstance(shape.gradient, kind)
    # The stop in the middle, and the padded end where it shows, are stops of their own.
    fills = np.array([stop.colour for stop in shape.gradient.stops])
    assert len(fills) <= 4 and np.abs(fills - (240, 144, 32, 255)).max(axis=1).min() <= 2
    assert np.percentile(difference(drawing, body), 99) <= 3 and difference(drawing, body).mean() < 0.4


def test_a_gradient_goes_on_into_tips_that_are_too_thin_to_be_seen_as_even():
    body = LINEAR.format(TWO) + GROUND + '<path fill="url(#a)" d="M20 96L120 84L252 60L130 110L60 180z"/>'
    drawing = draw(picture(body))
    _, shape = drawing.shapes
    assert isinstance(shape.gradient, LinearGradient)
    assert difference(drawing, body).mean() < 0.08


def test_pieces_that_are_too_small_to_show_a_gradient_follow_that_of_a_larger_part():
    pieces = "".join(f'<rect x="236" y="{y}" width="7" height="9" fill="url(#a)"/>' for y in range(20, 164, 16))
    levels = as_levels(picture(ROUND.format(TWO).replace("110", "200") + GROUND + BLOB + pieces))
    areas = gradient_areas(smooth_parts(levels))
    assert len({area.shade for area in areas}) == 1 and len(areas) == 10
    small = [area.patch for area in areas if area.patch.size < 64]
    assert len(small) == 9 and all(236 <= patch.left < 243 for patch in small)


def test_pixels_along_an_edge_of_little_contrast_are_no_tips():
    near = '<rect width="256" height="192" fill="#cb2831"/>'
    stops = '<stop stop-color="#d0202c"/><stop offset="1" stop-color="#b8202c"/>'
    levels = as_levels(picture(LINEAR.format(stops) + near + BLOB))
    parts = smooth_parts(levels)
    areas = gradient_areas(parts)
    sizes = [[area.patch.size for area in each] for each in (areas, with_tips(parts, areas))]
    assert sizes[0] == sizes[1] and len(areas) == 1


def test_a_radial_gradient_has_its_middle_and_radius():
    drawing = draw(picture(ROUND.format(TWO) + BLOB))
    found = drawing.shapes[0].gradient
    assert isinstance(found, RadialGradient)
    assert (found.cx, found.cy) == pytest.approx((120, 80), abs=0.3) and found.rx == pytest.approx(found.ry, rel=0.01)


FOCUS = (
    '<radialGradient id="a" cx="120" cy="90" r="100" fx="{}" fy="{}" gradientUnits="userSpaceOnUse">{}</radialGradient>'
)
FOCAL_OVAL = (
    '<radialGradient id="a" cx="0" cy="0" r="1" fx="{}" fy="{}" gradientTransform="matrix(110 30 -15 60 120 90)" '
    'gradientUnits="userSpaceOnUse">{}</radialGradient>'
)


@pytest.mark.parametrize(("markup", "focus", "px"), [(FOCUS, (80, 60), (80, 60)), (FOCAL_OVAL, (0.5, -0.4), (181, 81))])
def test_a_radial_gradient_has_its_focus(markup, focus, px):
    body = markup.format(*focus, TWO) + BLOB
    drawing = draw(picture(body))
    (shape,) = drawing.shapes
    assert isinstance(shape.gradient, RadialGradient) and shape.gradient.focus == pytest.approx(px, abs=1.0)
    assert np.percentile(difference(drawing, body), 99) <= 2 and difference(drawing, body).mean() < 0.4


def test_the_tip_of_a_sphere_is_the_middle_of_its_gradient():
    stops = '<stop stop-color="#fff"/><stop offset=".4" stop-color="#60a0f0"/><stop offset="1" stop-color="#103070"/>'
    body = '<rect width="256" height="192" fill="#fff"/><circle cx="128" cy="96" r="70" fill="url(#a)"/>'
    drawing = draw(picture(ROUND.replace("110", "100").format(stops) + body))
    ground, sphere = drawing.shapes
    assert ground.gradient is None and 3 <= len(sphere.gradient.stops) <= 4
    first = sphere.gradient.stops[0]
    assert first.offset == 0.0 and min(first.colour) >= 250


def test_what_lies_over_a_gradient_does_not_divide_it():
    bars = '<path fill="#fff" d="M90 0h14v192H90zM150 0h10v192h-10z"/><circle cx="60" cy="90" r="12" fill="#222"/>'
    body = ROUND.format(TWO) + '<circle cx="128" cy="96" r="80" fill="url(#a)"/>' + bars
    drawing = draw(picture(body))
    assert len({shape.gradient for shape in drawing.shapes if shape.gradient}) == 1
    assert len(drawing.shapes) <= 6 and difference(drawing, body).mean() < 0.6


@pytest.mark.slow
def test_a_thin_line_between_a_gradient_and_a_fill_keeps_its_colour():
    # Its pixels are within 24 levels of blends of the two, and are none.
    ends = '<stop stop-color="#efefef"/><stop offset="1" stop-color="#d8d8d8"/>'
    body = f'<defs>{LINEAR.format(ends)}</defs><path d="M0 0H256V100H0z" fill="url(#a)"/>'
    body += '<path d="M0 100H256V192H0z" fill="#543930"/>'
    body += '<path d="M20 90Q128 106 236 92" stroke="#c0c8d0" stroke-width="2" fill="none"/>'
    off = difference(draw(picture(body)), body)
    assert (off > 16.0).sum() <= 8
    assert off.mean() < 0.035


@pytest.mark.slow
def test_two_gradients_that_touch():
    other = LINEAR.replace('"a"', '"b"').replace('y2="150"', 'y2="31"').format(THREE)
    body = ROUND.format(TWO) + other + '<rect width="256" height="192" fill="url(#b)"/>'
    body += '<circle cx="128" cy="96" r="70" fill="url(#a)"/>'
    drawing = draw(picture(body))
    back, front = drawing.shapes
    assert isinstance(back.gradient, LinearGradient) and isinstance(back.outlines[0], Rectangle)
    assert isinstance(front.gradient, RadialGradient) and isinstance(front.outlines[0], Circle)
    assert front.outlines[0].r == pytest.approx(70, abs=0.1)
    assert difference(drawing, body).mean() < 0.5


def test_a_soft_shadow_over_nothing_has_no_rings():
    stops = (
        '<stop offset=".3" stop-color="#000" stop-opacity=".5"/><stop offset="1" stop-color="#000" stop-opacity="0"/>'
    )
    shadow = ROUND.replace("80", "130").replace("110", "60").format(stops)
    body = shadow + '<ellipse cx="120" cy="130" rx="60" ry="60" fill="url(#a)"/>'
    body += '<circle cx="120" cy="70" r="45" fill="#e04040"/>'
    drawing = draw(picture(body))
    assert len(drawing.shapes) == 2
    shade = drawing.shapes[0].gradient
    assert isinstance(shade, RadialGradient) and shade.stops[-1].colour[3] == 0
    assert {stop.colour[:3] for stop in shade.stops} == {(0, 0, 0)}
    assert shade.stops[0].colour[3] == pytest.approx(127, abs=2)
    assert difference(drawing, body).max() < 40 and difference(drawing, body).mean() < 0.4


@pytest.mark.slow
def test_a_glow_that_fades_into_the_ground_is_part_of_it():
    stops = '<stop stop-color="#fff0a0"/><stop offset="1" stop-color="#103050"/>'
    body = ROUND.format(stops) + GROUND + '<circle cx="120" cy="80" r="110" fill="url(#a)"/>'
    drawing = draw(picture(body))
    assert len(drawing.shapes) <= 2 and len(drawing.gradients) == 1
    assert np.percentile(difference(drawing, body), 99) <= 2


def test_flat_drawings_have_no_gradients_and_are_left_as_they_are():
    body = GROUND + '<circle cx="120" cy="80" r="60" fill="#e04040"/><path d="M0 150 256 90v9L0 160z" fill="#e8e8e8"/>'
    levels = as_levels(picture(body))
    assert gradient_areas(smooth_parts(levels)) == []


@pytest.mark.slow
def test_who_chooses_the_fills_gets_no_gradients():
    target = picture(LINEAR.format(TWO) + BLOB)
    assert not draw(target, ArtworkSettings(colors=6)).gradients
    assert not draw(target, ArtworkSettings(palette=((255, 0, 0), (0, 0, 255)))).gradients


@pytest.mark.parametrize("body", ['<rect width="256" height="192" fill="url(#a)"/>', GROUND + BLOB])
@pytest.mark.parametrize("markup", [LINEAR, ROUND], ids=["linear", "round"])
def test_drawings_of_gradients_are_artwork(markup, body):
    style = choose_style(picture(markup.format(THREE) + body))
    assert style.name == "artwork", style.reason


@pytest.mark.slow
def test_a_steep_gradient_is_no_blur():
    drawing = draw(picture(ROUND.format(THREE) + GROUND + BLOB))
    ground, blob = drawing.shapes
    assert ground.fill == (16, 48, 80, 255) and isinstance(blob.gradient, RadialGradient)


@pytest.mark.slow
def test_smooth_photos_are_no_gradients():
    photo = ndimage.gaussian_filter(astronaut()[:300, 100:300].astype(np.float32) / 255, (3, 3, 0))
    assert choose_style(photo).name == "photo"


def test_a_search_ends_where_nothing_is_a_gradient():
    waves = np.cumsum(np.random.default_rng(0).normal(size=(2, 160, 200)), axis=2).cumsum(axis=1)
    smooth = ndimage.gaussian_filter(waves, (0, 12, 12))
    levels = as_levels(np.stack([*smooth, smooth[0]], axis=-1) / np.abs(smooth).max())
    assert len(gradient_areas(smooth_parts(levels), tries=1)) <= 1


def test_of_two_gradients_of_a_place_the_one_that_explains_more_is_kept():
    # The second search, among more pixels, may come upon another geometry.
    x = np.tile(np.arange(40.0), (40, 1))
    levels = np.stack([20.0 + 4.0 * x, 200.0 - 3.0 * x, 0.0 * x, 0.0 * x + 255.0], axis=2).astype(np.float32)
    part = Part(levels, Patch(0, 0, np.ones((40, 40), dtype=bool)))
    good, bad = (shade_of(Pixels(*part.pixels[:2], part.pixels[2] + off)) for off in (0.0, 40.0))

    shades = [good, good, good, bad]
    search: Any = SimpleNamespace(found=[], shade=lambda _: shades.pop(0))
    _largest(part, search, 0)
    assert [area.shade for area in search.found] == [good]
    assert search.found[0].patch.mask.all()


def test_stops_are_found_where_they_are():
    y, x = np.mgrid[:120, :160] + 0.5
    truth = LinearGradient(0, 0, 160, 0, tuple(Stop(o, (v, 100, 50, 255)) for o, v in ((0, 20), (0.3, 200), (1, 90))))
    levels = np.rint(255 * painted(truth, x, y))
    shade = shade_of(Pixels(x.ravel(), y.ravel(), levels.reshape(-1, 4)))
    found = gradient_of(shade)
    assert (found.y1, found.y2) == (0.0, 0.0)
    ends = [found.x1 + stop.offset * (found.x2 - found.x1) for stop in found.stops]
    assert len(ends) == 3 and sorted(ends)[1] == pytest.approx(48, abs=0.5)
    assert max(abs(a - b) for a, b in zip(found.stops[1].colour, (200, 100, 50, 255), strict=True)) <= 1


@pytest.mark.slow
def test_a_gradient_with_a_light_on_it_and_little_that_is_even_is_one():
    """The even rim is too small a part of it for the rest to be looked at as something else."""
    y, x = np.mgrid[:200, :200] + 0.5
    far = np.clip(np.hypot(x - 120.0, y - 120.0) / 126.0, 0.0, 1.0)[..., None]
    colours = np.array([220.0, 94.0, 0.0]) * (1.0 - far) + np.array([228.0, 142.0, 23.0]) * far
    light = 0.5 * np.clip(1.0 - np.hypot((x - 55.0) / 35.0, (y - 70.0) / 45.0), 0.0, 1.0)[..., None]
    levels = np.rint(np.concatenate([colours + light * (255.0 - colours), np.full((200, 200, 1), 255.0)], axis=2))
    areas = gradient_areas(smooth_parts(levels.astype(np.float32)))
    assert max((area.patch.size for area in areas), default=0) > 20_000


def test_a_small_light_on_a_ball_is_one_gradient():
    """It changes by 14 levels a px, and its circles bend it by more than rounding does."""
    stops = '<stop stop-color="#fff"/><stop offset="1" stop-color="#301800"/>'
    body = f'<radialGradient id="a" cx="50" cy="40" r="15" gradientUnits="userSpaceOnUse">{stops}</radialGradient>'
    body += '<circle cx="50" cy="42" r="24" fill="url(#a)" stroke="#000" stroke-width="3"/>'
    drawing = draw(picture(body))
    assert len(drawing.shapes) <= 3 and any(isinstance(each, RadialGradient) for each in drawing.gradients)
    assert np.percentile(difference(drawing, body), 99) <= 4.0


def leaking() -> tuple[Drawing, np.ndarray]:
    """A gradient, and a bar of another fill on it than its picture (H, W, 4) has, premultiplied levels."""
    ground = LinearGradient(0.0, 0.0, 64.0, 0.0, (Stop(0.0, (0, 0, 0, 255)), Stop(1.0, (0, 0, 200, 255))))
    shapes = [
        Shape((0, 0, 100, 255), (Rectangle(0.0, 0.0, 64.0, 48.0),), "", ground),
        Shape((90, 40, 60, 255), (Rectangle(20.25, 10.0, 3.0, 30.0),), ""),
    ]
    right = Drawing(64, 48, (shapes[0], replace(shapes[1], fill=(40, 40, 60, 255))))
    return Drawing(64, 48, tuple(shapes)), np.rint(255.0 * render_scene(scene_of(right)))


def test_shapes_beside_a_gradient_have_nothing_of_what_stood_for_it():
    drawing, levels = leaking()
    assert recoloured(drawing, levels, None).shapes[1].fill == (40, 40, 60, 255)
    right = recoloured(drawing, levels, None)
    assert recoloured(right, levels, None) == right


def test_a_shape_gets_a_gradient_that_it_lacks_and_a_fill_for_one_that_is_not_its_own():
    drawing, levels = leaking()
    ground, bar = drawing.shapes
    flat = replace(drawing, shapes=(ground.filled((0, 0, 100, 255), 64, 48), bar))
    found = recoloured(flat, levels, None)
    # A fill that no gradient is beside has no part of one.
    assert found.shapes[1] == bar
    assert recoloured(flat, levels, None, simpler=True) == flat
    assert np.abs(255.0 * render_scene(scene_of(found)) - levels)[:, :20].max() <= 2.0
    # Another shape has the gradient already.
    half = Rectangle(32.0, 0.0, 32.0, 48.0)
    found = recoloured(replace(drawing, shapes=(ground, replace(flat.shapes[0], outlines=(half,)))), levels, None)
    assert found.shapes[1].gradient == ground.gradient
    wrong = replace(bar, gradient=ground.gradient)
    found = recoloured(replace(drawing, shapes=(ground, wrong)), levels, None)
    assert found.shapes[0] == ground
    assert (found.shapes[1].gradient, found.shapes[1].fill) == (None, (40, 40, 60, 255))


def test_a_damaged_picture_adds_no_gradients():
    drawing, levels = leaking()
    flat = replace(drawing, shapes=(drawing.shapes[0].filled((0, 0, 100, 255), 64, 48), drawing.shapes[1]))
    assert recoloured(flat, levels, Flattened(levels)) is flat


def test_a_damaged_picture_changes_fills_only_by_what_stood_for_its_gradients():
    drawing, levels = leaking()
    gradient = drawing.shapes[0].gradient
    assert gradient is not None
    for placeholder, fill in (((150, 0, 67, 255), (40, 40, 60, 255)), ((0, 150, 67, 255), (90, 40, 60, 255))):
        flat = Flattened(levels, np.array([placeholder], float), ((gradient,),))
        found = np.array(recoloured(drawing, levels, flat).shapes[1].fill)
        assert np.abs(found - fill).max() <= 3


def test_a_rim_of_few_px_has_one_gradient():
    ramp = '<linearGradient id="a" x1="0" y1="8" x2="0" y2="88" gradientUnits="userSpaceOnUse">{}</linearGradient>'
    rim = '<circle cx="60" cy="48" r="37" fill="#383838" stroke="url(#a)" stroke-width="6"/>'
    body = ramp.format('<stop stop-color="#606060"/><stop offset="1" stop-color="#3e3e3e"/>') + GROUND + rim
    drawing = draw(picture(body))
    assert sum(shape.gradient is not None for shape in drawing.shapes) == 1 and len(drawing.shapes) == 3
    assert difference(drawing, body).mean() < 0.1


FADING = (
    '<linearGradient id="b" x1="60" y1="150" x2="120" y2="90" gradientUnits="userSpaceOnUse">'
    '<stop stop-color="#4888e8"/><stop offset="1" stop-color="#4888e8" stop-opacity="0"/></linearGradient>'
    '<radialGradient id="c" cx="190" cy="60" r="90" gradientUnits="userSpaceOnUse"><stop stop-color="#6868b8"/>'
    '<stop offset="1" stop-color="#6868b8" stop-opacity="0"/></radialGradient>'
)
UNDER = BLOB.replace("url(#a)", "#2850c8")


@pytest.mark.parametrize(
    ("markup", "body", "most"),
    [
        (FADING, UNDER + BLOB.replace("#a", "#b") + BLOB.replace("#a", "#c"), 4),
        (LINEAR.format(TWO) + FADING, BLOB + BLOB.replace("#a", "#c"), 3),
    ],
    ids=["two over a fill", "one over another"],
)
def test_gradients_above_one_another_have_the_same_outlines(markup, body, most):
    drawing = draw(picture(markup + GROUND + body))
    assert len([shape for shape in drawing.shapes if shape.box().width * shape.box().height > 100]) <= most
    assert len({id(shape.outlines) for shape in drawing.shapes[1:most]}) == 1
    assert drawing.shapes[1].fill[3] == 255
    assert all(min(stop.colour[3] for stop in shape.gradient.stops) < 8 for shape in drawing.shapes[2:most])
    assert np.percentile(difference(drawing, markup + GROUND + body), 95) <= 2  # as many as layers explain at least


def test_where_shapes_may_not_overlap_no_gradient_is_above_another():
    whole = picture(FADING + GROUND + UNDER + BLOB.replace("#a", "#b") + BLOB.replace("#a", "#c"))
    cutout = draw(whole, ArtworkSettings(stacking="cutout"))
    assert len({id(shape.outlines) for shape in cutout.shapes}) == len(cutout.shapes)
    assert len(draw(whole, ArtworkSettings(curves=3)).shapes) <= 3


def test_a_colour_is_found_where_the_lines_to_it_meet():
    colour, rng = np.array([40.0, 200.0, 90.0]), np.random.default_rng(1)
    below, share = rng.uniform(0.0, 255.0, (400, 3)), rng.uniform(0.2, 0.8, 400)
    y, x = np.divmod(np.arange(400), 20)
    shown = np.column_stack([below + share[:, None] * (colour - below), np.full(400, 255.0)])
    between = Between(Pixels(x + 0.5, y + 0.5, shown), below, shown[:, :3] - below, np.ones(400))
    found = between.likeliest(rng)
    assert found == pytest.approx(colour, abs=0.5)
    shares, on_line = between.shares(colour, 2.0, np.arange(400))
    assert shares == pytest.approx(share)
    assert on_line.all()


def test_a_photo_has_no_layers():
    photo = as_levels(astronaut()[:256, :256] / 255.0)
    assert not [area for area in with_layers(smooth_parts(photo), []) if area.over]
