"""Small charts as coordinates: a course over time, and a histogram on a logarithmic axis."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.record import record

WIDTH, HEIGHT = 320.0, 132.0
LEFT, RIGHT, TOP, BOTTOM = 40.0, 310.0, 10.0, 112.0
_BINS = 32
_LEAST_DB = 1e-5  # whatever is worth less is in the first bar


@record
class Tick:
    """A mark of an axis: where it is, and what it says."""

    at: float
    text: str


@record
class Chart:
    """A chart in units of its box, WIDTH x HEIGHT: a line as SVG path data, or bars as (x, y, width, height, text)."""

    title: str
    about: str
    unit: str
    across: list[Tick]
    up: list[Tick]
    line: str = ""
    bars: tuple[tuple[float, float, float, float, str], ...] = ()
    last: str = ""


def course(title: str, about: str, seconds: Sequence[float], values: Sequence[float], decimals: int) -> Chart:
    """Values over the seconds at which they were measured; at least two."""
    low, high = min(values), max(values)
    up = ticks(low, high, 3)
    low, high = min(low, up[0]), max(high, up[-1])
    span = high - low or 1.0
    across = ticks(0.0, seconds[-1], 4)
    last = max(seconds[-1], across[-1]) or 1.0
    points = [
        f"{LEFT + (RIGHT - LEFT) * s / last:.1f} {BOTTOM - (BOTTOM - TOP) * (v - low) / span:.1f}"
        for s, v in zip(seconds, values, strict=True)
    ]
    return Chart(
        title,
        about,
        "seconds",
        [Tick(LEFT + (RIGHT - LEFT) * s / last, f"{s:g}") for s in across],
        [Tick(BOTTOM - (BOTTOM - TOP) * (v - low) / span, f"{v:g}") for v in up],
        line="M" + "L".join(points),
        last=f"{values[-1]:.{decimals}f}",
    )


def histogram(title: str, about: str, values: Sequence[float]) -> Chart:
    """Histogram of values in dB on a logarithmic axis; values up to 0 are in the first bar."""
    clipped = np.clip(np.asarray(values, dtype=float), _LEAST_DB, None)
    first, last = math.floor(math.log10(clipped.min())), math.ceil(math.log10(clipped.max()) + 1e-9)
    last = max(last, first + 1)
    counts, edges = np.histogram(np.log10(clipped), bins=_BINS, range=(first, last))
    step, most = (RIGHT - LEFT) / _BINS, max(1, int(counts.max()))
    bars = tuple(
        (LEFT + step * i + 0.5, BOTTOM - (BOTTOM - TOP) * c / most, step - 1.0, (BOTTOM - TOP) * c / most,
         f"{c}: {10 ** edges[i]:.1g} to {10 ** edges[i + 1]:.1g} dB")
        for i, c in enumerate(counts.tolist())
        if c
    )  # fmt: skip
    decades = range(first, last + 1)
    across = [Tick(LEFT + (RIGHT - LEFT) * (d - first) / (last - first), f"{10.0**d:g}") for d in decades]
    up = [Tick(BOTTOM - (BOTTOM - TOP) * c / most, f"{c:g}") for c in ticks(0, most, 3) if c <= most and c == int(c)]
    return Chart(title, about, "dB", across, up, bars=bars)


def ticks(low: float, high: float, count: int) -> list[float]:
    """About so many round numbers from `low` to `high`; at least one."""
    span = high - low
    if not span > 0:
        return [low]
    rough = span / count
    scale = 10.0 ** math.floor(math.log10(rough))
    step = next(m * scale for m in (1, 2, 2.5, 5, 10) if m * scale >= rough * 0.999)
    first = math.ceil(low / step - 1e-9)
    return [round(i * step, 10) for i in range(first, math.floor(high / step + 1e-9) + 1)] or [low]
