"""The page of an animation: a player with the clip beside it, and the quality of each frame."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from cubicsplat_cli.clip_request import ClipReport
from cubicsplat_cli.files.clips import Frame
from cubicsplat_cli.files.load import resize_picture
from cubicsplat_cli.files.marks import PROGRAM, made_mark
from cubicsplat_cli.formatting import counted, duration, file_size
from cubicsplat_cli.html_report.embed import eight_bit_pixels, picture_data_url, rendered
from cubicsplat_cli.html_report.page import Fact, course, setting_texts

# Of the clip, at most so many frames are on the page, of at most so many px a side.
MOST_PICTURES, SIDE = 120, 480


def player_page(svg: str, report: ClipReport, frames: Iterable[Frame], title: str) -> bytes:
    """The HTML file. svg: the text of the animation. frames: of the clip, as many as the report has."""
    levels, seconds = report.quality.frames, report.input.seconds
    every = -(-len(levels) // MOST_PICTURES)
    pictures, begins = [], []
    for index, frame in zip(range(len(levels)), frames, strict=False):
        begins.append(frame.begin)
        if index % every == 0:
            small = resize_picture(frame.picture, SIDE)
            pictures.append({"begin": frame.begin, "url": picture_data_url(eight_bit_pixels(small))})
    known = [(begin, level["psnr_db"]) for begin, level in zip(begins, levels, strict=True) if level["psnr_db"]]
    charts = []
    if len(known) > 1:
        about = "PSNR of each frame as it is played, in dB"
        charts.append(course("Closeness", about, [at for at, _ in known], [level for _, level in known], 2))
    shown = [{"begin": at, "psnr_db": level["psnr_db"]} for at, level in zip(begins, levels, strict=True)]
    text = rendered(
        "player.html",
        mark=made_mark(report.output.sha256),
        title=title,
        clip_name=report.input.path,
        width=report.input.width,
        height=report.input.height,
        markup=svg[svg.index("<svg") :],
        duration=seconds,
        data={"duration": seconds, "pictures": pictures, "frames": shown},
        facts=_facts(report),
        charts=charts,
        settings=setting_texts(report.settings),
        notes=report.notes,
        program=PROGRAM,
        version=report.version,
    )
    return text.encode()


def _facts(report: ClipReport) -> list[Fact]:
    quality, output, clip = report.quality, report.output, report.input
    worst = "" if quality.worst_psnr_db is None else f"worst frame {quality.worst_psnr_db:.2f} dB"
    level: Any = "identical" if quality.psnr_db is None else f"{quality.psnr_db:.2f} dB"
    return [
        Fact("PSNR", level, worst),
        Fact("curves", f"{output.curves:,}", counted(output.groups, "group") + f" of frames, {output.knots:,} knots"),
        Fact("file", file_size(output.bytes), f"{file_size(output.compressed_bytes)} compressed"),
        Fact("a second", file_size(round(output.compressed_bytes / clip.seconds)), "compressed"),
        Fact("clip", f"{clip.seconds:.2f} s", f"{counted(clip.frames, 'frame')}, {clip.width} \u00d7 {clip.height} px"),
        Fact("time", duration(report.timing["total_s"]), f"{report.timing['frame_s']:.2f} s a frame"),
    ]
