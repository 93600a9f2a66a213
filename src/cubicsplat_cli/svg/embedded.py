"""Pictures embedded in an SVG: PNG and JPEG files as data URIs, and nothing else."""

from __future__ import annotations

import base64
import binascii
import io
import re
import warnings

from PIL import Image

MOST_PIXELS = 2**26  # of one picture
# Of its two forms a renderer may take the second for an SVG where it holds this.
_PNG, _JPEG, _NO_JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"<svg"
_URI = re.compile(r"data:image/(png|jpeg);base64,([A-Za-z0-9+/]+={0,2})")


def uri_of(data: bytes) -> str:
    """The data URI of a PNG or JPEG file."""
    kind = "png" if data.startswith(_PNG) else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def picture_in(uri: str) -> bytes:
    """The file that a data URI holds. Raises ValueError for anything but a PNG or JPEG of at most MOST_PIXELS."""
    match = _URI.fullmatch(uri)
    if match is None:
        raise ValueError("has an image other than a PNG or JPEG as a base64 data URI")
    try:
        data = base64.b64decode(match[2], validate=True)
        pixels = pixels_of(data)
    except (binascii.Error, OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError("has an image that cannot be read") from error
    is_jpeg = data.startswith(_JPEG) and _NO_JPEG not in data
    if not is_jpeg and not data.startswith(_PNG):
        raise ValueError("has an image that is no plain PNG or JPEG")
    if pixels > MOST_PIXELS:
        raise ValueError(f"has an image of {pixels} px; at most {MOST_PIXELS} are drawn")
    return data


def pixels_of(data: bytes) -> int:
    """The pixels that a PNG or JPEG file says it has. Raises what Pillow raises where it is none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        with Image.open(io.BytesIO(data), formats=("PNG", "JPEG")) as image:
            return image.width * image.height
