"""`cubicsplat doctor`: versions, renderers and the engine, and what does not work here."""

from __future__ import annotations

import platform
import sys
from typing import Annotated, Any

import typer

from cubicsplat_cli._version import __version__

_PACKAGES = ("torch", "numpy", "Pillow", "scikit-image", "svgwrite", "cairosvg", "resvg_py", "typer", "rich")


def doctor(
    json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
) -> None:
    """Show versions, renderers and the engine; exit 1 when something needed does not work."""
    from cubicsplat_cli.report import to_json

    found = examine()
    if json:
        typer.echo(to_json(found), nl=False)
    else:
        for line in _lines(found):
            typer.echo(line)
    if found["problems"]:
        raise typer.Exit(1)


def examine() -> dict[str, Any]:
    """Versions, renderers and engine as plain values; `problems` lists, one sentence each, what is broken."""
    from cubicsplat_cli.evaluate import available_renderers

    problems: list[str] = []
    renderers = available_renderers()
    if all(info.version is None for info in renderers):
        problems.append("no SVG renderer works: " + "; ".join(info.problem or info.name for info in renderers))
    return {
        "version": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "executable": sys.executable,
        "packages": {name: _version_of(name, problems) for name in _PACKAGES},
        "renderers": {info.name: info.version or info.problem for info in renderers},
        "engine": _engine(problems),
        "problems": problems,
    }


def _version_of(package: str, problems: list[str]) -> str | None:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        problems.append(f"the package {package} is missing: pip install {package}")
        return None


def _engine(problems: list[str]) -> dict[str, Any]:
    from cubicsplat_cli import raster

    engines = raster.describe()
    if not any(state["available"] for state in engines.values()):
        reasons = "; ".join(f"{name}: {state['reason']}" for name, state in engines.items())
        problems.append(f"no engine works: {reasons}")
    return engines


def _engine_text(state: dict[str, Any]) -> str:
    if not state["available"]:
        return f"not available: {state['reason']}"
    return ", ".join(f"{name} {_plain(value)}" for name, value in state.items() if name != "available")


def _plain(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


def _lines(found: dict[str, Any]) -> list[str]:
    lines = [
        f"cubicsplat {found['version']}",
        f"python     {found['python']} ({found['executable']})",
        f"platform   {found['platform']}",
        "packages   " + ", ".join(f"{name} {version}" for name, version in found["packages"].items()),
    ]
    lines += [f"renderer   {name}: {state}" for name, state in found["renderers"].items()]
    lines += [f"engine     {name}: {_engine_text(state)}" for name, state in found["engine"].items()]
    lines += [f"PROBLEM    {problem}" for problem in found["problems"]]
    return lines
