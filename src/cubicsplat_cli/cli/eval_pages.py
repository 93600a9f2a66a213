"""The pages of `cubicsplat eval --report`: of one pair, or of all pairs of two folders with an index."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.files.marks import sha256_of
from cubicsplat_cli.files.names import PAGE
from cubicsplat_cli.files.paths import check_outputs, is_file
from cubicsplat_cli.metrics import Report

if TYPE_CHECKING:
    from cubicsplat_cli.evaluate.comparison import Comparison
    from cubicsplat_cli.html_report.index import Entry


def planned_pages(where: Path, *, folders: bool) -> Path:
    """The page of one pair, or of two folders the index beside which the pages of all pairs will lie, chosen before
    anything is compared. Raises UsageError for a name that no page can have, or of a file that cubicsplat did not
    write; InputError if nothing can be written.
    """
    if not folders:
        if where.suffix.lower() != PAGE:
            raise UsageError(f"the page must end in {PAGE}, but --report is {where}")
        check_outputs([where], force=False)
        return where
    if where.exists() and not where.is_dir():
        raise UsageError(f"--report of two folders must be a folder, not the file {where}")
    try:
        where.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{where}: folder cannot be created ({error.strerror}); choose another") from error
    return where / f"index{PAGE}"


def write_pages(
    first: Path, compared: Sequence[Comparison], failed: Sequence[tuple[Path, str]], threads: int | None, *,
    folders: bool,
) -> None:  # fmt: skip
    """Writes a page for each pair, and of two folders the index; first: of `planned_pages`."""
    from cubicsplat_cli.files.write import write_atomically
    from cubicsplat_cli.html_report.index import Entry, index

    if not folders:
        write_atomically(first, _page(compared[0], threads))
        return
    names = {id(each): first.with_name(f"{Path(each.candidate.path).name}{PAGE}") for each in compared}
    check_outputs([first, *names.values()], force=False)
    entries = []
    for each in compared:
        write_atomically(names[id(each)], _page(each, threads))
        entries.append(_entry(each, names[id(each)]))
    entries += [Entry(str(path), error=error) for path, error in failed]
    write_atomically(first, index(first, entries, first.absolute().parent.name))


def _page(comparison: Comparison, threads: int | None) -> bytes:
    from cubicsplat_cli.files.load import load_picture
    from cubicsplat_cli.files.read import read_whole
    from cubicsplat_cli.html_report.page import Subject, page

    candidate = comparison.candidate
    path = Path(candidate.path)
    subject = Subject(
        comparison.reference,
        read_whole(Path(comparison.reference_path)),
        path.name,
        candidate.data,
        comparison.quality,
        candidate.renderer,
        _made_with(path, candidate.data),
        sha256_of(candidate.data),
        path.stat().st_size if is_file(path) else len(candidate.data),
        raster=None if candidate.kind == "svg" else load_picture(candidate.data, name=candidate.path),
        notes=tuple(comparison.notes),
    )
    return page(subject, threads)


def _made_with(path: Path, data: bytes) -> Report | None:
    """The report of the run that made an SVG: the JSON beside it, where that is about this very file."""
    beside = path.with_suffix(".json")
    if not is_file(beside):
        return None
    try:
        report = Report.from_json(beside.read_bytes())
    except (OSError, ValueError):
        return None  # it is about something else
    return report if report.output.svg_sha256 in (sha256_of(data), sha256_of(path.read_bytes())) else None


def _entry(comparison: Comparison, page: Path) -> Entry:
    from cubicsplat_cli.files.load import load_picture
    from cubicsplat_cli.html_report.embed import eight_bit_pixels, thumbnail_url
    from cubicsplat_cli.html_report.index import Entry, svg_thumbnail

    candidate, reference = comparison.candidate, comparison.reference
    if candidate.kind == "svg":
        thumbnail = svg_thumbnail(candidate.data, candidate.path, reference.width, reference.height)
    else:
        thumbnail = thumbnail_url(eight_bit_pixels(load_picture(candidate.data, name=candidate.path)))
    size = Path(candidate.path).stat().st_size
    return Entry(candidate.path, page, thumbnail, quality=comparison.quality, bytes=size)
