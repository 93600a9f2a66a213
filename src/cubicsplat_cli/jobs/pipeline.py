"""picture -> fit -> SVG -> independent render -> figures: the whole way for one picture, without files."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from cubicsplat_cli._version import __version__
from cubicsplat_cli.evaluate import Quality, Rendered, agreement_db, compare, compare_premultiplied, rerender
from cubicsplat_cli.evaluate.report import OutputFiles, Timing, build_report
from cubicsplat_cli.files.load import Picture, resize_picture
from cubicsplat_cli.files.marks import provenance_comment, settings_hash
from cubicsplat_cli.fit import FitResult, FitSettings, Progress, fit
from cubicsplat_cli.jobs.scaling import measurable, scaled_scene
from cubicsplat_cli.raster import render_scene
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.svg import write_svg

# What does not decide the picture on one engine: the file is the same for every number of threads.
_NOT_DECISIVE = ("device", "threads")


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fitted picture and its SVG, before anything was measured.

    scene: what was fitted, in pixels of `picture`. svg: the text of the file, uncompressed. result: what `fit`
    returned. settings: all that decides the result, for the report; digest: their hash.
    """

    picture: Picture
    scene: Scene
    result: FitResult
    svg: bytes
    settings: dict[str, Any]
    digest: str
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Measured:
    """The SVG drawn by an independent renderer, its quality, that of the renderer used for the fit, and how
    closely both agree, in dB (None: no value differs).
    """

    rendered: Rendered
    svg_quality: Quality
    surrogate: Quality
    agreement_db: float | None
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Vectorized:
    """What `vectorize` returns: the SVG's bytes, its independent render, and the metrics JSON (schema 1)."""

    svg: bytes
    rendered: Rendered
    report: dict[str, Any]
    result: FitResult


def vectorize(
    picture: Picture,
    settings: FitSettings,
    *,
    precision: int = 2,
    title: str | None = None,
    max_size: int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> Vectorized:
    """Turn a loaded picture into an SVG and measure that SVG.

    precision: decimals of the coordinates, 0..6. title: the SVG's title, by default the picture's source. max_size:
    fit a copy scaled down to at most so many pixels a side; the SVG keeps the picture's size.
    Raises UsageError for bad settings, EngineError when the engine fails, InputError when the scene cannot be
    written.
    """
    started = time.perf_counter()
    fitted = fit_to_svg(picture, settings, precision=precision, title=title, max_size=max_size, on_progress=on_progress)
    measured = measure(fitted)
    report = make_report(fitted, measured, seconds=time.perf_counter() - started, svg=fitted.svg)
    return Vectorized(fitted.svg, measured.rendered, report, fitted.result)


def all_settings(settings: FitSettings, *, precision: int, max_size: int | None) -> dict[str, Any]:
    """Everything that decides the file, and what it was computed with, as plain values."""
    return {**settings.public(), "precision": precision, "max_size": max_size}


def digest_of(settings: Mapping[str, Any]) -> str:
    """The hash of `all_settings`, without what does not decide the file."""
    return settings_hash({name: value for name, value in settings.items() if name not in _NOT_DECISIVE})


def fit_to_svg(
    picture: Picture,
    settings: FitSettings,
    *,
    precision: int,
    title: str | None,
    max_size: int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> Fitted:
    """Fit and write the SVG text; a Ctrl-C during the fit ends it with the best scene so far."""
    target = picture if max_size is None else resize_picture(picture, max_size)
    result = fit(target.target(), settings, on_progress)
    scene = scaled_scene(result.scene, picture.width, picture.height)
    public = all_settings(settings, precision=precision, max_size=max_size)
    digest = digest_of(public)
    comment = provenance_comment(__version__, settings.seed, digest, picture.sha256)
    text = write_svg(scene, precision=precision, title=title or picture.source, comment=comment)
    notes = (*target.notes, *result.notes)
    return Fitted(picture, scene, result, text.encode("utf-8"), public, digest, notes)


def measure(fitted: Fitted) -> Measured:
    """Draw the SVG's bytes with an independent renderer and compare both pictures with the input."""
    reference = measurable(fitted.picture)
    rendered = rerender(fitted.svg, reference.width, reference.height)
    scene = scaled_scene(fitted.scene, reference.width, reference.height)
    samples, threads = fitted.result.samples, fitted.settings["threads"]
    own = render_scene(scene, coverage="exact", samples=samples, threads=threads)
    notes = [] if rendered.note is None else [rendered.note]
    if reference is not fitted.picture:
        notes.append(f"quality measured at {reference.width} x {reference.height} pixels")
    return Measured(
        rendered,
        compare(reference, rendered.pixels),
        compare_premultiplied(reference, own),
        agreement_db(own, rendered.pixels),
        tuple(notes),
    )


def make_report(
    fitted: Fitted,
    measured: Measured,
    *,
    seconds: float,
    svg: bytes,
    path: str | None = None,
    svg_path: str | None = None,
    png: bytes | None = None,
    png_path: str | None = None,
) -> dict[str, Any]:
    """The metrics JSON (schema 1) of one picture.

    seconds: wall-clock time of everything. svg, png: the bytes of the files as written, compressed or not.
    """
    result = fitted.result
    report = build_report(
        version=__version__,
        picture=fitted.picture,
        path=path or fitted.picture.source,
        output=OutputFiles(svg_path, png_path, len(svg), fitted.scene.curves),
        settings=fitted.settings,
        device=result.device,
        timing=Timing(seconds, result.fit_s, result.steps, result.ms_per_step),
        svg_quality=measured.svg_quality,
        renderer=measured.rendered.renderer,
        surrogate=measured.surrogate,
        surrogate_samples=result.samples,
        agreement_db=measured.agreement_db,
        history=result.history,
        replaced=result.replaced,
        dropped=result.dropped,
        interrupted=result.interrupted,
        notes=[*fitted.notes, *measured.notes],
    )
    # By these a later run knows whether the files are complete and what they were made with.
    report["output"]["svg_sha256"] = hashlib.sha256(svg).hexdigest()
    report["output"]["png_sha256"] = None if png is None else hashlib.sha256(png).hexdigest()
    report["settings_hash"] = fitted.digest
    return report
