"""A drawn picture as the bytes of a PNG file that carries our mark."""

from __future__ import annotations

import io
import zlib

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from cubicsplat_cli._version import __version__
from cubicsplat_cli.files.marks import PROGRAM


def encode_png(pixels: np.ndarray) -> bytes:
    """PNG bytes of (H, W, 4) uint8 straight RGBA; stored as RGB when every pixel is opaque."""
    height, width = pixels.shape[:2]
    # Without a copy where the pixels lie in a row, as they do when we have drawn them.
    image = Image.frombuffer("RGBA", (width, height), np.ascontiguousarray(pixels), "raw", "RGBA", 0, 1)
    if int(pixels[..., 3].min()) == 255:
        image = image.convert("RGB")
    info = PngInfo()
    info.add_text("Software", f"{PROGRAM} {__version__}")
    buffer = io.BytesIO()
    # Drawings are runs of one colour: looking for nothing else takes two thirds of the time and finds more.
    image.save(buffer, "PNG", pnginfo=info, compress_type=zlib.Z_RLE)
    return buffer.getvalue()
