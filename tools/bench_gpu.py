"""Times and memory on the GPU, of what docs/cuda.md states targets for: training steps, a fit, the whole command.

    python tools/bench_gpu.py [--device N] [--json FILE]

A step is all of it: forward pass, loss, backward pass and optimiser, replayed from its CUDA graph. The scenes are
small discs or strokes that have been fitted for a while to a picture of gradients, discs and fine texture, so that
curves overlap and differ in size as in a fit. Also prints what the picture alone takes, and each kernel launched by
itself. A fit is one of `standard`, exact finish included, and the command is that from the start of its process to the
files; both for the second time, the first time compiling the kernels.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from cubicsplat_cli.bench.step import synthetic_picture
from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.photo.initial import control_points, new_curves, picture_colours_at
from cubicsplat_cli.photo.loop import fit
from cubicsplat_cli.photo.seeding import random_centres
from cubicsplat_cli.photo.state import FitCurves
from cubicsplat_cli.raster.cuda import compile as cuda_compile
from cubicsplat_cli.raster.cuda.engine import CudaEngine
from cubicsplat_cli.raster.engine import OptimiserState, Rates, Training
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.settings import FitSettings, Mode

ROUNDS = 7
FIT_TARGET_S, FIT_GOAL_S, COMMAND_TARGET_S = 1.0, 0.5, 5.0
FOLDER, FOLDER_TARGET_S, FOLDER_GOAL_S = 36, 14.0, 9.0  # pictures of a folder, and the time for all at the best --jobs
FOLDER_JOBS = (1, 3, 6, 8, 12)


@dataclass(frozen=True)
class Case:
    """A scene to measure, and what its relaxed step is meant to take: ms, and MB of memory."""

    mode: Mode
    width: int
    height: int
    curves: int
    segments: int
    samples: int
    target_ms: float | None = None
    goal_ms: float | None = None
    target_mb: float | None = None

    @property
    def name(self) -> str:
        return f"{self.width}x{self.height} {self.mode.value} {self.curves}"


CASES = [
    Case(Mode.CLOSED, 768, 512, 512, 4, 12, 0.30, 0.10),
    Case(Mode.OPEN, 768, 512, 512, 3, 24),
    Case(Mode.CLOSED, 2040, 1344, 2048, 4, 12, 1.5, 0.8),
    Case(Mode.OPEN, 2040, 1344, 2048, 3, 24, 2.5, 1.2),
    Case(Mode.CLOSED, 2040, 1344, 32768, 4, 12, target_mb=500.0),
]


def scene_of(case: Case, target: Tensor, device: torch.device) -> FitCurves:
    """Curves at random places with the colours of a target (H, W, 3) on the CPU: discs, or bent strokes."""
    generator = np.random.default_rng(1)
    settings = FitSettings.from_preset("standard", case.mode, curves=case.curves, segments=case.segments)
    centres = random_centres(case.curves, target, generator)
    radius = 0.4 * math.sqrt(case.width * case.height / case.curves)
    points = control_points(centres, radius, settings, generator)
    size, grey = (case.width, case.height), (0.5, 0.5, 0.5)
    return new_curves(points, picture_colours_at(centres, target), 1.5, settings, size, grey).as_torch(device)


class Bench:
    """One case on one engine."""

    def __init__(self, engine: CudaEngine, case: Case, warm_up: int, rounds: int) -> None:
        self.engine, self.case, self.rounds = engine, case, rounds
        self.before = self._allocated()
        target = torch.from_numpy(synthetic_picture(case.width, case.height))
        self.target = target.to(engine.device)
        self.scene = scene_of(case, target, engine.device)
        n = len(self.scene.points)
        self.state = OptimiserState.zeros_for(self.scene.points)
        size = math.sqrt(case.width * case.height)
        self.rates = Rates(5e-3 * size, 0.05, 0.05, 2e-4 * size)
        self.relaxed = RasterSettings("relaxed", 1.0, case.samples, 0.05)
        finish_samples = FitSettings.from_preset("standard", case.mode).finish_samples
        self.exact = RasterSettings("exact", 1.0, finish_samples, 0.0125)
        self.importance = torch.zeros(n, device=engine.device)
        for i in range(warm_up):
            width = 4.0 ** (1.0 - i / max(warm_up, 1))
            self.step(RasterSettings("relaxed", width, case.samples, 0.05))
        # What follows should not change the scene while it is timed. A rate of 0 would leave the work out.
        self.rates = Rates(1e-12, 1e-12, 1e-12, 1e-12)

    def step(self, settings: RasterSettings, loo: bool = False) -> Tensor:
        measured = {"importance": "loo", "out": {"importance": self.importance}} if loo else {}
        training = Training(self.target, self.state, self.rates, **measured)
        return self.engine.step(self.scene, settings, training)

    def _allocated(self) -> int:
        return torch.cuda.memory_allocated() if self.engine.device.type == "cuda" else 0

    def milliseconds(self, body: Callable[[], Any], repeats: int) -> float:
        """Median over rounds of the mean time of `repeats` calls in a row, after a few that do not count."""
        for _ in range(3):
            body()
        return statistics.median(self._round(body, repeats) / repeats for _ in range(self.rounds))

    def _round(self, body: Callable[[], Any], repeats: int) -> float:
        """ms of so many calls: between events in the GPU's own queue, so that the host's waiting is no part of it."""
        if self.engine.device.type == "cpu":  # the emulator
            start = time.perf_counter()
            for _ in range(repeats):
                body()
            return 1e3 * (time.perf_counter() - start)
        before, after = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        torch.cuda.synchronize()
        before.record()
        for _ in range(repeats):
            body()
        after.record()
        after.synchronize()
        return before.elapsed_time(after)

    def kernels(self, settings: RasterSettings, repeats: int) -> dict[str, float]:
        """ms of each kernel launched by itself, many times in a row."""
        self.loss = self.step(settings)  # kept: the launches below write to it again
        plan = next(reversed(self.engine._plans.values()))
        launches: list[tuple] = []
        recorder = type("Recorder", (), {"launch": lambda _, *call: launches.append(call)})()
        self.engine._launch(recorder, plan.frame)
        return {call[0]: self.milliseconds(lambda call=call: plan.kernels.launch(*call), repeats) for call in launches}

    def run(self, repeats: int) -> dict[str, Any]:
        times = {
            "picture alone, relaxed": self.milliseconds(lambda: self.engine.render(self.scene, self.relaxed), repeats),
            "relaxed": self.milliseconds(lambda: self.step(self.relaxed), repeats),
            "relaxed, leave-one-out": self.milliseconds(lambda: self.step(self.relaxed, loo=True), repeats),
            "exact": self.milliseconds(lambda: self.step(self.exact), repeats),
        }
        stages = {"relaxed": self.kernels(self.relaxed, repeats), "exact": self.kernels(self.exact, repeats)}
        peak = torch.cuda.max_memory_allocated() if self.engine.device.type == "cuda" else 0
        loss = float(self.step(self.relaxed))
        psnr = 10.0 * math.log10(self.target.numel() / max(loss, 1e-30))
        return {
            "case": asdict(self.case) | {"mode": self.case.mode.value}, "name": self.case.name, "psnr_db": psnr,
            "step_ms": times, "kernel_ms": stages, "memory_mb": (peak - self.before) / 1e6,
        }  # fmt: skip


def measure(
    engine: CudaEngine, case: Case, warm_up: int = 200, repeats: int = 50, rounds: int = ROUNDS
) -> dict[str, Any]:
    """Times and memory of one case, as plain values."""
    engine.close()
    if engine.device.type == "cuda":
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats()
    return Bench(engine, case, warm_up, rounds).run(repeats)


def standard(device: str, **changes: float) -> FitSettings:
    return FitSettings.from_preset("standard", "closed", device=device, **{"curves": 512, **changes})


def fit_seconds(device: str, width: int = 768, height: int = 512, **changes: float) -> float:
    """Time of a fit by `standard` in this process, the second of two."""
    settings = standard(device, **changes)
    target = synthetic_picture(width, height)
    return [fit(target, settings).fit_s for _ in range(2)][-1]


def in_a_process(arguments: list[str]) -> None:
    """The command with these arguments."""
    subprocess.run([sys.executable, "-m", "cubicsplat_cli", *arguments], check=True)


def command_seconds(
    device: str, width: int = 768, height: int = 512, run: Callable[[list[str]], object] = in_a_process,
    pictures: int = 1, **changes: int,
) -> float:  # fmt: skip
    """Time of the whole command, the second of two, from the start of its process to the files and its end.

    pictures: several are of a folder; each is the same one, turned by another part of its width.
    """
    with tempfile.TemporaryDirectory() as folder:
        pixels = np.rint(255 * synthetic_picture(width, height)).astype(np.uint8)
        for index in range(pictures):
            turned = np.roll(pixels, index * width // pictures, axis=1)
            Image.fromarray(turned).save(Path(folder) / f"picture{index:02}.png")
        options = ["--device", device, "--force", "--quiet", "--style", "photo"]
        for name, value in {"curves": 512, **changes}.items():
            options += [f"--{name}", str(value)]
        command = ["vectorize", folder, *options]
        taken = []
        for _ in range(2):
            start = time.perf_counter()
            run(command)
            taken.append(time.perf_counter() - start)
    return taken[-1]


def compile_seconds(architecture: str) -> float:
    """Time of compiling one program, that of closed curves on an opaque picture."""
    start = time.perf_counter()
    cuda_compile.compile_text(cuda_compile.Program(Mode.CLOSED, 3), architecture)
    return time.perf_counter() - start


def verdict(value: float, target: float | None, goal: float | None = None) -> str:
    """How a value stands to what was aimed at."""
    if target is None:
        return ""
    if goal is not None and value <= goal:
        return f"goal {goal:g} met"
    return f"target {target:g} met" if value <= target else f"MISSES {target:g}"


def lines(result: dict[str, Any]) -> list[str]:
    """One case as text."""
    case, step, text = result["case"], result["step_ms"], []
    aim = verdict(step["relaxed"], case["target_ms"], case["goal_ms"])
    text.append(f"{result['name']}  ({result['psnr_db']:.1f} dB)")
    text += [f"  step, {name:24} {ms:8.3f} ms  {aim if name == 'relaxed' else ''}" for name, ms in step.items()]
    for coverage, kernels in result["kernel_ms"].items():
        parts = "  ".join(f"{name} {ms:.3f}" for name, ms in kernels.items())
        text.append(f"  kernels, {coverage}: {parts} ms")
    text.append(f"  memory {result['memory_mb']:.0f} MB  {verdict(result['memory_mb'], case['target_mb'])}")
    return [line.rstrip() for line in text]


def show_only(number: int) -> None:
    """Leaves one GPU to this process and those that it starts, before torch looks for them: it is their number 0."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    names = visible.split(",") if visible else []
    os.environ["CUDA_VISIBLE_DEVICES"] = names[number] if number < len(names) else str(number)


def main(arguments: list[str] | None = None, opened: Callable[[], CudaEngine] = CudaEngine) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--device", type=int, help="torch's number of the GPU")
    chosen = parser.parse_args(arguments)
    if chosen.device is not None:
        show_only(chosen.device)
    try:
        engine = opened()
    except EngineError as error:
        print(f"bench_gpu: error: {error}", file=sys.stderr)
        return 1
    print(json.dumps(engine.describe()))
    results = []
    for case in CASES:
        results.append(measure(engine, case))
        print("\n".join(lines(results[-1])), flush=True)
    engine.close()
    capability = torch.cuda.get_device_capability(engine.device)
    whole = {
        "compile_s": compile_seconds(cuda_compile.architecture_for(capability)),
        "fit_s": fit_seconds("cuda"),
        "fit_without_spike_penalty_s": fit_seconds("cuda", spike_penalty=0.0),
        "command_s": command_seconds("cuda"),
        "folder_s": {jobs: command_seconds("cuda", pictures=FOLDER, jobs=jobs) for jobs in FOLDER_JOBS},
    }
    print(f"compiling one program {whole['compile_s']:.2f} s")
    print(f"standard fit {whole['fit_s']:.2f} s  {verdict(whole['fit_s'], FIT_TARGET_S, FIT_GOAL_S)}")
    print(f"  without the penalty on spikes {whole['fit_without_spike_penalty_s']:.2f} s")
    print(f"whole command {whole['command_s']:.2f} s  {verdict(whole['command_s'], COMMAND_TARGET_S)}")
    for jobs, seconds in whole["folder_s"].items():
        aim = verdict(seconds, FOLDER_TARGET_S, FOLDER_GOAL_S)
        print(f"folder of {FOLDER} pictures, --jobs {jobs}: {seconds:.1f} s  {aim}")
    if chosen.json:
        report = {"engine": engine.describe(), "results": results, "whole": whole}
        chosen.json.write_text(json.dumps(report, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
