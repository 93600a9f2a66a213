"""What holds for all programs in `benchmarks/`: their help, their errors, and their documentation."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import command_of

from benchmarks import ablation, metamorphic
from benchmarks.artwork.degradations import CLEAN, DEGRADATIONS

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "benchmarks" / "README.md").read_text(encoding="utf-8")
NAMES = [
    "ablation", "artwork", "clips", "equal_bytes", "folder", "metamorphic", "paper", "peers", "shaded", "shapes",
    "spikes",
]  # fmt: skip


def test_every_program_is_in_the_table_and_nothing_else():
    listed = re.findall(r"^\| `python -m benchmarks\.(\w+)", README, re.MULTILINE)
    assert sorted(set(listed)) == NAMES
    programs = [
        path for path in (ROOT / "benchmarks").rglob("*.py") if "\n    main(" in path.read_text(encoding="utf-8")
    ]
    assert sorted(path.parent.name if path.stem == "__main__" else path.stem for path in programs) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_every_program_has_help(name, run_benchmark):
    done = run_benchmark(name, "--help")
    assert done.stderr == b""
    text = done.stdout.decode()
    assert text.startswith(f"Usage: python -m benchmarks.{name} [OPTIONS] ")
    assert command_of(name).__doc__.splitlines()[0] in text
    assert "-h, --help" in text


def test_a_program_runs_as_a_module_and_its_errors_are_one_line():
    command = [sys.executable, "-m", "benchmarks.spikes", "none.svg"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=200, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert re.fullmatch(r"cubicsplat: error: none\.svg: .*\n", done.stderr)


def test_wrong_options_are_refused(run_benchmark):
    run_benchmark("artwork", "--sizes", 3, code=2, error="--sizes")


def test_rows_inputs_and_limits_are_documented():
    for row in ablation.ABLATIONS:
        assert f"`{row.removeprefix('samples ')}`" in README or f"`{row}`" in README, row
    assert [kind for kind in DEGRADATIONS if f"`{kind}`" not in README and kind != CLEAN] == []
    assert f"{metamorphic.DELTA_E} (aliased and JPEG: {metamorphic.ROUGH_DELTA_E})" in README
    assert len(README.split()) <= 1300
