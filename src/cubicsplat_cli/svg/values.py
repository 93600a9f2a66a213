"""The grammars of numbers, lengths, colours, transforms and embedded pictures in the attributes of an SVG."""

from __future__ import annotations

import base64
import binascii
import io
import math
import re
import warnings

import numpy as np

# There is one way to match any digits, so the time for a hostile number grows linearly with its length.
NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
NUMBERS = re.compile(NUMBER)
_LENGTH = re.compile(rf"\s*({NUMBER})\s*(px|in|cm|mm|Q|pt|pc|em|ex|%)?\s*")
# px per unit: CSS has 96 px per inch; em and ex are those of text of 16 px.
_UNITS = {
    "px": 1.0, "in": 96.0, "cm": 96 / 2.54, "mm": 96 / 25.4, "Q": 24 / 25.4, "pt": 96 / 72, "pc": 16.0, "em": 16.0,
    "ex": 8.0,
}  # fmt: skip
_HEX = re.compile(r"#([0-9a-fA-F]{3}|[0-9a-fA-F]{6})")
_TRANSFORM = re.compile(r"(matrix|translate|scale|rotate|skewX|skewY)\s*\(([^()]*)\)")
_COUNTS = {"matrix": (6,), "translate": (1, 2), "scale": (1, 2), "rotate": (1, 3), "skewX": (1,), "skewY": (1,)}
MOST_PIXELS = 2**26  # of one picture
# A renderer may mistake a JPEG that holds the last of these for an SVG.
_PNG, _JPEG, _NO_JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"<svg"
_URI = re.compile(r"data:image/(png|jpeg);base64,([A-Za-z0-9+/]+={0,2})")
OPAQUE, OPACITY_DECIMALS = 255, 3  # of 8 bits; of opacities, and of the offsets of stops, in files
Rgba = tuple[float, float, float, float]  # sRGB and opacity, each in [0, 1]


def parse_number(text: str) -> float:
    """Return a finite number without a unit. Raises ValueError for anything else."""
    value = float(text) if NUMBERS.fullmatch(text) else math.nan
    if not math.isfinite(value):
        raise ValueError(f"has {text!r} where a number belongs")
    return value


def parse_length(text: str, whole: float) -> float:
    """Return a length in px; percentages refer to `whole`. Raises ValueError for anything else."""
    match = _LENGTH.fullmatch(text)
    if match is None or not math.isfinite(float(match[1])):
        raise ValueError(f"{text!r} is no length")
    return float(match[1]) * (whole / 100.0 if match[2] == "%" else _UNITS[match[2] or "px"])


def absolute_length(text: str | None) -> float | None:
    """Return a length in px that depends on nothing around it, perhaps infinite; None for any other text."""
    match = _LENGTH.fullmatch(text or "")
    if match is None or match[2] in ("em", "ex", "%"):
        return None
    return float(match[1]) * _UNITS[match[2] or "px"]


def share(text: str) -> float:
    """Return a number or a percentage, clipped to [0, 1]. Raises ValueError for anything else."""
    return min(1.0, max(0.0, parse_length(text, 1.0)))


def hex_colour(text: str) -> tuple[int, int, int]:
    """Return the 8-bit sRGB channels of #rgb or #rrggbb. Raises ValueError for anything else."""
    match = _HEX.fullmatch(text)
    if match is None:
        raise ValueError(f"has the colour {text!r}, not #rgb or #rrggbb")
    red, green, blue = bytes.fromhex(match[1] if len(match[1]) == 6 else "".join(2 * digit for digit in match[1]))
    return red, green, blue


def unit_colour(levels: tuple[float, ...] | None) -> tuple[float, float, float] | None:
    """Return sRGB in [0, 1] from 8-bit levels, without their opacity; None for None."""
    return None if levels is None else (levels[0] / 255, levels[1] / 255, levels[2] / 255)


def levels_of(colour: tuple[float, float, float] | None) -> tuple[int, int, int] | None:
    """Return the 8-bit levels of sRGB in [0, 1]; None for None."""
    return None if colour is None else (round(255.0 * colour[0]), round(255.0 * colour[1]), round(255.0 * colour[2]))


def colour(text: str, current: str) -> Rgba | None:
    """Return the colour of a CSS text, None for no paint; raises ValueError for others. current: that of `color`."""
    from PIL import ImageColor

    lowered = text.strip().lower()
    if lowered == "currentcolor":
        return colour(current, "black")
    if lowered in ("none", "transparent", "context-fill", "context-stroke"):
        return None
    match = re.fullmatch(r"(rgb|hsl)a?\(([^)]*)\)", lowered)
    opacity = 1.0
    if match is not None:
        parts = match[2].replace(",", " ").replace("/", " ").split()
        opacity = share(parts[3]) if len(parts) > 3 else 1.0
        lowered = f"{match[1]}({','.join(parts[:3])})"
    channels = ImageColor.getrgb(lowered)
    if len(channels) > 3:
        opacity = channels[3] / 255.0
    return channels[0] / 255.0, channels[1] / 255.0, channels[2] / 255.0, opacity


def is_transform(text: str) -> bool:
    """Return whether a `transform` holds nothing but transforms of SVG 1.1."""
    return not _TRANSFORM.sub("", text).replace(",", "").strip()


def transform_matrix(text: str) -> np.ndarray:
    """Return the product (3, 3) of the transforms in a `transform`; other text is skipped.

    Source: SVG 1.1, section 7.6. Raises ValueError for numbers that cannot be read, and for too few or too many.
    """
    total = np.eye(3)
    for name, inside in _TRANSFORM.findall(text):
        numbers = [float(part) for part in inside.replace(",", " ").split()]
        if len(numbers) not in _COUNTS[name]:
            raise ValueError(f"{name}({inside}) lacks numbers, or has too many")
        total = total @ _matrix(name, numbers)
    return total


def translation(x: float, y: float) -> np.ndarray:
    """Return the matrix (3, 3) that moves by (x, y)."""
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def _matrix(name: str, n: list[float]) -> np.ndarray:
    if name == "matrix":
        return np.array([[n[0], n[2], n[4]], [n[1], n[3], n[5]], [0.0, 0.0, 1.0]])
    if name == "translate":
        return translation(n[0], n[1] if len(n) > 1 else 0.0)
    if name == "scale":
        return np.diag([n[0], n[-1], 1.0])
    angle = math.radians(n[0])
    if name.startswith("skew"):
        skewed = np.eye(3)
        skewed[(0, 1) if name == "skewX" else (1, 0)] = math.tan(angle)
        return skewed
    cos, sin = math.cos(angle), math.sin(angle)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return turn if len(n) < 3 else translation(n[1], n[2]) @ turn @ translation(-n[1], -n[2])


def uri_of(data: bytes, kind: str = "") -> str:
    """Return the data URI of a file. kind: its media type, by default that of a PNG or JPEG."""
    kind = kind or ("image/png" if data.startswith(_PNG) else "image/jpeg")
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"


def picture_in(uri: str) -> tuple[bytes, int]:
    """Return the file in a data URI, and the number of pixels in its header.

    Raises ValueError for anything but a PNG or JPEG of at most MOST_PIXELS.
    """
    from PIL import Image

    match = _URI.fullmatch(uri)
    if match is None:
        raise ValueError("has an image other than a PNG or JPEG as a base64 data URI")
    try:
        data = base64.b64decode(match[2], validate=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data), formats=("PNG", "JPEG")) as image:
                pixels = image.width * image.height
    except (binascii.Error, OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError("has an image that cannot be read") from error
    is_jpeg = data.startswith(_JPEG) and _NO_JPEG not in data
    if not is_jpeg and not data.startswith(_PNG):
        raise ValueError("has an image that is no plain PNG or JPEG")
    if pixels > MOST_PIXELS:
        raise ValueError(f"has an image of {pixels} px; at most {MOST_PIXELS} are drawn")
    return data, pixels
