"""Where results go, and which existing files may be replaced by them. Imports nothing heavy."""

from __future__ import annotations

import stat
from dataclasses import dataclass
from pathlib import Path

from cubicsplat_cli.cli.options import STDIO
from cubicsplat_cli.cli.provenance import HEAD_BYTES, PROGRAM, svg_is_ours
from cubicsplat_cli.errors import UsageError


@dataclass(frozen=True)
class Outputs:
    """Files of one vectorised picture; None: not written. `svg` None means standard output."""

    svg: Path | None
    png: Path | None
    report: Path | None

    def files(self) -> list[Path]:
        """All files that will be written."""
        return [path for path in (self.svg, self.png, self.report) if path is not None]


def plan_outputs(source: Path | None, output: str | None, *, png: bool) -> Outputs:
    """The files for the picture at `source` (None: standard input) and the value of `-o` (None: not given).

    `-o` is an SVG file, a folder for it, or "-" for standard output, which is also the default for standard
    input.
    Raises UsageError when the SVG would not end in .svg or would be the input itself.
    """
    if output == STDIO or (output is None and source is None):
        return Outputs(None, None, None)
    if output is None:
        svg = source.with_suffix(".svg")
    else:
        svg = Path(output)
        if svg.is_dir():
            svg = svg / f"{source.stem if source is not None else 'stdin'}.svg"
    if svg.suffix.lower() != ".svg":
        raise UsageError(f"the output must end in .svg, but -o is {output}; use -o - for standard output")
    picture = svg.with_suffix(".png")
    # `photo.png` gives `photo.svg`, whose picture must not be `photo.png`.
    if source is not None and same_file(picture, source):
        picture = svg.with_suffix(".rendered.png")
    outputs = Outputs(svg, picture if png else None, svg.with_suffix(".json"))
    for path in outputs.files():
        if source is not None and same_file(path, source):
            raise UsageError(f"{path} is the input and would be overwritten; choose another output with -o")
    return outputs


def check_outputs(paths: list[Path], *, force: bool) -> None:
    """Find out before the work whether every file can be written and may be replaced.

    Raises InputError where a file cannot be written, UsageError where one exists that cubicsplat did not
    write and `force` is not given.
    """
    from cubicsplat_cli.image import check_writable

    for path in paths:
        check_writable(path)
        if not force and path.exists() and not is_ours(path):
            raise UsageError(
                f"{path} exists and was not written by cubicsplat; use --force or choose another output"
            )


def is_ours(path: Path) -> bool:
    """Whether an existing regular file carries the mark that cubicsplat leaves in what it writes."""
    if not stat.S_ISREG(path.stat().st_mode):
        return False
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    if path.suffix.lower() == ".png":
        return f"tEXtSoftware\0{PROGRAM} ".encode() in head
    if path.suffix.lower() == ".json":
        return f'"program": "{PROGRAM}"'.encode() in head
    return svg_is_ours(head)


def same_file(first: Path, second: Path) -> bool:
    """Whether two paths lead to the same existing file, links and letter case considered."""
    try:
        return first.samefile(second)
    except OSError:
        # One of them does not exist (or cannot be looked at), so writing the one cannot harm the other.
        return False
