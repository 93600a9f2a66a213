"""A drawn picture as the bytes of a PNG file that carries our mark."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from cubicsplat_cli._version import __version__
from cubicsplat_cli.files.marks import PROGRAM


def encode_png(pixels: np.ndarray) -> bytes:
    """PNG bytes of (H, W, 4) uint8 straight RGBA; stored as RGB when every pixel is opaque."""
    if (pixels[..., 3] == 255).all():
        pixels = pixels[..., :3]
    info = PngInfo()
    info.add_text("Software", f"{PROGRAM} {__version__}")
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(buffer, "PNG", pnginfo=info)
    return buffer.getvalue()
