"""The names of files: where results go, which suffixes mean what, which files of two folders belong together.

Imports nothing heavy.
"""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.files.paths import (
    EXPORTS,
    format_of,
    is_folder,
    is_ours,
    is_replaceable,
    is_there,
    pictured_name,
    same_file,
)  # fmt: skip
from cubicsplat_cli.formatting import did_you_mean
from cubicsplat_cli.options import listed
from cubicsplat_cli.record import record

STDIO = "-"
PLAIN, COMPRESSED = ".svg", ".svgz"
PAGE = ".html"
SVG_SUFFIXES = frozenset((PLAIN, COMPRESSED))
_RENDERED = ".rendered.png"
LAYER = "layer "
_LAYER_NAME = re.compile(r"\d{2,}-[0-9a-f]{6}(?:[0-9a-f]{2})?\.svg")
# In a folder, these are taken for pictures; a file that is named itself may be called anything.
PICTURE_SUFFIXES = frozenset(
    (
        *(".png", ".jpg", ".jpeg", ".jpe", ".webp", ".avif", ".gif", ".tif", ".tiff"),
        *(".bmp", ".dib", ".ppm", ".pgm", ".pbm", ".pnm"),
    )
)


@record
class Outputs:
    """Files of one vectorised picture; None: not written. `svg` None means standard output. metrics: the JSON;
    html_report: a page to look at, made of the others; animation: the fit as it develops; geometrize: the shapes as a
    list; exports: the SVG in formats of other programs, no two of one format; layers: how the names of the SVGs of each
    colour begin.
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
        """The file of a kind: a member, a format of other programs, or LAYER and the name of a layer."""
        if kind.startswith(LAYER):
            name = f"-{kind.removeprefix(LAYER)}{PLAIN}"
            return None if self.layers is None else self.layers.with_name(self.layers.name + name)
        exports = {format_of(path): path for path in self.exports}
        return exports[kind] if kind in exports else getattr(self, kind)

    def with_others(self, formats: tuple[str, ...], folder: Path | None, *, page: bool) -> Outputs:
        """Return the same with the files that are made of the SVG: beside it more formats of other programs and a page,
        in a folder, if there is one, the layers. Without an SVG on the disk there are none.
        """
        if self.svg is None:
            return self
        have = {format_of(path) for path in self.exports}
        more = [self.svg.with_suffix(f".{form}") for form in formats if form not in have]
        return replace(
            self,
            exports=(*self.exports, *more),
            layers=None if folder is None else folder / self.svg.stem,
            html_report=self.svg.with_suffix(PAGE) if page else None,
        )

    def existing_layers(self) -> list[Path]:
        """Files that are there and have the name of a layer of this picture, in order."""
        if self.layers is None or not is_folder(self.layers.parent):
            return []
        start = f"{self.layers.name}-"
        return sorted(
            path
            for path in self.layers.parent.iterdir()
            if path.name.startswith(start) and _LAYER_NAME.fullmatch(path.name.removeprefix(start))
        )

    def files(self) -> list[Path]:
        """All files that will be written, but for the layers, whose colours nobody knows before."""
        return [path for path in (*self.results(), self.html_report, *self.exports) if path is not None]

    def results(self) -> list[Path]:
        """All files except the page and the exports, which can be made again without a fit."""
        files = self.svg, self.png, self.metrics, self.animation, self.geometrize
        return [path for path in files if path is not None]


def is_picture_name(path: Path) -> bool:
    """Whether a file in a folder is taken for a picture: by its suffix, and not hidden."""
    return path.suffix.lower() in PICTURE_SUFFIXES and not path.name.startswith(".")


def is_heic_name(path: Path) -> bool:
    """Whether a file is an HEIC picture by its name."""
    return path.suffix.lower() in (".heic", ".heif") and not path.name.startswith(".")


def reads_heic() -> bool:
    """Whether HEIC pictures can be read here."""
    return importlib.util.find_spec("pillow_heif") is not None


def is_compressed_name(path: Path | None) -> bool:
    """Whether the name of an SVG says that it is compressed."""
    return path is not None and path.suffix.lower() == COMPRESSED


def parse_formats(given: Iterable[str]) -> tuple[str, ...]:
    """Formats of other programs from texts such as `pdf,dxf`, each once. Raises UsageError for any other name."""
    names = [part.strip().lower().removeprefix(".") for text in given for part in text.split(",")]
    for name in names:
        if name not in EXPORTS:
            raise UsageError(f"must name {listed(EXPORTS)}, not {name!r}", "also")
    return tuple(dict.fromkeys(names))


def plan_outputs(
    source: Path | None,
    output: str | None,
    *,
    png: bool,
    metrics: bool = True,
    compress: bool = False,
    ending: str = "",
) -> Outputs:
    """The files for the picture at `source` (None: standard input) and the value of `-o` (None: not given). ending:
    what a name that is made of the picture's gets at its end.

    `-o` is an SVG file; a file in a format of other programs, beside which the SVG lies; a folder for the SVG (one that
    exists, or a name that ends with a slash); or "-" for standard output, which is also the default for standard input.
    Raises UsageError when the name would end otherwise (with `compress` the SVG's in .svgz), or be the input itself.
    """
    if output == STDIO or (output is None and source is None):
        return Outputs(None, None, None)
    suffix = COMPRESSED if compress else PLAIN
    exports: tuple[Path, ...] = ()
    if output is None:
        assert source is not None
        svg = place_for(source, source.parent, f"{ending}{suffix}")
    elif names_a_folder(output):
        svg = Path(output) / f"stdin{ending}{suffix}"
        if source is not None:
            svg = place_for(source, Path(output), f"{ending}{suffix}")
    else:
        svg = Path(output)
        if ending:
            raise UsageError(f"--suffix is of names made of the picture's, but -o {output} is one; leave out either")
        if format_of(svg) is not None:
            exports, svg = (svg,), svg.with_suffix(suffix)
    if svg.suffix.lower() not in ((COMPRESSED,) if compress else SVG_SUFFIXES):
        raise UsageError(f"the output must end in {suffix}, but -o is {output}; {_instead(svg, suffix)}")
    outputs = replace(outputs_beside(svg, png=png, metrics=metrics, source=source), exports=exports)
    for path in outputs.files():
        if source is not None and same_file(path, source):
            raise UsageError(f"{path} is the input and would be overwritten; choose another output with -o")
    return outputs


def _instead(svg: Path, suffix: str) -> str:
    """Advice for an output of another kind than `suffix`."""
    if svg.suffix.lower() in PICTURE_SUFFIXES:
        kind = svg.suffix.lower()[1:].upper()
        return f"for a drawn {kind} make {svg.stem}{suffix} first: its PNG is written beside it"
    if not svg.suffix:
        return f"-o {svg}{suffix} is a file, -o {svg}/ a folder, -o - standard output"
    near = did_you_mean(svg.suffix[1:].lower(), EXPORTS)
    return f"other formats are {', '.join(EXPORTS)}{near}" if near else f"call it {svg.with_suffix(suffix)}"


def place_for(source: Path, folder: Path, suffix: str, *, shared: bool = False) -> Path:
    """The default path of a picture's SVG: the picture's name without its ending, and a suffix.

    Where another picture has that name, as a.jpg and a.png do, the ending stays (a.png.svg): with `shared` there is one
    now, and there was one where the SVG is there already and the picture that it says it was made of still is.
    Whoever came first keeps the short name, so that no earlier results are replaced or left behind.
    """
    short = folder / f"{source.stem}{suffix}"
    first = pictured_name(short)
    taken = shared if first is None else first != source.name and (shared or is_there(source.parent / first))
    return folder / f"{source.name}{suffix}" if taken else short


def outputs_beside(svg: Path, *, png: bool, metrics: bool = True, source: Path | None = None) -> Outputs:
    """The SVG's companions: its picture and its figures.

    `photo.png` gives `photo.svg`, whose picture must not be `photo.png`; nor may it be any other picture that is
    there and not drawn by us, since it is only a by-product. It is called `photo.rendered.png` then.
    """
    picture = drawn_name(svg)
    if source is not None and same_file(picture, source):
        picture = svg.with_suffix(_RENDERED)
    return Outputs(svg, picture if png else None, svg.with_suffix(".json") if metrics else None)


def drawn_name(svg: Path) -> Path:
    """The default path of the PNG of an SVG; never that of a picture that cubicsplat did not draw."""
    picture = svg.with_suffix(".png")
    return picture if is_replaceable(picture) else svg.with_suffix(_RENDERED)


def names_a_folder(output: str) -> bool:
    """Whether the value of `-o` means a folder: it is one, or ends with a slash."""
    return output.endswith(("/", "\\")) or is_folder(Path(output))


def pictures_in(folder: Path) -> list[Path]:
    """The picture files right in a folder, by name, less those that cubicsplat drew itself.

    Raises InputError where the folder cannot be read or has none.
    """
    pictures = [path for path in _files(folder, is_picture_name) if not is_ours(path)]
    if not pictures:
        raise InputError(f"{folder}: holds no pictures; give a folder with PNG, JPEG or other picture files")
    return pictures


def match_folders(references: Path, candidates: Path) -> tuple[list[tuple[Path, Path]], list[Path], list[Path]]:
    """Pairs of the pictures of one folder and the SVGs, or else pictures, of the same stem in another; the pictures
    without such a candidate; and candidates without a picture.

    Raises InputError where the folders are one, cannot be read, or a stem is not unique in one of them.
    """
    if references.resolve() == candidates.resolve():
        raise InputError(f"{references}: is both the reference and the candidate; give two folders")
    pictures = _by_stem(pictures_in(references))
    rasters = _files(candidates, is_picture_name)
    drawings = _by_stem(_files(candidates, lambda path: path.suffix.lower() in SVG_SUFFIXES))
    # Beside each SVG that `vectorize` writes lies its picture.
    results = _by_stem([path for path in rasters if path.stem not in drawings]) | drawings
    pairs = [(path, results[stem]) for stem, path in pictures.items() if stem in results]
    if not pairs:
        raise InputError(f"no file in {candidates} has the name of a picture in {references}; check the folders")
    missing = [path for stem, path in pictures.items() if stem not in results]
    return pairs, missing, [path for stem, path in results.items() if stem not in pictures]


def _files(folder: Path, is_one: Callable[[Path], bool]) -> list[Path]:
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
