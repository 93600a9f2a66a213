"""Programs that measure cubicsplat, run in a checkout as `python -m benchmarks.NAME`; no part of the package."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, NoReturn

import typer

from cubicsplat_cli.__main__ import run
from cubicsplat_cli.cli.options import TYPER, Command, option

Threads = Annotated[int, option("--threads N", "CPU threads.", min=1)]


def program(command: Callable[..., None]) -> Callable[[list[str]], int | None]:
    """A function with Typer's options as a program that takes arguments and returns an exit code."""
    app = typer.Typer(add_completion=False, **TYPER)
    app.command(cls=Command)(command)
    name = f"python -m benchmarks.{command.__name__}"
    return lambda arguments: app(args=arguments, prog_name=name, standalone_mode=False)


def main(command: Callable[..., None]) -> NoReturn:
    """Run a benchmark with this process's arguments; its errors and exit codes are those of `cubicsplat`."""
    run(program(command))
