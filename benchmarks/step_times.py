"""Times of training steps of a drawn picture, and how they grow with curves, pixels and samples."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cubicsplat_cli.bench.step import synthetic_picture, total_steps, wait_for_gpu
from cubicsplat_cli.photo.loop import FitLoop
from cubicsplat_cli.scene.arrays import one_torch_thread
from cubicsplat_cli.settings import FitSettings

WARMUP, REPEATS = 40, 11
# Five points of each quantity that grows; the others stay at the usual value.
GROWING_CURVES = (128, 512, 2048, 8192, 32_768)
GROWING_SIZES = ((192, 128), (384, 256), (768, 512), (1536, 1024), (3072, 2048))
GROWING_SAMPLES = (4, 8, 16, 32, 64)
USUAL_CURVES, USUAL_SIZE, USUAL_SAMPLES = 512, (768, 512), 12


@dataclass(frozen=True)
class StepTimes:
    """Medians in milliseconds: forward pass, backward pass (both passes less the forward one), whole training step."""

    forward_ms: float
    backward_ms: float
    step_ms: float


@dataclass(frozen=True)
class Growth:
    """How a step's time grows with one quantity: the points, and the exponent of the power law fitted to them."""

    what: str
    mode: str
    values: tuple[int, ...]
    step_ms: tuple[float, ...]
    exponent: float


def step_times(size: tuple[int, int], settings: FitSettings) -> StepTimes:
    """Times in a fit of the drawn picture of this size (width, height in px), WARMUP steps after its start."""
    settings = settings.with_(steps=max(settings.steps, total_steps(WARMUP, 3 * REPEATS, settings.recipe.finish)))
    loop = FitLoop(synthetic_picture(*size), settings)
    engine, goal = loop.engine, loop.goal
    with one_torch_thread():
        for _ in range(WARMUP):
            loop.advance()
        raster = loop.schedule.raster(loop.schedule.phase(loop.progress))
        forward = _median_ms(lambda: engine.render(loop.stepper.scene, raster))
        both = _median_ms(lambda: engine.gradients(loop.stepper.scene, raster, target=goal))
        whole = _median_ms(loop.advance)
    engine.close()
    return StepTimes(forward, max(0.0, both - forward), whole)


def _median_ms(call: Callable[[], object]) -> float:
    seconds = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        call()
        wait_for_gpu()
        seconds.append(time.perf_counter() - started)
    return 1e3 * statistics.median(seconds)


def exponent(values: Sequence[float], times: Sequence[float]) -> float:
    """The power of `values` that fits `times` best, by least squares of logarithms."""
    return float(np.polyfit(np.log(values), np.log(times), 1)[0])


def growths(modes: Sequence[str], fit: Mapping[str, Any], tell: Callable[[str], None]) -> list[Growth]:
    """Growth with the curves, the pixels and S, the other two at their usual values. tell: gets a line per point."""
    found = []
    for mode in modes:
        points = {
            "curves": [(count, USUAL_SIZE, count, USUAL_SAMPLES) for count in GROWING_CURVES],
            "pixels": [(w * h, (w, h), USUAL_CURVES, USUAL_SAMPLES) for w, h in GROWING_SIZES],
            "S": [(samples, USUAL_SIZE, USUAL_CURVES, samples) for samples in GROWING_SAMPLES],
        }
        for what, rows in points.items():
            times = []
            for value, size, curves, samples in rows:
                # Without a tolerance every cubic has S edges, as in the paper.
                settings = FitSettings.from_preset(mode=mode, curves=curves, samples=samples, tolerance=0.0, **fit)
                times.append(step_times(size, settings).step_ms)
                tell(f"{mode}, {value} {what}: {times[-1]:.2f} ms a step")
            values = tuple(row[0] for row in rows)
            found.append(Growth(what, mode, values, tuple(times), exponent(values, times)))
    return found
