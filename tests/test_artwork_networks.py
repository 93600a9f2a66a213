"""Shapes that straight lines of one pen cover: grids, frames, mazes."""

from __future__ import annotations

from io import BytesIO
from itertools import pairwise

import cairosvg
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from cubicsplat_cli.artwork.geometry.outlines import Ring, pieces_of_rings, polygon
from cubicsplat_cli.artwork.geometry.stroke import Stroke, outlines_of_stroke
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.artwork.strokes.network import network_of
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.raster.outlines import coverage

SIDE = 120


def ring(*points: tuple[float, float], hole: bool = False) -> Ring:
    """Clockwise as seen; a hole the other way."""
    return polygon(np.array(points[::-1] if hole else points, dtype=float))


def box(left: float, top: float, right: float, bottom: float, *, hole: bool = False) -> Ring:
    return ring((left, top), (right, top), (right, bottom), (left, bottom), hole=hole)


def covered(rings: list[Ring]) -> np.ndarray:
    return coverage(*pieces_of_rings(tuple(rings)), 0, 0, SIDE, SIDE)


def drawn(strokes: list[Stroke]) -> np.ndarray:
    """What strokes cover together."""
    left = np.ones((SIDE, SIDE))
    for stroke in strokes:
        outer, *holes = (outline.ring() for outline in outlines_of_stroke(stroke))
        left = left * (1.0 - covered([outer, *holes]))
    return 1.0 - left


def test_a_frame_is_one_closed_stroke() -> None:
    rings = [box(10, 10, 100, 80), box(12, 12, 98, 78, hole=True)]
    (stroke,) = network_of(tuple(rings))
    assert stroke.closed and stroke.width == pytest.approx(2.0)
    assert sorted(stroke.path.anchors.tolist()) == pytest.approx(np.array([[11, 11], [11, 79], [99, 11], [99, 79]]))


@given(
    st.lists(st.integers(1, 9), min_size=2, max_size=5, unique=True),
    st.lists(st.integers(1, 9), min_size=2, max_size=5, unique=True),
)
def test_a_grid_is_one_stroke_for_each_line_within_and_one_around(columns: list[int], rows: list[int]) -> None:
    x, y = (10.5 + 10.0 * np.sort(each) for each in (columns, rows))  # lines of a px fill their pixels
    rings = [box(x[0] - 0.5, y[0] - 0.5, x[-1] + 0.5, y[-1] + 0.5)]
    for a, b in pairwise(x):
        rings += [box(a + 0.5, c + 0.5, b - 0.5, d - 0.5, hole=True) for c, d in pairwise(y)]
    strokes = network_of(tuple(rings))
    assert len(strokes) == len(x) + len(y) - 3 and sum(stroke.closed for stroke in strokes) == 1
    assert all(stroke.width == pytest.approx(1.0) for stroke in strokes)
    assert drawn(strokes) == pytest.approx(covered(rings), abs=0.01)


def test_lines_that_meet_end_in_the_middle_of_the_other() -> None:
    """A T: the line below ends within the upper one."""
    rings = [ring((10, 20), (90, 20), (90, 22), (51, 22), (51, 90), (49, 90), (49, 22), (10, 22))]
    level, upright = sorted(network_of(tuple(rings)), key=lambda stroke: stroke.path.anchors[0, 0])
    assert level.path.anchors == pytest.approx(np.array([[10, 21], [90, 21]]), abs=0.3)
    assert sorted(upright.path.anchors[:, 1]) == pytest.approx([21.0, 90.0], abs=0.3)


def test_corners_are_joined_only_where_they_are_filled() -> None:
    full = ring((10, 10), (90, 10), (90, 90), (86, 90), (86, 14), (10, 14))
    cut = ring((10, 10), (88, 10), (88, 12), (90, 12), (90, 90), (86, 90), (86, 14), (10, 14))
    for rings, number in (([full], 1), ([cut], 2)):
        # Two sides more, so that there are enough lines.
        strokes = network_of((*rings, box(20, 40, 24, 90)))
        assert len(strokes) == number + 1
        assert np.abs(drawn(strokes) - covered([*rings, box(20, 40, 24, 90)])).sum() < 4.0


BAR, SQUARE = box(10, 10, 100, 14), box(10, 10, 100, 100)
TEE = ring((10, 10), (90, 10), (90, 40), (65, 40), (65, 90), (35, 90), (35, 40), (10, 40))
LETTER_F = ring((10, 10), (60, 10), (60, 22), (22, 22), (22, 40), (50, 40), (50, 52), (22, 52), (22, 90), (10, 90))


@pytest.mark.parametrize("ring", [BAR, SQUARE, TEE, LETTER_F])
def test_bars_squares_and_letters_are_no_lines(ring: Ring) -> None:
    assert network_of((ring,)) == []


MAZE = "M10 10H150V110H10ZM10 40H60V80M90 10V60H150M40 110V70M110 110V85H80"


def drawing_of(path: str, width: float, **chosen: bool) -> Drawing:
    svg = (
        '<svg xmlns="http://www.w3.org/2000/svg" width="160" height="120"><path d="M0 0H160V120H0z" fill="#fff"/>'
        f'<path d="{path}" stroke="#1a237e" stroke-width="{width}" fill="none"/></svg>'
    )
    png = np.array(Image.open(BytesIO(cairosvg.svg2png(bytestring=svg.encode()))).convert("RGB"))
    return draw(png.astype(np.float32) / 255.0, ArtworkSettings(**chosen))


@pytest.mark.parametrize("width", [2.0, 3.0])
def test_a_maze_is_drawn_in_strokes_of_its_pen(width: float) -> None:
    drawing = drawing_of(MAZE, width)
    strokes = [shape.stroke for shape in drawing.shapes if shape.stroke]
    assert len(strokes) >= 4 and len(drawing.shapes) == 1 + len(strokes)
    assert [stroke.width for stroke in strokes] == pytest.approx([width] * len(strokes), abs=0.15)
    assert sum(stroke.path.coordinates for stroke in strokes) <= 40
    bare = drawing_of(MAZE, width, strokes=False)
    assert not any(shape.stroke for shape in bare.shapes)
