"""The command that makes a file again, from the settings that its report holds."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from typing import Any

from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.metrics import Report
from cubicsplat_cli.options import settings_of
from cubicsplat_cli.settings import FitSettings, Recipe

# Neither decides what comes out.
_OF_THE_MACHINE = ("device", "threads")


def command(report: Report) -> str:
    """`cubicsplat vectorize ...` with every option that is not what it would be without being given."""
    settings, output = report.settings, report.output.svg
    parts = ["cubicsplat", "vectorize", report.input.path]
    parts += [] if output is None else ["-o", output]
    parts += [] if settings.get("style", "auto") == "auto" else ["--style", settings["style"]]
    for name, value in _differing(settings):
        parts += _option(name, value)
    for name in ("precision", "max_size", "frame", "max_bytes", "target_psnr"):
        parts += [] if settings.get(name) is None else _option(name, settings[name])
    for name in ("weights", "init"):
        parts += _option(name, settings[name]["name"]) if settings.get(name) else []
    parts += ["--freeze"] if settings.get("freeze") else []
    if settings.get("focus"):
        parts += _option("focus", ",".join(f"{value:.12g}" for value in settings["focus"]))
    return shlex.join(parts)


def unsaid(report: Report) -> list[str]:
    """Numbers of the recipe that differ from the preset's and have no option: such a fit is repeated from Python."""
    usual = _usual(report.settings)
    named = {field.name for field, _ in settings_of(Recipe)}
    recipe = report.settings.get("recipe") or {}
    return [name for name, value in recipe.items() if name not in named and value != getattr(usual.recipe, name, value)]


def _differing(settings: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    usual = _usual(settings)
    recipe, artwork = settings.get("recipe") or {}, settings.get("artwork") or {}
    held = (
        (FitSettings, settings, usual),
        (Recipe, recipe, usual.recipe),
        (ArtworkSettings, artwork, ArtworkSettings()),
    )
    for owner, given, default in held:
        for field, _ in settings_of(owner):
            name = field.name
            # What preset and mode are by default must not depend on the preset and mode that were given.
            before = getattr(FitSettings() if name in ("preset", "mode") else default, name)
            if name not in _OF_THE_MACHINE and given.get(name) is not None and given[name] != before:
                yield name, given[name]
    if artwork.get("palette"):
        yield "palette", ",".join(artwork["palette"])


def _usual(settings: Mapping[str, Any]) -> FitSettings:
    """What the preset and mode say."""
    return FitSettings.from_preset(settings.get("preset", "standard"), settings.get("mode", "closed"))


def _option(name: str, value: Any) -> list[str]:
    option = name.replace("_", "-")
    if isinstance(value, bool):
        return [f"--{option}" if value else f"--no-{option}"]
    return [f"--{option}", str(value)]
