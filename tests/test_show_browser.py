"""The pages in a real browser, by a real driver: the slider moves, zooming shows curves, no error, nothing leaves."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from command import run_here
from conftest import smooth_pixels
from PIL import Image

SIDE = 80  # px of the artwork, more than a picture of single pixels has


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pages about a photo, artwork with transparency, and both; and about a foreign SVG."""
    path = tmp_path_factory.mktemp("pages")
    Image.fromarray(smooth_pixels(60, 40)).save(path / "photo.png")
    Image.fromarray(smooth_pixels(SIDE, SIDE, alpha=True)).save(path / "logo.png")
    fit = ("--curves", 12, "--steps", 60, "--threads", 1, "--no-prune")
    # One by one in this process: the run over both finds all done but the index.
    for names in (["photo.png"], ["logo.png"], ["photo.png", "logo.png"]):
        run_here("vectorize", *(path / n for n in names), "-o", f"{path}/out/", "--report", *fit)
    (path / "plain.svg").write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="60" height="40"><g><rect width="60" height="40" fill="teal"/>'
        "</g></svg>"
    )
    run_here("eval", path / "photo.png", path / "plain.svg", "--report", path / "plain.html")
    return path


@pytest.fixture
def opened(browser) -> Iterator[object]:
    """Opens a page and returns it; the test fails where the page complains or asks for anything but itself."""
    said: list[str] = []
    asked: list[str] = []
    contexts = []

    def open_page(path: Path, **options):
        contexts.append(browser.new_context(viewport={"width": 1200, "height": 900}, **options))
        page = contexts[-1].new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(path.as_uri())
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert said == []
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []


def pixels_of(page) -> np.ndarray:
    """What the stage shows, (H, W, 3)."""
    with Image.open(io.BytesIO(page.locator(".stage").screenshot())) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def test_the_slider_moves_by_pointer_and_by_keys(opened, folder):
    page = opened(folder / "out" / "photo.html")
    divider = page.locator(".divider")
    before, box = pixels_of(page), page.locator(".stage").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 40)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] * 0.8, box["y"] + 40, steps=3)
    page.mouse.up()
    assert divider.get_attribute("aria-valuenow") == "80"
    after = pixels_of(page)
    middle = slice(int(0.55 * after.shape[1]), int(0.75 * after.shape[1]))
    assert np.abs(before[:, middle] - after[:, middle]).max() > 20  # the original where the SVG was
    page.keyboard.press("Home")
    assert divider.get_attribute("aria-valuenow") == "0"
    page.keyboard.press("PageUp")
    page.keyboard.press("ArrowRight")
    assert divider.get_attribute("aria-valuenow") == "22"


def test_zooming_shows_pixels_of_the_picture_and_curves_of_the_svg(opened, folder):
    page = opened(folder / "out" / "logo.html")
    page.locator("[value=beside]").check(force=True)
    box, scale = page.locator(".made").bounding_box(), float(page.locator(".stage").get_attribute("data-zoom"))
    # Where the disc of `smooth_pixels` is cut by a line at 45 degrees, from the middle of the picture.
    away = 0.3 * SIDE * 0.5**0.5
    page.mouse.move(
        box["x"] + box["width"] / 2 + scale * (0.45 * SIDE - away - SIDE / 2),
        box["y"] + box["height"] / 2 - scale * away,
    )
    for _ in range(12):
        page.mouse.wheel(0, -400)
    page.keyboard.press("Escape")
    seen = pixels_of(page)[60:-60]
    assert float(page.locator(".stage").get_attribute("data-zoom")) > 100
    half = seen.shape[1] // 2
    changes = [
        (np.abs(np.diff(side, axis=0)).max(axis=(1, 2)) > 20).mean() for side in (seen[:, :half], seen[:, half:])
    ]
    # The rows of a large pixel are alike; along a slanted outline each is another.
    assert changes[0] < 0.05
    assert changes[1] > 0.3
    page.keyboard.press("0")
    assert float(page.locator(".stage").get_attribute("data-zoom")) < 20


def test_a_curve_is_told_of_under_the_pointer_and_by_keys(opened, folder):
    page = opened(folder / "out" / "photo.html")
    box = page.locator(".stage").bounding_box()
    page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 0.5 * box["height"])
    page.locator(".mark").wait_for(state="attached")
    words = page.locator(".status .words").inner_text()
    assert " of 12 from the front" in words
    assert "segments" in words
    assert "without it" in words
    for key in ("Escape", "n", "n"):
        page.keyboard.press(key)
    assert page.locator(".status .words").inner_text().startswith("curve 2 of ")
    page.keyboard.press("4")
    assert page.locator(".outline").count() == page.locator(".drawing path").count()


@pytest.mark.parametrize("name", ["out/photo.html", "out/logo.html", "plain.html"])
def test_the_error_is_what_this_browser_finds(opened, folder, name):
    page = opened(folder / name)
    page.keyboard.press("3")
    page.locator(".stage[data-browser-db]").wait_for()
    level = page.locator(".stage").get_attribute("data-browser-db")
    said = page.locator(".facts dd").first.inner_text()
    # Chromium rounds colours after each translucent shape, and its edges are not cairo's.
    assert float(level.split()[0]) == pytest.approx(float(said.split()[0]), abs=1.2)


def test_dark_and_narrow_fits_the_screen(opened, folder):
    page = opened(folder / "out" / "photo.html", color_scheme="dark")
    page.set_viewport_size({"width": 400, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert max(map(int, ground.strip("rgb()").split(","))) < 60


def test_the_index_sorts_and_leads_to_the_pages(opened, folder):
    page = opened(folder / "out" / "index.html")
    levels = [float(text) for text in page.locator("tbody td:nth-child(3)").all_inner_texts()]
    page.get_by_role("button", name="PSNR, dB").click()
    shown = [float(text) for text in page.locator("tbody td:nth-child(3)").all_inner_texts()]
    assert shown == sorted(levels, reverse=True)
    page.get_by_role("button", name="PSNR, dB").press("Enter")
    assert [float(text) for text in page.locator("tbody td:nth-child(3)").all_inner_texts()] == sorted(levels)
    page.locator("td.name a").first.click()
    assert page.locator(".stage").count() == 1
