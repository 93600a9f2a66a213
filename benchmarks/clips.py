"""Clips: moving curves beside fits of each frame on its own, and a trace of each frame.

All have as many curves a frame. Frames are drawn from the rounded numbers of the file.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks import Threads, main
from benchmarks.tools import missing_piece, vtracer_svg
from cubicsplat_cli.cli.bench import Limit, Markdown, print_report
from cubicsplat_cli.cli.options import Json, argument, option
from cubicsplat_cli.clip_request import ClipRequest
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.clips import open_clip
from cubicsplat_cli.files.read import gzip_size
from cubicsplat_cli.formatting import number, text_table
from cubicsplat_cli.metrics import head
from cubicsplat_cli.motion.fitting import fit_clip
from cubicsplat_cli.photo.loop import fit
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.settings import FitSettings
from cubicsplat_cli.svg.moving import shown_at, to_grid_clip
from cubicsplat_cli.svg.moving_file import write_clip
from cubicsplat_cli.svg.scene_reader import quantise_scene
from cubicsplat_cli.svg.scene_writer import write_svg

PRECISION = 1  # decimals of coordinates
STILL = 2.0 / 255.0  # of the range of values: pixels that change less, in all channels, are still
BLOCK, REACH = 8, 6  # px: side of the blocks of the flow, and how far it looks


@dataclass(frozen=True)
class Filmed:
    """Frames (F, H, W, 3) in [0, 1], and when each begins and ends, (F,) s."""

    pictures: np.ndarray
    begins: np.ndarray
    ends: np.ndarray


@dataclass(frozen=True)
class Played:
    """What a tool made: the frames (F, H, W, 3) that its files show, and their bytes, plain and after gzip."""

    pictures: np.ndarray
    plain: int
    packed: int


def read(path: Path, frames: int, side: int) -> Filmed:
    """The first frames of a clip, those with transparency over black."""
    found = list(open_clip(path, ClipRequest(frames=frames, max_size=side)).frames())[:frames]
    pictures = np.stack([frame.picture.premultiplied()[..., :3] for frame in found])
    return Filmed(pictures, np.array([frame.begin for frame in found]), np.array([frame.end for frame in found]))


def moving(film: Filmed, settings: FitSettings) -> Played:
    """One SVG of curves that move."""
    frames = zip(film.pictures, film.begins.tolist(), film.ends.tolist(), strict=True)
    clip = fit_clip(frames, settings, len(film.pictures), precision=PRECISION)
    grid = to_grid_clip(clip, PRECISION)
    start = float(clip[0].times[0])
    drawn = [
        render_scene(scene, threads=settings.threads)
        for group, own in zip(clip, grid.groups, strict=True)
        for scene in grid.scenes(own, shown_at(group) - start)
    ]
    return _played(drawn, [write_clip(grid)])


def each_frame(film: Filmed, settings: FitSettings) -> Played:
    """An SVG of each frame, fitted on its own."""
    scenes = [fit(picture, settings).scene for picture in film.pictures]
    drawn = [render_scene(quantise_scene(scene, PRECISION), threads=settings.threads) for scene in scenes]
    return _played(drawn, [write_svg(scene, precision=PRECISION) for scene in scenes])


def traced(film: Filmed, _: FitSettings) -> Played:
    """A trace of each frame by vtracer."""
    height, width = film.pictures.shape[1:3]
    files = [vtracer_svg(np.rint(picture * 255.0).astype(np.uint8)) for picture in film.pictures]
    drawn = [rerender(svg, width, height).pixels[..., :3] / np.float32(255.0) for svg in files]
    return _played(drawn, [svg.decode() for svg in files])


TOOLS: dict[str, tuple[str, Callable[[Filmed, FitSettings], Played]]] = {
    "moving": ("moving", moving), "each": ("each frame", each_frame), "vtracer": ("vtracer", traced),
}  # fmt: skip


def _played(drawn: list[np.ndarray], files: list[str]) -> Played:
    # Frames are packed as one file, which favours those that repeat what others said.
    text = "".join(files)
    pictures = np.stack([image[..., :3] for image in drawn]).clip(0.0, 1.0)
    return Played(pictures, len(text.encode()), gzip_size(text))


def scores(film: Filmed, played: Played, seconds: float) -> dict[str, float | None]:
    """The figures of a clip; None where it has no still pixel.

    psnr_db: mean over the frames. still: mean change of a still pixel from frame to frame less that of the clip, in
    levels of 255. warp: root mean square of the difference from the frame before, moved along the clip's flow, in
    levels. bytes_s, gzip_s: a second of the clip. frame_s: CPU seconds a frame.
    """
    wanted, shown, duration = film.pictures, played.pictures, float(film.ends[-1] - film.begins[0])
    errors = np.square(shown - wanted).mean(axis=(1, 2, 3))
    changes = np.diff(wanted, axis=0)
    still = np.abs(changes).max(axis=-1) < STILL
    flicker = np.abs(np.diff(shown, axis=0) - changes).mean(axis=-1)
    warped = [
        np.square(shown[frame] - moved(shown[frame - 1], flow(wanted[frame - 1], wanted[frame]))).mean()
        for frame in range(1, len(wanted))
    ]
    return {
        "psnr_db": float(np.mean(-10.0 * np.log10(errors.clip(1e-10)))),
        "still": 255.0 * float(flicker[still].mean()) if still.any() else None,
        "warp": 255.0 * float(np.sqrt(np.mean(warped))),
        "bytes_s": played.plain / duration,
        "gzip_s": played.packed / duration,
        "frame_s": seconds / len(wanted),
    }


def flow(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(H, W, 2) int64: rows and columns from which each block of a picture (H, W, 3) came, by the least difference."""
    height, width, _ = after.shape
    shifts = [(dy, dx) for dy in range(-REACH, REACH + 1) for dx in range(-REACH, REACH + 1)]
    shifts.sort(key=lambda shift: abs(shift[0]) + abs(shift[1]))  # of equal ones the shortest
    rows, columns = np.arange(0, height, BLOCK), np.arange(0, width, BLOCK)
    costs = []
    for shift in shifts:
        off = np.abs(after - moved(before, np.broadcast_to(shift, (height, width, 2)))).sum(axis=2)
        costs.append(np.add.reduceat(np.add.reduceat(off, rows, axis=0), columns, axis=1))
    best = np.array(shifts)[np.argmin(costs, axis=0)]
    return best.repeat(BLOCK, axis=0).repeat(BLOCK, axis=1)[:height, :width]


def moved(picture: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """A picture (H, W, C) whose pixels come from so many rows and columns away (H, W, 2), at most from its edge."""
    height, width = picture.shape[:2]
    rows, columns = np.mgrid[:height, :width]
    return picture[(rows + shifts[..., 0]).clip(0, height - 1), (columns + shifts[..., 1]).clip(0, width - 1)]


def clips(
    folder: Annotated[Path, argument("DIR", "Folder of clips.")],
    frames: Annotated[int, option("--frames N", "The first so many frames of each.", min=2)] = 60,
    side: Annotated[int, option("--side PX", "Longer side of the frames, px.", min=16)] = 176,
    curves: Annotated[int, option("--curves N", "Curves of a frame.", min=1)] = 256,
    preset: Annotated[str, option("--preset", "Effort of the fit of a picture.")] = "draft",
    tools: Annotated[str, option("--tools TOOL,...", "Of moving, each and vtracer.")] = "moving,each,vtracer",
    threads: Threads = 1,
    limit: Limit = None,
    json: Json = False,
    markdown: Markdown = False,
) -> None:
    """Quality, flicker, bytes and time of clips as moving curves."""
    names = tools.split(",")
    if not set(names) <= set(TOOLS):
        raise UsageError(f"must be of {', '.join(TOOLS)}, with commas between them, not {tools!r}", "tools")
    if "vtracer" in names and (missing := missing_piece("vtracer")) is not None:
        raise UsageError(f"{missing}, or leave it out of --tools")
    paths = sorted(path for path in folder.iterdir() if not path.name.startswith("."))[:limit]
    if not paths:
        raise UsageError(f"{folder} holds no clips")
    settings = FitSettings.from_preset(preset, curves=curves, threads=threads, device="cpu")
    rows: list[dict[str, Any]] = []
    for path in paths:
        film = read(path, frames, side)
        for label, make in (TOOLS[name] for name in names):
            began = time.process_time()
            played = make(film, settings)
            row = scores(film, played, time.process_time() - began)
            rows.append({"clip": path.name, "tool": label, **row})
            typer.echo(f"{path.name}: {label}", err=True)
    header = ("clip", "tool", "PSNR dB", "still", "warp", "kB/s", "kB/s gzip", "CPU s a frame")
    table = [
        (
            row["clip"], row["tool"], number(row["psnr_db"], 2),
            "" if row["still"] is None else number(row["still"], 2), number(row["warp"], 2),
            number(row["bytes_s"] / 1e3, 1), number(row["gzip_s"] / 1e3, 1), number(row["frame_s"], 2),
        )
        for row in rows
    ]  # fmt: skip
    report = {**head(), "bench": "clips", "preset": preset, "curves": curves, "rows": rows}
    print_report(report, text_table(header, table, markdown=markdown), json=json)


if __name__ == "__main__":
    main(clips)
