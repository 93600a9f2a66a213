"""`cubicsplat animate` and the library's `animate`: from a clip to a file whose figures are those of what it plays."""

from __future__ import annotations

import gzip
import json
import re
from pathlib import Path

import numpy as np
import pytest
from clip_reader import read_clip
from command import run_here
from conftest import ctrl_c_when, rest_slow
from PIL import Image, ImageDraw

import cubicsplat_cli
from cubicsplat_cli.clip_request import ClipRequest
from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.clips import clip_of_pictures
from cubicsplat_cli.files.paths import is_ours
from cubicsplat_cli.from_options import clip_request_of
from cubicsplat_cli.pipeline.animation import CHANGE_S, ClipTask
from cubicsplat_cli.progress import StageTimer

WIDTH, HEIGHT, FRAMES = 48, 32, 5
FIT = ("--style", "photo", "--curves", 6, "--steps", 150, "--threads", 1)


def frames(count: int = FRAMES, *, transparent: bool = False) -> list[Image.Image]:
    """A disc that moves over a ground in two halves, or over nothing."""
    made = []
    for index in range(count):
        image = Image.new("RGBA", (WIDTH, HEIGHT), (0, 0, 0, 0) if transparent else (40, 90, 160, 255))
        pen = ImageDraw.Draw(image)
        if not transparent:
            pen.rectangle((0, HEIGHT // 2, WIDTH, HEIGHT), fill=(220, 200, 90, 255))
        pen.ellipse((4 + 5 * index, 8, 20 + 5 * index, 24), fill=(200, 30, 40, 255))
        made.append(image)
    return made


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clips") / "disc.gif"
    first, *rest = [image.convert("RGB") for image in frames()]
    first.save(path, save_all=True, append_images=rest, duration=100, loop=0)
    return path


def animated(clip: Path, *options: object):
    return run_here("animate", clip, *FIT, *options)


def error_of(*arguments: object, code: int) -> str:
    (line,) = run_here("animate", *arguments, code=code).stderr.decode().splitlines()
    assert line.startswith("cubicsplat: error: ")
    return line


def test_a_gif_becomes_an_svg_with_its_figures(clip, tmp_path):
    done = animated(clip, "-o", tmp_path / "disc.svg", "--report")
    text = (tmp_path / "disc.svg").read_text()
    report = json.loads((tmp_path / "disc.json").read_bytes())
    assert "<animate" in text and "script" not in text and text.startswith("<?xml")
    assert is_ours(tmp_path / "disc.svg") and is_ours(tmp_path / "disc.json")
    assert report["input"] | {"path": "", "sha256": ""} == {
        "path": "", "sha256": "", "width": WIDTH, "height": HEIGHT, "alpha": False, "frames": FRAMES, "seconds": 0.5,
        "plays": 0,
    }  # fmt: skip
    output = report["output"]
    assert (output["format"], output["bytes"], output["groups"]) == ("smil", len(text), 1)
    assert output["compressed_bytes"] == len(gzip.compress(text.encode(), mtime=0))
    assert output["curves"] == text.count("<path ") and output["knots"] > 0
    assert len(report["quality"]["frames"]) == FRAMES and not report["interrupted"]
    assert re.search(rf"disc\.svg  photo  {FRAMES} frames  {output['curves']} curves  .* dB", done.stderr.decode())
    assert b"<!doctype html>" in (tmp_path / "disc.html").read_bytes()


def test_the_figures_are_of_what_the_file_plays(clip, tmp_path):
    animated(clip, "-o", tmp_path / "disc.svg")
    report = json.loads((tmp_path / "disc.json").read_bytes())
    levels = [frame["psnr_db"] for frame in report["quality"]["frames"]]
    assert report["quality"]["psnr_db"] == pytest.approx(sum(levels) / len(levels), abs=1e-3)
    assert report["quality"]["worst_psnr_db"] == min(levels)
    # Viewers that stand still show the first frame, drawn here by another program.
    drawn = rerender((tmp_path / "disc.svg").read_bytes(), WIDTH, HEIGHT).pixels[..., :3]
    error = np.square((drawn - np.asarray(frames()[0].convert("RGB")).astype(float)) / 255).mean()
    assert -10 * np.log10(error) == pytest.approx(levels[0], abs=0.5)


def test_formats_follow_from_the_name(clip, tmp_path):
    animated(clip, "-o", tmp_path / "disc.json")
    assert json.loads((tmp_path / "disc.json").read_bytes())["w"] == WIDTH
    assert json.loads((tmp_path / "disc.metrics.json").read_bytes())["output"]["format"] == "lottie"
    # The figures of an SVG do not replace a Lottie file of the same name.
    animated(clip, "-o", tmp_path / "disc.svg")
    assert json.loads((tmp_path / "disc.json").read_bytes())["w"] == WIDTH
    assert json.loads((tmp_path / "disc.metrics.json").read_bytes())["output"]["format"] == "smil"
    for count in (FRAMES, 3):
        animated(clip, "-o", f"{tmp_path}/disc/", "--frames", count)
        names = sorted(path.name for path in (tmp_path / "disc").iterdir())
        # Those of a longer clip before are gone.
        assert names == [*(f"{index + 1:04d}.svg" for index in range(count)), "frames.json", "metrics.json"]
    times = json.loads((tmp_path / "disc" / "frames.json").read_bytes())
    assert [frame["begin_s"] for frame in times["frames"]] == pytest.approx([0.0, 0.1, 0.2])
    scene = cubicsplat_cli.read_svg((tmp_path / "disc" / "0002.svg").read_text())
    assert (scene.width, scene.height) == (WIDTH, HEIGHT)


def test_a_transparent_clip_stays_transparent_and_plays_as_often_as_it_says(tmp_path):
    first, *rest = frames(3, transparent=True)
    path = tmp_path / "disc.webp"
    first.save(path, save_all=True, append_images=rest, duration=100, loop=2, lossless=True)
    animated(path)
    text = (tmp_path / "disc.svg").read_text()
    assert "<rect" not in text and 'repeatCount="2"' in text
    assert (rerender(text.encode(), WIDTH, HEIGHT).pixels[0, -1] == 0).all()
    animated(path, "--loop")
    assert 'repeatCount="indefinite"' in (tmp_path / "disc.svg").read_text()


def test_wrong_use_is_told_before_the_work(clip, tmp_path):
    (tmp_path / "mine.svg").write_text("<svg>of somebody</svg>")
    (tmp_path / "text.gif").write_text("hello")
    cases = [
        ((clip, "-o", tmp_path / "mine.svg"), 2, "was not written by cubicsplat; use --force"),
        ((clip, "-o", tmp_path / "out.mp4"), 2, "must end in .svg, .json (Lottie) or / (frames)"),
        ((clip, "-o", tmp_path / "out.svg", "--format", "lottie"), 2, "leave out --format"),
        ((clip, "-o", ""), 2, "a file name is empty"),
        (("",), 2, "a file name is empty"),
        ((clip, "--fps", 0), 2, "--fps must be a number from 0.1 to 240"),
        ((clip, "--frames", 1), 2, "--frames must be a whole number"),
        ((clip, "--max-bytes", "20k", "--curves", 3), 2, "leave out --curves"),
        ((tmp_path / "text.gif", "-o", tmp_path / "x.svg"), 1, "is no clip"),
        ((tmp_path / "none.gif",), 1, "no such file"),
    ]
    for arguments, code, said in cases:
        assert said in error_of(*arguments, code=code)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.svg", "text.gif"]


def test_the_library_takes_pictures_and_prints_nothing(capfd):
    pictures = [np.asarray(image.convert("RGB")) for image in frames(3)]
    made = cubicsplat_cli.animate(pictures, fps=10, style="photo", curves=6, steps=150, threads=1)
    assert capfd.readouterr() == ("", "")
    assert (made.report.input.frames, made.report.input.seconds) == (3, pytest.approx(0.3))
    assert read_clip(made.svg).width == WIDTH and json.loads(made.lottie())["h"] == HEIGHT
    assert sorted(made.frames()) == ["0001.svg", "0002.svg", "0003.svg", "frames.json"]
    with pytest.raises(UsageError, match="did you mean curves"):
        cubicsplat_cli.animate(pictures, curve=3)
    with pytest.raises(InputError, match="one frame only"):
        cubicsplat_cli.animate(pictures[:1])
    with pytest.raises(InputError, match="scale it to their size"):
        cubicsplat_cli.animate([pictures[0], pictures[1][:8]])


def test_scenes_of_a_frame_each_keep_theirs_at_times_that_the_file_rounds():
    shades = [Image.new("RGB", (24, 16), shade) for shade in ("black", "white", "black", "white", "black", "white")]
    made = cubicsplat_cli.animate(shades, fps=7, style="photo", curves=2, steps=30, threads=1)
    drawn = [
        rerender(still.encode(), 24, 16).pixels for name, still in sorted(made.frames().items()) if name[-3:] == "svg"
    ]
    assert [round(float(pixels[..., :3].mean()) / 255.0) for pixels in drawn] == [0, 1, 0, 1, 0, 1]


def test_an_interrupt_writes_the_clip_so_far():
    pictures = [np.asarray(image.convert("RGB")) for image in frames(5)]
    stop = ctrl_c_when(lambda progress: progress.share > 0.1)
    made = cubicsplat_cli.animate(pictures, fps=10, style="photo", curves=6, steps=150, threads=1, on_progress=stop)
    assert made.report.interrupted and 1 <= made.report.input.frames <= 5


@pytest.mark.parametrize("most", rest_slow("1kgz", "4k"))
def test_as_much_as_fits_into_the_bytes(clip, tmp_path, most):
    options = ("--steps", 200, "--threads", 1, "--max-bytes", most)
    run_here("animate", clip, "-o", tmp_path / "disc.svg", *options)
    data = (tmp_path / "disc.svg").read_bytes()
    size = len(gzip.compress(data, mtime=0)) if most.endswith("gz") else len(data)
    assert 0.6 < size / int(most[0]) / 1000 <= 1.0


def test_bytes_for_no_curve_at_all_are_refused(clip, tmp_path):
    line = error_of(clip, "-o", tmp_path / "x.svg", "--style", "photo", "--steps", 5, "--max-bytes", 300, code=1)
    assert "1 curve need more than 300 bytes; allow more" in line
    assert not (tmp_path / "x.svg").exists()


def test_a_frame_that_is_shown_for_long_stands_still_before_it_changes():
    task = ClipTask(clip_of_pictures(frames(2), ClipRequest(fps=1)), ClipRequest(), "", StageTimer())
    assert [(frame.begin, frame.end) for frame in task.held_frames()] == [
        (0.0, 1 - CHANGE_S), (1 - CHANGE_S, 1.0), (1.0, 2 - CHANGE_S), (2 - CHANGE_S, 2.0),
    ]  # fmt: skip


def test_requests_are_checked_and_hashed():
    assert clip_request_of({"curves": 5}).digest() != clip_request_of({"curves": 6}).digest()
    assert clip_request_of({"force": True, "threads": 3}).digest() == clip_request_of({}).digest()
    assert (ClipRequest().plays(3), ClipRequest(loop=True).plays(3), ClipRequest(loop=False).plays(0)) == (3, 0, 1)
