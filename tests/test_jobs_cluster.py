"""`--cluster`: the same jobs on a real Ray runtime that the test starts on this machine."""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from cli_runs import SHORT, contents, json_lines, save_pictures, start, wait_until

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.jobs.cluster import divide
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings

NAMES = ("a.png", "deep/b.png", "deep/c.png")

# Holds a Ray runtime of two cores, says where it is, and ends it when its standard input is closed.
RUNTIME = """
import ray, sys
ray.init(num_cpus=2, include_dashboard=False, logging_level="ERROR", log_to_driver=False)
print(ray.get_runtime_context().gcs_address, flush=True)
sys.stdin.read()
ray.shutdown()
"""


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Of a local Ray runtime, which nobody else can use."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        # Before the import, which is when Ray reads it.
        patch.setenv("RAY_AUTH_MODE", "token")
        patch.setenv("RAY_AUTH_TOKEN", secrets.token_hex(32))
        pytest.importorskip("ray", reason="Ray is not installed (pip install 'cubicsplat[ray]')")
        process = subprocess.Popen([sys.executable, "-c", RUNTIME], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        try:
            yield process.stdout.readline().decode().strip()
        finally:
            process.stdin.close()
            process.wait(timeout=150)
            process.stdout.close()


def tasks() -> list[int]:
    """Process ids of Ray's workers that are at work on one of our jobs."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            named = (place / "cmdline").read_bytes().startswith(b"ray::work")
            ours = f"RAY_AUTH_TOKEN={os.environ['RAY_AUTH_TOKEN']}".encode() in (place / "environ").read_bytes()
        except OSError:  # it has ended meanwhile, or is somebody else's
            continue
        if named and ours:
            found.append(int(place.name))
    return found


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks into /proc")
def test_a_cluster_makes_the_same_files_and_survives_a_dead_worker(address, tmp_path, run_cli):
    save_pictures(tmp_path / "in", NAMES)
    (tmp_path / "in" / "bad.png").write_text("no picture")
    arguments = ["vectorize", tmp_path / "in", "-r", "--json", "--curves", 24, "--steps", 3000]
    output = tmp_path / "stdout"
    with output.open("wb") as stdout:
        process = start(*arguments, "-o", tmp_path / "far", "--cluster", address, stdout=stdout)
        try:
            wait_until(lambda: tasks() or process.poll() is not None)
            os.kill(next(iter(tasks())), signal.SIGKILL)
            _, errors = process.communicate(timeout=150)
        finally:
            process.kill()
    assert process.returncode == 1, errors
    assert b"bad.png: is not a picture" in errors
    status = {name: value["status"] for name, value in json_lines(output.read_bytes()).items()}
    assert status == {"a.png": "done", "b.png": "done", "c.png": "done", "bad.png": "failed"}, errors
    again = run_cli(*arguments, "-o", tmp_path / "far", code=1)
    assert [value["status"] for value in json_lines(again.stdout).values()].count("unchanged") == 3
    (tmp_path / "in" / "bad.png").unlink()
    run_cli(*arguments, "-o", tmp_path / "near", "-j", 2)
    assert contents(tmp_path / "near") == contents(tmp_path / "far")


@pytest.mark.slow
def test_one_picture_on_a_cluster(address, photo, run_cli):
    done = run_cli("vectorize", photo, "-o", photo.parent / "x.svgz", "--cluster", address, *SHORT)
    assert (photo.parent / "x.svgz").read_bytes().startswith(b"\x1f\x8b")
    assert done.stderr.decode().count("\n") == 1


def share(resources: dict[str, float], asked: dict[str, Any], **limits: int | None) -> tuple[int, int, int]:
    found = divide(resources, Request(FitSettings(**asked)), **{"count": 10, "limit": None, **limits})
    return found.cpus, found.gpus, found.at_once


def test_one_gpu_or_some_cores_a_task():
    assert share({"CPU": 64.0}, {}) == (6, 0, 20)
    assert share({"CPU": 64.0}, {"threads": 16}) == (16, 0, 8)
    assert share({"CPU": 4.0}, {"threads": 16}, count=1000) == (4, 0, 2)
    assert share({"CPU": 4.0}, {}, count=1000) == (1, 0, 8)
    assert share({"CPU": 64.0, "GPU": 4.0}, {"device": "auto"}) == (1, 1, 8)
    assert share({"CPU": 64.0, "GPU": 4.0}, {"device": "cpu"}, limit=3) == (6, 0, 3)
    with pytest.raises(EngineError, match="no GPU"):
        share({"CPU": 64.0}, {"device": "cuda"})


def test_without_ray_the_command_says_how_to_get_it(photo, run_cli, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    done = run_cli("vectorize", photo, "--cluster", "127.0.0.1:1", *SHORT, code=1)
    assert b"pip install 'cubicsplat[ray]'" in done.stderr
