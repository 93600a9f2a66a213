"""picture -> fit -> SVG -> independent render -> figures: the whole way for one picture, without files."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from cubicsplat_cli._version import __version__
from cubicsplat_cli.cli.provenance import provenance_comment, settings_hash
from cubicsplat_cli.evaluate import Quality, Rendered, compare, compare_premultiplied, rerender
from cubicsplat_cli.evaluate.report import OutputFiles, Timing, build_report
from cubicsplat_cli.fit import FitResult, FitSettings, Progress, fit
from cubicsplat_cli.image import Picture
from cubicsplat_cli.raster import render_scene
from cubicsplat_cli.svg import write_svg


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fitted picture and its SVG, before anything was measured.

    svg: the bytes of the file. result: what `fit` returned. settings: all that decides the result, for the
    report.
    """

    picture: Picture
    result: FitResult
    svg: bytes
    settings: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Measured:
    """The SVG drawn by an independent renderer, its quality, and that of the renderer used for the fit."""

    rendered: Rendered
    svg_quality: Quality
    surrogate: Quality


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
    on_progress: Callable[[Progress], None] | None = None,
) -> Vectorized:
    """Turn a loaded picture into an SVG and measure that SVG.

    precision: decimals of the coordinates, 0..6. title: the SVG's title, by default the picture's source.
    Raises UsageError for bad settings, EngineError when the engine fails, InputError when the scene cannot be
    written.
    """
    started = time.perf_counter()
    fitted = fit_to_svg(picture, settings, precision=precision, title=title, on_progress=on_progress)
    measured = measure(fitted)
    report = make_report(fitted, measured, seconds=time.perf_counter() - started)
    return Vectorized(fitted.svg, measured.rendered, report, fitted.result)


def fit_to_svg(
    picture: Picture,
    settings: FitSettings,
    *,
    precision: int,
    title: str | None,
    on_progress: Callable[[Progress], None] | None,
) -> Fitted:
    """Fit and write the SVG text; a Ctrl-C during the fit ends it with the best scene so far."""
    result = fit(picture.target(), settings, on_progress)
    public = {**settings.public(), "precision": precision}
    # Neither decides the picture on one engine: the file is the same for every number of threads.
    decisive = {name: value for name, value in public.items() if name not in ("device", "threads")}
    comment = provenance_comment(__version__, settings.seed, settings_hash(decisive))
    text = write_svg(result.scene, precision=precision, title=title or picture.source, comment=comment)
    return Fitted(picture, result, text.encode("utf-8"), public)


def measure(fitted: Fitted) -> Measured:
    """Draw the SVG's bytes with an independent renderer and compare both pictures with the input."""
    picture, result = fitted.picture, fitted.result
    rendered = rerender(fitted.svg, picture.width, picture.height)
    own = render_scene(
        result.scene, coverage="exact", samples=result.samples, threads=fitted.settings["threads"]
    )
    return Measured(rendered, compare(picture, rendered.pixels), compare_premultiplied(picture, own))


def make_report(
    fitted: Fitted,
    measured: Measured,
    *,
    seconds: float,
    path: str | None = None,
    svg_path: str | None = None,
    png_path: str | None = None,
) -> dict[str, Any]:
    """The metrics JSON (schema 1) of one picture; `seconds` is the wall-clock time of everything."""
    result = fitted.result
    notes = list(fitted.picture.notes)
    if measured.rendered.note is not None:
        notes.append(measured.rendered.note)
    return build_report(
        version=__version__,
        picture=fitted.picture,
        path=path or fitted.picture.source,
        output=OutputFiles(svg_path, png_path, len(fitted.svg), result.scene.curves),
        settings=fitted.settings,
        device=result.device,
        timing=Timing(seconds, result.fit_s, result.steps, result.ms_per_step),
        svg_quality=measured.svg_quality,
        renderer=measured.rendered.renderer,
        surrogate=measured.surrogate,
        surrogate_samples=result.samples,
        history=result.history,
        replaced=result.replaced,
        interrupted=result.interrupted,
        notes=notes,
    )
