"""Level and upright lines of one px: the frames and dividers of screenshots."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.artwork.degradations import degraded
from benchmarks.artwork.document import Document
from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.artwork.regions.fills import picture_fills
from cubicsplat_cli.artwork.regions.pixel_lines import with_pixel_lines
from cubicsplat_cli.artwork.regions.regions import FlatPicture, find_regions, pixel_fills
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.files.load import as_picture

WHITE, BLACK = (255, 255, 255, 255), (0, 0, 0, 255)


def page(grey: int, inside: str = "#fff") -> np.ndarray:
    """A frame of 1 px with round corners, a divider, and black marks whose edges have every grey."""
    line = f"rgb({grey},{grey},{grey})"
    body = (
        f'<rect width="120" height="80" fill="#fff"/><path d="M10 62.5H110" stroke="{line}"/>'
        f'<rect x="10.5" y="10.5" width="90" height="40" rx="6" fill="{inside}" stroke="{line}"/>'
        '<circle cx="30.3" cy="30.6" r="8.2"/><circle cx="55.6" cy="30.2" r="8.5"/><path d="M72 22l14 3-5 15z"/>'
    )
    text = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 120 80">{body}</svg>'
    return degraded(Document(text.encode(), "x", 120), "clean")


def fills_of_regions(pixels: np.ndarray) -> set[tuple[int, ...]]:
    levels = as_levels(as_picture(pixels).target())
    regions = find_regions(FlatPicture(levels, picture_fills(levels)))
    return {tuple(int(v) for v in fill) for fill in np.rint(regions.fills)}


@pytest.mark.parametrize("grey", [170, 221, 238])
def test_rules_have_their_own_fill_beside_a_darker_one(grey):
    assert fills_of_regions(page(grey)) == {WHITE, BLACK, (grey, grey, grey, 255)}


def test_a_frame_between_two_grounds_has_its_own_fill():
    assert (221, 221, 221, 255) in fills_of_regions(page(221, "#f0f2f6"))


def test_a_frame_keeps_its_fill_beside_letters_that_a_darker_one_explains_too():
    levels = np.full((40, 90, 4), 255.0, np.float32)
    levels[8:32, 8:82, :3] = 120.0
    levels[9:31, 9:81, :3] = 204.0
    levels[2:6, 2:20, :3] = 32.0
    slopes = np.abs(np.arange(9, 81) - 20.0 - 9.0 * (np.arange(9, 31)[:, None] % 3)) % 12.0
    levels[11:29, 9:81, :3] -= 172.0 * np.clip(1.2 - slopes, 0.0, 0.85)[2:-2, :, None]
    palette = np.array([(255, 255, 255, 255), (204, 204, 204, 255), (32, 32, 32, 255), (120, 120, 120, 255)], float)
    fills = pixel_fills(FlatPicture(levels, palette)).fills
    assert (fills[8, 10:80] == 3).all() and (fills[31, 10:80] == 3).all()


def test_a_frame_is_drawn_in_one_piece():
    drawn = [shape for shape in draw(as_picture(page(170)).target()).shapes if shape.fill == (170, 170, 170, 255)]
    assert len(drawn) == 2
    assert sorted(len(shape.outlines) for shape in drawn) == [1, 2]


def test_edges_within_a_row_of_pixels_are_no_rules():
    levels = np.full((40, 60, 4), 255.0, dtype=np.float32)
    levels[20:, :, :3] = (20, 90, 160)
    levels[20, :, :3] = (150, 183, 214)  # what the edge between two fills leaves
    levels[5:7, :, :3] = 128  # a line that two rows share
    palette = np.array([WHITE, (20, 90, 160, 255), BLACK], dtype=float)
    pure = np.full((40, 60), -1, dtype=np.int32)
    fills, found, _ = with_pixel_lines(levels, palette, pure, None)
    assert len(fills) == 3 and (found == -1).all()
    levels[6, :, :3] = 255
    fills, found, _ = with_pixel_lines(levels, palette, pure, None)
    assert fills[3:].tolist() == [[128, 128, 128, 255]] and (found[5, :59] == 3).all() and (found[6] == -1).all()
    assert len(with_pixel_lines(levels, palette, pure, 3)[0]) == 3


@pytest.mark.parametrize(("white", "rules"), [(12, 1), (60, 0)])
def test_a_line_between_two_grounds_is_a_rule_but_where_what_is_beneath_may_shine_through(white, rules):
    """White letters above the line lie beneath none of it, a white strip as long as it may lie beneath all of it."""
    palette = np.array([(59, 59, 59, 255), (46, 46, 46, 255), WHITE], dtype=float)
    pure = np.repeat([0, -1, 1], [20, 1, 19])[:, None].repeat(60, axis=1)
    pure[4:9, :white] = 2
    levels = palette[pure].astype(np.float32)
    levels[20, :, :3] = 91
    fills, found, _ = with_pixel_lines(levels, palette, pure.astype(np.int32), None)
    assert len(fills) == 3 + rules and (found[20, 1:59] == (3 if rules else -1)).all()


def test_a_round_frame_between_two_grounds_is_a_rule_though_a_strip_as_long_might_shine_through():
    body = (
        '<rect width="200" height="150" fill="#fff"/><rect width="200" height="20" fill="#333"/>'
        '<rect x="10.5" y="40.5" width="150" height="80" rx="8" fill="#f4f4f4" stroke="#d0d0d0"/>'
    )
    text = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 200 150">{body}</svg>'
    levels = as_levels(as_picture(degraded(Document(text.encode(), "x", 200), "clean")).target())
    assert find_regions(FlatPicture(levels, picture_fills(levels))).count == 4


def test_the_soft_edge_of_a_line_of_one_px_is_no_rule():
    palette = np.array([(177, 12, 12, 255), (49, 16, 3, 255), (255, 217, 0, 255)], dtype=float)
    pure = np.repeat([0, 1, -1, 2], [19, 1, 1, 19])[:, None].repeat(60, axis=1)
    levels = palette[pure].astype(np.float32)
    levels[20, :, :3] = (127, 108, 0)
    assert len(with_pixel_lines(levels, palette, pure.astype(np.int32), None)[0]) == 3
