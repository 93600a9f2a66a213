"""How the work is told while it goes on: on wide and narrow terminals, without one, and to readers that go away."""

from __future__ import annotations

import contextlib
import functools
import io
import os
import re
import sys

import pytest
from cli_runs import SHORT, on_terminal, save_pictures
from conftest import smooth_pixels
from PIL import Image
from warm import WarmCommand

from cubicsplat_cli.cli.console import Display, LiveDisplay, PlainDisplay
from cubicsplat_cli.progress import Progress

terminals = pytest.mark.skipif(sys.platform == "win32", reason="terminals of POSIX")
CONTROL = re.compile(r"\x1b\[[\d;?]*[A-Za-z]")


def test_the_time_left_for_all_counts_what_is_half_done_and_not_what_was_done_before():
    now = [100.0]
    whole = Display(10, clock=lambda: now[0])
    for name in "abcd":
        whole.end(name)  # done by an earlier run
    assert (whole.text(), whole.left()) == ("4/10 pictures", "")
    whole.begin("e")
    whole.begin("f")
    assert whole.left() == "", "nobody can tell yet"
    now[0] += 10.0
    whole.step(Progress(0.75, 0, 0, None, None, 0, 0.0), "e")
    whole.step(Progress(0.25, 0, 0, None, None, 0, 0.0), "f")
    assert whole.left() == "50 s left", "one of six in 10 s"
    now[0] += 10.0
    whole.end("e")
    whole.step(Progress(1.0, 0, 0, None, None, 0, 0.0), "f")
    assert (whole.text(), whole.left()) == ("5/10 pictures", "40 s left")
    for name in "fghij":
        whole.end(name)
    assert (whole.text(), whole.left()) == ("10/10 pictures", "")


def test_a_narrow_terminal_shows_percent_and_time_left_in_one_line(monkeypatch):
    for name, value in {"TERM": "xterm-256color", "COLUMNS": "40", "NO_COLOR": "1"}.items():
        monkeypatch.setenv(name, value)
    stderr = io.StringIO()
    stderr.isatty = lambda: True
    with contextlib.redirect_stderr(stderr), LiveDisplay(1) as shown:
        shown.begin("folder/a_photo_with_a_long_name.png")
        shown.step(Progress(0.25, 10, 40, 20.0, 3.5, 0, 12.0), "folder/a_photo_with_a_long_name.png")
    lines = [line for line in re.split(r"[\r\n]+", CONTROL.sub("", stderr.getvalue())) if " %" in line]
    assert any(re.search(r"a_photo_wi\.\.\.\s+25 %  12 s left", line) for line in lines), lines
    assert max(len(line.rstrip()) for line in lines) <= 40


class Terminal:
    """What is on a terminal that lays lines out anew when its width changes. follows: of a row, whether it goes on the
    line of the row above it.
    """

    def __init__(self, width: int) -> None:
        self.width, self.row, self.column = width, 0, 0
        self.rows, self.follows = [""], [False]

    def feed(self, text: str) -> None:
        for control, letter in re.findall(r"(\x1b\[[\d;?]*[A-Za-z])|([^\x1b])", text):
            if letter == "\r":
                self.column = 0
            elif letter == "\n":
                self._down(follows=False)
            elif control.endswith("K"):
                self.rows[self.row] = ""
                self.follows[self.row : self.row + 2] = [False] * len(self.follows[self.row : self.row + 2])
            elif control.endswith("A"):
                self.row = max(0, self.row - int(control[2:-1]))
            elif letter:
                if self.column == self.width:
                    self._down(follows=True)
                self.rows[self.row] = f"{self.rows[self.row].ljust(self.column)[: self.column]}{letter}"
                self.column += 1

    def _down(self, *, follows: bool) -> None:
        self.row, self.column = self.row + 1, 0
        if self.row == len(self.rows):
            self.rows.append("")
            self.follows.append(False)
        self.follows[self.row] = follows

    def resize(self, width: int) -> None:
        lines: list[str] = []
        for index, (row, follows) in enumerate(zip(self.rows, self.follows, strict=True)):
            lines = [*lines[:-1], lines[-1] + row] if follows else [*lines, row]
            if index == self.row:
                line, place = len(lines) - 1, len(lines[-1]) - len(row) + self.column
        self.width, self.rows, self.follows = width, [], []
        for index, text in enumerate(lines):
            if index == line:
                self.row = len(self.rows) + max(0, place - 1) // width
                self.column = place - max(0, place - 1) // width * width
            starts = range(0, max(1, len(text)), width)
            self.rows += [text[start : start + width] for start in starts]
            self.follows += [start > 0 for start in starts]


@terminals
def test_a_terminal_whose_size_changes_keeps_nothing_of_the_bars(monkeypatch):
    import codecs
    import fcntl
    import pty
    import select
    import struct
    import termios

    import rich.progress

    parent, child = pty.openpty()
    terminal = Terminal(100)
    decoder = codecs.getincrementaldecoder("utf-8")()

    def show() -> None:
        """What was written: the kernel hands it on a moment later, and in parts."""
        while select.select([parent], [], [], 0.1)[0]:
            terminal.feed(decoder.decode(os.read(parent, 1 << 16)))

    def resize(columns: int) -> None:
        """When the bars are still, as they nearly always are: what crosses a change of size is anybody's guess."""
        show()
        fcntl.ioctl(child, termios.TIOCSWINSZ, struct.pack("HHHH", 30, columns, 0, 0))
        terminal.resize(columns)

    size = os.get_terminal_size
    monkeypatch.setattr(os, "get_terminal_size", lambda _fd=0: size(child))
    for name in ("COLUMNS", "LINES", "NO_COLOR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    manual = functools.partial(rich.progress.Progress, auto_refresh=False)
    monkeypatch.setattr(rich.progress, "Progress", manual)
    with os.fdopen(child, "w") as stderr, contextlib.redirect_stderr(stderr):
        fcntl.ioctl(child, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
        print("before", file=stderr, flush=True)
        with LiveDisplay(3) as shown:
            for name in ("a_picture_of_some_length.png", "another_picture.png"):
                shown.begin(name)
                shown.step(Progress(0.1, 10, 100, 20.0, 3.5, 0, 12.0), name)
            for columns in (60, 100, 33, 20, 90, 30):
                shown._bars.refresh()
                resize(columns)
            shown.print("a note")
            resize(25)
        show()
    os.close(parent)
    assert [row.rstrip() for row in terminal.rows if row] == ["before", "a note"]


@terminals
def test_every_stage_has_a_word(photo, monkeypatch):
    arguments = ["vectorize", photo, *SHORT, "--report", "--animation", photo.with_suffix(".webp")]
    code, text = on_terminal(arguments, monkeypatch)
    assert code == 0, text
    assert photo.with_suffix(".html").is_file()


def test_lines_come_at_shares_of_the_work_however_fast_it_is():
    lines: list[str] = []
    display = PlainDisplay(lines.append, 1)
    display.begin("a.png")
    for step in range(201):
        display.step(Progress(step / 200, step, 200, 20.0, 3.5, 0, 12.0), "a.png")
    shares = [int(share) for share in re.findall(r"a\.png: +(\d+) %", "\n".join(lines))]
    assert 3 <= len(shares) <= 50
    assert shares == sorted(shares) and (shares[0], shares[-1]) == (0, 100)


def test_without_a_terminal_v_tells_of_time_limited_fits_and_of_the_whole(tmp_path, run_cli):
    save_pictures(tmp_path, ["a.png", "b.png"])
    arguments = ("--style", "photo", "--curves", 12, "--no-png", "--threads", 1)
    done = run_cli("vectorize", tmp_path / "a.png", *arguments, "--steps", 100_000, "--time-limit", 0.5, "-v")
    shares = [int(share) for share in re.findall(rb"a\.png: +(\d+) %", done.stderr)]
    assert shares and shares == sorted(shares)
    done = run_cli("vectorize", tmp_path, "-o", tmp_path / "out", *arguments, "--steps", 30, "-v")
    assert re.findall(rb"\d/\d pictures", done.stderr) == [b"1/2 pictures", b"2/2 pictures"]
    done = run_cli("vectorize", tmp_path, "-o", tmp_path / "out2", *arguments, "--steps", 30)
    assert b"1/2 pictures" not in done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="pipes of POSIX")
@pytest.mark.parametrize("arguments", [["eval", "IN", "IN", "--json"], ["vectorize", "IN", "--dry-run", "--json"],
                                       ["vectorize", "IN", *SHORT, "--json", "-q"],
                                       ["vectorize", "IN", *SHORT, "-o", "-", "-q"], ["doctor"]])  # fmt: skip
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
