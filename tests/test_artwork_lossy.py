"""Drawings from files that were compressed with loss, and say so."""

from __future__ import annotations

import io

import numpy as np
import pytest
from image_files import encode
from PIL import Image, ImageDraw

from cubicsplat_cli.api import vectorize
from cubicsplat_cli.artwork.input.prepare import analysed
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.files.convert import as_picture
from cubicsplat_cli.files.load import load_picture, resize_picture


def stripes() -> np.ndarray:
    """(100, 150, 3) uint8 of three level stripes, with edges within rows."""
    levels = np.empty((100, 150, 3))
    levels[:33], levels[33:66], levels[66:] = (30, 181, 58), (255, 255, 255), (0, 114, 198)
    levels[33], levels[66] = 0.6 * levels[32] + 0.4 * levels[34], 0.7 * levels[65] + 0.3 * levels[67]
    return np.rint(levels).astype(np.uint8)


def test_a_file_says_whether_it_was_compressed_with_loss():
    image = Image.fromarray(stripes())
    files = encode(image, "JPEG"), encode(image, "WEBP"), encode(image, "WEBP", lossless=True), encode(image)
    assert [load_picture(file).compression is not None for file in files] == [True, True, False, False]
    with Image.open(io.BytesIO(files[0])) as opened:
        assert as_picture(opened).compression == load_picture(files[0]).compression
    assert as_picture(stripes()).compression is resize_picture(load_picture(files[0]), 50).compression is None


def test_level_stripes_of_a_jpeg_are_drawn_without_its_ringing():
    """They have as few colours as a GIF, and coefficients along columns alone."""
    file = encode(Image.fromarray(stripes()), "JPEG", quality=80)
    picture = load_picture(file)
    assert analysed(picture.target(), picture.compression).condition.jpeg
    assert vectorize(file, measure=False).report.shapes == 3


def test_a_file_without_a_trace_of_loss_is_clean():
    levels = np.full((64, 64, 3), 240, np.uint8)
    levels[16:48, 16:48] = (80, 80, 80)  # whole blocks
    picture = load_picture(encode(Image.fromarray(levels), "JPEG", quality=95))
    assert analysed(picture.target(), picture.compression).condition.clean


@pytest.mark.parametrize("red", [253, 2])
def test_a_gradient_of_a_jpeg_that_has_nearly_all_or_nothing_of_a_channel_is_one(red):
    levels = np.full((160, 160, 3), 255, np.uint8)
    levels[20:140, 20:140] = [[(red, 230 - y, 60) for x in range(120)] for y in range(120)]
    picture = load_picture(encode(Image.fromarray(levels), "JPEG", quality=90))
    assert len(draw(picture.target()).gradients) == 1


def test_a_colour_of_three_digits_comes_back_from_what_it_is_rounded_to():
    image = Image.new("RGB", (128, 128), (255, 255, 255))
    ImageDraw.Draw(image).rectangle([22, 21, 99, 97], fill=(34, 102, 153))
    picture = load_picture(encode(image, "JPEG", quality=80))
    assert (255.0 * picture.target()[60, 60]).round().tolist() == [34, 101, 153]
    prepared = analysed(picture.target(), picture.compression)
    assert (34, 102, 153, 255) in draw(picture.target(), prepared=prepared).fills
