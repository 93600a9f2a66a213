"""Pictures of every kind through the real command, in one run over a folder: what becomes of each, and what is said."""

from __future__ import annotations

import gzip
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cli_runs import SHORT, contents, json_lines
from conftest import smooth_pixels
from image_files import encode, png_chunk, png_of, swapped_profile
from PIL import Image

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.read import read_file
from cubicsplat_cli.svg.scene_reader import read_svg

RED = (255, 0, 0)


def turned() -> bytes:
    """40 x 28 as stored, to be turned by a quarter: the left half, which is red, comes to the top."""
    exif = Image.Exif()
    exif[0x0112] = 6
    image = Image.new("RGB", (40, 28), (0, 0, 255))
    image.paste(RED, (0, 0, 20, 28))
    return encode(image, "JPEG", quality=95, exif=exif)


def sixteen_bits() -> bytes:
    values = np.full((20, 24, 3), 0x80FF, ">u2")
    rows = b"".join(b"\0" + row.tobytes() for row in values)
    return png_of(24, 20, 16, 2, rows)


def palette_with_transparency() -> bytes:
    image = Image.new("P", (24, 20), 0)
    image.putpalette([*RED, 0, 255, 0])
    image.paste(1, (0, 0, 12, 20))
    return encode(image, transparency=1)


def animated() -> bytes:
    frames = [Image.new("RGB", (24, 20), colour) for colour in (RED, (0, 0, 255))]
    return encode(frames[0], "GIF", save_all=True, append_images=frames[1:])


def other_profile() -> bytes:
    """Pixels (0, 255, 0) of a profile whose primaries are swapped: what is called green is red."""
    return encode(Image.new("RGB", (24, 20), (0, 255, 0)), icc_profile=swapped_profile(b"gXYZ"))


def grey_with_alpha() -> bytes:
    image = Image.new("LA", (24, 20), (200, 255))
    image.paste((0, 0), (0, 0, 12, 20))
    return encode(image)


def solid(mode: str, colour: object, file_format: str = "PNG") -> Callable[[], bytes]:
    return lambda: encode(Image.new(mode, (24, 20), colour), file_format)


# name -> (bytes, colour of the picture's last pixel or None where it has many, words of the note or None)
PICTURES: dict[str, tuple[Callable[[], bytes], tuple[int, ...] | None, str | None]] = {
    "one_pixel.png": (lambda: encode(Image.new("RGB", (1, 1), RED)), RED, None),
    "one_row.png": (lambda: encode(Image.fromarray(smooth_pixels(33, 1))), None, None),
    "one_column.png": (lambda: encode(Image.fromarray(smooth_pixels(1, 17))), None, None),
    "no_tile_multiple.png": (lambda: encode(Image.fromarray(smooth_pixels(67, 35))), None, None),
    "constant.png": (solid("RGB", (10, 200, 30)), (10, 200, 30), None),
    "black_and_white.png": (solid("1", 1), (255, 255, 255), None),
    "grey.png": (solid("L", 128), (128, 128, 128), None),
    "grey_alpha.png": (grey_with_alpha, (200, 200, 200, 255), None),
    "grey_16_bits.png": (solid("I;16", 0x8080), (128, 128, 128), None),
    "colour_16_bits.png": (sixteen_bits, (128, 128, 128), "16 bits per channel"),
    "palette.png": (palette_with_transparency, (*RED, 255), None),
    "cmyk.jpg": (solid("CMYK", (0, 255, 255, 0), "JPEG"), RED, "CMYK without a colour profile"),
    "profile.png": (other_profile, RED, None),
    "rgba.png": (lambda: encode(Image.fromarray(smooth_pixels(32, 32, alpha=True))), None, None),
    "all_transparent.png": (solid("RGBA", (9, 9, 9, 0)), (0, 0, 0, 0), "every pixel is transparent"),
    "all_opaque.png": (solid("RGBA", (*RED, 255)), RED, None),
    "animated.gif": (animated, RED, "only the first one is used"),
    "turned.jpg": (turned, None, None),
    "really_a_jpeg.png": (lambda: encode(Image.new("RGB", (24, 20), RED), "JPEG", quality=95), RED, None),
    "odd name [b]\u00fc.webp": (solid("RGB", RED, "WEBP"), RED, None),
}


OF_ONE_COLOUR = {
    "one_pixel.png", "constant.png", "black_and_white.png", "grey.png", "grey_16_bits.png", "colour_16_bits.png",
    "cmyk.jpg", "profile.png", "all_transparent.png", "all_opaque.png", "animated.gif", "really_a_jpeg.png",
    "odd name [b]ü.webp",
}  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory, run_cli) -> tuple[Path, dict[str, dict], str]:
    """A folder with all of them, the JSON of each, and what was said."""
    folder = tmp_path_factory.mktemp("pictures")
    for name, (data, _, _) in PICTURES.items():
        (folder / name).write_bytes(data())
    done = run_cli("vectorize", folder, "-o", folder / "out", "--json", *SHORT)
    return folder / "out", json_lines(done.stdout), done.stderr.decode()


def test_every_picture_gives_its_three_files_and_nothing_else(made):
    results, found, _ = made
    assert set(found) == set(PICTURES)
    stems = {Path(name).stem for name in PICTURES}
    assert set(contents(results)) == {f"{stem}.{kind}" for stem in stems for kind in ("svg", "png", "json")}


@pytest.mark.parametrize("name", PICTURES)
def test_colours_size_and_notes(name, made):
    results, found, said = made
    _, colour, note = PICTURES[name]
    stem, report = Path(name).stem, found[name]
    svg = (results / f"{stem}.svg").read_text()
    with Image.open(results / f"{stem}.png") as image:
        drawn = np.asarray(image.convert("RGBA")).astype(int)
    height, width = report["input"]["height"], report["input"]["width"]
    assert drawn.shape[:2] == (height, width)
    assert f'viewBox="0 0 {width} {height}"' in svg
    transparent = name == "rgba.png" or (colour is not None and len(colour) == 4)
    assert bool((drawn[..., 3] < 255).any()) == report["input"]["alpha"] == transparent
    # What has one colour is a ground and no curve; what is all transparent is nothing.
    assert svg.count("<path") == report["output"]["paths"]
    assert (report["output"]["paths"] == 0) == (name in OF_ONE_COLOUR)
    assert svg.count("<rect") == (0 if transparent else 1)
    if name in OF_ONE_COLOUR:
        assert (report["style"], report["timing"]["steps"]) == ("photo", 0)
        assert report["quality"]["svg"]["identical"] or report["quality"]["svg"]["psnr_db"] > 50
    if colour is not None:
        wanted = np.array([*colour, 255][:4])
        last = drawn[-1, -1]
        # Over black: what a transparent pixel is coloured does not count.
        assert np.abs(last * [*[last[3] / 255] * 3, 1] - wanted * [*[wanted[3] / 255] * 3, 1]).max() <= 60, last
        if len(colour) == 3:
            assert np.abs(last - wanted).max() <= 8, last
    quality = report["quality"]["svg"]
    assert quality["identical"] or quality["psnr_db"] > 5
    if note is not None:
        assert any(note in text for text in report["notes"])
        assert f"{name}: " in said and note in said


def test_orientation_is_applied(made):
    results, found, _ = made
    assert (found["turned.jpg"]["input"]["width"], found["turned.jpg"]["input"]["height"]) == (28, 40)
    with Image.open(results / "turned.png") as image:
        drawn = np.asarray(image.convert("RGB")).astype(int)
    red = drawn[..., 0] - drawn[..., 2]
    assert red[:15].mean() > red[25:].mean() + 50


def test_transparency_comes_out_as_transparency(made):
    results, _, _ = made
    for name, alphas in (("all_transparent", (0, 0)), ("all_opaque", (255, 255)), ("grey_alpha", (0, 255))):
        with Image.open(results / f"{name}.png") as image:
            alpha = np.asarray(image.convert("RGBA"))[..., 3].astype(int)
        left, right = alpha[:, :8].mean(), alpha[:, -8:].mean()
        assert abs(left - alphas[0]) < 40, name
        assert abs(right - alphas[1]) < 40, name
    assert "<rect" not in (results / "all_transparent.svg").read_text()


def test_max_size_fits_small_and_keeps_the_size_of_the_original(photo, run_cli):
    large = photo.with_name("large.png")
    Image.fromarray(smooth_pixels(300, 211)).save(large)
    done = run_cli("vectorize", large, "--max-size", 60, "--curves", 24, "--steps", 150, "--threads", 1, "--json")
    (report,) = json_lines(done.stdout).values()
    scene = read_svg(large.with_suffix(".svg").read_bytes())
    assert (scene.width, scene.height) == (300, 211)
    assert report["settings"]["max_size"] == 60
    assert any("scaled from 300 x 211 to 60 x 42 pixels" in note for note in report["notes"])
    assert report["quality"]["svg"]["psnr_db"] > 15, "measured against the original at its own size"
    assert report["quality"]["agreement_db"] > 35
    with Image.open(large.with_name("large.rendered.png")) as image:
        assert image.size == (300, 211)


def test_a_truncated_stream_on_standard_input(run_cli):
    data = encode(Image.fromarray(smooth_pixels(40, 28)))
    said = "cubicsplat: error: stdin: is damaged or truncated"
    run_cli("vectorize", "-", *SHORT, data=data[: len(data) // 2], code=1, error=said)
    run_cli("vectorize", "-", *SHORT, data=b"", code=1, error="cubicsplat: error: ")


def test_a_bomb_is_refused_and_the_limit_can_be_raised(tmp_path, run_cli):
    bomb = tmp_path / "bomb.png"
    bomb.write_bytes(png_of(60_000, 60_000, 8, 2, b"\0" * 1000, png_chunk(b"tEXt", b"Software\0x")))
    done = run_cli("vectorize", bomb, *SHORT, code=1, error="3,600,000,000 pixels")
    assert b"--max-pixels" in done.stderr
    small = tmp_path / "small.png"
    Image.fromarray(smooth_pixels(30, 20)).save(small)
    run_cli("vectorize", small, "--max-pixels", 599, *SHORT, code=1)
    assert set(contents(tmp_path)) == {"bomb.png", "small.png"}
    run_cli("vectorize", small, "--max-pixels", 600, *SHORT)


def test_svgz(photo, run_cli, monkeypatch):
    done = run_cli("vectorize", photo, "--svgz", "--no-png", *SHORT, "--json")
    path = photo.with_suffix(".svgz")
    data = path.read_bytes()
    (report,) = json_lines(done.stdout).values()
    assert report["output"]["bytes"] == len(data)
    assert 0 < read_svg(gzip.decompress(data)).curves <= 12
    plain = run_cli("vectorize", photo, "-o", "-", *SHORT)
    assert plain.stdout == gzip.decompress(data), "nothing but the packing differs"
    assert len(data) < 0.8 * len(plain.stdout)
    drawn = run_cli("render", path, "-o", "-")
    with Image.open(io.BytesIO(drawn.stdout)) as image:
        assert image.size == (40, 28)
    assert read_file(path) == plain.stdout, "eval reads it so"
    for damaged, said in ((data[:60], "cut short"), (data[:40] + b"#" + data[41:], "damaged")):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=said):
            read_file(path)
    path.write_bytes(gzip.compress(bytes(1000)))
    monkeypatch.setattr("cubicsplat_cli.files.read.MAX_UNPACKED_BYTES", 999)
    with pytest.raises(InputError, match="when unpacked"):
        read_file(path)
