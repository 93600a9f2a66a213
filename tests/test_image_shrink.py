"""Very large pictures read smaller: in every mode what the mean of the whole would be, and in the place it was."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import smooth_pixels
from image_files import encode
from PIL import Image

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files import decode
from cubicsplat_cli.files.load import load_picture

WIDTH, HEIGHT = 96, 64
FINE = {"quality": 98, "subsampling": 0}


@pytest.fixture(autouse=True)
def _all_is_very_large(monkeypatch):
    """What has more than 1,000 pixels is very large here, and 400 are wanted."""
    monkeypatch.setattr(decode, "READ_WHOLE_PIXELS", 1000)
    monkeypatch.setattr(decode, "MOST_PIXELS", 400)
    monkeypatch.setattr(decode, "BAND_PIXELS", 5 * WIDTH)


def picture_of(mode: str) -> Image.Image:
    image = Image.fromarray(smooth_pixels(WIDTH, HEIGHT, alpha=True))
    if mode in ("I;16", "F"):
        grey = np.asarray(image.convert("L"))
        return Image.fromarray(grey.astype(np.uint16) * 257 if mode == "I;16" else grey.astype(np.float32) / 255)
    return image.convert("RGB").quantize(64) if mode == "P" else image.convert(mode)


@pytest.mark.parametrize(
    ("mode", "file_format"),
    [
        ("RGB", "PNG"), ("RGB", "JPEG"), ("RGB", "TIFF"), ("RGB", "WEBP"), ("RGB", "BMP"), ("L", "JPEG"), ("L", "PNG"),
        ("RGBA", "PNG"), ("RGBA", "WEBP"), ("LA", "PNG"), ("P", "PNG"), ("P", "GIF"), ("1", "PNG"), ("CMYK", "JPEG"),
        ("I;16", "PNG"), ("F", "TIFF"),
    ],
)  # fmt: skip
def test_it_is_the_mean_of_the_whole(mode, file_format):
    data = encode(picture_of(mode), file_format, **(FINE if file_format == "JPEG" else {}))
    whole, small = load_picture(data), load_picture(data, max_size=20)
    assert (small.width, small.height) == (24, 16)
    assert small.size == whole.size == (WIDTH, HEIGHT)
    assert small.full_size == (WIDTH, HEIGHT)
    assert whole.full_size is None
    assert "read at 24 x 16 of its 96 x 64 pixels" in small.notes
    assert small.sha256 == whole.sha256
    wanted = whole.premultiplied().reshape(16, 4, 24, 4, 4).mean((1, 3))
    # JPEG's own reduction is no exact mean, and black and white are dithered.
    assert np.abs(small.premultiplied() - wanted).max() < (0.06 if file_format == "JPEG" else 0.012)


@pytest.mark.parametrize("file_format", ["PNG", "TIFF", "WEBP", "JPEG"])
@pytest.mark.parametrize("orientation", [1, 3, 6, 7])
def test_orientation_is_applied(file_format, orientation):
    exif = Image.Exif()
    exif[0x0112] = orientation
    data = encode(picture_of("RGB"), file_format, exif=exif, **(FINE if file_format == "JPEG" else {}))
    whole, small = load_picture(data), load_picture(data, max_size=20)
    assert small.size == (whole.width, whole.height)
    assert (4 * small.width, 4 * small.height) == small.size
    wanted = whole.rgb.reshape(small.height, 4, small.width, 4, 3).mean((1, 3))
    assert np.abs(small.rgb - wanted).max() < 0.06


def test_what_is_hidden_does_not_bleed_in():
    pixels = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    pixels[:, ::2] = (200, 100, 50, 255)
    pixels[:, 1::2] = (0, 255, 255, 0)
    small = load_picture(encode(Image.fromarray(pixels)), max_size=10)
    assert np.abs(small.rgb * 255 - (200, 100, 50)).max() < 2
    assert np.abs(small.alpha - 0.5).max() < 0.01


@pytest.mark.parametrize(("max_size", "width"), [(96, 96), (49, 96), (48, 48), (24, 24), (1, 24)])
def test_never_smaller_than_is_needed(max_size, width):
    assert load_picture(encode(picture_of("RGB")), max_size=max_size).width == width


def test_sides_that_are_no_multiple():
    data = encode(Image.fromarray(smooth_pixels(97, 63)))
    small = load_picture(data, max_size=20)
    assert (small.width, small.height, small.size) == (25, 16, (97, 63))
    assert (
        np.abs(small.rgb[:15, :24] - load_picture(data).rgb[:60, :96].reshape(15, 4, 24, 4, 3).mean((1, 3))).max()
        < 0.01
    )


def test_the_limit_is_that_of_what_is_read(monkeypatch):
    data = encode(picture_of("RGB"))
    assert load_picture(data, max_size=20, max_pixels=384).width == 24
    with pytest.raises(InputError, match=r"96 x 64 = .*; try this, or raise it with --max-pixels"):
        load_picture(data, max_size=90, max_pixels=6000, smaller="try this")
    monkeypatch.setattr(decode, "MAX_DECODED_PIXELS", 6000)
    with pytest.raises(InputError, match=r"a file of its kind is read up to .*; scale the picture down first"):
        load_picture(data, max_size=20)
    assert load_picture(encode(picture_of("RGB"), "JPEG"), max_size=20).width == 24, "is decoded small to begin with"


def test_the_command_takes_what_max_size_makes_small(tmp_path, run_cli):
    path = tmp_path / "large.png"
    path.write_bytes(encode(picture_of("RGB")))
    few = ("--style", "photo", "--curves", 12, "--steps", 40, "--threads", 1, "--max-pixels", 2000)
    run_cli("vectorize", path, *few, code=1, error="fit a smaller copy with --max-size")
    done = run_cli("vectorize", path, *few, "--max-size", 20)
    said = done.stderr.decode()
    assert "read at 24 x 16 of its 96 x 64 pixels" in said
    assert "scaled from 24 x 16 to 20 x 13 pixels" in said
    assert "quality measured at 24 x 16 pixels" in said
    assert 'viewBox="0 0 96 64"' in path.with_suffix(".svg").read_text()
