"""The formats of pictures that are read."""

from __future__ import annotations

import importlib
from pathlib import Path

from PIL import Image

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.names import reads_heic
from cubicsplat_cli.files.ownership import read_head
from cubicsplat_cli.files.paths import is_file

FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TIFF", "GIF", "PPM")
FORMATS_TEXT = ", ".join((*FORMATS, "AVIF"))
_AVIF = {b"avif", b"avis"}
_HEIC = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"}


def holds_picture(path: Path) -> bool:
    """Whether an existing regular file begins as a raster picture does, whatever its name."""
    try:
        if not is_file(path) or _brands(read_head(path)) & (_AVIF | _HEIC):
            return is_file(path)
        Image.open(path, formats=FORMATS).close()
    except OSError:
        return False
    except Image.DecompressionBombError:
        pass
    return True


def formats_of(data: bytes, shown: str) -> tuple[str, ...]:
    """The formats, by Pillow's names, that a file of these bytes may be opened as.

    AVIF is read where Pillow was built with it, HEIC where there is pillow-heif. Raises InputError, naming the file,
    for one of these that cannot be read here, with what to install.
    """
    brands = _brands(data)
    if brands & _AVIF:
        Image.init()
        if "AVIF" not in Image.OPEN:
            raise InputError(f"{shown}: is an AVIF picture; pip install -U 'Pillow>=11.3' to have it read")
        return ("AVIF",)
    if brands & _HEIC:
        if not reads_heic():
            raise InputError(
                f"{shown}: is an HEIC picture; pip install pillow-heif to have it read, or save it as JPEG"
            )
        importlib.import_module("pillow_heif").register_heif_opener()
        return ("HEIF",)
    return FORMATS


def _brands(data: bytes) -> set[bytes]:
    """What a file of the MPEG-4 family says that it can be read as; none where it is of another kind."""
    if data[4:8] != b"ftyp":
        return set()
    names = data[8 : min(int.from_bytes(data[:4], "big"), 256)]
    return {names[i : i + 4] for i in range(0, len(names), 4) if i != 4}  # between them stands a version
