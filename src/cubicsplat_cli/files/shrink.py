"""Very large pictures read smaller, by a whole factor, for those who want a small copy anyway.

A JPEG is decoded at 1/2, 1/4 or 1/8 of its size to begin with. What else Pillow reads it decodes whole, into at most 4
bytes a pixel; from there on a band of rows at a time is all that exists at full size.
"""

from __future__ import annotations

import math

from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile

# Pictures of no more pixels are read as they are: so many are measured as they are too.
READ_WHOLE_PIXELS = 2**25
# What is read smaller has this many at most, and a quarter of them at least.
_MOST_PIXELS = 2**24
# That Pillow may have to hold: 2 GiB.
MAX_DECODED_PIXELS = 2**29
_BAND_PIXELS = 2**22
_JPEG_FACTORS = (8, 4, 2)


def factor_for(size: tuple[int, int], max_size: int | None) -> int:
    """By how much a picture of `size` px can be read smaller, its longer side still of `max_size` px; 1: not at all."""
    pixels = size[0] * size[1]
    if max_size is None or pixels <= READ_WHOLE_PIXELS:
        return 1
    # A power of two, as the decoder of JPEGs has them.
    wanted = 2 ** math.ceil(math.log2(pixels / _MOST_PIXELS) / 2)
    return max(1, min(wanted, max(size) // max_size))


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
    rows = max(1, _BAND_PIXELS // image.width // factor) * factor
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
