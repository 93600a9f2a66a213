"""A file looks the same in cairosvg, resvg and Chromium: filled or stroked, opaque or transparent, or artwork."""

from __future__ import annotations

import io
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from conftest import rest_slow
from PIL import Image

from benchmarks.artwork.pixels import psnr
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.svg.drawing_writer import write_drawing
from cubicsplat_cli.svg.scene_reader import read_svg

SAMPLES = Path(__file__).resolve().parents[1] / "samples"
AGREEMENT_DB = 40.0
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
    run_cli("vectorize", SAMPLES / name, "-o", folder / "x.svg", *options)
    return folder / "x.svg"


def in_chromium(browser, svg: Path, width: int, height: int) -> np.ndarray:
    """(H, W, 4) uint8: what Chromium shows of a file."""
    page = browser.new_page(viewport={"width": width, "height": height})
    page.goto(svg.as_uri())
    shot = page.screenshot(omit_background=True)
    page.close()
    with Image.open(io.BytesIO(shot)) as image:
        return np.asarray(image.convert("RGBA"))


def size_of(svg: Path) -> tuple[int, int]:
    scene = read_svg(svg.read_bytes())
    return scene.width, scene.height


def test_cairosvg_and_resvg_agree(drawing):
    width, height = size_of(drawing)
    drawn = [rerender(drawing.read_bytes(), width, height, renderer=name).pixels for name in ("cairosvg", "resvg")]
    assert drawn[0].std() > 10, "there is something to see"
    assert psnr(*drawn) >= AGREEMENT_DB


def test_chromium_agrees_with_both(drawing, browser):
    width, height = size_of(drawing)
    data = drawing.read_bytes()
    drawn = {name: rerender(data, width, height, renderer=name).pixels for name in ("cairosvg", "resvg")}
    drawn["chromium"] = in_chromium(browser, drawing, width, height)
    found = {pair: psnr(drawn[pair[0]], drawn[pair[1]]) for pair in combinations(drawn, 2)}
    assert min(found.values()) >= AGREEMENT_DB, found
