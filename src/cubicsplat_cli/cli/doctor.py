"""`cubicsplat doctor`: versions, renderers and engines, and the problems of this machine."""

from __future__ import annotations

import platform
import shutil
import sys
import textwrap
from typing import Any

import typer

from cubicsplat_cli._version import __version__
from cubicsplat_cli.cli.options import Json
from cubicsplat_cli.metrics import to_json

_PACKAGES = (
    "numpy", "torch", "array-api-compat", "Pillow", "scikit-image", "scipy", "svgwrite", "cairosvg", "resvg_py",
    "typer", "rich",
)  # fmt: skip
_INDENT = 11  # columns before the text of a line


def doctor(json: Json = False) -> None:
    """Show what works here, and why something does not.

    Versions, renderers and engines; exits with 1 when something needed does not work.
    """
    report = examine()
    if json:
        typer.echo(to_json(report), nl=False)
    else:
        for line in _lines(report):
            for part in _folded(line):
                typer.echo(part)
    if report["problems"]:
        raise typer.Exit(1)


def examine() -> dict[str, Any]:
    """Return versions, renderers and engines as plain values; `problems` has a sentence about each failure."""
    from cubicsplat_cli.evaluate.rerender import available_renderers
    from cubicsplat_cli.raster.engines import describe

    problems: list[str] = []
    renderers, engines = available_renderers(), describe()
    if all(version is None for version, _ in renderers.values()):
        problems.append("no SVG renderer works: " + "; ".join(problem or "" for _, problem in renderers.values()))
    packages = {name: _version_of(name, problems) for name in _PACKAGES}
    if not any(state["available"] for state in engines.values()):
        reasons = "; ".join(f"{name}: {state['reason']}" for name, state in engines.items())
        problems.append(f"no engine works: {reasons}")
    return {
        "version": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "executable": sys.executable,
        "packages": packages,
        "renderers": {name: version or problem for name, (version, problem) in renderers.items()},
        "engine": engines,
        "problems": problems,
    }


def _version_of(package: str, problems: list[str]) -> str | None:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        problems.append(f"the package {package} is missing: pip install {package}")
        return None


def _engine_text(state: dict[str, Any]) -> str:
    if not state["available"]:
        return f"not available: {state['reason']}"
    shown = {
        name.replace("_", " "): " ".join(map(str, value)) if isinstance(value, (list, tuple)) else value
        for name, value in state.items()
        if name not in ("available", "name", "used")
    }
    return ("the one used; " if state.get("used") else "") + ", ".join(f"{n} {value}" for n, value in shown.items())


def _folded(line: str) -> list[str]:
    """Return the rows of a line: folded between words and indented for a terminal, else one."""
    if not sys.stdout.isatty():
        return [line]
    width = max(2 * _INDENT, shutil.get_terminal_size().columns)
    return textwrap.wrap(line, width, subsequent_indent=" " * _INDENT, break_long_words=False, break_on_hyphens=False)


def _lines(report: dict[str, Any]) -> list[str]:
    lines = [
        f"cubicsplat {report['version']}",
        f"python     {report['python']} ({report['executable']})",
        f"platform   {report['platform']}",
        "packages   " + ", ".join(f"{name} {version}" for name, version in report["packages"].items()),
    ]
    lines += [f"renderer   {name}: {state}" for name, state in report["renderers"].items()]
    lines += [f"engine     {name}: {_engine_text(state)}" for name, state in report["engine"].items()]
    lines += [f"PROBLEM    {problem}" for problem in report["problems"]]
    return lines
