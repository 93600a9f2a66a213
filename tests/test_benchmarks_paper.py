"""`benchmarks.paper`: the tables beside the published figures, exponents, resuming, and what is asked of whom."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from conftest import smooth_pixels
from PIL import Image

from benchmarks import paper, step_times
from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.settings import FitSettings

# Everything small enough for a test; the protocol is the same.
TIMES = step_times.Protocol(
    2, 5, (4, 8, 16, 32, 64), ((16, 16), (32, 16), (32, 32), (64, 32), (64, 64)), usual_curves=8, usual_size=(32, 24)
)
QUALITY = {(mode, count): (0.5, 20.0, 1.0) for mode in paper.MODES for count in (4, 6)}
SIZES = paper.Sizes((48, 32), 16, QUALITY, 12, TIMES)


def session(*pictures: Path, cache: Path | None = None) -> paper.Session:
    fit = {"preset": "standard", "steps": 4, "seed": 0, "device": "cpu", "threads": 1}
    return paper.Session(list(pictures), fit, cache, Reporter(quiet=True), SIZES)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("a", "b"):
        Image.fromarray(smooth_pixels(40, 28)).save(tmp_path / f"{name}.png")
    return tmp_path


def test_an_exponent_is_that_of_the_power():
    values = [1, 2, 4, 8, 16]
    assert step_times.exponent(values, [3.0 * v**0.7 for v in values]) == pytest.approx(0.7)


def test_a_step_takes_longer_than_its_parts_and_more_curves_longer_than_few():
    few, many = (step_times.step_times((96, 64), FitSettings(curves=count, threads=1), TIMES) for count in (8, 2000))
    assert few["forward_ms"] > 0
    assert many["forward_ms"] < many["step_ms"]  # of few curves both are tenths of a millisecond, and any pause shows
    assert many["forward_ms"] + many["backward_ms"] < 2 * many["step_ms"]
    assert many["step_ms"] > 2 * few["step_ms"]


def test_without_a_folder_speed_and_growth_are_measured(capsys):
    names = paper.chosen_tables(None, None)
    paper.measure(names, session(), json=True)
    found = json.loads(capsys.readouterr().out)
    assert set(found["steps"]) == {"open", "closed"}
    assert [(row["what"], row["mode"]) for row in found["growth"]] == [
        (what, mode) for mode in ("open", "closed") for what in ("curves", "pixels", "S")
    ]
    assert all(len(row["values"]) == len(row["step_ms"]) == 5 for row in found["growth"])
    assert set(found["notes"]) == {"steps", "growth"}
    assert "quality" not in found


def test_a_folder_gives_the_other_tables_and_goes_on_where_it_stopped(folder, capsys):
    names = paper.chosen_tables("quality,magnify,large", folder)
    given = session(*sorted(folder.iterdir()), cache=folder / "cache")
    paper.measure(names, given, markdown=True)
    text = capsys.readouterr().out
    assert [line[4:] for line in text.splitlines() if line.startswith("### ")] == ["quality", "magnify", "large"]
    (row,) = [line for line in text.splitlines() if line.startswith("| open 6 ")]
    assert [cell.strip() for cell in row.split("|")[2:3] + row.split("|")[-4:-1]] == ["2", "0.500", "20.00", "60"]
    assert re.search(r"\| a.png, open +\| +480 \|", text)  # 40 px, 12 times
    assert "38.09" in text
    assert all(note in text for name, note in paper.NOTES.items() if name in ("quality", "magnify", "large"))
    paper.measure(names, given, json=True)
    again = json.loads(capsys.readouterr().out)
    assert all(run["cached"] for name in ("quality", "large") for run in again[name])
    assert len(again["quality"]) == 8


@pytest.mark.slow  # 1,024 curves
def test_the_command_measures_the_pictures_of_its_folder(run_benchmark, folder):
    done = run_benchmark("paper", folder, "--tables", "magnify", "--threads", 1, "--steps", 1, "--json")
    assert {row["picture"] for row in json.loads(done.stdout)["magnify"]} == {"a.png"}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(("--tables", "steps,figure"), "must be of steps, growth"), (("--tables", "large"), "needs a folder")],
)
def test_what_cannot_be_measured_is_said(run_benchmark, arguments, words):
    run_benchmark("paper", *arguments, code=2, error=words)
