"""How a picture's file was compressed with loss, as far as it says so, and the same done to another picture."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile, get_sampling

_MOST_TABLE = 255  # a step of the quantisation, which baseline files hold


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
