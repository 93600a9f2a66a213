"""`cubicsplat bench step`: time and memory of one training step in the middle of a fit."""

from __future__ import annotations

import math
import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.metrics import head
from cubicsplat_cli.settings import FitSettings

if TYPE_CHECKING:
    from cubicsplat_cli.photo.loop import FitLoop

# Untimed steps of the exact finish, which bring its larger polylines and tile lists into memory.
_EXACT_WARMUP = 5
STATUS = Path("/proc/self/status")


def total_steps(warmup: int, steps: int, finish: float) -> int:
    """Return the fewest steps of a fit whose timed steps end half-way at the latest, and whose exact finish, a share
    `finish` of it, has enough steps to time.
    """
    needed = 2 * (warmup + steps)
    return max(needed, math.ceil((steps + _EXACT_WARMUP + 1) / finish)) if finish > 0 else needed


def measure_step(
    target: np.ndarray, name: str, settings: FitSettings, *, warmup: int, steps: int, baseline: Memory
) -> dict[str, Any]:
    """Return the report of `bench step` as plain values.

    target: (H, W, 3), or (H, W, 4) premultiplied, float32. name: of the picture. settings: of the fit, which gets more
    steps if it has too few to be measured in its middle. warmup, steps: untimed first steps, and timed steps, of each
    phase. baseline: memory before the target was made. Raises UsageError for a warm-up below 0 or steps below 1.
    """
    if warmup < 0 or steps < 1:
        raise UsageError(f"warmup-steps must be at least 0 and steps at least 1, not {warmup} and {steps}")
    finish = settings.recipe.finish
    settings = settings.with_(steps=max(settings.steps, total_steps(warmup, steps, finish)), time_limit=None)
    # Their memory counts as the fit's, not as the baseline's.
    from cubicsplat_cli.photo.loop import FitLoop
    from cubicsplat_cli.scene.arrays import one_torch_thread

    loop = FitLoop(target, settings)
    with one_torch_thread():
        for _ in range(warmup):
            loop.advance()
        relaxed = _time(loop, steps)
        exact = None
        if finish > 0:
            loop.step = math.ceil((1.0 - finish) * settings.steps)
            for _ in range(_EXACT_WARMUP):
                loop.advance()
            exact = _time(loop, steps)
    height, width, channels = target.shape
    return {
        **head(),
        "bench": "step",
        "picture": {"name": name, "width": width, "height": height, "channels": channels},
        "settings": loop.settings.public(),
        "device": loop.engine.describe(),
        "warmup_steps": warmup,
        "timed_steps": steps,
        "relaxed": relaxed,
        "exact": exact,
        "memory": _memory_fields(baseline, memory()),
    }


def wait_for_gpu() -> None:
    """Wait until a GPU, if one is in use, has done all of its work."""
    torch = sys.modules.get("torch")
    if torch is not None and torch.cuda.is_initialized():
        torch.cuda.synchronize()


def _time(loop: FitLoop, steps: int) -> dict[str, Any]:
    """Time the next steps of a fit."""
    phase = loop.schedule.phase(loop.progress)
    seconds: list[float] = []
    stages: list[dict[str, float]] = []
    counts: list[dict[str, int]] = []
    for _ in range(steps):
        replaced, started = loop.log.replaced, time.perf_counter()
        loop.advance()
        wait_for_gpu()
        seconds.append(time.perf_counter() - started)
        # An asynchronous engine has no timings: its steps are timed as a whole.
        engine = loop.engine.timings() or {"engine": seconds[-1]}
        # The rest of a step is Python and, in some steps, the replacement of curves.
        rest = seconds[-1] - sum(engine.values())
        changed = loop.log.replaced > replaced
        stages.append({**engine, "replacement": rest if changed else 0.0, "other": 0.0 if changed else rest})
        counts.append(loop.engine.counts())
    total = sum(seconds)
    p10, median, p90 = (1e3 * float(value) for value in np.percentile(seconds, (10, 50, 90)))
    return {
        "coverage": "exact" if phase.exact else "relaxed",
        "edge_width_px": round(phase.edge_width, 3),
        "median_ms": round(median, 3),
        "p10_ms": round(p10, 3),
        "p90_ms": round(p90, 3),
        "mean_ms": round(1e3 * total / steps, 3),
        "stages": {
            name: {"ms": round(1e3 * spent / steps, 3), "share": round(spent / total, 4)}
            for name, spent in ((name, sum(stage[name] for stage in stages)) for name in stages[0])
        },
        "pairs": {name: int(np.median([count[name] for count in counts])) for name in counts[0]},
    }


def _memory_fields(before: Memory, after: Memory) -> dict[str, float | None]:
    """Return megabytes (10^6 bytes): of the process before, now and at most, and the part of the fit."""
    bytes_of = {
        "before_mb": (before.resident, 0),
        "resident_mb": (after.resident, 0),
        "peak_mb": (after.peak, 0),
        "resident_above_mb": (after.resident, before.resident),
        "peak_above_mb": (after.peak, before.resident),
    }
    return {
        name: None if count is None or less is None else round((count - less) / 1e6, 1)
        for name, (count, less) in bytes_of.items()
    }


def step_lines(report: dict[str, Any]) -> str:
    """Return the report as a few lines for people."""
    picture, settings, device = report["picture"], report["settings"], report["device"]
    machine = ", ".join(f"{name} {value}" for name, value in device.items())
    curves = f"{settings['curves']} {settings['mode']} curves of {settings['segments']} segments"
    lines = [f"{picture['name']}, {picture['width']} x {picture['height']} px, {curves}; {machine}"]
    for name in ("relaxed", "exact"):
        figures = report[name]
        if figures is None:
            continue
        spread = f"p10 {figures['p10_ms']:.2f}  p90 {figures['p90_ms']:.2f}  edge {figures['edge_width_px']:.2f} px"
        lines.append(f"{name:8} median {figures['median_ms']:.2f} ms  {spread}")
        stages = "  ".join(f"{stage} {100 * part['share']:.1f} %" for stage, part in figures["stages"].items())
        pairs = "  ".join(f"{kind} {count}" for kind, count in figures["pairs"].items())
        lines.append(f"         {stages}")
        lines += [f"         pairs: {pairs}"] if pairs else []
    lines.append("memory   " + _memory_text(report["memory"]))
    return "\n".join(lines) + "\n"


def _memory_text(figures: dict[str, float | None]) -> str:
    if figures["peak_above_mb"] is None:
        return f"peak {figures['peak_mb']} MB in all" if figures["peak_mb"] is not None else "not known here"
    more = f"{figures['resident_above_mb']:.0f} MB more in it, {figures['peak_above_mb']:.0f} MB more at most"
    return f"{figures['before_mb']:.0f} MB before the fit, {more}"


def synthetic_picture(width: int, height: int) -> np.ndarray:
    """Return (H, W, 3) float32 in [0, 1]: a smooth gradient, sharp discs and bars, a band of fine texture."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    u, v = (x + 0.5) / width, (y + 0.5) / height
    picture = np.stack([0.35 + 0.45 * v, 0.55 - 0.25 * u * v, 0.75 - 0.5 * v + 0.1 * np.sin(5.0 * u)], axis=-1)
    random = np.random.default_rng(2026)  # another seed, or another number of shapes, would be another benchmark
    aspect = width / height
    for index in range(40):
        cx, cy, size, turn = random.uniform(0, 1, 4) * (1.0, 1.0, 0.14, 2 * np.pi)
        colour = random.uniform(0.05, 0.95, 3)
        dx, dy = (u - cx) * aspect, v - cy
        along, across = dx * np.cos(turn) + dy * np.sin(turn), dy * np.cos(turn) - dx * np.sin(turn)
        if index % 2:
            inside = along**2 + (1.7 * across) ** 2 < (0.02 + size) ** 2
        else:
            inside = (np.abs(along) < 0.03 + 2.0 * size) & (np.abs(across) < 0.006 + 0.15 * size)
        shade = 1.0 + 0.25 * along / (0.02 + size)
        picture = np.where(inside[..., None], colour * np.clip(shade, 0.6, 1.4)[..., None], picture)
    weave = np.sin(2 * np.pi * (31 * u + 7 * v)) * np.sin(2 * np.pi * (23 * v - 11 * u))
    band = np.exp(-(((v - 0.72) / 0.12) ** 2))
    picture = picture + 0.12 * (weave * band)[..., None]
    return np.clip(picture, 0.0, 1.0).astype(np.float32)


class Memory(NamedTuple):
    """Bytes of this process in physical memory: `resident` now, `peak` the most so far; None if unknown."""

    resident: int | None
    peak: int | None


def memory(status: Path = STATUS) -> Memory:
    """Return the figures of Linux's process status, or elsewhere the peak of `getrusage`; Windows has neither."""
    try:
        text = status.read_text(encoding="ascii")
    except OSError:
        return Memory(None, _peak_of_getrusage())
    sizes = {name: 1024 * int(kilobytes) for name, kilobytes in re.findall(r"^(Vm\w+):\s*(\d+) kB$", text, re.M)}
    return Memory(sizes.get("VmRSS"), sizes.get("VmHWM"))


def _peak_of_getrusage() -> int | None:
    try:
        import resource
    except ImportError:
        return None
    # Kilobytes everywhere but on macOS.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
