"""Reading pictures from hostile files and writing results so that nothing half-written is left behind."""

from cubicsplat_cli.image.atomic import check_writable, write_atomically
from cubicsplat_cli.image.load import DEFAULT_MAX_PIXELS, Picture, load_picture, read_picture_file, resize_picture

__all__ = [
    "DEFAULT_MAX_PIXELS",
    "Picture",
    "check_writable",
    "load_picture",
    "read_picture_file",
    "resize_picture",
    "write_atomically",
]
