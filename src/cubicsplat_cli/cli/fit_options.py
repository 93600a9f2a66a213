"""The options of a fit, for every command that fits: one line of `FitOptions` is one option.

The names are those of the fields of `fit.FitSettings` and `fit.Recipe`; None means "as the preset says".
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from enum import Enum
from typing import Annotated, Any, get_type_hints

from typer import Option

from cubicsplat_cli.cli.options import (
    MAX_CURVES,
    MAX_SAMPLES,
    MAX_SEED,
    MAX_SEGMENTS,
    MAX_STEPS,
    MAX_THREADS,
    MIN_SAMPLES,
    DeviceChoice,
    EdgesChoice,
    FlattenChoice,
    ImportanceChoice,
    ModeChoice,
    PresetChoice,
    parse_background,
)

_PRESET = "  [default: from the preset]"
_TIME = "End the fit after so many seconds; its schedule is shortened to match."
_EFFORT = "Effort of the fit; options given explicitly win over it, in any order."
_THREADS = "CPU threads in all.  [default: one per core]"
_IMPORTANCE = "A curve's use: the loss without it (loo), or what is seen of it." + _PRESET
_EDGES = "Crisp as in an SVG, or soft as published, which no SVG can show." + _PRESET


# Shared with commands that take some of the options, or take them with other defaults.
Curves = Annotated[int, Option("--curves", min=1, max=MAX_CURVES, help="Number of curves.")]
Mode = Annotated[ModeChoice, Option("--mode", help="Filled shapes (closed) or strokes (open).")]
Preset = Annotated[PresetChoice, Option("--preset", help=_EFFORT)]
Steps = Annotated[int | None, Option("--steps", min=1, max=MAX_STEPS, help="Optimisation steps." + _PRESET)]
Device = Annotated[DeviceChoice, Option("--device", help="Where to compute; auto takes a GPU that works.")]
Threads = Annotated[int | None, Option("--threads", min=1, max=MAX_THREADS, help=_THREADS)]
Seed = Annotated[int, Option("--seed", min=0, max=MAX_SEED, help="Seed of all random choices.")]


class FitOptions:
    """name: Annotated[type, Option(...)] = default; in the order of the help."""

    curves: Curves = 512
    mode: Mode = ModeChoice.closed
    preset: Preset = PresetChoice.standard
    steps: Steps = None
    time_limit: Annotated[float | None, Option("--time-limit", metavar="SECONDS", help=_TIME)] = None
    segments: Annotated[
        int | None, Option("--segments", min=1, max=MAX_SEGMENTS, help="Cubic segments of a curve." + _PRESET)
    ] = None
    samples: Annotated[
        int | None,
        Option("--samples", min=MIN_SAMPLES, max=MAX_SAMPLES, help="Edges of a segment during the fit." + _PRESET),
    ] = None
    device: Device = DeviceChoice.auto
    threads: Threads = None
    seed: Seed = 0
    background: Annotated[
        str | None,
        Option("--background", metavar="COLOUR", help="auto, none (transparent), #rrggbb or a name." + _PRESET),
    ] = None
    opaque: Annotated[bool | None, Option("--opaque/--no-opaque", help="Curves without transparency." + _PRESET)] = None
    prune: Annotated[bool | None, Option("--prune/--no-prune", help="Replace curves of little use." + _PRESET)] = None
    importance: Annotated[ImportanceChoice | None, Option("--importance", help=_IMPORTANCE)] = None
    geometric_reg: Annotated[
        float | None,
        Option("--geometric-reg", min=0, metavar="WEIGHT", help="Penalty on curves that cross themselves." + _PRESET),
    ] = None
    flatten: Annotated[FlattenChoice | None, Option("--flatten", help="How curves become polylines." + _PRESET)] = None
    edges: Annotated[EdgesChoice | None, Option("--edges", help=_EDGES)] = None


def takes_fit_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give `command`, whose last parameter is `**fit`, the options of a fit in place of that parameter."""
    signature = inspect.signature(command)
    hints = get_type_hints(command, include_extras=True)
    own = [p.replace(annotation=hints[p.name]) for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD]
    fit = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=getattr(FitOptions, name), annotation=hint)
        for name, hint in get_type_hints(FitOptions, include_extras=True).items()
    ]
    places = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own]
    command.__signature__ = signature.replace(parameters=[*places[:2], *fit, *places[2:]])
    command.__annotations__ = {p.name: p.annotation for p in [*own, *fit]}
    return command


def fit_overrides(fit: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """The preset and the settings given explicitly, as `FitSettings.from_preset` takes them.

    Raises UsageError for a background that is no colour.
    """
    given = {name: value.value if isinstance(value, Enum) else value for name, value in fit.items()}
    if given["background"] is not None:
        given["background"] = parse_background(given["background"])
    preset = given.pop("preset")
    return preset, {name: value for name, value in given.items() if value is not None}
