"""Find the pictures that files, patterns and folders name."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.files.names import STDIO, is_heic_name, is_picture_name, reads_heic
from cubicsplat_cli.files.paths import is_folder, is_ours
from cubicsplat_cli.record import record

_SEPARATORS = re.escape(os.sep + (os.altsep or ""))
_ANY_DEPTH = re.compile(rf"(?:(?<![^{_SEPARATORS}])\*\*(?:[{_SEPARATORS}]+|$))+")  # `**`, or several, in a pattern


@record
class Source:
    """One picture: its path, and the folder below an output folder that mirrors where it was found."""

    path: Path
    below: Path = Path()


@dataclass(eq=False)
class PictureSearch:
    """Result of a search: pictures in a fixed order, and by name the arguments that failed."""

    sources: list[Source] = field(default_factory=list)
    problems: list[tuple[str, InputError]] = field(default_factory=list)
    left_out: dict[str, list[Path]] = field(default_factory=dict)

    def leave_out(self, path: Path, reason: str) -> None:
        """Note a file that is not taken, and why."""
        self.left_out.setdefault(reason, []).append(path)


def is_batch(arguments: list[str]) -> bool:
    """Whether the arguments may mean more than one picture: several, a folder, or a pattern."""
    first = arguments[0]
    return len(arguments) > 1 or (first != STDIO and (is_folder(Path(first)) or _is_pattern(first)))


def find_sources(arguments: list[str], *, recursive: bool) -> PictureSearch:
    """Follow every argument: a file as it is, a folder to the pictures in it (with `recursive` at any depth), and a
    pattern (`*`, `?`, `[]`, `**`) that no shell has resolved to the files that match.

    Each picture comes once. Pictures that cubicsplat itself drew are left out, so that a second run over a folder
    does not vectorise the results of the first. Raises UsageError for standard input among other arguments.
    """
    if STDIO in arguments:
        raise UsageError("standard input (-) can only be the one input; name files and folders in another run")
    search = PictureSearch()
    for argument in arguments:
        path = Path(argument)
        if is_folder(path):
            _take_folder(path, recursive, search)
        elif _is_pattern(argument):
            _take_pattern(argument, search)
        else:
            _take_file(Source(path), search)
    once: dict[Path, Source] = {}
    for source in search.sources:
        once.setdefault(source.path.absolute(), source)
    search.sources = list(once.values())
    return search


def _is_pattern(argument: str) -> bool:
    return glob.has_magic(argument) and not os.path.lexists(argument)


def _take_file(source: Source, search: PictureSearch) -> None:
    if is_ours(source.path):
        search.leave_out(source.path, "drawn by cubicsplat itself")
    else:
        search.sources.append(source)


def _take_pattern(pattern: str, search: PictureSearch) -> None:
    matches = sorted({path for path in _matching(pattern) if not is_folder(path)})
    if not matches:
        search.problems.append((pattern, InputError(f"{pattern}: no file matches; check the pattern")))
    for path in matches:
        _take_file(Source(path), search)


def _matching(pattern: str) -> Iterator[Path]:
    """Paths that match a pattern. `**` is any number of folders, but no hidden ones and no links: `glob` follows links,
    and never ends if they form a cycle.
    """
    before, *after = _ANY_DEPTH.split(pattern, maxsplit=1)
    if not after:
        yield from map(Path, glob.glob(pattern))  # noqa: PTH207 (Path.glob takes no absolute patterns)
        return
    for top in glob.glob(before) if before else [os.curdir]:  # noqa: PTH207
        for place, folders, _ in os.walk(top):
            folders[:] = [name for name in folders if not name.startswith(".")]
            for path in _matching(os.path.join(glob.escape(place), after[0] or "*")):  # noqa: PTH118
                inside = list(path.relative_to(top).parents)[:-1]
                if not any(Path(top, folder).is_symlink() for folder in inside):
                    yield path


def _take_folder(folder: Path, recursive: bool, search: PictureSearch) -> None:
    def unreadable(error: OSError) -> None:
        message = f"{error.filename}: folder cannot be read ({error.strerror}); check its permissions"
        search.problems.append((str(error.filename), InputError(message)))

    count, deeper = 0, False
    for place, folders, files in os.walk(folder, onerror=unreadable):
        # Hidden folders hold caches and version control, no pictures of the user.
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(files):
            path = Path(place, name)
            if is_picture_name(path) or (is_heic_name(path) and reads_heic()):
                count += 1
                _take_file(Source(path, Path(place).relative_to(folder)), search)
            elif is_heic_name(path):
                search.leave_out(path, "HEIC, which pip install pillow-heif has read")
            elif not name.startswith(".") and not is_ours(path):
                search.leave_out(path, "not a picture by its name")
        if not recursive:
            deeper = bool(folders)
            break
    if count == 0 and not search.problems:
        hint = "with -r the folders in it are searched too" if deeper else "give a folder with pictures"
        search.problems.append((str(folder), InputError(f"{folder}: is a folder without pictures; {hint}")))
