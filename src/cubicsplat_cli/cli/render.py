"""`cubicsplat render`: an SVG becomes a PNG, drawn by an independent renderer."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import STDIO, RendererChoice
from cubicsplat_cli.cli.outputs import check_outputs, same_file
from cubicsplat_cli.errors import UsageError


def render(
    source: Annotated[Path, typer.Argument(metavar="IN", help="SVG to draw.")],
    output: Annotated[
        str | None,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT",
            help="PNG to write, or - for standard output.  [default: the input's name with .png]",
            show_default=False,
        ),
    ] = None,
    scale: Annotated[float, typer.Option("--scale", help="Pixels per unit of the SVG; above 0.")] = 1.0,
    renderer: Annotated[
        RendererChoice,
        typer.Option("--renderer", help="What draws the SVG; auto is cairosvg where it works."),
    ] = RendererChoice.auto,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Replace an existing file that cubicsplat did not write.")
    ] = False,
) -> None:
    """Draw an SVG as a PNG, its transparency kept. Files it refers to are never fetched."""
    path = None if output == STDIO else source.with_suffix(".png") if output is None else Path(output)
    if path is not None:
        if path.suffix.lower() != ".png":
            raise UsageError(f"the output must end in .png, but is {path}; choose another with -o")
        if same_file(path, source):
            raise UsageError(f"{path} is the input and would be overwritten; choose another output with -o")
        check_outputs([path], force=force)

    from cubicsplat_cli.cli.files import read_file
    from cubicsplat_cli.cli.png import encode_png
    from cubicsplat_cli.evaluate import rerender_untrusted
    from cubicsplat_cli.image import write_atomically

    rendered, _ = rerender_untrusted(
        read_file(source), source=str(source), scale=scale, renderer=renderer.wanted()
    )
    data = encode_png(rendered.pixels)
    reporter = Reporter(quiet=quiet, verbose=False)
    if rendered.note is not None:
        reporter.note(rendered.note)
    if path is None:
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()
        return
    write_atomically(path, data)
    height, width = rendered.pixels.shape[:2]
    reporter.summary(f"{path}  {width} x {height} px  {rendered.renderer}")
