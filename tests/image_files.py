"""Picture files made in memory, and pictures of drawings."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import numpy as np
import resvg_py
from PIL import Image, ImageCms

NOISE = np.random.default_rng(7).integers(0, 256, (13, 17, 3), dtype=np.uint8)


def encode(image: Image.Image, file_format: str = "PNG", **options) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, file_format, **options)
    return buffer.getvalue()


def by_resvg(svg: str | Path, width: int | None = None, ground: str | None = None) -> Image.Image:
    """What resvg makes of the text of an SVG, or of a file, in RGBA; over a colour where one is given."""
    given = {"svg_path": str(svg)} if isinstance(svg, Path) else {"svg_string": svg}
    with Image.open(io.BytesIO(bytes(resvg_py.svg_to_bytes(**given, width=width)))) as image:
        picture = image.convert("RGBA")
    return picture if ground is None else Image.alpha_composite(Image.new("RGBA", picture.size, ground), picture)


def recoded(picture: Image.Image | np.ndarray, file_format: str = "JPEG", **options) -> np.ndarray:
    """(H, W, C) uint8: a picture, whose levels are rounded, as it comes back from a file."""
    if not isinstance(picture, Image.Image):
        picture = Image.fromarray(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    with Image.open(io.BytesIO(encode(picture, file_format, **options))) as image:
        return np.array(image)


def swapped_profile(other: bytes = b"bXYZ") -> bytes:
    """An RGB profile whose red and blue (or other) primaries are exchanged, so that applying it cannot go unnoticed."""
    data = bytearray(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    for at in range(132, 132 + 12 * struct.unpack_from(">I", data, 128)[0], 12):
        name = bytes(data[at : at + 4])
        if name in (b"rXYZ", other):
            data[at : at + 4] = other if name == b"rXYZ" else b"rXYZ"
        if name == b"desc":
            offset, size = struct.unpack_from(">II", data, at + 4)
            text = bytes(data[offset : offset + size])
            data[offset : offset + size] = text.replace("sRGB".encode("utf-16-be"), "swap".encode("utf-16-be"))
    return bytes(data)


def png_chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png_of(width: int, height: int, depth: int, colour_type: int, rows: bytes, *extra: bytes) -> bytes:
    """A PNG written by hand, for what Pillow does not write (bombs, 16-bit colour, a grey key value)."""
    header = struct.pack(">IIBBBBB", width, height, depth, colour_type, 0, 0, 0)
    data = png_chunk(b"IDAT", zlib.compress(rows))
    chunks = [png_chunk(b"IHDR", header), *extra, data, png_chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)
