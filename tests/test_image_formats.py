"""Formats that only some installations read, and files that hold several pictures."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from cli_runs import SHORT, strict_json
from conftest import smooth_pixels
from image_files import encode
from PIL import Image, features

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files import names
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.jobs.plan import find_sources

HEIC = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(200)
COLOURS = [(250, 10, 10), (10, 250, 10), (10, 10, 250)]


@pytest.fixture
def several():
    """Bytes of a file with three pictures, each of one colour, the second larger than the first in a TIFF."""

    def make(kind: str) -> bytes:
        sizes = [(24, 20), (30, 26) if kind == "TIFF" else (24, 20), (24, 20)]
        pictures = [Image.new("RGB", size, colour) for size, colour in zip(sizes, COLOURS, strict=True)]
        return encode(pictures[0], kind, save_all=True, append_images=pictures[1:])

    return make


@pytest.mark.parametrize("kind", ["GIF", "TIFF", "WEBP", "PNG"])
def test_the_frame_asked_for(kind, several):
    data = several(kind)
    first = load_picture(data)
    assert any("several frames" in note for note in first.notes)
    for number, colour in enumerate(COLOURS, 1):
        picture = load_picture(data, frame=number)
        assert np.abs(255 * picture.rgb.reshape(-1, 3).mean(0) - colour).max() < 6
        assert picture.notes == ()
    assert (load_picture(data, frame=2).width == 30) == (kind == "TIFF")
    with pytest.raises(InputError, match="has 3 frames, and --frame is 4"):
        load_picture(data, frame=4)


def test_the_frame_is_an_option_and_decides_what_is_made(tmp_path, several, run_cli):
    path = tmp_path / "x.gif"
    path.write_bytes(several("GIF"))
    quick = (*SHORT, "--no-measure", "--no-png")
    run_cli("vectorize", path, *quick)
    first = path.with_suffix(".svg").read_bytes()
    run_cli("vectorize", path, *quick, "--frame", 2)
    assert path.with_suffix(".svg").read_bytes() != first
    assert strict_json(path.with_suffix(".json").read_bytes())["settings"]["frame"] == 2
    for frame, code, said in ((9, 1, "x.gif: has 3 frames"), (0, 2, "--frame must be a whole number")):
        run_cli("vectorize", path, *quick, "--frame", frame, code=code, error=said)


@pytest.mark.skipif(not features.check("avif"), reason="this Pillow was built without AVIF")
def test_avif_is_read(tmp_path):
    pixels = smooth_pixels(40, 28, alpha=True)
    path = tmp_path / "x.avif"
    path.write_bytes(encode(Image.fromarray(pixels), "AVIF", quality=100, subsampling="4:4:4"))
    picture = load_picture(path)
    assert (picture.width, picture.height) == (40, 28)
    seen = pixels[..., 3] == 255
    assert np.abs(255 * picture.rgb - pixels[..., :3])[seen].mean() < 6
    assert picture.alpha is not None
    assert [each for each, _ in find_sources([str(tmp_path)], recursive=False).sources.values()] == [path]


def test_avif_without_a_pillow_that_reads_it_says_what_to_install(monkeypatch):
    Image.init()
    monkeypatch.delitem(Image.OPEN, "AVIF", raising=False)
    with pytest.raises(InputError, match=r"is an AVIF picture; pip install -U 'Pillow>=11\.3'"):
        load_picture(b"\0\0\0\x14ftypavif\0\0\0\0avif" + bytes(99))


def test_heic_says_what_to_install(tmp_path, monkeypatch, run_cli):
    monkeypatch.setitem(sys.modules, "pillow_heif", None)  # as if it were not installed
    path = tmp_path / "x.jpg"
    path.write_bytes(HEIC)
    said = "is an HEIC picture; pip install pillow-heif to have it read, or save it as JPEG"
    run_cli("vectorize", path, code=1, error=f"cubicsplat: error: {path}: {said}\n")


def test_heic_is_read_by_its_plugin_where_that_is_installed(tmp_path, monkeypatch, package):
    """With a plugin of the test's, which takes the file for another."""
    package(
        "pillow_heif",
        "from PIL import Image\n"
        "def register_heif_opener():\n"
        "    Image.register_open('HEIF', lambda file, name: Image.new('RGB', (9, 7)), lambda _: True)\n",
    )
    Image.init()  # what it knows by itself must not go with the copy
    monkeypatch.setitem(Image.OPEN, "HEIF", None)
    monkeypatch.setattr(Image, "ID", list(Image.ID))
    path = tmp_path / "x.heic"
    path.write_bytes(HEIC)
    assert load_picture(path).width == 9
    assert [each for each, _ in find_sources([str(tmp_path)], recursive=False).sources.values()] == [path]


def test_whether_heic_is_read_depends_on_what_is_installed(monkeypatch, package):
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "pillow_heif", None)
        assert not names.reads_heic()
    package("pillow_heif", "")
    assert names.reads_heic()
