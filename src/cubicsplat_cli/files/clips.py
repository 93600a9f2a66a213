"""Clips, read one frame at a time: animated GIF, PNG and WebP files, folders of pictures, and videos by PyAV, which is
imported when one is read.

Every failure is an `InputError` of one line, but for a video that cannot be read for want of a package: `EngineError`.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from cubicsplat_cli.errors import EngineError, InputError
from cubicsplat_cli.files.decode import Decoded, decode, formats_of
from cubicsplat_cli.files.load import Picture, PictureLike, as_picture, load_picture, resize_picture
from cubicsplat_cli.files.marks import sha256_of
from cubicsplat_cli.files.names import pictures_in
from cubicsplat_cli.files.paths import is_folder
from cubicsplat_cli.files.read import read_whole
from cubicsplat_cli.formatting import one_line, printable
from cubicsplat_cli.record import record
from cubicsplat_cli.settings import MAX_PIXELS

FOLDER_FPS = 25.0  # of pictures in a folder, which say no times; as ffmpeg has it
# Browsers show frames of GIFs that ask for at most so many ms for UNTIMED_S each.
_SHORTEST_MS, UNTIMED_S = 10, 0.1
_FORMS = "give a GIF, an animated PNG or WebP, a video, or a folder of pictures"
USUAL_FPS = 25.0  # of a video that says none
# How the files of videos begin that are read: no lists of other files or addresses, which would be followed.
_STARTS = (b"\x1a\x45\xdf\xa3", b"OggS", b"FLV\x01", b"\0\0\x01\xba", b"\0\0\x01\xb3")
_BOXES = (b"ftyp", b"moov", b"mdat", b"free", b"wide", b"skip")
_STILLS = (b"avif", b"avis", b"heic", b"heix", b"hevc", b"mif1", b"msf1")  # pictures in the same boxes
_TRANSPORT, _PACKET = 0x47, 188  # of an MPEG transport stream: how each packet begins, and its bytes


@record
class Frame:
    """A picture that is shown from `begin` until `end`, seconds from the start of the clip."""

    picture: Picture
    begin: float
    end: float


@record
class ClipSource:
    """A clip that can be read.

    frames: reads it from the start, one frame at a time. transparent: whether any frame is. plays: how often it is to
    be shown, 0 for ever. count, seconds: of its frames and of all of it, about, as its file says; None: it does not.
    sha256: of its bytes, of a folder of those of all pictures one after the other.
    """

    name: str
    width: int
    height: int
    transparent: bool
    plays: int
    count: int | None
    sha256: str
    frames: Callable[[], Iterator[Frame]]
    seconds: float | None = None


def open_clip(
    path: Path,
    *,
    fps: float | None = None,
    most_frames: int | None = None,
    max_size: int | None = None,
    max_pixels: int = MAX_PIXELS,
) -> ClipSource:
    """Look a clip through, and give its frames.

    fps: frames a second that are taken in place of the clip's own (folders: FOLDER_FPS). most_frames: taken from the
    start. max_size: px of the longer side of the frames; larger ones are scaled down. max_pixels: of a frame.
    Raises InputError for what is no clip, has a single frame, or cannot be read; EngineError for a video without PyAV.
    """
    shown = printable(str(path))
    if is_folder(path):
        source = _folder_clip(path, fps or FOLDER_FPS, most_frames, max_pixels)
    else:
        data, most = read_whole(path), None if fps else most_frames
        video = is_video(data)
        source = _video_clip(data, shown, max_pixels) if video else _picture_clip(data, shown, most, max_pixels)
        if fps is not None:
            count = None if source.seconds is None else max(1, round(source.seconds * fps))
            source = replace(source, frames=_then(source.frames, lambda frames: _resampled(frames, fps)), count=count)
    return _finished(source, most_frames, max_size)


def _finished(source: ClipSource, most_frames: int | None, max_size: int | None) -> ClipSource:
    """The clip with as many frames as are wanted, as large as is wanted, and its size. InputError for a single one."""
    if most_frames is not None:
        count = None if source.count is None else min(source.count, most_frames)
        taken = _then(source.frames, lambda frames: islice(frames, most_frames))
        source = replace(source, frames=taken, count=count)
    if max_size is not None:
        source = replace(source, frames=_then(source.frames, lambda frames: _smaller(frames, max_size)))
    first = [*islice(source.frames(), 2)]
    if len(first) < 2:
        raise _single(source.name)
    return replace(source, width=first[0].picture.width, height=first[0].picture.height)


def _single(shown: str) -> InputError:
    return InputError(f"{shown}: has one frame only; `cubicsplat vectorize` is for single pictures")


def _then(
    frames: Callable[[], Iterator[Frame]], change: Callable[[Iterator[Frame]], Iterator[Frame]]
) -> Callable[[], Iterator[Frame]]:
    return lambda: change(frames())


def _resampled(frames: Iterator[Frame], fps: float) -> Iterator[Frame]:
    """Whatever frame is shown at each multiple of 1 / fps seconds."""
    taken = 0
    for frame in frames:
        # A time may miss the start of its frame by the rounding of either.
        while taken / fps < frame.end - 1e-6:
            yield replace(frame, begin=taken / fps, end=(taken + 1) / fps)
            taken += 1


def _smaller(frames: Iterator[Frame], max_size: int) -> Iterator[Frame]:
    for frame in frames:
        yield replace(frame, picture=resize_picture(frame.picture, max_size))


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """A key that sorts frame2 before frame10."""
    parts = re.split(r"(\d+)", path.name.lower())
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts if part]


def _folder_clip(folder: Path, fps: float, most: int | None, max_pixels: int) -> ClipSource:
    paths = sorted(pictures_in(folder), key=_natural)[:most]

    def loaded() -> Iterator[tuple[Picture, str]]:
        return ((load_picture(path, max_pixels=max_pixels), printable(str(path))) for path in paths)

    return _clip_at(printable(str(folder)), loaded, fps)


def clip_of_pictures(
    pictures: Sequence[PictureLike], *, fps: float = FOLDER_FPS, max_size: int | None = None
) -> ClipSource:
    """A clip of pictures that are no files. Raises InputError for what is none, and for fewer than two."""
    name = "<frames>"

    def loaded() -> Iterator[tuple[Picture, str]]:
        return ((as_picture(each), f"{name}: frame {index + 1}") for index, each in enumerate(pictures))

    return _finished(_clip_at(name, loaded, fps), None, max_size)


def _clip_at(name: str, loaded: Callable[[], Iterator[tuple[Picture, str]]], fps: float) -> ClipSource:
    """A clip of so many frames a second, of pictures with their names. Its size is left open."""

    def frames() -> Iterator[Frame]:
        size = None
        for index, (picture, shown) in enumerate(loaded()):
            size = size or picture.size
            _check_size(picture, size, shown)
            yield Frame(picture, index / fps, (index + 1) / fps)

    looked = [(frame.picture.alpha is not None, frame.picture.sha256) for frame in frames()]
    digest = sha256_of("".join(sha256 for _, sha256 in looked).encode())
    return ClipSource(name, 0, 0, any(alpha for alpha, _ in looked), 0, len(looked), digest, frames)


def _check_size(picture: Picture, size: tuple[int, int], shown: str) -> None:
    if picture.size != size:
        raise InputError(
            f"{shown}: is {picture.width} x {picture.height} px, the frames before it {size[0]} x {size[1]}; "
            "scale it to their size"
        )


def _picture_clip(data: bytes, shown: str, most: int | None, max_pixels: int) -> ClipSource:
    """The first `most` frames of an animated GIF, PNG, WebP or AVIF file."""
    plays = _plays(data, shown) if data else None
    # The checks of a still picture: its bytes, its pixels.
    load_picture(data, name=shown, max_pixels=max_pixels, frame=1)
    if plays is None:
        raise _single(shown)
    digest = sha256_of(data)

    def frames() -> Iterator[Frame]:
        begin = 0.0
        for decoded, seconds in islice(_decoded_frames(data, shown), most):
            yield Frame(Picture(decoded.rgb, decoded.alpha, shown, digest), begin, begin + seconds)
            begin += seconds

    looked = [(frame.picture.alpha is not None, frame.end) for frame in frames()]
    transparent = any(alpha for alpha, _ in looked)
    return ClipSource(shown, 0, 0, transparent, plays, len(looked), digest, frames, looked[-1][1])


def _plays(data: bytes, shown: str) -> int | None:
    """The number of times an animation asks to be shown, 0 for ever; None of any other picture."""
    try:
        with Image.open(io.BytesIO(data), formats=formats_of(data, shown)) as image:
            if not getattr(image, "is_animated", False) or image.format == "TIFF":
                return None
            loop = image.info.get("loop")
            if image.format != "GIF":
                return int(loop or 0)
            # A GIF counts the repetitions after the first showing, and without a count there are none.
            return 1 if loop is None else 0 if loop == 0 else int(loop) + 1
    except UnidentifiedImageError as error:
        raise InputError(f"{shown}: is no clip; {_FORMS}") from error
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"{shown}: is damaged or truncated ({printable(one_line(error))}); save it again") from error


def _decoded_frames(data: bytes, shown: str) -> Iterator[tuple[Decoded, float]]:
    """Each frame as it is shown, on those before it, and for how many seconds."""
    with Image.open(io.BytesIO(data), formats=formats_of(data, shown)) as image:
        # An animated PNG may begin with a picture for those who show no animations.
        first = 1 if image.info.get("default_image") else 0
        for index in range(first, getattr(image, "n_frames", 1)):
            try:
                image.seek(index)
                decoded = decode(image, data, shown, chosen=True)
            except InputError:
                raise
            except Exception as error:  # as of a still picture, Pillow answers broken bytes with nearly any
                reason = printable(one_line(error)) or type(error).__name__
                raise InputError(
                    f"{shown}: frame {index + 1 - first} is damaged or cut short ({reason}); save it again, or take "
                    "those before it with --frames"
                ) from error
            milliseconds = float(image.info.get("duration") or 0.0)
            yield decoded, milliseconds / 1000.0 if milliseconds > _SHORTEST_MS else UNTIMED_S


def is_video(data: bytes) -> bool:
    """Whether the bytes begin as those of a video that is read."""
    if data[4:8] == b"ftyp" and data[8:12] in _STILLS:
        return False
    transport = len(data) > _PACKET and data[0] == data[_PACKET] == _TRANSPORT
    avi = data.startswith(b"RIFF") and data[8:12] == b"AVI "
    return data.startswith(_STARTS) or data[4:8] in _BOXES or transport or avi


def _video_clip(data: bytes, shown: str, max_pixels: int) -> ClipSource:
    """Raises EngineError where there is no PyAV."""
    opened, digest = partial(_opened_video, data, shown, max_pixels), sha256_of(data)
    with opened() as (_, stream):
        count = stream.frames or None
        seconds = None if stream.duration is None else float(stream.duration * stream.time_base)

    def frames() -> Iterator[Frame]:
        size = None
        with opened() as (container, stream):
            for index, (pixels, begin, end) in enumerate(_video_frames(container, stream)):
                picture = Picture(pixels, None, shown, digest)
                size = size or picture.size
                _check_size(picture, size, f"{shown}: frame {index + 1}")
                yield Frame(picture, begin, end)

    return ClipSource(shown, 0, 0, False, 0, count, digest, frames, seconds)


@contextmanager
def _opened_video(data: bytes, shown: str, max_pixels: int) -> Iterator[tuple[Any, Any]]:
    """The container of a video and its stream of pictures."""
    try:
        import av
    except ModuleNotFoundError as error:
        raise EngineError(
            f"{shown}: is a video; pip install 'cubicsplat[video]' to have it read, or give a GIF or its frames"
        ) from error
    try:
        with av.open(io.BytesIO(data)) as container:
            if not container.streams.video:
                raise InputError(f"{shown}: holds no pictures; give another video, or a GIF")
            stream = container.streams.video[0]
            if stream.width * stream.height > max_pixels:
                raise InputError(
                    f"{shown}: is {stream.width} x {stream.height} px, the limit is {max_pixels:,} pixels; scale it "
                    "down first, or raise it with --max-pixels"
                )
            yield container, stream
    except av.FFmpegError as error:
        reason = printable(one_line(error.strerror or error))
        raise InputError(f"{shown}: is damaged or cut short ({reason}); save it again") from error


def _video_frames(container: Any, stream: Any) -> Iterator[tuple[np.ndarray, float, float]]:
    """Pictures (H, W, 3) float32 in [0, 1], each with the seconds from which and until which it is shown.

    The last is shown as long as one usually is.
    """
    rate = float(stream.average_rate or USUAL_FPS)
    waiting: tuple[np.ndarray, float] | None = None
    start = None
    for index, image in enumerate(container.decode(stream)):
        at = index / rate if image.time is None else float(image.time)
        start = at if start is None else start
        if waiting is not None and at - start <= waiting[1]:
            continue  # two at one time
        if waiting is not None:
            yield *waiting, at - start
        waiting = _upright(image), at - start
    if waiting is not None:
        yield *waiting, waiting[1] + 1.0 / rate


def _upright(image: Any) -> np.ndarray:
    turned = int(getattr(image, "rotation", 0) or 0) // 90 % 4  # counterclockwise
    return np.ascontiguousarray(np.rot90(image.to_ndarray(format="rgb24"), turned), np.float32) / np.float32(255)
