"""`cubicsplat eval` with folders, tables and --scale."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from cli_runs import strict_json
from conftest import smooth_pixels
from PIL import Image
from scenes import PAPER, random_scene

from cubicsplat_cli.settings import SCALE, Mode
from cubicsplat_cli.svg.scene_writer import write_svg


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    """Three references; an SVG and a picture of two of them, and what belongs to none."""
    references, candidates = tmp_path / "references", tmp_path / "candidates"
    references.mkdir()
    candidates.mkdir()
    for name in ("a", "b", "c"):
        Image.fromarray(smooth_pixels(40, 28)).save(references / f"{name}.png")
    scene = random_scene(Mode.CLOSED, curves=5, width=40, height=28, background=PAPER)
    (candidates / "a.svg").write_text(write_svg(scene, title="t", comment="cubicsplat test"))
    Image.fromarray(smooth_pixels(40, 28)).save(candidates / "b.png")
    (candidates / "stray.svg").write_text("<svg/>")
    return references, candidates


def test_folders_are_judged_pair_by_pair_and_failures_come_last(folders, run_cli):
    done = run_cli("eval", *folders, code=1)
    first, second, mean = done.stdout.decode().splitlines()
    assert first.startswith(str(folders[1] / "a.svg"))
    assert " dB  SSIM 0." in first
    assert second == f"{folders[1] / 'b.png'}  identical  SSIM 1.0000"
    assert mean.startswith("mean of 2  ")
    assert b"without a reference: stray.svg" in done.stderr
    assert done.stderr.decode().splitlines()[-1].startswith(f"cubicsplat: error: {folders[0] / 'c.png'}: ")


def test_json_and_csv_of_folders_hold_every_pair_and_the_means(folders, tmp_path, run_cli):
    (folders[0] / "c.png").unlink()
    Image.fromarray(smooth_pixels(40, 28) // 2).save(folders[1] / "b.png")
    table = tmp_path / "table.csv"
    done = run_cli("eval", *folders, "--json", "--csv", table, "-q")
    assert done.stderr == b""
    found = strict_json(done.stdout)
    levels = [pair["quality"]["psnr_db"] for pair in found["pairs"]]
    assert len(levels) == 2
    assert found["mean"]["psnr_db"] == pytest.approx(sum(levels) / 2, abs=1e-3)
    assert (found["mean"]["pairs"], found["mean"]["identical"], found["failed"]) == (2, 0, [])
    assert found["mean"]["svg_change_db"] is None
    rows = list(csv.DictReader(table.open()))
    assert [float(row["psnr_db"]) for row in rows] == pytest.approx(levels, abs=1e-3)
    assert [row["kind"] for row in rows] == ["svg", "raster"]
    assert rows[0]["scale"] == ""


def test_one_pair_that_cannot_be_judged_does_not_stop_the_others(folders, run_cli):
    (folders[1] / "c.svg").write_text("no svg")
    done = run_cli("eval", *folders, "--json", code=1)
    found = strict_json(done.stdout)
    assert [Path(pair["candidate"]["path"]).name for pair in found["pairs"]] == ["a.svg", "b.png"]
    assert "is no SVG" in found["failed"][0]["error"]
    for path in folders[1].iterdir():
        path.write_text("broken")
    assert b"is no SVG; give an SVG file; " in run_cli("eval", *folders, code=1).stderr


def test_scale_shows_file_and_engine(folders, tmp_path, run_cli):
    table = tmp_path / "t.csv"
    done = run_cli("eval", folders[0] / "a.png", folders[1] / "a.svg", "--scale", 2, "--threads", 1, "--csv", table)
    native, file, engine = done.stdout.decode().splitlines()
    assert native.startswith(str(folders[1] / "a.svg"))
    for line, name in ((file, "cairosvg"), (engine, "engine")):
        assert line.startswith("  2x, 80 x 56 px  " + name)
        assert "(native " in line
    (row,) = csv.DictReader(table.open())
    assert row["scale"] == "2"
    assert abs(float(row["engine_scaled_psnr_db"]) - float(row["engine_psnr_db"])) < 0.1
    assert abs(float(row["scaled_psnr_db"]) - float(row["psnr_db"])) < 0.1


def test_scale_over_folders_reports_the_mean_change(folders, run_cli):
    (folders[0] / "b.png").unlink()
    (folders[0] / "c.png").unlink()
    done = run_cli("eval", *folders, "--scale", 3, "--threads", 1)
    assert b"  svg " in done.stdout.splitlines()[-1]
    assert b"  engine " in done.stdout.splitlines()[-1]


def test_wrong_usage(folders, tmp_path, run_cli):
    picture, svg = folders[0] / "a.png", folders[1] / "a.svg"
    run_cli("eval", folders[0], svg, code=2, error="is a folder")
    run_cli("eval", picture, svg, "--csv", tmp_path / "figures.txt", code=2, error="--csv")
    run_cli("eval", picture, folders[1] / "b.png", "--scale", 2, code=2, error="--scale")
    run_cli("eval", picture, svg, "--scale", SCALE.most + 1, code=2, error="--scale")
