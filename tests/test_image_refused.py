"""Loading pictures: every hostile input is refused with one clear line, and without hanging."""

from __future__ import annotations

import os
import re
import socket
from pathlib import Path

import numpy as np
import pytest
from image_files import NOISE, encode, png_of
from PIL import Image

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.files.load import load_picture

SUPPORTED = ("PNG", "JPEG", "WEBP", "BMP", "TIFF", "GIF", "PPM")


def refuse(source: Path | bytes, *words: str, **options) -> str:
    """Assert that loading fails with one line that names the source and holds `words`; returns the line."""
    with pytest.raises(InputError) as caught:
        load_picture(source, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 400
    name = options.get("name") or ("<bytes>" if isinstance(source, bytes) else Path(source).name)
    assert name in message
    assert ";" in message, "the message should say what to do"
    for word in words:
        assert word in message
    return message


@pytest.mark.parametrize(
    "beginning", [b"\x89PNG\r\n\x1a\nxx", b"\xff\xd8\xff\xe0\0", b"GIF89a\1", b"RIFF\0\0\0\0WEBPx", b"II*\0"]
)
def test_what_begins_like_a_picture_is_called_damaged(beginning):
    with pytest.raises(InputError, match=r"^a\.png: .*damaged or truncated.*; save or download it again$"):
        load_picture(beginning, name="a.png")


def test_missing(tmp_path):
    refuse(tmp_path / "nowhere.png", "no such file")


def test_empty(tmp_path):
    path = tmp_path / "empty.png"
    path.touch()
    refuse(path, "empty")
    refuse(b"", "empty")


def test_directory(tmp_path):
    refuse(tmp_path, "folder")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no FIFOs on this system")
@pytest.mark.timeout(100)
def test_fifo_does_not_hang(tmp_path):
    path = tmp_path / "pipe.png"
    os.mkfifo(path)
    refuse(path, "pipe")


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="no local sockets on this system")
def test_socket(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # socket paths have about 100 characters at most
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("s.png")
        refuse(Path("s.png"), "socket")


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no /dev/zero on this system")
@pytest.mark.timeout(100)
def test_endless_device():
    refuse(Path("/dev/zero"), "device")


def test_unreadable(tmp_path, monkeypatch):
    path = tmp_path / "locked.png"
    path.write_bytes(encode(Image.fromarray(NOISE)))
    path.chmod(0)
    if os.access(path, os.R_OK):  # root reads everything: let the call fail as it does for others

        def denied(self):
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr(Path, "read_bytes", denied)
    refuse(path, "permission")


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="no /proc/self/mem on this system")
def test_disk_error():
    refuse(Path("/proc/self/mem"), "Input/output error")  # nothing lies at address 0


def test_null_byte_and_control_characters_in_the_name(tmp_path):
    message = refuse(Path("a\0b.png"), name="a\\x00b.png")
    assert "\0" not in message
    with pytest.raises(InputError) as caught:
        load_picture(tmp_path / "two\nlines.png")
    assert "two\\nlines.png" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_too_many_bytes_is_found_before_reading(tmp_path):
    path = tmp_path / "huge.png"
    with path.open("wb") as file:
        file.truncate(1 << 43)  # a sparse file: takes no space, and no memory has room for it
    refuse(path, "MiB", "limit")


@pytest.mark.parametrize("text", ["hello, I am text\n" * 20, "x", "\x89PNG\r\n\x1a\n", "GIF89a", "P6\n"])
def test_text_named_png(tmp_path, text):
    path = tmp_path / "text.png"
    path.write_bytes(text.encode("latin-1"))
    refuse(path)


def test_plain_text_says_which_formats_work(tmp_path):
    path = tmp_path / "text.png"
    path.write_text("hello")
    refuse(path, *SUPPORTED)


def test_svg_is_called_vector():
    refuse(b'<?xml version="1.0"?>\n<svg xmlns="http://www.w3.org/2000/svg"/>', "already vector")


@pytest.mark.parametrize("file_format", ["ICO", "TGA", "PCX", "PDF", "EPS"])
def test_formats_off_the_list_are_refused(file_format):
    refuse(encode(Image.new("RGB", (16, 16), (1, 2, 3)), file_format), "not a picture in a supported format")


@pytest.mark.parametrize("file_format", SUPPORTED)
def test_truncated_anywhere(file_format):
    big = np.random.default_rng(1).integers(0, 256, (60, 70, 3), dtype=np.uint8)
    data = encode(Image.fromarray(big), file_format)
    for share in (0.02, 0.3, 0.6, 0.8):
        refuse(data[: max(1, int(len(data) * share))])


@pytest.mark.parametrize("file_format", SUPPORTED)
def test_damaged_bytes_never_raise_anything_else(file_format):
    clean = encode(Image.fromarray(NOISE), file_format)
    random = np.random.default_rng(3)
    outcomes = set()
    for _ in range(60):
        data = bytearray(clean)
        for at in random.integers(0, len(data), 4):
            data[at] = random.integers(0, 256)
        try:
            picture = load_picture(bytes(data), max_pixels=100_000)
        except InputError as error:
            assert "\n" not in str(error)
            outcomes.add("refused")
        else:
            assert np.isfinite(picture.rgb).all()
            assert picture.rgb.min() >= 0
            assert picture.rgb.max() <= 1
            outcomes.add("read")
    assert "refused" in outcomes, "the damage must matter for this test to mean anything"


def test_bomb_is_refused_before_it_is_decoded():
    data = png_of(60_000, 60_000, 8, 2, b"\0" * 1000)
    assert len(data) < 1000
    # Decoded, it would be refused for the pixels that it lacks.
    refuse(data, "60000 x 60000", "3,600,000,000 pixels", "100,000,000")


def test_max_pixels_is_exact_and_pillows_limit_is_restored():
    data = encode(Image.new("RGB", (20, 10)))
    before = Image.MAX_IMAGE_PIXELS
    assert load_picture(data, max_pixels=200).width == 20
    refuse(data, "20 x 10", max_pixels=199)
    assert before == Image.MAX_IMAGE_PIXELS


def test_max_pixels_above_pillows_own_limit(monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 50)
    assert load_picture(encode(Image.new("RGB", (20, 10)))).width == 20


@pytest.mark.parametrize("max_pixels", [0, -1])
def test_senseless_max_pixels(max_pixels):
    with pytest.raises(UsageError, match=re.escape(str(max_pixels))):
        load_picture(encode(Image.new("RGB", (2, 2))), max_pixels=max_pixels)
