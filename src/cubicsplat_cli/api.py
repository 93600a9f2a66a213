"""The library as Python programs use it; docs/python.md shows how. Nothing in here prints."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from cubicsplat_cli.amounts import parse_bytes, with_segments
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.evaluate.comparison import compare_with
from cubicsplat_cli.evaluate.metrics import compare_premultiplied
from cubicsplat_cli.files.convert import PictureLike, as_picture
from cubicsplat_cli.files.read import looks_like_svg, read_file
from cubicsplat_cli.files.weights import load_mask
from cubicsplat_cli.focus import parse_focus
from cubicsplat_cli.pipeline import Result, vectorize_picture
from cubicsplat_cli.progress import Progress
from cubicsplat_cli.report import Quality
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings, Mode, unknown_setting
from cubicsplat_cli.svg.initial import load_initial_drawing


def vectorize(
    picture: PictureLike,
    *,
    style: str = "auto",
    curves: int | str | None = None,
    mode: str = "closed",
    preset: str = "standard",
    precision: int | None = None,
    max_size: int | None = None,
    weights: PictureLike | None = None,
    focus: str | Sequence[float] | None = None,
    init: str | Path | bytes | Result | None = None,
    freeze: bool = False,
    max_bytes: int | str | None = None,
    target_psnr: float | None = None,
    title: str | None = None,
    measure: bool = True,
    on_progress: Callable[[Progress], None] | None = None,
    **settings: Any,
) -> Result:
    """Turn a picture into an SVG of Bezier shapes.

    style: "photo" (curves that blend), "artwork" (few opaque shapes), "pixel" (square cells, exactly) or "auto", which
    measures what the picture is.

    picture: a path, the bytes of a file, an array (H, W), (H, W, 3) or (H, W, 4) of uint8 or of floats in [0, 1]
    (straight alpha), or a Pillow image. curves: how many, of artwork at most so many ("auto" or None: as many
    as the picture asks for). mode ("closed" or "open"), preset ("draft", "standard", "high", "paper") and `settings`:
    fields of `FitSettings` and of its recipe, such as seed, time_limit, background or opaque; for artwork colors,
    palette (8-bit triples or colour names), min_area, detail, stacking ("stacked" or "cutout") and completion
    ("on" or "off"), see `ArtworkSettings`. precision: decimals of the
    coordinates, 0..6 (None: 2, and for artwork by its size). max_size: fit a copy of at most so many pixels a side; the
    SVG keeps the picture's size.
    weights: a picture of the same shape that says how much each pixel of a photo matters to the fit, from black, not at
    all, to white. focus: (x, y, width, height) in px of the picture, or with a factor behind them: a rectangle that
    matters 4 times as much as the rest, or so many times. init: an SVG of any program, or an earlier result, that the
    fit of a photo begins with, of at most `curves` of its curves (None: all) and as many new ones as are missing;
    freeze: its own stay as they are. title: of the SVG. measure: draw the SVG by an independent renderer, for
    `report.quality` and `pixels`. on_progress: called about ten times a second; a KeyboardInterrupt that it raises ends
    the fit early with the best SVG so far.

    Raises InputError for what is no picture, UsageError for senseless settings, EngineError where no engine runs.
    """
    known = {*inspect.signature(vectorize).parameters, *FitSettings.names(), *ArtworkSettings.__dataclass_fields__}
    for name in settings:
        if name not in known:
            raise unknown_setting(name, known)
    artwork = {name: settings.pop(name) for name in [*settings] if name in ArtworkSettings.__dataclass_fields__}
    request = Request(
        settings=FitSettings.from_preset(preset, mode, curves=curves, **with_segments(settings, max_bytes)),
        artwork=ArtworkSettings(**artwork),
        style=style,
        precision=precision,
        max_size=max_size,
        measure=measure,
        weights=None if weights is None else load_mask(weights),
        focus=None if focus is None else parse_focus(focus),
        init=None
        if init is None
        else load_initial_drawing(init.svg.encode() if isinstance(init, Result) else init, Mode(mode)),
        freeze=freeze,
        max_bytes=None if max_bytes is None else parse_bytes(max_bytes),
        target_psnr=target_psnr,
    )
    return vectorize_picture(as_picture(picture, max_size=max_size), request, title=title, on_progress=on_progress)


def compare(reference: PictureLike, candidate: PictureLike | Result) -> Quality:
    """How close a picture or an SVG is to a reference picture: PSNR and SSIM.

    candidate: what `vectorize` returned, the path, bytes or text of an SVG (drawn by an independent renderer at the
    reference's size), or any picture. Where either has transparency both are laid over black and over white, and the
    worse figure counts. Raises InputError for what is neither, and where sizes differ.
    """
    picture = as_picture(reference)
    svg = _svg_of(candidate)
    if svg is None:
        assert not isinstance(candidate, Result)
        return compare_premultiplied(picture, as_picture(candidate).target())
    return compare_with(picture, picture.source, svg, "the SVG", is_svg=True).quality


def _svg_of(candidate: PictureLike | Result) -> bytes | None:
    """The bytes of an SVG, unpacked; None where it is no SVG."""
    if isinstance(candidate, Result):
        return candidate.svg.encode()
    if isinstance(candidate, str) and candidate.lstrip().startswith("<"):
        return candidate.encode()
    if isinstance(candidate, bytes):
        return candidate if looks_like_svg(Path(), candidate) else None
    if isinstance(candidate, (str, Path)):
        path = Path(candidate)
        if looks_like_svg(path, b""):
            return read_file(path)
    return None
