"""Independent rendering, its fallback and its limits; PSNR and SSIM; the report."""

from __future__ import annotations

import importlib
import json
import math

import numpy as np
import pytest
import torch
from scenes import PAPER, as_arguments, random_scene

from cubicsplat_cli.errors import EngineError, InputError, UsageError
from cubicsplat_cli.evaluate import (
    Quality,
    available_renderers,
    compare,
    compare_premultiplied,
    rerender,
    rerender_untrusted,
)
from cubicsplat_cli.evaluate.report import agreement_db, quality_fields, to_json
from cubicsplat_cli.image import Picture
from cubicsplat_cli.raster import reference
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Mode, Scene
from cubicsplat_cli.svg import quantise_scene, write_svg

RENDERER = importlib.import_module("cubicsplat_cli.evaluate.rerender")
BOTH = pytest.mark.parametrize("renderer", ["cairosvg", "resvg"])


def svg_of(scene: Scene, precision: int = 2) -> bytes:
    return write_svg(scene, precision=precision, title="t", comment="cubicsplat test").encode()


def square(left: float, top: float, side: float) -> list[list[float]]:
    """Control points of a closed curve of four straight cubics."""
    corners = [(left, top), (left + side, top), (left + side, top + side), (left, top + side)]
    points = []
    for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
        points += [[x0 + (x1 - x0) * t, y0 + (y1 - y0) * t] for t in (0, 1 / 3, 2 / 3)]
    return points


def two_squares(background: tuple[float, float, float] | None) -> Scene:
    """A red opaque square in front of a half transparent blue one; edges on pixel edges."""
    return Scene(
        mode=Mode.CLOSED,
        width=12,
        height=8,
        points=torch.tensor([square(2, 2, 3), square(4, 2, 4)]),
        colours=torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        opacities=torch.tensor([1.0, 0.5]),
        half_widths=torch.zeros(2),
        background=background,
    )


def picture(rgb: np.ndarray, alpha: np.ndarray | None = None) -> Picture:
    return Picture(rgb=rgb.astype(np.float32), alpha=alpha, source="reference.png", sha256="0" * 64)


def noise(height: int, width: int, channels: int = 3, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, channels), dtype=np.uint8)


def without_libcairo(name: str):
    if name == "cairosvg":
        raise OSError('no library called "cairo-2" was found\nand more lines')
    return importlib.import_module(name)


# --- rendering ---------------------------------------------------------------------------------------------


@BOTH
def test_front_covers_back_and_transparency_is_kept(renderer):
    rendered = rerender(svg_of(two_squares(None)), 12, 8, renderer=renderer)
    assert rendered.pixels.shape == (8, 12, 4)
    assert rendered.pixels.dtype == np.uint8
    assert rendered.pixels[3, 4].tolist() == [255, 0, 0, 255], "the front square, where both are"
    assert rendered.pixels[3, 6, :3].tolist() == [0, 0, 255]
    assert abs(int(rendered.pixels[3, 6, 3]) - 128) <= 1
    assert rendered.pixels[0, 0, 3] == 0
    assert rendered.note is None
    assert rendered.renderer.split()[0] == {"cairosvg": "cairosvg", "resvg": "resvg_py"}[renderer]


@BOTH
def test_background_fills_the_canvas_and_size_is_what_was_asked_for(renderer):
    rendered = rerender(svg_of(two_squares((0.0, 1.0, 0.0))), 36, 24, renderer=renderer)
    assert rendered.pixels.shape == (24, 36, 4)
    assert (rendered.pixels[..., 3] == 255).all()
    assert rendered.pixels[0, 0].tolist() == [0, 255, 0, 255]
    assert rendered.pixels[9, 13].tolist() == [255, 0, 0, 255]


@BOTH
@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("background", [None, PAPER])
def test_file_shows_the_same_picture_as_the_reference_renderer(mode, background, renderer):
    scene = random_scene(mode, curves=10, width=64, height=48, background=background, seed=3)
    file = rerender(svg_of(scene), 64, 48, renderer=renderer)
    tensors, keywords = as_arguments(quantise_scene(scene, 2))
    own = reference.render(*tensors, **keywords, settings=RasterSettings("exact", samples=32))
    pixels = file.pixels.astype(np.float64) / 255
    if background is None:
        pixels[..., :3] *= pixels[..., 3:]
    error = own.numpy() - pixels[..., : own.shape[2]]
    assert own.std() > 0.05, "an empty picture would agree with anything"
    # The renderers' anti-aliasing is coarser than ours, resvg's most (about 39 dB on this crowd of strokes).
    assert -10 * math.log10((error**2).mean()) > 37
    assert np.abs(error).max() < 0.2


def test_the_two_renderers_agree():
    svg = svg_of(random_scene(Mode.CLOSED, curves=30, width=80, height=60, background=PAPER))
    first, second = (
        rerender(svg, 80, 60, renderer=name).pixels.astype(float) for name in ("cairosvg", "resvg")
    )
    assert first.std() > 10
    assert np.abs(first - second).mean() < 1.5


def test_missing_libcairo_falls_back_and_says_so(monkeypatch):
    monkeypatch.setattr(RENDERER, "_import_module", without_libcairo)
    rendered = rerender(svg_of(two_squares(None)), 12, 8)
    assert rendered.renderer.startswith("resvg_py ")
    assert "libcairo" in rendered.note
    assert RENDERER.install_hint() in rendered.note
    assert "\n" not in rendered.note
    states = {info.name: info for info in available_renderers()}
    assert states["cairosvg"].version is None
    assert "libcairo" in states["cairosvg"].problem
    assert states["resvg"].version


@pytest.mark.parametrize(
    ("system", "hint"),
    [("linux", "apt-get install libcairo2"), ("darwin", "brew install cairo"), ("win32", "GTK")],
)
def test_hint_suits_the_system(monkeypatch, system, hint):
    monkeypatch.setattr(RENDERER.sys, "platform", system)
    assert hint in RENDERER.install_hint()


def test_a_renderer_asked_for_by_name_is_never_replaced(monkeypatch):
    monkeypatch.setattr(RENDERER, "_import_module", without_libcairo)
    with pytest.raises(EngineError, match="libcairo"):
        rerender(svg_of(two_squares(None)), 12, 8, renderer="cairosvg")
    with pytest.raises(UsageError, match="inkscape"):
        rerender(svg_of(two_squares(None)), 12, 8, renderer="inkscape")


def test_no_renderer_at_all_is_an_error_with_both_reasons(monkeypatch):
    def nothing(name: str):
        if name == "resvg_py":
            raise ImportError("no resvg here")
        return without_libcairo(name)

    monkeypatch.setattr(RENDERER, "_import_module", nothing)
    with pytest.raises(EngineError, match=r"libcairo.*pip install resvg_py"):
        rerender(svg_of(two_squares(None)), 12, 8)


@pytest.mark.parametrize(("width", "height"), [(0, 5), (5, -1), (40_000, 5), (30_000, 30_000)])
def test_impossible_sizes_are_refused(width, height):
    with pytest.raises(InputError, match="cannot be drawn"):
        rerender(svg_of(two_squares(None)), width, height)


# --- SVG files of others -----------------------------------------------------------------------------------

XLINK = 'xmlns:xlink="http://www.w3.org/1999/xlink"'
OPEN_TAG = f'<svg xmlns="http://www.w3.org/2000/svg" {XLINK} width="20" height="10">'


def foreign(body: str, before: str = "") -> bytes:
    return f"{before}{OPEN_TAG}{body}</svg>".encode()


@BOTH
def test_ordinary_files_of_others_are_drawn(renderer):
    doctype = (
        '<!DOCTYPE svg PUBLIC "-//W3C//DTD SVG 1.1//EN" "http://www.w3.org/Graphics/SVG/1.1/DTD/svg11.dtd">'
    )
    body = (
        "<style>.a{fill:url(#g)}</style>"
        '<defs><linearGradient id="g"><stop stop-color="#f00"/></linearGradient>'
        '<rect id="r" width="10" height="10"/></defs>'
        '<a href="https://example.org"><use xlink:href="#r" class="a"/></a>'
    )
    rendered, size = rerender_untrusted(foreign(body, doctype), source="x.svg", scale=2, renderer=renderer)
    assert (size.width, size.height) == (20, 10)
    assert rendered.pixels.shape == (20, 40, 4)
    assert rendered.pixels[10, 5].tolist() == [255, 0, 0, 255]
    assert rendered.pixels[10, 30, 3] == 0


@BOTH
def test_other_shapes_are_centred(renderer):
    svg = b'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 10 10"><rect width="10" height="10"/></svg>'
    rendered, _ = rerender_untrusted(svg, source="x.svg", width=30, height=10, renderer=renderer)
    assert rendered.pixels.shape == (10, 30, 4)
    opaque = rendered.pixels[5, :, 3] == 255
    assert opaque.tolist() == [False] * 10 + [True] * 10 + [False] * 10


@BOTH
@pytest.mark.parametrize(
    ("svg", "said"),
    [
        (b"", "empty"),
        (b"  \n", "empty"),
        (b"GIF89a", "well-formed"),
        (b"<html/>", "no SVG"),
        (b"\x1f\x8b\x08rest", "gunzip"),
        (foreign("")[:-5], "well-formed"),
        (foreign("", '<!DOCTYPE svg [<!ENTITY a "b">]>'), "entity"),
        (foreign("", '<!DOCTYPE svg [<!ENTITY % a SYSTEM "file:///etc/passwd"> %a;]>'), "entity"),
        (foreign('<image href="data:image/png;base64,AAAA"/>'), "<image>"),
        (foreign('<image xlink:href="file:///etc/hostname"/>'), "<image>"),
        (foreign('<x:image xmlns:x="http://www.w3.org/2000/svg" href="a.png"/>'), "<image>"),
        (foreign('<filter><feImage href="http://localhost/"/></filter>'), "<feImage>"),
        (foreign("<foreignObject/>"), "<foreignObject>"),
        (foreign('<use xlink:href="other.svg#a"/>'), "outside"),
        (foreign('<use href="http://localhost/a.svg#a"/>'), "outside"),
        (foreign('<rect width="9" height="9" fill="url(http://localhost/#a)"/>'), "outside"),
        (foreign("<rect style=\"fill:url('//localhost/#a')\"/>"), "outside"),
        (foreign("<style>@import 'http://localhost/a.css';</style>"), "outside"),
        (foreign("<style>rect{fill:url( a.svg#b )}</style>"), "outside"),
        (foreign("", '<?xml-stylesheet href="http://localhost/a.css"?>'), "outside"),
        (b'<svg xmlns="http://www.w3.org/2000/svg"/>', "no size"),
        (b'<svg xmlns="http://www.w3.org/2000/svg" width="100%" height="1e999"/>', "no size"),
        (b'<svg xmlns="http://www.w3.org/2000/svg" width="0" height="5"/>', "no size"),
        (foreign("<g>" * 300 + "</g>" * 300), "levels"),
        (b'<?xml version="1.0" encoding="nonsense"?>' + foreign(""), "encoding|well-formed"),
    ],
)
def test_dangerous_or_broken_files_are_refused(svg, said, renderer, monkeypatch):
    monkeypatch.setattr("socket.socket.connect", lambda *_: pytest.fail("a file made us open a connection"))
    with pytest.raises(InputError, match=said):
        rerender_untrusted(svg, source="x.svg", renderer=renderer)


def test_files_over_the_size_limit_are_refused(monkeypatch):
    monkeypatch.setattr("cubicsplat_cli.evaluate.untrusted.MAX_SVG_BYTES", 100)
    with pytest.raises(InputError, match="100 bytes"):
        rerender_untrusted(foreign("<g/>" * 50), source="x.svg")


def test_what_cairosvg_cannot_draw_is_one_clear_error():
    with pytest.raises(InputError, match="cairosvg cannot draw"):
        rerender_untrusted(foreign('<use id="u" href="#u"/>'), source="x.svg", renderer="cairosvg")


@pytest.mark.parametrize("scale", [0, -1, float("nan"), float("inf")])
def test_scale_must_be_positive(scale):
    with pytest.raises(UsageError, match="scale"):
        rerender_untrusted(foreign(""), source="x.svg", scale=scale)


# --- measures ----------------------------------------------------------------------------------------------


def test_psnr_of_a_known_error():
    reference_picture = picture(np.full((16, 16, 3), 100 / 255))
    candidate = np.full((16, 16, 3), 110, np.uint8)
    quality = compare(reference_picture, candidate)
    assert quality.psnr_db == pytest.approx(20 * math.log10(255 / 10), abs=1e-4)
    assert not quality.identical


def test_ssim_is_the_gaussian_window_definition():
    """Against the published formula written out for the one pixel whose window fits an 11 x 11 picture."""
    first, second = noise(11, 11, seed=1), noise(11, 11, seed=2)
    taps = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    window = np.outer(taps, taps) / taps.sum() ** 2
    values = []
    for channel in range(3):
        x, y = first[..., channel] / 255, second[..., channel] / 255
        mx, my = (window * x).sum(), (window * y).sum()
        vx, vy = (window * x * x).sum() - mx * mx, (window * y * y).sum() - my * my
        cov = (window * x * y).sum() - mx * my
        c1, c2 = 0.01**2, 0.03**2
        values.append((2 * mx * my + c1) * (2 * cov + c2) / ((mx * mx + my * my + c1) * (vx + vy + c2)))
    quality = compare(picture(first / 255), second)
    assert quality.ssim == pytest.approx(np.mean(values), abs=1e-5)
    assert abs(quality.ssim) < 0.5


def test_identical_pictures_have_no_psnr():
    pixels = noise(20, 15)
    quality = compare(picture(pixels / 255), pixels)
    assert quality == Quality(None, 1.0, True)
    assert "Infinity" not in to_json(quality_fields(quality))
    opaque = np.dstack([pixels, np.full((20, 15), 255, np.uint8)])
    assert compare(picture(pixels / 255), opaque).identical
    assert compare_premultiplied(picture(pixels / 255), pixels / 255).identical


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 30), (10, 40), (40, 10)])
def test_small_pictures_have_no_ssim_but_a_reason(height, width):
    quality = compare(picture(np.zeros((height, width, 3))), np.full((height, width, 3), 9, np.uint8))
    assert quality.ssim is None
    assert "11" in quality.ssim_note
    assert quality.psnr_db > 20
    assert quality_fields(quality)["ssim"] is None


def test_transparency_reports_the_worse_of_black_and_white():
    black = picture(np.zeros((16, 16, 3)), np.full((16, 16), 0.5, np.float32))
    # Half transparent black: over black nothing differs from an opaque black candidate, over white much does.
    opaque_black = np.dstack([np.zeros((16, 16, 3), np.uint8), np.full((16, 16), 255, np.uint8)])
    quality = compare(black, opaque_black)
    assert not quality.identical
    assert quality.psnr_db == pytest.approx(-20 * math.log10(0.5), abs=1e-3)
    # And a candidate that is transparent where the reference is opaque is judged over both as well.
    white = picture(np.ones((16, 16, 3)))
    clear = compare(white, np.zeros((16, 16, 4), np.uint8))
    assert clear.psnr_db == pytest.approx(0.0, abs=1e-6)


def test_hidden_colours_of_transparent_pixels_do_not_count():
    alpha = np.zeros((16, 16), np.float32)
    alpha[:8] = 1
    rgb = noise(16, 16) / 255 * alpha[..., None]
    candidate = np.dstack([np.rint(rgb * 255), alpha * 255]).astype(np.uint8)
    candidate[8:, :, :3] = 77
    assert compare(picture(rgb, alpha), candidate).identical
    premultiplied = np.dstack([rgb, alpha]).astype(np.float32)
    assert compare_premultiplied(picture(rgb, alpha), premultiplied).identical


def test_sizes_and_shapes_must_fit():
    with pytest.raises(InputError, match=r"20 x 10 px.*10 x 20 px"):
        compare(picture(np.zeros((10, 20, 3))), np.zeros((20, 10, 3), np.uint8))
    with pytest.raises(InputError, match="uint8"):
        compare(picture(np.zeros((10, 20, 3))), np.zeros((10, 20, 3)))
    with pytest.raises(InputError, match="finite"):
        compare_premultiplied(picture(np.zeros((10, 20, 3))), np.full((10, 20, 3), np.nan))


# --- report ------------------------------------------------------------------------------------------------


def test_json_never_holds_what_is_not_json():
    text = to_json(
        {"a": float("inf"), "b": [float("nan"), 1.5, np.float64(2.5)], "c": {"d": -float("inf")}, "e": (1,)}
    )
    assert json.loads(text, parse_constant=pytest.fail) == {
        "a": None,
        "b": [None, 1.5, 2.5],
        "c": {"d": None},
        "e": [1],
    }
    assert text.endswith("\n")


def test_agreement_is_own_minus_file():
    assert agreement_db(Quality(30.0, 0.9, False), Quality(30.5, 0.9, False)) == pytest.approx(0.5)
    assert agreement_db(Quality(None, 1.0, True), Quality(30.5, 0.9, False)) is None
