"""The command that makes a file again, from the settings that its metrics hold."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from typing import Any

from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.metrics import Report
from cubicsplat_cli.options import Setting, renamed, settings_of
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings, Recipe

# Neither decides what comes out.
_OF_THE_MACHINE = ("device", "threads")


def command(report: Report) -> str:
    """`cubicsplat vectorize ...` with every option that is not what it would be without being given."""
    parts = ["cubicsplat", "vectorize", report.input.path]
    parts += [] if report.output.svg is None else ["-o", report.output.svg]
    for name, known, value in _differing(report.settings):
        parts += _option(name, known, value)
    return shlex.join(parts)


def _differing(settings: Mapping[str, Any]) -> Iterator[tuple[str, Setting, Any]]:
    usual = FitSettings.from_preset(settings.get("preset", "standard"), settings.get("mode", "closed"))
    recipe, artwork = settings.get("recipe") or {}, settings.get("artwork") or {}
    held: tuple[tuple[type, Mapping[str, Any], Any], ...] = (
        (Request, settings, Request()),
        (FitSettings, settings, usual),
        (Recipe, renamed(recipe), usual.recipe),
        (ArtworkSettings, artwork, ArtworkSettings()),
    )
    for owner, given, default in held:
        for field, known in settings_of(owner):
            name = field.name
            # What preset and mode are by default must not depend on the preset and mode that were given.
            before = getattr(FitSettings() if name in ("preset", "mode") else default, name)
            value = given.get(name)
            if known.decides and name not in _OF_THE_MACHINE and value not in (None, []) and value != before:
                yield name, known, value


def _option(name: str, known: Setting, value: Any) -> list[str]:
    option = f"--{(known.option or name).replace('_', '-')}"
    if known.by_set:
        return ["--set", f"{name}={str(value).lower() if isinstance(value, bool) else value}"]
    if known.only_off or value is False:
        return [f"--no-{option[2:]}"]
    if value is True:
        return [option]
    if isinstance(value, list):
        return [option, ",".join(f"{each:.12g}" if isinstance(each, float) else str(each) for each in value)]
    return [option, value["name"] if isinstance(value, dict) else str(value)]
