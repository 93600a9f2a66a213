"""The help of a command: its options in groups, the most used first, with the names that people have for values."""

from __future__ import annotations

import re
from typing import Any

from typer.core import TyperCommand

from cubicsplat_cli.request import ARTWORK_OPTIONS, PHOTO_OPTIONS

# The groups of options, in the order of the help; an option says its own by `rich_help_panel`, `Setting.group`.
COMMON, BOTH, PHOTOS, DRAWINGS, FILES = "Most used", "Photos and drawings", "Photos", "Drawings", "Files"
_GROUPS = (COMMON, BOTH, PHOTOS, DRAWINGS, FILES, "Experts")
_IMPLIED = dict.fromkeys(PHOTO_OPTIONS, "photo") | dict.fromkeys(ARTWORK_OPTIONS, "artwork")


class Command(TyperCommand):
    """A command whose help is plain text."""

    grouped = False

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """`[OPTIONS] IN...`."""
        arguments = [str(p.metavar) for p in self.get_params(ctx) if p.param_type_name == "argument"]
        return [self.options_metavar or "", *arguments]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write what the parameters mean."""
        groups: dict[str, list[tuple[str, str]]] = {"Arguments": []}
        for name in _GROUPS if self.grouped else ("Options",):
            groups[name] = []
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is None:
                continue
            shown, text = record
            if self.grouped and parameter.name in _IMPLIED:
                text += f"  [implies --style {_IMPLIED[parameter.name]}]"
            if parameter.param_type_name == "argument":
                groups["Arguments"].append((str(parameter.metavar), text.replace("  [required]", "")))
            else:
                name = (getattr(parameter, "rich_help_panel", None) or COMMON) if self.grouped else "Options"
                # The parser shows choices in brackets of its own.
                groups[name].append((re.sub(r"[<\[]([^<\[]*\|[^>\]]*)[>\]]$", r"\1", shown), text))
        for name, rows in groups.items():
            if rows:
                with formatter.section(name):
                    formatter.write_dl(rows, col_max=min(30, formatter.width // 3))


class GroupedCommand(Command):
    """A command of many options, which come in groups."""

    grouped = True
