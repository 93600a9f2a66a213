"""The index of many pictures: a table with thumbnails, which can be sorted and links a page for each picture; and the
pages of `cubicsplat eval --report` about one pair, or about all pairs of two folders with an index.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

import numpy as np
from PIL import Image

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.evaluate.comparison import Comparison
from cubicsplat_cli.evaluate.rerender import rerender_untrusted
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.files.marks import made_mark, sha256_of
from cubicsplat_cli.files.names import PAGE
from cubicsplat_cli.files.paths import check_outputs, is_file
from cubicsplat_cli.files.read import read_file, read_whole
from cubicsplat_cli.files.write import write_atomically
from cubicsplat_cli.formatting import counted, duration, file_size, mean, number
from cubicsplat_cli.html_report.embed import THUMBNAIL, rendered, thumbnail_url
from cubicsplat_cli.html_report.page import Subject, page
from cubicsplat_cli.metrics import Quality, Report
from cubicsplat_cli.record import record


@record
class Entry:
    """A row. page: of the picture; None if there is none, for the reason in `error`. thumbnail: a data: URL. bytes: of
    the SVG or picture. shapes: None if they were not counted. seconds: None if nothing was made.
    """

    name: str
    page: Path | None = None
    thumbnail: str | None = None
    style: str = ""
    quality: Quality | None = None
    bytes: int | None = None
    shapes: int | None = None
    seconds: float | None = None
    error: str = ""


def entry_of(name: str, page: Path, report: Report, png: Path | None, svg: Path) -> Entry:
    """Return the row of a vectorised picture, with a thumbnail of the SVG."""
    if png is not None and is_file(png):
        with Image.open(png) as image:
            thumbnail = thumbnail_url(np.asarray(image.convert("RGBA")))
    else:
        thumbnail = svg_thumbnail(read_file(svg), str(svg), report.input.width, report.input.height)
    quality, size = None if report.quality is None else report.quality.svg, report.output.bytes
    return Entry(name, page, thumbnail, report.style, quality, size, report.count(), report.timing.total_s)


def svg_thumbnail(svg: bytes, source: str, width: int, height: int) -> str:
    """Return a data: URL of an SVG in the shape width x height. Raises the errors of drawing it."""
    factor = min(1.0, THUMBNAIL / max(width, height))
    size = max(1, round(width * factor)), max(1, round(height * factor))
    drawn, _ = rerender_untrusted(svg, source=source, width=size[0], height=size[1])
    return thumbnail_url(drawn.pixels)


def index(path: Path, entries: Sequence[Entry], title: str) -> bytes:
    """Return the HTML file for `path`, where its relative links start."""
    qualities = [entry.quality for entry in entries if entry.quality is not None]
    done = [entry for entry in entries if entry.page is not None]
    sizes = [entry.bytes for entry in entries if entry.bytes is not None]
    facts = [("pictures", f"{len(done):,}", f"{len(entries) - len(done)} failed" if len(done) < len(entries) else "")]
    decibels, similarity = mean(quality.psnr_db for quality in qualities), mean(quality.ssim for quality in qualities)
    facts += [] if decibels is None else [("mean PSNR", f"{number(decibels, 2)} dB", "")]
    facts += [] if similarity is None else [("mean SSIM", number(similarity, 3), "")]
    facts += [("files", file_size(sum(sizes)), "")] if sizes else []
    seconds = [entry.seconds for entry in entries if entry.seconds is not None]
    facts += [("time", duration(sum(seconds)), "of all together")] if seconds else []
    mark = made_mark(counted(len(entries), "picture"))
    headings = ["PSNR, dB", "SSIM", "shapes", "file", "time"]
    rows = [_row(path, entry) for entry in entries]
    return rendered("index.html", mark=mark, title=title, facts=facts, headings=headings, rows=rows)


def _row(index_path: Path, entry: Entry) -> tuple[Entry, str | None, list[tuple[str, str]]]:
    """Return an entry, the link to its page, and cells as (number to sort by, text)."""
    quality, link = entry.quality, None
    if entry.page is not None:
        relative = os.path.relpath(entry.page.absolute(), index_path.absolute().parent)
        link = quote("./" + Path(relative).as_posix())
    level, similarity = (None, None) if quality is None else (quality.psnr_db, quality.ssim)
    same = quality is not None and quality.identical
    cells = [
        (float("inf") if same else level, "identical" if same else number(level, 2)),
        (similarity, number(similarity, 4)),
        (entry.shapes, "-" if entry.shapes is None else f"{entry.shapes:,}"),
        (entry.bytes, "-" if entry.bytes is None else file_size(entry.bytes)),
        (entry.seconds, "-" if entry.seconds is None else duration(entry.seconds)),
    ]
    return entry, link, [("" if value is None else f"{value:g}", text) for value, text in cells]


def planned_pages(where: Path, *, folders: bool) -> Path:
    """Return the path of the page of one pair, or of the index of two folders, beside which the pages of all pairs lie.

    Raises UsageError for a name that no page can have, or of a file that cubicsplat did not write; InputError if
    nothing can be written.
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
    """Write a page for each pair, and the index of two folders. first: from `planned_pages`."""
    if not folders:
        write_atomically(first, _page(compared[0], threads))
        return
    pages = [first.with_name(f"{Path(each.path).name}{PAGE}") for each in compared]
    check_outputs([first, *pages], force=False)
    entries = []
    for each, path in zip(compared, pages, strict=True):
        write_atomically(path, _page(each, threads))
        entries.append(_entry(each, path))
    entries += [Entry(str(path), error=error) for path, error in failed]
    write_atomically(first, index(first, entries, first.absolute().parent.name))


def _page(comparison: Comparison, threads: int | None) -> bytes:
    path = Path(comparison.path)
    subject = Subject(
        comparison.reference,
        read_whole(Path(comparison.reference_path)),
        path.name,
        comparison.data,
        comparison.quality,
        comparison.renderer,
        _made_with(path, comparison.data),
        sha256_of(comparison.data),
        path.stat().st_size if is_file(path) else len(comparison.data),
        raster=None if comparison.kind == "svg" else load_picture(comparison.data, name=comparison.path),
        notes=tuple(comparison.notes),
    )
    return page(subject, threads)


def _made_with(path: Path, data: bytes) -> Report | None:
    """Return the report of the run that made an SVG: the JSON beside it, if it is about the same file."""
    report = Report.in_file(path.with_suffix(".json"))
    same = report and report.output.svg_sha256 in (sha256_of(data), sha256_of(path.read_bytes()))
    return report if same else None


def _entry(comparison: Comparison, page: Path) -> Entry:
    reference = comparison.reference
    if comparison.kind == "svg":
        thumbnail = svg_thumbnail(comparison.data, comparison.path, reference.width, reference.height)
    else:
        thumbnail = thumbnail_url(load_picture(comparison.data, name=comparison.path).pixels())
    size = Path(comparison.path).stat().st_size
    return Entry(comparison.path, page, thumbnail, quality=comparison.quality, bytes=size)
