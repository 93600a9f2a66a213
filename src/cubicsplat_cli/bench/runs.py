"""Fits of the pictures of a folder, one after the other; a bad picture is reported, and the others are fitted."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import cubicsplat_cli
from cubicsplat_cli._version import __version__
from cubicsplat_cli.errors import CubicSplatError
from cubicsplat_cli.files.load import Picture, load_picture
from cubicsplat_cli.files.marks import settings_hash, sha256_of
from cubicsplat_cli.files.write import write_atomically
from cubicsplat_cli.formatting import level_text, one_line
from cubicsplat_cli.metrics import Report
from cubicsplat_cli.pipeline.task import Result
from cubicsplat_cli.pipeline.vectorize import vectorize_picture
from cubicsplat_cli.progress import OnProgress
from cubicsplat_cli.record import record
from cubicsplat_cli.request import PHOTO_PRECISION, Request
from cubicsplat_cli.settings import FitSettings

Watch = Callable[[str], AbstractContextManager[OnProgress | None]]


@record
class FitJob:
    """One fit: its picture, its settings, and the configuration of the benchmark to which it belongs."""

    path: Path
    configuration: str
    settings: FitSettings


@record
class FitFigures:
    """Figures of one fitted picture. psnr_db, ssim: of the SVG file, drawn by `renderer`. own_psnr_db: of the engine's
    picture. agreement_db: between the two pictures. gap_db: own minus SVG. seconds: with writing and measuring.
    """

    picture: str
    configuration: str
    mode: str
    curves: int
    psnr_db: float | None
    ssim: float | None
    own_psnr_db: float | None
    agreement_db: float | None
    gap_db: float | None
    seconds: float
    fit_seconds: float
    steps: int
    bytes: int
    paths: int
    renderer: str
    cached: bool


@dataclass(eq=False)
class Runs:
    """Results: figures and SVG of each fit, and failures as (picture, configuration, error); the configuration is empty
    if the picture cannot be read.
    """

    done: list[tuple[FitFigures, bytes]] = field(default_factory=list)
    failed: list[tuple[str, str, str]] = field(default_factory=list)

    def of(self, configuration: str) -> list[FitFigures]:
        """Return the figures of one configuration, in the order of the pictures."""
        return [run for run, _ in self.done if run.configuration == configuration]

    def failures(self) -> list[dict[str, str]]:
        """Return the failures as members of a JSON report."""
        return [dict(zip(("picture", "configuration", "error"), failure, strict=True)) for failure in self.failed]


def run_all(
    fits: Iterable[FitJob],
    cache: Path | None,
    watch: Watch,
    tell: Callable[[str], None],
    vectorized: Callable[..., Result] | None = None,
) -> Runs:
    """Do every fit, or take it from the cache.

    watch: makes the progress callback of a fit, a context manager of its name. tell: gets a line per picture.
    vectorized: carries out a fit (default: `vectorize_picture`). Raises KeyboardInterrupt if a fit is interrupted;
    earlier fits are in the cache.
    """
    runs = Runs()
    unreadable: set[Path] = set()
    for fit in fits:
        if fit.path in unreadable:
            continue
        configuration = ""
        try:
            picture = load_picture(fit.path)
            configuration = fit.configuration
            run, svg = _run(fit, picture, cache, watch, vectorized or vectorize_picture)
        except CubicSplatError as error:
            if not configuration:
                unreadable.add(fit.path)
            runs.failed.append((fit.path.name, configuration, one_line(error)))
            tell(f"{', '.join(filter(None, runs.failed[-1][:2]))}: failed: {one_line(error)}")
            continue
        runs.done.append((run, svg))
        cached = "  (from the cache)" if run.cached else ""
        tell(f"{fit.path.name}, {configuration}: {level_text(run.psnr_db)}  {run.seconds:.1f} s{cached}")
    return runs


def _run(
    fit: FitJob, picture: Picture, cache: Path | None, watch: Watch, vectorized: Callable[..., Result]
) -> tuple[FitFigures, bytes]:
    entry = None if cache is None else CacheEntry(cache, fit, picture)
    if entry is not None and (kept := entry.read()) is not None:
        return _figures(fit, kept[0], cached=True), kept[1]
    with watch(f"{fit.path.name}, {fit.configuration}") as on_progress:
        request = Request(fit.settings, style="photo", precision=PHOTO_PRECISION)
        result = vectorized(picture, request, title=fit.path.name, on_progress=on_progress)
    if result.report.interrupted:
        raise KeyboardInterrupt
    if entry is not None:
        entry.write(result)
    # The figures are those of the report's file, so that they are the same from the cache.
    return _figures(fit, Report.from_json(result.report.to_json()), cached=False), result.svg.encode()


def _figures(fit: FitJob, report: Report, *, cached: bool) -> FitFigures:
    """Return the figures in the report of one picture, which was measured."""
    quality, timing = report.quality, report.timing
    assert quality is not None
    return FitFigures(
        picture=fit.path.name,
        configuration=fit.configuration,
        mode=fit.settings.mode.value,
        curves=fit.settings.curves,
        psnr_db=quality.svg.psnr_db,
        ssim=quality.svg.ssim,
        own_psnr_db=quality.surrogate.psnr_db,
        agreement_db=quality.agreement_db,
        gap_db=quality.gap_db,
        seconds=timing.total_s,
        fit_seconds=timing.fit_s,
        steps=timing.steps,
        bytes=report.output.bytes,
        paths=report.output.paths,
        renderer=quality.svg.renderer,
        cached=cached,
    )


class CacheEntry:
    """Cache files of one fit: its report and its SVG, named by a hash of everything that decides the result."""

    def __init__(self, folder: Path, fit: FitJob, picture: Picture, code: str | None = None) -> None:
        decisive = fit.settings.public() | {
            "picture": picture.sha256,
            "precision": PHOTO_PRECISION,
            "version": __version__,
            "engine": fit.settings.device,
            "code": code or code_digest(),
        }
        stem = f"{fit.path.stem}-{fit.settings.mode.value}-{fit.settings.curves}-{settings_hash(decisive)}"
        self.json, self.svg = folder / f"{stem}.json", folder / f"{stem}.svg"

    def read(self) -> tuple[Report, bytes] | None:
        """Return the cached result; None if it is missing or incomplete."""
        try:
            report, svg = Report.from_json(self.json.read_bytes()), self.svg.read_bytes()
        except (OSError, ValueError):
            return None
        return (report, svg) if report.output.svg_sha256 == sha256_of(svg) else None

    def write(self, result: Result) -> None:
        """Keep a result; the JSON comes last: without it the files do not count."""
        self.json.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(self.svg, result.svg.encode())
        write_atomically(self.json, result.report.to_json().encode())


@lru_cache(maxsize=1)
def code_digest() -> str:
    """Return the SHA-256 of the files that decide a result, which tells results of other code apart."""
    digest = hashlib.sha256()
    root = Path(cubicsplat_cli.__file__).parent
    for package in ("photo", "raster", "svg", "evaluate"):
        for path in sorted((root / package).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
