"""What is left when processes die: kill -9 of the command or of a worker, and Ctrl-C. Nothing may be lost."""

from __future__ import annotations

import os
import re
import signal
import sys
from pathlib import Path

import pytest
from cli_runs import contents, json_lines, save_pictures, start, wait_until

from cubicsplat_cli.svg.scene_reader import read_svg

pytestmark = pytest.mark.skipif(not Path("/proc").is_dir() or sys.platform == "win32", reason="looks into /proc")

NAMES = ("a.png", "b.png", "c.png", "d.png")
OPTIONS = ("--curves", 12, "--steps", 900, "--threads", 2, "-j", 2, "--json")


def children(process_id: int) -> list[int]:
    """Process ids of the worker processes of a command: spawned by it, or forked from a process that it started."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rsplit(")", 1)[1].split()
            command = (status.parent / "cmdline").read_bytes()
        except OSError:  # it has ended meanwhile
            continue
        if int(fields[1]) == process_id and fields[0] != "Z":
            if b"forkserver" in command:
                found += forked(int(status.parent.name))
            elif b"spawn_main" in command:
                found.append(int(status.parent.name))
    return found


def forked(process_id: int) -> list[int]:
    """The living children of a process."""
    try:
        ids = Path(f"/proc/{process_id}/task/{process_id}/children").read_text().split()
    except OSError:
        return []
    return [int(child) for child in ids if not gone(int(child))]


def gone(process_id: int) -> bool:
    try:
        return Path(f"/proc/{process_id}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True


@pytest.fixture(scope="module")
def clean(tmp_path_factory, run_cli) -> tuple[Path, dict[str, bytes]]:
    """A folder of pictures and what an undisturbed run makes of it."""
    folder = tmp_path_factory.mktemp("clean")
    save_pictures(folder / "in", NAMES)
    run_cli("vectorize", folder / "in", "-o", folder / "out", *OPTIONS, "-j", 1)
    return folder / "in", contents(folder / "out")


def interrupted_run(pictures: Path, results: Path, act) -> tuple[int, str, bytes]:
    """Start a run, `act` on its process when the first SVG is there, and wait for its end."""
    output = results.parent / "stdout"
    with output.open("wb") as stdout:
        process = start("vectorize", pictures, "-o", results, *OPTIONS, stdout=stdout)
        try:
            wait_until(lambda: list(results.glob("*.svg")) or process.poll() is not None)
            assert process.poll() is None, process.stderr.read()
            act(process)
            _, errors = process.communicate(timeout=150)
        finally:
            process.kill()
    return process.returncode, errors.decode(), output.read_bytes()


def test_kill_9_of_the_command_loses_nothing(clean, tmp_path, run_cli):
    pictures, wanted = clean
    results = tmp_path / "out"
    workers: list[int] = []

    def kill(process) -> None:
        workers.extend(children(process.pid))
        process.send_signal(signal.SIGKILL)

    code, _, _ = interrupted_run(pictures, results, kill)
    assert code == -signal.SIGKILL
    assert workers
    wait_until(lambda: all(gone(worker) for worker in workers), 60)
    # The kill may have come in the middle of writing a file, whose own place is not touched by then.
    left = {name: data for name, data in contents(results).items() if not name.endswith(".tmp")}
    assert set(left) < set(wanted), "some work must be left for this test to mean anything"
    for name, data in left.items():
        assert data == wanted[name], f"{name} is half-written"
    # What a process killed in the middle of writing would leave.
    (results / ".d.svg.0123456789ab.tmp").write_text("<svg half")
    done = run_cli("vectorize", pictures, "-o", results, *OPTIONS)
    assert contents(results) == wanted
    status = {name: value["status"] for name, value in json_lines(done.stdout).items()}
    complete = {f"{name[:-5]}.png" for name in left if name.endswith(".json")}
    assert status == {name: "unchanged" if name in complete else "done" for name in NAMES}


@pytest.mark.slow  # test_jobs_pool.py has workers that die in a pool of its own
def test_a_killed_worker_takes_down_no_more_than_a_moment(clean, tmp_path):
    pictures, wanted = clean

    def kill(process) -> None:
        os.kill(children(process.pid)[0], signal.SIGKILL)

    code, errors, _ = interrupted_run(pictures, tmp_path / "out", kill)
    assert code == 0, errors
    assert errors.count("its worker process died (SIGKILL, perhaps for lack of memory); it is tried again") == 1
    assert contents(tmp_path / "out") == wanted


def test_ctrl_c_ends_the_fits_under_way_and_keeps_what_they_have(clean, tmp_path):
    pictures, _ = clean
    results = tmp_path / "out"
    arguments = ["vectorize", pictures, "-o", results, *OPTIONS]
    arguments[arguments.index(900)] = 2_000_000
    output, errors = tmp_path / "stdout", tmp_path / "stderr"
    with output.open("wb") as stdout, errors.open("wb") as stderr:
        process = start(*arguments, "-v", stdout=stdout, stderr=stderr)
        try:
            wait_until(lambda: len(set(re.findall(r"(\w)\.png: .*, step \d", errors.read_text()))) == 2)
            process.send_signal(signal.SIGINT)
            process.wait(timeout=150)
        finally:
            process.kill()
    text = errors.read_text()
    assert process.returncode == 130, text
    assert "Traceback" not in text
    found = json_lines(output.read_bytes())
    assert {value["status"] for value in found.values()} == {"interrupted"}
    assert len(found) == 2
    table = [line.split() for line in text.splitlines() if line.startswith(("interrupted  ", "not begun"))]
    assert [(row[0], row[-1] if row[0] == "not" else row[1]) for row in table] == [("interrupted", "2"), ("not", "2")]
    assert len([line for line in text.splitlines() if line.endswith("  interrupted")]) == 2, text
    for value in found.values():
        assert read_svg(Path(value["output"]["svg"]).read_bytes()).curves > 0
        assert value["interrupted"] is True
    assert not list(results.glob(".*"))
