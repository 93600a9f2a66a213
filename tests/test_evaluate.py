"""Independent rendering, its fallback and its limits; PSNR, SSIM and agreement; the report."""

from __future__ import annotations

import importlib
import json
import math
import subprocess
import sys
from io import BytesIO
from itertools import product

import numpy as np
import pytest
import reference
import torch
from conftest import agreement_db, rest_slow
from PIL import Image
from scenes import PAPER, random_scene, rectangle

from cubicsplat_cli.errors import EngineError, InputError, UsageError
from cubicsplat_cli.evaluate.images import of_pixels, of_scene, of_values
from cubicsplat_cli.evaluate.metrics import compare, measure, psnr_db
from cubicsplat_cli.evaluate.rerender import available_renderers, rerender
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.metrics import Quality, gap_db, plain, to_json
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.scene_reader import quantise_scene
from cubicsplat_cli.svg.scene_writer import write_svg

RENDERER = importlib.import_module("cubicsplat_cli.evaluate.rerender")
BOTH = pytest.mark.parametrize("renderer", ["cairosvg", "resvg"])


def svg_of(scene: Scene, precision: int = 2) -> bytes:
    return write_svg(scene, precision=precision, title="t", comment="cubicsplat test").encode()


def two_squares(background: tuple[float, float, float] | None) -> Scene:
    """A red opaque square in front of a half transparent blue one; edges on pixel edges."""
    return Scene(
        mode=Mode.CLOSED,
        width=12,
        height=8,
        points=torch.stack([rectangle(2, 2, 5, 5), rectangle(4, 2, 8, 6)]),
        colours=torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        opacities=torch.tensor([1.0, 0.5]),
        half_widths=torch.zeros(2),
        background=background,
    )


def picture(rgb: np.ndarray, alpha: np.ndarray | None = None) -> Picture:
    return Picture(rgb=rgb.astype(np.float32), alpha=alpha, source="reference.png", sha256="0" * 64)


def noise(height: int, width: int, channels: int = 3, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, channels), dtype=np.uint8)


WITHOUT_LIBCAIRO = """raise OSError('no library called "cairo-2" was found\\nand more lines')"""


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
@pytest.mark.parametrize(("mode", "background"), rest_slow((Mode.OPEN, PAPER), *product(Mode, (None, PAPER))))
def test_file_shows_the_same_picture_as_the_reference_renderer(mode, background, renderer):
    scene = random_scene(mode, curves=10, width=64, height=48, background=background, seed=3)
    file = rerender(svg_of(scene), 64, 48, renderer=renderer)
    own = reference.render(quantise_scene(scene, 2).as_torch(), RasterSettings("exact", samples=16))
    pixels = file.pixels.astype(np.float64) / 255
    if background is None:
        pixels[..., :3] *= pixels[..., 3:]
    error = own.numpy() - pixels[..., : own.shape[2]]
    assert own.std() > 0.05, "an empty picture would agree with anything"
    # The renderers' anti-aliasing is coarser than ours, resvg's most (about 39 dB on this crowd of strokes).
    assert -10 * math.log10((error**2).mean()) > 37
    assert np.abs(error).max() < 0.2


@pytest.mark.parametrize("background", [None, PAPER])
def test_pixels_come_from_cairo_as_its_own_png_would_have_them(background):
    cairosvg = importlib.import_module("cairosvg")
    scene = random_scene(Mode.CLOSED, curves=30, width=90, height=70, background=background, opacity=(0.1, 1.0), seed=3)
    png = cairosvg.svg2png(bytestring=svg_of(scene), output_width=180, output_height=140)
    drawn = rerender(svg_of(scene), 180, 140, renderer="cairosvg").pixels
    assert np.array_equal(drawn, np.asarray(Image.open(BytesIO(png)).convert("RGBA")))


def test_the_two_renderers_agree():
    svg = svg_of(random_scene(Mode.CLOSED, curves=30, width=80, height=60, background=PAPER))
    first, second = (rerender(svg, 80, 60, renderer=name).pixels.astype(float) for name in ("cairosvg", "resvg"))
    assert first.std() > 10
    assert np.abs(first - second).mean() < 1.5


def test_missing_libcairo_falls_back_and_says_so(package):
    package("cairosvg", WITHOUT_LIBCAIRO)
    rendered = rerender(svg_of(two_squares(None)), 12, 8)
    assert rendered.renderer.startswith("resvg_py ")
    assert "libcairo" in rendered.note
    assert RENDERER.install_hint() in rendered.note
    assert "\n" not in rendered.note
    states = available_renderers()
    version, problem = states["cairosvg"]
    assert version is None
    assert "libcairo" in problem
    assert states["resvg"][0]


@pytest.mark.parametrize(
    ("system", "hint"),
    [("linux", "apt-get install libcairo2"), ("darwin", "brew install cairo"), ("win32", "GTK")],
)
def test_hint_suits_the_system(monkeypatch, system, hint):
    monkeypatch.setattr(RENDERER.sys, "platform", system)
    assert hint in RENDERER.install_hint()


def test_a_renderer_asked_for_by_name_is_never_replaced(package):
    package("cairosvg", WITHOUT_LIBCAIRO)
    with pytest.raises(EngineError, match="libcairo"):
        rerender(svg_of(two_squares(None)), 12, 8, renderer="cairosvg")
    with pytest.raises(UsageError, match="inkscape"):
        rerender(svg_of(two_squares(None)), 12, 8, renderer="inkscape")


def test_no_renderer_at_all_is_an_error_with_both_reasons(package):
    package("cairosvg", WITHOUT_LIBCAIRO)
    package("resvg_py", 'raise ImportError("no resvg here")')
    with pytest.raises(EngineError, match=r"libcairo.*pip install resvg_py"):
        rerender(svg_of(two_squares(None)), 12, 8)


def test_a_command_keeps_what_comes_of_parsing_cairos_header(tmp_path, monkeypatch):
    """A damaged file in the cache costs no more than the time to parse it again."""
    code = """import sys, hashlib
from cubicsplat_cli.progress import COMMAND_BEGAN
COMMAND_BEGAN.set(0.0)
from cubicsplat_cli.evaluate.rerender import rerender
svg = b'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><circle r="5" fill="#f40"/></svg>'
drawn = rerender(svg, 9, 9, renderer="cairosvg").pixels
print("pycparser" in sys.modules, hashlib.sha256(drawn.tobytes()).hexdigest())"""
    for name in ("XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.setenv(name, str(tmp_path))
    said = []
    for damaged in (False, False, True):
        for path in tmp_path.rglob("*.bin") if damaged else ():
            path.write_bytes(path.read_bytes()[:-1])
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
        said.append(done.stdout.split())
    assert [parsed for parsed, _ in said] == ["True", "False", "True"]
    assert len({pixels for _, pixels in said}) == 1


@pytest.mark.parametrize(("width", "height"), [(0, 5), (5, -1), (40_000, 5), (30_000, 30_000)])
def test_impossible_sizes_are_refused(width, height):
    with pytest.raises(InputError, match="cannot be drawn"):
        rerender(svg_of(two_squares(None)), width, height)


# --- measures ----------------------------------------------------------------------------------------------


def test_psnr_of_a_known_error():
    reference_picture = picture(np.full((16, 16, 3), 100 / 255))
    candidate = np.full((16, 16, 3), 110, np.uint8)
    quality = compare(reference_picture, of_pixels(candidate))
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
    quality = compare(picture(first / 255), of_pixels(second))
    assert quality.ssim == pytest.approx(np.mean(values), abs=1e-5)
    assert abs(quality.ssim) < 0.5


def alike(height: int, width: int, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """A picture and what could have been made of it: (H, W, 3) float32 in [0, 1], (H, W, 4) uint8 opaque."""
    random = np.random.default_rng(7)
    y, x = np.mgrid[:height, :width]
    smooth = 0.5 + 0.4 * np.sin(x / 19) * np.cos(y / 23)
    first = {
        "photo": np.clip(smooth + 0.1 * random.standard_normal((height, width)), 0, 1),
        "smooth": smooth,
        # Hardly any variance: what is lost to rounding shows most here.
        "bright": np.full((height, width), 0.98) + 0.004 * random.random((height, width)),
        "flat": np.full((height, width), 0.6),
    }[kind]
    rgb = np.stack([first, first**2, 1 - first], axis=2).astype(np.float32)
    second = np.rint(255 * np.clip(rgb + 0.02 * random.standard_normal((height, width, 1)), 0, 1))
    return rgb, np.dstack([second, np.full((height, width), 255)]).astype(np.uint8)


@pytest.mark.parametrize("kind", ["photo", "smooth", "bright", "flat"])
@pytest.mark.parametrize(("height", "width"), [(11, 11), (75, 300), (132, 523), (200, 261)])
def test_ssim_part_by_part_is_that_of_the_whole_picture(height, width, kind):
    """Sizes about those of tiles and strips, which are small here: their seams must not show."""
    from skimage.metrics import structural_similarity

    rgb, drawn = alike(height, width, kind)
    values = drawn[..., :3].astype(np.float64) / 255
    want = structural_similarity(
        rgb.astype(np.float64),
        values,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=2,
    )
    (found,), _ = measure(picture(rgb), [of_pixels(drawn)], strip_pixels=40_000)
    assert found.ssim == pytest.approx(want, abs=1e-6)
    assert found.psnr_db == pytest.approx(-10 * math.log10(((rgb - values) ** 2).mean()), abs=1e-5)


def test_figures_are_the_same_for_any_number_of_threads():
    rgb, drawn = alike(200, 700, "photo")
    layers = [of_pixels(drawn), of_values(np.roll(rgb, 1, axis=0))]
    one = measure(picture(rgb), layers, threads=1)
    assert all(measure(picture(rgb), layers, threads=n) == one for n in (2, 3))
    qualities, agreement = one
    assert qualities == [compare(picture(rgb), layer) for layer in layers]
    assert agreement == agreement_db(np.roll(rgb, 1, axis=0), drawn)


@pytest.mark.parametrize("background", [PAPER, None])
def test_the_engines_picture_in_strips_is_the_whole_one(background):
    from cubicsplat_cli.raster.engines import render_scene

    scene = random_scene(Mode.CLOSED, curves=40, width=90, height=400, background=background, seed=5)
    whole, candidate = render_scene(scene, samples=48, threads=1), of_scene(scene, 90, 400, 48, threads=1)
    for top, bottom in ((0, 400), (0, 69), (59, 133), (379, 400)):
        assert np.abs(candidate.rows(top, bottom) - whole[top:bottom]).max() < 2e-5
    reference_picture = picture(np.random.default_rng(1).random((400, 90, 3)))
    (found,), agreement = measure(reference_picture, [candidate], strip_pixels=64 * 90)
    want = compare(reference_picture, of_values(whole))
    assert agreement is None
    assert (found.psnr_db, found.ssim) == (pytest.approx(want.psnr_db, abs=1e-5), pytest.approx(want.ssim, abs=1e-6))
    assert psnr_db(reference_picture, candidate) == measure(reference_picture, [candidate])[0][0].psnr_db


@pytest.mark.slow
def test_twelve_megapixels_are_measured_in_little_memory():
    """Of the process's own peak: what is drawn and compared lies in memory of numpy and of the engine."""
    code = (
        "import numpy as np, resource\n"
        "from cubicsplat_cli.evaluate.images import of_pixels\n"
        "from cubicsplat_cli.evaluate.metrics import measure\n"
        "from cubicsplat_cli.files.load import Picture\n"
        "picture = Picture(np.zeros((3000, 4000, 3), np.float32), None, 'p', '0')\n"
        "drawn = np.full((3000, 4000, 4), 9, np.uint8)\n"
        "picture.rgb[:] = 0.5\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "measure(picture, [of_pixels(drawn)], threads=2)\n"
        "print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)\n"
    )
    pytest.importorskip("resource")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert int(done.stdout) < 150


def test_identical_pictures_have_no_psnr():
    pixels = noise(20, 15)
    quality = compare(picture(pixels / 255), of_pixels(pixels))
    assert quality == Quality(None, 1.0, True)
    assert "Infinity" not in to_json(quality)
    opaque = np.dstack([pixels, np.full((20, 15), 255, np.uint8)])
    assert compare(picture(pixels / 255), of_pixels(opaque)).identical
    assert compare(picture(pixels / 255), of_values(pixels / 255)).identical


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 30), (10, 40), (40, 10)])
def test_small_pictures_have_no_ssim_but_a_reason(height, width):
    quality = compare(picture(np.zeros((height, width, 3))), of_pixels(np.full((height, width, 3), 9, np.uint8)))
    assert quality.ssim is None
    assert "11" in quality.ssim_note
    assert quality.psnr_db > 20
    assert plain(quality)["ssim"] is None


def test_transparency_reports_the_worse_of_black_and_white():
    black = picture(np.zeros((16, 16, 3)), np.full((16, 16), 0.5, np.float32))
    # Half transparent black: over black nothing differs from an opaque black candidate, over white much does.
    opaque_black = np.dstack([np.zeros((16, 16, 3), np.uint8), np.full((16, 16), 255, np.uint8)])
    quality = compare(black, of_pixels(opaque_black))
    assert not quality.identical
    assert quality.psnr_db == pytest.approx(-20 * math.log10(0.5), abs=1e-3)
    # And a candidate that is transparent where the reference is opaque is judged over both as well.
    white = picture(np.ones((16, 16, 3)))
    clear = compare(white, of_pixels(np.zeros((16, 16, 4), np.uint8)))
    assert clear.psnr_db == pytest.approx(0.0, abs=1e-6)


def test_hidden_colours_of_transparent_pixels_do_not_count():
    alpha = np.zeros((16, 16), np.float32)
    alpha[:8] = 1
    rgb = noise(16, 16) / 255 * alpha[..., None]
    candidate = np.dstack([np.rint(rgb * 255), alpha * 255]).astype(np.uint8)
    candidate[8:, :, :3] = 77
    assert compare(picture(rgb, alpha), of_pixels(candidate)).identical
    premultiplied = np.dstack([rgb, alpha]).astype(np.float32)
    assert compare(picture(rgb, alpha), of_values(premultiplied)).identical


def test_sizes_and_shapes_must_fit():
    with pytest.raises(InputError, match=r"20 x 10 px.*10 x 20 px"):
        compare(picture(np.zeros((10, 20, 3))), of_pixels(np.zeros((20, 10, 3), np.uint8)))
    with pytest.raises(InputError, match="uint8"):
        compare(picture(np.zeros((10, 20, 3))), of_pixels(np.zeros((10, 20, 3))))
    with pytest.raises(InputError, match="finite"):
        compare(picture(np.zeros((10, 20, 3))), of_values(np.full((10, 20, 3), np.nan)))


# --- report ------------------------------------------------------------------------------------------------


def test_json_never_holds_what_is_not_json():
    text = to_json({"a": float("inf"), "b": [float("nan"), 1.5, np.float64(2.5)], "c": {"d": -float("inf")}, "e": (1,)})
    assert json.loads(text, parse_constant=pytest.fail) == {
        "a": None,
        "b": [None, 1.5, 2.5],
        "c": {"d": None},
        "e": [1],
    }
    assert text.endswith("\n")


def test_gap_is_own_minus_file():
    assert gap_db(Quality(30.0, 0.9, False), Quality(30.5, 0.9, False)) == pytest.approx(0.5)
    assert gap_db(Quality(None, 1.0, True), Quality(30.5, 0.9, False)) is None
    assert gap_db(Quality(30.5, 0.9, False), Quality(None, 1.0, True)) is None


# --- agreement of two renderers ----------------------------------------------------------------------------


def test_agreement_is_the_psnr_between_the_two_pictures_and_not_a_difference_of_figures():
    own = np.full((8, 8, 3), 0.5, np.float32)
    own[::2] += 0.1
    drawn = np.full((8, 8, 4), 255, np.uint8)
    drawn[..., :3] = round(0.5 * 255)
    drawn[1::2, :, :3] = round(0.6 * 255)
    # Both are equally far from any picture that is symmetric to them, and yet they do not agree at all.
    assert agreement_db(own, drawn) == pytest.approx(20.0, abs=0.1)
    same = np.rint(own * 255) / 255
    opaque = np.dstack([np.rint(own * 255), np.full((8, 8), 255)]).astype(np.uint8)
    assert agreement_db(same, opaque) is None


def test_agreement_with_transparency_is_the_worse_over_black_and_white():
    # Half transparent black against opaque black: alike over black, half apart over white.
    own = np.zeros((4, 4, 4), np.float32)
    own[..., 3] = 0.5
    opaque = np.zeros((4, 4, 4), np.uint8)
    opaque[..., 3] = 255
    assert agreement_db(own, opaque) == pytest.approx(-20 * math.log10(0.5), abs=1e-6)
    # Half transparent white against opaque white: alike over white, half apart over black.
    own[..., :3] = 0.5
    assert agreement_db(own, np.full((4, 4, 4), 255, np.uint8)) == pytest.approx(-20 * math.log10(0.5), abs=1e-6)


def test_agreement_of_engine_and_file_on_a_crowd_of_curves():
    from cubicsplat_cli.raster.engines import render_scene

    scene = random_scene(Mode.CLOSED, curves=20, width=64, height=48, background=PAPER, opacity=(0.3, 1.0), seed=5)
    drawn = rerender(svg_of(scene), 64, 48).pixels
    assert agreement_db(render_scene(scene, threads=1), drawn) > 40
    assert agreement_db(render_scene(random_scene(Mode.CLOSED, width=64, height=48, background=PAPER)), drawn) < 30


def test_agreement_needs_pictures_of_one_size_and_finite_values():
    drawn = np.zeros((4, 4, 4), np.uint8)
    with pytest.raises(InputError, match="sizes"):
        agreement_db(np.zeros((4, 5, 3)), drawn)
    with pytest.raises(InputError, match="finite"):
        agreement_db(np.full((4, 4, 3), np.inf), drawn)
    with pytest.raises(InputError, match="uint8"):
        agreement_db(np.zeros((4, 4, 3)), drawn.astype(np.float32))
    with pytest.raises(InputError, match="3 or 4"):
        agreement_db(np.zeros((4, 4)), drawn)
