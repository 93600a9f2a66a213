"""The settings of a fit: what the user chooses, and the recipe (numbers found by measurement, see docs/quality.md)."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, fields, replace
from enum import Enum
from typing import Any

from cubicsplat_cli.errors import UsageError

MOST_CURVES = 1_000_000
MOST_STEPS = 10_000_000


class Mode(str, Enum):
    """What a primitive is: a filled ring of cubics (closed) or a round-ended stroke along a chain (open)."""

    CLOSED = "closed"
    OPEN = "open"


@dataclass(frozen=True)
class Recipe:
    """Numbers of the optimisation.

    Lengths named *_size and the rates of points and half-widths are fractions of the length unit: "spacing" is
    sqrt(width * height / curves), the side of a curve's share of the picture; "canvas" half the picture's width.
    """

    length_unit: str = "spacing"
    # step sizes
    rate_points: float = 0.24
    rate_colours: float = 0.05
    rate_opacities: float = 0.05
    rate_half_widths: float = 0.015
    rate_edge_widths: float = 0.036  # px; soft edges only
    rate_course: str = "cosine"  # or "published": a staircase
    rate_end: float = 0.1  # of the start, cosine
    finish_rate: float = 0.4
    finish_rate_end: float = 0.1
    # Adan: how much of its running means of gradient, change and square stays from step to step; floor of their scale
    keep_mean: float = 0.98
    keep_change: float = 0.999
    keep_square: float = 0.99
    epsilon: float = 1e-3
    # edges
    edge_start: float = 4.0
    edge_end: float = 0.8
    anneal: float = 0.6  # fraction of the relaxed phase
    finish_edge_width: float = 1.0
    finish: float = 0.15  # fraction of the steps with exact coverage
    edges: str = "crisp"  # or "soft": every curve learns its edge width, which no SVG can show
    soft_edge: float = 2.7  # px, at the start
    # start
    opacity_logit: float = 0.0
    opaque: bool = False
    start_size: float = 0.14  # radius
    # capacity
    prune: bool = True
    importance: str = "loo"
    prune_rule: str = "decay"  # prune_fraction falls linearly to 0; or "gini": as published, by the inequality
    gini_threshold: float = 0.35  # of the rule "gini"
    prune_fraction: float = 0.6
    reallocation_density: float = 0.8  # times the square root of the steps: how many reallocations there are
    reallocate_until: float = 0.9  # of the relaxed phase
    seeding: str = "blobs"  # ellipses over patches of like residual; or "discs" at pixels, as published
    seed_size: float = 0.27  # of blobs the standard deviation of the window, of discs the radius
    seed_blur: int = 9  # px, odd
    seed_power: float = 1.25
    half_width_size: float = 0.07  # of a new stroke
    # polyline
    flatten: str = "uniform"  # or "de-casteljau": adaptive subdivision to flatness 0.5 px
    tolerance: float = 0.05  # px; 0: always `samples` edges per cubic
    # regulariser
    geometric_reg: float = 0.0  # weight of the non-crossing penalty, in squared error per pixel

    def __post_init__(self) -> None:
        _choice("length_unit", self.length_unit, "spacing", "canvas")
        _choice("seeding", self.seeding, "blobs", "discs")
        _choice("rate_course", self.rate_course, "cosine", "published")
        _choice("edges", self.edges, "crisp", "soft")
        _choice("importance", self.importance, "loo", "visibility")
        _choice("prune_rule", self.prune_rule, "decay", "gini")
        _choice("flatten", self.flatten, "uniform", "de-casteljau")
        if not 0.0 <= self.geometric_reg < 1e6:
            raise UsageError(f"geometric-reg must be a weight between 0 and 1000000, not {self.geometric_reg}")
        if not 0.0 <= self.finish < 1.0:
            raise UsageError(f"finish must lie between 0 and 1, not {self.finish}")

    def unit(self, width: int, height: int, curves: int) -> float:
        """The length unit in px."""
        return 0.5 * width if self.length_unit == "canvas" else math.sqrt(width * height / curves)


@dataclass(frozen=True)
class FitSettings:
    """What to fit, and how long. Raises UsageError on values that make no sense.

    curves 1..1,000,000; segments per curve 1..16; samples: edges per cubic while fitting, 4..64; finish_samples: those
    of the exact finish (S*); background: "auto" (the picture's mean colour), "none" or "#rrggbb", for opaque pictures;
    time_limit: seconds, > 0, that the fit may take: its schedule runs by the clock where the steps take longer.
    """

    curves: int = 512
    mode: Mode = Mode.CLOSED
    preset: str = "standard"
    steps: int = 1500
    segments: int = 4
    samples: int = 12
    finish_samples: int = 24
    seed: int = 0
    device: str = "auto"
    threads: int | None = None
    background: str = "auto"
    time_limit: float | None = None
    recipe: Recipe = field(default_factory=Recipe)

    def __post_init__(self) -> None:
        object.__setattr__(self, "mode", _mode(self.mode))
        _between("curves", self.curves, 1, MOST_CURVES)
        _between("steps", self.steps, 1, MOST_STEPS)
        _between("segments", self.segments, 1, 16)
        _between("samples", self.samples, 4, 64)
        _between("finish_samples", self.finish_samples, 4, 64)
        if self.threads is not None:
            _between("threads", self.threads, 1, 1024)
        if self.device not in ("auto", "cpu", "cuda"):
            raise UsageError(f"device must be auto, cpu or cuda, not {self.device!r}")
        if self.device == "cuda" and self.recipe.flatten == "de-casteljau":
            raise UsageError("only the CPU has flatten de-casteljau: use device cpu or auto, or flatten uniform")
        if self.time_limit is not None and not 0.0 < self.time_limit < 1e7:
            raise UsageError(f"time-limit must be a number of seconds above 0, not {self.time_limit}")
        parse_background(self.background)

    @classmethod
    def from_preset(cls, preset: str = "standard", mode: Mode | str = Mode.CLOSED, **overrides: Any) -> FitSettings:
        """A preset with explicit values on top; a value of None means the preset's. Recipe numbers may be given too.

        Explicit samples are used exactly; otherwise they are the most that a curve's flatness may ask for.
        """
        if preset not in PRESETS:
            raise UsageError(f"unknown preset {preset!r}; choose one of {', '.join(PRESETS)}")
        mode = _mode(mode)
        chosen = {name: value for name, value in overrides.items() if value is not None}
        own = {f.name for f in fields(cls)}
        recipe_names = {f.name for f in fields(Recipe)}
        unknown = [name for name in chosen if name not in own | recipe_names]
        if unknown:
            raise UsageError(f"unknown setting {unknown[0]!r}")
        if "samples" in chosen:
            # Asked for by number: exactly so many edges per cubic, and S* = max(S, 24) as published.
            chosen = {"tolerance": 0.0, "finish_samples": max(24, chosen["samples"])} | chosen
        base = dict(PRESETS[preset][mode])
        recipe = {name: base.pop(name) for name in list(base) if name in recipe_names}
        recipe |= {name: value for name, value in chosen.items() if name in recipe_names}
        base |= {name: value for name, value in chosen.items() if name in own}
        return cls(preset=preset, mode=mode, recipe=Recipe(**recipe), **base)

    def with_(self, **changes: Any) -> FitSettings:
        return replace(self, **changes)

    def public(self) -> dict[str, Any]:
        """Plain values for the metrics file and the settings hash."""
        return asdict(self) | {"mode": self.mode.value}


def _mode(mode: Mode | str) -> Mode:
    try:
        return Mode(mode)
    except ValueError:
        raise UsageError(f"mode must be closed or open, not {mode!r}") from None


def _choice(name: str, value: str, *allowed: str) -> None:
    if value not in allowed:
        raise UsageError(f"{name} must be {' or '.join(allowed)}, not {value!r}")


def _between(name: str, value: int, least: int, most: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
        raise UsageError(f"{name} must be a whole number between {least} and {most}, not {value!r}")


def parse_background(text: str) -> tuple[float, float, float] | None:
    """ "#rrggbb" as values in [0, 1]; None for "auto" and "none"."""
    if text in ("auto", "none"):
        return None
    digits = text.removeprefix("#")
    if len(digits) == 3:
        digits = "".join(2 * d for d in digits)
    try:
        if len(digits) != 6:
            raise ValueError
        values = bytes.fromhex(digits)
    except ValueError:
        raise UsageError(f"background must be auto, none or a colour such as #ffcc00, not {text!r}") from None
    return values[0] / 255.0, values[1] / 255.0, values[2] / 255.0


_CLOSED = {"segments": 4, "finish_samples": 48}
# The outer side of a wide, tightly bent stroke needs more edges than its centre line.
_OPEN = {"segments": 3, "samples": 24, "finish_samples": 48}
# As published (CubicSplat, ECCV 2026, and its reference implementation), as far as a single engine can follow it.
_PAPER = {
    "segments": 3, "steps": 10_000, "length_unit": "canvas", "rate_points": 1e-3, "start_size": 0.01,
    "rate_colours": 0.1, "rate_opacities": 0.1, "rate_course": "published", "keep_change": 0.92, "epsilon": 1e-8,
    "edges": "soft", "finish": 0.0, "importance": "visibility", "prune_rule": "gini",
    "prune_fraction": 0.2, "reallocation_density": 0.16, "reallocate_until": 0.8, "opacity_logit": 1.0,
    "tolerance": 0.0, "seeding": "discs", "seed_size": 0.01, "seed_blur": 1, "seed_power": 1.0, "background": "#ffffff",
}  # fmt: skip
PRESETS: dict[str, dict[Mode, dict[str, Any]]] = {
    "paper": {
        Mode.CLOSED: _PAPER | {"samples": 12},
        Mode.OPEN: _PAPER | {"samples": 24, "half_width_size": 5e-3, "rate_half_widths": 8e-4},
    },
    "draft": {Mode.CLOSED: _CLOSED | {"steps": 600}, Mode.OPEN: _OPEN | {"steps": 400}},
    "standard": {Mode.CLOSED: _CLOSED | {"steps": 2500}, Mode.OPEN: _OPEN | {"steps": 2000}},
    "high": {Mode.CLOSED: _CLOSED | {"steps": 6000}, Mode.OPEN: _OPEN | {"steps": 6000}},
}
