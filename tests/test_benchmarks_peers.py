"""`benchmarks.peers`: other tools beside ours, what they lack, how they fail, and the table and plot of the means."""

from __future__ import annotations

import csv
import io
import json
import shutil
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import torch
from conftest import smooth_pixels
from PIL import Image

from benchmarks import peers, tools
from benchmarks.peers import Point, Points, means, plotted, run_peers, table_of
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.evaluate.comparison import compare_with
from cubicsplat_cli.files.load import as_picture

FLAT = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="40" height="28"><rect width="40" height="28" fill="#806050"/></svg>'
)
OURS = ("--curves", "4,8", "--steps", 6, "--threads", 1)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "in").mkdir()
    for name, width in (("a", 40), ("b", 32)):
        Image.fromarray(smooth_pixels(width, 28)).save(tmp_path / "in" / f"{name}.png")
    return tmp_path / "in"


def test_every_picture_by_every_tool_and_a_failure_stops_nothing(folder):
    def breaks(pixels: np.ndarray) -> bytes:
        raise ValueError("out of fill")

    points, told = Points(), []
    made = {("flat", "usual"): lambda pixels: FLAT.encode(), ("bad", "usual"): breaks, ("none", "x"): lambda p: b"?"}
    run_peers(sorted(folder.iterdir()), made, points, told.append)
    assert [(point.picture, point.tool, point.bytes) for point in points.done] == [
        ("a.png", "flat", len(FLAT)),
        ("b.png", "flat", len(FLAT)),
    ]
    wanted = compare_with(as_picture(folder / "a.png"), "a", FLAT.encode(), "b", is_svg=True).quality
    assert (points.done[0].psnr_db, points.done[0].ssim) == (wanted.psnr_db, wanted.ssim)
    assert [failed[:2] for failed in points.failed] == [
        ("a.png", "bad, usual"), ("a.png", "none, x"), ("b.png", "bad, usual"), ("b.png", "none, x"),
    ]  # fmt: skip
    assert "out of fill" in points.failed[0][2]
    assert len(told) == 6


def of(tool: str, setting: str, level: float | None, size: int) -> Point:
    return Point("p", tool, setting, level, 0.9, size, size // 2, 2.0, "r")


def test_means_leave_out_what_has_no_figure():
    points = [of("t", "s", 30.0, 1000), of("t", "s", None, 3000)]
    assert means(points)["psnr_db"] == 30.0
    assert means(points)["bytes"] == 2000.0
    table = table_of(Points([*points, of("t", "other", None, 10)]), markdown=True).splitlines()
    assert table[2].split("|")[1:8] != table[3].split("|")[1:8]
    assert "30.00" in table[2]


def test_the_plot_has_four_panels_and_a_line_for_each_tool():
    pytest.importorskip("matplotlib", reason="needs the extra plots")
    points = Points([of("one", "1", 20.0, 1000), of("one", "2", 25.0, 9000), of("two", "1", 22.0, 4000)])
    with Image.open(io.BytesIO(plotted(points))) as image:
        assert image.size == (1100, 825)
        assert image.text["Software"].startswith("cubicsplat ")
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3)
    # matplotlib's first two colours.
    for colour in ((31, 119, 180), (255, 127, 14)):
        assert (np.abs(pixels.astype(int) - colour).max(axis=1) < 3).sum() > 100


def test_the_command_prints_draws_and_tabulates(run_benchmark, folder, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib", reason="needs the extra plots")
    monkeypatch.setattr(peers, "missing_piece", lambda name: None if name == "potrace" else f"no {name}")
    monkeypatch.setitem(tools.TOOLS, "potrace", lambda pixels: FLAT.encode())
    out, table = tmp_path / "p.png", tmp_path / "t.csv"
    done = run_benchmark("peers", folder, *OURS, "--plot", out, "--csv", table, "--json")
    assert b"note: without vtracer: no vtracer" in done.stderr
    found = json.loads(done.stdout)
    assert [(row["tool"], row["setting"]) for row in found["means"]] == [
        ("cubicsplat", "4 curves"), ("cubicsplat", "8 curves"), ("potrace", "black and white"),
    ]  # fmt: skip
    assert len(list(csv.DictReader(table.open()))) == 6
    assert out.is_file()
    done = run_benchmark("peers", folder, *OURS, "--plot", out, "--limit", 1, "-q")
    assert (done.stdout.count(b"\n"), done.stderr) == (4, b"")


def test_what_is_wrong_is_said_before_the_work(run_benchmark, folder, tmp_path):
    Image.fromarray(smooth_pixels(8, 8)).save(tmp_path / "mine.png")
    for more, words in (
        (("--tools", "inkscape"), "--tools must be of vtracer, potrace, diffvg"),
        (("--plot", tmp_path / "p.pdf"), "must end in .png"),
        (("--plot", tmp_path / "mine.png"), "was not written by cubicsplat"),
        (("--tools", "diffvg"), "pydiffvg cannot be imported"),
    ):
        run_benchmark("peers", folder, *OURS, *more, code=2, error=words)


def test_vtracer_draws_more_finely_with_finer_settings():
    pytest.importorskip("vtracer", reason="needs vtracer")
    picture = as_picture(smooth_pixels(80, 60))
    pixels = np.dstack([smooth_pixels(80, 60), np.full((60, 80), 255, np.uint8)])
    levels = [
        compare_with(picture, "a", make(pixels), "b", is_svg=True).quality.psnr_db
        for make in tools.settings_of_peers(["vtracer"]).values()
    ]
    assert levels[0] < levels[2] <= levels[3]


@pytest.mark.skipif(shutil.which("potrace") is None, reason="needs potrace: apt-get install potrace")
def test_potrace_draws_what_is_dark():
    pixels = np.full((40, 40, 4), 255, np.uint8)
    pixels[10:30, 10:30, :3] = 20
    svg = tools.potrace_svg(pixels)
    drawn = compare_with(as_picture(np.where(pixels < 128, 0, 255).astype(np.uint8)), "a", svg, "b", is_svg=True)
    assert drawn.quality.psnr_db is None or drawn.quality.psnr_db > 20
    pixels[..., 3] = np.where(pixels[..., 0] == 20, 255, 0)
    assert b"<rect" not in tools.potrace_svg(pixels)


@pytest.mark.slow
def test_diffvg_is_used_as_its_authors_do(monkeypatch):
    """With a stand-in of the same interface, which draws the mean of the fills."""
    library = ModuleType("pydiffvg")

    class Drawing:
        @staticmethod
        def serialize_scene(width, height, paths, groups):
            assert [len(path.points) for path in paths] == [12] * len(groups)
            return [width, height, *(group.fill_color for group in groups), *(path.points for path in paths)]

        @staticmethod
        def apply(width, height, across, down, seed, background, *scene):
            colours = torch.stack([v for v in scene[2:] if v.ndim == 1])
            moved = sum(v.sum() for v in scene[2:] if v.ndim == 2)
            return (colours.mean(0) + 0.0 * moved).expand(height, width, 4)

    def save_svg(path, width, height, paths, groups):
        red, green, blue, _ = (round(255 * float(v.detach())) for v in groups[0].fill_color)
        Path(path).write_text(f"{width} {height} {red} {green} {blue}")

    library.Path = lambda counts, points, width, closed: SimpleNamespace(points=points)
    library.ShapeGroup = lambda ids, colour: SimpleNamespace(fill_color=colour)
    library.RenderFunction, library.save_svg = Drawing, save_svg
    monkeypatch.setitem(sys.modules, "pydiffvg", library)
    pixels = np.zeros((6, 9, 4), np.uint8)
    pixels[...] = (200, 100, 50, 255)
    width, height, red, green, blue = map(int, tools.diffvg_svg(pixels, 1, iterations=60).split())
    assert (width, height) == (9, 6)
    assert red > green > blue


def test_tools_are_named(monkeypatch, tmp_path):
    with pytest.raises(UsageError, match="ours, photo, vtracer, potrace, diffvg"):
        tools.chosen_tools(["paint"])
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UsageError, match=r"apt-get install potrace, or leave it out of --tools"):
        tools.chosen_tools(["ours", "potrace"])
