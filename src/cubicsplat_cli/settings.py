"""The settings of a fit: what the user chooses, and the recipe (numbers found by measurement, see docs/lab/photos.md).

A field made by `setting` is also an option: its help and limits stand here alone. Imports nothing heavy.
"""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass, fields, replace
from enum import Enum
from typing import Any

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.options import (
    COMMON,
    LOSSES,
    PHOTOS,
    Kind,
    Setting,
    check_settings,
    listed,
    loss_text,
    parse_background,
    parse_loss,
    renamed,
    setting,
    settings_of,
    unknown_setting,
)

# A default that the preset or the picture replaces before the fit; so it is no part of the fields' types.
REPLACED: Any = None
USUAL_CURVES = 512  # of a photo of ordinary size
LEAST_PIXELS_PER_CURVE = 16  # with more curves, there would be more numbers than in the picture
# The kinds of closed curves to which a fit may be restricted, and their numbers of cubics; None: the preset's.
ANY = "any"
SHAPES = {"ellipse": 4, "rectangle": 4, "triangle": 3, "polygon": None}


class Mode(str, Enum):
    """Kind of a curve: a filled ring of cubics (closed), or a stroke with round ends along a chain (open)."""

    CLOSED = "closed"
    OPEN = "open"


PRECISION = Setting("count", "Decimals of the coordinates, in px.", most=6)
SCALE = Setting("count", "Times that a file is enlarged to see how it stands that.", least=1, most=12)
MAX_PIXELS = 100_000_000  # of a picture, unless more are asked for


def _by_preset(kind: Kind, text: str, **facts: Any) -> Any:
    """A setting whose usual value the preset decides."""
    return setting(REPLACED, kind, text, optional=False, **facts)


def _number(default: float, text: str, **facts: Any) -> Any:
    """A number of the recipe."""
    return setting(default, "number", text, by_set=True, metavar="NUMBER", **facts)


def _choice(text: str, *choices: str, **facts: Any) -> Any:
    """A choice of the recipe, the first by default."""
    return setting(choices[0], "choice", text, choices=choices, by_set=True, **facts)


@dataclass(frozen=True)
class Recipe:
    """Numbers of the optimisation; `--set NAME=VALUE` changes each of them.

    Sizes and the step sizes of points and half-widths are fractions of the length unit.
    """

    length_unit: str = _choice(
        "Length unit: the side of a curve's share of the picture, or half the picture's width.", "spacing", "canvas"
    )
    rate_points: float = _number(0.24, "Step size of control points, in length units.")
    rate_colours: float = _number(0.05, "Step size of colours.")
    rate_opacities: float = _number(0.05, "Step size of opacity logits.")
    rate_half_widths: float = _number(0.015, "Step size of half-widths, in length units.")
    rate_edge_widths: float = _number(0.036, "Step size of edge widths, in px; soft edges only.")
    rate_course: str = _choice("Course of the step sizes: cosine decay, or the published steps.", "cosine", "published")
    rate_end: float = _number(0.1, "Step size at the end of the cosine decay, relative to the start.")
    finish_rate: float = _number(0.4, "Step size at the start of the exact finish, relative to the start.")
    finish_rate_end: float = _number(0.1, "Step size at the end of the exact finish, relative to the start.")
    keep_mean: float = _number(0.98, "Adan: decay of the running mean of gradients.", most=0.99999)
    keep_change: float = _number(0.999, "Adan: decay of the running mean of gradient differences.", most=0.99999)
    keep_square: float = _number(0.99, "Adan: decay of the running mean of squares.", most=0.99999)
    epsilon: float = _number(1e-3, "Adan: least scale of a step.", least=1e-12)
    edge_start: float = _number(4.0, "Edge width at the start, in px.", least=0.01, most=1e4)
    edge_end: float = _number(0.8, "Edge width at the end of the annealing, in px.", least=0.01, most=1e4)
    anneal: float = _number(0.6, "Share of the relaxed phase in which the edge width shrinks.", most=1.0)
    finish_edge_width: float = _number(1.0, "Edge width of the exact finish, in px.", least=0.01, most=1e4)
    finish: float = _number(0.15, "Share of the steps that use exact coverage.", most=0.999)
    opacity_logit: float = _number(0.0, "Opacity logit of new curves.", least=-20.0, most=20.0)
    shared_opacity: float = _number(0.0, "One opacity for all curves, starting here; 0: each has its own.", most=0.999)
    opaque: bool = setting(False, "flag", "All curves are opaque.", by_set=True, hidden_option=True)
    start_size: float = _number(0.14, "Radius of the first curves, in length units.")
    prune: bool = setting(True, "flag", "Move curves of little use.", by_set=True, hidden_option=True)
    importance: str = _choice(
        "Rank of curves: by the loss without each, or by how much shows.", "loo", "visibility", hidden_option=True
    )
    prune_rule: str = _choice(
        "Share of curves to move: falls linearly to 0, or depends on the Gini coefficient.", "decay", "gini"
    )
    gini_threshold: float = _number(0.35, "Gini coefficient above which the rule `gini` moves curves.", most=1.0)
    prune_fraction: float = _number(0.6, "Largest share of curves to move at once.", most=1.0)
    reallocation_density: float = _number(0.8, "Reallocations per square root of the steps.")
    reallocate_until: float = _number(0.9, "Share of the relaxed phase in which curves move.", most=1.0)
    seeding: str = _choice("New curves: ellipses over patches of similar error, or discs at pixels.", "blobs", "discs")
    seed_size: float = _number(0.27, "Size of new curves, in length units: window of blobs, or radius of discs.")
    seed_blur: int = setting(9, "count", "Blur of the error map, in px; odd.", least=1, most=999, by_set=True)
    seed_power: float = _number(1.25, "Exponent of the error map when seeding.")
    half_width_size: float = _number(0.07, "Half-width of new strokes, in length units.")
    crossing_penalty: float = _number(0.0, "Weight of the penalty on self-crossings.", most=1e6, hidden_option=True)
    spike_penalty: float = _number(0.0, "Weight of the penalty on spikes and slivers.", most=1e6, hidden_option=True)
    flatten: str = _choice(
        "Polylines: uniform steps, or subdivision on the CPU.", "uniform", "de-casteljau", hidden_option=True
    )
    tolerance: float = _number(0.05, "Flatness of polylines, in px; 0: always `samples` edges per cubic.", most=1e4)
    edges: str = _choice("Edges: as in an SVG, or as published.", "crisp", "soft", hidden_option=True)
    soft_edge: float = _number(2.7, "Width of soft edges at the start, in px.")

    def __post_init__(self) -> None:
        check_settings(self)

    def unit(self, width: int, height: int, curves: int) -> float:
        """Return the length unit in px."""
        return 0.5 * width if self.length_unit == "canvas" else math.sqrt(width * height / curves)


_CLOSED = {"segments": 4, "samples": 12, "finish_samples": 48, "spike_penalty": 1.0}
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
# For each preset and mode: the `FitSettings`, and the values of the `Recipe` that differ from the usual ones.
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
    """Settings of a fit; the preset replaces those that are None. Raises UsageError for senseless values.

    curves: None (auto) until the size of the picture is known, see `for_size`. loss: see `options.parse_loss`. samples:
    of these edges a curve gets as many as its flatness needs. finish_samples: by default the preset's, or `samples` if
    that is more. background: "auto" (the picture's mean colour), "none" (transparent) or a colour; `fit` uses it for
    pictures without transparency, and `vectorize` lays other pictures over a colour. time_limit: seconds of a fit, or
    of everything in `vectorize`; the schedule follows the clock if the steps take longer.
    """

    curves: int = setting(
        REPLACED, "count", "Curves of a photo; most shapes of a drawing.  [default: auto]", group=COMMON, least=1,
        most=1_000_000, auto=True,
    )  # fmt: skip
    mode: Mode = setting(
        Mode.CLOSED, "choice", "Filled shapes (closed) or strokes (open).", choices=tuple(m.value for m in Mode)
    )
    preset: str = setting(
        "standard", "choice", "Effort of a photo; other options win over it.", choices=tuple(PRESETS), group=COMMON
    )
    steps: int = _by_preset("count", "Optimisation steps of a photo.", least=1, most=10_000_000)
    time_limit: float | None = setting(
        None, "number", "Time for one picture in all.", least=1e-3, most=1e7, metavar="SECONDS"
    )
    segments: int = _by_preset("count", "Cubic segments per curve.", least=1, most=16, by_set=True, hidden_option=True)
    samples: int = _by_preset(
        "count", "Most polyline edges per segment during the fit.", least=4, most=64, by_set=True, hidden_option=True
    )
    finish_samples: int = _by_preset(
        "count", "Most polyline edges per segment in the exact finish.", least=4, most=64, by_set=True
    )
    loss: str = setting(
        "l2", "text", f"What to minimise: {listed(LOSSES)}, or a mixture (l2:0.7,ms-ssim:0.3).", metavar="LOSS",
        group=PHOTOS,
    )  # fmt: skip
    fill: str = setting(
        "flat", "choice", "Fill of each curve: one colour or a gradient.", choices=("flat", "linear"), group=PHOTOS
    )
    shapes: str = setting(
        ANY, "choice", "What each curve of a photo is; any is free.", choices=(ANY, *SHAPES), group=PHOTOS
    )
    device: str = setting(
        "auto", "choice", "Where to compute; auto takes a working GPU.", choices=("auto", "cpu", "cuda")
    )
    threads: int | None = setting(None, "count", "CPU threads in all.  [default: one per core]", least=1, most=1024)
    seed: int = setting(0, "count", "Seed of all random choices.", most=2**31 - 1)
    background: str = _by_preset("text", "Colour behind all: auto, none, #rrggbb or a name.", metavar="COLOUR")
    recipe: Recipe = REPLACED

    def __post_init__(self) -> None:
        self._set("mode", _mode(self.mode))
        _setting("preset").check("preset", self.preset)
        base = PRESETS[self.preset][self.mode]
        if self.recipe is None:
            self._set("recipe", Recipe(**{name: value for name, value in base.items() if name in _RECIPE}))
        if self.finish_samples is None:
            self._set("finish_samples", max(base["finish_samples"], self.samples or 0))
        segments = SHAPES.get(self.shapes)
        if segments is not None:
            if self.segments not in (None, segments):
                raise UsageError(f"of --shapes {self.shapes} are {segments}; leave it out", "segments")
            self._set("segments", segments)
        for name in ("steps", "segments", "samples"):
            if getattr(self, name) is None:
                self._set(name, base[name])
        if str(self.curves).lower() == "auto":
            self._set("curves", REPLACED)
        self._set("loss", loss_text(parse_loss(self.loss)))
        given = self.background
        self._set("background", parse_background(base.get("background", "auto") if given is None else given))
        check_settings(self)
        if self.shapes != ANY and (self.mode is Mode.OPEN or self.fill != "flat"):
            other = "--mode open" if self.mode is Mode.OPEN else f"--fill {self.fill}"
            raise UsageError(f"are filled with one colour each; leave out {other}", "shapes")
        if self.device == "cuda" and self.recipe.flatten == "de-casteljau":
            raise UsageError("de-casteljau runs on the CPU only; use device cpu or auto, or flatten uniform", "flatten")

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    @classmethod
    def names(cls) -> set[str]:
        """Return the names of the settings that `from_preset` takes."""
        return {*cls.__dataclass_fields__, *_RECIPE}

    @classmethod
    def from_preset(cls, preset: str = "standard", mode: Mode | str = Mode.CLOSED, **overrides: Any) -> FitSettings:
        """Return settings from values of them and of the recipe; None means the preset's value."""
        given = renamed(overrides)
        for name in given:
            if name not in cls.names():
                raise unknown_setting(name, cls.names())
        numbers = {name: given.pop(name) for name in _RECIPE & given.keys()}
        settings = cls(preset=preset, mode=_mode(mode), **given)
        return settings.with_(recipe=replace(settings.recipe, **numbers)) if numbers else settings

    def for_size(self, width: int, height: int) -> FitSettings:
        """Return the settings with a number of curves, if they have none: in a small picture of width x height px one
        per 96 px, and at least 64 for the details of an icon (`LEAST_PIXELS_PER_CURVE` permitting).
        """
        if self.curves is not None:
            return self
        fewest = max(1, min(64, width * height // LEAST_PIXELS_PER_CURVE))
        return self.with_(curves=min(USUAL_CURVES, max(fewest, width * height // 96)))

    def with_(self, **changes: Any) -> FitSettings:
        """Return the settings with some changes; the preset is not applied again."""
        return replace(self, **changes)

    @property
    def background_colour(self) -> tuple[float, float, float] | None:
        """sRGB in [0, 1]; None for "auto" and "none"."""
        if not self.background.startswith("#"):
            return None
        red, green, blue = bytes.fromhex(self.background[1:])
        return red / 255.0, green / 255.0, blue / 255.0

    def public(self) -> dict[str, Any]:
        """Return plain values for the metrics file and the settings hash."""
        return asdict(self) | {"mode": self.mode.value}


_RECIPE = frozenset(each.name for each in fields(Recipe))


def _mode(mode: Mode | str) -> Mode:
    _setting("mode").check("mode", mode)
    return Mode(mode)


def _setting(name: str) -> Setting:
    return next(spec for each, spec in settings_of(FitSettings) if each.name == name)


def width_decimals(precision: int) -> int:
    """Return the decimals of stroke widths in a file, two at least: in whole pixels most strokes would be 0 or 1 px."""
    return max(precision, 2)


def cpu_count() -> int:
    """Return the number of CPU cores that the process may use: its affinity, not the machine's count."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
