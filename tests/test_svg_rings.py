"""Curves of different length and of several rings in SVG files: subpaths, round trip, holes in other renderers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import MODES, PAPER, circle, ragged_scene, rectangle, reverse_ring, scene_of

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.scene import Scene, pack_rings
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.scene_reader import quantise_scene, read_svg
from cubicsplat_cli.svg.scene_writer import write_svg


def written(scene: Scene, precision: int = 2) -> str:
    return write_svg(scene, precision=precision, title="", comment="")


def same(first: Scene, second: Scene) -> bool:
    tables = (first.ring_ends, second.ring_ends)
    equal_tables = tables[0] is tables[1] is None or np.array_equal(*tables)
    names = ("points", "colours", "opacities", "half_widths")
    return equal_tables and all(np.array_equal(getattr(first, n), getattr(second, n)) for n in names)


@pytest.mark.parametrize("mode", MODES)
@settings(derandomize=True)
@given(seed=st.integers(0, 2**20), curves=st.integers(1, 7), precision=st.integers(0, 6))
def test_what_a_file_gives_back_is_written_as_it_is(mode, seed, curves, precision):
    scene = ragged_scene(mode, curves, 60, 40, seed, background=PAPER)
    quantised = quantise_scene(scene, precision)
    rings = [sorted(len(ring) for ring in scene.rings(curve)) for curve in range(curves)]
    assert [sorted(len(ring) for ring in quantised.rings(curve)) for curve in range(curves)] == rings
    for name, steps in (("colours", 255), ("opacities", 1000)):
        asked = np.rint(getattr(scene, name).double().numpy() * steps) / steps
        assert np.array_equal(getattr(quantised, name), asked.astype(np.float32))
    assert same(quantise_scene(quantised, precision), quantised)


def ring_and_hole(scale: float = 1.0) -> Scene:
    points, ring_ends = pack_rings(
        Mode.CLOSED,
        [
            [rectangle(2, 2, 38, 28) * scale, reverse_ring(circle(20, 15, 9)) * scale],
            [circle(10, 20, 8, 3) * scale],
        ],
    )
    scene = scene_of(Mode.CLOSED, [rectangle(0, 0, 1, 1)] * 2, 40, 30, background=PAPER)
    return replace(scene, points=points, ring_ends=ring_ends)


def test_a_curve_is_one_path_with_a_subpath_for_each_ring():
    text = written(ring_and_hole())
    paths = [line for line in text.splitlines() if line.startswith("<path")]
    assert [line.count("M") for line in paths] == [1, 2]  # back to front
    assert [line.count("z") for line in paths] == [1, 2]


def test_a_table_that_says_nothing_is_not_kept():
    scene = scene_of(Mode.CLOSED, [circle(10, 10, 5), circle(20, 10, 5)], 40, 30, background=PAPER)
    wide = replace(
        scene,
        points=torch.cat((scene.points, torch.zeros(2, 3, 2)), dim=1),
        ring_ends=torch.full((2, 2), 4, dtype=torch.int32),
    )
    assert written(wide) == written(scene)
    assert quantise_scene(wide, 2).ring_ends is None


@pytest.mark.parametrize("scale", [1, 3])
def test_other_renderers_see_the_hole_where_the_engine_sees_it(scale):
    scene = ring_and_hole().scaled(40 * scale, 30 * scale)
    drawn = rerender(written(scene).encode(), scene.width, scene.height).pixels[..., :3] / 255.0
    ours = render_scene(quantise_scene(scene, 2))
    assert float(np.abs(drawn - ours).max()) < 0.04
    hole = ours[15 * scale, 22 * scale]
    assert np.abs(hole - PAPER).max() < 0.6 / 255


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ("M1 1c1 0 2 1 2 2c0 1-1 2-2-2zm1 1l1 1c1 0 2 1 2 2c0 1-1 2-2-2z", "other than M, cubics and z"),
        ("M1 1c1 0 2 1 2 2c0 1-1 2-2-2M1 1c1 0 2 1 2 2c0 1-1 2-2-2z", "does not end with z"),
        ("M1 1c1 0 2 1 2 2c0 1-1 2-2-2zM1 1z", "does not begin with one point and a cubic"),
        ("M1 1c1 0 2 1 2 2c0 1-1 2-2-2z4", "a number after z"),
        ("c1 0 2 1 2 2z", "does not begin with M"),
        ("", "without data"),
    ],
)
def test_damaged_subpaths_are_refused(data, said):
    text = written(ring_and_hole())
    begin = text.index('d="M') + 3
    damaged = text[:begin] + data + text[text.index('"', begin) :]
    with pytest.raises(InputError, match=said):
        read_svg(damaged)


def test_strokes_have_one_subpath():
    text = written(ragged_scene(Mode.OPEN, 2, background=PAPER))
    with pytest.raises(InputError, match="several subpaths"):
        read_svg(text.replace('d="M', 'd="M1 1c1 1 1 1 1 1M', 1))
