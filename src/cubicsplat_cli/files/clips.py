"""Clips, read one frame at a time: animated GIF, PNG and WebP files, folders of pictures, and videos by PyAV.

Every failure is an `InputError` of one line, except that a video without PyAV is an `EngineError`.
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

from cubicsplat_cli.clip_request import ClipRequest
from cubicsplat_cli.errors import EngineError, InputError
from cubicsplat_cli.files.decode import AVIF, HEIC, decode, formats_of
from cubicsplat_cli.files.load import Picture, PictureLike, as_picture, load_picture, resize_picture
from cubicsplat_cli.files.marks import sha256_of
from cubicsplat_cli.files.names import pictures_in
from cubicsplat_cli.files.paths import is_folder
from cubicsplat_cli.files.read import read_whole
from cubicsplat_cli.formatting import one_line, printable
from cubicsplat_cli.record import record

FOLDER_FPS = 25.0  # of pictures in a folder, which have no times: the default of ffmpeg
UNTIMED_S = 0.1  # of a frame that asks for 10 ms or less, as browsers show it
_ONE_FRAME = "has one frame only; `cubicsplat vectorize` is for single pictures"


@record
class Frame:
    """A picture that is shown from `begin` until `end`, seconds from the start of the clip."""

    picture: Picture
    begin: float
    end: float


@record
class ClipSource:
    """A clip that can be read.

    frames: reads it from the start, one frame at a time. transparent: whether any frame is. plays: how often to show
    it, 0 for ever. count, seconds: the approximate number of frames and length that its file states, or None. sha256:
    of its bytes; of a folder, of the hashes of all pictures. width, height: px.
    """

    name: str
    transparent: bool
    plays: int
    count: int | None
    sha256: str
    frames: Callable[[], Iterator[Frame]]
    seconds: float | None = None
    width: int = 0
    height: int = 0

    def changed(self, change: Callable[[Iterator[Frame]], Iterator[Frame]], count: int | None) -> ClipSource:
        """Return the clip with its frames changed, about `count` of them."""
        return replace(self, frames=lambda: change(self.frames()), count=count)


def open_clip(path: Path, request: ClipRequest) -> ClipSource:
    """Open a clip, and check all of its frames.

    request: its `fps` take the place of the clip's own times (folders: FOLDER_FPS); larger frames than its `max_size`
    are scaled down. Raises InputError for anything but a readable clip of two frames or more; EngineError for a video
    without PyAV.
    """
    shown, fps, max_pixels = printable(str(path)), request.fps, request.max_pixels
    if is_folder(path):
        paths = sorted(pictures_in(path), key=_natural)[: request.frames]
        loaded = [(partial(load_picture, each, max_pixels=max_pixels), printable(str(each))) for each in paths]
        source = _timed_clip(shown, loaded, fps or FOLDER_FPS)
    else:
        data = read_whole(path)
        if is_video(data):
            source = _video_clip(data, shown, max_pixels)
        else:
            source = _picture_clip(data, shown, None if fps else request.frames, max_pixels)
        if fps is not None:
            count = None if source.seconds is None else max(1, round(source.seconds * fps))
            source = source.changed(lambda frames: _resampled(frames, fps), count)
    return _finished(source, request)


def _finished(source: ClipSource, request: ClipRequest) -> ClipSource:
    """Return the clip cut to the request's frames, scaled down, with its size. Raises InputError for a single frame."""
    most_frames, max_size = request.frames, request.max_size
    if most_frames is not None:
        count = None if source.count is None else min(source.count, most_frames)
        source = source.changed(lambda frames: islice(frames, most_frames), count)
    if max_size is not None:
        source = source.changed(
            lambda frames: (replace(frame, picture=resize_picture(frame.picture, max_size)) for frame in frames),
            source.count,
        )
    first = [*islice(source.frames(), 2)]
    if len(first) < 2:
        raise InputError(f"{source.name}: {_ONE_FRAME}")
    return replace(source, width=first[0].picture.width, height=first[0].picture.height)


def _resampled(frames: Iterator[Frame], fps: float) -> Iterator[Frame]:
    """Yield the frame that is shown at each multiple of 1 / fps seconds."""
    taken = 0
    for frame in frames:
        while taken / fps < frame.end - 1e-6:  # rounding may move a time across the start of its frame
            yield replace(frame, begin=taken / fps, end=(taken + 1) / fps)
            taken += 1


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Return a key that sorts frame2 before frame10."""
    parts = re.split(r"(\d+)", path.name.lower())
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts if part]


def clip_of_pictures(pictures: Sequence[PictureLike], request: ClipRequest) -> ClipSource:
    """Return a clip of pictures that are no files. Raises InputError for anything else, and for fewer than two."""
    taken = enumerate([*pictures][: request.frames], 1)
    loaded = [(partial(as_picture, picture), f"<frames>: frame {number}") for number, picture in taken]
    return _finished(_timed_clip("<frames>", loaded, request.fps or FOLDER_FPS), request)


def _timed_clip(name: str, loaded: Sequence[tuple[Callable[[], Picture], str]], fps: float) -> ClipSource:
    """Return a clip of so many frames a second. loaded: for each picture a function that loads it, and its name."""

    def frames() -> Iterator[Frame]:
        size = None
        for index, (load, shown) in enumerate(loaded):
            picture = load()
            size = _checked_size(picture, size, shown)
            yield Frame(picture, index / fps, (index + 1) / fps)

    looked = [(frame.picture.alpha is not None, frame.picture.sha256) for frame in frames()]
    digest = sha256_of("".join(sha256 for _, sha256 in looked).encode())
    return ClipSource(name, any(alpha for alpha, _ in looked), 0, len(looked), digest, frames)


def _checked_size(picture: Picture, size: tuple[int, int] | None, shown: str) -> tuple[int, int]:
    """Return a frame's size. Raises InputError if it is not that of the frames before, if there are any."""
    if size and picture.size != size:
        sizes = f"{picture.width} x {picture.height} px, the frames before it {size[0]} x {size[1]}"
        raise InputError(f"{shown}: is {sizes}; scale it to their size")
    return picture.size


def _picture_clip(data: bytes, shown: str, most: int | None, max_pixels: int) -> ClipSource:
    """Return a clip of the first `most` frames of an animated GIF, PNG, WebP or AVIF file."""
    plays = _plays(data, shown) if data else None
    load_picture(data, name=shown, max_pixels=max_pixels, frame=1)  # checks bytes and pixels as of a still picture
    if plays is None:
        raise InputError(f"{shown}: {_ONE_FRAME}")
    digest = sha256_of(data)

    def frames() -> Iterator[Frame]:
        begin = 0.0
        for rgb, alpha, seconds in islice(_decoded_frames(data, shown), most):
            yield Frame(Picture(rgb, alpha, shown, digest), begin, begin + seconds)
            begin += seconds

    looked = [(frame.picture.alpha is not None, frame.end) for frame in frames()]
    return ClipSource(shown, any(alpha for alpha, _ in looked), plays, len(looked), digest, frames, looked[-1][1])


def _plays(data: bytes, shown: str) -> int | None:
    """Return the number of times that an animation asks to be shown, 0 for ever; None for any other picture."""
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
        forms = "a GIF, an animated PNG or WebP, a video, or a folder of pictures"
        raise InputError(f"{shown}: is no clip; give {forms}") from error
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"{shown}: is damaged or truncated ({printable(one_line(error))}); save it again") from error


def _decoded_frames(data: bytes, shown: str) -> Iterator[tuple[np.ndarray, np.ndarray | None, float]]:
    """Yield rgb and alpha of each frame as it is shown, composed with the frames before it, and its seconds."""
    with Image.open(io.BytesIO(data), formats=formats_of(data, shown)) as image:
        # An animated PNG may begin with a picture for those who show no animations.
        first = 1 if image.info.get("default_image") else 0
        for index in range(first, getattr(image, "n_frames", 1)):
            try:
                image.seek(index)
                rgb, alpha, *_ = decode(image, data, shown, chosen=True)
            except InputError:
                raise
            except Exception as error:  # as of a still picture, Pillow answers broken bytes with nearly any
                reason = printable(one_line(error)) or type(error).__name__
                text = f"{shown}: frame {index + 1 - first} is damaged or cut short ({reason})"
                raise InputError(f"{text}; save it again, or take those before it with --frames") from error
            milliseconds = float(image.info.get("duration") or 0.0)
            yield rgb, alpha, milliseconds / 1000.0 if milliseconds > 10.0 else UNTIMED_S


def is_video(data: bytes) -> bool:
    """Return whether the bytes begin as a video does; lists of other files or addresses, which PyAV follows, do not."""
    if data[4:8] == b"ftyp" and data[8:12] in AVIF | HEIC:  # pictures in the boxes of videos
        return False
    transport = len(data) > 188 and data[0] == data[188] == 0x47  # the start of each packet of an MPEG transport stream
    avi = data.startswith(b"RIFF") and data[8:12] == b"AVI "
    starts = (b"\x1a\x45\xdf\xa3", b"OggS", b"FLV\x01", b"\0\0\x01\xba", b"\0\0\x01\xb3")
    boxes = (b"ftyp", b"moov", b"mdat", b"free", b"wide", b"skip")
    return data.startswith(starts) or data[4:8] in boxes or transport or avi


def _video_clip(data: bytes, shown: str, max_pixels: int) -> ClipSource:
    """Return the clip of a video. Raises EngineError without PyAV."""
    opened, digest = partial(_opened_video, data, shown, max_pixels), sha256_of(data)
    with opened() as (_, stream):
        count = stream.frames or None
        seconds = None if stream.duration is None else float(stream.duration * stream.time_base)

    def frames() -> Iterator[Frame]:
        size = None
        with opened() as (container, stream):
            for index, (pixels, begin, end) in enumerate(_video_frames(container, stream)):
                picture = Picture(pixels, None, shown, digest)
                size = _checked_size(picture, size, f"{shown}: frame {index + 1}")
                yield Frame(picture, begin, end)

    return ClipSource(shown, False, 0, count, digest, frames, seconds)


@contextmanager
def _opened_video(data: bytes, shown: str, max_pixels: int) -> Iterator[tuple[Any, Any]]:
    """Open a video; give its container and its stream of pictures."""
    try:
        import av
    except ModuleNotFoundError as error:
        advice = "pip install 'cubicsplat[video]' to have it read, or give a GIF or its frames"
        raise EngineError(f"{shown}: is a video; {advice}") from error
    try:
        with av.open(io.BytesIO(data)) as container:
            if not container.streams.video:
                raise InputError(f"{shown}: holds no pictures; give another video, or a GIF")
            stream = container.streams.video[0]
            if stream.width * stream.height > max_pixels:
                sizes = f"{stream.width} x {stream.height} px, the limit is {max_pixels:,} pixels"
                raise InputError(f"{shown}: is {sizes}; scale it down first, or raise it with --max-pixels")
            yield container, stream
    except av.FFmpegError as error:
        reason = printable(one_line(error.strerror or error))
        raise InputError(f"{shown}: is damaged or cut short ({reason}); save it again") from error


def _video_frames(container: Any, stream: Any) -> Iterator[tuple[np.ndarray, float, float]]:
    """Yield upright pictures (H, W, 3) float32 in [0, 1] with the seconds at which each begins and ends.

    The last one lasts as long as the average, or a 25th of a second.
    """
    rate = float(stream.average_rate or 25.0)
    waiting: tuple[np.ndarray, float] | None = None
    start = None
    for index, image in enumerate(container.decode(stream)):
        at = index / rate if image.time is None else float(image.time)
        start = at if start is None else start
        if waiting is not None and at - start <= waiting[1]:
            continue  # two at one time
        if waiting is not None:
            yield *waiting, at - start
        quarters = int(getattr(image, "rotation", 0) or 0) // 90 % 4  # counterclockwise, as its file says
        upright = np.ascontiguousarray(np.rot90(image.to_ndarray(format="rgb24"), quarters), np.float32)
        waiting = upright / np.float32(255), at - start
    if waiting is not None:
        yield *waiting, waiting[1] + 1.0 / rate
