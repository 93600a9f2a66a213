"""`cubicsplat eval` and `cubicsplat render` as users start them."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from conftest import smooth_pixels
from PIL import Image
from scenes import PAPER, random_scene

from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.scene_writer import write_svg

RED = '<svg xmlns="http://www.w3.org/2000/svg" width="40" height="28"><rect width="40" height="28" fill="red"/></svg>'


@pytest.fixture
def drawing(tmp_path: Path) -> Path:
    """An SVG of ours, 40 x 28, transparent behind."""
    path = tmp_path / "drawing.svg"
    scene = random_scene(Mode.CLOSED, width=40, height=28)
    path.write_text(write_svg(scene, title="t", comment="cubicsplat test"))
    return path


def figures(done) -> dict:
    return json.loads(done.stdout, parse_constant=pytest.fail)


def test_eval_of_an_svg(photo, tmp_path, run_cli):
    candidate = tmp_path / "red.svg"
    candidate.write_text(RED)
    found = figures(run_cli("eval", photo, candidate, "--json"))
    error = smooth_pixels(40, 28) / 255.0 - np.array([1.0, 0.0, 0.0])
    assert found["quality"]["psnr_db"] == pytest.approx(-10 * np.log10((error**2).mean()), abs=1e-3)
    assert found["quality"]["renderer"].startswith("cairosvg ")
    assert found["candidate"]["kind"] == "svg"
    assert found["candidate"]["bytes"] == len(RED)
    assert found["reference"]["path"] == str(photo)
    other = figures(run_cli("eval", photo, candidate, "--json", "--renderer", "resvg"))
    assert other["quality"]["renderer"].startswith("resvg_py ")
    assert other["quality"]["psnr_db"] == pytest.approx(found["quality"]["psnr_db"], abs=1e-3)


def test_eval_of_pictures_and_its_plain_line(photo, tmp_path, run_cli):
    same = figures(run_cli("eval", photo, photo, "--json"))
    assert same["quality"] == {"renderer": None, "psnr_db": None, "ssim": 1.0, "identical": True}
    assert same["candidate"]["kind"] == "raster"
    done = run_cli("eval", photo, photo)
    assert done.stdout.decode() == f"{photo}  identical  SSIM 1.0000\n"
    darker = tmp_path / "darker.png"
    Image.fromarray(smooth_pixels(40, 28) // 2).save(darker)
    assert " dB  SSIM 0." in run_cli("eval", photo, darker).stdout.decode()


def test_eval_says_when_shapes_differ(photo, tmp_path, run_cli):
    candidate = tmp_path / "wide.svg"
    candidate.write_text(RED.replace('height="28"', 'height="10"', 1))
    done = run_cli("eval", photo, candidate, "--json")
    assert "shape" in done.stderr.decode()
    assert "shape" in figures(done)["notes"][0]
    assert run_cli("eval", photo, candidate, "-q").stderr == b""


@pytest.mark.parametrize("kind", ["missing", "other size", "not a picture", "dangerous svg", "folder"])
def test_eval_refuses_with_one_line(kind, photo, tmp_path, run_cli):
    candidate = tmp_path / "candidate.png"
    if kind == "other size":
        Image.fromarray(smooth_pixels(20, 28)).save(candidate)
    elif kind == "not a picture":
        candidate.write_text("hello")
    elif kind == "dangerous svg":
        candidate = tmp_path / "c.svg"
        candidate.write_text(RED.replace("</svg>", '<image href="file:///etc/hostname"/></svg>'))
    elif kind == "folder":
        candidate = tmp_path
    run_cli("eval", photo, candidate, code=1, error="cubicsplat: error: ")


def test_render_keeps_transparency_and_scales(drawing, run_cli):
    done = run_cli("render", drawing, "--scale", 2.5)
    with Image.open(drawing.with_suffix(".png")) as image:
        assert image.size == (100, 70)
        alpha = np.asarray(image)[..., 3]
    assert alpha.min() == 0
    assert alpha.max() > 50
    assert b"100 x 70 px" in done.stderr
    run_cli("render", drawing)  # our own PNG is replaced without --force


def test_render_to_stdout(drawing, run_cli):
    done = run_cli("render", drawing, "-o", "-", "-q", "--renderer", "resvg")
    assert done.stderr == b""
    with Image.open(BytesIO(done.stdout)) as image:
        assert (image.size, image.mode) == ((40, 28), "RGBA")
    assert not drawing.with_suffix(".png").exists()


def test_render_of_an_opaque_svg_is_the_picture_that_eval_judges(tmp_path, run_cli):
    path = tmp_path / "o.svg"
    scene = random_scene(Mode.OPEN, width=40, height=28, background=PAPER)
    path.write_text(write_svg(scene, title="t", comment="cubicsplat test"))
    run_cli("render", path)
    png = path.with_suffix(".png")
    with Image.open(png) as image:
        assert image.mode == "RGB"
    assert figures(run_cli("eval", png, path, "--json"))["quality"]["identical"] is True


def test_render_refuses(drawing, photo, run_cli):
    for arguments, code, said in (
        (["--scale", 0], 2, "scale"),
        (["--scale", "nan"], 2, "scale"),
        (["--scale", 1e6], 1, "smaller scale"),
        (["-o", "x.jpg"], 2, ".png"),
        (["-o", photo], 2, "--force"),
        (["--width", 0], 2, "--width must be a whole number from 1 to 32767, not 0"),
        (["--width", 9, "--scale", 2], 2, "give one of them"),
        (["--renderer", "inkscape"], 2, "--renderer"),
    ):
        run_cli("render", drawing, *arguments, code=code, error=said)
    run_cli("render", drawing.parent / "missing.svg", code=1)
    run_cli("render", photo, "-o", photo, "--force", code=2)  # the input itself
    assert {path.name for path in drawing.parent.iterdir()} == {"drawing.svg", "photo.png"}
    with Image.open(photo) as image:
        assert (np.asarray(image) == smooth_pixels(40, 28)).all()


UNSIZED = RED.replace('width="40" height="28"', "", 1)


@pytest.mark.parametrize(
    ("root", "arguments", "size"),
    [
        ('width="40" height="28"', ["--width", 20], (20, 14)),
        ('width="40" height="28"', ["--height", 56], (80, 56)),
        ('width="40" height="28"', ["--width", 30, "--height", 30], (30, 30)),
        ('width="25.4mm" height="0.5in" viewBox="0 0 40 28"', [], (96, 48)),
        ('width="3cm" height="30pt"', ["--scale", 2], (227, 80)),
        ('width="100%" viewBox="0 0 40 28"', [], (40, 28)),
        ('width="100%" height="100%"', ["--width", 40, "--height", 28], (40, 28)),
        ("", ["--width", 40, "--height", 28], (40, 28)),
    ],
)
def test_render_at_the_size_asked_for_whatever_the_file_says(root, arguments, size, tmp_path, run_cli):
    path = tmp_path / "x.svg"
    path.write_text(RED.replace('width="40" height="28"', root, 1))
    for renderer in ("cairosvg", "resvg"):
        run_cli("render", path, *arguments, "--renderer", renderer)
        with Image.open(path.with_suffix(".png")) as image:
            assert image.size == size
            shown = np.asarray(image.convert("RGBA"))
        assert shown[size[1] // 2, size[0] // 4].tolist() == [255, 0, 0, 255], renderer


def test_an_svg_without_a_size_is_told_how_to_get_one(tmp_path, run_cli):
    path = tmp_path / "x.svg"
    path.write_text(UNSIZED)
    run_cli("render", path, code=1, error="says no size")


def test_render_of_folders_and_several_files(drawing, tmp_path, run_cli):
    folder = tmp_path / "more"
    folder.mkdir()
    (folder / "a.svg").write_text(RED)
    (folder / "b.svg").write_text("broken")
    (folder / "notes.txt").write_text("x")
    done = run_cli("render", drawing, folder, "-o", tmp_path / "new" / "out", code=1)
    assert {path.name for path in (tmp_path / "new" / "out").iterdir()} == {"drawing.png", "a.png"}
    assert done.stderr.decode().count("cubicsplat: error: ") == 1
    assert b"b.svg" in done.stderr
    run_cli("render", folder / "a.svg", drawing)
    assert (folder / "a.png").is_file()
    assert drawing.with_suffix(".png").is_file()


def test_render_refuses_what_several_files_cannot_mean(drawing, tmp_path, run_cli):
    (tmp_path / "empty").mkdir()
    (tmp_path / "same").mkdir()
    (tmp_path / "same" / "drawing.svg").write_text(RED)
    for arguments, code, said in (
        ([drawing, tmp_path / "same", "-o", "one.png"], 2, "give a folder"),
        ([drawing, tmp_path / "same", "-o", "-"], 2, "give a folder"),
        ([drawing, "-"], 2, "only be the one input"),
        ([tmp_path / "empty"], 1, "a folder without SVGs"),
        ([drawing, tmp_path / "same", "-o", tmp_path / "out"], 2, "would both give"),
    ):
        run_cli("render", *arguments, code=code, error=said)
    assert not (tmp_path / "out").exists()


def test_eval_takes_standard_input_as_the_candidate(photo, run_cli):
    done = run_cli("eval", photo, "-", "--json", data=RED.encode())
    assert figures(done)["candidate"]["path"] == "stdin"
    assert run_cli("eval", photo, "-", data=photo.read_bytes()).stdout.decode() == "stdin  identical  SSIM 1.0000\n"
    run_cli("eval", photo, "-", data=b"", code=1, error="cubicsplat: error: stdin")
    run_cli("eval", photo.parent, "-", data=b"", code=2)


def test_failures_of_eval_over_folders_read_like_other_errors(photo, tmp_path, run_cli):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        for picture in ("a.png", "b.png"):
            (tmp_path / name / picture).write_bytes(photo.read_bytes())
    (tmp_path / "two" / "b.png").write_text("broken")
    done = run_cli("eval", tmp_path / "one", tmp_path / "two", code=1)
    (line,) = done.stderr.decode().splitlines()
    assert line.startswith("cubicsplat: error: ")
    assert "b.png" in line
