"""Results of jobs: of earlier runs, finished, interrupted or edited; and sinks of new files, on disk or in memory."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from cubicsplat_cli.errors import CubicSplatError, InputError, UsageError
from cubicsplat_cli.files.marks import is_edited, sha256_of
from cubicsplat_cli.files.names import SVG_SUFFIXES, outputs_beside
from cubicsplat_cli.files.paths import check_ownership, is_file, is_replaceable, is_there, read_ends
from cubicsplat_cli.files.read import unpacked
from cubicsplat_cli.files.write import check_writable, folder_locked, write_atomically, write_stdout
from cubicsplat_cli.jobs.plan import Job, make_folders
from cubicsplat_cli.metrics import Report


def prepare_files(job: Job) -> None:
    """Make the folders of a job, and raise InputError, before the work, if its files cannot be written."""
    if job.path is not None and not is_there(job.path):
        return  # reading it raises the error; no folder is made for nothing
    make_folders(job)
    for path in job.outputs.files():
        check_writable(path)


def check_may_write(job: Job, *, force: bool) -> None:
    """Raise UsageError if a file of the job is the input or, without `force`, edited or not written by cubicsplat."""
    layers = job.outputs.existing_layers()
    check_ownership([*job.outputs.files(), *layers], force=force, source=job.path)
    if force:
        return
    for path in [*edited(job), *filter(holds_edited, layers)]:
        raise UsageError(f"{path} was edited since it was made; --force replaces it, -o chooses another output")


def edited(job: Job) -> list[Path]:
    """Return the files of a job that differ from the report beside them or, without one, from the SVG's checksum."""
    report, outputs = earlier_report(job), job.outputs
    if report is None:
        return [outputs.svg] if outputs.svg is not None and holds_edited(outputs.svg) else []
    written = ((outputs.svg, report.output.svg_sha256), (outputs.png, report.output.png_sha256))
    return [path for path, digest in written if path is not None and digest and holds_edited(path, digest)]


def holds_edited(path: Path, digest: str | None = None) -> bool:
    """Return whether a file is whole and has another SHA-256 than `digest`; without one, whether an SVG of ours has
    another checksum than it says.
    """
    if not is_file(path) or (digest is None and path.suffix.lower() not in SVG_SUFFIXES):
        return False
    data = path.read_bytes()
    if not _is_whole(path, data):
        return False
    return is_edited(unpacked(data, str(path))) if digest is None else sha256_of(data) != digest


def _is_whole(path: Path, data: bytes) -> bool:
    """Return whether a file is complete; one that was cut short, as by a crash, may be replaced."""
    if path.suffix.lower() == ".png":
        return data.endswith(b"IEND\xaeB`\x82")
    try:
        return b"</svg>" in unpacked(data, str(path))  # an editor may add text after the end
    except InputError:
        return False


def forget_layers(job: Job, kinds: Iterable[str]) -> None:
    """Remove layers of an earlier run, of colours that are not among these kinds; edited layers stay."""
    kept = {job.outputs.place(kind) for kind in kinds}
    for path in job.outputs.existing_layers():
        if path not in kept and is_replaceable(path) and not holds_edited(path):
            path.unlink(missing_ok=True)


def _report_of(job: Job) -> Path | None:
    """Return the path of the JSON of an earlier run, even if this run writes none."""
    svg = job.outputs.svg
    return job.outputs.metrics or (None if svg is None else outputs_beside(svg, png=False).metrics)


def earlier_report(job: Job) -> Report | None:
    """Return the report beside the SVG; None if there is none that this version can read."""
    path = _report_of(job)
    return None if path is None else Report.in_file(path)


def finished(job: Job, digest: str) -> Report | None:
    """Return the report of an earlier run that made all results of a job from the same input with the same settings;
    None if any file is missing, incomplete or changed, or the fit was interrupted.
    """
    outputs = job.outputs
    if outputs.svg is None or not all(is_file(path) for path in outputs.results()):
        return None
    report = earlier_report(job)
    if report is None or report.interrupted or report.settings_hash != digest:
        return None
    try:
        complete = (
            report.input.sha256 == sha256_of(job.source())
            and sha256_of(outputs.svg.read_bytes()) == report.output.svg_sha256
            and (outputs.png is None or sha256_of(outputs.png.read_bytes()) == report.output.png_sha256)
            and all(
                report.output.svg_sha256.encode() in read_ends(path)
                for path in (outputs.animation, outputs.geometrize)
                if path is not None
            )
        )
    except (CubicSplatError, OSError):  # an unreadable input: the work, done anew, reports the reason
        return None
    return report if complete else None


def is_finished(job: Job) -> bool:
    """Return whether there is a finished SVG of any settings, which an interrupted fit must not replace."""
    report, svg = earlier_report(job), job.outputs.svg
    if svg is None or not is_file(svg) or svg.stat().st_size == 0:
        return False
    return job.outputs.metrics is None if report is None else not report.interrupted


@dataclass(eq=False, kw_only=True)
class Sink:
    """Keeps the files of a job, for another machine. files: by kind. written: those on the disk."""

    files: dict[str, bytes] = field(default_factory=dict)
    written: list[Path] = field(default_factory=list)

    def put(self, kind: str, data: bytes) -> None:
        self.files[kind] = data


@dataclass(eq=False)
class FileSink(Sink):
    """Writes each file whole to its place; an SVG without a place goes to standard output.

    If two runs have one output, the files of the run that ends last remain: with the report, which comes last, it
    writes again all files that the other run has replaced. A run that is killed leaves no report of other files.
    """

    job: Job

    def put(self, kind: str, data: bytes) -> None:
        path, svg = self.job.outputs.place(kind), self.job.outputs.svg
        if kind == "svg" and path is None:
            write_stdout(data)
        super().put(kind, data)
        with folder_locked(Path() if svg is None else svg.parent):
            replaced = self._replaced() if kind == "metrics" else {}
            if kind == "svg" or replaced:
                # The report of an earlier run is wrong from here on; without one the work counts as not done.
                report = _report_of(self.job)
                if report is not None and is_replaceable(report):
                    report.unlink(missing_ok=True)
            for place, content in replaced.items():
                write_atomically(place, content)
            if path is not None:
                write_atomically(path, data)
                self.written.append(path)
            if kind == "metrics":
                forget_layers(self.job, self.files)

    def _replaced(self) -> dict[Path, bytes]:
        """Return the files of this run that another run has replaced or removed; edited files stay as they are."""
        replaced = {}
        for kind, data in self.files.items():
            place = self.job.outputs.place(kind)
            if kind == "metrics" or place is None or (is_file(place) and place.read_bytes() == data):
                continue
            if is_replaceable(place) and not holds_edited(place):
                replaced[place] = data
        return replaced
