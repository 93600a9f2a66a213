"""The gallery of the pages: every sample, vectorized, with its report. Run by `make docs`.

    python tools/gallery.py [--preset PRESET]

Writes docs/gallery and docs/gallery.md, which are not kept in the repository; what an earlier run has made stays as it
is. The drawings of samples/artwork are drawn as pictures of 512 px first.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from PIL import Image

from cubicsplat_cli.evaluate.rerender import rerender_untrusted
from cubicsplat_cli.formatting import counted, file_size
from cubicsplat_cli.metrics import Report
from cubicsplat_cli.svg.untrusted import check_untrusted

ROOT = Path(__file__).resolve().parents[1]
GALLERY = ROOT / "docs" / "gallery"
PAGE = ROOT / "docs" / "gallery.md"
COMMAND = [sys.executable, "-m", "cubicsplat_cli"]
LONGER_SIDE = 512
PHOTOS = ("chelsea.png", "astronaut.jpg", "landscape.png", "logo.png")
HEAD = """# Gallery

Made by one command, `make docs`, from the samples of the repository: photos and pictures, then drawings whose truth is
known (drawn at 512 px, and vectorized from that). Each leads to its report; there is also
[a table of all](gallery/index.html) that can be sorted.

"""


def main() -> int:
    """Vectorize the samples and write the page; the exit code of what failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="draft", help="effort of the fits (default: draft)")
    preset = parser.parse_args().preset
    pictures = GALLERY / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    for name in PHOTOS:
        (pictures / name).write_bytes((ROOT / "samples" / name).read_bytes())
    drawings = sorted((ROOT / "samples" / "artwork").glob("*.svg"))
    for path in drawings:
        drawn(path).save(pictures / f"{path.stem}.png")
    names = [*PHOTOS, *(f"{path.stem}.png" for path in drawings)]
    inputs = [pictures / name for name in names]
    subprocess.run([*COMMAND, "vectorize", *inputs, "-o", GALLERY, "--report", "--preset", preset], check=True)
    PAGE.write_text(HEAD + "\n".join(rows(names)) + "\n", encoding="utf-8")
    return 0


def drawn(path: Path) -> Image.Image:
    """A drawing as a picture, without the mark of our own, which would make it no input."""
    data = path.read_bytes()
    size = check_untrusted(data, str(path))
    scale = LONGER_SIDE / max(size.width, size.height)
    return Image.fromarray(rerender_untrusted(data, source=str(path), scale=scale)[0].pixels)


def rows(names: list[str]) -> list[str]:
    """The lines of the table."""
    lines = ["| the picture | the SVG | |", "|---|---|---|"]
    for name in names:
        stem = Path(name).stem
        report = Report.from_json((GALLERY / f"{stem}.json").read_bytes())
        quality = report.quality.svg if report.quality is not None else None
        level = "" if quality is None else "identical" if quality.psnr_db is None else f"{quality.psnr_db:.1f} dB"
        made = counted(report.output.paths, "curve" if report.style == "photo" else "shape")
        figures = "<br>".join(
            [f"**{stem}**", made, file_size(report.output.bytes), level, f"[report](gallery/{stem}.html)"]
        )
        lines.append(f"| ![{stem}](gallery/pictures/{name}) | ![{stem} as SVG](gallery/{stem}.svg) | {figures} |")
    return lines


if __name__ == "__main__":
    sys.exit(main())
