"""An SVG in a format of other programs, and the mark in that file that identifies the SVG."""

from __future__ import annotations

import importlib.util
import math
import re
from collections.abc import Iterable
from typing import Any

from cubicsplat_cli.errors import EngineError, InputError
from cubicsplat_cli.evaluate.rerender import MAX_RENDER_PIXELS, checked, choose_renderer, drawing_with, embedded_only
from cubicsplat_cli.export.android import vector_drawable
from cubicsplat_cli.export.dxf import dxf
from cubicsplat_cli.files.marks import made_mark, sha256_of
from cubicsplat_cli.progress import warnings_to
from cubicsplat_cli.request import DXF_TOLERANCE, Request
from cubicsplat_cli.svg.painted import painted_shapes
from cubicsplat_cli.svg.untrusted import SvgSize

BY_CAIRO = ("pdf", "ps", "eps")
_POINTS = 0.75  # per px, as in CSS
_PPI = 300.0  # pixels per inch for what PostScript cannot express, as in cairo


def check_packages(formats: Iterable[str]) -> None:
    """Raise EngineError, with what to install, if the package for one of the formats is missing."""
    for form in formats:
        if form == "dxf" and importlib.util.find_spec("ezdxf") is None:
            raise EngineError("DXF needs ezdxf: pip install 'cubicsplat[dxf]'")
        if form in BY_CAIRO:
            choose_renderer("cairosvg")


def exported(
    svg: bytes,
    form: str,
    source: str,
    *,
    tolerance: float = DXF_TOLERANCE,
    width: float | None = None,
    height: float | None = None,
    scale: float = 1.0,
) -> tuple[bytes, list[str]]:
    """Return an SVG of any origin, unpacked, in a format, and a sentence for each thing of it that the file lacks.

    form: a name in `files.paths.EXPORTS`. source: the SVG's name for messages. tolerance: largest distance of a DXF's
    arcs from the outlines, px. width, height, scale: see `rerender_untrusted`. Raises InputError for an SVG that cannot
    be read or drawn, EngineError if a package is missing, UsageError for a bad tolerance or scale.
    """
    check_packages([form])
    Request(dxf_tolerance=tolerance)  # raises UsageError for a bad tolerance
    mark = mark_of(svg, form, tolerance)
    svg, size, drawn = checked(svg, source, width, height, scale)
    notes: list[str] = []
    with warnings_to(notes.append):
        if form in BY_CAIRO:
            data, notes = _by_cairo(svg, form, drawn, source)
            return data + f"% {mark}\n".encode(), notes
        drawing = painted_shapes(svg, source, size, drawn)
        try:
            data = dxf(drawing, mark, tolerance) if form == "dxf" else vector_drawable(drawing, mark)
        except InputError as error:
            raise InputError(f"{source}: {error}") from error
    return data, [*notes, *drawing.notes()]


def mark_of(svg: bytes, form: str, tolerance: float) -> str:
    """Return the mark of an SVG's file in a format, which holds all that the file depends on."""
    return made_mark(sha256_of(svg) + (f", tolerance {tolerance:g} px" if form == "dxf" else ""))


def _by_cairo(svg: bytes, form: str, drawn: SvgSize, source: str) -> tuple[bytes, list[str]]:
    """Do as `exported`, by cairosvg. Cairo makes pixels of what PostScript cannot express, as many as fit memory."""
    module, name, _ = choose_renderer("cairosvg")
    surfaces = importlib.import_module(f"{module.__name__}.surface")
    width, height = drawn.width * _POINTS, drawn.height * _POINTS
    ppi = min(_PPI, 72.0 * math.sqrt(MAX_RENDER_PIXELS / 4.0 / (width * height)))

    class Surface(getattr(surfaces, f"{form.upper()}Surface")):  # type: ignore[misc]
        def _create_surface(self, width: float, height: float) -> Any:
            made = super()._create_surface(width, height)
            made[0].set_fallback_resolution(ppi, ppi)
            return made

    with drawing_with(name, source):
        data = Surface.convert(svg, url_fetcher=embedded_only, output_width=drawn.width, output_height=drawn.height)
    if form == "eps":
        # cairo gives the box of the drawing; a user who places the file needs the page, which ends at a whole point.
        right, top = math.ceil(width), math.ceil(height)
        box = f"%%BoundingBox: 0 0 {right} {top}\n%%HiResBoundingBox: 0 {top - height:g} {width:g} {top}"
        data = re.sub(rb"%%BoundingBox: .*", box.encode(), data, count=1)
    pixels = form != "pdf" and b"/ImageType" in data  # which begins every picture in PostScript
    opacity = "what is translucent became pixels; PDF keeps it as it is, --set opaque=true makes a photo without it"
    return data, [f"{form.upper()} has no opacity: {opacity}"] if pixels else []
