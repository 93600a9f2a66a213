"""Two folders whose files belong together by stem: the references, and what was made of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.names import SVG_SUFFIXES, is_picture_name
from cubicsplat_cli.files.ownership import is_ours


@dataclass
class Matches:
    """pairs: (reference, candidate). missing: references without a candidate. extra: candidates without one."""

    pairs: list[tuple[Path, Path]] = field(default_factory=list)
    missing: list[Path] = field(default_factory=list)
    extra: list[Path] = field(default_factory=list)


def pictures_in(folder: Path) -> list[Path]:
    """The picture files right in a folder, by name, less those that cubicsplat drew itself.

    Raises InputError where the folder cannot be read or has none.
    """
    found = [path for path in _files(folder, is_picture_name) if not is_ours(path)]
    if not found:
        raise InputError(f"{folder}: holds no pictures; give a folder with PNG, JPEG or other picture files")
    return found


def match_folders(references: Path, candidates: Path) -> Matches:
    """Pairs the pictures of one folder with the SVGs, or else pictures, of the same stem in another.

    Raises InputError where the folders are one, cannot be read, or a stem is not unique in one of them.
    """
    if references.resolve() == candidates.resolve():
        raise InputError(f"{references}: is both the reference and the candidate; give two folders")
    wanted = _by_stem(pictures_in(references))
    rasters = _files(candidates, is_picture_name)
    drawings = _by_stem(_files(candidates, lambda path: path.suffix.lower() in SVG_SUFFIXES))
    # Beside each SVG that `vectorize` writes lies its picture.
    found = _by_stem([path for path in rasters if path.stem not in drawings]) | drawings
    matches = Matches(extra=[path for stem, path in found.items() if stem not in wanted])
    for stem, path in wanted.items():
        if stem in found:
            matches.pairs.append((path, found[stem]))
        else:
            matches.missing.append(path)
    if not matches.pairs:
        raise InputError(f"no file in {candidates} has the name of a picture in {references}; check the folders")
    return matches


def _files(folder: Path, wanted: Callable[[Path], bool]) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if wanted(path) and path.is_file())
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror}); check the path") from error


def _by_stem(paths: list[Path]) -> dict[str, Path]:
    named: dict[str, Path] = {}
    for path in paths:
        if path.stem in named:
            raise InputError(f"{named[path.stem]} and {path.name} have the same stem; remove one of them")
        named[path.stem] = path
    return named
