"""Where results go, and which existing files may be replaced by them. Imports nothing heavy."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.marks import HEAD_BYTES, PROGRAM, svg_is_ours
from cubicsplat_cli.files.paths import is_file, is_folder, is_there, same_file

STDIO = "-"
PLAIN, COMPRESSED = ".svg", ".svgz"
_GZIP = b"\x1f\x8b"


@dataclass(frozen=True)
class Outputs:
    """Files of one vectorised picture; None: not written. `svg` None means standard output."""

    svg: Path | None
    png: Path | None
    report: Path | None

    def files(self) -> list[Path]:
        """All files that will be written."""
        return [path for path in (self.svg, self.png, self.report) if path is not None]

    @property
    def compressed(self) -> bool:
        """Whether the name of the SVG says that it is compressed."""
        return self.svg is not None and self.svg.suffix.lower() == COMPRESSED


def plan_outputs(source: Path | None, output: str | None, *, png: bool, compress: bool = False) -> Outputs:
    """The files for the picture at `source` (None: standard input) and the value of `-o` (None: not given).

    `-o` is an SVG file, a folder for it (one that exists, or a name that ends with a slash), or "-" for standard
    output, which is also the default for standard input. Raises UsageError when the SVG would not end in .svg (or
    .svgz; with `compress` only that) or would be the input itself.
    """
    if output == STDIO or (output is None and source is None):
        return Outputs(None, None, None)
    suffix = COMPRESSED if compress else PLAIN
    if output is None:
        svg = source.with_suffix(suffix)
    else:
        svg = Path(output)
        if names_a_folder(output):
            svg = svg / f"{source.stem if source is not None else 'stdin'}{suffix}"
    if svg.suffix.lower() not in ((COMPRESSED,) if compress else (PLAIN, COMPRESSED)):
        raise UsageError(f"the output must end in {suffix}, but -o is {output}; use -o - for standard output")
    outputs = beside(svg, png=png)
    for path in outputs.files():
        if source is not None and same_file(path, source):
            raise UsageError(f"{path} is the input and would be overwritten; choose another output with -o")
    return outputs


def beside(svg: Path, *, png: bool) -> Outputs:
    """The SVG's companions: its picture and its figures.

    `photo.png` gives `photo.svg`, whose picture must not be `photo.png`; nor may it be any other picture that is
    there and not drawn by us, since it is only a by-product. It is called `photo.rendered.png` then.
    """
    picture = svg.with_suffix(".png")
    if is_there(picture) and not is_ours(picture):
        picture = svg.with_suffix(".rendered.png")
    return Outputs(svg, picture if png else None, svg.with_suffix(".json"))


def names_a_folder(output: str) -> bool:
    """Whether the value of `-o` means a folder: it is one, or ends with a slash."""
    return output.endswith(("/", "\\")) or is_folder(Path(output))


def check_outputs(paths: list[Path], *, force: bool) -> None:
    """Find out before the work whether every file can be written and may be replaced.

    Raises InputError where a file cannot be written, UsageError where one exists that cubicsplat did not
    write and `force` is not given.
    """
    from cubicsplat_cli.files.atomic import check_writable

    for path in paths:
        check_writable(path)
    check_ownership(paths, force=force)


def check_ownership(paths: list[Path], *, force: bool) -> None:
    """Raise UsageError where a file exists that cubicsplat did not write and `force` is not given."""
    for path in paths:
        if not force and is_there(path) and not is_ours(path):
            raise UsageError(f"{path} exists and was not written by cubicsplat; use --force or choose another output")


def is_ours(path: Path) -> bool:
    """Whether an existing regular file carries the mark that cubicsplat leaves in what it writes.

    A file that cannot be read is not ours, as far as we can tell.
    """
    if not is_file(path):
        return False
    try:
        head = read_head(path)
    except OSError:
        return False
    if path.suffix.lower() == ".png":
        return f"tEXtSoftware\0{PROGRAM} ".encode() in head
    if path.suffix.lower() == ".json":
        return f'"program": "{PROGRAM}"'.encode() in head
    return svg_is_ours(head)


def read_head(path: Path) -> bytes:
    """The first bytes of a file, unpacked where it is compressed; marks of ours are in them."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    if not head.startswith(_GZIP):
        return head
    try:
        return zlib.decompressobj(16 + zlib.MAX_WBITS).decompress(head, HEAD_BYTES)
    except zlib.error:
        return head
