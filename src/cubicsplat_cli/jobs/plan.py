"""Jobs: which picture becomes which files, with which settings, and whether that work is done already."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cubicsplat_cli.errors import CubicSplatError, InputError, UsageError
from cubicsplat_cli.files.marks import hashes_in
from cubicsplat_cli.files.names import (
    COMPRESSED,
    PLAIN,
    STDIO,
    Outputs,
    beside,
    check_outputs,
    check_ownership,
    read_head,
)
from cubicsplat_cli.files.paths import is_file, is_folder, is_there, same_file
from cubicsplat_cli.jobs.sources import Source

if TYPE_CHECKING:
    from cubicsplat_cli.fit import FitSettings


@dataclass(frozen=True)
class Request:
    """What the options ask for, the same for every input; `overrides` are fit settings given explicitly."""

    preset: str = "standard"
    overrides: dict[str, Any] = field(default_factory=dict)
    precision: int = 2
    max_size: int | None = None
    max_pixels: int = 100_000_000
    png: bool = True
    compress: bool = False
    force: bool = False

    def settings(self, threads: int | None = None) -> FitSettings:
        """The settings of the fit; `threads` instead of what was asked for. Imports torch."""
        from cubicsplat_cli.fit import FitSettings

        given = {**self.overrides} if threads is None else {**self.overrides, "threads": threads}
        return FitSettings.from_preset(self.preset, **given)

    def describe(self) -> str:
        """The settings as a line; the recipe's numbers are in the JSON. Imports torch."""
        return ", ".join(f"{name} {value}" for name, value in self.settings().public().items() if name != "recipe")

    def digest(self) -> str:
        """The settings hash that the files will carry. Imports torch."""
        from cubicsplat_cli.jobs.pipeline import all_settings, digest_of

        return digest_of(all_settings(self.settings(), precision=self.precision, max_size=self.max_size))


@dataclass(frozen=True)
class Job:
    """One picture to vectorise. path: None for standard input, whose bytes are `data`. name: for messages and
    reports.
    """

    name: str
    path: Path | None
    outputs: Outputs
    data: bytes | None = None

    @classmethod
    def named(cls, name: str) -> Job:
        """A job of which no more is known yet than how the user named it."""
        return cls(name, None, Outputs(None, None, None))

    @property
    def title(self) -> str:
        """The SVG's title."""
        return "stdin" if self.path is None else self.path.name


def plan_jobs(sources: list[Source], output: str | None, *, png: bool, compress: bool) -> list[Job]:
    """A job for each picture: its files lie beside it, or in a mirror of its folders below `output`.

    Pictures that differ in their ending alone (`a.png` and `a.jpg`) would give the same files; those get it into
    their names (`a.png.svg`, `a.jpg.svg`). Raises UsageError where two pictures still meet, or where `output` cannot
    be a folder.
    """
    if output == STDIO:
        raise UsageError("-o - takes the SVG of one picture; give a folder for several")
    if output is not None and is_there(Path(output)) and not is_folder(Path(output)):
        raise UsageError(f"-o {output} is a file; give a folder for the results of several pictures")
    suffix = COMPRESSED if compress else PLAIN
    stems = [_folder_of(source, output) / source.path.stem for source in sources]
    shared = {key for key, count in Counter(_key(stem) for stem in stems).items() if count > 1}
    claimed: dict[str, Path] = {}
    jobs = []
    for source, stem in zip(sources, stems, strict=True):
        base = stem.parent / (source.path.name if _key(stem) in shared else stem.name)
        svg = base.parent / f"{base.name}{suffix}"
        if (other := claimed.setdefault(_key(svg), source.path)) is not source.path:
            raise UsageError(f"{other} and {source.path} would both give {svg}; use two runs with different folders")
        jobs.append((source, svg))
    return [Job(str(source.path), source.path, beside(svg, png=png)) for source, svg in jobs]


def _folder_of(source: Source, output: str | None) -> Path:
    return source.path.parent if output is None else Path(output) / source.below


def _key(path: Path) -> str:
    """Equal for names that some file systems take for the same."""
    return str(path.absolute()).casefold()


def prepare(job: Job, *, force: bool, make_folders: bool) -> None:
    """Find out before the work whether the files of `job` can be written, with `make_folders` making their folders.

    Raises InputError where they cannot, UsageError where they may not: existing files that cubicsplat did not write
    are only replaced with `force`, and the input never.
    """
    check_may_write(job, force=force)
    for folder in {path.parent for path in job.outputs.files()} if make_folders else ():
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            reason = error.strerror or str(error)
            raise InputError(f"{folder}: folder cannot be created ({reason}); choose another with -o") from error
    check_outputs(job.outputs.files(), force=force)


def check_may_write(job: Job, *, force: bool) -> None:
    """The part of `prepare` that changes nothing on the disk."""
    for path in job.outputs.files():
        if job.path is not None and same_file(path, job.path):
            raise UsageError(f"{path} is the input and would be overwritten; choose another output with -o")
    check_ownership(job.outputs.files(), force=force)


def all_written(job: Job) -> bool:
    """Whether all files of `job` exist, so that asking `finished` is worth the import of torch."""
    files = job.outputs.files()
    return bool(files) and all(is_file(path) for path in files)


def finished(job: Job, digest: str) -> dict[str, Any] | None:
    """The report of an earlier run that made all files of `job` from the same input with the same settings.

    None when any file is missing, incomplete, changed since, made from another input or with other settings, or of a
    fit that was interrupted.
    """
    outputs = job.outputs
    if outputs.svg is None or outputs.report is None or not all_written(job):
        return None
    try:
        report = json.loads(outputs.report.read_bytes())
        written = report["output"]
        made_from = (report["settings_hash"], report["input"]["sha256"])
        complete = (
            report["interrupted"] is False
            and made_from == hashes_in(read_head(outputs.svg)) == (digest, _input_sha256(job))
            and _sha256(outputs.svg) == written["svg_sha256"]
            and (outputs.png is None or _sha256(outputs.png) == written["png_sha256"])
        )
    except (CubicSplatError, OSError, ValueError, KeyError, TypeError):
        # No report as this version writes it, or an input that cannot be read: the work is done anew, and says why
        # it cannot be.
        return None
    return report if complete else None


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _input_sha256(job: Job) -> str:
    from cubicsplat_cli.files.load import read_picture_file

    if job.path is None:
        return hashlib.sha256(job.data or b"").hexdigest()
    return hashlib.sha256(read_picture_file(job.path)).hexdigest()
