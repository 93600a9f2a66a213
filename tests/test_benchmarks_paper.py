"""`benchmarks.paper`: the tables beside the published figures, exponents, resuming, and what is asked of whom."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from conftest import smooth_pixels
from PIL import Image

from benchmarks import paper, step_times
from cubicsplat_cli.settings import FitSettings

SHORT = ("--threads", 1, "--steps", 4)


@pytest.fixture
def quick(monkeypatch):
    """Everything small enough for a test; the protocol is the same."""
    monkeypatch.setattr(step_times, "WARMUP", 2)
    monkeypatch.setattr(step_times, "REPEATS", 3)
    monkeypatch.setattr(step_times, "GROWING_CURVES", (4, 8, 16, 32, 64))
    monkeypatch.setattr(step_times, "GROWING_SIZES", ((16, 16), (32, 16), (32, 32), (64, 32), (64, 64)))
    monkeypatch.setattr(step_times, "USUAL_CURVES", 8)
    monkeypatch.setattr(step_times, "USUAL_SIZE", (32, 24))
    monkeypatch.setattr(paper, "COUNTS", (4, 6))
    monkeypatch.setattr(paper, "SIZE", (48, 32))
    monkeypatch.setattr(paper, "CURVES", 16)
    monkeypatch.setattr(paper, "MANY_CURVES", 12)
    levels = {(mode, count): (0.5, 20.0, 1.0) for mode in paper.MODES for count in (4, 6)}
    monkeypatch.setattr(paper, "QUALITY", levels)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("a", "b"):
        Image.fromarray(smooth_pixels(40, 28)).save(tmp_path / f"{name}.png")
    return tmp_path


def test_an_exponent_is_that_of_the_power():
    values = [1, 2, 4, 8, 16]
    assert step_times.exponent(values, [3.0 * v**0.7 for v in values]) == pytest.approx(0.7)


def test_a_step_takes_longer_than_its_parts_and_more_curves_longer_than_few(quick):
    few, many = (step_times.step_times((96, 64), FitSettings(curves=count, threads=1)) for count in (8, 2000))
    assert 0 < few.forward_ms < few.step_ms
    assert many.forward_ms + many.backward_ms < 2 * many.step_ms
    assert many.step_ms > 2 * few.step_ms


def test_without_a_folder_speed_and_growth_are_measured(run_benchmark, quick):
    done = run_benchmark("paper", *SHORT, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert set(found["steps"]) == {"open", "closed"}
    assert [(row["what"], row["mode"]) for row in found["growth"]] == [
        (what, mode) for mode in ("open", "closed") for what in ("curves", "pixels", "S")
    ]
    assert all(len(row["values"]) == len(row["step_ms"]) == 5 for row in found["growth"])
    assert set(found["notes"]) == {"steps", "growth"}
    assert "quality" not in found


def test_a_folder_gives_the_other_tables_and_goes_on_where_it_stopped(run_benchmark, quick, folder):
    arguments = ("paper", folder, *SHORT, "--tables", "quality,magnify,large", "--cache", folder / "cache")
    done = run_benchmark(*arguments, "--markdown")
    assert done.returncode == 0, done.stderr
    text = done.stdout.decode()
    assert [line[4:] for line in text.splitlines() if line.startswith("### ")] == ["quality", "magnify", "large"]
    (row,) = [line for line in text.splitlines() if line.startswith("| open 6 ")]
    assert [cell.strip() for cell in row.split("|")[2:3] + row.split("|")[-4:-1]] == ["2", "0.500", "20.00", "60"]
    assert re.search(r"\| a.png, open +\| +480 \|", text)  # 40 px, 12 times
    assert "38.09" in text
    assert all(note in text for name, note in paper.NOTES.items() if name in ("quality", "magnify", "large"))
    again = json.loads(run_benchmark(*arguments, "--json").stdout)
    assert all(run["cached"] for name in ("quality", "large") for run in again[name])
    assert len(again["quality"]) == 8


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(("--tables", "steps,figure"), b"must be of steps, growth"), (("--tables", "large"), b"needs a folder")],
)
def test_what_cannot_be_measured_is_said(run_benchmark, arguments, words):
    done = run_benchmark("paper", *arguments)
    assert (done.returncode, words in done.stderr) == (2, True)
