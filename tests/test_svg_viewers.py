"""A file looks the same in cairosvg, resvg and Chromium: filled or stroked, opaque or transparent, or artwork."""

from __future__ import annotations

import math
import shutil
import subprocess
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from conftest import rest_slow
from PIL import Image

from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.evaluate import rerender
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.svg import read_svg, write_drawing

SAMPLES = Path(__file__).resolve().parents[1] / "samples"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
AGREEMENT_DB = 40.0
# Nothing but the file itself: no network, no profile of anybody, no updates.
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-extensions",
    "--force-device-scale-factor=1", "--default-background-color=00000000",
)  # fmt: skip
FITS = {
    "filled": ("chelsea.png", "--max-size", 160, "--curves", 120, "--steps", 120, "--threads", 1),
    "stroked": ("chelsea.png", "--max-size", 140, "--curves", 80, "--steps", 100, "--threads", 1, "--mode", "open"),
    "transparent": ("logo.png", "--curves", 64, "--steps", 100, "--threads", 1),
}


@pytest.fixture(scope="module", params=rest_slow("filled", "artwork", *FITS, fast=2))
def drawing(request, tmp_path_factory, run_cli) -> Path:
    """The SVG of a sample."""
    folder = tmp_path_factory.mktemp("drawing")
    if request.param == "artwork":
        made = draw(load_picture(SAMPLES / "logo.png").target())
        (folder / "x.svg").write_text(write_drawing(made, title="logo", comment="c"), encoding="utf-8")
        return folder / "x.svg"
    name, *options = FITS[request.param]
    done = run_cli("vectorize", SAMPLES / name, "-o", folder / "x.svg", *options)
    assert done.returncode == 0, done.stderr
    return folder / "x.svg"


def agreement(first: np.ndarray, second: np.ndarray) -> float:
    """The smaller PSNR, over black and over white, of two (H, W, 4) uint8 straight RGBA pictures."""
    found = []
    for white in (0.0, 1.0):
        alphas = [pixels[..., 3:] / 255 for pixels in (first, second)]
        over = [p[..., :3] / 255 * a + white * (1 - a) for p, a in zip((first, second), alphas, strict=True)]
        error = float(np.mean((over[0] - over[1]) ** 2))
        found.append(math.inf if error == 0 else -10 * math.log10(error))
    return min(found)


def in_chromium(svg: Path, width: int, height: int, profile: Path) -> np.ndarray:
    """What Chromium shows of a file; the window is larger than the picture, which lies in its corner."""
    shot = profile / "shot.png"
    arguments = [*FLAGS, f"--user-data-dir={profile}", f"--window-size={width + 200},{height + 300}"]
    done = subprocess.run(
        [CHROMIUM, *arguments, f"--screenshot={shot}", svg.as_uri()], capture_output=True, timeout=90, check=False
    )
    assert shot.is_file(), done.stderr.decode(errors="replace")[-2000:]
    with Image.open(shot) as image:
        return np.asarray(image.convert("RGBA"))[:height, :width]


def size_of(svg: Path) -> tuple[int, int]:
    scene = read_svg(svg.read_bytes())
    return scene.width, scene.height


def test_cairosvg_and_resvg_agree(drawing):
    width, height = size_of(drawing)
    drawn = [rerender(drawing.read_bytes(), width, height, renderer=name).pixels for name in ("cairosvg", "resvg")]
    assert drawn[0].std() > 10, "there is something to see"
    assert agreement(*drawn) >= AGREEMENT_DB


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed (apt-get install chromium)")
def test_chromium_agrees_with_both(drawing, tmp_path):
    width, height = size_of(drawing)
    data = drawing.read_bytes()
    drawn = {name: rerender(data, width, height, renderer=name).pixels for name in ("cairosvg", "resvg")}
    drawn["chromium"] = in_chromium(drawing, width, height, tmp_path)
    found = {pair: agreement(drawn[pair[0]], drawn[pair[1]]) for pair in combinations(drawn, 2)}
    assert min(found.values()) >= AGREEMENT_DB, found
