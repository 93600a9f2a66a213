"""The options that several commands share; those of a fit are made from `settings.py`, where help and limits stand."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

from typer import Argument, Option

from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.cli.help import FILES
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.settings import FitSettings, Recipe, Setting, settings_of
from cubicsplat_cli.tables import csv_text

Renderer = Annotated[
    Literal["auto", "cairosvg", "resvg"],
    Option("--renderer", case_sensitive=False, help="What draws an SVG; auto is cairosvg where it works."),
]
MaxPixels = Annotated[
    int,
    Option("--max-pixels", metavar="N", help="Refuse pictures with more pixels than this.", rich_help_panel=FILES),
]
Json = Annotated[bool, Option("--json", help="Print everything as JSON.")]
Quiet = Annotated[bool, Option("--quiet", "-q", help="Print results and errors only.")]
Pictures = Annotated[
    list[str],
    Argument(
        metavar="IN...",
        help="Pictures, folders, patterns such as 'photos/*.png', or - for standard input.",
        show_default=False,
    ),
]

DRAWING_OPTIONS = tuple(field.name for field, _ in settings_of(ArtworkSettings))
_KINDS: dict[str, Any] = {"count": int, "number": float, "flag": bool, "colour": str, "text": str}


def takes_fit_options(*names: str, after: int = 2) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Gives a command, whose last parameter is `**fit`, options in place of that parameter.

    names: of the settings; all where none is named. after: how many of the command's own options the help shows first.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command)
        hints = get_type_hints(command, include_extras=True)
        own = [
            p.replace(annotation=hints[p.name]) for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD
        ]
        fit = [p for p in _fit_parameters() if not names or p.name in names]
        places = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own]
        parameters = [*places[:after], *fit, *places[after:]]
        command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        command.__annotations__ = {p.name: p.annotation for p in [*own, *fit]}
        return command

    return decorate


def fit_settings(fit: dict[str, Any], **more: Any) -> FitSettings:
    """The settings that the options ask for; None means the preset's. Raises UsageError for senseless values."""
    given = {name: value.value if isinstance(value, Enum) else value for name, value in {**fit, **more}.items()}
    return FitSettings.from_preset(**given)


def _fit_parameters() -> Iterator[inspect.Parameter]:
    """An option for each setting of a fit, in the order of the help."""
    for owner in (FitSettings, Recipe, ArtworkSettings):
        for each, known in settings_of(owner):
            default = None if owner is Recipe else each.default
            yield inspect.Parameter(
                each.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=default.value if isinstance(default, Enum) else default,
                annotation=_annotation(each.name, known, default, from_preset=default is None and not known.optional),
            )


def _annotation(name: str, known: Setting, default: Any, *, from_preset: bool) -> Any:
    """What Typer needs to know. Limits are left to `Setting.check`, whose words are those of every other error."""
    option = "--" + name.replace("_", "-")
    text = known.help + ("  [default: from the preset]" if from_preset else "")
    if known.kind == "choice":
        kind: Any = Literal[known.choices]
        extra: dict[str, Any] = {"case_sensitive": False}
    elif known.auto:
        kind, extra = str, {"metavar": known.metavar, "parser": _number_or_word}
    else:
        kind, extra = _KINDS[known.kind], {} if known.kind == "flag" else {"metavar": known.metavar}
    declared = f"{option}/--no-{option[2:]}" if known.kind == "flag" else option
    return Annotated[
        kind | None if default is None else kind, Option(declared, help=text, rich_help_panel=known.group, **extra)
    ]


def _number_or_word(text: str) -> Any:
    """A whole number as such, and anything else as it is: `Setting.check` says what is wrong with it."""
    try:
        return int(text)
    except ValueError:
        return text.lower()


def wanted_renderer(chosen: str) -> str | None:
    """The name that `rerender` takes: None for auto."""
    return None if chosen == "auto" else chosen


def check_csv(path: Path | None) -> None:
    """Raises UsageError where --csv has another suffix, InputError where it cannot be written."""
    if path is None:
        return
    if path.suffix.lower() != ".csv":
        raise UsageError(f"the table must end in .csv, but --csv is {path}")
    from cubicsplat_cli.files.write import check_writable

    check_writable(path)


def write_csv(path: Path | None, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write the rows, where a table was asked for."""
    if path is not None:
        from cubicsplat_cli.files.write import write_atomically

        write_atomically(path, csv_text(rows).encode())
