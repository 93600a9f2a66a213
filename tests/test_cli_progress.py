"""How the work is told while it goes on: on wide and narrow terminals, without one, and to readers that go away."""

from __future__ import annotations

import os
import re
import sys

import pytest
from cli_runs import SHORT, on_terminal, save_pictures
from conftest import smooth_pixels
from PIL import Image
from warm import WarmCommand

from cubicsplat_cli.cli import display
from cubicsplat_cli.cli.display import Whole

terminals = pytest.mark.skipif(sys.platform == "win32", reason="terminals of POSIX")
CONTROL = re.compile(r"\x1b\[[\d;?]*[A-Za-z]")


def test_the_time_left_for_all_counts_what_is_half_done_and_not_what_was_done_before(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(display.time, "monotonic", lambda: now[0])
    whole = Whole(10)
    for name in "abcd":
        whole.end(name)  # done by an earlier run
    assert (whole.text(), whole.left()) == ("4/10 pictures", "")
    whole.begin("e")
    whole.begin("f")
    assert whole.left() == "", "nobody can tell yet"
    now[0] += 10.0
    whole.step("e", 0.75)
    whole.step("f", 0.25)
    assert whole.left() == "50 s left", "one of six in 10 s"
    now[0] += 10.0
    whole.end("e")
    whole.step("f", 1.0)
    assert (whole.text(), whole.left()) == ("5/10 pictures", "40 s left")
    for name in "fghij":
        whole.end(name)
    assert (whole.text(), whole.left()) == ("10/10 pictures", "")


@terminals
def test_a_narrow_terminal_shows_percent_and_time_left_in_one_line(tmp_path, monkeypatch):
    path = tmp_path / "a_photo_with_a_long_name.png"
    Image.fromarray(smooth_pixels(40, 28)).save(path)
    arguments = ["vectorize", path, "--style", "photo", "--curves", 12, "--steps", 4000, "--no-png"]
    code, text = on_terminal(arguments, monkeypatch, COLUMNS="40", NO_COLOR="1")
    assert code == 0
    lines = [line for line in re.split(r"[\r\n]+", CONTROL.sub("", text)) if " %" in line]
    assert any(re.search(r"a_photo_wi\.\.\.\s+\d+ %  [\d.]+ s left", line) for line in lines), lines
    assert max(len(line.rstrip()) for line in lines) <= 40


@terminals
def test_every_stage_has_a_word(photo, monkeypatch):
    arguments = ["vectorize", photo, *SHORT, "--report", "--animation", photo.with_suffix(".webp")]
    code, text = on_terminal(arguments, monkeypatch)
    assert code == 0, text
    assert photo.with_suffix(".html").is_file()


def test_without_a_terminal_v_tells_of_time_limited_fits_and_of_the_whole(tmp_path, run_cli):
    save_pictures(tmp_path, ["a.png", "b.png"])
    arguments = ("--style", "photo", "--curves", 12, "--no-png", "--threads", 1)
    done = run_cli("vectorize", tmp_path / "a.png", *arguments, "--steps", 100_000, "--time-limit", 1.5, "-v")
    assert done.returncode == 0, done.stderr
    shares = [int(share) for share in re.findall(rb"a\.png: +(\d+) %", done.stderr)]
    assert len(shares) >= 4
    assert shares == sorted(shares)
    done = run_cli("vectorize", tmp_path, "-o", tmp_path / "out", *arguments, "--steps", 30, "-v")
    assert re.findall(rb"\d/\d pictures", done.stderr) == [b"1/2 pictures", b"2/2 pictures"]
    done = run_cli("vectorize", tmp_path, "-o", tmp_path / "out2", *arguments, "--steps", 30)
    assert b"1/2 pictures" not in done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="pipes of POSIX")
@pytest.mark.parametrize("arguments", [["eval", "IN", "IN", "--json"], ["vectorize", "IN", "--dry-run", "--json"],
                                       ["vectorize", "IN", *SHORT, "--json", "-q"], ["doctor"]])  # fmt: skip
def test_a_reader_that_goes_away_is_no_news(arguments, photo):
    reader, writer = os.pipe()
    os.close(reader)
    with WarmCommand(*(photo if word == "IN" else word for word in arguments), stdout=writer) as command:
        os.close(writer)
        done = command.wait()
    assert (done.returncode, done.stderr) == (1, b"")


@pytest.mark.skipif(sys.platform == "win32", reason="names of POSIX")
def test_a_dry_run_escapes_names(tmp_path, run_cli):
    path = tmp_path / "two\nlines\x1b[31m.png"
    Image.fromarray(smooth_pixels(20, 16)).save(path)
    done = run_cli("vectorize", path, "--dry-run")
    assert done.stdout.count(b"\n") == 1
    assert b"two\\nlines\\x1b[31m.png -> " in done.stdout
    assert b"\x1b" not in done.stdout
