"""The settings of a fit: what the user chooses, and the recipe (numbers found by measurement, see docs/lab/photos.md).

A field made by `setting` is at the same time an option of the command: its help and its limits stand here alone.
Imports nothing heavy, since the command line is built from it.
"""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass, fields, replace
from enum import Enum
from typing import Any

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.options import (
    Setting,
    loss_text,
    parse_background,
    parse_loss,
    setting,
    settings_of,
    unknown_setting,
)

# The default of a field whose value the preset says, or the picture. Resolved before anybody computes with it, hence
# not in the field's type.
FROM_PRESET: Any = None
AUTO: Any = None
USUAL_CURVES = 512  # of a photo of ordinary size
PIXELS_PER_CURVE = 96  # at the least, unless more curves are asked for


class Mode(str, Enum):
    """What a primitive is: a filled ring of cubics (closed) or a round-ended stroke along a chain (open)."""

    CLOSED = "closed"
    OPEN = "open"


# Of what is no field of FitSettings.
PRECISION = Setting("count", "Decimals of the SVG's coordinates, in px.", most=6)
SCALE = Setting("count", "Times that a file is enlarged to see how it stands that.", least=1, most=12)
MAX_PIXELS = 100_000_000  # of a picture, unless more are asked for


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
    # start
    opacity_logit: float = 0.0
    shared_opacity: float = 0.0  # one for all curves, for files that say it once, and where it starts; 0: each its own
    opaque: bool = setting(False, "flag", "Make all curves opaque.", group="Photos")
    start_size: float = 0.14  # radius
    # capacity
    prune: bool = setting(True, "flag", "Move curves of little use to where the error is largest.")
    importance: str = setting(
        "loo",
        "choice",
        "How use is measured: the loss without the curve (loo), or how much of it is visible.",
        choices=("loo", "visibility"),
    )
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
    # regulariser: weight of the non-crossing penalty, in squared error per pixel
    geometric_reg: float = setting(
        0.0, "number", "Penalty on curves that cross themselves.", most=1e6, metavar="WEIGHT"
    )
    # weight of the penalties on joins that turn back, in shares of the loss a join, and on slivers: photo/geometric.py
    thorn_reg: float = setting(
        0.0, "number", "Penalty on spikes: joins that turn back, and slivers.", most=1e6, metavar="WEIGHT"
    )
    # polyline: by uniform parameters, or adaptive subdivision to flatness 0.5 px
    flatten: str = setting("uniform", "choice", "How curves become polylines.", choices=("uniform", "de-casteljau"))
    tolerance: float = 0.05  # px; 0: always `samples` edges per cubic
    # soft: every curve learns its edge width
    edges: str = setting(
        "crisp",
        "choice",
        "Edges during the fit: crisp as in an SVG, or soft as published, which no SVG can show.",
        choices=("crisp", "soft"),
    )
    soft_edge: float = 2.7  # px, at the start

    def __post_init__(self) -> None:
        for each, known in settings_of(Recipe):
            known.check(each.name, getattr(self, each.name))
        _choice("length_unit", self.length_unit, "spacing", "canvas")
        _choice("seeding", self.seeding, "blobs", "discs")
        _choice("rate_course", self.rate_course, "cosine", "published")
        _choice("prune_rule", self.prune_rule, "decay", "gini")
        if not 0.0 <= self.shared_opacity < 1.0:
            raise UsageError(f"must lie between 0 and 1, not {self.shared_opacity}", "shared_opacity")
        if not 0.0 <= self.finish < 1.0:
            raise UsageError(f"must lie between 0 and 1, not {self.finish}", "finish")

    def unit(self, width: int, height: int, curves: int) -> float:
        """The length unit in px."""
        return 0.5 * width if self.length_unit == "canvas" else math.sqrt(width * height / curves)


_CLOSED = {"segments": 4, "samples": 12, "finish_samples": 48, "thorn_reg": 1.0}
# The outer side of a wide, tightly bent stroke needs more edges than its centre line.
_OPEN = {"segments": 3, "samples": 24, "finish_samples": 48}
# As published (CubicSplat, ECCV 2026, and its reference implementation), as far as a single engine can follow it.
_PAPER = {
    "segments": 3, "steps": 10_000, "finish_samples": 24, "length_unit": "canvas", "rate_points": 1e-3,
    "start_size": 0.01, "rate_colours": 0.1, "rate_opacities": 0.1, "rate_course": "published", "keep_change": 0.92,
    "epsilon": 1e-8, "edges": "soft", "finish": 0.0, "importance": "visibility", "prune_rule": "gini",
    "prune_fraction": 0.2, "reallocation_density": 0.16, "reallocate_until": 0.8, "opacity_logit": 1.0,
    "tolerance": 0.0, "seeding": "discs", "seed_size": 0.01, "seed_blur": 1, "seed_power": 1.0, "background": "#ffffff",
}  # fmt: skip
# Of each preset by mode: what it says of `FitSettings`, and where its `Recipe` differs from the usual one.
PRESETS: dict[str, dict[Mode, dict[str, Any]]] = {
    "draft": {Mode.CLOSED: _CLOSED | {"steps": 600}, Mode.OPEN: _OPEN | {"steps": 400}},
    "standard": {Mode.CLOSED: _CLOSED | {"steps": 2300}, Mode.OPEN: _OPEN | {"steps": 2000}},
    "high": {Mode.CLOSED: _CLOSED | {"segments": 5, "steps": 6000}, Mode.OPEN: _OPEN | {"steps": 6000}},
    "paper": {
        Mode.CLOSED: _PAPER | {"samples": 12},
        Mode.OPEN: _PAPER | {"samples": 24, "half_width_size": 5e-3, "rate_half_widths": 8e-4},
    },
}


@dataclass(frozen=True)
class FitSettings:
    """What to fit, and how long; what is not given is as the preset says. Raises UsageError on senseless values.

    curves: None (auto) until the picture is known, see `for_size`.
    loss: see `losses.parse_loss`. samples: the most edges per cubic while fitting, of which a curve gets as many as its
    flatness needs;
    finish_samples: those of the exact finish (S*), the preset's or `samples` where that is more. background: "auto"
    (the picture's mean colour), "none" (transparent) or a colour; `fit` uses it for pictures without transparency,
    `vectorize` lays others over a colour. time_limit:
    seconds that a fit may take, and with `vectorize` all of it: the schedule runs by the clock where the steps take
    longer. recipe: the preset's.
    """

    curves: int = setting(
        AUTO,
        "count",
        "Number of curves of a photo; of a drawing, the most shapes.  [default: auto]",
        least=1,
        most=1_000_000,
        optional=True,
        auto=True,
        group="Most used",
    )
    mode: Mode = setting(
        Mode.CLOSED,
        "choice",
        "Filled shapes (closed) or strokes (open).",
        choices=tuple(m.value for m in Mode),
        group="Photos and drawings",
    )
    preset: str = setting(
        "standard",
        "choice",
        "Effort spent on a photo; options given explicitly take precedence, in any order.",
        choices=tuple(PRESETS),
        group="Most used",
    )
    steps: int = setting(FROM_PRESET, "count", "Optimisation steps.", least=1, most=10_000_000, group="Photos")
    time_limit: float | None = setting(
        None,
        "number",
        "Seconds that a picture may take in all; the fit is shortened to match.",
        least=1e-3,
        most=1e7,
        metavar="SECONDS",
        optional=True,
        group="Photos and drawings",
    )
    segments: int = setting(FROM_PRESET, "count", "Cubic segments per curve.", least=1, most=16)
    samples: int = setting(FROM_PRESET, "count", "Most straight edges per segment during the fit.", least=4, most=64)
    finish_samples: int = FROM_PRESET
    loss: str = setting(
        "l2",
        "text",
        "What to minimise: l2, l1, huber, ms-ssim, or a mixture such as l2:0.7,ms-ssim:0.3.",
        metavar="LOSS",
        group="Photos",
    )
    fill: str = setting(
        "flat",
        "choice",
        "Fill of each curve: one colour (flat), or a gradient between two (linear).",
        choices=("flat", "linear"),
        group="Photos",
    )
    device: str = setting(
        "auto",
        "choice",
        "Where to compute; auto takes a GPU that works.",
        choices=("auto", "cpu", "cuda"),
        group="Photos",
    )
    threads: int | None = setting(
        None,
        "count",
        "CPU threads in all.  [default: one per core]",
        least=1,
        most=1024,
        optional=True,
        group="Photos and drawings",
    )
    seed: int = setting(0, "count", "Seed of all random choices.", most=2**31 - 1, group="Photos")
    background: str = setting(
        FROM_PRESET,
        "colour",
        "Colour behind everything: auto, none (transparent), #rrggbb or a name.",
        metavar="COLOUR",
        group="Photos and drawings",
    )
    recipe: Recipe = FROM_PRESET

    def __post_init__(self) -> None:
        self._set("mode", _mode(self.mode))
        _choice("preset", self.preset, *PRESETS)
        base = PRESETS[self.preset][self.mode]
        if self.recipe is None:
            self._set("recipe", Recipe(**{name: value for name, value in base.items() if name in _RECIPE}))
        if self.finish_samples is None:
            self._set("finish_samples", max(base["finish_samples"], self.samples or 0))
        for name in ("steps", "segments", "samples"):
            if getattr(self, name) is None:
                self._set(name, base[name])
        if str(self.curves).lower() == "auto":
            self._set("curves", AUTO)
        self._set("loss", loss_text(parse_loss(self.loss)))
        given = self.background
        self._set("background", parse_background(base.get("background", "auto") if given is None else given))
        for each, known in settings_of(FitSettings):
            if each.name != "mode":
                known.check(each.name, getattr(self, each.name))
        Setting("count", "", least=4, most=64).check("finish_samples", self.finish_samples)
        if self.device == "cuda" and self.recipe.flatten == "de-casteljau":
            raise UsageError("de-casteljau runs on the CPU only; use device cpu or auto, or flatten uniform", "flatten")

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    @classmethod
    def names(cls) -> set[str]:
        """Of the settings that `from_preset` takes."""
        return {*cls.__dataclass_fields__, *_RECIPE}

    @classmethod
    def from_preset(cls, preset: str = "standard", mode: Mode | str = Mode.CLOSED, **overrides: Any) -> FitSettings:
        """Settings with numbers of the recipe among them; a value of None means the preset's."""
        given = {name: value for name, value in overrides.items() if value is not None}
        for name in given:
            if name not in cls.names():
                raise unknown_setting(name, cls.names())
        settings = cls(preset=preset, mode=_mode(mode), **{n: v for n, v in given.items() if n not in _RECIPE})
        numbers = {name: value for name, value in given.items() if name in _RECIPE}
        return settings.with_(recipe=replace(settings.recipe, **numbers)) if numbers else settings

    def for_size(self, width: int, height: int) -> FitSettings:
        """The settings for a picture of width x height px: a small one gets no more curves than it has use for."""
        if self.curves is not None:
            return self
        return self.with_(curves=max(1, min(USUAL_CURVES, width * height // PIXELS_PER_CURVE)))

    def with_(self, **changes: Any) -> FitSettings:
        """The same settings but for some; the preset is not asked again."""
        return replace(self, **changes)

    @property
    def background_colour(self) -> tuple[float, float, float] | None:
        """sRGB in [0, 1]; None for "auto" and "none"."""
        if not self.background.startswith("#"):
            return None
        red, green, blue = bytes.fromhex(self.background[1:])
        return red / 255.0, green / 255.0, blue / 255.0

    def public(self) -> dict[str, Any]:
        """Plain values for the metrics file and the settings hash."""
        return asdict(self) | {"mode": self.mode.value}


_RECIPE = frozenset(each.name for each in fields(Recipe))


def _mode(mode: Mode | str) -> Mode:
    try:
        return Mode(mode)
    except ValueError:
        _choice("mode", mode, *(each.value for each in Mode))
        raise


def _choice(name: str, value: str, *allowed: str) -> None:
    Setting("choice", "", choices=allowed).check(name, value)


def with_segments(fit: dict[str, Any], max_bytes: object) -> dict[str, Any]:
    """The settings of a fit with the segments that give most for a byte, where bytes are the budget and none are given.

    Measured at equal bytes (docs/lab/photos.md): closed curves of 2 segments have some 0.2 dB more than of 4.
    """
    closed = str(getattr(fit.get("mode"), "value", fit.get("mode") or "closed")) == "closed"
    return fit if max_bytes is None or fit.get("segments") is not None or not closed else {**fit, "segments": 2}


def cpu_count() -> int:
    """The CPU cores that the process may use: its affinity, not the machine's count."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
