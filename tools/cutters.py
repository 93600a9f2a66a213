"""The picture of docs/cutters.md: a drawing, its layers, and a misplaced print without and with an overlap.

    python tools/cutters.py

Writes docs/pictures/cutters.png.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

import cubicsplat_cli as cubicsplat
from cubicsplat_cli.evaluate.rerender import rerender, rerender_untrusted

ROOT = Path(__file__).resolve().parents[1]
SIDE, GAP, OVERLAP = 160, 8, 4.0  # px of a picture, between two of them, and of the drawing
# Px by which the sheets of a careless print lie off their places, by the colours' place in the alphabet.
OFF = ((2, 0), (-1, -1), (0, 2), (1, 1), (-1, 1))


def drawn(svg: str, side: int = SIDE) -> Image.Image:
    """A square SVG of ours in RGBA."""
    return Image.fromarray(rerender(svg.encode(), side, side).pixels)


def on_paper(sheets: list[Image.Image], off: tuple[tuple[int, int], ...]) -> Image.Image:
    """Sheets laid on one another and on white paper, each off its place by so many px."""
    paper = Image.new("RGBA", sheets[0].size, "white")
    for sheet, place in zip(sheets, off, strict=True):
        moved = Image.new("RGBA", sheet.size)
        moved.paste(sheet, place)
        paper = Image.alpha_composite(paper, moved)
    return paper


def on_checks(picture: Image.Image) -> Image.Image:
    """A picture on the checks that stand for nothing."""
    checks = (np.indices((SIDE, SIDE)) // 10).sum(axis=0) % 2 * 30 + 215
    return Image.alpha_composite(Image.fromarray(checks.astype(np.uint8)).convert("RGBA"), picture)


def main() -> None:
    """Draw the sheet."""
    face = (ROOT / "samples" / "artwork" / "face.svg").read_bytes()
    picture = rerender_untrusted(face, source="face.svg", width=256, height=256)[0].pixels
    cut, lapped, removed = (
        cubicsplat.vectorize(picture, background="#8fc7e0", stacking="cutout", **options)
        for options in ({"group_by": "color"}, {"overlap": OVERLAP}, {"ground": "remove"})
    )
    prints = []
    for made in (cut, lapped):
        places = {name[3:]: OFF[number] for number, name in enumerate(sorted(made.layers(), key=lambda n: n[3:]))}
        sheets = {name[3:]: drawn(svg) for name, svg in made.layers().items()}
        prints.append(on_paper([*sheets.values()], tuple(places[colour] for colour in sheets)))
    sheets = [drawn(svg) for svg in cut.layers().values()]
    top = [drawn(cut.svg), *(on_paper([sheet], ((0, 0),)) for sheet in sheets[:3])]
    bottom = [on_paper(sheets[3:4], ((0, 0),)), *prints, on_checks(drawn(removed.svg))]
    sheet = Image.new("RGB", (len(top) * (SIDE + GAP) - GAP, 2 * SIDE + GAP), "#dddddd")
    for row, pictures in enumerate((top, bottom)):
        for column, each in enumerate(pictures):
            sheet.paste(each.convert("RGB"), (column * (SIDE + GAP), row * (SIDE + GAP)))
    sheet.quantize(64).save(ROOT / "docs" / "pictures" / "cutters.png", optimize=True)


if __name__ == "__main__":
    main()
