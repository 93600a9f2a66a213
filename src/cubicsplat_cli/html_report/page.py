"""The page about one picture and its SVG: one HTML file with figures and small charts."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.files.marks import made_mark
from cubicsplat_cli.formatting import counted, duration, file_size, level_text
from cubicsplat_cli.html_report.embed import Shown, picture_url, rendered, shown_elements
from cubicsplat_cli.metrics import Quality, Report
from cubicsplat_cli.options import Setting, renamed, settings_of
from cubicsplat_cli.record import record
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings
from cubicsplat_cli.svg.values import uri_of

LEFT, RIGHT, TOP, BOTTOM = 40.0, 310.0, 10.0, 112.0  # of the plotted area, in a chart of 320 x 132 units
_BINS = 32
_LEAST_DB = 1e-5  # the first bar of a histogram counts all smaller values

Fact = tuple[str, str, str]  # the name of a figure, the figure, and a remark or ""


@record
class Subject:
    """The subject of a page.

    picture, data: the original, and the bytes of its file. name: of the candidate. candidate: its bytes, those of an
    SVG (unpacked) or of the picture `raster`. quality: of the candidate, None if it was not measured. drawn_by: the
    renderer. report: of the run that made the SVG, or None. sha256, bytes: of the candidate's file.
    """

    picture: Picture
    data: bytes
    name: str
    candidate: bytes
    quality: Quality | None
    drawn_by: str | None
    report: Report | None
    sha256: str
    bytes: int
    raster: Picture | None = None
    notes: tuple[str, ...] = ()


def page(subject: Subject, threads: int | None = None) -> bytes:
    """Return the HTML file. threads: of the engine, which measures the worth of each curve."""
    report, picture = subject.report, subject.picture
    own = shown_elements(subject.candidate, picture, threads) if subject.raster is None else None
    kind = "" if own is None else own.kind
    losses = [] if own is None else own.losses_db
    # A foreign SVG, or a raster picture, is shown as a picture, which can neither act nor fetch.
    if subject.raster is None:
        shown = None if own is not None else uri_of(subject.candidate, "image/svg+xml")
    else:
        shown = picture_url(subject.raster, subject.candidate)
    return rendered(
        "page.html",
        mark=made_mark(subject.sha256),
        title=subject.name,
        picture=picture,
        picture_url=picture_url(picture, subject.data),
        own=own,
        candidate_url=shown,
        is_svg=subject.raster is None,
        kind=kind,
        data={"width": picture.width, "height": picture.height, "kind": kind, "losses": losses},
        facts=_facts(subject, own),
        charts=_charts(report, losses, kind),
        times=[] if report is None else _times(report),
        notes=[*(() if report is None else report.notes), *subject.notes],
        report=report,
        command=report and command(report),
        settings=report and setting_texts(report.settings),
    )


def page_of_result(picture: Picture, data: bytes, svg: bytes, report: Report, threads: int | None) -> bytes:
    """Return the HTML file about an SVG (unpacked) and its report. data: the bytes of the picture's file."""
    quality, output = None if report.quality is None else report.quality.svg, report.output
    name = Path(output.svg).name if output.svg else picture.source
    drawn_by = quality.renderer if quality else None
    return page(Subject(picture, data, name, svg, quality, drawn_by, report, output.svg_sha256, output.bytes), threads)


def _facts(subject: Subject, own: Shown | None) -> list[Fact]:
    """Return the figures at the top of the page."""
    quality, report = subject.quality, subject.report
    facts: list[Fact] = []
    if quality is not None:
        by = f"drawn by {subject.drawn_by}" if subject.drawn_by else "of the candidate"
        facts.append(("PSNR", level_text(quality.psnr_db), by))
        if quality.ssim is not None and not quality.identical:
            facts.append(("SSIM", f"{quality.ssim:.4f}", "1 is identical"))
    if own is not None:
        about = [] if report is None or report.inks is None else [counted(len(report.inks), "colour")]
        count = own.count if report is None else report.count()
        if own.losses_db and count != len(own.losses_db):
            about.insert(0, f"in {counted(len(own.losses_db), 'element')}")
        facts.append((f"{own.kind}s", f"{count:,}", ", ".join(about)))
    if report is not None and report.shaded:
        facts.append(("shaded", counted(len(report.shaded), "object"), ", ".join(report.shaded)))
    facts.append(("file", file_size(subject.bytes), f"the picture: {file_size(len(subject.data))}"))
    facts.append(("size", f"{subject.picture.width} \u00d7 {subject.picture.height}", "pixels of the original"))
    if report is not None:
        steps = f"{report.timing.steps:,} steps" if report.timing.steps else ""
        facts.append(("time", duration(report.timing.total_s), steps))
    return facts


def _charts(report: Report | None, losses: list[float], kind: str) -> list[Chart]:
    """Return the charts of the fit's history and of the worth of the curves."""
    history = [] if report is None else report.history
    courses = (
        ("psnr_db", "Closeness", "PSNR of the fit's own picture, in dB", 2),
        ("gini", "Inequality", "Gini coefficient of the curves' worth: 0 all alike, 1 few do everything", 2),
        ("replaced", "Curves replaced", "removed where they did little, and begun anew where the error is", 0),
    )
    charts = []
    for member, title, about, decimals in courses:
        entries = [entry for entry in history if member in entry]
        if len(entries) > 1:
            seconds, values = [e["seconds"] for e in entries], [e[member] for e in entries]
            charts.append(course(title, about, seconds, values, decimals))
    if len(losses) > 1:
        about = f"{kind}s by how many dB the picture loses without one"
        charts.append(histogram(f"Worth of the {kind}s", about, losses))
    return charts


def _times(report: Report) -> list[tuple[str, str, float]]:
    """Return name, text and percentage of each stage."""
    stages = [(name, getattr(report.timing, f"{name}_s")) for name in ("read", "fit", "write", "draw", "measure")]
    timed = [(name, seconds) for name, seconds in stages if seconds is not None]
    total = sum(seconds for _, seconds in timed) or 1.0
    return [(name, duration(seconds), 100.0 * seconds / total) for name, seconds in timed]


def setting_texts(settings: Mapping[str, Any]) -> dict[str, str]:
    """Return every setting by name; settings of a group begin with its name and a dot."""
    texts: dict[str, str] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping):
            texts |= {f"{name}.{key}": text for key, text in setting_texts(value).items()}
        else:
            texts[name] = "-" if value is None or value == [] else str(value)
    return texts


def command(report: Report) -> str:
    """Return `cubicsplat vectorize ...` with every option that differs from its default."""
    parts = ["cubicsplat", "vectorize", report.input.path]
    parts += [] if report.output.svg is None else ["-o", report.output.svg]
    for name, spec, value in _differing(report.settings):
        parts += _option(name, spec, value)
    return shlex.join(parts)


def _differing(settings: Mapping[str, Any]) -> Iterator[tuple[str, Setting, Any]]:
    """Yield name, description and value of each setting that differs from its default."""
    usual = FitSettings.from_preset(settings.get("preset", "standard"), settings.get("mode", "closed"))
    recipe, artwork = settings.get("recipe") or {}, settings.get("artwork") or {}
    holders, held = (Request(), usual, usual.recipe, ArtworkSettings()), (settings, settings, renamed(recipe), artwork)
    for default, given in zip(holders, held, strict=True):
        for field, spec in settings_of(type(default)):
            name = field.name
            # The defaults of preset and mode do not depend on the chosen preset and mode.
            before = getattr(FitSettings() if name in ("preset", "mode") else default, name)
            value = given.get(name)
            # The device and the threads decide nothing.
            if spec.decides and name not in ("device", "threads") and value not in (None, []) and value != before:
                yield name, spec, value


def _option(name: str, spec: Setting, value: Any) -> list[str]:
    """Return the words of the command line that set a value."""
    option = f"--{(spec.option or name).replace('_', '-')}"
    if spec.by_set:
        return ["--set", f"{name}={str(value).lower() if isinstance(value, bool) else value}"]
    if value is False or value == "off":
        return [f"--no-{option[2:]}"]
    if value is True:
        return [option]
    if isinstance(value, list):
        return [option, ",".join(f"{each:.12g}" if isinstance(each, float) else str(each) for each in value)]
    return [option, value["name"] if isinstance(value, dict) else str(value)]


@record
class Chart:
    """A chart in units of its box. line: path data. bars: (x, y, width, height, text). across, up: (place, label)."""

    title: str
    about: str
    unit: str
    across: list[tuple[float, str]]
    up: list[tuple[float, str]]
    line: str = ""
    bars: tuple[tuple[float, float, float, float, str], ...] = ()
    last: str = ""


def course(title: str, about: str, seconds: Sequence[float], values: Sequence[float], decimals: int) -> Chart:
    """Return a chart of values over the seconds at which they were measured; there must be two or more."""
    up, across = ticks(min(values), max(values), 3), ticks(0.0, seconds[-1], 4)
    low, high = min(*values, up[0]), max(*values, up[-1])
    last = max(seconds[-1], across[-1]) or 1.0

    def x(second: float) -> float:
        return LEFT + (RIGHT - LEFT) * second / last

    def y(value: float) -> float:
        return BOTTOM - (BOTTOM - TOP) * (value - low) / (high - low or 1.0)

    line = "M" + "L".join(f"{x(s):.1f} {y(v):.1f}" for s, v in zip(seconds, values, strict=True))
    marks = [(x(s), f"{s:g}") for s in across], [(y(v), f"{v:g}") for v in up]
    return Chart(title, about, "s", *marks, line=line, last=f"{values[-1]:.{decimals}f}")


def histogram(title: str, about: str, values: Sequence[float]) -> Chart:
    """Return a histogram of values in dB on a logarithmic axis; the first bar counts values up to 0, too."""
    clipped = np.clip(np.asarray(values, dtype=float), _LEAST_DB, None)
    first, last = math.floor(math.log10(clipped.min())), math.ceil(math.log10(clipped.max()) + 1e-9)
    last = max(last, first + 1)
    counts, edges = np.histogram(np.log10(clipped), bins=_BINS, range=(first, last))
    step, most = (RIGHT - LEFT) / _BINS, max(1, int(counts.max()))
    bars = tuple(
        (LEFT + step * i + 0.5, BOTTOM - (BOTTOM - TOP) * c / most, step - 1.0, (BOTTOM - TOP) * c / most,
         f"{c}: {10 ** edges[i]:.1g} to {10 ** edges[i + 1]:.1g} dB")
        for i, c in enumerate(counts.tolist())
        if c
    )  # fmt: skip
    across = [(LEFT + (RIGHT - LEFT) * (d - first) / (last - first), f"{10.0**d:g}") for d in range(first, last + 1)]
    up = [(BOTTOM - (BOTTOM - TOP) * c / most, f"{c:g}") for c in ticks(0, most, 3) if c <= most and c == int(c)]
    return Chart(title, about, "dB", across, up, bars=bars)


def ticks(low: float, high: float, count: int) -> list[float]:
    """Return about `count` round numbers from `low` to `high`, at least one."""
    span = high - low
    if not span > 0:
        return [low]
    rough = span / count
    scale = 10.0 ** math.floor(math.log10(rough))
    step = next(m * scale for m in (1, 2, 2.5, 5, 10) if m * scale >= rough * 0.999)
    first = math.ceil(low / step - 1e-9)
    return [round(i * step, 10) for i in range(first, math.floor(high / step + 1e-9) + 1)] or [low]
