"""`benchmarks.folder`: figures of real processes, limits, failures, and two versions that take turns."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
import pytest
from cli_runs import save_pictures
from PIL import Image

if sys.platform == "win32":
    pytest.skip("needs POSIX", allow_module_level=True)

import resource

from benchmarks import folder as benchmark

FLAT = '<svg xmlns="http://www.w3.org/2000/svg" width="40" height="28"><rect width="40" height="28" fill="{}"/></svg>'
# Options of the quickest fit.
QUICK = ("--", "--style", "photo", "--curves", 3, "--steps", 4, "--threads", 1)


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    (tmp_path / "in").mkdir()
    for name in ("a", "b"):
        Image.fromarray(np.full((28, 40, 3), 128, np.uint8)).save(tmp_path / "in" / f"{name}.png")
    return tmp_path / "in"


def rows_of(out: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((out / "table.tsv").open(), delimiter="\t"))


def python(text: str, seconds: float = 60.0, gigabytes: float = 8.0):
    return benchmark.run_process([sys.executable, "-c", text], None, seconds, gigabytes)


def test_a_process_is_measured():
    # More than this process itself has: a child begins with its parent's peak.
    unit = 1 if sys.platform == "darwin" else 1024  # bytes
    size = unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss + 300_000_000
    text = f"x = bytearray({size})\nwhile __import__('time').process_time() < 0.2: pass\nprint('hi')"
    output, found = python(text, gigabytes=1e-9 * size + 1.0)
    assert output == "hi\n"
    assert "error" not in found
    assert 0.15 <= found["cpu_seconds"] < 10 and found["cpu_seconds"] < found["seconds"] + 0.1
    assert size < 1e9 * found["peak_gb"] < size + 200_000_000


def test_a_process_that_fails_has_a_reason_and_limits_hold():
    assert python("raise SystemExit(3)")[1]["error"] == "ended with exit code 3"
    told = "import sys; sys.exit('cubicsplat: error: no\\ncubicsplat: note: later')"
    assert python(told)[1]["error"] == "no"
    assert "MemoryError" in python("bytearray(900_000_000)", gigabytes=0.8)[1]["error"]
    _, late = python("import subprocess; subprocess.run(['sleep', '60'])", seconds=0.3)
    assert late["error"] == "took over 0.3 s"
    assert late["seconds"] < 50


def test_a_real_run_has_all_figures(run_benchmark, tmp_path):
    save_pictures(tmp_path / "in", ["a.png"])
    run_benchmark("folder", tmp_path / "in", "-o", tmp_path / "out", *QUICK)
    (row,) = rows_of(tmp_path / "out")
    assert (row["picture"], row["version"], row["style"], row["shapes"], row["error"]) == (
        "in/a.png", "new", "photo", "4", "",
    )  # fmt: skip
    assert float(row["cpu_seconds"]) > 0.1 and float(row["peak_gb"]) > 0.02
    assert float(row["psnr_db"]) > 8 and float(row["delta_e"]) < 40
    assert int(row["bytes"]) == (tmp_path / "out" / "new" / "in-a.png.svg").stat().st_size
    assert int(row["coordinates"]) > 3 * 8


def test_two_versions_take_turns_and_are_compared(run_benchmark, pictures, tmp_path, monkeypatch):
    asked = []

    def stand_in(command, pythonpath, seconds, gigabytes):
        asked.append((Path(command[4]).name, pythonpath, command[-2:]))
        result = {"seconds": 2.0, "cpu_seconds": 1.0 if pythonpath else 0.5, "peak_gb": 0.1}
        if command[4].endswith("b.png") and pythonpath:
            return "", result | {"error": "broke"}
        Path(command[6]).write_text(FLAT.format("#818181" if pythonpath else "#808080"))
        return '{"style": "artwork"}\n', result

    monkeypatch.setattr(benchmark, "run_process", stand_in)
    out = tmp_path / "out"
    done = run_benchmark("folder", pictures, "--compare", "/old/src", "-o", out, "--", "--detail", "low", code=1)
    assert [(name, path) for name, path, _ in asked] == [
        ("a.png", None), ("a.png", "/old/src"), ("b.png", "/old/src"), ("b.png", None),
    ]  # fmt: skip
    assert all(options == ["--detail", "low"] for *_, options in asked)
    rows = {(row["picture"], row["version"]): row for row in rows_of(out)}
    assert float(rows["in/a.png", "new"]["delta_e"]) == 0.0
    assert 0.2 < float(rows["in/a.png", "old"]["delta_e"]) < 0.6
    assert rows["in/b.png", "old"]["error"] == "broke"
    last = done.stdout.decode().splitlines()[-1]
    assert last.startswith("new / old of 1 pictures: seconds 1.000  cpu_seconds 0.500 ")
    assert b"cubicsplat: failed: in/b.png, old: broke" in done.stderr
    with Image.open(out / "sheet-01.png") as sheet:
        assert sheet.width > 3 * benchmark.CELL


def test_a_bug_that_the_other_style_hides_is_a_failure(tmp_path, monkeypatch):
    report = '{"style": "photo", "notes": ["made as photo, since artwork failed; this is a bug, please report it"]}'
    monkeypatch.setattr(benchmark, "run_process", lambda *_: (report, {"seconds": 1.0}))
    svg = tmp_path / "a.svg"
    svg.write_text(FLAT.format("#808080"))
    result, drawn = benchmark.measure(tmp_path / "a.png", svg, None, [], 1.0, 1.0)
    assert result["error"].startswith("made as photo, since artwork failed") and drawn is None


def test_wrong_usage_is_said(run_benchmark, pictures, tmp_path):
    run_benchmark("folder", pictures, "--time-limit", 0, code=2, error="must be above 0")
    run_benchmark("folder", tmp_path / "none", code=1, error="cannot be read")
