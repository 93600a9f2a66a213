"""Clips are read as browsers show them: every frame on those before it, for its own time, as often as the file says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw

from cubicsplat_cli.clip_request import ClipRequest
from cubicsplat_cli.errors import EngineError, InputError
from cubicsplat_cli.files.clips import is_video, open_clip
from cubicsplat_cli.files.decode import AVIF, HEIC

SIZE = (24, 16)


def discs(count: int = 4, ground: tuple[int, ...] = (0, 0, 0, 0)) -> list[Image.Image]:
    """A red disc that moves 4 px to the right from frame to frame."""
    frames = []
    for index in range(count):
        frames.append(Image.new("RGBA", SIZE, ground))
        ImageDraw.Draw(frames[-1]).ellipse((4 * index, 4, 4 * index + 8, 12), fill=(200, 30, 30, 255))
    return frames


def saved(path: Path, frames: list[Image.Image], **options: object) -> Path:
    frames[0].save(path, save_all=True, append_images=frames[1:], **options)
    return path


def rgba(picture) -> np.ndarray:
    return np.round(picture.premultiplied() * 255).astype(int)


@pytest.mark.parametrize("name", ["a.gif", "a.webp", "a.png"])
def test_frames_are_whole_pictures_with_their_own_times(tmp_path, name):
    frames = discs()
    options = {"disposal": 2} if name == "a.gif" else {"lossless": True} if name == "a.webp" else {}
    path = saved(tmp_path / name, frames, duration=[100, 200, 50, 1000], loop=0, **options)
    clip = open_clip(path, ClipRequest())
    assert (clip.width, clip.height, clip.transparent, clip.plays, clip.count) == (*SIZE, True, 0, 4)
    read = [*clip.frames()]
    times = [(frame.begin, frame.end) for frame in read]
    np.testing.assert_allclose(times, [(0, 0.1), (0.1, 0.3), (0.3, 0.35), (0.35, 1.35)], atol=1e-9)
    for frame, made in zip(read, frames, strict=True):
        wanted = np.asarray(made).astype(int)
        assert np.abs(rgba(frame.picture) - wanted * (wanted[..., 3:] > 0)).max() <= 1


def test_what_a_frame_leaves_out_is_what_the_one_before_it_showed(tmp_path):
    # Optimised GIFs hold the changed rectangle only, transparent where nothing changes.
    frames = [frame.convert("RGB") for frame in discs(ground=(20, 120, 220, 255))]
    clip = open_clip(saved(tmp_path / "a.gif", frames, duration=100, disposal=1, optimize=True), ClipRequest())
    assert not clip.transparent
    for frame, made in zip(clip.frames(), frames, strict=True):
        assert np.abs(frame.picture.rgb * 255 - np.asarray(made)).max() <= 1


@pytest.mark.parametrize(
    ("name", "loop", "plays"),
    [("a.gif", None, 1), ("a.gif", 0, 0), ("a.gif", 2, 3), ("a.png", 2, 2), ("a.webp", 3, 3), ("a.webp", 0, 0)],
)
def test_how_often_a_clip_is_shown(tmp_path, name, loop, plays):
    options = {} if loop is None else {"loop": loop}
    assert open_clip(saved(tmp_path / name, discs(), duration=40, **options), ClipRequest()).plays == plays


def test_a_gif_without_times_runs_at_ten_frames_a_second_as_in_browsers(tmp_path):
    clip = open_clip(saved(tmp_path / "a.gif", discs(), duration=0), ClipRequest())
    assert [round(frame.end - frame.begin, 6) for frame in clip.frames()] == [0.1] * 4


def test_a_folder_is_read_in_natural_order(tmp_path):
    for index, frame in enumerate(discs(12)):
        frame.convert("RGB").save(tmp_path / f"frame{index}.png")
    clip = open_clip(tmp_path, ClipRequest(fps=10))
    assert clip.count == 12
    for index, (frame, made) in enumerate(zip(clip.frames(), discs(12), strict=True)):
        assert (frame.begin, frame.end) == (index / 10, (index + 1) / 10)
        assert np.array_equal(np.round(frame.picture.rgb * 255), np.asarray(made.convert("RGB")))


def test_other_frame_rates_take_what_is_shown_at_their_times(tmp_path):
    path = saved(tmp_path / "a.gif", discs(), duration=[100, 200, 100, 400], disposal=2)
    columns = [
        int(np.argmax(frame.picture.alpha[8] > 0)) // 4 for frame in open_clip(path, ClipRequest(fps=5)).frames()
    ]
    assert columns == [0, 1, 3, 3]  # at 0, 0.2, 0.4 and 0.6 s
    assert len([*open_clip(path, ClipRequest(fps=20)).frames()]) == open_clip(path, ClipRequest(fps=20)).count == 16
    assert len([*open_clip(path, ClipRequest(frames=3)).frames()]) == 3
    small = open_clip(path, ClipRequest(max_size=12))
    assert (small.width, small.height) == (12, 8)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("none.gif", "no such file"), ("text.gif", "is no clip"), ("one.gif", "one frame only"),
        ("one.png", "one frame only"), ("cut.gif", "frame 4 is damaged or cut short"), ("empty.gif", "empty"),
        ("sizes", "is 8 x 8 px, the frames before it 24 x 16"), ("single", "one frame only"),
    ],
)  # fmt: skip
def test_what_is_no_clip_is_refused_in_one_line(tmp_path, name, said):
    whole = saved(tmp_path / "whole.gif", discs(), duration=40, disposal=2).read_bytes()
    (tmp_path / "text.gif").write_text("hello")
    (tmp_path / "empty.gif").write_bytes(b"")
    (tmp_path / "cut.gif").write_bytes(whole[:-20])
    for one in ("one.gif", "one.png"):
        discs()[0].save(tmp_path / one)
    for folder, sizes in (("sizes", [SIZE, (8, 8)]), ("single", [SIZE])):
        (tmp_path / folder).mkdir()
        for index, size in enumerate(sizes):
            Image.new("RGB", size).save(tmp_path / folder / f"{index}.png")
    with pytest.raises(InputError, match=said) as caught:
        open_clip(tmp_path / name, ClipRequest())
    assert "\n" not in str(caught.value)


def test_frames_before_a_damaged_one_can_be_taken(tmp_path):
    whole = saved(tmp_path / "whole.gif", discs(), duration=40, disposal=2).read_bytes()
    (tmp_path / "cut.gif").write_bytes(whole[:-20])
    assert len([*open_clip(tmp_path / "cut.gif", ClipRequest(frames=3)).frames()]) == 3


@pytest.mark.parametrize("brand", sorted(AVIF | HEIC))
def test_a_still_picture_in_the_boxes_of_videos_is_no_video(brand):
    assert not is_video(b"\0\0\0\x18ftyp" + brand + bytes(16))
    assert is_video(b"\0\0\0\x18ftypisom" + bytes(16))


def test_a_video_needs_pyav_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "av", None)
    (tmp_path / "clip.mp4").write_bytes(b"\0\0\0\x18ftypisom" + bytes(64))
    with pytest.raises(EngineError, match=r"pip install 'cubicsplat\[video\]'"):
        open_clip(tmp_path / "clip.mp4", ClipRequest())


def test_videos_are_read_with_the_times_of_their_frames(tmp_path):
    av = pytest.importorskip("av", reason="needs PyAV: pip install 'cubicsplat[video]'")
    path = tmp_path / "clip.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=20)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv444p"
        for frame in discs(ground=(20, 120, 220, 255)):
            container.mux(stream.encode(av.VideoFrame.from_image(frame.convert("RGB"))))
        container.mux(stream.encode(None))
    read = [*open_clip(path, ClipRequest()).frames()]
    np.testing.assert_allclose([(f.begin, f.end) for f in read], [(i / 20, (i + 1) / 20) for i in range(4)], atol=2e-3)
    for frame, made in zip(read, discs(ground=(20, 120, 220, 255)), strict=True):
        assert np.abs(frame.picture.rgb * 255 - np.asarray(made.convert("RGB"))).max() <= 6  # of its YUV
    path.write_bytes(path.read_bytes()[:40] + bytes(400))
    with pytest.raises(InputError, match=r"damaged or cut short|holds no pictures"):
        open_clip(path, ClipRequest())
