"""Options made from the tables of settings (`settings.py`, `request.py`, `artwork/settings.py`); the help's layout."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import Field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_type_hints

from typer import Argument, Exit, Option, echo
from typer.core import TyperCommand, TyperGroup

from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.write import check_writable, write_atomically
from cubicsplat_cli.formatting import csv_text, did_you_mean
from cubicsplat_cli.options import COMMON, FILES, GROUPS, RENAMED, Setting, settings_of
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings, Recipe

# Of every application. Tracebacks are for bug reports: plain, complete, and without the values of local variables.
TYPER: dict[str, Any] = {
    "pretty_exceptions_enable": False, "rich_markup_mode": None,
    "context_settings": {"help_option_names": ["-h", "--help"], "max_content_width": 100},
}  # fmt: skip


def option(names: str, text: str, group: str | None = None, **facts: Any) -> Any:
    """Return an option for Typer. names: such as `--output -o OUT`, OUT being its value. text, group: of the help."""
    flags = [word for word in names.split() if word.startswith("-")]
    values = [word for word in names.split() if not word.startswith("-")]
    return Option(*flags, metavar="".join(values) or None, help=text, rich_help_panel=group, **facts)


def argument(metavar: str, text: str) -> Any:
    """Return an argument for Typer, the text being its help."""
    return Argument(metavar=metavar, help=text, show_default=False)


Renderer = Annotated[
    Literal["auto", "cairosvg", "resvg"],
    option("--renderer", "What draws an SVG; auto is cairosvg where it works.", case_sensitive=False),
]
MaxPixels = Annotated[int, option("--max-pixels N", "Refuse larger pictures.")]
Json = Annotated[bool, option("--json", "Print everything as JSON.")]
Quiet = Annotated[bool, option("--quiet -q", "Print results and errors only.", FILES)]
Verbose = Annotated[bool, option("--verbose -v", "Print settings and plain progress too.", FILES)]

_PRESENT = {  # the present names of options by their earlier names
    f"--{earlier}".replace("_", "-"): f"--{name}".replace("_", "-")
    for earlier, name in {"measures": "metrics", "no_completion": "completion=off", **RENAMED}.items()
}
_KINDS: dict[str, Any] = {"count": int, "number": float, "flag": bool, "text": str}
_READ: dict[Any, Callable[[Any], Any]] = {list[str]: list} | {
    each: kind for kind in (str, int, float) for each in (kind, kind | None)
}
_OWNERS = (FitSettings, Request, Recipe, ArtworkSettings)


def takes_options(
    *names: str, after: int = 2, owners: tuple[type[Any], ...] = _OWNERS
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Replace the last parameter of a command, `**options`, by options made from settings.

    names: of settings of the owners; all by default. after: so many of the command's own parameters come before.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command)
        hints = get_type_hints(command, include_extras=True)
        own = [
            p.replace(annotation=hints[p.name], kind=p.KEYWORD_ONLY)
            for p in signature.parameters.values()
            if p.kind is not p.VAR_KEYWORD
        ]
        made = [p for p in _parameters(owners) if not names or p.name in names]
        parameters = [*own[:after], *made, *own[after:]]
        command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        command.__annotations__ = {p.name: p.annotation for p in [*own, *made]}
        return command

    return decorate


def print_names(overrides: list[str]) -> list[str]:
    """Return the values of --set; for `--set help` print all names, defaults and meanings, and end the command."""
    if "help" not in overrides:
        return overrides
    fit = FitSettings()
    owners: dict[Any, Any] = {FitSettings: fit, Recipe: fit.recipe, ArtworkSettings: ArtworkSettings()}
    for owner, each, spec in _settings(tuple(owners)):
        if spec.by_set:
            name, default = each.name.replace("_", "-"), str(getattr(owners[owner], each.name))
            echo(f"{name:<21}{default:>10}  {spec.help}  [{spec.values()}]")
    raise Exit


def override(text: str) -> tuple[str, Any]:
    """Return name and value of `NAME=VALUE`, of --set. Raises UsageError for a senseless one."""
    said, equals, value = text.partition("=")
    if not equals:
        raise UsageError(f"--set takes NAME=VALUE, such as importance=visibility, not {text!r}")
    name = said.strip().replace("-", "_")
    name = RENAMED.get(name, name)
    settings = {each.name: spec for _, each, spec in _settings() if spec.by_set}
    if name not in settings:
        raise UsageError(f"--set knows no {said.strip()!r}{did_you_mean(name, settings)}; --set help lists the names")
    return name, settings[name].read(f"set {name}", value)


def _settings(owners: tuple[type[Any], ...] = _OWNERS) -> Iterator[tuple[type[Any], Field[Any], Setting]]:
    for owner in owners:
        for each, spec in settings_of(owner):
            yield owner, each, spec


def _parameters(owners: tuple[type[Any], ...]) -> Iterator[inspect.Parameter]:
    """Yield the options of all settings, in the order of the help."""
    for owner, each, spec in _settings(owners):
        if spec.by_set and not spec.hidden_option:
            continue
        # The preset decides the defaults of its recipe.
        default = None if owner is Recipe or each.default == () else getattr(each.default, "value", each.default)
        from_preset = owner is FitSettings and default is None and not spec.optional
        text = spec.help + ("  [default: from the preset]" if from_preset else "")
        annotation = _annotation(each.name, spec, default, text)
        yield inspect.Parameter(each.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _annotation(name: str, spec: Setting, default: Any, text: str) -> Any:
    """Return the annotation for Typer. `Setting.check` checks limits, so that all errors have the same form."""
    facts: dict[str, Any] = {"show_default": default is not True and default != ""}
    kind: Any = object if spec.auto else str if spec.parse is not None else _KINDS.get(spec.kind)
    if spec.kind == "choice":
        kind = Literal[spec.choices]
        facts["case_sensitive"] = False
    if spec.auto:
        facts["parser"] = _number_or_word
    names = spec.option if spec.option.startswith(" ") else "--" + (spec.option or name).replace("_", "-")
    if spec.kind == "flag" and default is not False and "/" not in names:
        names += f"/--no-{names[2:]}"
    if spec.kind not in ("choice", "flag"):
        facts["metavar"] = spec.metavar
    made = Option(names, help=text, rich_help_panel=spec.group, hidden=spec.hidden or spec.by_set, **facts)
    return Annotated[kind | None if default is None else kind, made]


def _number_or_word(text: str) -> Any:
    """Return a whole number, or any other text in lower case for `Setting.check`."""
    try:
        return int(text)
    except ValueError:
        return text.lower()


def _value(parameter: Any, convert: Callable[[Any, Any], Any], kind: Any, context: Any, given: Any) -> Any:
    """Return the value of a parameter of a type from the command line or its default. convert: the way of Typer."""
    if given is None or given == parameter.default:
        return convert(context, given) if parameter.required else given
    try:
        chosen = given in get_args(kind)
        value = given if chosen else _READ[kind](given) if given else convert(context, given)
    except (KeyError, ValueError):
        return convert(context, given)
    return value if parameter.callback is None else parameter.callback(context, parameter, value)


def check_csv(path: Path | None) -> None:
    """Raise UsageError if --csv has another suffix, InputError if it cannot be written."""
    if path is None:
        return
    if path.suffix.lower() != ".csv":
        raise UsageError(f"the table must end in .csv, but --csv is {path}")
    check_writable(path)


def write_csv(path: Path | None, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write the rows if the user asked for a table."""
    if path is not None:
        write_atomically(path, csv_text(rows).encode())


class _AsGiven:
    """Reads values of simple types without pydantic, whose import by Typer takes as long as all of our imports."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, with --help."""
        parameters: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        kinds = get_type_hints(self.callback) if self.callback else {}  # type: ignore[attr-defined]
        for each in parameters:
            if not isinstance(each.process_value, partial):
                each.process_value = partial(_value, each, each.process_value, kinds.get(each.name))
        return parameters


class CommandGroup(_AsGiven, TyperGroup):
    """A group of commands."""


class Command(_AsGiven, TyperCommand):
    """A command with help in plain text, which accepts the options of earlier versions."""

    grouped = False

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments, with earlier names of options replaced by the present ones."""
        end = args.index("--") if "--" in args else len(args)
        parts = [argument.partition("=") for argument in args[:end]]
        present = [_PRESENT.get(name, name) + equals + value for name, equals, value in parts]
        return super().parse_args(ctx, [*present, *args[end:]])

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return `[OPTIONS] IN...`."""
        arguments = [str(p.metavar) for p in self.get_params(ctx) if p.param_type_name == "argument"]
        return [self.options_metavar or "", *arguments]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the meanings of the parameters."""
        names = GROUPS if self.grouped else ("Options",)
        groups: dict[str, list[tuple[str, str]]] = {name: [] for name in ("Arguments", *names)}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is None:
                continue
            shown, text = record
            if parameter.param_type_name == "argument":
                groups["Arguments"].append((str(parameter.metavar), text.replace("  [required]", "")))
            else:
                name = (getattr(parameter, "rich_help_panel", None) or COMMON) if self.grouped else "Options"
                # The parser puts choices into brackets.
                groups[name].append((re.sub(r"[<\[]([^<\[]*\|[^>\]]*)[>\]]$", r"\1", shown), text))
        for name, rows in groups.items():
            if rows:
                with formatter.section(name):
                    formatter.write_dl(rows, col_max=min(30, formatter.width // 3))


class GroupedCommand(Command):
    """A command of many options, in groups."""

    grouped = True
