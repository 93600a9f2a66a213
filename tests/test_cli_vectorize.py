"""`cubicsplat vectorize` as users start it: files, figures, streams, refusals, Ctrl-C. Tiny pictures, few steps."""

from __future__ import annotations

import hashlib
import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from cli_runs import SHORT, on_terminal, save_pictures, strict_json, wait_until
from conftest import rest_slow
from PIL import Image
from warm import WarmCommand

from cubicsplat_cli.evaluate.images import of_pixels
from cubicsplat_cli.evaluate.metrics import compare
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.svg.scene_reader import read_svg

SUMMARY = r"{name}  photo  1?\d curves  [\d.]+ kB  SVG [\d.]+ dB  SSIM [\d.]+  [\d.]+ s  cpu"


def test_writes_svg_png_and_json_whose_figures_are_those_of_the_file(photo, run_cli):
    done = run_cli("vectorize", photo, *SHORT)
    assert done.stdout == b""
    svg, png, report = (photo.with_name(name) for name in ("photo.svg", "photo.rendered.png", "photo.json"))
    assert re.fullmatch(SUMMARY.format(name=re.escape(str(svg))), done.stderr.decode().strip())
    scene = read_svg(svg.read_bytes())
    assert (scene.width, scene.height) == (40, 28)
    assert 6 <= scene.curves <= 12
    found = strict_json(report.read_bytes())
    picture = load_picture(photo)
    quality = compare(picture, of_pixels(rerender(svg.read_bytes(), 40, 28).pixels))
    assert found["quality"]["svg"]["psnr_db"] == pytest.approx(quality.psnr_db, abs=1e-3)
    assert found["quality"]["svg"]["ssim"] == pytest.approx(quality.ssim, abs=1e-4)
    assert compare(picture, of_pixels(np.asarray(Image.open(png)))).psnr_db == pytest.approx(quality.psnr_db, abs=1e-6)
    assert quality.psnr_db > 12, "30 steps do better than this"
    own = found["quality"]["surrogate"]["psnr_db"]
    assert found["quality"]["gap_db"] == pytest.approx(own - quality.psnr_db, abs=1e-3)
    assert abs(found["quality"]["gap_db"]) < 0.5
    assert found["quality"]["agreement_db"] > 35


def test_report_follows_schema_one(photo, run_cli, tmp_path):
    out = tmp_path / "sub" / "x.svg"
    out.parent.mkdir()
    done = run_cli("vectorize", photo, "-o", out, "--json", "--no-png", "-q", "--seed", 3, *SHORT)
    assert done.stderr == b""
    found = strict_json(done.stdout)
    assert done.stdout.count(b"\n") == 1, "one line a picture"
    assert found.pop("status") == "done"
    assert strict_json(out.with_suffix(".json").read_bytes()) == found
    assert sorted(path.name for path in out.parent.iterdir()) == ["x.json", "x.svg"]
    assert found["schema"] == 1
    assert found["input"]["path"] == str(photo)
    assert (found["input"]["width"], found["input"]["height"], found["input"]["alpha"]) == (40, 28, False)
    data = out.read_bytes()
    written = {"svg": str(out), "png": None, "bytes": len(data), "paths": data.count(b"<path")}
    hashes = {"svg_sha256": hashlib.sha256(data).hexdigest(), "png_sha256": None, "compressed_bytes": None}
    assert found["output"] == {**written, **hashes}
    assert (found["settings"]["curves"], found["settings"]["steps"], found["settings"]["seed"]) == (12, 30, 3)
    assert found["settings"]["precision"] is None
    assert found["timing"]["steps"] == 30
    assert found["timing"]["total_s"] >= found["timing"]["fit_s"] > 0
    assert found["device"]["name"] == "cpu"
    assert found["interrupted"] is False
    assert found["history"][-1]["step"] == 30
    source = hashlib.sha256(photo.read_bytes()).hexdigest()
    assert found["input"]["sha256"] == source
    comment = f"<!-- cubicsplat {found['version']}, seed 3, settings {found['settings_hash']}, input {source}, "
    assert comment in data.decode()
    docs = (Path(__file__).resolve().parents[1] / "docs" / "metrics-json.md").read_text(encoding="utf-8")
    for name, value in found.items():
        members = [f"{name}.{inner}" for inner in value] if name in ("input", "output", "timing") else [name]
        for member in [f"quality.{inner}" for inner in value] if name == "quality" else members:
            assert f"`{member}`" in docs, f"{member} is not documented"


def test_same_seed_same_file_whatever_the_threads_and_presets_order(photo, run_cli, tmp_path):
    first, second = (tmp_path / f"{name}.svg" for name in "ab")
    common = ("--curves", 12, "--steps", 25, "-q", "--no-png")
    run_cli("vectorize", photo, "-o", first, *common, "--preset", "draft", "--threads", 1)
    run_cli("vectorize", photo, "-o", second, "--preset", "draft", *common, "--threads", 2)
    assert first.read_bytes() == second.read_bytes()


def test_transparency_stays_transparent(logo, run_cli):
    run_cli("vectorize", logo, "--curves", 12, "--steps", 80)
    svg = logo.with_suffix(".svg").read_bytes()
    assert b"<rect" not in svg
    pixels = rerender(svg, 32, 32).pixels
    assert pixels[0, 0, 3] < 64
    assert pixels[16, 14, 3] > 192
    assert strict_json(logo.with_suffix(".json").read_bytes())["input"]["alpha"] is True


def test_open_curves_background_and_precision(photo, run_cli):
    run_cli("vectorize", photo, *SHORT, "--mode", "open", "--background", "teal", "--precision", 1)
    text = photo.with_suffix(".svg").read_text()
    assert 'stroke-linecap="round"' in text
    assert 'fill="#008080"' in text
    assert not re.search(r' d="[^"]*\.\d\d', text)


def test_svg_on_stdout_from_stdin(photo, run_cli):
    done = run_cli("vectorize", "-", *SHORT, data=photo.read_bytes())
    assert 0 < read_svg(done.stdout).curves <= 12
    assert re.match(rb"stdout  photo  \d+ curves", done.stderr)
    assert [path.name for path in photo.parent.iterdir()] == ["photo.png"]


def test_a_time_limit_gives_a_finished_fit(photo, run_cli):
    endless = ("--curves", 12, "--steps", 9_000_000, "--threads", 1, "--time-limit", 0.6)
    done = run_cli("vectorize", photo, *endless, "--json", "--no-png")
    found = strict_json(done.stdout)
    assert (found["status"], found["interrupted"]) == ("done", False)
    assert found["timing"]["fit_s"] < 60, "wide: the machine may be busy"
    assert 0 < found["timing"]["steps"] < 9_000_000
    assert found["settings"]["time_limit"] == 0.6
    run_cli("vectorize", photo, "--time-limit", 0, "--force", code=2, error="time-limit")


def test_our_files_are_replaced_and_those_of_others_are_not(photo, run_cli):
    svg = photo.with_suffix(".svg")
    svg.write_text("<svg><!-- drawn by hand --></svg>")
    before = photo.read_bytes()
    run_cli("vectorize", photo, *SHORT, code=2, error="--force")
    assert "by hand" in svg.read_text()
    run_cli("vectorize", photo, *SHORT, "--force")
    first = svg.read_bytes()
    run_cli("vectorize", photo, *SHORT, "--seed", 9)  # our own file needs no --force
    assert svg.read_bytes() != first
    assert photo.read_bytes() == before, "the input was changed"
    assert not list(photo.parent.glob("*.tmp"))


def test_an_output_folder_that_does_not_exist_is_made(photo, run_cli):
    run_cli("vectorize", photo, "-o", photo.parent / "new" / "deep" / "x.svg", *SHORT)
    assert sorted(path.name for path in (photo.parent / "new" / "deep").iterdir()) == ["x.json", "x.png", "x.svg"]


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_ctrl_c_writes_the_best_svg_so_far(photo):
    with WarmCommand("vectorize", photo, "--curves", 12, "--steps", 5_000_000, "-v") as command:
        wait_until(lambda: b", step " in command.stderr() or not command.running())
        command.interrupt()
        done = command.wait()
    rest = done.stderr.decode()
    assert done.returncode == 130, rest
    assert "interrupted at step" in rest
    assert "Traceback" not in rest
    assert 0 < read_svg(photo.with_suffix(".svg").read_bytes()).curves <= 12
    found = strict_json(photo.with_suffix(".json").read_bytes())
    assert found["interrupted"] is True
    assert 0 < found["timing"]["steps"] < 5_000_000
    assert photo.with_suffix(".rendered.png").is_file()


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("jobs", rest_slow(1, 2))
def test_ctrl_c_writes_the_drawings_so_far(jobs, tmp_path):
    """Of rings whose finish takes a second."""
    y, x = np.mgrid[0:240, 0:240] + 0.5
    cover = np.ones((240, 240))
    for u, v, r in np.random.default_rng(4).uniform((20, 20, 6), (220, 220, 18), (60, 3)):
        cover = np.minimum(cover, np.clip(np.abs(np.hypot(x - u, y - v) - r) - 1.5, 0.0, 1.0))
    for name in "ab"[:jobs]:
        Image.fromarray(np.rint(255 * cover).astype(np.uint8)).save(tmp_path / f"{name}.png")
    with WarmCommand("vectorize", *tmp_path.glob("*.png"), "--style", "artwork", "-j", jobs, "-v") as command:
        wait_until(lambda: command.stderr().count(b"fitting to the pixels") >= jobs or not command.running())
        command.interrupt()
        done = command.wait()
    assert done.returncode == 130, done.stderr
    assert b"Traceback" not in done.stderr
    reports = [strict_json(path.read_bytes()) for path in tmp_path.glob("*.json")]
    assert [report["interrupted"] for report in reports] == [True] * jobs
    assert all(report["quality"]["svg"]["psnr_db"] > 20 for report in reports)


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_ctrl_c_before_the_fit_writes_nothing(tmp_path):
    import fcntl
    import termios

    def unread() -> int:
        return int.from_bytes(fcntl.ioctl(source, termios.FIONREAD, bytes(4)), sys.byteorder)

    source, pipe = os.pipe()
    os.write(pipe, b"the beginning of a picture")
    try:
        with WarmCommand("vectorize", "-", "-o", tmp_path / "x.svg", stdin=source) as command:
            wait_until(lambda: unread() == 0 or not command.running())
            assert command.running(), "it should be waiting for more of its input"
            command.interrupt()
            done = command.wait()
    finally:
        os.close(source)
        os.close(pipe)
    assert done.returncode == 130
    assert b"Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="terminals of POSIX")
def test_progress_bar_on_a_terminal_and_its_colours(photo, monkeypatch):
    # Square brackets in the name must not be taken for markup.
    path = photo.with_name("[red]a[bold].png")
    photo.rename(path)
    arguments = ["vectorize", path, "--curves", 12, "--no-png", "--force", "--steps"]
    code, text = on_terminal([*arguments, 4000], monkeypatch)
    assert code == 0
    assert "[red]a[bold].png" in text
    assert re.search(r"\d+ %", text)
    assert "dB" in text
    assert "replaced" in text
    assert re.search(r"\x1b\[[\d;]*3\d", text), "colours on a terminal"
    code, text = on_terminal([*arguments, 30], monkeypatch, TERM="dumb")
    assert code == 0
    assert " %" not in text, "a terminal without cursor movements cannot hold a bar"
    assert "\x1b" not in text


@pytest.mark.skipif(sys.platform == "win32", reason="terminals of POSIX")
def test_one_display_for_many_pictures(tmp_path, monkeypatch):
    save_pictures(tmp_path / "in", ("a.png", "b.png", "c.png"))
    (tmp_path / "in" / "bad.png").write_text("no picture")
    arguments = ["vectorize", tmp_path / "in", "-o", tmp_path / "out", "-j", 2, "--curves", 12, "--steps", 4000]
    code, text = on_terminal(arguments, monkeypatch, NO_COLOR="1")
    assert code == 1
    assert re.search(r"[0-4]/4 pictures", text), "the whole"
    assert re.search(r"[abc]\.png [^\n]*\d+ % [^\n]* dB", text), "and each under way"
    assert not re.search(r"\x1b\[[\d;]*[349]\d[\d;]*m", text), "NO_COLOR was not honoured"
    assert text.rstrip().splitlines()[-1].startswith("cubicsplat: error: ")
