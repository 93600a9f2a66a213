"""Videos by PyAV, which is imported when one is read."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from cubicsplat_cli.errors import EngineError, InputError
from cubicsplat_cli.formatting import one_line, printable
from cubicsplat_cli.record import record

USUAL_FPS = 25.0  # of a video that says none
# How the files of videos begin that are read: no lists of other files or addresses, which would be followed.
_STARTS = (b"\x1a\x45\xdf\xa3", b"OggS", b"FLV\x01", b"\0\0\x01\xba", b"\0\0\x01\xb3")
_BOXES = (b"ftyp", b"moov", b"mdat", b"free", b"wide", b"skip")
_STILLS = (b"avif", b"avis", b"heic", b"heix", b"hevc", b"mif1", b"msf1")  # pictures in the same boxes
_TRANSPORT, _PACKET = 0x47, 188  # of an MPEG transport stream: how each packet begins, and its bytes


def is_video(data: bytes) -> bool:
    """Whether the bytes begin as those of a video that is read."""
    if data[4:8] == b"ftyp" and data[8:12] in _STILLS:
        return False
    transport = len(data) > _PACKET and data[0] == data[_PACKET] == _TRANSPORT
    avi = data.startswith(b"RIFF") and data[8:12] == b"AVI "
    return data.startswith(_STARTS) or data[4:8] in _BOXES or transport or avi


@record
class Video:
    """The bytes of a video, and its name for messages. count, seconds: as its file says; None: it does not."""

    data: bytes
    shown: str
    max_pixels: int
    count: int | None = None
    seconds: float | None = None

    @contextmanager
    def opened(self) -> Iterator[tuple[Any, Any]]:
        """Its container and stream of pictures. Raises InputError for what cannot be read."""
        import av

        try:
            with av.open(io.BytesIO(self.data)) as container:
                if not container.streams.video:
                    raise InputError(f"{self.shown}: holds no pictures; give another video, or a GIF")
                stream = container.streams.video[0]
                if stream.width * stream.height > self.max_pixels:
                    raise InputError(
                        f"{self.shown}: is {stream.width} x {stream.height} px, the limit is {self.max_pixels:,} "
                        "pixels; scale it down first, or raise it with --max-pixels"
                    )
                yield container, stream
        except av.FFmpegError as error:
            reason = printable(one_line(error.strerror or error))
            raise InputError(f"{self.shown}: is damaged or cut short ({reason}); save it again") from error

    def frames(self) -> Iterator[tuple[np.ndarray, float, float]]:
        """Pictures (H, W, 3) float32 in [0, 1], each with the seconds from which and until which it is shown.

        The last is shown as long as one usually is.
        """
        with self.opened() as (container, stream):
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


def open_video(data: bytes, shown: str, max_pixels: int) -> Video:
    """The video in a file's bytes. Raises EngineError where there is no PyAV, InputError for what cannot be read."""
    try:
        import av  # noqa: F401
    except ModuleNotFoundError as error:
        raise EngineError(
            f"{shown}: is a video; pip install 'cubicsplat[video]' to have it read, or give a GIF or its frames"
        ) from error
    with Video(data, shown, max_pixels).opened() as (_, stream):
        seconds = None if stream.duration is None else float(stream.duration * stream.time_base)
        return Video(data, shown, max_pixels, stream.frames or None, seconds)


def _upright(image: Any) -> np.ndarray:
    turned = int(getattr(image, "rotation", 0) or 0) // 90 % 4  # counterclockwise
    return np.ascontiguousarray(np.rot90(image.to_ndarray(format="rgb24"), turned), np.float32) / np.float32(255)
