"""The benchmark of the GPU runs, on the emulator and tiny sizes: its figures mean nothing here."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

import pytest
from conftest import rest_slow
from engines import CUDA, open_cuda

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.settings import Mode

TOOL = Path(__file__).parent.parent / "tools" / "bench_gpu.py"


@pytest.fixture
def tool(monkeypatch):
    spec = importlib.util.spec_from_file_location("bench_gpu", TOOL)
    tool = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "bench_gpu", tool)
    spec.loader.exec_module(tool)
    return tool


def test_fits_and_the_whole_command_are_timed(tool, run_cli):
    """The command in this process, which has torch: its start, twice, is no behaviour of the tool."""

    def run(arguments):
        run_cli(*arguments)

    assert tool.fit_seconds("cpu", 24, 16, steps=12, curves=3) > 0
    assert tool.command_seconds("cpu", 24, 16, run, steps=12, curves=3) > 0
    assert tool.command_seconds("cpu", 24, 16, run, pictures=2, jobs=2, steps=12, curves=3) > 0


def without_a_gpu():
    raise EngineError("no GPU today")


@pytest.mark.parametrize(("visible", "number", "shown"), [(None, 1, "1"), ("4,GPU-abc", 1, "GPU-abc"), ("2", 0, "2")])
def test_everything_is_measured_on_the_gpu_that_is_asked_for(tool, monkeypatch, visible, number, shown):
    """The engine, the fit and the command, which is a process of its own."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible or "")
    assert tool.main(["--device", str(number)], without_a_gpu) == 1
    assert os.environ["CUDA_VISIBLE_DEVICES"] == shown


def test_without_a_gpu_the_benchmark_says_what_is_missing(tool, capsys):
    assert tool.main([], without_a_gpu) == 1
    assert capsys.readouterr().err == "bench_gpu: error: no GPU today\n"


@pytest.mark.parametrize("kind", CUDA)
@pytest.mark.parametrize("mode", rest_slow(*Mode))
def test_the_benchmark_of_the_gpu(kind, mode, tool):
    case = tool.Case(mode, 40, 32, 24, 2, 6, 1e6, 1e-6, 500.0)
    result = tool.measure(open_cuda(kind), case, warm_up=6, repeats=1, rounds=1)
    assert result["psnr_db"] > 8.0
    assert set(result["kernel_ms"]["exact"]) == {"flatten", "raster_exact", "update"}
    assert all(ms > 0 for ms in result["step_ms"].values())
    text = "\n".join(tool.lines(result))
    assert f"40x32 {mode.value} 24" in text
    assert "target 1e+06 met" in text
    assert tool.verdict(2.0, 1.5, 0.8) == "MISSES 1.5"
    assert tool.verdict(0.5, 1.5, 0.8) == "goal 0.8 met"
