"""Animated WebPs and GIFs of the course of a fit, or of a drawing built up from the back; and the page about an
animated clip: a player beside the clip, and the quality of each frame.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from PIL import Image

from cubicsplat_cli.clip_request import ClipReport
from cubicsplat_cli.evaluate.metrics import decibels
from cubicsplat_cli.files.clips import Frame
from cubicsplat_cli.files.load import Picture, resize_picture
from cubicsplat_cli.files.marks import made_mark
from cubicsplat_cli.files.write import encoded
from cubicsplat_cli.formatting import counted, duration, file_size, level_text
from cubicsplat_cli.html_report.embed import picture_data_url, rendered
from cubicsplat_cli.html_report.page import Fact, course, setting_texts
from cubicsplat_cli.progress import FrameRecorder
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.scene import Scene

SIDE = 512  # px, at most
_WHOLE_MS, _LEAST_MS, _MOST_MS, _LAST_MS = 4000, 80, 500, 2500
_SAMPLES = 24
_QUALITY = 82
# Of the clip, at most so many frames are on the page, of at most so many px a side.
MOST_PICTURES, PAGE_SIDE = 120, 480


def animation(recorder: FrameRecorder, last: Scene, *, form: str, about: str, threads: int | None) -> bytes:
    """Return the bytes of the animation. last: the finished scene. form: "WEBP" or "GIF". about: SHA-256 of the SVG.

    The few frames that `recorder` holds are all in memory at once, with at most SIDE px a side.
    """
    factor = min(1.0, SIDE / max(last.width, last.height))
    width, height = (max(1, round(side * factor)) for side in (last.width, last.height))
    frames = [_frame(scene, width, height, threads) for scene in recorder.scenes(last)]
    each = min(_MOST_MS, max(_LEAST_MS, _WHOLE_MS // len(frames)))
    durations = [*[each] * (len(frames) - 1), _LAST_MS]
    mark = made_mark(about)
    exif = Image.Exif()
    exif[0x0131] = mark  # Software
    of_form = {"WEBP": {"quality": _QUALITY, "exif": exif}, "GIF": {"comment": mark.encode(), "disposal": 2}}
    several = {"save_all": True, "append_images": frames[1:], "duration": durations, "loop": 0}
    return encoded(frames[0], form, **several, **of_form[form])


def _frame(scene: Scene, width: int, height: int, threads: int | None) -> Image.Image:
    values = render_scene(scene.scaled(width, height), samples=_SAMPLES, threads=threads)
    if values.shape[2] == 4:
        values[..., :3] /= np.maximum(values[..., 3:], 1e-6)
    return Image.fromarray(np.round(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8))


def record_shapes(film: FrameRecorder, scene: Scene, picture: Picture, threads: int | None) -> None:
    """Record how a drawing is built up, shape after shape from the back."""
    small = resize_picture(picture, SIDE)
    sized = scene.scaled(small.width, small.height)
    pieces = np.linspace(1, sized.curves, min(sized.curves, 2 * film.frames)).astype(int)
    target = small.premultiplied()
    shown_db = 0.0
    for count in dict.fromkeys(pieces.tolist()):
        part = sized.chosen(slice(-count, None))  # the shapes furthest back
        error = float(((render_scene(part, samples=_SAMPLES, threads=threads) - target) ** 2).mean())
        # A shape that later ones complete may make the picture worse at first; it counts as a step forward.
        shown_db = max(shown_db, decibels(max(error, 1e-10))) + 1e-3
        film.keep(shown_db, part)


def player_page(svg: str, report: ClipReport, frames: Iterable[Frame], title: str) -> bytes:
    """Return the HTML file. svg: the text of the animation. frames: of the clip, as many as the report has."""
    levels = report.quality.frames
    every = -(-len(levels) // MOST_PICTURES)
    pictures, begins = [], []
    for index, frame in zip(range(len(levels)), frames, strict=False):
        begins.append(frame.begin)
        if index % every == 0:
            small = resize_picture(frame.picture, PAGE_SIDE)
            pictures.append({"begin": frame.begin, "url": picture_data_url(small.pixels())})
    shown = [{"begin": at, "psnr_db": level["psnr_db"]} for at, level in zip(begins, levels, strict=True)]
    measured = [(at, level["psnr_db"]) for at, level in zip(begins, levels, strict=True) if level["psnr_db"]]
    charts = []
    if len(measured) > 1:
        times, decibels = zip(*measured, strict=True)
        charts.append(course("Closeness", "PSNR of each frame as it is played, in dB", times, decibels, 2))
    return rendered(
        "player.html",
        mark=made_mark(report.output.sha256),
        title=title,
        report=report,
        markup=svg[svg.index("<svg") :],
        data={"duration": report.input.seconds, "pictures": pictures, "frames": shown},
        facts=_facts(report),
        charts=charts,
        settings=setting_texts(report.settings),
    )


def _facts(report: ClipReport) -> list[Fact]:
    quality, output, clip = report.quality, report.output, report.input
    worst = "" if quality.worst_psnr_db is None else f"worst frame {quality.worst_psnr_db:.2f} dB"
    return [
        ("PSNR", level_text(quality.psnr_db), worst),
        ("curves", f"{output.curves:,}", counted(output.groups, "group") + f" of frames, {output.knots:,} knots"),
        ("file", file_size(output.bytes), f"{file_size(output.compressed_bytes)} compressed"),
        ("a second", file_size(round(output.compressed_bytes / clip.seconds)), "compressed"),
        ("clip", f"{clip.seconds:.2f} s", f"{counted(clip.frames, 'frame')}, {clip.width} \u00d7 {clip.height} px"),
        ("time", duration(report.timing["total_s"]), f"{report.timing['frame_s']:.2f} s a frame"),
    ]
