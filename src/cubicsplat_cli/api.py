"""The Python library, see docs/python.md. It prints nothing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cubicsplat_cli.clip_request import ClipRequest
from cubicsplat_cli.evaluate import metrics
from cubicsplat_cli.evaluate.comparison import compare_with
from cubicsplat_cli.evaluate.images import of_values
from cubicsplat_cli.files.load import PictureLike, as_picture
from cubicsplat_cli.files.read import looks_like_svg, read_file
from cubicsplat_cli.from_options import check_library_names, clip_request_of, request_of
from cubicsplat_cli.metrics import Quality
from cubicsplat_cli.pipeline.task import Result
from cubicsplat_cli.pipeline.vectorize import vectorize_picture
from cubicsplat_cli.progress import OnProgress, StageTimer
from cubicsplat_cli.request import Request

if TYPE_CHECKING:
    from cubicsplat_cli.pipeline.animation import Animation


def vectorize(
    picture: PictureLike, *, title: str | None = None, on_progress: OnProgress | None = None, **options: Any
) -> Result:
    """Turn a picture into an SVG of Bezier shapes.

    picture: a path, the bytes of a file, an array (H, W), (H, W, 3) or (H, W, 4) of uint8 or of floats in [0, 1]
    (straight alpha), or a Pillow image. title: of the SVG. on_progress: called about ten times a second; a
    KeyboardInterrupt that it raises ends the work early with the best SVG so far.

    options: the command's options that decide the result (docs/cli.md), with underscores, such as style, curves, mode,
    preset, max_bytes or seed, and all names of `--set`. None means the default. Values need not be text: palette takes
    8-bit triples, focus numbers, weights any picture of the same shape, init an SVG's bytes or an earlier result.
    measure: True to have an independent renderer draw the SVG, for `report.quality` and `pixels`.

    Raises InputError for anything but a picture, UsageError for senseless options, EngineError if no engine runs.
    """
    check_library_names(Request, options)
    request = request_of(options)
    loaded = as_picture(picture, max_size=request.max_size)
    return vectorize_picture(loaded, request, title=title, on_progress=on_progress)


def animate(
    clip: str | Path | Sequence[PictureLike],
    *,
    title: str | None = None,
    on_progress: OnProgress | None = None,
    **options: Any,
) -> Animation:
    """Turn a clip into curves that move, as an animated SVG.

    clip: the path of a GIF, an animated PNG or WebP, a video or a folder of pictures; or a sequence of pictures as
    `vectorize` takes them, of which `fps` (25 by default) are shown a second. title, on_progress: as for `vectorize`; a
    KeyboardInterrupt that `on_progress` raises ends the work with the frames so far.

    options: the command's options that decide the result (docs/cli.md), with underscores: curves, max_bytes, fps,
    frames, loop, preset, steps, time_limit, threads, seed, background, precision, max_size. None means the default.

    Raises InputError for anything but a clip, UsageError for senseless options, EngineError if no engine runs.
    """
    from cubicsplat_cli.files.clips import clip_of_pictures, open_clip
    from cubicsplat_cli.pipeline.animate import animate_clip
    from cubicsplat_cli.pipeline.animation import ClipTask

    check_library_names(ClipRequest, options)
    request, timer = clip_request_of(options), StageTimer()
    with timer("read"):
        source = open_clip(Path(clip), request) if isinstance(clip, (str, Path)) else clip_of_pictures(clip, request)
    return animate_clip(ClipTask(source, request, title or Path(source.name).name, timer, on_progress))


def compare(reference: PictureLike, candidate: PictureLike | Result) -> Quality:
    """Compare a picture or an SVG with a reference picture: PSNR and SSIM.

    candidate: a result of `vectorize`, the path, bytes or text of an SVG (drawn by an independent renderer at the
    reference's size), or any picture. If either has transparency, both are laid over black and over white, and the
    worse figure counts. Raises InputError for anything else, and for pictures of different sizes.
    """
    picture = as_picture(reference)
    svg = _svg_of(candidate)
    if svg is None:
        assert not isinstance(candidate, Result)
        return metrics.compare(picture, of_values(as_picture(candidate).target()))
    return compare_with(picture, picture.source, svg, "the SVG", is_svg=True).quality


def _svg_of(candidate: PictureLike | Result) -> bytes | None:
    """Return the bytes of an SVG, unpacked; None for anything else."""
    if isinstance(candidate, Result):
        return candidate.svg.encode()
    if isinstance(candidate, str) and candidate.lstrip().startswith("<"):
        return candidate.encode()
    if isinstance(candidate, bytes):
        return candidate if looks_like_svg(Path(), candidate) else None
    if isinstance(candidate, (str, Path)) and looks_like_svg(Path(candidate), b""):
        return read_file(Path(candidate))
    return None
