"""Scale consistency: tiles cover a picture once, parts drawn equal the whole drawn, and the figures of known cases."""

from __future__ import annotations

import math
import mmap
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scenes import PAPER, ragged_scene, random_scene, rectangle, scene_of

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.evaluate import images
from cubicsplat_cli.evaluate.images import (
    Tile,
    downsampled_scene,
    downsampled_svg,
    draw_part,
    of_values,
    scaled_samples,
)
from cubicsplat_cli.evaluate.metrics import compare
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.scene import Scene, pack_rings
from cubicsplat_cli.scene.arrays import block_means
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.scene_reader import quantise_scene
from cubicsplat_cli.svg.scene_writer import write_svg

BOTH = pytest.mark.parametrize("renderer", ["cairosvg", "resvg"])
GROUNDS = pytest.mark.parametrize("background", [None, PAPER])


def svg_of(scene: Scene) -> bytes:
    return write_svg(scene, title="t", comment="cubicsplat test").encode()


def psnr(first: np.ndarray, second: np.ndarray) -> float:
    return -10 * math.log10(float(np.mean((first - second) ** 2)) + 1e-20)


def premultiplied(pixels: np.ndarray) -> np.ndarray:
    values = pixels / 255.0
    values[..., :3] *= values[..., 3:]
    return values


@given(
    width=st.integers(1, 90), height=st.integers(1, 90), scale=st.integers(1, 12), pixels=st.integers(1, 40_000),
    side=st.integers(12, 400),
)  # fmt: skip
def test_tiles_cover_every_pixel_once_and_stay_small(width, height, scale, pixels, side):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(images, "MAX_TILE_SIDE", side)
        found = list(images.tiles(width, height, scale, pixels))
    count = np.zeros((height, width), int)
    for tile in found:
        count[tile.rows, tile.columns] += 1
        assert tile.width * scale <= side
        assert tile.height * scale <= side
        least = tile.width * scale * scale  # one row of a tile
        assert tile.width * tile.height * scale * scale <= max(pixels, least)
    assert (count == 1).all()


def test_24k_pixels_in_tiles_of_bounded_size():
    found = list(images.tiles(2040, 1344, 12, images.TILE_PIXELS))
    assert sum(tile.width * tile.height for tile in found) == 2040 * 1344
    assert max(tile.width * tile.height * 144 for tile in found) <= images.TILE_PIXELS
    assert len(found) < 200, "each tile costs a pass over the whole file"


def test_block_means_are_exact_means_of_blocks():
    values = np.random.default_rng(1).integers(0, 256, (6, 12, 4), dtype=np.uint8)
    want = values.astype(np.float64).reshape(2, 3, 4, 3, 4).mean(axis=(1, 3))
    assert np.abs(block_means(values, 3) - want).max() < 1e-4
    assert np.abs(block_means(values.astype(np.float32), 3) - want).max() < 1e-4
    assert block_means(np.full((24, 24, 3), 255, np.uint8), 12).max() == 255


@BOTH
@GROUNDS
def test_tiles_of_a_file_together_are_the_whole_drawing(renderer, background):
    svg = svg_of(random_scene(Mode.OPEN, curves=8, width=50, height=34, background=background, seed=2))
    whole = premultiplied(rerender(svg, 150, 102, renderer=renderer).pixels.astype(np.float64))
    want = whole.reshape(34, 3, 50, 3, 4).mean(axis=(1, 3))
    got = downsampled_svg(svg, 50, 34, 3, renderer=renderer, tile_pixels=500)
    assert got.renderer.startswith({"cairosvg": "cairosvg ", "resvg": "resvg_py "}[renderer])
    assert want.std() > 0.05
    # Straight and premultiplied 8-bit pixels round differently; nothing else may differ with cairo. resvg's outlines
    # depend a little on where the canvas begins.
    assert np.abs(got.pixels - want).max() < (1.5 / 255 if renderer == "cairosvg" else 0.05)
    assert psnr(got.pixels, want) > 45


@BOTH
def test_scale_one_is_the_native_drawing(renderer):
    svg = svg_of(random_scene(Mode.CLOSED, curves=6, width=40, height=30, background=PAPER))
    native = rerender(svg, 40, 30, renderer=renderer).pixels / 255.0
    # resvg clips shapes at the border of its canvas with a little less precision.
    assert np.abs(downsampled_svg(svg, 40, 30, 1, renderer=renderer).pixels - native).max() < 2.5 / 255


@pytest.mark.parametrize("mode", list(Mode))
@GROUNDS
def test_tiles_of_a_scene_together_are_the_whole_render(mode, background):
    scene = random_scene(mode, curves=8, width=50, height=34, background=background, seed=3)
    scene.points[0] -= 500.0  # the tiles without this curve are right only if it is never drawn
    large = replace(scene, width=150, height=102, points=scene.points * 3, half_widths=scene.half_widths * 3)
    whole = render_scene(large, samples=scaled_samples(24, 3), threads=1)
    want = whole.reshape(34, 3, 50, 3, -1).mean(axis=(1, 3))
    got = downsampled_scene(scene, 3, threads=1, tile_pixels=500)
    assert got.shape == want.shape
    assert np.abs(got - want).max() < 2e-3


@pytest.mark.parametrize("scale", [1, 2, 5])
def test_a_scene_of_whole_pixels_is_the_same_at_every_scale(scale):
    scene = scene_of(
        Mode.CLOSED, [rectangle(2, 3, 9, 8), rectangle(5, 1, 11, 6)], 13, 10, background=PAPER, opacity=0.5
    )
    native = render_scene(scene, threads=1)
    assert np.abs(downsampled_scene(scene, scale, threads=1) - native).max() < 1e-3
    file = downsampled_svg(svg_of(scene), 13, 10, scale).pixels[..., :3]
    assert np.abs(file - native).max() < 2 / 255


def test_conflation_of_a_shared_edge_shows_natively_and_fades_with_scale():
    """Two white halves that meet in the middle of a pixel column, on black: natively 1 - 1/4 of light is there."""
    halves = [rectangle(0, 0, 4.5, 8), rectangle(4.5, 0, 9, 8)]
    scene = scene_of(Mode.CLOSED, halves, 9, 8, background=(0.0, 0.0, 0.0), opacity=1.0)
    scene.colours[:] = 1.0
    levels = [float(downsampled_scene(scene, scale, threads=1)[4, 4, 0]) for scale in (1, 2, 4)]
    assert levels[0] == pytest.approx(0.75, abs=2e-3)
    # At an even scale the edge lies between two pixels of the large picture.
    assert levels[1:] == pytest.approx([1.0, 1.0], abs=2e-3)


def test_engine_and_file_agree_at_scale():
    scene = quantise_scene(random_scene(Mode.CLOSED, curves=12, width=48, height=36, background=PAPER, seed=4), 2)
    own = downsampled_scene(scene, 4, threads=1)
    file = downsampled_svg(svg_of(scene), 48, 36, 4).pixels[..., :3]
    assert own.std() > 0.05
    assert psnr(own, file) > 45
    # Against itself a render has lost next to nothing: what "scale consistent" means.
    native = Picture(render_scene(scene, threads=1), None, "x", "0")
    assert compare(native, of_values(own)).psnr_db > 38


@pytest.mark.parametrize("scale", [0, 13, -1, 2.5, True, None])
def test_senseless_scales_are_refused(scale):
    with pytest.raises(UsageError, match="scale"):
        downsampled_svg(b"", 5, 5, scale)
    with pytest.raises(UsageError, match="scale"):
        downsampled_scene(random_scene(Mode.CLOSED), scale)


def test_a_scene_of_ragged_rings_is_drawn_in_parts():
    scene = ragged_scene(Mode.CLOSED)
    whole = render_scene(scene, samples=48, threads=1)
    assert np.abs(downsampled_scene(scene, 1, samples=48, threads=1, tile_pixels=300) - whole).max() < 2e-5


def test_bad_scenes_and_files_are_refused():
    scene = random_scene(Mode.CLOSED)
    scene.points[1, 0, 0] = math.nan
    with pytest.raises(InputError, match="curve 1"):
        downsampled_scene(scene, 2)
    with pytest.raises(InputError, match=r"here\.svg"):
        downsampled_svg(b"<html/>", 5, 5, 2, source="here.svg")
    wrong = b'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><rect width="9" opacity="x"/></svg>'
    with pytest.raises(InputError, match=r"here\.svg: cairosvg cannot draw it \('x' is no number\)"):
        downsampled_svg(wrong, 9, 9, 2, source="here.svg", renderer="cairosvg")


def test_a_missing_libcairo_is_told(package):
    package("cairosvg", 'raise OSError("no library")')
    found = downsampled_svg(svg_of(random_scene(Mode.CLOSED)), 24, 20, 2)
    assert found.renderer.startswith("resvg_py ")
    assert "libcairo" in found.note


def test_samples_grow_with_the_root_of_the_scale():
    assert [scaled_samples(24, scale) for scale in (1, 4, 9)] == [24, 48, 64]
    # The error, D2 / (8 S^2), is then the same in pixels of the large picture, as far as 64 edges allow.
    assert 4 / scaled_samples(24, 4) ** 2 == pytest.approx(1 / 24**2)


PREFIXED = (
    '<?xml version="1.0"?><!DOCTYPE s:svg><!-- <svg> --><s:svg xmlns:s="http://www.w3.org/2000/svg" id="a>b"'
    " width='20' height='10'><s:rect width='10' height='10' fill='#f00'/></s:svg>\n"
)


PERCENT = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="20" height="10"><rect width="50%" height="100%" fill="red"/></svg>'
)
SHIFTED = (
    '\ufeff<svg xmlns="http://www.w3.org/2000/svg" viewBox="-5 0 20 10"><path d="M-5 0h10v10h-10z" fill="red"/></svg>'
)


@pytest.mark.parametrize("svg", [PERCENT, SHIFTED, PREFIXED])
@BOTH
def test_files_of_others_are_cropped_right(svg, renderer):
    """Left half red, right half nothing, whatever the root looks like."""
    got = downsampled_svg(svg.encode(), 20, 10, 2, renderer=renderer, tile_pixels=14**2).pixels
    want = np.zeros((10, 20, 4))
    want[:, :10] = (1, 0, 0, 1)
    assert np.abs(got - want).max() < 1e-6


def test_an_empty_root_and_other_encodings():
    empty = '<svg xmlns="http://www.w3.org/2000/svg" width="8" height="4"/>'
    assert (downsampled_svg(empty.encode(), 8, 4, 2, renderer="resvg").pixels == 0).all()
    latin = '<?xml version="1.0" encoding="latin-1"?><svg width="8" height="4"><title>é</title><rect %s/></svg>'
    latin %= 'width="8" height="4"'
    assert (downsampled_svg(latin.encode("latin-1"), 8, 4, 2, renderer="resvg").pixels[..., 3] == 1).all()


def test_a_tile_without_the_shape_of_many_rings_is_drawn():
    """What touches the tile has fewer segments than the other shape has rings."""
    square = np.repeat([[1, 1], [4, 1], [4, 4], [1, 4]], 3, axis=0).astype(np.float32)
    rings = [square + np.float32([9 * (k % 4), 30 + 9 * (k // 4)]) for k in range(9)]
    points, ring_ends = pack_rings(Mode.CLOSED, [[square], rings])
    flat = np.ones(2, np.float32)
    scene = Scene(Mode.CLOSED, 40, 60, points, np.zeros((2, 3), np.float32), flat, 0 * flat, PAPER, ring_ends)
    whole = draw_part(scene, 1, Tile(0, 0, 40, 60), 4, None)
    assert np.abs(draw_part(scene, 1, Tile(0, 0, 40, 9), 4, None) - whole[:9]).max() < 1e-6


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads Linux's own count of memory")
def test_one_long_ring_among_short_ones_costs_no_memory():
    """600 squares, and one shape of 20,000 corners: 290 MB of points if every row were as long as the longest."""
    square = np.repeat([[1, 1], [9, 1], [9, 9], [1, 9]], 3, axis=0).astype(np.float32)
    angles = np.linspace(0.0, 2.0 * np.pi, 60_000, endpoint=False)
    disc = (20.0 + 15.0 * np.stack([np.cos(angles), np.sin(angles)], axis=1)).astype(np.float32)
    before = resident_bytes()
    points, ring_ends = pack_rings(Mode.CLOSED, [[disc], *[[square]] * 600])
    flat = np.ones(601, np.float32)
    scene = Scene(Mode.CLOSED, 40, 40, points, np.zeros((601, 3), np.float32), flat, 0 * flat, PAPER, ring_ends)
    drawn = draw_part(scene.scaled(80, 80), 1, Tile(0, 0, 80, 80), 4, None)
    assert np.allclose(drawn[[8, 40], [8, 40]], 0.0, atol=0.01)
    assert np.allclose(drawn[70, 5], PAPER, atol=0.01)
    assert resident_bytes() - before < 100e6


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * mmap.PAGESIZE


def test_memory_is_that_of_a_tile(monkeypatch):
    """The engine is never asked for more than one tile, and gets only the curves that touch it."""
    seen: list[tuple[int, int]] = []
    from cubicsplat_cli.raster import engines

    original = engines.render_scene

    def spy(scene: Scene, **options):
        seen.append((scene.width * scene.height, scene.curves))
        return original(scene, **options)

    monkeypatch.setattr(engines, "render_scene", spy)
    dots = [rectangle(x, y, x + 2, y + 2) for x in (2, 30) for y in (2, 12, 22)]
    scene = scene_of(Mode.CLOSED, dots, 40, 26, background=PAPER)
    assert torch.isfinite(scene.points).all()
    downsampled_scene(scene, 4, threads=1, tile_pixels=2000)
    assert len(seen) > 5
    assert max(pixels for pixels, _ in seen) <= 2000
    assert max(curves for _, curves in seen) <= 3
