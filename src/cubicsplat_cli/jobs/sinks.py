"""Destinations of the finished files of a job: the disk, or memory for another machine."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from cubicsplat_cli.files.paths import is_file, is_replaceable
from cubicsplat_cli.files.write import write_stdout
from cubicsplat_cli.jobs.earlier import forget, forget_layers, holds_edited
from cubicsplat_cli.jobs.plan import Job


class Sink(Protocol):
    """Takes the finished files of one job; `kind` is one of `Outputs.place`. written: the files on the disk so far."""

    written: list[Path]

    def put(self, kind: str, data: bytes) -> None: ...


@dataclass(eq=False)
class FileSink:
    """Writes each file whole to where the job wants it; an SVG without a place goes to standard output.

    Two runs on one output leave the files of the one that ends last: with the report, which comes last, all others are
    written again that the other run has replaced meanwhile. A run that is killed leaves no report of other files.
    """

    job: Job
    written: list[Path] = field(default_factory=list)
    files: dict[str, bytes] = field(default_factory=dict)

    def put(self, kind: str, data: bytes) -> None:
        from cubicsplat_cli.files.write import folder_locked, write_atomically

        path, svg = self.job.outputs.place(kind), self.job.outputs.svg
        if kind == "svg" and path is None:
            write_stdout(data)
        self.files[kind] = data
        with folder_locked(Path() if svg is None else svg.parent):
            replaced = self._replaced() if kind == "metrics" else {}
            if kind == "svg" or replaced:
                # From here on the report there is wrong; whoever finds none knows that the work is not done.
                forget(self.job)
            for place, content in replaced.items():
                write_atomically(place, content)
            if path is not None:
                write_atomically(path, data)
                self.written.append(path)
            if kind == "metrics":
                forget_layers(self.job, self.files)

    def _replaced(self) -> dict[Path, bytes]:
        """The files of this run in whose places lie others of ours by now, or none; an edited one stays as it is."""
        replaced = {}
        for kind, data in self.files.items():
            place = self.job.outputs.place(kind)
            if kind == "metrics" or place is None or (is_file(place) and place.read_bytes() == data):
                continue
            if is_replaceable(place) and not holds_edited(place):
                replaced[place] = data
        return replaced


@dataclass(eq=False)
class MemorySink:
    """Keeps the files, for whoever asked for them from afar."""

    files: dict[str, bytes] = field(default_factory=dict)
    written: list[Path] = field(default_factory=list)

    def put(self, kind: str, data: bytes) -> None:
        self.files[kind] = data
