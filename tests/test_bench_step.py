"""`bench step`: its picture, its figures and its memory."""

from __future__ import annotations

import json
import mmap
import sys

import numpy as np
import pytest

from cubicsplat_cli.bench.step import (
    Memory,
    measure_step,
    memory,
    step_lines,
    synthetic_picture,
    total_steps,
)
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.settings import FitSettings

SMALL = {"curves": 6, "threads": 1, "steps": 20}


def measured(mode: str = "closed", **changes):
    settings = FitSettings.from_preset("standard", mode=mode, **SMALL | changes)
    return measure_step(synthetic_picture(32, 24), "synthetic", settings, warmup=4, steps=6, baseline=memory())


def test_the_drawn_picture_is_the_same_every_time_and_has_all_kinds_of_content():
    picture = synthetic_picture(96, 64)
    assert picture.shape == (64, 96, 3)
    assert picture.dtype == np.float32
    assert picture.min() >= 0
    assert picture.max() <= 1
    assert (picture == synthetic_picture(96, 64)).all()
    # To 1/100, so that another machine's sine does not matter.
    assert float(picture.mean()) == pytest.approx(0.515, abs=0.005)
    steps = np.abs(np.diff(picture, axis=1)).max(axis=-1)
    assert (steps > 0.2).mean() > 0.01, "sharp edges"
    assert (steps < 0.02).mean() > 0.3, "smooth parts"
    small, large = synthetic_picture(96, 64), synthetic_picture(192, 128)
    halved = large.reshape(64, 2, 96, 2, 3).mean(axis=(1, 3))
    assert np.abs(halved - small).mean() < 0.02, "the same picture at another size"


@pytest.mark.parametrize("mode", ["closed", "open"])
def test_figures_of_both_phases(mode):
    report = measured(mode)
    assert report["settings"]["mode"] == mode
    for name in ("relaxed", "exact"):
        figures = report[name]
        assert figures["coverage"] == name
        assert 0 < figures["p10_ms"] <= figures["median_ms"] <= figures["p90_ms"]
        stages = figures["stages"]
        assert set(stages) >= {"flatten", "bin", "raster", "update", "replacement", "other"}
        assert sum(part["share"] for part in stages.values()) == pytest.approx(1.0, abs=1e-3)
        assert all(part["share"] >= 0 for part in stages.values())
        assert stages["raster"]["ms"] > 0
        assert figures["pairs"]["boundary"] > 0
        assert figures["pairs"]["edges"] >= figures["pairs"]["boundary"]
    assert report["relaxed"]["edge_width_px"] > report["exact"]["edge_width_px"]
    assert report["device"]["name"] == "cpu"


def test_without_an_exact_finish_there_is_none():
    report = measured(finish=0.0)
    assert report["exact"] is None
    assert "exact" not in step_lines(report).split("memory")[0].split("\n", 1)[1]


def test_an_engine_that_does_not_time_itself_is_one_stage(monkeypatch):
    from cubicsplat_cli.raster.cpu import CpuEngine

    for name in ("timings", "counts"):
        monkeypatch.delattr(CpuEngine, name)
    report = measured()
    assert set(report["relaxed"]["stages"]) == {"engine", "replacement", "other"}
    assert report["relaxed"]["stages"]["engine"]["share"] == pytest.approx(1.0)
    assert report["relaxed"]["pairs"] == {}
    assert "pairs" not in step_lines(report)


@pytest.mark.parametrize("finish", [0.0, 0.15, 0.5])
def test_timed_steps_lie_in_their_phase(finish):
    warmup, steps = 30, 20
    total = total_steps(warmup, steps, finish)
    assert (warmup + steps) / total <= min(0.5, 1 - finish)
    if finish:
        first = np.ceil((1 - finish) * total)
        assert first + steps + 5 <= total, "the fit does not end while steps are timed"


def test_senseless_counts_are_refused():
    settings = FitSettings.from_preset("standard", **SMALL)
    for warmup, steps in ((-1, 5), (0, 0)):
        with pytest.raises(UsageError, match="steps"):
            measure_step(synthetic_picture(8, 8), "s", settings, warmup=warmup, steps=steps, baseline=Memory(1, 1))


# --- memory ------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads Linux's process status")
def test_memory_grows_by_what_is_taken():
    before = memory()
    # A mapping of its own: the allocator may have memory left that is resident already.
    with mmap.mmap(-1, 40_000_000) as block:
        block.write(b"\1" * len(block))
        after = memory()
    assert 30e6 < after.resident - before.resident < 80e6
    assert after.peak >= after.resident


def test_status_is_read_in_bytes(tmp_path):
    status = tmp_path / "status"
    status.write_text("Name:\tx\nVmPeak:\t  999 kB\nVmHWM:\t   20 kB\nVmRSS:\t   10 kB\nThreads:\t1\n")
    assert memory(status) == Memory(10_240, 20_480)
    status.write_text("Name:\tx\n")
    assert memory(status) == Memory(None, None)


def test_systems_without_a_status_file_tell_the_peak_or_nothing(monkeypatch, tmp_path):
    found = memory(tmp_path / "none")
    assert found.resident is None
    assert found.peak > 10e6
    monkeypatch.setitem(sys.modules, "resource", None)
    assert memory(tmp_path / "none") == Memory(None, None)


@pytest.mark.parametrize(("peak", "said"), [(400.0, "peak 400.0 MB in all"), (None, "not known")])
def test_the_lines_say_what_is_known_of_the_memory(peak, said):
    report = measured()
    unknown = dict.fromkeys(report["memory"]) | {"peak_mb": peak}
    assert said in step_lines(report | {"memory": unknown})


# --- the command -------------------------------------------------------------------------------------------


QUICK = ("--curves", 6, "--threads", 1, "--warmup-steps", 2, "--steps", 3, "--preset", "draft")


def test_step_prints_lines_or_json(run_cli):
    done = run_cli("bench", "step", "--size", "40x24", *QUICK)
    first, relaxed = done.stdout.decode().splitlines()[:2]
    assert first.startswith("synthetic, 40 x 24 px, 6 closed curves of 4 segments")
    assert relaxed.startswith("relaxed")
    assert done.stdout.splitlines()[-1].startswith(b"memory")
    done = run_cli("bench", "step", "--size", "40x24", *QUICK, "--json", "--mode", "open")
    found = json.loads(done.stdout, parse_constant=pytest.fail)
    assert (found["bench"], found["settings"]["mode"], found["timed_steps"]) == ("step", "open", 3)
    assert found["memory"]["before_mb"] is None or found["memory"]["before_mb"] > 50


def test_step_of_a_picture_file(logo, run_cli):
    found = json.loads(run_cli("bench", "step", logo, *QUICK, "--json").stdout)
    assert found["picture"] == {"name": str(logo), "width": 32, "height": 32, "channels": 4}


@pytest.mark.parametrize("size", ["40", "0x5", "40x", "axb", "99999x5", "-4x4"])
def test_senseless_sizes_are_refused(size, run_cli):
    run_cli("bench", "step", f"--size={size}", code=2, error="--size must be")
