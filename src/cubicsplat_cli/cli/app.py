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
from cubicsplat_cli.cli.options import TYPER, Command, CommandGroup, GroupedCommand
from cubicsplat_cli.files.paths import is_there
from cubicsplat_cli.formatting import did_you_mean
from cubicsplat_cli.options import listed

_OWN_OPTIONS = ("--help", "-h", "--version", "--install-completion", "--show-completion")
# Commands of `bench` that are programs of a checkout by now, with the names of their modules.
_MOVED = {"ablation": "ablation", "artwork": "artwork", "paper": "paper", "peers": "peers", "thorns": "spikes"}
# For each command, in the module of its name: the function and its class, or a group of commands and None.
_FUNCTIONS = {
    "vectorize": ("vectorize", GroupedCommand), "animate": ("animate", Command), "eval": ("evaluate", Command),
    "render": ("render", Command), "doctor": ("doctor", Command), "bench": ("bench", None),
}  # fmt: skip
COMMANDS = tuple(_FUNCTIONS)
_ParserError = typer.BadParameter.__mro__[2]  # the base of all errors of the parser


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
    """Return the command line with some of COMMANDS: each one imports modules and makes parsers of its options, which
    takes as long as a small drawing.
    """
    app = typer.Typer(
        name="cubicsplat",
        cls=CommandGroup,
        help="Turn pictures into SVGs: photos as curves that blend, drawings as few shapes. Measure any SVG.",
        **TYPER,
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
    """Run a command by its arguments, as `meant` returns them; return the exit code, None for success."""
    # Only the first word can name a command; otherwise the help, or an error, lists all of them.
    named = [arguments[0]] if arguments[0] in COMMANDS else COMMANDS
    return application(*named)(args=arguments, prog_name="cubicsplat", standalone_mode=False)


def meant(arguments: list[str]) -> list[str]:
    """Return the arguments with what their user left out: `help` and nothing mean --help; pictures, folders and options
    of vectorize need no command.
    """
    first = arguments[0] if arguments else "help"
    if first == "help":
        return [*arguments[1:], "--help"]
    if arguments == ["bench"]:
        return ["bench", "--help"]
    if first in COMMANDS or first.partition("=")[0] in _OWN_OPTIONS:
        return arguments
    is_input = first.startswith("-") or is_there(Path(first))  # - is standard input
    is_path = re.search(r"[./\\*?]", first) and not difflib.get_close_matches(first, COMMANDS)
    return ["vectorize", *arguments] if is_input or is_path else arguments


def parser_error(error: Exception) -> str | None:
    """Return the parser's error in our words; "" if the user gave up (Ctrl-C), None for any other exception."""
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
    return (text[:1].lower() + text[1:]).rstrip(".")


def _reason(text: str, cause: BaseException | None) -> str:
    """Return the reason without the jargon of the parser, and of the library whose error is the cause."""
    errors = getattr(cause, "errors", None)
    given = "" if errors is None else f", not {errors()[0]['input']!r}"
    if "valid integer" in text:
        return f"must be a whole number{given}"
    if "valid number" in text or "valid float" in text:
        return f"must be a number{given}"
    if match := re.match(r"(?:Value error, )?'(.*)' is not one of (.*?)\.?$", text, re.DOTALL):
        choices = match[2].replace("'", "").split(", ")
        return f"must be {listed(choices)}, not {match[1]!r}"
    return (text[:1].lower() + text[1:]).rstrip(".")
