"""Artwork from pictures whose colours were rounded to a few, without dither."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image, ImageDraw

from benchmarks.artwork.pixels import srgb_of_light
from cubicsplat_cli.api import vectorize
from cubicsplat_cli.artwork.channels import light_of_srgb
from cubicsplat_cli.artwork.input.condition import rounding_noise
from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.files.load import as_picture

PENS = ("#e8a33d", "#3c8dd6", "#2f9e5b", "#c2344f", "#7a4fb0", "#222b45")


def discs(*, linear: bool = False) -> Image.Image:
    """A picture of twelve overlapping discs and a bar in six colours on white, with 4 x 4 samples a pixel."""
    large = Image.new("RGB", (4 * 200, 4 * 160), "white")
    pen = ImageDraw.Draw(large)
    for k in range(12):
        x, y = 90 + 200 * (k % 4) + 13 * k, 110 + 200 * (k // 4) - 5 * k
        pen.ellipse([x - 95, y - 80, x + 95, y + 80], fill=PENS[k % len(PENS)])
    pen.polygon([30, 590, 760, 500, 770, 545, 40, 625], fill=PENS[1])
    values = np.asarray(large) / 255.0
    mean = (light_of_srgb(values) if linear else values).reshape(160, 4, 200, 4, 3).mean(axis=(1, 3))
    if linear:
        mean = srgb_of_light(mean)
    return Image.fromarray(np.rint(255.0 * mean).astype(np.uint8))


def rounded(picture: Image.Image, colours: int) -> Image.Image:
    return picture.quantize(colours, dither=Image.Dither.NONE).convert("RGB")


def noise_of(picture: Image.Image) -> float:
    return rounding_noise(as_levels(as_picture(np.asarray(picture)).target()))


@pytest.mark.parametrize("colours", [12, 16, 24])
def test_blends_in_few_colours_are_noisy_and_the_drawing_is_not(colours):
    picture = rounded(discs(), colours)
    assert 1.0 < noise_of(picture) < 12.0
    plain, found = (vectorize(np.asarray(each), style="artwork", measure=False) for each in (discs(), picture))
    assert found.report.shapes <= plain.report.shapes + 1
    assert len(found.svg) < 1.5 * len(plain.svg)
    assert any("few colours" in note for note in found.report.notes)


def test_a_picture_with_all_its_colours_is_not_rounded():
    assert noise_of(discs()) == 0.0


def test_a_palette_that_holds_all_blends_rounds_none():
    assert noise_of(rounded(discs(), 256)) < 1.0


def test_lines_of_one_pixel_are_no_blends():
    levels = np.full((60, 80, 4), 255.0, np.float32)
    for k, x in enumerate(range(4, 76, 3)):
        levels[:, x:, :3] = np.float32([(90 * k) % 256, (140 * k) % 256, (200 * k) % 256])
        levels[:, x, :3] = (k % 3) * 20.0
    assert rounding_noise(levels) == 0.0


@pytest.mark.parametrize("size", [(1, 1), (3, 60), (60, 3), (5, 5)])
def test_tiny_pictures_do_not_tell(size):
    assert rounding_noise(np.random.default_rng(0).integers(0, 2, (*size, 4)).astype(np.float32) * 255.0) == 0.0


def test_edges_blended_in_linear_light_are_not_taken_for_rounded_ones():
    found = vectorize(np.asarray(discs(linear=True)), style="artwork", measure=False)
    assert any("linear light" in note for note in found.report.notes)
    assert not any("few colours" in note for note in found.report.notes)
