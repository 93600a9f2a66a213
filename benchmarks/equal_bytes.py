"""Photos of equal bytes: SVGs after gzip, beside WebP, AVIF and JPEG at the best size and quality that fit."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from PIL import Image, features

from benchmarks import Threads, main
from cubicsplat_cli import compare, vectorize
from cubicsplat_cli.cli.bench import Folder, Limit, Markdown, pictures_of, print_report
from cubicsplat_cli.cli.options import Json, option
from cubicsplat_cli.files.read import gzip_size
from cubicsplat_cli.formatting import mean, number, text_table
from cubicsplat_cli.metrics import head
from cubicsplat_cli.options import parse_bytes

OURS = "cubicsplat"
# Shares of the picture's sides at which a raster format is tried; what is smaller is enlarged again, bicubically.
SHARES = (1.0, 0.75, 0.5, 0.375, 0.25, 0.1875, 0.125, 0.09, 0.0625)
_ENCODERS: dict[str, dict[str, Any]] = {"WEBP": {"method": 6}, "AVIF": {"speed": 6}, "JPEG": {"optimize": True}}


def formats() -> list[str]:
    """The raster formats that this Pillow can write."""
    return [name for name in _ENCODERS if name == "JPEG" or features.check(name.lower())]


class Encoder:
    """The files of a picture in a raster format, each made once."""

    def __init__(self, picture: Image.Image, form: str) -> None:
        self.picture, self.form = picture, form
        self._files: dict[tuple[float, int], bytes] = {}

    def best(self, most: int) -> tuple[float, int] | None:
        """PSNR in dB and bytes of the best file of at most so many bytes; None where none is so small."""
        found = (self._largest(share, most) for share in SHARES)
        levels = [(_psnr_db(self.picture, Image.open(io.BytesIO(data))), len(data)) for data in found if data]
        return max(levels, default=None)

    def _largest(self, share: float, most: int) -> bytes | None:
        """The file of the highest quality that has at most so many bytes, by bisection: sizes rise with quality."""
        low, high, kept = -1, 101, None
        while high - low > 1:
            quality = (low + high) // 2 if low >= 0 else 0
            data = self.file(share, quality)
            if len(data) <= most:
                low, kept = quality, data
            elif quality == 0:
                return None
            else:
                high = quality
        return kept

    def file(self, share: float, quality: int) -> bytes:
        """The file of a quality, of the picture with its sides reduced to a share."""
        if (share, quality) not in self._files:
            buffer = io.BytesIO()
            _smaller(self.picture, share).save(buffer, self.form, quality=quality, **_ENCODERS[self.form])
            self._files[share, quality] = buffer.getvalue()
        return self._files[share, quality]


def _smaller(picture: Image.Image, share: float) -> Image.Image:
    size = [max(1, round(share * side)) for side in picture.size]
    return picture if share == 1.0 else picture.resize(size, Image.Resampling.LANCZOS)


def _psnr_db(picture: Image.Image, other: Image.Image) -> float:
    shown = other.convert("RGB").resize(picture.size, Image.Resampling.BICUBIC)
    level = compare(np.asarray(picture), np.asarray(shown)).psnr_db
    return 100.0 if level is None else level


def rows_of(path: Path, sizes: Sequence[int], side: int, threads: int) -> Iterator[dict[str, Any]]:
    """The figures of one picture: format, wanted and written bytes, PSNR in dB, and CPU seconds of our own."""
    picture = Image.open(path).convert("RGB")
    picture = _smaller(picture, min(1.0, side / max(picture.size)))
    encoders = [Encoder(picture, form) for form in formats()]
    for most in sizes:
        began = time.process_time()
        result = vectorize(np.asarray(picture), max_bytes=f"{most}gz", threads=threads, measure=False)
        seconds = time.process_time() - began
        ours = {"bytes": gzip_size(result.svg), "psnr_db": compare(np.asarray(picture), result).psnr_db}
        yield {"picture": path.name, "format": OURS, "most": most, **ours, "cpu_s": seconds}
        for each in encoders:
            best = each.best(most) or (None, None)
            yield {"picture": path.name, "format": each.form, "most": most, "bytes": best[1], "psnr_db": best[0]}


def equal_bytes(
    folder: Folder,
    sizes: Annotated[
        str, option("--bytes N,...", "Sizes to compare at, such as 400,1k; SVGs after gzip.")
    ] = "400,550,1200,2500,5k,10k",
    side: Annotated[int, option("--side PX", "Longer side of the pictures, px.", min=16)] = 300,
    threads: Threads = 1,
    limit: Limit = None,
    json: Json = False,
    markdown: Markdown = False,
) -> None:
    """Quality of photos at equal bytes, as SVGs and in raster formats."""
    amounts = [int(parse_bytes(text)) for text in sizes.split(",")]
    rows = [row for path in pictures_of(folder, limit) for row in rows_of(path, amounts, side, threads)]
    header = ("bytes", OURS, *formats(), "CPU s")
    table = [[str(most), *(_mean(rows, most, form) for form in header[1:-1]), _seconds(rows, most)] for most in amounts]
    report = {**head(), "bench": "equal_bytes", "side": side, "rows": rows}
    print_report(report, text_table(header, table, markdown=markdown), json=json)


def _mean(rows: Sequence[dict[str, Any]], most: int, form: str) -> str:
    """Mean PSNR of a format; none where any picture has no file so small."""
    levels = [row["psnr_db"] for row in rows if (row["most"], row["format"]) == (most, form)]
    return "" if None in levels else number(mean(levels), 2)


def _seconds(rows: Sequence[dict[str, Any]], most: int) -> str:
    return number(mean(row["cpu_s"] for row in rows if (row["most"], row["format"]) == (most, OURS)), 1)


if __name__ == "__main__":
    main(equal_bytes)
