"""The pool of worker processes, with made-up workers: what dies, what is tried again, what is not begun."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest
from PIL import Image

from cubicsplat_cli.files.names import Outputs
from cubicsplat_cli.jobs.plan import Job
from cubicsplat_cli.jobs.pool import run_in_workers, share_threads
from cubicsplat_cli.jobs.run import DONE, FAILED, Outcome
from cubicsplat_cli.progress import Observer
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings, cpu_count

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")


def job(name: str) -> Job:
    return Job(name, Path(name), Outputs(None, None, None))


def work_or_die(pipe, _request: Request, threads: int, _server: None) -> None:
    """Does every job in no time; dies of the jobs called so, of "once" at the first attempt only."""
    while (work := pipe.recv()) is not None:
        if work.name == "fatal":
            os.kill(os.getpid(), signal.SIGKILL)
        elif work.name.endswith("once") and not Path(work.name).exists():
            Path(work.name).touch()
            os._exit(3)
        pipe.send(("outcome", Outcome(work, DONE, {"threads": threads})))


def dead_on_arrival(_pipe, _request: Request, _threads: int, _server: None) -> None:
    os._exit(9)


def run(names: list[str], work=work_or_die, **options) -> tuple[list[Outcome], list[str]]:
    notes: list[str] = []
    known = {"workers": 2, "stopping": lambda: False, "work": work}

    class Notes(Observer):
        def note(self, text: str, job: str = "") -> None:
            notes.append(text)

    jobs = iter([job(name) for name in names])
    request = Request(FitSettings(threads=3))
    return list(run_in_workers(jobs, request, observer=Notes(), **{**known, **options})), notes


def test_every_job_is_done_once_and_threads_are_shared():
    outcomes, notes = run(["a", "b", "c", "d", "e"])
    assert sorted(outcome.job.name for outcome in outcomes) == ["a", "b", "c", "d", "e"]
    assert {outcome.report["threads"] for outcome in outcomes} <= {1, 2}
    assert notes == []


def test_a_job_that_kills_is_given_up_and_the_others_are_done(tmp_path):
    once = str(tmp_path / "once")
    outcomes, notes = run(["a", "fatal", "b", once, "c"])
    found = {Path(outcome.job.name).name: outcome for outcome in outcomes}
    assert {name: outcome.status for name, outcome in found.items()} == {
        "a": DONE, "b": DONE, "c": DONE, "once": DONE, "fatal": FAILED,
    }  # fmt: skip
    assert "died 2 times (SIGKILL, perhaps for lack of memory)" in found["fatal"].error
    assert sorted(Path(note.split(":")[0]).name for note in notes) == ["fatal", "once"]
    assert any("exit code 3" in note for note in notes)


def test_workers_that_never_start_end_with_an_error_each():
    outcomes, _ = run(["a", "b"], dead_on_arrival)
    assert [outcome.status for outcome in outcomes] == [FAILED, FAILED]
    assert all("exit code 9" in outcome.error for outcome in outcomes)


def test_once_stopped_nothing_is_begun():
    assert run(["a", "b"], stopping=lambda: True) == ([], [])


def test_no_more_pictures_at_once_than_cores_and_that_is_said(tmp_path, run_cli, monkeypatch):
    """More would wait for each other, and each would have to be started."""
    asked = []

    def note_workers(jobs, request, *, workers, **options):
        asked.append(workers)
        return iter(())

    monkeypatch.setattr("cubicsplat_cli.jobs.pool.run_in_workers", note_workers)
    monkeypatch.setattr("cubicsplat_cli.jobs.execute.cpu_count", lambda: 2)
    for name in "abc":
        Image.new("RGB", (4, 4)).save(tmp_path / f"{name}.png")
    assert b"note: --jobs 9: 2 cores, so 2 pictures at once" in run_cli("vectorize", tmp_path, "-j", 9).stderr
    assert b"--jobs" not in run_cli("vectorize", tmp_path, "-j", 2).stderr
    assert b"--jobs" not in run_cli("vectorize", tmp_path).stderr
    assert asked == [2, 2, 1]


@pytest.mark.parametrize(
    ("threads", "workers", "shares"), [(8, 3, [3, 3, 2]), (1, 3, [1, 1, 1]), (4, 1, [4]), (2, 2, [1, 1])]
)
def test_shares_of_threads(threads, workers, shares):
    assert share_threads(threads, workers) == shares
    assert sum(share_threads(None, 1)) == cpu_count()
