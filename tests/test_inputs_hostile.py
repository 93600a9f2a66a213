"""Files, folders and disks that do not play along, through the real command: one line, an exit code, nothing left."""

from __future__ import annotations

import ctypes
import hashlib
import os
import resource
import signal
import subprocess
import sys
import threading
import time
import types
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cli_runs import SHORT, contents, save_pictures, start, strict_json, wait_until
from command import one_error
from conftest import rest_slow
from image_files import encode
from PIL import Image
from warm import WarmCommand, run_warm

from cubicsplat_cli.files.marks import provenance_comment, with_checksum
from cubicsplat_cli.files.names import outputs_beside
from cubicsplat_cli.files.write import encode_png, folder_locked
from cubicsplat_cli.jobs.plan import Job
from cubicsplat_cli.jobs.results import FileSink
from cubicsplat_cli.progress import interrupt
from cubicsplat_cli.svg.scene_reader import read_svg

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="permissions, limits and signals of POSIX")

# Of Linux: the version of its sets of powers, and those of root to pass over permission bits, to write and to read.
_VERSION, _OVERRIDING = 0x20080522, 1 << 1 | 1 << 2
ordinary = pytest.mark.skipif(
    sys.platform != "linux" and hasattr(os, "geteuid") and os.geteuid() == 0,
    reason="root cannot give up its powers here",
)


def as_ordinary_user() -> None:
    """In a process of its own: let permission bits count, as they do for everybody but root."""
    if os.geteuid() == 0:
        libc = ctypes.CDLL(None, use_errno=True)
        header = (ctypes.c_uint32 * 2)(_VERSION, 0)
        powers = (ctypes.c_uint32 * 6)()  # effective, permitted, inheritable; then those of higher numbers
        for call in (libc.capget, libc.capset):
            if call(header, powers) != 0:
                raise OSError(ctypes.get_errno(), "root cannot give up its powers here")
            powers[0] &= ~_OVERRIDING
            powers[1] &= ~_OVERRIDING


def warm_error(said: str, *arguments: object, before: Callable[[], None]) -> None:
    """The command fails with one line after something was done to its process."""
    done = run_warm("vectorize", *arguments, *SHORT, before=before)
    assert done.returncode == 1
    one_error(done, said)


@pytest.fixture
def jpeg(tmp_path) -> Path:
    save_pictures(tmp_path, ["x.jpg"])
    return tmp_path / "x.jpg"


PNG = encode(Image.fromarray(np.random.default_rng(1).integers(0, 256, (40, 50, 3), dtype=np.uint8)))
BAD = {
    "missing.png": (None, "no such file"),
    "empty.png": (b"", "empty"),
    "cut.png": (PNG[: len(PNG) // 2], "damaged or truncated"),
    "head_only.png": (PNG[:33], "begins like a picture, but is damaged or truncated"),
    "text.png": (b"hello, I am text\n" * 9, "is not a picture in a supported format"),
    "drawing.svg": (b"<svg xmlns='http://www.w3.org/2000/svg'/>", "already vector"),
    "format.pdf": (b"%PDF-1.7\n%\xe2\xe3\xcf\xd3\n", "is not a picture in a supported format"),
    "null\nline.png": (b"\0" * 100, "null\\nline.png"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_alone(name, tmp_path, run_cli):
    data, said = BAD[name]
    if data is not None:
        (tmp_path / name).write_bytes(data)
    before = contents(tmp_path)
    run_cli("vectorize", tmp_path / name, *SHORT, code=1, error=said)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("kind", ["fifo", "loop of links", "empty folder", "device"])
@pytest.mark.timeout(100)
def test_what_is_no_file(kind, tmp_path, run_cli):
    path = tmp_path / "x.png"
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "loop of links":
        path.symlink_to(path)
    elif kind == "device":
        path = Path("/dev/zero")
    else:
        path.mkdir()
    run_cli("vectorize", path, *SHORT, code=1, error="cubicsplat: error: ")
    assert contents(tmp_path) == {}


@ordinary
def test_a_folder_nobody_may_look_into(tmp_path):
    folder = tmp_path / "locked"
    save_pictures(folder, ["x.jpg"])
    folder.chmod(0)
    try:
        for path in (folder, folder / "x.jpg", folder / "*.jpg"):
            warm_error("locked", path, before=as_ordinary_user)
        warm_error("cannot be read", tmp_path, "-r", before=as_ordinary_user)
    finally:
        folder.chmod(0o755)
    assert set(contents(folder)) == {"x.jpg"}


def test_names_that_no_file_can_have(jpeg, run_cli):
    for arguments in (["a" * 300 + ".png"], [jpeg, "-o", jpeg.parent / ("a" * 300 + ".svg")]):
        run_cli("vectorize", *arguments, *SHORT, code=1, error="name too long")
    done = run_cli("vectorize", jpeg, jpeg.with_name("b" * 300), "-o", jpeg.parent / ("a" * 300), *SHORT, code=1)
    assert b"Traceback" not in done.stderr
    assert list(jpeg.parent.iterdir()) == [jpeg]


@ordinary
def test_read_only_folder(jpeg, tmp_path):
    folder = tmp_path / "locked"
    folder.mkdir()
    folder.chmod(0o555)
    try:
        for output in (folder / "x.svg", folder / "x.pdf", f"{folder}/new/"):
            warm_error("locked", jpeg, "-o", output, before=as_ordinary_user)
    finally:
        folder.chmod(0o755)
    assert list(folder.iterdir()) == []


def full_disk() -> None:
    """No file may grow beyond a few bytes: the nearest to a full disk that needs no disk."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (600, 600))


def test_full_disk(jpeg):
    warm_error("free some space", jpeg, before=full_disk)
    assert list(jpeg.parent.iterdir()) == [jpeg], "no partial output, no temporary file"


def test_the_input_is_never_overwritten(jpeg, run_cli):
    svg = jpeg.with_name("really_a_jpeg.svg")
    svg.write_bytes(jpeg.read_bytes())
    before = contents(jpeg.parent)
    for arguments in ([svg], [svg, "--force"], [svg, "-o", svg, "--force"], [jpeg, svg, "--force", "-o", jpeg.parent]):
        done = run_cli("vectorize", *arguments, "--dry-run", *SHORT, code=None)
        assert done.returncode in (1, 2), arguments
        assert b"is the input and would be overwritten" in done.stderr
        assert contents(jpeg.parent) == before


def test_two_runs_on_one_output(jpeg, tmp_path):
    results = tmp_path / "out"
    results.mkdir()
    arguments = ("vectorize", jpeg, "-o", results / "x.svg", "--curves", 12, "--steps", 300, "--threads", 1)
    with WarmCommand(*arguments) as one, WarmCommand(*arguments) as other:
        assert [run.wait().returncode for run in (one, other)] == [0, 0]
    assert set(contents(results)) == {"x.svg", "x.png", "x.json"}
    assert read_svg((results / "x.svg").read_bytes()).width == 24
    report = strict_json((results / "x.json").read_bytes())
    assert report["output"]["svg_sha256"] == hashlib.sha256((results / "x.svg").read_bytes()).hexdigest()


@pytest.mark.parametrize("order", rest_slow("abAB", "abA", "abBA", "baAB", "aAbB", "abB", fast=2))
def test_two_runs_on_one_output_leave_the_set_of_the_one_that_ends_last(order, tmp_path):
    job = Job("x.png", tmp_path / "x.png", outputs_beside(tmp_path / "x.svg", png=True))
    sinks = {name: FileSink(job) for name in "ab"}
    for name in order:
        sink, end = sinks[name.lower()], name.lower().encode()
        if name.islower():
            text = provenance_comment(0, "0" * 12, "0" * 64)
            svg = with_checksum(f"<svg><!-- {text} --><g id='{name}'/></svg>").encode()
            sink.put("svg", svg)
            sink.put("png", encode_png(np.zeros((2, 2, 4), np.uint8)) + end)
            assert not job.outputs.metrics.exists(), "there is no report of files that are being replaced"
        else:
            sink.put("metrics", b'{\n  "schema": 1,\n  "program": "cubicsplat"' + end)
            last = end
    assert b"id='" + last + b"'" in job.outputs.svg.read_bytes()
    assert {job.outputs.png.read_bytes()[-1:], job.outputs.metrics.read_bytes()[-1:]} == {last}
    job.outputs.svg.write_bytes(job.outputs.svg.read_bytes().replace(b"</svg>", b"<!-- mine --></svg>"))
    sinks["a"].put("metrics", b"{}a")
    assert b"mine" in job.outputs.svg.read_bytes(), "somebody's work is not replaced"


def test_files_are_put_while_no_other_run_does(tmp_path):
    sink = FileSink(Job("x.png", tmp_path / "x.png", outputs_beside(tmp_path / "x.svg", png=True)))
    with folder_locked(tmp_path):
        putting = threading.Thread(target=sink.put, args=("svg", b"<svg/>"))
        putting.start()
        putting.join(0.1)
        assert putting.is_alive()
        assert not sink.written
    putting.join(100)
    assert sink.written
    assert [path.name for path in tmp_path.iterdir()] == ["x.svg"]


def test_an_interrupt_waits_for_the_import_of_torch(monkeypatch):
    importing = types.SimpleNamespace(__spec__=types.SimpleNamespace(_initializing=True))
    monkeypatch.setitem(sys.modules, "torch", importing)
    before = signal.signal(signal.SIGINT, lambda _number, _frame: interrupt())
    try:
        signal.raise_signal(signal.SIGINT)  # raises nothing yet
        importing.__spec__._initializing = False
        with pytest.raises(KeyboardInterrupt):
            for _ in range(3000):  # a signal raised by a thread ends no sleep
                time.sleep(0.01)
    finally:
        signal.signal(signal.SIGINT, before)


def cpu_seconds(process_id: int) -> float:
    """What a process has computed so far, which says better than the clock how far it has come."""
    fields = Path(f"/proc/{process_id}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks into /proc")
@pytest.mark.parametrize("delay", rest_slow(0.8, 0.02, 0.3, 1.4))
def test_ctrl_c_at_any_moment(delay, jpeg):
    process = start("vectorize", jpeg, "--curves", 12, "--steps", 4_000_000, "--threads", 1)
    try:
        wait_until(lambda: cpu_seconds(process.pid) >= delay)
        process.send_signal(signal.SIGINT)
        try:
            _, errors = process.communicate(timeout=15 if delay < 0.1 else 150)
        except subprocess.TimeoutExpired:
            # While the interpreter starts, an interrupt may be lost before our first line: whoever waits presses again.
            assert delay < 0.1
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=150)
    finally:
        process.kill()
    left = set(contents(jpeg.parent)) - {jpeg.name}
    # Before Python has come to our first line, an interrupt is Python's to answer.
    # (a shell shows -SIGINT as 130 too: Python ends so where C code met the interrupt).
    assert process.returncode in (130, -signal.SIGINT) or (delay < 0.1 and process.returncode == 1), errors
    assert left in (set(), {"x.svg", "x.png", "x.json"})
    if left:
        assert strict_json(jpeg.with_suffix(".json").read_bytes())["interrupted"] is True
        assert read_svg(jpeg.with_suffix(".svg").read_bytes()).width == 24
    if delay >= 0.2:
        assert b"Traceback" not in errors
