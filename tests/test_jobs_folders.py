"""Folders through the real command: mirrored trees, what a second run skips, and what a bad picture does not stop."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from cli_runs import SHORT, contents, json_lines, save_pictures

from cubicsplat_cli.jobs.plan import plan_jobs
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings
from cubicsplat_cli.svg.scene_reader import read_svg

NAMES = ("a.png", "b.png", "deep/c.jpg", "deep/er/d.png")


@pytest.fixture(scope="module")
def made(tmp_path_factory, run_cli) -> tuple[Path, Path, object]:
    """A folder of four pictures and one that is none, its results, and what the command said."""
    folder = tmp_path_factory.mktemp("folder")
    pictures, results = folder / "in", folder / "out"
    save_pictures(pictures, NAMES)
    (pictures / "bad.png").write_text("no picture")
    (pictures / "notes.txt").write_text("not looked at")
    (pictures / ".hidden.png").write_text("not looked at")
    done = run_cli("vectorize", pictures, "-r", "-o", results, "-j", 2, "--json", *SHORT, code=1)
    return pictures, results, done


@pytest.fixture
def copied(made, tmp_path) -> tuple[Path, Path]:
    """The same, to be changed."""
    for folder in made[:2]:
        shutil.copytree(folder, tmp_path / folder.name)
    return tmp_path / "in", tmp_path / "out"


def test_the_tree_is_mirrored_and_a_bad_picture_stops_nothing(made):
    _, results, done = made
    stems = ("a", "b", "deep/c", "deep/er/d")
    assert set(contents(results)) == {f"{stem}.{kind}" for stem in stems for kind in ("svg", "png", "json")}
    for stem in stems:
        assert read_svg((results / f"{stem}.svg").read_bytes()).width >= 24
    lines = done.stderr.decode().splitlines()
    assert sum(" curves  " in line and " dB  SSIM " in line for line in lines) == 4
    table = next(index for index, line in enumerate(lines) if line.split()[:2] == ["pictures", "curves"])
    assert lines[table + 1].split()[:2] == ["done", "4"]
    assert lines[table + 2].split() == ["failed", "1"]
    assert lines[table + 3].startswith("5 pictures in ")
    assert lines[table + 4].startswith("cubicsplat: error: ")
    assert "bad.png: is not a picture" in lines[-1]
    assert len(lines) == table + 5, "the failures come last"


def test_json_is_one_object_a_picture_and_nothing_else(made):
    found = json_lines(made[2].stdout)
    assert set(found) == {"a.png", "b.png", "c.jpg", "d.png", "bad.png"}
    assert {value["status"] for value in found.values()} == {"done", "failed"}
    assert "is not a picture" in found["bad.png"]["error"]
    assert found["a.png"]["quality"]["svg"]["psnr_db"] > 8


def test_a_second_run_redoes_exactly_what_is_missing_or_changed(copied, run_cli):
    pictures, results = copied
    (pictures / "bad.png").unlink()
    before = {path: path.stat().st_mtime_ns for path in results.rglob("*.svg")}
    first = contents(results)
    (results / "a.svg").write_bytes((results / "a.svg").read_bytes()[:500])  # cut short
    (results / "deep" / "c.png").unlink()
    shutil.copy(pictures / "a.png", pictures / "b.png")  # another input
    done = run_cli("vectorize", pictures, "-r", "-o", results, "--json", *SHORT)
    status = {name: value["status"] for name, value in json_lines(done.stdout).items()}
    assert status == {"a.png": "done", "b.png": "done", "c.jpg": "done", "d.png": "unchanged"}
    unchanged = results / "deep" / "er" / "d.svg"
    assert unchanged.stat().st_mtime_ns == before[unchanged]
    second = contents(results)
    assert {name for name in second if second[name] != first[name]} == {"b.svg", "b.png", "b.json"}


def test_settings_decide_what_is_redone_threads_and_jobs_do_not(copied, run_cli):
    pictures, results = copied
    (pictures / "bad.png").unlink()
    (results / "b.json").write_text(json.dumps({"program": "cubicsplat", "half": "a report"}))
    report = json.loads((results / "deep" / "c.json").read_text())
    (results / "deep" / "c.json").write_text(json.dumps({**report, "interrupted": True}))
    other_threads = ("--style", "photo", "--curves", 12, "--steps", 30, "--threads", 2, "--device", "cpu")
    done = run_cli("vectorize", pictures, "-r", "-o", results, "--dry-run", *other_threads)
    states = {line.split("  ")[1].split(" -> ")[0]: line.split("  ")[0] for line in done.stdout.decode().splitlines()}
    assert {Path(name).name: state for name, state in states.items()} == {
        "a.png": "unchanged", "b.png": "to do", "c.jpg": "to do", "d.png": "unchanged",
    }  # fmt: skip
    done = run_cli("vectorize", pictures / "a.png", "-o", results, "--dry-run", *SHORT, "--force")
    assert done.stdout.startswith(b"to do")


def test_the_hash_covers_what_decides_the_file():
    given = {"preset": "draft", "curves": 12, "threads": 1, "device": "auto"}
    request = Request(FitSettings(**given))
    digest = request.digest()

    def digest_with(**changes: object) -> str:
        return replace(request, settings=FitSettings.from_preset(**given | changes)).digest()

    for same in ({"threads": 2}, {"device": "cpu"}, {"samples": 12}):
        assert digest_with(**same) == digest
    assert replace(request, force=True, png=False, compress=True, max_pixels=9).digest() == digest
    for other in (
        {"curves": 13}, {"seed": 1}, {"prune": False}, {"time_limit": 9.0}, {"background": "none"}, {"preset": "high"},
    ):  # fmt: skip
        assert digest_with(**other) != digest, other
    for other in ({"precision": 1}, {"max_size": 100}):
        assert replace(request, **other).digest() != digest, other


def test_beside_the_inputs_own_drawings_are_left_out_and_endings_kept_apart(tmp_path, run_cli):
    save_pictures(tmp_path, ("a.png", "a.jpg", "b.jpg"))
    arguments = ("vectorize", tmp_path, *SHORT)
    run_cli(*arguments)
    stems = ("a.png", "a.jpg", "b")
    wanted = {f"{stem}.{kind}" for stem in stems for kind in ("svg", "png", "json")} | {"a.png", "a.jpg", "b.jpg"}
    assert set(contents(tmp_path)) == wanted
    again = run_cli(*arguments, "-v")
    assert set(contents(tmp_path)) == wanted, "what was drawn is no input"
    assert again.stderr.count(b"  unchanged\n") == 3
    assert b"left out, drawn by cubicsplat itself: 3 (" in again.stderr
    pattern = run_cli("vectorize", tmp_path / "*.jpg", "--dry-run", *SHORT)
    planned = sorted(Path(line.split(" -> ")[1]).name for line in pattern.stdout.decode().splitlines())
    assert planned == ["a.svg", "b.svg"], "without a.png among the inputs, a.jpg needs no longer name"
    job = plan_jobs([(tmp_path / "a.jpg", Path())], None, Request())[0]
    assert job.outputs.png.name == "a.rendered.png", "a by-product never replaces somebody's picture"


def test_several_files_and_a_missing_one(tmp_path, photo, logo, run_cli):
    done = run_cli(
        "vectorize", photo, logo, tmp_path / "none.png", "-o", tmp_path / "new" / "out", *SHORT, "-q", code=1
    )
    assert done.stderr.decode().count("\n") == 1, "-q: only what failed"
    assert b"none.png: no such file" in done.stderr
    assert {path.name for path in (tmp_path / "new" / "out").glob("*.svg")} == {"photo.svg", "logo.svg"}


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["in", "-o", "-"], 2, "-o -"),
        (["in", "-", "-o", "out"], 2, "standard input"),
        (["in", "-o", "file"], 2, "file"),
        (["in", "in2", "-o", "out"], 2, "both"),
        (["empty"], 1, "without pictures"),
        (["in/deep"], 1, "-r"),
        (["in/*.webp"], 1, "no file matches"),
        (["in", "--jobs", 0], 2, "--jobs"),
        (["in", "--cluster", "127.0.0.1:1"], 1, "no Ray cluster"),
    ],
)
def test_what_cannot_be_done_is_said_before_any_work(arguments, code, said, tmp_path, run_cli, monkeypatch):
    if "--cluster" in arguments:
        pytest.importorskip("ray", reason="Ray is not installed")
    monkeypatch.chdir(tmp_path)
    save_pictures(tmp_path, ("in/x.png", "in/deep/er/y.png", "in2/x.png"))
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("x")
    before = set(contents(tmp_path))
    done = run_cli("vectorize", *arguments, *SHORT, code=code, error=said)
    assert b"Traceback" not in done.stderr
    assert set(contents(tmp_path)) == before
