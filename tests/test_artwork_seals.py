"""No ground shows between opaque shapes: the finish moves hidden edges away from where others meet."""

import numpy as np
import pytest
from test_artwork_draw import BLUE, RED
from test_artwork_regular import regions_of

from cubicsplat_cli.artwork.finish import seals
from cubicsplat_cli.artwork.finish.finish import State, begin, goal_of, settle
from cubicsplat_cli.artwork.geometry.outlines import polygon
from cubicsplat_cli.artwork.input.intake import as_levels
from cubicsplat_cli.artwork.layers.seams import without_seams
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.raster.stack import normal_equations

SIZE, MEETING = 40, 20  # px; the row and column of the pixels in which the shapes meet
GREEN = (0.0, 0.6, 0.0, 1.0)


def stacked(hidden):
    """Red below and green at the right meet over a blue shape; they hide its right side where that lies far enough."""
    corners = {
        (0, 0, 255, 255): [(2.0, 2.0), (hidden, 2.0), (hidden, 38.0), (2.0, 38.0)],
        (255, 0, 0, 255): [(2.0, 20.5), (38.0, 20.5), (38.0, 38.0), (2.0, 38.0)],
        (0, 153, 0, 255): [(20.4, 2.0), (38.0, 2.0), (38.0, 21.9), (20.4, 21.9)],
    }
    return Drawing(SIZE, SIZE, tuple(Shape(ink, (polygon(np.array(c)),), "x") for ink, c in corners.items()))


def target_of(drawing):
    return begin(drawing, goal_of(np.zeros((SIZE, SIZE, 4)))).image


def ground_inside(state):
    return float((1.0 - state.image[4:36, 4:36, 3]).max())


def test_the_ground_leaks_where_a_hidden_edge_meets_two_others_and_not_along_the_drawing():
    target = target_of(stacked(30.0))
    rows, columns = np.divmod(seals.leaks(begin(stacked(20.7), goal_of(target)).image, goal_of(target)), SIZE)
    assert set(columns.tolist()) == {MEETING}
    # The first and last rows are beside the drawing's own edge, and below 20 red covers it all.
    assert rows.tolist() == list(range(3, MEETING + 1))
    assert not len(seals.leaks(target, goal_of(target)))


def test_the_equations_of_leaks_match_finite_differences():
    target = target_of(stacked(30.0))
    goal, state = goal_of(target), begin(stacked(20.7), goal_of(target))
    given = (goal, state.image, state.crossings, int(state.pieces[-1]))
    gradient = seals.sealed_equations(*given, state.leaking)[1] - normal_equations(*given)[1]
    outline = state.layers[0].outlines[0]
    found = outline.jacobian.T @ gradient[: outline.jacobian.shape[0]]

    def misfit(step):
        layers = begin(stacked(20.7), goal).layers
        layers[0].outlines[0] = outline.moved(step)
        state = State.of(layers, goal)
        return seals.leak_misfit(state.image, state.leaking).sum()

    steps = 1e-5 * np.eye(len(found))
    expected = [(misfit(step) - misfit(-step)) / 2e-5 for step in steps]
    assert np.abs(expected).max() > 1.0
    # Half of the square's slope, as of every misfit.
    assert found == pytest.approx(0.5 * np.array(expected), rel=3e-3, abs=1e-3)


def test_hidden_edges_leave_the_pixels_where_others_meet(monkeypatch):
    """A target that is a little darker there would be best matched by a little of the ground."""
    target = target_of(stacked(30.0))
    target[MEETING - 2 : MEETING + 2, MEETING, :3] *= 0.8
    goal = goal_of(target)
    sealed = ground_inside(settle(begin(stacked(20.7), goal), goal))
    monkeypatch.setattr(seals, "WEIGHT", 0.0)
    assert ground_inside(settle(begin(stacked(20.7), goal), goal)) > 2e-3
    assert sealed < 2e-4


def meeting_place(seam):
    """Red, blue and green meet about the middle, where `seam` of the pixels beside it is left of what they cover."""
    picture = np.zeros((SIZE, SIZE, 4))
    picture[:, :20], picture[:20, 20:], picture[20:, 20:] = RED, BLUE, GREEN
    picture[19:21, 19] *= seam
    return as_levels(picture.astype(np.float32))


def test_nothing_shines_through_where_three_shapes_meet():
    levels = meeting_place(0.7)
    mended = without_seams(levels, regions_of(meeting_place(1.0), RED, BLUE, GREEN))
    assert mended == pytest.approx(meeting_place(1.0), abs=1e-3)
    assert levels[19, 19, 3] == pytest.approx(0.7 * 255.0)


def test_a_gap_stays_where_only_two_shapes_are_near():
    levels = meeting_place(1.0)
    levels[4, 19] *= 0.7
    regions = regions_of(meeting_place(1.0), RED, BLUE, GREEN)
    assert (without_seams(levels, regions)[4, 19] == levels[4, 19]).all()
