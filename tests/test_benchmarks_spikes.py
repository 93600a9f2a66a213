"""`benchmarks.spikes`: cusps and slivers of files, against shapes whose figures are known."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scenes import straight

from benchmarks.spikes import Spikes, cusps_of, opened, spikes_of
from cubicsplat_cli.scene import Scene, pack_rings
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.scene_writer import write_svg


def polygon(*corners: tuple[float, float]) -> np.ndarray:
    """(3M, 2): its sides as cubics."""
    return straight(corners, closed=True).numpy()


def scene(*rings: list[np.ndarray], opacity: float = 1.0, mode: Mode = Mode.CLOSED, half_width: float = 0.0) -> Scene:
    points, ends = pack_rings(mode, list(rings))
    count = len(rings)
    return Scene(
        mode, 40, 30, points, np.full((count, 3), 0.5, np.float32), np.full(count, opacity, np.float32),
        np.full(count, half_width, np.float32), (1.0, 1.0, 1.0), ends,
    )  # fmt: skip


def bar(thickness: float, length: float = 10.0, left: float = 5.0) -> np.ndarray:
    return polygon((left, 8), (left + length, 8), (left + length, 8 + thickness), (left, 8 + thickness))


def test_a_bar_thinner_than_a_third_of_a_pixel_is_a_sliver_as_far_as_it_is_seen_and_shows_through():
    assert spikes_of(scene([bar(0.25)])).slivers == pytest.approx(2.5, rel=0.02)
    assert spikes_of(scene([bar(0.25)], opacity=0.4)).slivers == pytest.approx(1.0, rel=0.02)
    assert spikes_of(scene([bar(0.5)])).slivers < 0.1
    assert spikes_of(scene([bar(0.25, left=-4.0)])).slivers == pytest.approx(1.5, rel=0.02)
    assert spikes_of(scene([bar(0.25, left=-40.0)])) == Spikes(0, 0.0)
    both = spikes_of(scene([bar(0.25)], [bar(0.5), bar(0.25, left=25.0)]))
    assert both.slivers == pytest.approx(5.0, rel=0.04), "every ring counts"


def test_a_slanted_bar_is_what_a_level_one_is():
    for angle in (0.3, 0.7, 1.2):
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]], np.float32)
        for thickness, slivers in ((0.22, 2.2), (0.5, 0.0)):
            ring = (bar(thickness) - [10, 8]) @ turn + [20, 15]
            assert spikes_of(scene([ring.astype(np.float32)])).slivers == pytest.approx(slivers, abs=0.15)


def test_a_thin_stroke_is_a_sliver():
    line = np.array([[5, 8], [8, 8], [12, 8], [15, 8]], np.float32)
    assert spikes_of(scene([line], mode=Mode.OPEN, half_width=0.125)).slivers == pytest.approx(2.5, rel=0.1)
    assert spikes_of(scene([line], mode=Mode.OPEN, half_width=0.4)).slivers < 0.05


def test_cusps_are_sharp_corners_that_are_seen():
    needle = polygon((5, 8), (25, 8), (5, 10))  # one of 174 degrees, others of 90 and 96
    assert cusps_of(scene([needle])) == 1
    assert cusps_of(scene([polygon((5, 8), (25, 8), (5, 20))])) == 0
    assert cusps_of(scene([needle + np.float32([30, 0])])) == 0, "its tip is off the canvas"
    back = np.array([[5, 8], [25, 8], [25, 8.5], [6, 9]], np.float32)
    there = np.array([[5, 8], [8, 8], [10, 8], [15, 8], [12, 8.1], [9, 8.1], [6, 8.1]], np.float32)
    assert [cusps_of(scene([line], mode=Mode.OPEN, half_width=1.0)) for line in (back, there)] == [0, 1]


def test_opening_keeps_what_the_disc_fits_in():
    inside = np.zeros((20, 40), bool)
    inside[2:5, 3:30], inside[8:12, 3:30] = True, True
    kept = opened(inside)
    assert not kept[:8].any()
    corners = np.zeros_like(inside)
    corners[[8, 8, 11, 11], [3, 29, 3, 29]] = True
    assert (kept == (inside & ~corners & (np.arange(20) >= 8)[:, None])).all()


def test_the_command_measures_files_and_refuses_others(tmp_path, run_benchmark):
    for name, thickness in (("thin", 0.25), ("thick", 1.0)):
        (tmp_path / f"{name}.svg").write_text(write_svg(scene([bar(thickness)]), precision=2))
    files = [str(tmp_path / f"{name}.svg") for name in ("thin", "thick")]
    found = json.loads(run_benchmark("spikes", *files, "--json").stdout)
    assert [row["file"] for row in found["files"]] == ["thin.svg", "thick.svg"]
    assert found["files"][0]["slivers"] == pytest.approx(2.5, rel=0.02)
    assert found["means"]["slivers"] == pytest.approx(np.mean([row["slivers"] for row in found["files"]]), abs=1e-3)
    table = run_benchmark("spikes", *files, "--markdown").stdout.decode().splitlines()
    assert [line.split()[1] for line in table if line[2] != "-"] == ["file", "thin.svg", "thick.svg", "mean"]
    foreign = tmp_path / "foreign.svg"
    foreign.write_text('<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><circle r="3"/></svg>')
    for path in (foreign, tmp_path / "none.svg"):
        run_benchmark("spikes", path, code=1, error=path.name)
