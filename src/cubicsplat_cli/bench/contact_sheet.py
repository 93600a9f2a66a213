"""Pictures side by side with their labels, and rows of them as one PNG."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from cubicsplat_cli.files.write import encode_png

_LABEL = 18  # px, the height of a line of text
_LETTERS = 12  # px
_MARGIN = 6  # px


def cell(pixels: np.ndarray, longest: int, *, enlarge: bool = False) -> Image.Image:
    """(H, W, 3) uint8 as an image whose longer side has at most `longest` px, or just as many with `enlarge`."""
    image = Image.fromarray(pixels)
    scale = longest / max(image.size)
    if not enlarge:
        scale = min(1.0, scale)
    width, height = (max(1, round(side * scale)) for side in image.size)
    return image.resize((width, height), Image.Resampling.BOX if scale < 1 else Image.Resampling.NEAREST)


def labelled_row(cells: Sequence[Image.Image], labels: Sequence[str], width: int) -> Image.Image:
    """The cells in columns of `width` px, each below its label, which may have several lines."""
    lines = max(label.count("\n") + 1 for label in labels)
    height = max(cell.height for cell in cells) + lines * _LABEL + _MARGIN
    row = Image.new("RGB", (len(cells) * (width + _MARGIN) + _MARGIN, height), "white")
    draw, font = ImageDraw.Draw(row), ImageFont.load_default(_LETTERS)
    for index, (image, label) in enumerate(zip(cells, labels, strict=True)):
        left = _MARGIN + index * (width + _MARGIN)
        for number, line in enumerate(label.split("\n")):
            # The built-in font may lack other letters, and no label is worth a failure.
            text = line.encode("ascii", "replace").decode()
            draw.text((left, 3 + number * _LABEL), text, fill="black", font=font)
        row.paste(image, (left, lines * _LABEL))
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
