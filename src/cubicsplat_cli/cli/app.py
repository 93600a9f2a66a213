"""The Typer application: the list of commands and what holds for all of them."""

from __future__ import annotations

import difflib
import re
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from cubicsplat_cli._version import __version__
from cubicsplat_cli.cli.options import Command, CommandGroup, GroupedCommand
from cubicsplat_cli.files.paths import is_there
from cubicsplat_cli.formatting import did_you_mean
from cubicsplat_cli.options import listed

# What may stand in place of a command.
_OWN_OPTIONS = ("--help", "-h", "--version", "--install-completion", "--show-completion")
# Commands of `bench` that are now programs of a checkout, with the names of their modules.
_MOVED = {name: name for name in ("ablation", "artwork", "paper", "peers")} | {"thorns": "spikes"}
# The functions of the commands, in the modules of these names, and their classes; a typer of its own has none.
_FUNCTIONS = {
    "vectorize": ("vectorize", GroupedCommand), "animate": ("animate", Command), "eval": ("evaluate", Command),
    "render": ("render", Command), "doctor": ("doctor", Command), "bench": ("bench", None),
}  # fmt: skip
COMMANDS = tuple(_FUNCTIONS)
# All that the parser raises for wrong usage derives from what BadParameter derives from.
_ParserError = typer.BadParameter.__mro__[2]


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"cubicsplat {__version__}")
        raise typer.Exit


def _all_commands(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


@lru_cache
def application(*commands: str) -> typer.Typer:
    """The command line with some of its commands, of COMMANDS; each of them imports what it needs, and makes parsers
    of its options, which takes as long as a small drawing.
    """
    app = typer.Typer(
        name="cubicsplat",
        cls=CommandGroup,
        help="Turn pictures into SVGs: photos as curves that blend, drawings as few shapes. Measure any SVG.",
        add_completion=True,
        # A traceback of a bug is for a bug report: plain, complete, and without the values of local variables.
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    )
    app.callback()(_all_commands)
    for command in commands:
        name, kind = _FUNCTIONS[command]
        function = getattr(import_module(f"cubicsplat_cli.cli.{command}"), name)
        if kind is None:
            app.add_typer(function, name=command)
        else:
            app.command(command, cls=kind)(function)
    return app


def run_command(arguments: list[str]) -> int | None:
    """Run a command by its arguments, as `meant` gives them; the exit code, None where the command just ended."""
    # Only the first word can name a command; without one the help, or an error, lists them all.
    named = [arguments[0]] if arguments[0] in COMMANDS else COMMANDS
    code: int | None = application(*named)(args=arguments, prog_name="cubicsplat", standalone_mode=False)
    return code


def meant(arguments: list[str]) -> list[str]:
    """The arguments as they were meant: `help` or nothing is --help. A picture, a folder or an option of vectorize
    needs no command."""
    if not arguments:
        return ["--help"]
    first = arguments[0]
    if first == "help":
        return [*arguments[1:], "--help"]
    if arguments == ["bench"]:
        return ["bench", "--help"]
    if first in COMMANDS or first.partition("=")[0] in _OWN_OPTIONS:
        return arguments
    if first.startswith("-") or is_there(Path(first)):  # STDIO too
        return ["vectorize", *arguments]
    if difflib.get_close_matches(first, COMMANDS):
        return arguments
    return ["vectorize", *arguments] if re.search(r"[./\\*?]", first) else arguments


def parser_error(error: Exception) -> str | None:
    """The parser's complaint in our words; "" where the user gave up (Ctrl-C), None for any other exception."""
    if isinstance(error, typer.Abort):
        return ""
    if not isinstance(error, _ParserError):
        return None
    text = str(error.format_message())  # type: ignore[attr-defined]
    if match := re.match(r"Invalid value for '?([^':]+?)'?(?: / '[^']*')*(?: \([^)]*\))?: (.*)", text, re.DOTALL):
        name, reason = match[1].split(" / ")[-1].strip("'[]. "), match[2]
        return f"{name} {_reason(reason, error.__cause__)}"
    if match := re.match(r"No such command (['\"])(.*?)\1(?=\.|$)", text):
        group = error.ctx  # type: ignore[attr-defined]
        commands = [*getattr(group.command, "commands", COMMANDS)]
        if group.info_name == "bench" and match[2] in _MOVED:
            return f"bench {match[2]} is now `python -m benchmarks.{_MOVED[match[2]]}`, to be run in a checkout"
        hint = did_you_mean(match[2], commands) or f"; the commands are {', '.join(commands)}"
        return f"there is no command {match[2]!r}{hint}"
    if match := re.match(r"Missing argument '(.*?)'", text):
        return f"{match[1]} is missing; see --help"
    if match := re.match(r"No such option: (\S+)(?:.*\boptions?: (.*?)\)?$)?", text):
        hint = did_you_mean(match[1], (match[2] or "").split(", ")) or "; see --help"
        return f"there is no option {match[1]}{hint}"
    if match := re.match(r"Got unexpected extra arguments?(?:\(s\))? \((.*)\)", text):
        return f"there is nothing that {match[1]!r} could be for; see --help"
    if match := re.match(r"Option '(.*)' requires", text):
        return f"{match[1]} needs a value; see --help"
    return _lowered(text).rstrip(".")


def _reason(text: str, cause: BaseException | None) -> str:
    """The reason without the jargon of the parser and of what it checks values with, which is the cause."""
    errors = getattr(cause, "errors", None)
    given = "" if errors is None else f", not {errors()[0]['input']!r}"
    if "valid integer" in text:
        return f"must be a whole number{given}"
    if "valid number" in text or "valid float" in text:
        return f"must be a number{given}"
    if match := re.match(r"(?:Value error, )?'(.*)' is not one of (.*?)\.?$", text, re.DOTALL):
        choices = match[2].replace("'", "").split(", ")
        return f"must be {listed(choices)}, not {match[1]!r}"
    return _lowered(text).rstrip(".")


def _lowered(text: str) -> str:
    return text[:1].lower() + text[1:]
