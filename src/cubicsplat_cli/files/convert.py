"""Pictures that are no files: arrays and Pillow images, as the library's callers have them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Union

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.decode import Decoded, decode
from cubicsplat_cli.files.load import Picture, load_picture
from cubicsplat_cli.files.marks import sha256_of
from cubicsplat_cli.formatting import one_line
from cubicsplat_cli.settings import MAX_PIXELS

if TYPE_CHECKING:
    from PIL import Image

PictureLike = Union[str, Path, bytes, np.ndarray, "Image.Image", Picture]


def as_picture(source: PictureLike, *, max_pixels: int = MAX_PIXELS, max_size: int | None = None) -> Picture:
    """A picture from whatever a person has.

    source: a path; the bytes of a file; an array (H, W), (H, W, 3) or (H, W, 4), uint8 or float in [0, 1], sRGB with
    straight alpha; or a Pillow image.

    max_pixels, max_size: of files, as for `load_picture`. Raises InputError for anything that is no picture.
    """
    from PIL import Image

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
        decoded: Decoded = decode(image, b"", "<image>")
    except InputError:
        raise
    except Exception as error:
        # Pillow reads the pixels only now, and answers broken ones with nearly any exception.
        raise InputError(f"the Pillow image cannot be read ({one_line(error)})") from error
    alpha = b"" if decoded.alpha is None else decoded.alpha.tobytes()
    digest = sha256_of(decoded.rgb.tobytes() + alpha)
    return Picture(decoded.rgb, decoded.alpha, "<image>", digest, decoded.notes, compression=decoded.compression)
