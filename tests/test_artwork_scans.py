"""Scans of pen drawings: the paper found, its light evened out, and what is on it drawn; nothing else counts as one."""

from __future__ import annotations

import re

import numpy as np
import pytest
from conftest import rest_slow
from PIL import Image, ImageDraw
from scans import PAPER, scaled_pens, target_of
from scans import scan_of as scan
from scipy import ndimage
from skimage import data
from stroke_icons import ICONS, svg_of

from cubicsplat_cli import vectorize
from cubicsplat_cli.artwork.input.paper import scan_of
from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.artwork.style import _drawn, choose_style
from cubicsplat_cli.evaluate.rerender import rerender

SIDE = 600
PENS = scaled_pens(ICONS["clock"], 1.6)


@pytest.mark.parametrize(("light", "quality"), rest_slow((0.15, 85), (0.3, None)))
def test_paper_is_white_and_ink_as_it_was_drawn(light, quality):
    found = scan_of(as_levels(target_of(scan(PENS, SIDE, light=light, quality=quality))))
    assert found is not None and 3.0 < found.grain < 9.0
    truth = rerender(svg_of(PENS).encode(), SIDE, SIDE).pixels[..., :3].astype(float)
    away = np.abs(truth - 255.0).max(axis=2) == 0.0
    assert (found.levels[away][:, :3] == 255.0).all(axis=1).mean() > 0.97
    # The pen's lines are soft, but dark in their middle.
    assert found.levels[truth[..., 0] < 27.0][:, 0].mean() < 110.0
    assert (found.levels[..., 3] == 255.0).all()


def test_a_scan_is_not_given_up_for_what_its_paper_lacks():
    # Uneven light alone is more than the 18 dB that any other drawing may be off.
    made = vectorize(scan(PENS, 320, light=0.5), mode="open", threads=1)
    assert made.report.style == "artwork" and made.report.quality.svg.psnr_db < 18.0
    assert "drawn as ink on even paper, without its grain and shadows" in made.report.notes


def test_an_evenly_lit_scan_keeps_its_papers_colour_and_one_ink_for_all_lines():
    pens = [*scaled_pens(ICONS["circle"], 3.0), *scaled_pens(ICONS["thin cross"], 1.4)]
    picture = scan(pens, 320, light=0.0, texture=3.0)
    made = vectorize(picture, threads=1)
    assert "drawn as ink on even paper, without its grain and shadows" in made.report.notes
    drawn = rerender(made.svg.encode(), 320, 320).pixels[..., :3].astype(float)
    truth = rerender(svg_of(pens).encode(), 320, 320).pixels[..., :3] / 255.0 * PAPER
    assert np.abs(drawn[0, 0] - PAPER).max() <= 1.0
    assert np.sqrt(np.mean((drawn - truth) ** 2)) < 8.0 < np.sqrt(np.mean((picture - truth) ** 2))
    assert len(set(re.findall('"(#[0-9a-f]{6})"', made.svg))) == 2


@pytest.mark.parametrize("ground", ["light", "dark", "without blue"])
def test_thin_lines_that_are_blurred_have_one_ink_without_any_grain(ground):
    pens = [*scaled_pens(ICONS["circle"], 3.0), *scaled_pens(ICONS["thin cross"], 1.4)]
    picture = scan(pens, 320, light=0, texture=0)
    if ground == "dark":
        picture = 255 - picture
    elif ground == "without blue":
        picture[..., 2] = 0
    made = vectorize(picture, threads=1)
    assert any(note.startswith("drawn through a blur of 1.") for note in made.report.notes)
    assert len(set(re.findall('"(#[0-9a-f]{3,6})"', made.svg))) == 2 and made.svg.count("<path") <= 4


def relief() -> np.ndarray:
    """(256, 256) levels: hills of 10 to 50 px, lit from one side."""
    generator = np.random.default_rng(7)
    hills = sum(side**0.9 * ndimage.gaussian_filter(generator.normal(size=(256, 256)), side) for side in (6, 12, 24))
    slope = np.diff(hills, axis=1, append=hills[:, -1:])
    return 180.0 + 10.0 * slope / slope.std() - 15.0 * np.linspace(0.0, 1.0, 256)


def test_shaded_relief_is_no_grain_and_coloured_roads_are_no_shadow():
    hills, line = relief(), np.abs(np.mgrid[:256, :256][0] - 128) < 2
    bar = np.where(line, 20.0, hills)[..., None].repeat(3, axis=2)
    assert scan_of(as_levels(target_of(np.clip(np.rint(bar), 0, 255)))) is None
    grain = ndimage.gaussian_filter(np.random.default_rng(8).normal(size=(256, 256)), 1.0)
    rough = hills.mean() + np.linspace(-10.0, 10.0, 256) + 8.0 * grain / grain.std()
    for roads in (False, True):
        picture = np.where(line, 20.0, rough)[..., None].repeat(3, axis=2)
        if roads:
            picture[:, 60:64] += (45.0, -15.0, -80.0)
        assert (scan_of(as_levels(target_of(np.clip(np.rint(picture), 0, 255)))) is None) == roads


def gradient() -> np.ndarray:
    x = np.linspace(0.0, 1.0, 256)
    return np.repeat(np.repeat((200.0 + 50.0 * x)[None, :, None], 256, axis=0), 3, axis=2)


def test_what_is_no_scan_stays_as_it_is():
    generator = np.random.default_rng(3)
    noisy = generator.normal(0.0, 4.0, (256, 256, 3))
    clean = rerender(svg_of(ICONS["house"]).encode(), 256, 256).pixels[..., :3].astype(float)
    bright = np.clip(gradient() - 60.0 + noisy, 0.0, 255.0)
    bright[100:160, 100:160] = 250.0
    # A gradient with a kink, which no polynomial follows, and a dark shape on it.
    kinked = np.full((256, 256, 3), 140.0) + 100.0 * np.abs(np.linspace(-1.0, 1.0, 256))[:, None, None]
    kinked[60:90, 60:90] = 20.0
    # Soft tones in facets, as a JPEG keeps them, and a dark shape.
    y, x = np.mgrid[:256, :256]
    facets = gradient() - 40.0 + 9.0 * np.sign(np.sin(x / 19.0) * np.sin(y / 23.0 + x / 60.0))[..., None] + 0.25 * noisy
    facets[60:90, 60:90] = 20.0
    for picture in (clean, gradient(), clean + noisy, bright, kinked, facets):
        assert scan_of(as_levels(np.clip(np.rint(picture), 0, 255).astype(np.float32) / 255.0)) is None
    seethrough = as_levels(target_of(scan(PENS, 200)))
    seethrough[:10, :, 3] = 0.0
    assert scan_of(seethrough) is None


def in_grey(luma: np.ndarray) -> np.ndarray:
    """The levels (H, W, 4) of a grey picture (H, W), cut off at the ends of the scale."""
    return as_levels(target_of(np.clip(np.rint(luma), 0, 255)[..., None].repeat(3, axis=2)))


def test_dark_spots_on_a_dark_ground_are_not_ink_on_paper():
    assert scan_of(in_grey(data.microaneurysms())) is None


def test_a_dark_corner_of_a_rough_surface_is_a_shadow_and_no_ink():
    # Brushed metal: streaks that are alike along rows, and light that falls off quickly in one corner.
    generator = np.random.default_rng(4)
    streaks = ndimage.gaussian_filter(generator.normal(size=(256, 320)), (0.5, 12.0))
    y, x = np.mgrid[:256, :320] / 320.0
    grey = 205.0 + 20.0 * x + 9.0 * streaks / streaks.std() - 190.0 * np.exp(-(x**2 + y**2) / 0.004)
    assert scan_of(in_grey(grey)) is None


@pytest.mark.parametrize("seed", [0, 1])
def test_a_texture_of_all_tones_on_a_light_ground_is_no_ink(seed):
    """Frost and plaster have a few dark places, and many that are a little darker than the rest."""
    order, shade = np.random.default_rng(seed), np.zeros((200, 200))
    for _ in range(400):
        x, y, turn, length = order.uniform([0, 0, 0, 4], [200, 200, np.pi, 20])
        mark = Image.new("L", (200, 200))
        ImageDraw.Draw(mark).line([(x, y), (x + length * np.cos(turn), y + length * np.sin(turn))], fill=1, width=2)
        shade = np.maximum(shade, np.asarray(mark) * order.exponential(18.0))
    grey = np.linspace(205.0, 235.0, 200)[:, None] - shade + order.normal(0.0, 4.0, shade.shape)
    assert scan_of(in_grey(grey)) is None


def test_a_charts_grey_panels_are_no_unevenly_lit_paper():
    grey = np.full((480, 640), 255.0)
    for left in (39, 239, 440):
        panel = grey[25:442, left : left + 194]
        panel[:] = 235.0
        panel[40::81] = panel[:, 22::45] = 245.0
        panel[::81] = panel[:, ::45] = 255.0
        for k in range(12):
            panel[20 + 30 * k : 30 + 30 * k, 10 + 15 * k : 20 + 15 * k] = 0.0
    assert scan_of(in_grey(grey)) is None


@pytest.mark.slow
@pytest.mark.parametrize("grey", [False, True])
def test_a_scan_is_artwork(grey):
    picture = target_of(scan(PENS, SIDE))
    if grey:
        picture = np.repeat(np.rint(255.0 * picture.mean(axis=2, keepdims=True)) / 255.0, 3, axis=2)
    assert choose_style(picture.astype(np.float32)).name == "artwork"


def test_a_scan_of_even_paper_is_artwork():
    """Its neighbours are alike, as in a drawing, and its colours drift, as in a soft photo."""
    picture = target_of(scan(PENS, 512, texture=2.0, light=0.2, quality=70))
    assert _drawn(np.rint(255.0 * picture).astype(np.float32))[0]
    assert choose_style(picture.astype(np.float32)).name == "artwork"


@pytest.mark.parametrize(
    ("name", "style"),
    rest_slow(("page", "artwork"), ("camera", "photo"), ("text", "artwork"), ("grass", "photo")),
)
def test_scans_of_text_are_artwork_and_grey_photos_are_not(name, style):
    grey = np.asarray(getattr(data, name)())
    assert choose_style(target_of(np.repeat(grey[..., None], 3, axis=2))).name == style
