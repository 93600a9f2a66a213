"""`benchmarks.clips`: the flow, the scores of known clips, and the command."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from benchmarks.clips import Filmed, Played, flow, moved, scores


@pytest.fixture(scope="module")
def noise() -> np.ndarray:
    return np.random.default_rng(0).random((24, 32, 3)).astype(np.float32)


def test_the_flow_finds_where_blocks_came_from(noise):
    shift = np.broadcast_to([2, -3], (24, 32, 2))
    found = flow(noise, moved(noise, shift))
    assert (found == shift).all()
    assert not flow(noise, noise).any()


def test_a_perfect_copy_of_a_moving_clip_has_no_flicker_and_a_shaking_one_has(noise):
    pictures = np.stack([noise, noise, moved(noise, np.broadcast_to([0, 2], (24, 32, 2)))])
    film = Filmed(pictures, np.arange(3.0), np.arange(1.0, 4.0))
    same = scores(film, Played(pictures, 3000, 600), 1.5)
    assert same["psnr_db"] == pytest.approx(100.0)
    assert same["still"] == pytest.approx(0.0)
    assert same["warp"] == pytest.approx(0.0)
    assert (same["bytes_s"], same["gzip_s"], same["frame_s"]) == (1000.0, 200.0, 0.5)
    shaken = pictures.copy()
    shaken[1] += 0.1
    assert scores(film, Played(shaken, 1, 1), 1.0)["still"] == pytest.approx(25.5, rel=1e-3)


def test_each_clip_has_a_row_for_each_tool(tmp_path, run_benchmark):
    frames = [Image.fromarray(np.full((16, 16, 3), 40 * index, np.uint8)) for index in range(3)]
    frames[0].save(tmp_path / "grey.gif", save_all=True, append_images=frames[1:], duration=100)
    done = run_benchmark("clips", tmp_path, "--tools", "moving,each", "--curves", 2, "--json")
    rows = json.loads(done.stdout)["rows"]
    assert [row["tool"] for row in rows] == ["moving", "each frame"]
    assert all(row["psnr_db"] > 25.0 for row in rows)
