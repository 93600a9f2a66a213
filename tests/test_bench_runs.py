"""`bench quality` and `bench ablation`: figures, cache, failures, sheet, tables and documentation."""

from __future__ import annotations

import csv
import io
import json
import re
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import typer
from conftest import smooth_pixels
from PIL import Image
from typer.testing import CliRunner

from cubicsplat_cli.bench import ablation, runs
from cubicsplat_cli.bench.quality import means, quality_jobs
from cubicsplat_cli.bench.runs import CacheEntry, run_all
from cubicsplat_cli.cli.bench import bench
from cubicsplat_cli.errors import EngineError, InputError, UsageError
from cubicsplat_cli.evaluate import compare, rerender
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.settings import FitSettings

DOCS = Path(__file__).resolve().parents[1] / "docs" / "bench.md"
SHORT = ("--steps", 12, "--threads", 1)


def run(command: str, *arguments: object):
    return CliRunner().invoke(bench, [command, *(str(argument) for argument in arguments)])


def strict(text: str) -> dict:
    return json.loads(text, parse_constant=pytest.fail)


def quiet(_name: str):
    return nullcontext(None)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two pictures, the second with transparency."""
    path = tmp_path / "pictures"
    path.mkdir()
    Image.fromarray(smooth_pixels(32, 20)).save(path / "a.png")
    Image.fromarray(smooth_pixels(24, 24, alpha=True)).save(path / "b.png")
    return path


def jobs_of(folder: Path, **overrides):
    settings = {"steps": 12, "threads": 1} | overrides
    return quality_jobs(sorted(folder.iterdir()), ["closed"], [5], {"preset": "draft", **settings})


# --- quality -----------------------------------------------------------------------------------------------


def test_quality_reports_what_the_files_are_worth(folder, tmp_path):
    cache = tmp_path / "cache"
    done = run("quality", folder, "--curves", "5,8", "--mode", "closed,open", *SHORT, "--cache", cache, "--json")
    assert done.exit_code == 0, done.exception
    found = strict(done.stdout)
    assert list(found["means"]) == ["closed 5", "closed 8", "open 5", "open 8"]
    assert len(found["runs"]) == 8
    kept = {path.name.rsplit("-", 1)[0]: path for path in cache.glob("*.svg")}
    for figures in found["runs"]:
        svg = kept[f"{Path(figures['picture']).stem}-{figures['mode']}-{figures['curves']}"].read_bytes()
        picture = load_picture(folder / figures["picture"])
        quality = compare(picture, rerender(svg, picture.width, picture.height).pixels)
        assert figures["psnr_db"] == pytest.approx(quality.psnr_db, abs=1e-3)
        assert figures["bytes"] == len(svg)
        assert figures["paths"] == svg.count(b"<path")
        assert figures["gap_db"] == pytest.approx(figures["own_psnr_db"] - figures["psnr_db"], abs=1e-3)
        assert figures["agreement_db"] > 30
        assert figures["seconds"] >= figures["fit_seconds"] > 0
        assert figures["steps"] == 12
    mean = found["means"]["open 8"]
    values = [run["psnr_db"] for run in found["runs"] if run["configuration"] == "open 8"]
    assert mean["psnr_db"] == pytest.approx(np.mean(values), abs=1e-4)
    assert (mean["pictures"], found["failed"]) == (2, [])


def test_tables_have_a_mean_row_per_configuration_and_a_table_of_means(folder):
    done = run("quality", folder, "--curves", "4,6", *SHORT)
    assert done.exit_code == 0
    lines = done.stdout.splitlines()
    assert [line for line in lines if re.fullmatch(r"closed \d|means", line)] == ["closed 4", "closed 6", "means"]
    assert sum(line.startswith("mean of 2") for line in lines) == 2
    assert [line.split()[:2] for line in lines[-2:]] == [["closed", "4"], ["closed", "6"]]
    assert [line.split(":")[0] for line in done.stderr.splitlines()][:2] == ["a.png, closed 4", "b.png, closed 4"]
    done = run("quality", folder, "--curves", 4, "--limit", 1, "--markdown", "-q", *SHORT)
    assert done.stderr == ""
    assert done.stdout.startswith("### closed 4\n\n| picture ")
    assert "| a.png " in done.stdout
    assert "b.png" not in done.stdout


def test_csv_has_a_row_per_fit(folder, tmp_path):
    table = tmp_path / "table.csv"
    assert run("quality", folder, "--curves", "4", *SHORT, "--csv", table).exit_code == 0
    rows = list(csv.DictReader(table.open()))
    assert [row["picture"] for row in rows] == ["a.png", "b.png"]
    assert float(rows[0]["psnr_db"]) > 5


def test_a_bad_picture_is_reported_once_and_the_others_go_on(folder):
    (folder / "aa.png").write_text("no picture")
    done = run("quality", folder, "--curves", "4,5", *SHORT, "--json")
    assert done.exit_code == 1
    found = strict(done.stdout)
    assert len(found["runs"]) == 4
    assert [failure["picture"] for failure in found["failed"]] == ["aa.png"]
    assert done.stderr.splitlines()[-1].startswith("cubicsplat: failed: aa.png: ")
    for path in folder.iterdir():
        path.write_text("no picture")
    assert isinstance(run("quality", folder, *SHORT).exception, InputError)


def test_a_fit_that_breaks_down_is_reported_with_its_configuration(folder, monkeypatch):
    original = runs.vectorize_picture

    def sometimes(picture, request, **options):
        if request.settings.curves == 5:
            raise EngineError("the fit broke\ndown")
        return original(picture, request, **options)

    monkeypatch.setattr(runs, "vectorize_picture", sometimes)
    done = run("quality", folder, "--curves", "4,5", *SHORT)
    assert done.exit_code == 1
    assert "cubicsplat: failed: a.png, closed 5: the fit broke down" in done.stderr
    assert "mean of 0" in done.stdout
    assert "mean of 2" in done.stdout


# --- the cache ---------------------------------------------------------------------------------------------


def test_a_second_run_takes_everything_from_the_cache(folder, tmp_path, monkeypatch):
    cache = tmp_path / "new" / "cache"
    first = run_all(jobs_of(folder), cache, quiet, lambda _: None)
    monkeypatch.setattr(runs, "vectorize_picture", lambda *_, **__: pytest.fail("fitted again"))
    said: list[str] = []
    second = run_all(jobs_of(folder), cache, quiet, said.append)
    assert [svg for _, svg in second.done] == [svg for _, svg in first.done]
    assert all(found.cached for found, _ in second.done)
    assert all("from the cache" in line for line in said)
    assert means(second.of("closed 5")) == means(first.of("closed 5"))


def entry(folder: Path, **overrides) -> str:
    (job, *_) = jobs_of(folder, **overrides)
    return CacheEntry(Path("x"), job, load_picture(job.path)).json.name


def test_a_cached_result_counts_only_for_the_same_fit(folder, monkeypatch):
    kept = entry(folder)
    assert kept == entry(folder)
    assert kept != entry(folder, steps=13)
    assert kept != entry(folder, seed=1)
    assert kept != entry(folder, rate_colours=0.01)
    monkeypatch.setattr(runs, "code_digest", lambda: "other code")
    assert kept != entry(folder)
    monkeypatch.undo()
    Image.fromarray(smooth_pixels(32, 20) // 2).save(folder / "a.png")
    assert kept != entry(folder), "another picture of the same name"


@pytest.mark.parametrize("damage", ["svg", "json", "member"])
def test_damaged_entries_are_made_anew(folder, tmp_path, damage):
    jobs = jobs_of(folder)[:1]
    first = run_all(jobs, tmp_path / "c", quiet, lambda _: None)
    (svg,), (report,) = (tmp_path / "c").glob("*.svg"), (tmp_path / "c").glob("*.json")
    if damage == "svg":
        svg.write_bytes(b"<svg/>")
    elif damage == "json":
        report.unlink()
    else:
        kept = json.loads(report.read_text())
        del kept["run"]["ssim"]
        report.write_text(json.dumps(kept))
    second = run_all(jobs, tmp_path / "c", quiet, lambda _: None)
    assert not second.done[0][0].cached
    assert second.done[0][1] == first.done[0][1]
    assert run_all(jobs, tmp_path / "c", quiet, lambda _: None).done[0][0].cached


def test_an_interrupted_fit_ends_the_run_and_is_not_kept(folder, tmp_path):
    def interrupt(_name: str):
        def callback(_progress):
            raise KeyboardInterrupt

        return nullcontext(callback)

    with pytest.raises(KeyboardInterrupt):
        run_all(jobs_of(folder), tmp_path / "c", interrupt, lambda _: None)
    assert not (tmp_path / "c").exists()


# --- the sheet ---------------------------------------------------------------------------------------------


def test_the_sheet_shows_original_svg_and_error(folder, tmp_path):
    sheet = tmp_path / "sheet.png"
    cache = tmp_path / "c"
    done = run("quality", folder, "--curves", "6", *SHORT, "--sheet", sheet, "--cache", cache)
    assert done.exit_code == 0, done.exception
    pixels = np.asarray(Image.open(sheet).convert("RGB")).astype(int)
    original = smooth_pixels(32, 20)
    column, top = 6 + 240 + 6, 18
    assert (pixels[top : top + 20, 6:38] == original).all()
    (svg,) = cache.glob("a-*.svg")
    drawn = rerender(svg.read_bytes(), 32, 20).pixels[..., :3].astype(int)
    assert np.abs(pixels[top : top + 20, column : column + 32] - drawn).max() <= 1
    error = np.clip(4 * np.abs(original - drawn), 0, 255)
    shown = pixels[top : top + 20, 2 * column - 6 : 2 * column + 26]
    assert np.abs(shown - error).max() <= 4
    assert error.max() > 20
    assert run("quality", folder, "--curves", "6", *SHORT, "--sheet", sheet, "--cache", cache).exit_code == 0


def test_only_the_first_four_pictures_are_shown_and_large_ones_are_made_smaller(folder, tmp_path):
    for name in "cdefg":
        Image.fromarray(smooth_pixels(8, 8)).save(folder / f"{name}.png")
    Image.fromarray(smooth_pixels(1000, 10)).save(folder / "a.png")
    sheet = tmp_path / "sheet.png"
    assert run("quality", folder, "--curves", "2", "--steps", 3, "--threads", 1, "--sheet", sheet).exit_code == 0
    with Image.open(sheet) as image:
        assert image.size == (3 * 768 + 4 * 6, 4 * (18 + 6) + 8 + 24 + 8 + 8)


def test_a_picture_of_the_users_is_never_replaced_by_a_sheet(folder):
    before = (folder / "a.png").read_bytes()
    assert isinstance(run("quality", folder, *SHORT, "--sheet", folder / "a.png").exception, UsageError)
    assert (folder / "a.png").read_bytes() == before


# --- ablation ----------------------------------------------------------------------------------------------


def test_ablation_rows_are_settings_that_exist_and_that_change_something():
    base = FitSettings.from_preset("standard", mode="closed")
    for row, changes in ablation.ABLATIONS.items():
        settings = FitSettings.from_preset("standard", mode="closed", **changes)
        assert (settings == base) == (row == ablation.BASE), row
        for name, value in changes.items():
            assert getattr(settings if hasattr(settings, name) else settings.recipe, name) == value
    text = DOCS.read_text(encoding="utf-8").rpartition("| Row |")[2]
    for row in ablation.ABLATIONS:
        last = row.split()[-1] if row.startswith("samples") else row
        assert f"`{last}`" in text or f"`{row}`" in text, f"{row} is not documented"


def test_ablation_table_and_json_agree(folder, tmp_path):
    options = ("--curves", "4,6", "--mode", "closed,open", "--rows", "opaque,no pruning", "--cache", tmp_path / "c")
    done = run("ablation", folder, *options, *SHORT, "--json")
    assert done.exit_code == 0, done.exception
    found = strict(done.stdout)
    rows = found["rows"]
    assert [row["row"] for row in rows[:3]] == ["base", "no pruning", "opaque"], "in the order of the table"
    assert len(rows) == 12
    levels = {(row["row"], row["mode"], row["curves"]): row["psnr_db"] for row in rows}
    for row in rows:
        change = row["psnr_db"] - levels["base", row["mode"], row["curves"]]
        assert row["change_db"] == pytest.approx(change, abs=1e-3)
        assert row["steps_per_minute"] > 100
    assert any(abs(row["change_db"]) > 0.01 for row in rows)
    table = run("ablation", folder, *options, *SHORT, "--markdown", "-q").stdout.splitlines()
    assert [cell.strip() for cell in table[0].split("|")[1:6]] == [
        "row", "closed 4 dB", "change", "own - SVG", "steps/min",
    ]  # fmt: skip
    assert len(table) == 2 + 3
    opaque = [cell.strip() for cell in table[-1].split("|")[1:-1]]
    assert opaque[0] == "opaque"
    assert float(opaque[1]) == pytest.approx(levels["opaque", "closed", 4], abs=0.006)


def test_change_is_over_the_pictures_that_both_have(folder, monkeypatch):
    original = runs.vectorize_picture

    def fail_one(picture, request, **options):
        if request.settings.recipe.opaque and picture.source.endswith("b.png"):
            raise EngineError("broke")
        return original(picture, request, **options)

    monkeypatch.setattr(runs, "vectorize_picture", fail_one)
    done = run("ablation", folder, "--curves", 4, "--mode", "closed", "--rows", "opaque", *SHORT, "--json")
    assert done.exit_code == 1
    found = strict(done.stdout)
    base, opaque = found["rows"]
    levels = {(run["picture"], run["configuration"]): run["psnr_db"] for run in found["runs"]}
    want = levels["a.png", "closed 4, opaque"] - levels["a.png", "closed 4, base"]
    assert opaque["change_db"] == pytest.approx(want, abs=1e-6)
    assert (base["pictures"], opaque["pictures"]) == (2, 1)


def test_all_rows_without_a_choice_and_unknown_ones_are_refused():
    assert ablation.chosen_rows(None) == list(ablation.ABLATIONS)
    assert ablation.chosen_rows(["base"]) == ["base"]
    with pytest.raises(UsageError, match="nonsense"):
        ablation.chosen_rows(["nonsense"])


# --- options -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        ("--curves", "0"), ("--curves", ""), ("--curves", "5,x"), ("--curves", "5;6"), ("--mode", "round"),
        ("--mode", ","), ("--csv", "t.txt"), ("--sheet", "s.jpg"),
    ],
)  # fmt: skip
def test_wrong_values_are_refused_before_any_work(folder, arguments, monkeypatch):
    monkeypatch.setattr(runs, "vectorize_picture", lambda *_, **__: pytest.fail("worked"))
    assert isinstance(run("quality", folder, *arguments).exception, UsageError)


def test_missing_and_empty_folders_are_one_clear_error(tmp_path):
    for path in (tmp_path / "none", tmp_path):
        assert isinstance(run("quality", path).exception, InputError)
    assert isinstance(run("ablation", tmp_path).exception, InputError)


def test_every_option_is_documented_with_its_default():
    commands = typer.main.get_command(bench).commands
    parts = re.split(r"^## cubicsplat bench (\w+).*$", DOCS.read_text(encoding="utf-8"), flags=re.MULTILINE)
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    assert set(sections) == set(commands)
    for name, command in commands.items():
        table = sections[name].partition("| Option |")[2].partition("\n\n")[0]
        rows = {}
        for line in table.splitlines():
            cells = [cell.strip() for cell in line.replace(r"\|", "/").split("|")[1:-1]]
            for option in re.findall(r"(?<![\w-])(--?[a-z][a-z-]*)", cells[0]) if cells else ():
                rows[option] = cells
        declared = {opt for p in command.params for opt in [*p.opts, *p.secondary_opts] if opt[0] == "-"}
        assert declared | {"--help", "-h"} == set(rows), name
        for parameter in command.params:
            if parameter.opts[0] in rows and parameter.default not in (None, False):
                default = getattr(parameter.default, "value", parameter.default)
                assert rows[parameter.opts[0]][1] == str(default), (name, parameter.opts[0])


def test_presets_in_the_documentation_are_all():
    from cubicsplat_cli.settings import PRESETS

    found = re.findall(r"`--preset ([^`]*)`", DOCS.read_text(encoding="utf-8"))
    assert len(found) >= 4
    for choices in found:
        assert set(io.StringIO(choices).read().split(r"\|")) == set(PRESETS)
