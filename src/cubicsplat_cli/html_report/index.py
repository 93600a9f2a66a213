"""The page of many pictures: a table that can be sorted, with thumbnails, each row leading to the page of one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

import numpy as np
from PIL import Image

from cubicsplat_cli._version import __version__
from cubicsplat_cli.evaluate.rerender import rerender_untrusted
from cubicsplat_cli.files.marks import PROGRAM, made_mark
from cubicsplat_cli.files.paths import is_file
from cubicsplat_cli.files.read import read_file
from cubicsplat_cli.formatting import counted, duration, file_size, mean, number
from cubicsplat_cli.html_report.embed import THUMBNAIL, rendered, thumbnail_url
from cubicsplat_cli.metrics import Quality, Report
from cubicsplat_cli.record import record

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
