"""The formats of pictures that are read, and an opened Pillow image of any mode as straight sRGB floats: frame,
orientation, profile, alpha; and how the file was compressed with loss, and the same done to another picture.

Very large pictures are read smaller, by a whole factor, for those who want a small copy anyway. A JPEG is decoded at
1/2, 1/4 or 1/8 of its size to begin with. What else Pillow reads it decodes whole, into at most 4 bytes a pixel; from
there on a band of rows at a time is all that exists at full size.
"""

from __future__ import annotations

import importlib
import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageCms
from PIL.JpegImagePlugin import JpegImageFile, get_sampling

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.names import reads_heic
from cubicsplat_cli.files.paths import is_file, read_head
from cubicsplat_cli.record import record

_MOST_TABLE = 255  # a step of the quantisation, which baseline files hold
FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TIFF", "GIF", "PPM")
FORMATS_TEXT = ", ".join((*FORMATS, "AVIF"))
_AVIF = {b"avif", b"avis"}
_HEIC = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"}
# Pictures of no more pixels are read as they are: so many are measured as they are too.
READ_WHOLE_PIXELS = 2**25
# What is read smaller has this many at most, and a quarter of them at least.
MOST_PIXELS = 2**24
# That Pillow may have to hold: 2 GiB.
MAX_DECODED_PIXELS = 2**29
BAND_PIXELS = 2**22
_JPEG_FACTORS = (8, 4, 2)
_EXIF_ORIENTATION = 0x0112
_PHOTOMETRIC, _WHITE_IS_ZERO = 262, 0  # TIFF's tag for what numbers mean, and a value of it
_UPRIGHT = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}
_WITH_ALPHA = ("LA", "La", "PA", "RGBA", "RGBa")
# Colour space of a profile -> mode its transform reads, and the modes of pictures it can be meant for.
_PROFILE_MODES = {"RGB": "RGB", "GRAY": "L", "CMYK": "CMYK"}
_PROFILE_FITS = {"RGB": ("RGB", "RGBX", "L", "YCbCr"), "GRAY": ("L",), "CMYK": ("CMYK",)}


@dataclass(frozen=True)
class Compression:
    """tables: (64,) steps of the quantisation of a JPEG's luma and chroma; none where the file's are unknown or not of
    the pixels as they are read. sampling: of chroma, by Pillow's number: 0 for 4:4:4, 1 for 4:2:2, 2 for 4:2:0.
    """

    tables: tuple[tuple[int, ...], ...] = ()
    sampling: int = 0

    @property
    def halved(self) -> tuple[int, ...]:
        """The axes along which chroma is stored at half its size: 0 for rows, 1 for columns."""
        return ((), (1,), (0, 1))[self.sampling]

    @property
    def rounding(self) -> float:
        """Levels: the standard deviation of luma that is rounded to its tables' steps."""
        return float(np.sqrt(np.mean(np.square(self.tables[0], dtype=float)) / 12.0))

    def again(self, levels: np.ndarray) -> np.ndarray:
        """(H, W, 3) uint8 of a picture (H, W, 3) in levels that is compressed like this and read."""
        buffer = io.BytesIO()
        image = Image.fromarray(np.clip(np.rint(levels), 0, 255).astype(np.uint8))
        image.save(buffer, "JPEG", qtables=[list(table) for table in self.tables], subsampling=self.sampling)
        with Image.open(buffer) as read:
            return np.array(read)


def compression_of(image: Image.Image, data: bytes) -> Compression | None:
    """The compression of a JPEG, or of a file that is a WebP of nothing but a lossy picture; None of others."""
    if image.format == "WEBP" and data[12:16] == b"VP8 ":
        return Compression()
    if not isinstance(image, JpegImageFile):
        return None
    sampling = get_sampling(image)
    if image.mode != "RGB" or image.info.get("adobe_transform", 1) != 1 or sampling < 0:
        return Compression()
    tables = tuple(tuple(image.quantization[component[3]]) for component in image.layer[:2])
    return Compression(tables, sampling) if max(map(max, tables)) <= _MOST_TABLE else Compression()


@record
class Decoded:
    """`rgb` (H, W, 3) and `alpha` (H, W) or None, float32 in [0, 1], straight; the rest as in `Picture`."""

    rgb: np.ndarray
    alpha: np.ndarray | None
    notes: tuple[str, ...]
    compression: Compression | None = None


def decode(image: Image.Image, data: bytes, shown: str, factor: int = 1, *, chosen: bool = False) -> Decoded:
    """Decode the frame at which `image` is, whose file bytes are `data`; `shown` is its name for messages.

    factor: by how much its sides are to become shorter. chosen: whether somebody has said which frame.

    Raises `InputError` for colour modes and value ranges with no defined meaning; whatever Pillow raises for
    broken bytes passes through.
    """
    notes: list[str] = []
    if not chosen and getattr(image, "is_animated", False):
        notes.append("several frames: only the first one is used; --frame chooses another")
    # Pillow reads colour with 8 bits a channel; byte 24 of a PNG is IHDR's depth.
    if image.format == "PNG" and data[24:25] == b"\x10" and not image.mode.startswith("I"):
        notes.append("16 bits per channel: read with 8")
    compression = compression_of(image, data) if factor == 1 else None
    image.load()
    upright = _turn_upright(image if factor == 1 else shrunk(image, factor), notes)
    if upright.mode.startswith("I") or upright.mode == "F":
        grey, alpha = _deep_grey(upright, shown), _key_alpha(upright)
        # Pillow turns over what has 1 to 8 bits itself.
        if image.mode.startswith("I;16") and _white_is_zero(image):
            grey = np.float32(1.0) - grey
        if upright.info.get("icc_profile"):
            notes.append(f"embedded colour profile ignored for {_depth(upright)} grey")
        rgb = np.repeat(grey[..., None], 3, axis=2)
    else:
        colour, alpha = _split_alpha(upright)
        colour = _to_srgb(colour, upright.info.get("icc_profile"), notes, shown)
        same = upright is image and not upright.info.get("icc_profile")
        if compression is not None and not (same or np.array_equal(np.asarray(colour), np.asarray(image))):
            compression = Compression()  # it says nothing of pixels that were turned, or of other colours
        rgb = _as_float(colour)
    if alpha is not None and bool((alpha >= 1.0).all()):
        alpha = None
    if alpha is not None:
        rgb[alpha == 0.0] = 0.0
        if not alpha.any():
            notes.append("every pixel is transparent")
    return Decoded(rgb=rgb, alpha=alpha, notes=tuple(notes), compression=compression)


def _turn_upright(image: Image.Image, notes: list[str]) -> Image.Image:
    """Apply the EXIF orientation (where Pillow did so on loading, as for TIFF, it has removed the tag)."""
    try:
        orientation = image.getexif().get(_EXIF_ORIENTATION, 1)
    except Exception as error:  # as hostile as the pixels, but without it the picture is merely unturned
        notes.append(f"EXIF data unreadable ({type(error).__name__}): orientation not applied")
        return image
    method = _UPRIGHT.get(orientation) if isinstance(orientation, int) else None
    if method is None:
        return image
    turned = image.transpose(method)
    turned.info = image.info
    return turned


def _split_alpha(image: Image.Image) -> tuple[Image.Image, np.ndarray | None]:
    """The image without transparency, in a mode that keeps its colour space, and alpha (H, W) or None."""
    if image.mode in _WITH_ALPHA or "transparency" in image.info:
        grey = image.mode in ("1", "L", "LA", "La")
        with_alpha = (image.convert("LA") if image.mode == "La" else image).convert("RGBA")
        alpha = _as_float(with_alpha.getchannel("A"))
        colour = with_alpha.convert("RGB")
        return (colour.getchannel("R") if grey else colour), alpha
    if image.mode == "1":
        return image.convert("L"), None
    return (image.convert("RGB") if image.mode == "P" else image), None


def _to_srgb(image: Image.Image, profile: bytes | None, notes: list[str], shown: str) -> Image.Image:
    """An opaque 8-bit image in mode RGB, through the embedded colour profile when there is a usable one."""
    if profile:
        converted = _through_profile(image, profile, notes)
        if converted is not None:
            return converted
    elif image.mode == "CMYK":
        notes.append("CMYK without a colour profile: converted by the plain formula")
    try:
        return image.convert("RGB")
    except ValueError as error:
        raise InputError(f"{shown}: colour mode {image.mode} is not supported; save it as RGB") from error


def _through_profile(image: Image.Image, profile: bytes, notes: list[str]) -> Image.Image | None:
    """`image` in sRGB; None when the profile needs no conversion, or allows none, which is noted."""
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        if (source.profile.profile_description or "").startswith("sRGB"):
            return None
        space = source.profile.xcolor_space.strip()
        if image.mode not in _PROFILE_FITS.get(space, ()):
            notes.append(f"embedded {space} colour profile does not fit {image.mode} pixels: ignored")
            return None
        return ImageCms.profileToProfile(
            image.convert(_PROFILE_MODES[space]),
            source,
            ImageCms.createProfile("sRGB"),
            renderingIntent=ImageCms.Intent.RELATIVE_COLORIMETRIC,
            outputMode="RGB",
        )
    except (ImageCms.PyCMSError, ImportError, OSError, TypeError, ValueError) as error:
        notes.append(f"embedded colour profile unusable ({type(error).__name__}): colours taken as sRGB")
        return None


def _deep_grey(image: Image.Image, shown: str) -> np.ndarray:
    """(H, W) float32 in [0, 1] of a grey image with 16-bit, 32-bit integer or floating-point pixels."""
    values = np.asarray(image)
    if image.mode == "F":
        low, high = float(values.min()), float(values.max())
        if not (np.isfinite(low) and np.isfinite(high)):
            raise InputError(f"{shown}: has infinite or undefined pixel values; replace them")
        if low < -1e-6 or high > 1 + 1e-6:
            raise InputError(f"{shown}: pixel values run from {low:g} to {high:g}; scale them to 0 to 1")
        return np.clip(values, 0.0, 1.0).astype(np.float32)
    if int(values.min()) < 0 or int(values.max()) > 65535:
        raise InputError(
            f"{shown}: integer values run from {values.min()} to {values.max()}; save it with 8 or 16 bits"
        )
    return values.astype(np.float32) / np.float32(65535)


def _white_is_zero(image: Image.Image) -> bool:
    tags = getattr(image, "tag_v2", {})  # of a TIFF
    return bool(tags.get(_PHOTOMETRIC) == _WHITE_IS_ZERO)


def _key_alpha(image: Image.Image) -> np.ndarray | None:
    """Alpha (H, W) of a deep grey image where one value is declared transparent (PNG tRNS), or None."""
    key = image.info.get("transparency")
    return None if not isinstance(key, int) else (np.asarray(image) != key).astype(np.float32)


def _depth(image: Image.Image) -> str:
    return "floating-point" if image.mode == "F" else "16-bit"


def _as_float(image: Image.Image) -> np.ndarray:
    values = np.asarray(image, dtype=np.float32)
    # In place: of a large picture this is most of the memory.
    values /= np.float32(255)
    return values


def factor_for(size: tuple[int, int], max_size: int | None) -> int:
    """By how much a picture of `size` px can be read smaller, its longer side still of `max_size` px; 1: not at all."""
    pixels = size[0] * size[1]
    if max_size is None or pixels <= READ_WHOLE_PIXELS:
        return 1
    # A power of two, as the decoder of JPEGs has them.
    factor = 2 ** math.ceil(math.log2(pixels / MOST_PIXELS) / 2)
    return max(1, min(factor, max(size) // max_size))


def draft(image: Image.Image, factor: int) -> int:
    """Have a JPEG decoded smaller, which no other format can; what is left of the factor then."""
    for scale in _JPEG_FACTORS:
        if isinstance(image, JpegImageFile) and factor >= scale:
            image.draft(None, (max(1, image.width // scale), max(1, image.height // scale)))
            return max(1, factor // scale)
    return factor


def shrunk(image: Image.Image, factor: int) -> Image.Image:
    """A copy by the means of blocks of factor x factor px, in a mode that can be averaged; `info` is kept.

    Alpha is premultiplied there, so that what is hidden does not bleed in.
    """
    small: Image.Image | None = None
    rows = max(1, BAND_PIXELS // image.width // factor) * factor
    for top in range(0, image.height, rows):
        band = _averageable(image.crop((0, top, image.width, min(image.height, top + rows)))).reduce(factor)
        if small is None:
            small = Image.new(band.mode, (band.width, math.ceil(image.height / factor)))
        small.paste(band, (0, top // factor))
    assert small is not None  # a picture has rows
    small.info = image.info
    return small


def _averageable(band: Image.Image) -> Image.Image:
    if band.mode.startswith("I"):
        return band.convert("I")
    if band.mode in ("LA", "La") or (band.mode == "L" and "transparency" in band.info):
        return band.convert("LA").convert("La")
    if band.mode in ("PA", "RGBA", "RGBa") or "transparency" in band.info:
        return band.convert("RGBA").convert("RGBa")
    return band.convert({"1": "L", "P": "RGB"}.get(band.mode, band.mode))


def holds_picture(path: Path) -> bool:
    """Whether an existing regular file begins as a raster picture does, whatever its name."""
    try:
        if not is_file(path) or _brands(read_head(path)) & (_AVIF | _HEIC):
            return is_file(path)
        Image.open(path, formats=FORMATS).close()
    except OSError:
        return False
    except Image.DecompressionBombError:
        pass
    return True


def formats_of(data: bytes, shown: str) -> tuple[str, ...]:
    """The formats, by Pillow's names, that a file of these bytes may be opened as.

    AVIF is read where Pillow was built with it, HEIC where there is pillow-heif. Raises InputError, naming the file,
    for one of these that cannot be read here, with what to install.
    """
    brands = _brands(data)
    if brands & _AVIF:
        Image.init()
        if "AVIF" not in Image.OPEN:
            raise InputError(f"{shown}: is an AVIF picture; pip install -U 'Pillow>=11.3' to have it read")
        return ("AVIF",)
    if brands & _HEIC:
        if not reads_heic():
            raise InputError(
                f"{shown}: is an HEIC picture; pip install pillow-heif to have it read, or save it as JPEG"
            )
        importlib.import_module("pillow_heif").register_heif_opener()
        return ("HEIF",)
    return FORMATS


def _brands(data: bytes) -> set[bytes]:
    """The brands that a file of the MPEG-4 family declares; none for another kind of file."""
    if data[4:8] != b"ftyp":
        return set()
    names = data[8 : min(int.from_bytes(data[:4], "big"), 256)]
    return {names[i : i + 4] for i in range(0, len(names), 4) if i != 4}  # between them stands a version
