"""`bench quality`: figures, cache, failures, sheet and tables."""

from __future__ import annotations

import csv
import json
import re
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from cli_runs import strict_json
from conftest import ctrl_c, smooth_pixels
from PIL import Image

from cubicsplat_cli.bench.quality import means, quality_jobs
from cubicsplat_cli.bench.runs import CacheEntry, run_all
from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.evaluate.images import of_pixels
from cubicsplat_cli.evaluate.metrics import compare
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.pipeline.vectorize import vectorize_picture

SHORT = ("--steps", 12, "--threads", 1)


def quiet(_name: str):
    return nullcontext(None)


def jobs_of(two_pictures: Path, **overrides):
    settings = {"steps": 12, "threads": 1} | overrides
    return quality_jobs(sorted(two_pictures.iterdir()), ["closed"], [5], {"preset": "draft", **settings})


# --- quality -----------------------------------------------------------------------------------------------


def test_quality_reports_what_the_files_are_worth(two_pictures, tmp_path, run_cli):
    cache = tmp_path / "cache"
    kinds = ("--curves", "5,8", "--mode", "closed,open")
    done = run_cli("bench", "quality", two_pictures, *kinds, *SHORT, "--cache", cache, "--json")
    found = strict_json(done.stdout)
    assert list(found["means"]) == ["closed 5", "closed 8", "open 5", "open 8"]
    assert len(found["runs"]) == 8
    kept = {path.name.rsplit("-", 1)[0]: path for path in cache.glob("*.svg")}
    for figures in found["runs"]:
        svg = kept[f"{Path(figures['picture']).stem}-{figures['mode']}-{figures['curves']}"].read_bytes()
        picture = load_picture(two_pictures / figures["picture"])
        quality = compare(picture, of_pixels(rerender(svg, picture.width, picture.height).pixels))
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


def test_tables_have_a_mean_row_per_configuration_and_a_table_of_means(two_pictures, run_cli):
    done = run_cli("bench", "quality", two_pictures, "--curves", "4,6", *SHORT)
    lines = done.stdout.decode().splitlines()
    assert [line for line in lines if re.fullmatch(r"closed \d|means", line)] == ["closed 4", "closed 6", "means"]
    assert sum(line.startswith("mean of 2") for line in lines) == 2
    assert [line.split()[:2] for line in lines[-2:]] == [["closed", "4"], ["closed", "6"]]
    said = [line.split(b":")[0] for line in done.stderr.splitlines()[:2]]
    assert said == [b"a.png, closed 4", b"b.png, closed 4"]
    done = run_cli("bench", "quality", two_pictures, "--curves", 4, "--limit", 1, "--markdown", "-q", *SHORT)
    assert done.stderr == b""
    assert done.stdout.startswith(b"### closed 4\n\n| picture ")
    assert b"| a.png " in done.stdout
    assert b"b.png" not in done.stdout


def test_csv_has_a_row_per_fit(two_pictures, tmp_path, run_cli):
    table = tmp_path / "table.csv"
    run_cli("bench", "quality", two_pictures, "--curves", "4", *SHORT, "--csv", table)
    rows = list(csv.DictReader(table.open()))
    assert [row["picture"] for row in rows] == ["a.png", "b.png"]
    assert float(rows[0]["psnr_db"]) > 5


def test_a_bad_picture_is_reported_once_and_the_others_go_on(two_pictures, run_cli):
    (two_pictures / "aa.png").write_text("no picture")
    done = run_cli("bench", "quality", two_pictures, "--curves", "4,5", *SHORT, "--json", code=1)
    found = strict_json(done.stdout)
    assert len(found["runs"]) == 4
    assert [failure["picture"] for failure in found["failed"]] == ["aa.png"]
    assert done.stderr.splitlines()[-1].startswith(b"cubicsplat: failed: aa.png: ")
    for path in two_pictures.iterdir():
        path.write_text("no picture")
    assert b"no picture could be fitted" in run_cli("bench", "quality", two_pictures, *SHORT, code=1).stderr


def test_a_fit_that_breaks_down_is_reported_with_its_configuration(two_pictures):
    def sometimes(picture, request, **options):
        if request.settings.curves == 5:
            raise EngineError("the fit broke\ndown")
        return vectorize_picture(picture, request, **options)

    said: list[str] = []
    fits = quality_jobs(
        sorted(two_pictures.iterdir()), ["closed"], [4, 5], {"preset": "draft", "steps": 12, "threads": 1}
    )
    found = run_all(fits, None, quiet, said.append, sometimes)
    assert found.failed == [(name, "closed 5", "the fit broke down") for name in ("a.png", "b.png")]
    assert "a.png, closed 5: failed: the fit broke down" in said
    assert (len(found.of("closed 4")), len(found.of("closed 5"))) == (2, 0)


# --- the cache ---------------------------------------------------------------------------------------------


def test_a_second_run_takes_everything_from_the_cache(two_pictures, tmp_path):
    cache = tmp_path / "new" / "cache"
    first = run_all(jobs_of(two_pictures), cache, quiet, lambda _: None)
    said: list[str] = []
    second = run_all(jobs_of(two_pictures), cache, quiet, said.append, lambda *_, **__: pytest.fail("fitted again"))
    assert [svg for _, svg in second.done] == [svg for _, svg in first.done]
    assert all(found.cached for found, _ in second.done)
    assert all("from the cache" in line for line in said)
    assert means(second.of("closed 5")) == means(first.of("closed 5"))


def entry(two_pictures: Path, code: str | None = None, **overrides) -> str:
    (job, *_) = jobs_of(two_pictures, **overrides)
    return CacheEntry(Path("x"), job, load_picture(job.path), code).json.name


def test_a_cached_result_counts_only_for_the_same_fit(two_pictures):
    kept = entry(two_pictures)
    assert kept == entry(two_pictures)
    assert kept != entry(two_pictures, steps=13)
    assert kept != entry(two_pictures, seed=1)
    assert kept != entry(two_pictures, rate_colours=0.01)
    assert kept != entry(two_pictures, "other code")
    Image.fromarray(smooth_pixels(32, 20) // 2).save(two_pictures / "a.png")
    assert kept != entry(two_pictures), "another picture of the same name"


@pytest.mark.parametrize("damage", ["svg", "json", "member"])
def test_damaged_entries_are_made_anew(two_pictures, tmp_path, damage):
    jobs = jobs_of(two_pictures)[:1]
    first = run_all(jobs, tmp_path / "c", quiet, lambda _: None)
    (svg,), (report,) = (tmp_path / "c").glob("*.svg"), (tmp_path / "c").glob("*.json")
    if damage == "svg":
        svg.write_bytes(b"<svg/>")
    elif damage == "json":
        report.unlink()
    else:
        kept = json.loads(report.read_text())
        del kept["quality"]["svg"]["ssim"]
        report.write_text(json.dumps(kept))
    second = run_all(jobs, tmp_path / "c", quiet, lambda _: None)
    assert not second.done[0][0].cached
    assert second.done[0][1] == first.done[0][1]
    assert run_all(jobs, tmp_path / "c", quiet, lambda _: None).done[0][0].cached


def test_an_interrupted_fit_ends_the_run_and_is_not_kept(two_pictures, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run_all(jobs_of(two_pictures), tmp_path / "c", lambda _: nullcontext(ctrl_c), lambda _: None)
    assert not (tmp_path / "c").exists()


# --- the sheet ---------------------------------------------------------------------------------------------


def test_the_sheet_shows_original_svg_and_error(two_pictures, tmp_path, run_cli):
    sheet = tmp_path / "sheet.png"
    cache = tmp_path / "c"
    run_cli("bench", "quality", two_pictures, "--curves", "6", *SHORT, "--sheet", sheet, "--cache", cache)
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
    run_cli("bench", "quality", two_pictures, "--curves", "6", *SHORT, "--sheet", sheet, "--cache", cache)


def test_only_the_first_four_pictures_are_shown_and_large_ones_are_made_smaller(two_pictures, tmp_path, run_cli):
    for name in "cdefg":
        Image.fromarray(smooth_pixels(8, 8)).save(two_pictures / f"{name}.png")
    Image.fromarray(smooth_pixels(1000, 10)).save(two_pictures / "a.png")
    sheet = tmp_path / "sheet.png"
    run_cli("bench", "quality", two_pictures, "--curves", "2", "--steps", 3, "--threads", 1, "--sheet", sheet)
    with Image.open(sheet) as image:
        assert image.size == (3 * 768 + 4 * 6, 4 * (18 + 6) + 8 + 24 + 8 + 8)


def test_a_picture_of_the_users_is_never_replaced_by_a_sheet(two_pictures, run_cli):
    before = (two_pictures / "a.png").read_bytes()
    run_cli("bench", "quality", two_pictures, *SHORT, "--sheet", two_pictures / "a.png", code=2, error="not written by")
    assert (two_pictures / "a.png").read_bytes() == before


# --- options -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        ("--curves", "0"), ("--curves", ""), ("--curves", "5,x"), ("--curves", "5;6"), ("--mode", "round"),
        ("--mode", ","), ("--csv", "t.txt"), ("--sheet", "s.jpg"),
    ],
)  # fmt: skip
def test_wrong_values_are_refused_before_any_work(two_pictures, arguments, run_cli):
    for path in two_pictures.iterdir():
        path.write_text("a picture that would be refused")
    run_cli("bench", "quality", two_pictures, *arguments, code=2, error=arguments[0])


def test_missing_and_empty_folders_are_one_clear_error(tmp_path, run_cli):
    for path in (tmp_path / "none", tmp_path):
        run_cli("bench", "quality", path, code=1, error=str(path))
