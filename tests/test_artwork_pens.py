"""Pens of scans: their ink, blur and widths told by what lines look like across, and strokes made of them."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import rest_slow
from scans import scaled_pens, target_of
from scans import scan_of as scan
from scipy import ndimage
from scipy.spatial import cKDTree
from stroke_icons import ICONS, SIZE, line_of, svg_of

from cubicsplat_cli.artwork.geometry.outlines import points_at, signed_area
from cubicsplat_cli.artwork.geometry.stroke import pieces_of
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.paper import scan_of
from cubicsplat_cli.artwork.input.pens import Pens, pens_of, sharpened
from cubicsplat_cli.artwork.input.prepare import analysed, as_levels
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Shape
from cubicsplat_cli.artwork.strokes.centre_line import end_of
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.evaluate.rerender import rerender

SIDE, FILL, WHITE = 600, np.array([26.0, 43.0, 109.0]), np.full(3, 255.0)


def drawn(name: str, width: float, **how: float | None) -> np.ndarray:
    return target_of(scan(scaled_pens(ICONS[name], width * SIZE / SIDE), SIDE, **how))  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "width", "blur", "texture", "quality"),
    [("clock", 2.3, 1.0, 5.0, 85), ("house", 2.8, 1.4, 3.0, None), ("triangle", 4.5, 1.4, 8.0, 85)],
)
def test_ink_blur_and_width_are_told_by_profiles(name, width, blur, texture, quality):
    found = scan_of(as_levels(drawn(name, width, blur=blur, texture=texture, quality=quality)))
    pens = pens_of(found.bare, WHITE, found.grain)
    assert pens is not None and len(pens.inks) == 1
    assert pens.blur == pytest.approx(blur, abs=0.06)
    assert np.abs(pens.inks[0] - FILL).max() < 12.0
    assert np.median(pens.widths) == pytest.approx(width, abs=0.15)


def paper_with(*lines: tuple[int, float, tuple[float, float, float]], blur: float = 1.0) -> np.ndarray:
    """(300, 400, 3) levels: level lines, (middle and width in px, ink), on white paper with a fine grain, blurred."""
    fine = np.full((3000, 3), 255.0)
    for middle, width, ink in lines:
        fine[round(10 * (middle - width / 2)) : round(10 * (middle + width / 2))] = ink
    rows = fine.reshape(300, 10, 3).mean(axis=1)
    soft = ndimage.gaussian_filter1d(rows, blur, axis=0)
    return soft[:, None] + np.random.default_rng(4).normal(0.0, 2.0, (300, 400, 1))


def test_inks_of_two_pens_are_told_apart_and_two_widths_of_one_are_not():
    pale, dark = (170.0, 200.0, 235.0), (30.0, 40.0, 60.0)
    paper = paper_with((40.3, 1.6, pale), (80.2, 3.0, dark), (120, 1.6, pale), (160.4, 5.0, dark), blur=0.8)
    pens = pens_of(paper, WHITE, 2.0)
    assert pens is not None and pens.blur == pytest.approx(0.8, abs=0.05)
    assert len(pens.inks) == 2
    assert np.abs(np.sort(pens.inks, axis=0) - np.array([dark, pale])).max() < 10.0
    for middle, width in ((40.3, 1.6), (80.2, 3.0), (160.4, 5.0)):
        own = np.abs(pens.places[:, 1] - middle + 0.5) < 1.0
        assert np.median(pens.widths[own]) == pytest.approx(width, abs=0.2)


def test_areas_have_inks_of_their_own_and_more_of_them_than_lines_are_no_pens():
    paper = paper_with((60, 2.5, (30.0, 30.0, 30.0)))
    paper[150:190, 100:160] = (200.0, 40.0, 50.0)
    pens = pens_of(paper, WHITE, 2.0)
    assert np.abs(pens.inks[pens.owners[pens.places[:, 1] > 140]] - (200.0, 40.0, 50.0)).max() <= 3.0
    paper[120:290, 20:380] = (200.0, 40.0, 50.0)
    assert pens_of(paper, WHITE, 2.0) is None


def test_nothing_drawn_has_no_pens():
    assert pens_of(paper_with(), WHITE, 2.0) is None


def test_blurred_lines_become_as_wide_as_they_were():
    y, x = np.mgrid[:60, :200].astype(float)
    share = np.clip(1.75 - np.abs(y - 30.2 - 0.05 * x), 0.0, 1.0)
    soft = ndimage.gaussian_filter(share, 1.2)[..., None]
    levels = np.concatenate([255.0 + soft * (FILL - 255.0), np.full((60, 200, 1), 255.0)], axis=2)
    places = np.stack([np.arange(200.0), 30.2 + 0.05 * np.arange(200.0)], axis=1)
    pens = Pens(1.2, WHITE, FILL[None], places, np.zeros(200, dtype=int), np.full(200, 2.5))
    sharp, inks = sharpened(levels.astype(np.float32), pens)
    assert inks == pytest.approx(np.array([[255.0, 255.0, 255.0, 255.0], [*FILL, 255.0]]))
    assert np.abs((255.0 - sharp[..., 0]) / (255.0 - FILL[0]) - share)[:, 10:-10].mean() < 0.02
    assert ((255.0 - sharp[:, 10:-10, 0]) / (255.0 - FILL[0])).sum() == pytest.approx(share[:, 10:-10].sum(), rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "width", "blur", "texture", "quality"),
    rest_slow(("triangle", 2.0, 0.8, 4.0, 90), ("house", 2.34, 1.0, 5.0, 85), ("grid", 5.0, 1.3, 6.0, 90)),
)
def test_pens_of_scans_become_strokes_of_their_width_and_ink(name, width, blur, texture, quality):
    picture = drawn(name, width, blur=blur, texture=texture, quality=quality)
    prepared = analysed(picture)
    assert prepared.pens is not None and prepared.condition.coarse
    assert prepared.scanned and prepared.notes[0] == "drawn as ink on even paper, without its grain and shadows"
    ground, *shapes = draw(picture, ArtworkSettings(strokes=True), prepared).shapes
    assert ground.fill == (255, 255, 255, 255)
    pens = scaled_pens(ICONS[name], width * SIZE / SIDE)
    assert len(shapes) == len(pens)
    strokes = [shape.stroke for shape in shapes if shape.stroke is not None]
    assert [stroke.width for stroke in strokes] == pytest.approx([width] * len(pens), abs=0.2)
    assert all(np.abs(np.array(shape.fill[:3]) - FILL).max() <= 12.0 for shape in shapes)
    lines = np.concatenate([line_of(pen) for pen in pens]) * SIDE / SIZE
    cubics = np.concatenate([pieces_of(stroke.path)[0] for stroke in strokes])
    found = np.concatenate([points_at(cubic[None], np.linspace(0.0, 1.0, 3000)[None])[0] for cubic in cubics])
    assert np.percentile(cKDTree(lines).query(found)[0], 95) < 0.35
    assert np.percentile(cKDTree(found).query(lines)[0], 95) < 0.3


@pytest.mark.slow
def test_a_scan_drawn_closed_is_near_the_drawing():
    pens = scaled_pens(ICONS["clock"], 2.3 * SIZE / SIDE)
    drawing = draw(drawn("clock", 2.3), ArtworkSettings(strokes=False))
    assert all(shape.stroke is None for shape in drawing.shapes)
    truth = rerender(svg_of(pens).encode(), SIDE, SIDE).pixels[..., 0].astype(float)
    area = sum(outline_area(shape) for shape in drawing.shapes[1:])
    assert area == pytest.approx((255.0 - truth).sum() / (255.0 - FILL[0]), rel=0.06)


def outline_area(shape: Shape) -> float:
    return abs(sum(signed_area(ring) for ring in shape.oriented()))


def test_a_run_of_one_point_has_no_direction():
    way, bend = end_of(np.array([[3.0, 4.0], [3.0, 4.0]]))
    assert (way == 0.0).all() and (bend == 0.0).all()


def test_grain_counts_as_more_noise_on_edges_than_noise_of_single_pixels():
    assert Condition(noise=4.0, coarse=True).edge_error > 2.0 * Condition(noise=4.0).edge_error
