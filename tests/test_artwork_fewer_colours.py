"""Pictures in fewer colours, or in those of a palette: which are merged, and that regions of one are one shape."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.artwork.document import Document
from cubicsplat_cli.artwork.regions.fewer import MOST_COMPARED, fewer_colours, nearest_colours, nearest_in
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.load import as_picture

SKY, SEA, SAND, FILL = (90, 160, 230), (70, 140, 215), (240, 220, 150), (20, 20, 25)


def shore(clear: bool = False) -> np.ndarray:
    """(96, 96, 3 or 4) in [0, 1]: two blues and sand with a black line of 2 px between them, and a black disc."""
    y, x = np.mgrid[:96, :96] + 0.5
    picture = np.empty((96, 96, 3))
    picture[:40], picture[40:70], picture[70:] = SKY, SEA, SAND
    picture[69:71] = FILL
    picture[np.hypot(x - 30, y - 20) < 6] = FILL
    if not clear:
        return (picture / 255.0).astype(np.float32)
    opacity = (np.abs(x - 48) < 40).astype(float)[..., None]
    return np.concatenate([picture / 255.0 * opacity, opacity], axis=2).astype(np.float32)


@pytest.mark.parametrize("clear", [False, True])
def test_like_fills_are_merged_before_thin_black_lines(clear):
    drawing = draw(shore(clear), ArtworkSettings(colors=3))
    fills = {fill[:3] for fill in drawing.fills}
    assert len(drawing.fills) == 3 and (*FILL,) in fills and SAND in fills and fills & {SKY, SEA}


def test_neighbours_that_get_one_colour_are_one_shape():
    free, merged = draw(shore()), draw(shore(), ArtworkSettings(colors=3))
    chosen = draw(shore(), ArtworkSettings(palette=((0, 0, 255), (255, 255, 0), (0, 0, 0))))
    assert {fill[:3] for fill in chosen.fills} == {(0, 0, 255), (255, 255, 0), (0, 0, 0)}
    assert len(merged.shapes) == len(chosen.shapes) < len(free.shapes)


def test_what_is_clear_is_no_colour_and_stays_clear():
    colours = np.array([[0.0, 0, 0, 0], [250, 0, 0, 255], [240, 0, 0, 255], [0, 0, 250, 255]])
    kept, owner = fewer_colours(colours, np.array([900, 10, 20, 5]), 2)
    assert kept[owner].tolist() == [colours[0].tolist(), colours[2].tolist(), colours[2].tolist(), colours[3].tolist()]
    assert fewer_colours(colours[:1], np.array([5]), 1)[0].tolist() == [[0, 0, 0, 0]]


def test_near_colours_are_merged_without_a_number():
    colours = np.array([[100.0, 100, 100, 255], [101, 100, 100, 255], [130, 100, 100, 255]])
    assert len(np.unique(fewer_colours(colours, np.ones(3), None, apart=2.0)[1])) == 2
    assert len(np.unique(fewer_colours(colours, np.ones(3), None)[1])) == 3
    assert len(np.unique(fewer_colours(colours, np.ones(3), None, free=1e4)[1])) == 1


def test_very_many_colours_are_merged_in_bounded_work():
    colours = np.concatenate(
        [np.random.default_rng(0).integers(0, 256, (20_000, 3)), np.full((20_000, 1), 255)], axis=1
    )
    kept, owner = fewer_colours(colours.astype(float), np.ones(len(colours)), 16)
    assert len(kept) == 16 < MOST_COMPARED
    assert np.abs(kept[owner] - colours).max(axis=1).mean() < 70.0


def test_a_palette_keeps_opacities():
    kept, owner = nearest_colours(np.array([[100.0, 0, 0, 128], [0, 0, 200, 255]]), ((255, 0, 0), (0, 0, 255)))
    assert kept[owner].round().tolist() == [[128, 0, 0, 128], [0, 0, 255, 255]]
    assert nearest_in(((255, 0, 0), (0, 0, 255)), (90, 80, 200, 77)) == (0, 0, 255, 77)


def test_colours_far_from_a_palette_stay_with_a_tolerance():
    # Nearly the palette's red, in two opacities; another red; and its blue.
    colours = np.array([[250.0, 4, 8, 255], [125, 2, 4, 128], [180, 0, 40, 255], [0, 0, 255, 255]])
    palette = ((255, 0, 0), (0, 0, 255))
    kept, owner = nearest_colours(colours, palette, 3.0)
    assert kept[owner].round().tolist() == [[255, 0, 0, 255], [128, 0, 0, 128], [180, 0, 40, 255], [0, 0, 255, 255]]
    assert len(nearest_colours(colours, palette, 40.0)[0]) == 3
    assert nearest_in(palette, (180, 0, 40, 255), 3.0) == (180, 0, 40, 255)


def test_a_drawing_takes_colours_of_a_palette_that_are_near():
    text = (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 64 64"><path d="M0 0H64V64H0z" fill="#fdfdff"/>'
        '<circle cx="20" cy="30" r="14" fill="#fa0408"/><path d="M40 8h16v40h-16z" fill="#145078"/></svg>'
    )
    target = as_picture(Document(text.encode(), "x", 64).draw()).target()
    drawing = draw(target, ArtworkSettings(palette=((255, 0, 0), (255, 255, 255)), palette_tolerance=3.0))
    assert {shape.fill[:3] for shape in drawing.shapes} == {(255, 0, 0), (255, 255, 255), (20, 80, 120)}
    with pytest.raises(UsageError, match="--palette"):
        ArtworkSettings(palette_tolerance=3.0)
