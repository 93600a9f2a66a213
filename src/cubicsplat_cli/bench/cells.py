"""Pictures side by side with their labels, and rows of them as one PNG."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from cubicsplat_cli.files.png import encode_png

_LABEL = 18
_LETTERS = 12  # px
_MARGIN = 6


def labelled_row(cells: Sequence[Image.Image], labels: Sequence[str], width: int) -> Image.Image:
    """The cells in columns of `width` px, each below its label."""
    height = max(cell.height for cell in cells) + _LABEL + _MARGIN
    row = Image.new("RGB", (len(cells) * (width + _MARGIN) + _MARGIN, height), "white")
    draw, font = ImageDraw.Draw(row), ImageFont.load_default(_LETTERS)
    for index, (cell, label) in enumerate(zip(cells, labels, strict=True)):
        left = _MARGIN + index * (width + _MARGIN)
        # The built-in font may hold no other letters, and no label is worth a failure.
        draw.text((left, 3), label.encode("ascii", "replace").decode(), fill="black", font=font)
        row.paste(cell, (left, _LABEL))
    return row


def stacked(rows: Sequence[Image.Image]) -> bytes:
    """PNG bytes of the rows below one another."""
    sheet = Image.new("RGB", (max(row.width for row in rows), sum(row.height for row in rows)), "white")
    top = 0
    for row in rows:
        sheet.paste(row, (0, top))
        top += row.height
    pixels = np.asarray(sheet)
    return encode_png(np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)]))
