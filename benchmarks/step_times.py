"""Times of training steps of a drawn picture, and how they grow with curves, pixels and samples."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cubicsplat_cli.bench.step import synthetic_picture, total_steps, wait_for_gpu
from cubicsplat_cli.photo.loop import FitLoop
from cubicsplat_cli.scene.arrays import one_torch_thread
from cubicsplat_cli.settings import FitSettings


@dataclass(frozen=True)
class Protocol:
    """What is timed: medians of `repeats` after `warmup` steps, at five points of each quantity that grows, the others
    at their usual value. Sizes are (width, height) in px.
    """

    warmup: int = 40
    repeats: int = 11
    curves: tuple[int, ...] = (128, 512, 2048, 8192, 32_768)
    sizes: tuple[tuple[int, int], ...] = ((192, 128), (384, 256), (768, 512), (1536, 1024), (3072, 2048))
    samples: tuple[int, ...] = (4, 8, 16, 32, 64)
    usual_curves: int = 512
    usual_size: tuple[int, int] = (768, 512)
    usual_samples: int = 12


@dataclass(frozen=True)
class PowerLaw:
    """How a step's time grows with one quantity: the points, and the exponent of the power law fitted to them."""

    what: str
    mode: str
    values: tuple[int, ...]
    step_ms: tuple[float, ...]
    exponent: float


def step_times(size: tuple[int, int], settings: FitSettings, protocol: Protocol) -> dict[str, float]:
    """Median milliseconds of the forward pass, the backward pass (both passes less the forward one) and a whole step.

    They are measured in a fit of the drawn picture of this size (width, height in px), the warm-up after its start.
    """
    warmup, repeats = protocol.warmup, protocol.repeats
    settings = settings.with_(steps=max(settings.steps, total_steps(warmup, 3 * repeats, settings.recipe.finish)))
    loop = FitLoop(synthetic_picture(*size), settings)
    engine, goal = loop.engine, loop.goal
    with one_torch_thread():
        for _ in range(warmup):
            loop.advance()
        raster = loop.schedule.raster(loop.schedule.phase(loop.progress))
        forward, both, whole = _median_ms(
            (
                lambda: engine.render(loop.stepper.scene, raster),
                lambda: engine.gradients(loop.stepper.scene, raster, target=goal),
                loop.advance,
            ),
            repeats,
        )
    engine.close()
    return {"forward_ms": forward, "backward_ms": max(0.0, both - forward), "step_ms": whole}


def _median_ms(calls: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Median milliseconds of each call; all are made in turn, so that other work on the machine slows all alike."""
    seconds = np.empty((repeats, len(calls)))
    for row in seconds:
        for k, call in enumerate(calls):
            started = time.perf_counter()
            call()
            wait_for_gpu()
            row[k] = time.perf_counter() - started
    return (1e3 * np.median(seconds, axis=0)).tolist()


def exponent(values: Sequence[float], times: Sequence[float]) -> float:
    """The power of `values` that fits `times` best, by least squares of logarithms."""
    return float(np.polyfit(np.log(values), np.log(times), 1)[0])


def growths(
    modes: Sequence[str], fit: Mapping[str, Any], tell: Callable[[str], None], protocol: Protocol
) -> list[PowerLaw]:
    """Growth with the curves, the pixels and S, the other two at their usual values. tell: gets a line per point."""
    found = []
    size, count, edges = protocol.usual_size, protocol.usual_curves, protocol.usual_samples
    for mode in modes:
        points = {
            "curves": [(curves, size, curves, edges) for curves in protocol.curves],
            "pixels": [(w * h, (w, h), count, edges) for w, h in protocol.sizes],
            "S": [(samples, size, count, samples) for samples in protocol.samples],
        }
        for what, rows in points.items():
            times = []
            for value, of_size, curves, samples in rows:
                # Without a tolerance every cubic has S edges, as in the paper.
                settings = FitSettings.from_preset(mode=mode, curves=curves, samples=samples, tolerance=0.0, **fit)
                times.append(step_times(of_size, settings, protocol)["step_ms"])
                tell(f"{mode}, {value} {what}: {times[-1]:.2f} ms a step")
            values = tuple(row[0] for row in rows)
            found.append(PowerLaw(what, mode, values, tuple(times), exponent(values, times)))
    return found
