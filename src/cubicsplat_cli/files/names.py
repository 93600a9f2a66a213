"""Names of files: the files of a result, the meaning of suffixes, and pairs of two folders. Imports nothing heavy."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.files.paths import (
    EXPORTS,
    check_ownership,
    format_of,
    is_folder,
    is_ours,
    is_replaceable,
    is_there,
    pictured_name,
    same_file,
)
from cubicsplat_cli.formatting import did_you_mean
from cubicsplat_cli.options import listed
from cubicsplat_cli.record import record

if TYPE_CHECKING:
    from cubicsplat_cli.request import Request

STDIO = "-"
PLAIN, COMPRESSED = ".svg", ".svgz"
PAGE = ".html"
SVG_SUFFIXES = frozenset((PLAIN, COMPRESSED))
_RENDERED = ".rendered.png"
LAYER = "layer "
# A folder's files with these suffixes count as pictures; a file that the user names may have any name.
PICTURE_SUFFIXES = {
    ".png", ".jpg", ".jpeg", ".jpe", ".webp", ".avif", ".gif", ".tif", ".tiff", ".bmp", ".dib", ".ppm", ".pgm", ".pbm",
    ".pnm",
}  # fmt: skip


@record
class Outputs:
    """Files of one vectorised picture; None: not written, or for `svg` standard output.

    metrics: the JSON. html_report: the page about the result. animation: the fit as it develops. geometrize: the list
    of shapes. exports: the SVG in formats of other programs, each once. layers: how the colours' SVGs begin.
    """

    svg: Path | None
    png: Path | None
    metrics: Path | None
    html_report: Path | None = None
    animation: Path | None = None
    geometrize: Path | None = None
    exports: tuple[Path, ...] = ()
    layers: Path | None = None

    def place(self, kind: str) -> Path | None:
        """Return the file of a kind: a member, a format of other programs, or LAYER and the name of a layer."""
        if kind.startswith(LAYER):
            name = f"-{kind.removeprefix(LAYER)}{PLAIN}"
            return None if self.layers is None else self.layers.with_name(self.layers.name + name)
        exports = {format_of(path): path for path in self.exports}
        return exports[kind] if kind in exports else getattr(self, kind)

    def with_others(self, request: Request, below: Path) -> Outputs:
        """Return the same with the files that are made of the SVG: beside it more formats of other programs and a page,
        and the layers, in a folder below that of the request. Without an SVG on the disk there are none.
        """
        if self.svg is None:
            return self
        have = {format_of(path) for path in self.exports}
        more = [self.svg.with_suffix(f".{form}") for form in request.also if form not in have]
        layers = None if request.layers is None else request.layers / below / self.svg.stem
        html_report = self.svg.with_suffix(PAGE) if request.html_report else None
        return replace(self, exports=(*self.exports, *more), layers=layers, html_report=html_report)

    def existing_layers(self) -> list[Path]:
        """Return the existing files with the names of this picture's layers, in order."""
        if self.layers is None or not is_folder(self.layers.parent):
            return []
        name = re.compile(re.escape(self.layers.name) + r"-\d{2,}-[0-9a-f]{6}(?:[0-9a-f]{2})?\.svg")
        return sorted(path for path in self.layers.parent.iterdir() if name.fullmatch(path.name))

    def files(self) -> list[Path]:
        """Return all files that will be written, except the layers, which depend on the picture's colours."""
        return list(filter(None, (*self.results(), self.html_report, *self.exports)))

    def results(self) -> list[Path]:
        """Return all files except the page and the exports, which can be made again without a fit."""
        return list(filter(None, (self.svg, self.png, self.metrics, self.animation, self.geometrize)))


def is_picture_name(path: Path) -> bool:
    """Return whether a file in a folder counts as a picture: its suffix says so, and it is not hidden."""
    return path.suffix.lower() in PICTURE_SUFFIXES and not path.name.startswith(".")


def is_heic_name(path: Path) -> bool:
    """Return whether the name is that of an HEIC picture that is not hidden."""
    return path.suffix.lower() in (".heic", ".heif") and not path.name.startswith(".")


def reads_heic() -> bool:
    """Return whether HEIC pictures can be read here."""
    return importlib.util.find_spec("pillow_heif") is not None


def is_compressed_name(path: Path | None) -> bool:
    """Return whether the name of an SVG says that it is compressed."""
    return path is not None and path.suffix.lower() == COMPRESSED


def parse_formats(given: Iterable[str]) -> tuple[str, ...]:
    """Return formats of other programs from texts such as `pdf,dxf`, each once. Raises UsageError for other names."""
    names = [part.strip().lower().removeprefix(".") for text in given for part in text.split(",")]
    for name in names:
        if name not in EXPORTS:
            raise UsageError(f"must name {listed(EXPORTS)}, not {name!r}", "also")
    return tuple(dict.fromkeys(names))


def plan_outputs(source: Path | None, output: str | None, request: Request) -> Outputs:
    """Return the files for the picture at `source` (None: standard input) and the value of `-o` (None: not given).

    `-o` is an SVG file; a file in a format of other programs, beside which the SVG lies; a folder for the SVG (one that
    exists, or a name that ends with a slash); or "-" for standard output, which is also the default for standard input.
    The request's suffix is added to names that are made of the picture's name. Raises UsageError if the name of the SVG
    has another suffix than .svg or .svgz (where it is to be compressed, than .svgz), or if a file is the input.
    """
    if output == STDIO or (output is None and source is None):
        return Outputs(None, None, None)
    suffix, ending = COMPRESSED if request.compress else PLAIN, request.suffix
    exports: tuple[Path, ...] = ()
    if output is None or names_a_folder(output):
        folder = Path(output) if output is not None else source.parent if source is not None else Path()
        svg = place_for(source, folder, f"{ending}{suffix}") if source else folder / f"stdin{ending}{suffix}"
    else:
        svg = Path(output)
        if ending:
            raise UsageError(f"--suffix is of names made of the picture's, but -o {output} is one; leave out either")
        if format_of(svg) is not None:
            exports, svg = (svg,), svg.with_suffix(suffix)
    if svg.suffix.lower() not in ((COMPRESSED,) if request.compress else SVG_SUFFIXES):
        raise UsageError(f"the output must end in {suffix}, but -o is {output}; {_instead(svg, suffix)}")
    outputs = replace(outputs_beside(svg, png=request.png, metrics=request.metrics, source=source), exports=exports)
    check_ownership(outputs.files(), force=True, source=source)  # whose files exist is seen later, in the work
    return outputs


def _instead(svg: Path, suffix: str) -> str:
    """Return advice for an output of another kind than `suffix`."""
    if svg.suffix.lower() in PICTURE_SUFFIXES:
        kind = svg.suffix.lower()[1:].upper()
        return f"for a drawn {kind} make {svg.stem}{suffix} first: its PNG is written beside it"
    if not svg.suffix:
        return f"-o {svg}{suffix} is a file, -o {svg}/ a folder, -o - standard output"
    near = did_you_mean(svg.suffix[1:].lower(), EXPORTS)
    return f"other formats are {', '.join(EXPORTS)}{near}" if near else f"call it {svg.with_suffix(suffix)}"


def place_for(source: Path, folder: Path, suffix: str, *, shared: bool = False) -> Path:
    """Return the default path of a picture's SVG: the picture's name with another suffix.

    The picture's own suffix stays (a.png.svg) if another picture, such as a.jpg, has the same name: now, with `shared`,
    or earlier, when it became the SVG that is there, and still exists. The first picture keeps the short name, so that
    no earlier results are replaced or left behind.
    """
    short = folder / f"{source.stem}{suffix}"
    first = pictured_name(short)
    taken = shared if first is None else first != source.name and (shared or is_there(source.parent / first))
    return folder / f"{source.name}{suffix}" if taken else short


def outputs_beside(svg: Path, *, png: bool, metrics: bool = True, source: Path | None = None) -> Outputs:
    """Return an SVG with its PNG and its metrics.

    The PNG of `photo.svg` is `photo.png`, or `photo.rendered.png` if that is the input, or a picture that cubicsplat
    did not draw: a by-product replaces no picture.
    """
    picture = drawn_name(svg)
    if source is not None and same_file(picture, source):
        picture = svg.with_suffix(_RENDERED)
    return Outputs(svg, picture if png else None, svg.with_suffix(".json") if metrics else None)


def drawn_name(svg: Path) -> Path:
    """Return the default path of the PNG of an SVG, which is no picture that cubicsplat did not draw."""
    picture = svg.with_suffix(".png")
    return picture if is_replaceable(picture) else svg.with_suffix(_RENDERED)


def names_a_folder(output: str) -> bool:
    """Return whether the value of `-o` means a folder: it is one, or ends with a slash."""
    return output.endswith(("/", "\\")) or is_folder(Path(output))


def pictures_in(folder: Path) -> list[Path]:
    """Return a folder's pictures that cubicsplat did not draw, by name. Raises InputError if there are none to read."""
    pictures = [path for path in files_in(folder, is_picture_name) if not is_ours(path)]
    if not pictures:
        raise InputError(f"{folder}: holds no pictures; give a folder with PNG, JPEG or other picture files")
    return pictures


def match_folders(references: Path, candidates: Path) -> tuple[list[tuple[Path, Path]], list[Path], list[Path]]:
    """Match the pictures of one folder with the SVGs, or else pictures, of the same stem in another.

    Return the pairs, the pictures without a candidate, and the candidates without a picture. Raises InputError where
    the folders are one, cannot be read, or a stem is not unique in one of them.
    """
    if references.resolve() == candidates.resolve():
        raise InputError(f"{references}: is both the reference and the candidate; give two folders")
    pictures = _by_stem(pictures_in(references))
    rasters = files_in(candidates, is_picture_name)
    drawings = _by_stem(files_in(candidates, lambda path: path.suffix.lower() in SVG_SUFFIXES))
    # Beside each SVG that `vectorize` writes lies its picture.
    results = _by_stem([path for path in rasters if path.stem not in drawings]) | drawings
    pairs = [(path, results[stem]) for stem, path in pictures.items() if stem in results]
    if not pairs:
        raise InputError(f"no file in {candidates} has the name of a picture in {references}; check the folders")
    missing = [path for stem, path in pictures.items() if stem not in results]
    return pairs, missing, [path for stem, path in results.items() if stem not in pictures]


def files_in(folder: Path, is_one: Callable[[Path], bool]) -> list[Path]:
    """Return the files of a kind directly in a folder, sorted by name. Raises InputError if it cannot be read."""
    try:
        return sorted(path for path in folder.iterdir() if is_one(path) and path.is_file())
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror}); check the path") from error


def _by_stem(paths: list[Path]) -> dict[str, Path]:
    named: dict[str, Path] = {}
    for path in paths:
        if path.stem in named:
            raise InputError(f"{named[path.stem]} and {path.name} have the same stem; remove one of them")
        named[path.stem] = path
    return named
