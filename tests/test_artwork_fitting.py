"""Outlines from sub-pixel boundary points: pieces, corners and primitives against the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from outline_loops import farthest, nearest_primitive
from PIL import Image, ImageDraw, ImageFont

from cubicsplat_cli.artwork import vectorize
from cubicsplat_cli.artwork.geometry.fitting import few_lines, fit_outlines
from cubicsplat_cli.artwork.geometry.outlines import (
    Circle,
    Ellipse,
    Outline,
    Rectangle,
    Ring,
    flattened,
    points_at,
    polygon,
    signed_area,
)
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.load import as_picture
from cubicsplat_cli.progress import Work, under_way
from cubicsplat_cli.raster.borders import border_map
from cubicsplat_cli.raster.outlines import BOX, CIRCLE, ELLIPSE
from cubicsplat_cli.svg.drawing_writer import write_drawing

NOISE = 0.02


def fit_outline(points, sigma, detail=1.0, corners=None):
    points, sigma = np.asarray(points, dtype=float), np.asarray(sigma, dtype=float)
    return fit_outlines([points], [sigma], detail, [np.zeros(len(points), bool) if corners is None else corners])[0]


def sampled(outline: Outline, noise: float = NOISE, seed: int = 0) -> np.ndarray:
    """Points about 1 px apart along an outline, with noise across it."""
    ring = outline.ring()
    fine = np.concatenate([points_at(c, np.linspace(0.0, 1.0, 400, endpoint=False)) for c in ring.cubics])
    loop = np.vstack([fine, fine[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(loop, axis=0).T))])
    count = max(8, round(length[-1]))
    at = (np.arange(count) + 0.37) * length[-1] / count

    def along(s: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(s, length, loop[:, c], period=length[-1]) for c in (0, 1)], axis=1)

    way = along(at + 0.05) - along(at - 0.05)
    way /= np.hypot(*way.T)[:, None]
    across = np.stack([-way[:, 1], way[:, 0]], axis=1)
    return along(at) + np.random.default_rng(seed).normal(0.0, noise, count)[:, None] * across


def fitted(outline: Outline, **options: float) -> Outline:
    points = sampled(outline)
    return fit_outline(points, np.full(len(points), NOISE), **options)


def deviation(fit: Outline, truth: Outline) -> float:
    """Largest distance of the fit from the truth, px."""
    line = flattened(fit.ring(), 0.5)
    return farthest(sampled(truth, noise=0.0), np.vstack([line, line[:1]]))


def star() -> Ring:
    angles = np.arange(10) * math.pi / 5 + 0.1
    radii = np.where(np.arange(10) % 2, 35.0, 80.0)
    return polygon(100.0 + radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1))


@pytest.mark.parametrize(
    "truth",
    [
        Circle(50.2, 40.7, 30.3),
        Ellipse(60.0, 70.0, 50.0, 20.0, 0.3),
        Ellipse(60.0, 70.0, 20.0, 50.0),
        Rectangle(10.3, 20.2, 80.1, 41.3),
        Rectangle(10.3, 20.2, 80.1, 41.3, 8.2),
        Rectangle(40.0, 50.0, 120.0, 60.0, 0.0, 0.3),
        Rectangle(40.0, 50.0, 120.0, 60.0, 12.0, 0.3),
    ],
)
def test_a_primitive_is_found_as_such(truth: Outline) -> None:
    fit = fitted(truth)
    assert type(fit) is type(truth)
    assert fit.parameters == truth.parameters
    assert deviation(fit, truth) < 0.05


def test_a_square_of_nothing_but_round_corners_is_a_circle() -> None:
    """However surely its straight parts of a quarter of a pixel can be told: it looks like a circle."""
    points = sampled(Rectangle(14.0, 15.0, 483.46, 483.38, 241.59, 0.77))
    found = nearest_primitive(points, np.full(len(points), NOISE**-2), 4.0)
    assert found[0] in (CIRCLE, ELLIPSE)


@pytest.mark.parametrize("clockwise", [True, False])
def test_a_loop_there_and_back_is_no_huge_circle(clockwise: bool) -> None:
    there = np.stack([np.arange(57.0) + 87.5, np.full(57, 159.0)], axis=1)
    points = np.concatenate([there, there[::-1] - [0.0, 0.55]])
    fit = fit_outline(points if clockwise else points[::-1], np.repeat([0.25, 0.5], 57))
    assert abs(signed_area(fit.ring())) == pytest.approx(31.0, abs=30.0)
    assert np.ptp(flattened(fit.ring(), 0.5), axis=0) == pytest.approx([56.0, 0.5], abs=3.0)


@pytest.mark.parametrize(("share", "found"), [(0.25, False), (0.45, True)])
def test_an_arc_is_a_circle_from_a_third_of_the_turn_on(share: float, found: bool) -> None:
    truth = Circle(60.0, 60.0, 40.0)
    points = sampled(truth)
    shown = np.abs(np.arctan2(points[:, 1] - 60.0, points[:, 0] - 60.0)) < share * math.pi
    fit = nearest_primitive(points, np.where(shown, NOISE**-2, 0.0), 4.0)
    assert (fit is not None and fit[0] == CIRCLE) == found
    assert found or fit is None or fit[0] == BOX


def test_a_star_has_its_ten_corners_where_they_are() -> None:
    fit = fitted(star())
    assert isinstance(fit, Ring)
    assert fit.pieces == 10 and fit.lines.all()
    away = np.hypot(*np.moveaxis(fit.anchors[:, None] - star().anchors, -1, 0)).min(axis=1)
    assert away.max() < 0.1


def test_a_drop_is_a_corner_and_few_cubics() -> None:
    cubics = np.array(
        [
            [[50.0, 10.0], [60.0, 40.0], [80.0, 50.0], [80.0, 70.0]],
            [[80.0, 70.0], [80.0, 110.0], [20.0, 110.0], [20.0, 70.0]],
            [[20.0, 70.0], [20.0, 50.0], [40.0, 40.0], [50.0, 10.0]],
        ]
    )
    truth = Ring(cubics[:, 0], cubics[:, 1:3], np.zeros(3, bool), np.array([False, True, True]))
    fit = fitted(truth)
    assert isinstance(fit, Ring)
    assert fit.pieces <= 4 and (~fit.smooth).sum() == 1
    assert deviation(fit, truth) < 0.15


def test_a_hidden_stretch_is_bridged_simply() -> None:
    points = sampled(Rectangle(20.0, 20.0, 100.0, 60.0))
    hidden = (points[:, 1] < 30.0) & (points[:, 0] > 50.0) & (points[:, 0] < 80.0)
    points[hidden, 1] += 6.0 * np.sin(points[hidden, 0])
    fit = fit_outline(points, np.where(hidden, np.inf, NOISE))
    assert fit.coordinates <= 6
    assert deviation(fit, Rectangle(20.0, 20.0, 100.0, 60.0)) < 0.1


def test_a_few_points_that_show_between_hidden_ones_are_met() -> None:
    truth = Ellipse(150.0, 150.0, 120.0, 90.0)
    points = sampled(truth)
    hidden = points[:, 1] < 140.0
    shown = np.hypot(*(points - [150.0, 60.0]).T) < 4.0
    points[hidden & ~shown, 1] += 8.0
    fit = fit_outline(points, np.where(hidden & ~shown, np.inf, NOISE))
    assert np.hypot(*(flattened(fit.ring(), 0.2) - [150.0, 60.0]).T).min() < 0.2


def test_more_detail_gives_no_fewer_pieces() -> None:
    angles = np.linspace(0.0, 2.0 * math.pi, 400, endpoint=False)
    radii = 60.0 + 3.0 * np.sin(7.0 * angles)
    points = 100.0 + radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    counts = [fit_outline(points, np.full(400, NOISE), detail=d).parameters for d in (0.1, 1.0, 4.0)]
    assert counts == sorted(counts)


def test_a_smooth_outline_of_many_waves_is_followed_as_well_as_one_of_few() -> None:
    for waves in (6, 60):
        radius = 20.0 * waves / math.pi
        angles = np.linspace(0.0, 2.0 * math.pi, 60 * waves, endpoint=False)
        radii = radius + 4.0 * np.sin(waves * angles)
        points = radius + 10.0 + radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        ring = fit_outline(points, np.full(len(points), NOISE)).ring()
        away = np.hypot(*(flattened(ring, 0.3) - radius - 10.0).T)
        assert np.ptp(away) == pytest.approx(8.0, abs=0.2)
        assert 2 * waves <= ring.pieces <= 6 * waves


def test_the_same_points_give_the_same_outline() -> None:
    one, two = fitted(star()), fitted(star())
    assert isinstance(one, Ring) and isinstance(two, Ring)
    assert one.cubics.tobytes() == two.cubics.tobytes()


def test_outlines_fitted_together_on_any_number_of_threads_are_those_fitted_alone() -> None:
    shapes = [star(), Circle(40.0, 41.0, 30.0), Rectangle(5.3, 6.1, 50.0, 30.0), star()]
    points = [sampled(shape) for shape in shapes]
    sigmas = [np.full(len(each), NOISE) for each in points]
    alone = [fit_outline(*pair) for pair in zip(points, sigmas, strict=True)]
    for threads in (1, 3):
        with under_way(Work(threads=threads)):
            together = fit_outlines(points, sigmas)
        assert [type(each) for each in together] == [type(each) for each in alone] == [Ring, Circle, Rectangle, Ring]
        for one, other in zip(together, alone, strict=True):
            assert one.ring().cubics.tobytes() == other.ring().cubics.tobytes()


def test_an_outline_that_goes_astray_is_fitted_closer_to_its_points() -> None:
    # A disc with a bump, which would cost more than to leave it out.
    turn = np.linspace(0.0, 2.0 * math.pi, 300, endpoint=False)
    radii = 30.0 + 20.0 * np.exp(-(((turn - math.pi) / 0.2) ** 2))
    points = 60.0 + radii[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    sigma, area = np.full(len(points), 0.5), abs(signed_area(polygon(points)))
    allowed = 0.1 * float(np.hypot(*(points - np.roll(points, 1, axis=0)).T).sum()) + 1.0
    astray = fit_outline(points, sigma, 0.01)
    assert isinstance(astray, Circle) and area - signed_area(astray.ring()) > allowed
    (sound,) = fit_outlines([points], [sigma], 0.01)
    assert abs(signed_area(sound.ring())) == pytest.approx(area, abs=allowed)


@pytest.mark.parametrize("degrees", [1.0, 8.0])
def test_a_tip_ends_where_it_can_be_seen(degrees: float) -> None:
    """Where nearly parallel sides meet, the points do not tell: they end where the tip is half a px wide."""
    x, slope = np.arange(0.5, 60.0), math.tan(math.radians(degrees / 2.0))
    half = 0.25 + slope * (60.0 - x)
    base = np.linspace(-half[0], half[0], 5)
    sides = [np.stack(each, axis=1) for each in ((x, -half), (x[::-1], half[::-1]), (0.0 * base, base[::-1]))]
    points = np.concatenate(sides)
    tip = fit_outline(points, np.full(len(points), 0.05)).ring().anchors[:, 0].max()
    assert tip < 66.0
    if degrees > 5.0:
        assert tip == pytest.approx(60.0 + 0.25 / slope, abs=0.2)


@pytest.mark.parametrize("count", [3, 5, 8, 9, 12])
def test_tiny_loops_are_fitted_too(count: int) -> None:
    angles = np.arange(count) * 2.0 * math.pi / count
    points = 5.0 + 1.5 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ring = fit_outline(points, np.full(count, 0.1)).ring()
    assert np.isfinite(ring.cubics).all()


@pytest.mark.parametrize("points", [np.zeros((5, 2)), np.zeros((5, 3)), np.full((5, 2), np.nan)])
def test_points_without_a_loop_are_refused(points: np.ndarray) -> None:
    with pytest.raises(InputError):
        fit_outline(points, np.ones(5))


def crossings(ring: Ring) -> int:
    """How often a ring crosses itself, as a polyline."""
    points = flattened(ring, 0.2)
    way = np.roll(points, -1, axis=0) - points
    gap = points[None] - points[:, None]
    across = way[:, None, 0] * way[None, :, 1] - way[:, None, 1] * way[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (gap[..., 0] * way[None, :, 1] - gap[..., 1] * way[None, :, 0]) / across
        u = (gap[..., 0] * way[:, None, 1] - gap[..., 1] * way[:, None, 0]) / across
    crossed = (t >= 0.0) & (t < 1.0) & (u >= 0.0) & (u < 1.0)
    return int(np.triu(crossed, 2).sum())


def test_small_letters_do_not_cross_themselves() -> None:
    """An arch a pixel thin has its inner corner beyond its outer side, where the flanks meet."""
    image = Image.new("RGB", (110, 26), "white")
    ImageDraw.Draw(image).text((5.3, 4), "Menu item num", fill="#222", font=ImageFont.load_default(15))
    shapes = vectorize.draw(as_picture(image).target()).shapes
    assert sum(crossings(o) for shape in shapes for o in shape.outlines if isinstance(o, Ring)) <= 10  # 20 were


def test_small_letters_whose_outlines_went_astray_follow_their_points() -> None:
    """Where hardly any flank is straight for 2 px, corners are found where none are, up to 6 px off."""
    image = Image.new("RGB", (110, 26), "white")
    ImageDraw.Draw(image).text((5.3, 4), "Menu item num", fill="#222", font=ImageFont.load_default(11))
    drawing = vectorize.draw(as_picture(image).target())
    drawn = rerender(write_drawing(drawing, title="", comment="").encode(), 110, 26).pixels[..., :3]
    assert np.mean((drawn - np.asarray(image, float)) ** 2) < 50.0  # 75 it was


def test_only_rings_off_their_points_have_another_one() -> None:
    angles = np.arange(60) * 2.0 * math.pi / 60.0
    star = 30.0 + (10.0 + 8.0 * np.cos(5.0 * angles))[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    letter = Image.new("L", (20, 20))
    ImageDraw.Draw(letter).text((4, 3), "e", fill=255, font=ImageFont.load_default(12))
    (_, (_, cracks, _)) = border_map(np.asarray(letter) > 127).loops.outer()
    cracks = cracks.astype(float)
    steps = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])[cracks[:, 2].astype(int)]
    loops = [star, cracks[:, :2] + 0.5 * steps]
    sure, rough = fit_outlines(loops, [np.full(60, 0.05), np.full(len(cracks), 0.3)])
    assert isinstance(sure, Ring) and sure.otherwise is None
    assert isinstance(rough, Ring) and rough.otherwise is not None
    assert rough.otherwise.pieces > rough.pieces


def test_a_bar_thinner_than_lines_may_be_off_has_four_corners():
    across = np.arange(6) + 0.5
    for count in (3, 6):
        x = across[:count]
        bar = np.concatenate([np.stack([x, 5.0 - 0.1 + 0.0 * x], 1), np.stack([x[::-1], 5.0 + 0.1 + 0.0 * x], 1)])
        assert len(few_lines(bar).anchors) == 4
    short = fit_outline(bar[[0, 1, 2, -3, -2, -1]], np.full(6, 0.05))
    assert isinstance(short, Ring)
    assert len(short.anchors) == 4
