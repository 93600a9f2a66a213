"""Load a picture from a file or from untrusted bytes, or take it from an array or a Pillow image.

Every failure is an `InputError` of one line that names the file, the problem and a remedy. The order of the checks
matters: the kind of file before opening it (a FIFO would block), the bytes before reading them, the pixels before
decoding them (a decompression bomb is a small file).
"""

from __future__ import annotations

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
from cubicsplat_cli.files.decode import FORMATS_TEXT, Compression, decode, draft, factor_for, formats_of, unit_values
from cubicsplat_cli.files.marks import sha256_of
from cubicsplat_cli.files.read import check_size, read_whole
from cubicsplat_cli.formatting import counted, one_line, printable
from cubicsplat_cli.record import record
from cubicsplat_cli.settings import MAX_PIXELS

_ENLARGED_IN = 4  # rounds; more change a fit by less than 0.3 dB

_pillow_lock = threading.Lock()


@record
class Picture:
    """A decoded picture in sRGB, independent of its file.

    rgb: (H, W, 3) float32 in [0, 1], straight (not premultiplied), 0 where `alpha` is 0. alpha: (H, W) float32 in
    [0, 1], or None if every pixel is opaque. source: the name for messages. sha256: of the file's bytes. notes: for the
    user, about how the file was read, one sentence each. full_size: width and height of the picture in the file if it
    was read smaller, else None. compression: of a file compressed with loss, else None.
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

    def pixels(self) -> np.ndarray:
        """Return (H, W, 3) uint8, or straight (H, W, 4) if the picture has transparency."""
        channels = self.rgb if self.alpha is None else np.dstack([self.rgb, self.alpha])
        return np.rint(channels * 255.0).astype(np.uint8)

    def premultiplied(self) -> np.ndarray:
        """Return (H, W, 4) float32 in [0, 1]: colours times alpha, and alpha (1 if the picture has none)."""
        alpha = np.ones(self.rgb.shape[:2], np.float32) if self.alpha is None else self.alpha
        return np.concatenate([self.rgb * alpha[..., None], alpha[..., None]], axis=2)

    def target(self) -> np.ndarray:
        """Return the target of a fit: (H, W, 3) if the picture is opaque, else premultiplied (H, W, 4); float32."""
        return self.rgb if self.alpha is None else self.premultiplied()


PictureLike = str | Path | bytes | np.ndarray | Image.Image | Picture


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

    name: replaces the path in messages and in `Picture.source`; for bytes it is "<bytes>" by default. max_pixels: the
    most that are accepted, as read. max_size: a very large picture (`READ_WHOLE_PIXELS`) may be read smaller, its
    longer side still at least so many px. frame: of a file with several, from 1; by default the first, with a note.
    smaller: the advice for pictures that are too large.

    Raises InputError for anything that is no picture in one of the formats of `formats_of`, or too large; UsageError
    for a max_pixels below 1.
    """
    if max_pixels < 1:
        raise UsageError(f"max_pixels is {max_pixels}, it must be at least 1")
    shown = printable(name or ("<bytes>" if isinstance(source, bytes) else str(source)))
    data = source if isinstance(source, bytes) else read_whole(Path(source), shown)
    check_size(len(data), shown)
    if not data:
        raise InputError(f"{shown}: is empty (0 bytes); give a picture")
    picture, size = _open_and_decode(data, shown, max_pixels, max_size, smaller, frame)
    width, height = picture.width, picture.height
    if (width - height) * (size[0] - size[1]) < 0:  # it was turned upright
        size = size[::-1]
    if size == (width, height):
        return picture
    note = f"read at {width} x {height} of its {size[0]} x {size[1]} pixels"
    return replace(picture, notes=(*picture.notes, note), full_size=size, compression=None)


@contextmanager
def _libtiff_listened_to(data: bytes) -> Iterator[list[str]]:
    """Within, keep off stderr the lines that libtiff, unlike all other decoders, prints; the list gets them at the end.

    They would come between ours. For TIFF only, because all other output to stderr is lost meanwhile.
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
    """Within, Pillow has no limit of pixels, since `_check_pixels` has one; the list gets its warnings at the end.

    The warnings are notes about the picture, and would come between the lines of progress on stderr.
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
) -> tuple[Picture, tuple[int, int]]:
    """Return the picture, and its size in the file."""
    try:
        with (
            _pillow_settings() as notes,
            _libtiff_listened_to(data) as lines,
            Image.open(io.BytesIO(data), formats=formats_of(data, shown)) as image,
        ):
            if frame is not None:
                if frame > (count := getattr(image, "n_frames", 1)):
                    found = counted(count, "frame")
                    raise InputError(f"{shown}: has {found}, and --frame is {frame}; give one that there is")
                image.seek(frame - 1)
            size, factor = image.size, factor_for(image.size, max_size)
            _check_pixels(size, shown, max_pixels, factor, smaller)
            rest = draft(image, factor, shown)
            rgb, alpha, own, compression = decode(image, data, shown, rest, chosen=frame is not None)
        heard = [f"the decoder says: {line}" for line in lines[:1]]
        return Picture(rgb, alpha, shown, sha256_of(data), (*own, *notes, *heard), compression=compression), size
    except InputError:
        raise
    except UnidentifiedImageError as error:
        raise InputError(_not_a_picture(data, shown)) from error
    except MemoryError as error:
        raise InputError(f"{shown}: not enough memory to decode it; scale it down first") from error
    except Exception as error:
        # Pillow raises nearly any exception for broken bytes: OSError, SyntaxError, struct.error, IndexError...
        reason = printable(one_line(error)) or type(error).__name__
        raise InputError(f"{shown}: is damaged or truncated ({reason}); save or download it again") from error


def _check_pixels(size: tuple[int, int], shown: str, max_pixels: int, factor: int, smaller: str) -> None:
    """Raise InputError if a picture, read smaller by `factor`, has no pixels or too many."""
    width, height = size
    if width < 1 or height < 1:
        raise InputError(f"{shown}: has no pixels ({width} x {height}); give a picture of at least 1 x 1")
    if width * height > max_pixels * factor**2:
        text = f"{shown}: is {width} x {height} = {width * height:,} pixels, the limit is {max_pixels:,}"
        raise InputError(f"{text}; {smaller}, or raise it with --max-pixels")


def _not_a_picture(data: bytes, shown: str) -> str:
    """Return the error for a file that Pillow does not identify."""
    starts = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"GIF87a", b"GIF89a", b"II*\0", b"MM\0*")
    if data[:512].lstrip().lower().startswith((b"<svg", b"<?xml")):
        return f"{shown}: is an SVG or XML file, already vector; give a raster picture ({FORMATS_TEXT})"
    if data.startswith(starts) or (data.startswith(b"RIFF") and data[8:12] == b"WEBP"):
        return f"{shown}: begins like a picture, but is damaged or truncated; save or download it again"
    return f"{shown}: is not a picture in a supported format; give one of {FORMATS_TEXT}"


def laid_over(picture: Picture, colour: tuple[float, float, float] | None) -> Picture:
    """Return the picture opaque, on a ground, sRGB in [0, 1]; the same object if it is opaque or without a ground."""
    if picture.alpha is None or colour is None:
        return picture
    alpha = picture.alpha[..., None]
    rgb = picture.rgb * alpha + np.array(colour, np.float32) * (1 - alpha)
    # What the loss did to an opaque picture is not known.
    return replace(picture, rgb=rgb, alpha=None, compression=picture.compression and Compression())


def resize_picture(picture: Picture, max_size: int) -> Picture:
    """Return the picture scaled down to at most `max_size` px on its longer side; the same object if it fits.

    A Lanczos filter scales sRGB values, of premultiplied colours because hidden colours of transparent pixels must not
    bleed in. Adds a note with both sizes.
    """
    sides = picture.width, picture.height
    if max(sides) <= max_size:
        return picture
    width, height = (max(1, round(side * max_size / max(sides))) for side in sides)
    scaled = np.clip(resampled(picture.target(), (width, height), Image.Resampling.LANCZOS), 0.0, 1.0)
    note = f"scaled from {picture.width} x {picture.height} to {width} x {height} pixels"
    return replace(with_target(picture, scaled), notes=(*picture.notes, note))


def enlarge_picture(picture: Picture, factor: int) -> Picture:
    """Return the picture, `factor` times as large, smooth between the pixels, so that the means over factor x factor
    pixels are about the pixels of the picture: as if a finer sensor had seen it.

    What bicubic enlargements lack is enlarged and added in turn (Irani and Peleg, "Improving resolution by image
    registration", 1991).
    """
    channels, size = picture.target(), (factor * picture.width, factor * picture.height)
    enlarged = np.zeros((size[1], size[0], channels.shape[2]), np.float32)
    for _ in range(_ENLARGED_IN):
        means = enlarged.reshape(picture.height, factor, picture.width, factor, -1).mean(axis=(1, 3))
        enlarged = np.clip(enlarged + resampled(channels - means, size, Image.Resampling.BICUBIC), 0.0, 1.0)
    return with_target(picture, enlarged)


def resampled(channels: np.ndarray, size: tuple[int, int], kernel: Image.Resampling) -> np.ndarray:
    """Return (H, W, C) float32 channels in another size (width, height); values may overshoot."""
    images = (Image.fromarray(np.ascontiguousarray(channels[..., k])) for k in range(channels.shape[2]))
    return np.stack([np.asarray(image.resize(size, kernel)) for image in images], axis=2)


def with_target(picture: Picture, channels: np.ndarray) -> Picture:
    """Return the picture with other pixels, as `Picture.target` returns them. Changes the array."""
    rgb, alpha = channels[..., :3], None
    if channels.shape[2] == 4:
        alpha = channels[..., 3]
        # Below half a step of 16 bits the division would only amplify the filter's ringing.
        alpha[alpha < 0.5 / 65535] = 0.0
        rgb = np.where(alpha[..., None] > 0, rgb / np.maximum(alpha, 1e-6)[..., None], 0.0)
        rgb = np.clip(rgb, 0.0, 1.0).astype(np.float32)
    return replace(picture, rgb=np.ascontiguousarray(rgb), alpha=alpha, compression=None)


def with_levels(picture: Picture, levels: np.ndarray) -> Picture:
    """Return the picture with other pixels, (H, W, 4) premultiplied in levels of 0..255."""
    return with_target(picture, levels[..., : 3 if picture.alpha is None else 4] / np.float32(255.0))


def as_picture(source: PictureLike, *, max_pixels: int = MAX_PIXELS, max_size: int | None = None) -> Picture:
    """Return a picture from anything that holds one.

    source: a path; the bytes of a file; an array (H, W), (H, W, 3) or (H, W, 4), uint8 or float in [0, 1], sRGB with
    straight alpha; or a Pillow image. max_pixels, max_size: of files, as for `load_picture`. Raises InputError for
    anything that is no picture.
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
    if values.ndim != 3 or values.shape[2] not in (3, 4):
        raise InputError(f"a picture's array must be (H, W), (H, W, 3) or (H, W, 4), not {values.shape}")
    if values.size == 0:
        raise InputError(f"a picture's array {values.shape} holds no pixel")
    if values.dtype == np.uint8:
        floats = values.astype(np.float32) / np.float32(255)
    elif np.issubdtype(values.dtype, np.floating):
        floats = unit_values(values, "a picture's array")
    else:
        raise InputError(f"a picture's array must hold uint8 or floating-point values, not {values.dtype}")
    rgb, alpha = np.ascontiguousarray(floats[..., :3]), None
    if values.shape[2] == 4 and bool((floats[..., 3] < 1.0).any()):
        alpha = np.ascontiguousarray(floats[..., 3])
        rgb[alpha == 0.0] = 0.0
    return Picture(rgb, alpha, "<array>", sha256_of(np.ascontiguousarray(values).tobytes()))


def _of_image(image: Image.Image) -> Picture:
    try:
        rgb, alpha, notes, compression = decode(image, b"", "<image>")
    except InputError:
        raise
    except Exception as error:
        # Pillow reads the pixels only now, and raises nearly any exception for broken ones.
        raise InputError(f"the Pillow image cannot be read ({one_line(error)})") from error
    digest = sha256_of(rgb.tobytes() + (b"" if alpha is None else alpha.tobytes()))
    return Picture(rgb, alpha, "<image>", digest, notes, compression=compression)
