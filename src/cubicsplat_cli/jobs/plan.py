"""Jobs: the pictures that files, patterns and folders name, and the files that each picture becomes."""

from __future__ import annotations

import glob
import itertools
import os
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from cubicsplat_cli.errors import CubicSplatError, InputError, UsageError
from cubicsplat_cli.files.names import (
    COMPRESSED,
    PAGE,
    PLAIN,
    STDIO,
    Outputs,
    is_heic_name,
    is_picture_name,
    names_a_folder,
    outputs_beside,
    place_for,
    plan_outputs,
    reads_heic,
)
from cubicsplat_cli.files.paths import format_of, is_folder, is_ours, is_svg, is_there, make_folder_of
from cubicsplat_cli.files.read import read_whole
from cubicsplat_cli.formatting import printable
from cubicsplat_cli.record import record
from cubicsplat_cli.request import Request

_SEPARATORS = re.escape(os.sep + (os.altsep or ""))
_ANY_DEPTH = re.compile(rf"(?:(?<![^{_SEPARATORS}])\*\*(?:[{_SEPARATORS}]+|$))+")  # `**`, or several, in a pattern


@dataclass(frozen=True)
class Job:
    """One picture to vectorise. name: as the user named it, for messages and reports. path: None for standard input,
    whose bytes are `data`. below: the picture's folder, relative to the one that the user named. mask: its own.
    """

    name: str
    path: Path | None
    outputs: Outputs
    data: bytes | None = None
    below: Path = Path()
    mask: Path | None = None

    def source(self) -> bytes:
        """Return the bytes of the picture's file. Raises InputError where they cannot be read."""
        if self.path is None or self.data is not None:
            return self.data or b""
        return read_whole(self.path)

    def request(self, request: Request) -> Request:
        """Return the request for this picture, with the picture's own mask. Raises InputError if that is no mask."""
        if self.mask is None:
            return request
        from cubicsplat_cli.files.weights import load_mask

        return replace(request, masks=None, weights=load_mask(self.mask, max_pixels=request.max_pixels))


@record
class JobPlan:
    """The jobs of one command, in a fixed order. problems: name and error of each argument without a picture. left_out:
    pictures that were not taken, by the reason. index: the page that links the pages of all pictures, if they have any.
    """

    jobs: list[Job]
    problems: list[tuple[str, CubicSplatError]] = field(default_factory=list)
    left_out: Mapping[str, list[Path]] = field(default_factory=dict)
    index: Path | None = None

    @property
    def pictures(self) -> int:
        """The number of outcomes to expect."""
        return len(self.jobs) + len(self.problems)


def plan(arguments: list[str], output: str | None, request: Request, *, recursive: bool) -> JobPlan:
    """Return a job for each picture of the arguments. Raises UsageError where they make no sense together."""
    first = arguments[0]
    if len(arguments) > 1 or (first != STDIO and (is_folder(Path(first)) or _is_pattern(first))):
        for name in ("animation", "geometrize"):
            if getattr(request, name) is not None:
                raise UsageError(f"--{name} is of one picture, and there may be several; give one")
        search = find_sources(arguments, recursive=recursive)
        jobs = plan_jobs([*search.sources.values()], output, request)
        return _with_others(JobPlan(jobs, search.problems, search.left_out), output, request)
    path = None if first == STDIO else Path(first)
    if path is not None and is_svg(path):
        raise InputError(f"{printable(first)}: is an SVG or XML file, already vector; give a raster picture")
    outputs = plan_outputs(path, output, request)
    if request.geometrize and outputs.metrics and _key(request.geometrize) == _key(outputs.metrics):
        raise UsageError(f"{outputs.metrics} will hold the figures; give --geometrize another name, or add --no-json")
    outputs = replace(outputs, animation=request.animation, geometrize=request.geometrize)
    return _with_others(JobPlan([Job(first, path, outputs)]), output, request)


def _with_others(made: JobPlan, output: str | None, request: Request) -> JobPlan:
    """Return the plan with the files made of finished SVGs: exports, layers and pages, with an index of several pages.

    Raises UsageError where an SVG goes to standard output, the folder of layers is a file, or two pictures would have
    layers of one name.
    """
    for given, need in (
        (request.also, "--also needs a file beside which the others can lie; give one with -o"),
        (request.layers, "--layers needs an SVG of which they are made; give a file with -o"),
        (request.html_report, "--report needs a file beside which the page can lie; give one with -o"),
    ):
        if given and any(job.outputs.svg is None for job in made.jobs):
            raise UsageError(need)
    folder = request.layers
    if folder is not None and is_there(folder) and not is_folder(folder):
        raise UsageError(f"--layers {folder} is a file; give a folder")
    jobs = [replace(job, outputs=job.outputs.with_others(request, job.below)) for job in made.jobs]
    _check_distinct(((job.outputs.layers, job.name) for job in jobs), "{}-...; use two runs with other --layers")
    pages = [job.outputs.html_report for job in jobs if job.outputs.html_report is not None]
    if made.pictures == 1 or not pages:
        return replace(made, jobs=jobs)
    beside = Path(os.path.commonpath([page.parent for page in pages])) if output is None else Path(output)
    # A picture may be called index itself.
    names = (beside / f"index{'' if number == 1 else f'-{number}'}{PAGE}" for number in itertools.count(1))
    return replace(made, jobs=jobs, index=next(path for path in names if path not in pages))


def _check_distinct(places: Iterable[tuple[Path | None, str]], said: str) -> None:
    """Raise UsageError where two pictures, by their names, have one place. said: the place, in braces, and advice."""
    claimed: dict[str, str] = {}
    for place, name in places:
        if place is not None and (other := claimed.setdefault(_key(place), name)) is not name:
            raise UsageError(f"{other} and {name} would both give {said.format(place)}")


def plan_jobs(sources: list[tuple[Path, Path]], output: str | None, request: Request) -> list[Job]:
    """Return a job for each picture: its files lie beside it, or in a mirror of its folders below `output`.

    Pictures that differ in their suffix alone (`a.png` and `a.jpg`) would give the same files. The names of their files
    contain the suffix (`a.png.svg`, `a.jpg.svg`), unless a picture has the short name from an earlier run. Raises
    UsageError where two pictures would still give one file, or where `output` cannot be a folder.

    sources: as the values in a `PictureSearch`.
    """
    _check_folder(output)
    suffix = request.suffix + (COMPRESSED if request.compress else PLAIN)
    folders = [path.parent if output is None else Path(output) / below for path, below in sources]
    stems = [_key(folder / path.stem) for (path, _), folder in zip(sources, folders, strict=True)]
    count = Counter(stems)
    jobs = []
    for (path, below), folder, stem in zip(sources, folders, stems, strict=True):
        svg = place_for(path, folder, suffix, shared=count[stem] > 1)
        jobs.append(Job(str(path), path, outputs_beside(svg, png=request.png, metrics=request.metrics), below=below))
    _check_distinct(((job.outputs.svg, job.name) for job in jobs), "{}; use two runs with different folders")
    return jobs


def _check_folder(output: str | None) -> None:
    """Raise UsageError where `-o` of several pictures is no folder, or has the suffix of one picture's result."""
    if output is None:
        return
    if output == STDIO:
        raise UsageError("-o - takes the SVG of one picture; give a folder for several")
    path = Path(output)
    if is_there(path) and not is_folder(path):
        raise UsageError(f"-o {output} is a file; give a folder for the results of several pictures")
    of_one = path.suffix.lower() in (PLAIN, COMPRESSED) or format_of(path) is not None
    if of_one and not names_a_folder(output):
        raise UsageError(f"-o {output} is for one picture that you name; give a folder for several or for a folder")


def _key(path: Path) -> str:
    """Return a text that is the same for names that are one file on some file systems."""
    return str(path.absolute()).casefold()


def make_folders(job: Job) -> None:
    """Make the folders of a job's files. Raises InputError where that cannot be done."""
    for path in [*job.outputs.files(), *([job.outputs.layers] if job.outputs.layers else [])]:
        make_folder_of(path)


def with_masks(made: JobPlan, folder: Path) -> JobPlan:
    """Return the plan with the masks of the pictures. A mask has its picture's name, with any suffix, and lies below
    `folder` as the picture lies below its own folder. Raises UsageError where no picture has a mask, or one has two.
    """
    listed: dict[Path, list[Path]] = {}
    jobs = [replace(job, mask=_mask_of(job, folder, listed)) for job in made.jobs]
    if jobs and not any(job.mask for job in jobs):
        raise UsageError(f"has no picture of the name of {jobs[0].name} in {folder}, nor of any other", "weights")
    return replace(made, jobs=jobs)


def _mask_of(job: Job, folder: Path, listed: dict[Path, list[Path]]) -> Path | None:
    if job.path is None:
        return None
    place = folder / job.below
    if place not in listed:
        listed[place] = sorted(path for path in place.iterdir() if is_picture_name(path)) if place.is_dir() else []
    masks = [path for path in listed[place] if path.stem == job.path.stem]
    same = [path for path in masks if path.name == job.path.name]
    if len(masks) > 1 and not same:
        raise UsageError(f"has two masks for {job.name}, {masks[0]} and {masks[1]}; take one away", "weights")
    return next(iter(same or masks), None)


@dataclass(eq=False)
class PictureSearch:
    """The result of a search. sources: of each picture, by its absolute path and in a fixed order, its path and the
    folder below an output folder that mirrors where it was found. problems, left_out: as in a `JobPlan`.
    """

    sources: dict[Path, tuple[Path, Path]] = field(default_factory=dict)
    problems: list[tuple[str, CubicSplatError]] = field(default_factory=list)
    left_out: dict[str, list[Path]] = field(default_factory=lambda: defaultdict(list))


def find_sources(arguments: list[str], *, recursive: bool) -> PictureSearch:
    """Find the pictures of all arguments, each picture once: files, the pictures of a folder (with `recursive` at any
    depth), and the matches of a pattern (`*`, `?`, `[]`, `**`) that the shell has not expanded.

    Pictures that cubicsplat itself drew are left out, so that a second run over a folder does not vectorise the results
    of the first. Raises UsageError for standard input among other arguments.
    """
    if STDIO in arguments:
        raise UsageError("standard input (-) can only be the one input; name files and folders in another run")
    search = PictureSearch()
    for argument in arguments:
        path = Path(argument)
        if is_folder(path):
            _take_folder(path, recursive, search)
        elif _is_pattern(argument):
            matches = sorted({match for match in _matching(argument) if not is_folder(match)})
            if not matches:
                search.problems.append((argument, InputError(f"{argument}: no file matches; check the pattern")))
            for match in matches:
                _take_file(match, search)
        else:
            _take_file(path, search)
    return search


def _is_pattern(argument: str) -> bool:
    return glob.has_magic(argument) and not os.path.lexists(argument)


def _take_file(path: Path, search: PictureSearch, below: Path = Path()) -> None:
    if is_ours(path):
        search.left_out["drawn by cubicsplat itself"].append(path)
    else:
        search.sources.setdefault(path.absolute(), (path, below))


def _matching(pattern: str) -> Iterator[Path]:
    """Yield the paths that match a pattern. `**` is any number of folders that are neither hidden nor links: `glob`
    follows links, and never ends if they form a cycle.
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
        # Hidden folders hold caches and version control, not the user's pictures.
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(files):
            path = Path(place, name)
            if is_picture_name(path) or (is_heic_name(path) and reads_heic()):
                count += 1
                _take_file(path, search, Path(place).relative_to(folder))
            elif is_heic_name(path):
                search.left_out["HEIC, which pip install pillow-heif has read"].append(path)
            elif not name.startswith(".") and not is_ours(path):
                search.left_out["not a picture by its name"].append(path)
        if not recursive:
            deeper = bool(folders)
            break
    if count == 0 and not search.problems:
        hint = "with -r the folders in it are searched too" if deeper else "give a folder with pictures"
        search.problems.append((str(folder), InputError(f"{folder}: is a folder without pictures; {hint}")))
