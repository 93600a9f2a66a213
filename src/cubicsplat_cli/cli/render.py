"""`cubicsplat render`: SVGs become PNGs, drawn by an independent renderer, or files for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import Quiet, Renderer, argument, option
from cubicsplat_cli.errors import CubicSplatError, InputError, UsageError
from cubicsplat_cli.files.names import STDIO, SVG_SUFFIXES, drawn_name, files_in, names_a_folder
from cubicsplat_cli.files.paths import EXPORTS, check_ownership, format_of, is_folder, is_there, make_folder_of
from cubicsplat_cli.files.read import read_file, read_stdin, unpacked
from cubicsplat_cli.files.write import encode_png, write_atomically, write_stdout
from cubicsplat_cli.formatting import did_you_mean, file_size, one_line, printable
from cubicsplat_cli.options import Setting, listed
from cubicsplat_cli.request import DXF_TOLERANCE

_SIDE = Setting("count", "", least=1, most=32_767, optional=True)
_ENDINGS = (".png", *(f".{form}" for form in EXPORTS))


def render(
    sources: Annotated[list[str], argument("IN...", "SVGs to draw, folders of them, or - for standard input.")],
    output: Annotated[
        str | None,
        option(
            "--output -o OUT",
            "PNG (or .pdf, .ps, .eps, .dxf, .xml) to write, a folder for it, or - for standard output."
            "  [default: the input's name with .png, or -]",
        ),
    ] = None,
    scale: Annotated[float, option("--scale FACTOR", "Pixels per unit of the SVG; above 0.")] = 1.0,
    width: Annotated[
        int | None, option("--width PX", "Draw so wide; as high as its shape asks, without --height.")
    ] = None,
    height: Annotated[
        int | None, option("--height PX", "Draw so high; as wide as its shape asks, without --width.")
    ] = None,
    dxf_tolerance: Annotated[
        float, option("--dxf-tolerance PX", "How far a DXF may be off the outlines.")
    ] = DXF_TOLERANCE,
    renderer: Renderer = "auto",
    quiet: Quiet = False,
    force: Annotated[bool, option("--force", "Replace an existing file that cubicsplat did not write.")] = False,
) -> None:
    """Draw SVGs as PNGs, or write one for another program.

    Transparency is kept, but in PS and EPS. Files they refer to are never fetched.
    """
    for name, value in (("width", width), ("height", height)):
        _SIDE.check(name, value)
    if scale != 1.0 and (width or height):
        raise UsageError("--scale and --width or --height both say how large to draw; give one of them")
    size: dict[str, Any] = {"scale": scale, "width": width, "height": height}
    reporter = Reporter(quiet=quiet)
    places = _plan(sources, output)
    failed = 0
    for source, path in places:
        try:
            _draw(source, path, size, dxf_tolerance, renderer, reporter, force=force and output is not None)
        except CubicSplatError as error:
            if len(places) == 1:
                raise
            failed += 1
            text = one_line(error)
            reporter.error(text if str(source) in text else f"{source}: {text}")
    if failed:
        raise typer.Exit(1)


def _plan(sources: list[str], output: str | None) -> list[tuple[Path | None, Path | None]]:
    """Return pairs of an SVG, None for standard input, and its PNG, None for standard output."""
    if STDIO in sources and len(sources) > 1:
        raise UsageError("standard input (-) can only be the one input; name files and folders in another run")
    several = len(sources) > 1 or is_folder(Path(sources[0]))
    if several and output is not None:
        folder = Path(output)
        may_be_folder = is_folder(folder) or (not is_there(folder) and folder.suffix.lower() not in _ENDINGS)
        if output == STDIO or not may_be_folder:
            kind = folder.suffix[1:].upper() or "file"
            raise UsageError(f"-o {output} names one {kind}, but there may be several; give a folder")
    inside = several or (output is not None and names_a_folder(output))
    places = [(source, _place(source, output, inside=inside)) for source in _files(sources)]
    taken: dict[Path, Path] = {}
    for source, path in places:
        if source is not None and path is not None and (other := taken.setdefault(path, source)) != source:
            raise UsageError(f"{other} and {source} would both give {path}; use two runs with different folders")
    return places


def _files(sources: list[str]) -> list[Path | None]:
    """Return the files, with the SVGs of folders in place of these, each once; None for standard input."""
    files: dict[Path | None, None] = {}
    for name in sources:
        folder = Path(name)
        if name == STDIO or not is_folder(folder):
            files[None if name == STDIO else folder] = None
            continue
        inside = files_in(folder, lambda path: path.suffix.lower() in SVG_SUFFIXES)
        if not inside:
            raise InputError(f"{printable(name)}: is a folder without SVGs; give one with .svg files")
        files.update(dict.fromkeys(inside))
    return list(files)


def _place(source: Path | None, output: str | None, *, inside: bool) -> Path | None:
    """Return the path of the result, None for standard output. inside: `output` is a folder for it."""
    if output == STDIO:
        return None
    if output is None:
        if source is not None and not source.name:
            raise InputError(f"{source}: is no file; give an SVG")
        return None if source is None else drawn_name(source)
    if inside:
        return Path(output) / f"{'stdin' if source is None else source.stem}.png"
    return Path(output)


def _draw(
    source: Path | None, path: Path | None, size: dict[str, Any], tolerance: float, renderer: str, reporter: Reporter,
    *, force: bool,
) -> None:  # fmt: skip
    """Draw one SVG. size, tolerance: see `exported`. force: replace files of other programs; not for a default name."""
    if path is not None:
        if path.suffix.lower() not in _ENDINGS:
            near = did_you_mean(path.suffix.lower(), _ENDINGS) or "; choose another with -o"
            raise UsageError(f"the output must end in {listed(_ENDINGS)}, but is {path}{near}")
        check_ownership([path], force=force, source=source)

    from cubicsplat_cli.evaluate.rerender import rerender_untrusted

    svg = unpacked(read_stdin(), "stdin") if source is None else read_file(source)
    name = "stdin" if source is None else str(source)
    if path is not None and (form := format_of(path)):
        if renderer != "auto":
            raise UsageError("--renderer is of PNGs; leave it out")
        from cubicsplat_cli.export.formats import exported

        data, lacking = exported(svg, form, name, tolerance=tolerance, **size)
        notes, about = [f"{name}: {note}" for note in lacking], file_size(len(data))
    else:
        rendered, _ = rerender_untrusted(svg, source=name, renderer=renderer, **size)
        height, width = rendered.pixels.shape[:2]
        data, about = encode_png(rendered.pixels), f"{width} x {height} px  {rendered.renderer}"
        notes = [] if rendered.note is None else [rendered.note]
    for note in notes:
        reporter.note(note)
    if path is None:
        write_stdout(data)
        return
    make_folder_of(path)
    write_atomically(path, data)
    reporter.summary(f"{path}  {about}")
