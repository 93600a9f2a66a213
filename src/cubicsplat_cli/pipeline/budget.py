"""As many curves as fit into so many bytes, or as few as give so many decibels: found by growing or shrinking one fit.

A first, shorter fit tells what a curve costs and gives; a second begins with it, with the number of curves that follows
and a few more; then curves go, those of the least use for their bytes first, until the budget is met.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import torch

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.settings import USUAL_CURVES, FitSettings

if TYPE_CHECKING:
    from cubicsplat_cli.photo import FitResult
    from cubicsplat_cli.scene import Scene

FIRST_SHARE, SECOND_SHARE = 0.4, 1.2  # of the steps asked for
SPARE, SPARE_COMPRESSED = 1.03, 1.08  # times the curves that should be enough, so that some may go
GUESSED_BYTES = (40, 30)  # of a curve at one decimal, and of each segment
# Measured: kodim08 and 23 gain 1.0 and 1.7 dB from twice the curves.
DB_PER_DOUBLING = 1.4
EXPECTED_GAIN = 0.4  # dB, of the second fit with the same curves
MOST_GROWTH = 8.0
TOLERANCE = 0.2  # dB
PRECISIONS = (2, 1, 0)


@dataclass(frozen=True)
class Means:
    """How things are done: fit(settings, start), size(scene, precision) in bytes, level(scene, precision) in dB, and
    worth(scene), (N,): by how much the loss would rise without each curve.
    """

    fit: Callable[[FitSettings, Scene | None], FitResult]
    size: Callable[[Scene, int], int]
    level: Callable[[Scene, int], float]
    worth: Callable[[Scene], torch.Tensor]


@dataclass(frozen=True)
class Within:
    """A fit that keeps to a budget, the decimals that suit it, and what the user should know."""

    fitted: FitResult
    precision: int
    notes: list[str]


def within_bytes(most: int, settings: FitSettings, precision: int | None, means: Means, spare: float = SPARE) -> Within:
    """The best picture in at most so many bytes. precision: decimals, or None for those that pay; spare:
    times the curves that should be enough, which the second fit gets.

    Raises InputError where not even one curve fits.
    """
    guess = max(1, min(1_000_000, most // (GUESSED_BYTES[0] + GUESSED_BYTES[1] * settings.segments)))
    first = means.fit(_shared(settings, FIRST_SHARE, guess), None)
    chosen = _paying_precision(first.scene, means) if precision is None else precision
    head, size = means.size(_only(first.scene, 1), chosen), means.size(first.scene, chosen)
    if head > most:
        raise InputError(f"not even one curve fits into {most} bytes; allow at least {head}")
    each = max(1.0, (size - head) / max(1, first.scene.curves - 1))
    wanted = max(1, math.ceil(spare * (1 + (most - head) / each)))
    fitted = first if first.interrupted else _joined(first, means.fit(_rest(settings, first, wanted), first.scene))
    order = _by_use(fitted.scene, means, chosen)
    count = _most(fitted.scene.curves, lambda n: means.size(_kept(fitted.scene, order, n), chosen) <= most)
    if count == 0:
        raise InputError(f"not even one curve fits into {most} bytes; allow at least {head}")
    return Within(_trimmed(fitted, order, count), chosen, [])


def within_level(least: float, settings: FitSettings, precision: int, means: Means) -> Within:
    """The fewest curves whose file has so many dB; where that cannot be reached, the note says what was."""
    base = max(1, settings.curves or USUAL_CURVES)
    fitted = means.fit(_shared(settings, FIRST_SHARE, base), None)
    gain, slope, before = EXPECTED_GAIN, DB_PER_DOUBLING, (0.0, -math.inf)
    level = means.level(fitted.scene, precision)
    for _ in range(2):
        if fitted.interrupted or (level >= least and before[0]):
            break
        here = (math.log2(fitted.scene.curves), level)
        if before[0] and here[0] > before[0] + 0.2:
            slope, gain = max(0.5, (here[1] - before[1]) / (here[0] - before[0])), 0.0
        growth = min(math.log2(MOST_GROWTH), (least - level - gain) / slope)
        wanted = max(1, min(1_000_000, math.ceil(SPARE * fitted.scene.curves * 2.0**growth)))
        fitted = _joined(fitted, means.fit(_rest(settings, fitted, wanted), fitted.scene))
        before, level = here, means.level(fitted.scene, precision)
    if level < least:
        return Within(fitted, precision, [f"reached {level:.2f} dB of the {least:g} dB asked for; allow more --steps"])
    order = _by_use(fitted.scene, means, precision)
    total = fitted.scene.curves
    spare = _most(total, lambda n: n < total and means.level(_kept(fitted.scene, order, total - n), precision) >= least)
    return Within(_trimmed(fitted, order, total - spare), precision, [])


def _paying_precision(scene: Scene, means: Means) -> int:
    """The decimals that leave most dB when what they save in bytes goes into more curves."""
    facts = [(means.level(scene, p) - DB_PER_DOUBLING * math.log2(means.size(scene, p)), p) for p in PRECISIONS]
    return max(facts)[1]


def _shared(settings: FitSettings, share: float, curves: int) -> FitSettings:
    seconds = None if settings.time_limit is None else settings.time_limit * share / (FIRST_SHARE + SECOND_SHARE)
    return settings.with_(steps=max(1, round(share * settings.steps)), curves=curves, time_limit=seconds)


def _rest(settings: FitSettings, first: FitResult, curves: int) -> FitSettings:
    """Settings of a fit that goes on with a first one, whose result says the mode and segments."""
    return _shared(settings, SECOND_SHARE, curves).with_(seed=settings.seed + 1 if settings.seed < 2**31 - 1 else 0)


def _by_use(scene: Scene, means: Means, precision: int) -> torch.Tensor:
    """The curves' numbers, those of most use for a byte first."""
    from cubicsplat_cli.svg.sizes import bytes_by_curve

    worth = means.worth(scene).double()
    return (worth / torch.tensor(bytes_by_curve(scene, precision), dtype=torch.float64)).argsort(descending=True)


def _only(scene: Scene, count: int) -> Scene:
    return _kept(scene, torch.arange(scene.curves), count)


def _kept(scene: Scene, order: torch.Tensor, count: int) -> Scene:
    """The first `count` curves of an order, in the scene's own."""
    return scene.chosen(order[:count].sort().values)


def _most(limit: int, holds: Callable[[int], bool]) -> int:
    """The largest number up to a limit for which something holds that holds for all smaller ones; 0 if for none."""
    low, high = 0, limit
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if holds(middle) else (low, middle - 1)
    return low


def _trimmed(fitted: FitResult, order: torch.Tensor, count: int) -> FitResult:
    gone = fitted.scene.curves - count
    return replace(fitted, scene=_kept(fitted.scene, order, count), dropped=fitted.dropped + gone)


def _joined(first: FitResult, second: FitResult) -> FitResult:
    """Two fits as one."""
    steps, seconds = first.steps + second.steps, first.fit_s + second.fit_s
    later = [
        {**entry, "step": entry["step"] + first.steps, "seconds": round(entry["seconds"] + first.fit_s, 3)}
        for entry in second.history
    ]
    return replace(
        second, steps=steps, fit_s=seconds, ms_per_step=1e3 * seconds / max(1, steps), history=[*first.history, *later],
        replaced=first.replaced + second.replaced, notes=list(dict.fromkeys([*first.notes, *second.notes])),
    )  # fmt: skip
