"""Scenes brought to another size, and pictures too large to measure as they are."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from conftest import smooth_pixels
from image_files import encode
from PIL import Image
from scenes import PAPER, random_scene

from cubicsplat_cli.evaluate.metrics import measurable
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.pipeline.vectorize import vectorize_picture
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings, Mode
from cubicsplat_cli.svg.scene_writer import write_svg


@pytest.mark.parametrize("mode", list(Mode))
def test_a_scaled_scene_is_the_drawing_at_another_size(mode):
    scene = random_scene(mode, width=40, height=30, background=PAPER)
    large = scene.scaled(120, 90)
    assert (large.width, large.height) == (120, 90)
    assert torch.allclose(large.half_widths, 3 * scene.half_widths)
    drawn = rerender(write_svg(large, precision=3, title="", comment="").encode(), 120, 90).pixels
    wanted = rerender(write_svg(scene, precision=4, title="", comment="").encode(), 120, 90).pixels
    assert np.abs(drawn.astype(int) - wanted).mean() < 0.5
    assert scene.scaled(40, 30) is scene


def test_sides_that_were_rounded_fit_again():
    scene = random_scene(Mode.CLOSED, width=60, height=42)
    large = scene.scaled(300, 211)
    assert torch.allclose(large.points[..., 0], 5 * scene.points[..., 0])
    assert torch.allclose(large.points[..., 1], 211 / 42 * scene.points[..., 1])


def test_only_what_is_too_large_is_scaled_for_measuring():
    picture, wide = (load_picture(encode(Image.fromarray(smooth_pixels(*size)))) for size in ((60, 20), (65534, 4)))
    assert measurable(picture) is picture
    assert (measurable(wide).width, measurable(wide).height) == (32767, 2)
    small = measurable(picture, most=100)
    assert 60 <= small.width * small.height <= 110


def test_a_picture_too_large_to_draw_is_measured_smaller_and_says_so():
    picture = load_picture(encode(Image.fromarray(smooth_pixels(65534, 4))), name="wide.png")
    settings = FitSettings.from_preset(curves=8, steps=20, threads=1)
    done = vectorize_picture(picture, Request(settings, style="photo"))
    assert 'viewBox="0 0 65534 4"' in done.svg
    assert done.pixels.shape[:2] == (2, 32767)
    assert "quality measured at 32767 x 2 pixels" in done.report.notes
    assert done.report.quality.agreement_db > 35
