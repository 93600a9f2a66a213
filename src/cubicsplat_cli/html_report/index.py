"""The page of many pictures: a table that can be sorted, with thumbnails, each row leading to the page of one; and the
pages of `cubicsplat eval --report`, of one pair, or of all pairs of two folders with such an index.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

import numpy as np
from PIL import Image

from cubicsplat_cli._version import __version__
from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.evaluate.rerender import rerender_untrusted
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.files.marks import PROGRAM, made_mark, sha256_of
from cubicsplat_cli.files.names import PAGE
from cubicsplat_cli.files.paths import check_outputs, is_file
from cubicsplat_cli.files.read import read_file, read_whole
from cubicsplat_cli.files.write import write_atomically
from cubicsplat_cli.formatting import counted, duration, file_size, mean, number
from cubicsplat_cli.html_report.embed import THUMBNAIL, eight_bit_pixels, rendered, thumbnail_url
from cubicsplat_cli.html_report.page import Subject, page
from cubicsplat_cli.metrics import Quality, Report
from cubicsplat_cli.record import record

if TYPE_CHECKING:
    from cubicsplat_cli.evaluate.comparison import Comparison

_HEADINGS = ("PSNR, dB", "SSIM", "shapes", "file", "time")


@record
class Entry:
    """A row. page: of the picture, None where there is none, and `error` says why. thumbnail: a data: URL. bytes: of
    the SVG or picture. shapes: None where they were not counted. seconds: None where nothing was made.
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
    """The row of a picture that was vectorised; its thumbnail shows the SVG."""
    if png is not None and is_file(png):
        with Image.open(png) as image:
            image.draft("RGB", (THUMBNAIL, THUMBNAIL))
            thumbnail = thumbnail_url(np.asarray(image.convert("RGBA")))
    else:
        thumbnail = svg_thumbnail(read_file(svg), str(svg), report.input.width, report.input.height)
    return Entry(
        name,
        page,
        thumbnail,
        report.style,
        None if report.quality is None else report.quality.svg,
        report.output.bytes,
        report.count(),
        report.timing.total_s,
    )


def svg_thumbnail(svg: bytes, source: str, width: int, height: int) -> str:
    """A data: URL of an SVG in the shape width x height. Raises what drawing it raises."""
    factor = min(1.0, THUMBNAIL / max(width, height))
    size = max(1, round(width * factor)), max(1, round(height * factor))
    drawn, _ = rerender_untrusted(svg, source=source, width=size[0], height=size[1])
    return thumbnail_url(drawn.pixels)


def index(path: Path, entries: Sequence[Entry], title: str) -> bytes:
    """The HTML file that will be at `path`, which the links start from."""
    qualities = [entry.quality for entry in entries if entry.quality is not None]
    done = [entry for entry in entries if entry.page is not None]
    sizes = [entry.bytes for entry in entries if entry.bytes is not None]
    facts = [("pictures", f"{len(done):,}", f"{len(entries) - len(done)} failed" if len(done) < len(entries) else "")]
    for name, level, decimals in (
        ("mean PSNR", mean(quality.psnr_db for quality in qualities), 2),
        ("mean SSIM", mean(quality.ssim for quality in qualities), 3),
    ):
        facts += [] if level is None else [(name, number(level, decimals) + (" dB" if "PSNR" in name else ""), "")]
    facts += [("files", file_size(sum(sizes)), "")] if sizes else []
    seconds = [entry.seconds for entry in entries if entry.seconds is not None]
    facts += [("time", duration(sum(seconds)), "of all together")] if seconds else []
    text = rendered(
        "index.html",
        mark=made_mark(counted(len(entries), "picture")),
        title=title,
        facts=facts,
        headings=list(_HEADINGS),
        rows=[_row(path, entry) for entry in entries],
        program=PROGRAM,
        version=__version__,
    )
    return text.encode()


def _row(index_path: Path, entry: Entry) -> dict[str, object]:
    """Link, name, thumbnail, and cells as (what to sort by, text)."""
    quality = entry.quality
    level = None if quality is None else quality.psnr_db
    same = quality is not None and quality.identical
    cells = [
        (float("inf") if same else level, "identical" if same else number(level, 2)),
        (None if quality is None else quality.ssim, number(None if quality is None else quality.ssim, 4)),
        (entry.shapes, "-" if entry.shapes is None else f"{entry.shapes:,}"),
        (entry.bytes, "-" if entry.bytes is None else file_size(entry.bytes)),
        (entry.seconds, "-" if entry.seconds is None else duration(entry.seconds)),
    ]
    return {
        "link": None if entry.page is None else _link(index_path, entry.page),
        "name": entry.name,
        "style": entry.style,
        "thumbnail": entry.thumbnail,
        "error": entry.error.removeprefix(f"{entry.name}: "),
        "cells": [("" if value is None else f"{value:g}", text) for value, text in cells],
    }


def _link(index_path: Path, page: Path) -> str:
    """The page as seen from the index, as a relative URL."""
    relative = os.path.relpath(page.absolute(), index_path.absolute().parent)
    return quote("./" + Path(relative).as_posix())


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
    candidate, reference = comparison.candidate, comparison.reference
    if candidate.kind == "svg":
        thumbnail = svg_thumbnail(candidate.data, candidate.path, reference.width, reference.height)
    else:
        thumbnail = thumbnail_url(eight_bit_pixels(load_picture(candidate.data, name=candidate.path)))
    size = Path(candidate.path).stat().st_size
    return Entry(candidate.path, page, thumbnail, quality=comparison.quality, bytes=size)
