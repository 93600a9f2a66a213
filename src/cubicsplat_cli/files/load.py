"""Loading a picture from a file or from bytes that nobody vouches for, or taking it from an array or a Pillow image.

Every failure is an `InputError` of one line that names the file, what is wrong and what to do. The order of
the checks matters: kind of file before opening it (a FIFO would block), bytes before reading them, pixels
before decoding them (a decompression bomb is a small file).
"""

from __future__ import annotations

import hashlib
import io
import os
import tempfile
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.files.decode import (
    FORMATS_TEXT,
    MAX_DECODED_PIXELS,
    Compression,
    Decoded,
    decode,
    draft,
    factor_for,
    formats_of,
)
from cubicsplat_cli.files.marks import sha256_of
from cubicsplat_cli.files.read import check_size, read_whole
from cubicsplat_cli.formatting import counted, one_line, printable
from cubicsplat_cli.record import record
from cubicsplat_cli.settings import MAX_PIXELS

_pillow_lock = threading.Lock()
_BEGINNINGS = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"GIF87a", b"GIF89a", b"II*\0", b"MM\0*")


@record
class Picture:
    """A decoded picture in sRGB, independent of the file it came from.

    `rgb` is (H, W, 3) float32 in [0, 1], straight (not premultiplied), 0 where `alpha` is 0.
    `alpha` is (H, W) float32 in [0, 1], or None when every pixel is opaque.
    `source` is the name for messages, `sha256` the digest of the file's bytes, `notes` what the user should
    know about how the file was read (one sentence each). `full_size` is the width and height of a picture that was
    read smaller than it is, else None. `compression`: of a file that was compressed with loss, else None.
    """

    rgb: np.ndarray
    alpha: np.ndarray | None
    source: str
    sha256: str
    notes: tuple[str, ...] = ()
    full_size: tuple[int, int] | None = None
    compression: Compression | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture in the file, px."""
        return self.full_size or (self.width, self.height)

    @property
    def width(self) -> int:
        return int(self.rgb.shape[1])

    @property
    def height(self) -> int:
        return int(self.rgb.shape[0])

    def premultiplied(self) -> np.ndarray:
        """(H, W, 4) float32 in [0, 1]: colours times alpha, and alpha (1 where the picture has none)."""
        alpha = np.ones(self.rgb.shape[:2], np.float32) if self.alpha is None else self.alpha
        return np.concatenate([self.rgb * alpha[..., None], alpha[..., None]], axis=2)

    def target(self) -> np.ndarray:
        """The target of a fit: (H, W, 3) when the picture is opaque, else premultiplied (H, W, 4); float32."""
        return self.rgb if self.alpha is None else self.premultiplied()


PictureLike = str | Path | bytes | np.ndarray | Image.Image | Picture  # whatever a person has


def load_picture(
    source: str | Path | bytes,
    *,
    name: str | None = None,
    max_pixels: int = MAX_PIXELS,
    max_size: int | None = None,
    frame: int | None = None,
    smaller: str = "scale the picture down first",
) -> Picture:
    """Read a picture from a path, or from the bytes of a file (standard input, a network answer).

    `name` replaces the path in messages and in `Picture.source`; for bytes it defaults to "<bytes>". `max_size`: a very
    large picture (`READ_WHOLE_PIXELS`) may be read smaller, its longer side still of so many pixels at least; it then
    needs `max_pixels` pixels at most. `frame`: which one of a file with several, from 1; by default the first, and a
    note. `smaller`: what a refusal advises.
    Raises `InputError` for anything that cannot be read as a picture of at most `max_pixels` pixels in one of the
    formats of `formats_of`, and `UsageError` for a senseless `max_pixels`.
    """
    if max_pixels < 1:
        raise UsageError(f"max_pixels is {max_pixels}, it must be at least 1")
    if isinstance(source, bytes):
        shown = printable(name or "<bytes>")
        data = source
    else:
        shown = printable(name or str(source))
        data = read_whole(Path(source), shown)
    check_size(len(data), shown)
    if not data:
        raise InputError(f"{shown}: is empty (0 bytes); give a picture")
    decoded, size = _open_and_decode(data, shown, max_pixels, max_size, smaller, frame)
    height, width = decoded.rgb.shape[:2]
    # A picture that was turned upright has its sides exchanged.
    if (width - height) * (size[0] - size[1]) < 0:
        size = size[::-1]
    full, notes = None, decoded.notes
    if size != (width, height):
        full, notes = size, (*notes, f"read at {width} x {height} of its {size[0]} x {size[1]} pixels")
    compression = decoded.compression if full is None else None
    return Picture(decoded.rgb, decoded.alpha, shown, hashlib.sha256(data).hexdigest(), notes, full, compression)


@contextmanager
def _libtiff_listened_to(data: bytes) -> Iterator[list[str]]:
    """The lines that libtiff, unlike every other decoder, prints to stderr itself: gathered, and kept off it.

    They would come between ours. Only for TIFF, since whatever else the process says meanwhile is lost. The list is
    filled on leaving.
    """
    lines: list[str] = []
    if not data.startswith((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")):
        yield lines
        return
    with tempfile.TemporaryFile() as heard:
        try:
            saved = os.dup(2)
        except OSError:  # stderr is closed: nothing can be printed
            yield lines
            return
        try:
            os.dup2(heard.fileno(), 2)
            yield lines
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            heard.seek(0)
            text = heard.read(4096).decode(errors="replace")
            lines.extend(dict.fromkeys(printable(one_line(line)) for line in text.splitlines()))


@contextmanager
def _pillow_settings() -> Iterator[list[str]]:
    """Pillow with its process-wide pixel limit off and its warnings gathered in the list that is yielded.

    `_check_pixels` is explicit and names the numbers instead; what the decoder warns about belongs to the
    picture and not on stderr between progress lines. The list is filled on leaving.
    """
    notes: list[str] = []
    with _pillow_lock, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        saved = Image.MAX_IMAGE_PIXELS
        Image.MAX_IMAGE_PIXELS = None
        try:
            yield notes
        finally:
            Image.MAX_IMAGE_PIXELS = saved
    for warning in caught:
        if issubclass(warning.category, UserWarning):
            text = f"the decoder warns: {printable(one_line(warning.message))}"
            if text not in notes:
                notes.append(text)
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)


def _open_and_decode(
    data: bytes, shown: str, max_pixels: int, max_size: int | None, smaller: str, frame: int | None
) -> tuple[Decoded, tuple[int, int]]:
    """The picture, and its size in the file."""
    try:
        with (
            _pillow_settings() as notes,
            _libtiff_listened_to(data) as lines,
            Image.open(io.BytesIO(data), formats=formats_of(data, shown)) as image,
        ):
            if frame is not None:
                _go_to(image, frame, shown)
            size, factor = image.size, factor_for(image.size, max_size)
            _check_pixels(size, shown, max_pixels, factor, smaller)
            rest = draft(image, factor)
            if rest > 1 and image.width * image.height > MAX_DECODED_PIXELS:
                raise InputError(
                    f"{shown}: is {size[0]} x {size[1]} = {size[0] * size[1] / 1e6:.1f} megapixels, a file of its kind "
                    f"is read up to {MAX_DECODED_PIXELS / 1e6:.0f}; scale the picture down first"
                )
            decoded = decode(image, data, shown, rest, chosen=frame is not None)
        heard = [f"the decoder says: {line}" for line in lines[:1]]
        return replace(decoded, notes=(*decoded.notes, *notes, *heard)), size
    except InputError:
        raise
    except UnidentifiedImageError as error:
        raise InputError(_not_a_picture(data, shown)) from error
    except MemoryError as error:
        raise InputError(f"{shown}: not enough memory to decode it; scale it down first") from error
    except Exception as error:
        # Pillow's decoders answer broken bytes with nearly any exception (OSError, SyntaxError, struct.error,
        # ValueError, IndexError ...); whichever it is, the file is wrong, and the cause stays chained.
        reason = printable(one_line(error)) or type(error).__name__
        raise InputError(f"{shown}: is damaged or truncated ({reason}); save or download it again") from error


def _go_to(image: Image.Image, frame: int, shown: str) -> None:
    """Make a frame, from 1, the one that is read. Raises InputError where there are fewer."""
    count = getattr(image, "n_frames", 1)
    if frame > count:
        raise InputError(f"{shown}: has {counted(count, 'frame')}, and --frame is {frame}; give one that there is")
    image.seek(frame - 1)


def _check_pixels(size: tuple[int, int], shown: str, max_pixels: int, factor: int, smaller: str) -> None:
    """Raise InputError where a picture read smaller by `factor` has no pixels, or too many."""
    width, height = size
    if width < 1 or height < 1:
        raise InputError(f"{shown}: has no pixels ({width} x {height}); give a picture of at least 1 x 1")
    if width * height > max_pixels * factor**2:
        raise InputError(
            f"{shown}: is {width} x {height} = {width * height:,} pixels, the limit is {max_pixels:,}; {smaller}, or "
            "raise it with --max-pixels"
        )


def _not_a_picture(data: bytes, shown: str) -> str:
    head = data[:512].lstrip().lower()
    if head.startswith((b"<svg", b"<?xml")):
        return f"{shown}: is an SVG or XML file, already vector; give a raster picture ({FORMATS_TEXT})"
    if data.startswith(_BEGINNINGS) or (data.startswith(b"RIFF") and data[8:12] == b"WEBP"):
        return f"{shown}: begins like a picture, but is damaged or truncated; save or download it again"
    return f"{shown}: is not a picture in a supported format; give one of {FORMATS_TEXT}"


def laid_over(picture: Picture, colour: tuple[float, float, float] | None) -> Picture:
    """The picture on a ground, sRGB in [0, 1], opaque; the same object where it is opaque already or there is none."""
    if picture.alpha is None or colour is None:
        return picture
    alpha = picture.alpha[..., None]
    rgb = picture.rgb * alpha + np.array(colour, np.float32) * (1 - alpha)
    return replace(picture, rgb=rgb, alpha=None)


def resize_picture(picture: Picture, max_size: int) -> Picture:
    """The picture scaled down so that its longer side is at most `max_size` px; the same object when it fits.

    Lanczos filter, in sRGB values, on premultiplied colours so that hidden colours of transparent pixels do
    not bleed in. Adds a note with both sizes. Raises `UsageError` when `max_size` is below 1.
    """
    if max_size < 1:
        raise UsageError(f"max-size is {max_size}, it must be at least 1 pixel")
    longer = max(picture.width, picture.height)
    if longer <= max_size:
        return picture
    width, height = (max(1, round(side * max_size / longer)) for side in (picture.width, picture.height))
    channels = picture.target()
    scaled = np.stack([_resample(channels[..., k], width, height) for k in range(channels.shape[2])], axis=2)
    rgb, alpha = scaled[..., :3], None
    if picture.alpha is not None:
        alpha = scaled[..., 3]
        # Below half a step of 16 bits the division would only amplify the filter's ringing.
        alpha[alpha < 0.5 / 65535] = 0.0
        rgb = np.where(alpha[..., None] > 0, rgb / np.maximum(alpha, 1e-6)[..., None], 0.0)
        rgb = np.clip(rgb, 0.0, 1.0).astype(np.float32)
    note = f"scaled from {picture.width} x {picture.height} to {width} x {height} pixels"
    return replace(picture, rgb=np.ascontiguousarray(rgb), alpha=alpha, notes=(*picture.notes, note), compression=None)


def _resample(channel: np.ndarray, width: int, height: int) -> np.ndarray:
    """One (H, W) float32 channel to another size, clipped to [0, 1] (Lanczos overshoots)."""
    image = Image.fromarray(np.ascontiguousarray(channel, dtype=np.float32))
    return np.clip(np.asarray(image.resize((width, height), Image.Resampling.LANCZOS)), 0.0, 1.0)


def as_picture(source: PictureLike, *, max_pixels: int = MAX_PIXELS, max_size: int | None = None) -> Picture:
    """A picture from whatever a person has.

    source: a path; the bytes of a file; an array (H, W), (H, W, 3) or (H, W, 4), uint8 or float in [0, 1], sRGB with
    straight alpha; or a Pillow image.

    max_pixels, max_size: of files, as for `load_picture`. Raises InputError for anything that is no picture.
    """
    if isinstance(source, Picture):
        return source
    if isinstance(source, np.ndarray):
        return _of_array(source)
    if isinstance(source, Image.Image):
        return _of_image(source)
    if isinstance(source, (str, Path, bytes)):
        source = Path(source) if isinstance(source, str) else source
        return load_picture(source, max_pixels=max_pixels, max_size=max_size)
    raise InputError(f"a picture must be a path, bytes, a numpy array or a Pillow image, not {type(source).__name__}")


def _of_array(values: np.ndarray) -> Picture:
    if values.ndim == 2:
        values = values[..., None].repeat(3, axis=2)
    if values.ndim != 3 or values.shape[2] not in (3, 4) or 0 in values.shape:
        raise InputError(f"a picture's array must be (H, W), (H, W, 3) or (H, W, 4), not {values.shape}")
    if values.dtype == np.uint8:
        floats = values.astype(np.float32) / np.float32(255)
    elif np.issubdtype(values.dtype, np.floating):
        floats = values.astype(np.float32)
        if not bool(((floats >= 0.0) & (floats <= 1.0)).all()):
            raise InputError("a picture's floating-point values must lie between 0 and 1; scale them")
    else:
        raise InputError(f"a picture's array must hold uint8 or floating-point values, not {values.dtype}")
    rgb, alpha = np.ascontiguousarray(floats[..., :3]), None
    if values.shape[2] == 4 and bool((floats[..., 3] < 1.0).any()):
        alpha = np.ascontiguousarray(floats[..., 3])
        rgb[alpha == 0.0] = 0.0
    return Picture(rgb, alpha, "<array>", sha256_of(np.ascontiguousarray(values).tobytes()))


def _of_image(image: Image.Image) -> Picture:
    try:
        decoded = decode(image, b"", "<image>")
    except InputError:
        raise
    except Exception as error:
        # Pillow reads the pixels only now, and answers broken ones with nearly any exception.
        raise InputError(f"the Pillow image cannot be read ({one_line(error)})") from error
    alpha = b"" if decoded.alpha is None else decoded.alpha.tobytes()
    digest = sha256_of(decoded.rgb.tobytes() + alpha)
    return Picture(decoded.rgb, decoded.alpha, "<image>", digest, decoded.notes, compression=decoded.compression)
