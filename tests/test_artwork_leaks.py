"""No ground shows between opaque shapes: the finish moves hidden edges away from where others meet."""

from dataclasses import replace

import numpy as np
import pytest
from test_artwork_draw import BLUE, RED
from test_artwork_regular import regions_of

from cubicsplat_cli.artwork.finish.settle import settle
from cubicsplat_cli.artwork.finish.state import State, begin, goal_of
from cubicsplat_cli.artwork.geometry.outlines import polygon
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.artwork.layers.seams import without_seams
from cubicsplat_cli.artwork.plan import planned
from cubicsplat_cli.artwork.regions.regions import FlatPicture
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing, Shape

SIZE, MEETING = 40, 20  # px; the row and column of the pixels in which the shapes meet
GREEN = (0.0, 0.6, 0.0, 1.0)


def stacked(hidden):
    """Red below and green at the right meet over a blue shape; they hide its right side where that lies far enough."""
    corners = {
        (0, 0, 255, 255): [(2.0, 2.0), (hidden, 2.0), (hidden, 38.0), (2.0, 38.0)],
        (255, 0, 0, 255): [(2.0, 20.5), (38.0, 20.5), (38.0, 38.0), (2.0, 38.0)],
        (0, 153, 0, 255): [(20.4, 2.0), (38.0, 2.0), (38.0, 21.9), (20.4, 21.9)],
    }
    return Drawing(SIZE, SIZE, tuple(Shape(fill, (polygon(np.array(c)),), "x") for fill, c in corners.items()))


def target_of(drawing):
    return begin(drawing, goal_of(np.zeros((SIZE, SIZE, 4)))).image


def ground_inside(state):
    return float((1.0 - state.image[4:36, 4:36, 3]).max())


def weightless(goal):
    return replace(goal, leak_weight=0.0)


def test_the_ground_leaks_where_a_hidden_edge_meets_two_others_and_not_along_the_drawing():
    goal = goal_of(target_of(stacked(30.0)))
    state = begin(stacked(20.7), goal)
    shown = np.where(goal.inside, 1.0 - state.image[..., 3], 0.0)
    rows, columns = np.nonzero(shown > 1e-6)
    assert set(columns.tolist()) == {MEETING}
    # The first and last rows are beside the drawing's own edge, and below 20 red covers it all.
    assert rows.tolist() == list(range(3, MEETING + 1))
    leaked = state.stack.cost - begin(stacked(20.7), weightless(goal)).stack.cost
    assert leaked == pytest.approx(goal.leak_weight * (shown**2).sum()) and leaked > 0.0
    plain = begin(stacked(30.0), goal)
    assert plain.stack.cost == pytest.approx(begin(stacked(30.0), weightless(goal)).stack.cost, abs=1e-12)


def test_the_equations_of_leaks_match_finite_differences():
    goal = goal_of(target_of(stacked(30.0)))
    outline = begin(stacked(20.7), goal).outlines[0]
    count = outline.jacobian.count

    def gradient(goal):
        unknowns = [0], [4], [0], [outline.jacobian], np.ones(count), 1.0
        return begin(stacked(20.7), goal).stack.step(*unknowns).gradient

    def leaked(step):
        values = []
        for each in (goal, weightless(goal)):
            layers = begin(stacked(20.7), each).layers
            layers[0].outlines[0] = outline.moved(step)
            values.append(State(layers, each).stack.cost)
        return values[0] - values[1]

    found = gradient(goal) - gradient(weightless(goal))
    steps = 1e-5 * np.eye(count)
    expected = [(leaked(step) - leaked(-step)) / 2e-5 for step in steps]
    assert np.abs(expected).max() > 1.0
    # Half of the square's slope, as of every misfit.
    assert found == pytest.approx(0.5 * np.array(expected), rel=3e-3, abs=1e-3)


def test_hidden_edges_leave_the_pixels_where_others_meet():
    """A target that is a little darker there would be best matched by a little of the ground."""
    target = target_of(stacked(30.0))
    target[MEETING - 2 : MEETING + 2, MEETING, :3] *= 0.8
    goal = goal_of(target)
    sealed, leaking = (ground_inside(settle(begin(stacked(20.7), g))) for g in (goal, weightless(goal)))
    assert leaking > 2e-3
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


@pytest.mark.parametrize("known", [False, True])
def test_pixels_that_are_known_to_show_fills_have_no_seams(known):
    levels, whole = meeting_place(0.7), meeting_place(1.0)
    palette, labels = np.unique(whole.reshape(-1, 4), axis=0, return_inverse=True)
    labels = labels.reshape(whole.shape[:2]).astype(np.int32) if known else None
    plan = planned(FlatPicture(levels, palette, labels), ArtworkSettings(), Condition())
    assert plan.levels[19, 19, 3] == pytest.approx(0.7 * 255.0 if known else 255.0)


def test_a_gap_stays_where_only_two_shapes_are_near():
    levels = meeting_place(1.0)
    levels[4, 19] *= 0.7
    regions = regions_of(meeting_place(1.0), RED, BLUE, GREEN)
    assert (without_seams(levels, regions)[4, 19] == levels[4, 19]).all()
