"""Helpers of the tests that start the real command: in the background, and with what its files are made of."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import IO

import pytest
from command import cli_command, run_here
from conftest import smooth_pixels
from PIL import Image
from workers import start_what_outlives_a_pool

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.request import Request

SHORT = ("--style", "photo", "--curves", 12, "--steps", 30, "--threads", 1)


def strict_json(data: bytes | str) -> dict:
    """JSON without NaN and Infinity."""
    return json.loads(data, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


def json_lines(data: bytes) -> dict[str, dict]:
    """What `--json` printed: name of the file -> object, one line each."""
    values = [strict_json(line) for line in data.splitlines()]
    return {Path(value["input"]["path"]).name: value for value in values}


def asked_by(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> Request:
    """The request that a command line makes."""
    asked: list[Request] = []

    def planned(inputs: object, output: object, request: Request, **_: object) -> None:
        asked.append(request)
        raise UsageError("enough")

    monkeypatch.setattr("cubicsplat_cli.cli.vectorize.plan", planned)
    run_here(*arguments, code=2, error="enough")
    return asked[0]


def start(*arguments: object, stderr: int | IO[bytes] = subprocess.PIPE, **keywords) -> subprocess.Popen:
    """The command in the background, with Ctrl-C as a terminal has it (a test run may have it switched off)."""
    return subprocess.Popen(
        [*cli_command(), *map(str, arguments)],
        stderr=stderr,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        **keywords,
    )


def on_terminal(arguments: list[object], monkeypatch: pytest.MonkeyPatch, **environment: str) -> tuple[int, str]:
    """Exit code and stderr of the command, in this process, when stderr is a terminal."""
    import pty

    for name in [name for name in os.environ if name.endswith("_COLOR")]:
        monkeypatch.delenv(name)
    for name, value in {"TERM": "xterm-256color", "COLUMNS": "120", **environment}.items():
        monkeypatch.setenv(name, value)
    # What outlives the command must not keep the terminal open.
    start_what_outlives_a_pool()
    shown: list[bytes] = []
    parent, child = pty.openpty()
    # A terminal that nobody reads would soon hold up whoever writes to it.
    reader = threading.Thread(target=_read_all, args=(parent, shown), daemon=True)
    reader.start()
    try:
        with os.fdopen(child, "wb", buffering=0) as terminal:
            done = run_here(*arguments, stderr=terminal, code=None)
    finally:
        reader.join(timeout=30)
        os.close(parent)
    return done.returncode, b"".join(shown).decode(errors="replace")


def _read_all(terminal: int, chunks: list[bytes]) -> None:
    # Linux answers with an error when the other end is closed.
    with suppress(OSError):
        while chunk := os.read(terminal, 65536):
            chunks.append(chunk)


def wait_until(true: Callable[[], object], seconds: float = 150.0) -> None:
    """Wait for a condition; fail the test when it does not come about."""
    until = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < until, "it did not come about in time"
        time.sleep(0.02)


def save_pictures(folder: Path, names: Iterable[str]) -> None:
    """Small pictures, each another one."""
    for index, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(smooth_pixels(24 + 3 * index, 20 + 2 * index)).save(path)


def contents(folder: Path) -> dict[str, bytes]:
    """Relative name -> bytes of every file below a folder, hidden ones included; JSON without its times and paths."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            data = path.read_bytes()
            found[str(path.relative_to(folder))] = _lasting(data) if path.suffix == ".json" else data
    return found


def _lasting(data: bytes) -> bytes:
    report = strict_json(data)
    for name in ("timing", "history", "output", "input", "device"):
        report.pop(name)
    report["settings"].pop("threads")
    return json.dumps(report, sort_keys=True).encode()
