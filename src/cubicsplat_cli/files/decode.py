"""Decode Pillow images of any mode to straight sRGB floats: frame, orientation, profile, alpha. Also the formats that
are read, and the lossy compression of a file, which can be applied to another picture.

Very large pictures are read smaller by a whole factor if only a small copy is needed. Pillow decodes a JPEG at 1/2, 1/4
or 1/8 of its size. It decodes all other formats whole, at 4 bytes a pixel at most; after that only a band of rows at a
time has the full size.
"""

from __future__ import annotations

import importlib
import io
import math
from bisect import bisect_left
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from PIL import Image, ImageCms, ImageOps
from PIL.JpegImagePlugin import JpegImageFile, get_sampling

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.names import reads_heic
from cubicsplat_cli.files.paths import is_file, read_head
from cubicsplat_cli.files.write import encoded

FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TIFF", "GIF", "PPM")
FORMATS_TEXT = ", ".join((*FORMATS, "AVIF"))
AVIF = {b"avif", b"avis"}  # brands in the heads of files
HEIC = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"}
READ_WHOLE_PIXELS = 2**25  # larger pictures may be read smaller; those up to here are measured as they are, too
MOST_PIXELS = 2**24  # of a picture that is read smaller, which has a quarter of them at least
MAX_DECODED_PIXELS = 2**29  # in Pillow's memory: 2 GiB
BAND_PIXELS = 2**22
# The colour space of a profile: the mode that its transform reads, and the modes of pictures that it fits.
_PROFILES = {"RGB": ("RGB", ("RGB", "RGBX", "L", "YCbCr")), "GRAY": ("L", ("L",)), "CMYK": ("CMYK", ("CMYK",))}


@dataclass(frozen=True)
class Compression:
    """Lossy compression. tables: (64,) quantisation steps of a JPEG's luma and chroma; empty if they are unknown, or do
    not apply to the pixels as read. sampling: of chroma, by Pillow's number: 0 for 4:4:4, 1 for 4:2:2, 2 for 4:2:0.
    webp: the file of a WebP, empty for others and for pixels that are not as in the file.
    """

    tables: tuple[tuple[int, ...], ...] = ()
    sampling: int = 0
    webp: bytes = field(default=b"", repr=False)

    @property
    def known(self) -> bool:
        """True if it can be applied to another picture."""
        return bool(self.tables or self.webp)

    @cached_property
    def quality(self) -> int:
        """The quality, 1 to 100, at which the picture of a WebP takes as many bytes again: within about five of that of
        most files. Seven compressions find it.
        """
        with Image.open(io.BytesIO(self.webp)) as image:
            image.load()
        return 1 + bisect_left(range(1, 100), len(self.webp), key=lambda q: len(encoded(image, "WEBP", quality=q)))

    @property
    def halved(self) -> tuple[int, ...]:
        """The axes along which chroma is stored at half its size: 0 for rows, 1 for columns."""
        return ((), (1,), (0, 1))[self.sampling]

    @property
    def rounding(self) -> float:
        """The standard deviation, in levels, of the error of luma rounded to the steps of its table; of a WebP, whose
        steps are in its code only, that of a JPEG of quality 84.
        """
        if not self.tables:
            return 6.0
        return float(np.sqrt(np.mean(np.square(self.tables[0], dtype=float)) / 12.0))

    def again(self, levels: np.ndarray) -> np.ndarray:
        """Compress a picture like this, and decode it. Both have premultiplied levels, (H, W, 4) float32, or (H, W, 3)
        of an opaque picture; opacity has no loss.
        """
        channels = levels.shape[2]
        alpha = levels[..., 3:] if channels == 4 else np.full_like(levels[..., :1], 255.0)
        straight = straight_colours(levels) if channels == 4 else levels
        colours = Image.fromarray(np.clip(np.rint(straight), 0, 255).astype(np.uint8))
        if self.webp:
            if alpha.min() < 254.5:
                colours.putalpha(Image.fromarray(np.rint(alpha[..., 0]).astype(np.uint8)))
            data = encoded(colours, "WEBP", quality=self.quality)
        else:
            data = encoded(colours, "JPEG", qtables=[list(table) for table in self.tables], subsampling=self.sampling)
        with Image.open(io.BytesIO(data)) as read:
            decoded = np.asarray(read.convert("RGB"), dtype=np.float32)
        return np.concatenate([decoded * (alpha / np.float32(255.0)), alpha], axis=2, dtype=np.float32)[..., :channels]


def straight_colours(levels: np.ndarray) -> np.ndarray:
    """Return the straight colours (H, W, 3) of premultiplied levels (H, W, 4) in 0..255."""
    return np.asarray(levels[..., :3] * (255.0 / np.maximum(levels[..., 3:], 1.0)))


def compression_of(image: Image.Image, data: bytes) -> Compression | None:
    """Return the compression of a JPEG, or of a WebP of one lossy picture; None for other files."""
    if image.format == "WEBP" and _is_lossy_webp(data):
        return Compression(webp=data)
    if not isinstance(image, JpegImageFile):
        return None
    sampling = get_sampling(image)
    if image.mode != "RGB" or image.info.get("adobe_transform", 1) != 1 or sampling < 0:
        return Compression()
    tables = tuple(tuple(image.quantization[component[3]]) for component in image.layer[:2])
    return Compression(tables, sampling) if max(map(max, tables)) <= 255 else Compression()  # as in baseline files


def _is_lossy_webp(data: bytes) -> bool:
    """Return True if the picture in a WebP's file was compressed with loss; False for those of several pictures."""
    at = 12
    while data[at : at + 4] in (b"VP8X", b"ICCP", b"ALPH"):  # may come first: the features, the profile, the opacity
        size = int.from_bytes(data[at + 4 : at + 8], "little")
        at += 8 + size + size % 2
    return data[at : at + 4] == b"VP8 "


def decode(
    image: Image.Image, data: bytes, shown: str, factor: int = 1, *, chosen: bool = False
) -> tuple[np.ndarray, np.ndarray | None, tuple[str, ...], Compression | None]:
    """Return the rgb, alpha, notes and compression, as in `Picture`, of the current frame of an image.

    data: the bytes of its file. shown: its name for messages. factor: divides its sides. chosen: the user has chosen
    this frame. Raises InputError for colour modes and value ranges without a defined meaning, and anything that Pillow
    raises for broken bytes.
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
        grey, key = _deep_grey(upright, shown), upright.info.get("transparency")  # one value (PNG tRNS)
        alpha = (np.asarray(upright) != key).astype(np.float32) if isinstance(key, int) else None
        photometric = getattr(image, "tag_v2", {}).get(262)  # of a TIFF; 0: white is zero
        if image.mode.startswith("I;16") and photometric == 0:  # Pillow itself inverts 1 to 8 bits
            grey = np.float32(1.0) - grey
        if upright.info.get("icc_profile"):
            depth = "floating-point" if upright.mode == "F" else "16-bit"
            notes.append(f"embedded colour profile ignored for {depth} grey")
        rgb = np.repeat(grey[..., None], 3, axis=2)
    else:
        colour, alpha = _split_alpha(upright)
        colour = _to_srgb(colour, upright.info.get("icc_profile"), notes, shown)
        same = upright is image and not upright.info.get("icc_profile")
        if compression is not None and not (same or np.array_equal(np.asarray(colour), np.asarray(image))):
            compression = Compression()  # its tables do not apply to turned pixels, or other colours
        rgb = _as_float(colour)
    if alpha is not None and bool((alpha >= 1.0).all()):
        alpha = None
    if alpha is not None:
        rgb[alpha == 0.0] = 0.0
        if not alpha.any():
            notes.append("every pixel is transparent")
    return rgb, alpha, tuple(notes), compression


def _turn_upright(image: Image.Image, notes: list[str]) -> Image.Image:
    """Apply the EXIF orientation; Pillow removes the tag if it did so on loading, as for TIFF."""
    try:
        return ImageOps.exif_transpose(image) if image.getexif().get(0x0112, 1) != 1 else image
    except Exception as error:  # EXIF may be as hostile as the pixels; without it the picture is only not turned
        notes.append(f"EXIF data unreadable ({type(error).__name__}): orientation not applied")
        return image


def _split_alpha(image: Image.Image) -> tuple[Image.Image, np.ndarray | None]:
    """Return the image without transparency, in a mode that keeps its colour space, and alpha (H, W) or None."""
    if image.mode in ("LA", "La", "PA", "RGBA", "RGBa") or "transparency" in image.info:
        grey = image.mode in ("1", "L", "LA", "La")
        with_alpha = (image.convert("LA") if image.mode == "La" else image).convert("RGBA")
        alpha = _as_float(with_alpha.getchannel("A"))
        colour = with_alpha.convert("RGB")
        return (colour.getchannel("R") if grey else colour), alpha
    if image.mode == "1":
        return image.convert("L"), None
    return (image.convert("RGB") if image.mode == "P" else image), None


def _to_srgb(image: Image.Image, profile: bytes | None, notes: list[str], shown: str) -> Image.Image:
    """Return an opaque 8-bit image in mode RGB, through the embedded colour profile if there is a usable one."""
    if profile:
        image = _through_profile(image, profile, notes)
    elif image.mode == "CMYK":
        notes.append("CMYK without a colour profile: converted by the plain formula")
    try:
        return image.convert("RGB")
    except ValueError as error:
        raise InputError(f"{shown}: colour mode {image.mode} is not supported; save it as RGB") from error


def _through_profile(image: Image.Image, profile: bytes, notes: list[str]) -> Image.Image:
    """Return the image in sRGB; the same image if the profile is sRGB, or, with a note, if it cannot be used."""
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        if (source.profile.profile_description or "").startswith("sRGB"):
            return image
        space = source.profile.xcolor_space.strip()
        mode, modes = _PROFILES.get(space, ("", ()))
        if image.mode not in modes:
            notes.append(f"embedded {space} colour profile does not fit {image.mode} pixels: ignored")
            return image
        srgb, intent = ImageCms.createProfile("sRGB"), ImageCms.Intent.RELATIVE_COLORIMETRIC
        converted = ImageCms.profileToProfile(image.convert(mode), source, srgb, intent, outputMode="RGB")
        return image if converted is None else converted
    except (ImageCms.PyCMSError, ImportError, OSError, TypeError, ValueError) as error:
        notes.append(f"embedded colour profile unusable ({type(error).__name__}): colours taken as sRGB")
        return image


def unit_values(values: np.ndarray, shown: str) -> np.ndarray:
    """Return floating-point values as float32 in [0, 1]. Raises InputError with the name `shown` for any outside."""
    low, high = float(values.min()), float(values.max())
    if not (np.isfinite(low) and np.isfinite(high)):
        raise InputError(f"{shown}: has infinite or undefined pixel values; replace them")
    if low < -1e-6 or high > 1 + 1e-6:
        raise InputError(f"{shown}: pixel values run from {low:g} to {high:g}; scale them to 0 to 1")
    return np.clip(values, 0.0, 1.0).astype(np.float32)


def _deep_grey(image: Image.Image, shown: str) -> np.ndarray:
    """Return (H, W) float32 in [0, 1] of a grey image with 16-bit, 32-bit integer or floating-point pixels."""
    values = np.asarray(image)
    if image.mode == "F":
        return unit_values(values, shown)
    if int(values.min()) < 0 or int(values.max()) > 65535:
        text = f"integer values run from {values.min()} to {values.max()}"
        raise InputError(f"{shown}: {text}; save it with 8 or 16 bits")
    return values.astype(np.float32) / np.float32(65535)


def _as_float(image: Image.Image) -> np.ndarray:
    """Return 8-bit channels as float32 in [0, 1]."""
    values = np.asarray(image, dtype=np.float32)
    values /= np.float32(255)  # in place: for a large picture this is most of the memory
    return values


def factor_for(size: tuple[int, int], max_size: int | None) -> int:
    """Return the factor by which a picture may be read smaller, its longer side still of `max_size` px at least."""
    pixels = size[0] * size[1]
    if max_size is None or pixels <= READ_WHOLE_PIXELS:
        return 1
    factor = 2 ** math.ceil(math.log2(pixels / MOST_PIXELS) / 2)  # a power of two, as the decoder of JPEGs needs
    return max(1, min(factor, max(size) // max_size))


def draft(image: Image.Image, factor: int, shown: str) -> int:
    """Have a JPEG decoded smaller, the only format that can be; return the rest of the factor.

    Raises InputError, naming the file, for a picture that is too large to be decoded whole.
    """
    width, height = image.size
    if isinstance(image, JpegImageFile):
        image.draft(None, (max(1, width // factor), max(1, height // factor)))
        factor = max(1, factor // round(max(width, height) / max(image.size)))
    if factor > 1 and image.width * image.height > MAX_DECODED_PIXELS:
        size = f"{width} x {height} = {width * height / 1e6:.1f} megapixels"
        limit = f"a file of its kind is read up to {MAX_DECODED_PIXELS / 1e6:.0f}"
        raise InputError(f"{shown}: is {size}, {limit}; scale the picture down first")
    return factor


def shrunk(image: Image.Image, factor: int) -> Image.Image:
    """Return a copy of the means of blocks of factor x factor px, with the same `info`, in a mode that can be averaged:
    alpha is premultiplied, so that hidden colours do not bleed in.
    """
    size = math.ceil(image.width / factor), math.ceil(image.height / factor)
    small = Image.new(_averageable(image.crop((0, 0, 1, 1))).mode, size)
    rows = max(1, BAND_PIXELS // image.width // factor) * factor
    for top in range(0, image.height, rows):
        band = _averageable(image.crop((0, top, image.width, min(image.height, top + rows))))
        small.paste(band.reduce(factor), (0, top // factor))
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
    """Return whether an existing regular file, of any name, begins as a raster picture does."""
    try:
        if not is_file(path) or _brands(read_head(path)) & (AVIF | HEIC):
            return is_file(path)
        Image.open(path, formats=FORMATS).close()
    except OSError:
        return False
    except Image.DecompressionBombError:
        pass
    return True


def formats_of(data: bytes, shown: str) -> tuple[str, ...]:
    """Return the formats, by Pillow's names, as which a file of these bytes may be opened.

    AVIF needs a Pillow that was built with it, HEIC pillow-heif. Raises InputError, naming the file and the package to
    install, if that is missing.
    """
    brands = _brands(data)
    if brands & AVIF:
        Image.init()
        if "AVIF" not in Image.OPEN:
            raise InputError(f"{shown}: is an AVIF picture; pip install -U 'Pillow>=11.3' to have it read")
        return ("AVIF",)
    if brands & HEIC:
        if not reads_heic():
            advice = "pip install pillow-heif to have it read, or save it as JPEG"
            raise InputError(f"{shown}: is an HEIC picture; {advice}")
        importlib.import_module("pillow_heif").register_heif_opener()
        return ("HEIF",)
    return FORMATS


def _brands(data: bytes) -> set[bytes]:
    """Return the brands that a file of the MPEG-4 family declares; none for other files."""
    if data[4:8] != b"ftyp":
        return set()
    names = data[8 : min(int.from_bytes(data[:4], "big"), 256)]
    return {names[i : i + 4] for i in range(0, len(names), 4) if i != 4}  # between them stands a version
