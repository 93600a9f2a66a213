"""Merges of the finish: runs of pieces that one line or cubic stands for, where they show and where they do not."""

from pathlib import Path

import numpy as np
import pytest
from image_files import by_resvg

from cubicsplat_cli.artwork.finish.merges import Merge, merged, with_merges
from cubicsplat_cli.artwork.finish.parameters import Constraints
from cubicsplat_cli.artwork.finish.state import State, begin, drawn, goal_of
from cubicsplat_cli.artwork.geometry.outlines import Circle, Ring, divided, points_at, polygon, signed_area
from cubicsplat_cli.artwork.shapes import PRICE, Drawing, Shape
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.raster.cubics import found_merges

RED, BLUE = (255, 0, 0, 255), (0, 64, 255, 255)
SIZE = 64
HELD = Constraints(SIZE, SIZE)
SQUARE = polygon(np.array([[8.5, 8.25], [50.5, 8.25], [50.5, 50.75], [8.5, 50.75]]))


def picture_of(*shapes: Shape) -> np.ndarray:
    return begin(Drawing(SIZE, SIZE, shapes), goal_of(np.zeros((SIZE, SIZE, 4)))).image


def after_merges(target: np.ndarray, *shapes: Shape, detail: float = 1.0) -> tuple[State, Drawing]:
    drawing, goal = Drawing(SIZE, SIZE, shapes), goal_of(target)
    state = with_merges(begin(drawing, goal), HELD, detail)
    return state, drawn(drawing, state)


def shape(ring: Ring, fill=RED) -> Shape:
    return Shape(fill, (ring,), "shape")


def test_a_run_is_replaced_also_across_the_rings_start():
    ring = divided(divided(SQUARE, 3, 0.5), 0, 0.5)
    assert ring.pieces == 6
    whole = np.stack([SQUARE.anchors[3] * (1 - t) + SQUARE.anchors[0] * t for t in (0.0, 1 / 3, 2 / 3, 1.0)])
    found = merged(ring, [Merge(4, 2, whole, True, 2, 8.0)])
    assert found.pieces == 5 and found.lines.all()
    assert signed_area(found) == pytest.approx(signed_area(SQUARE))


def test_pieces_too_many_are_taken_out():
    circle = Circle(31.0, 30.0, 18.0).ring()
    ring = circle
    for piece in (3, 2, 1, 0):
        ring = divided(ring, piece, 0.4)
    target = picture_of(shape(ring))
    state, found = after_merges(target, shape(ring))
    (outline,) = found.shapes[0].outlines
    assert ring.pieces == 8 and isinstance(outline, Ring) and outline.pieces <= 4
    assert np.abs(state.image - target).max() < 0.01


def test_wrong_corners_along_a_line_are_taken_out():
    bent = polygon(np.array([[8.5, 8.25], [20.0, 8.3], [33.0, 8.2], [50.5, 8.25], [50.5, 50.75], [8.5, 50.75]]))
    state, found = after_merges(picture_of(shape(SQUARE)), shape(bent))
    (outline,) = found.shapes[0].outlines
    assert outline.ring().pieces == 4
    assert np.abs(state.image - picture_of(shape(SQUARE))).max() < 0.02


def test_a_corner_that_shows_stays():
    dented = polygon(np.array([[8.5, 8.25], [30.0, 9.5], [50.5, 8.25], [50.5, 50.75], [8.5, 50.75]]))
    _, found = after_merges(picture_of(shape(dented)), shape(dented))
    (outline,) = found.shapes[0].outlines
    assert outline.ring().pieces == 5


def test_what_is_hidden_goes_the_simple_way_and_nothing_else_is_seen():
    steps = [[40.0 + (k % 2), 10.0 + 2.0 * k] for k in range(20)]
    wandering = polygon(np.array([[10.0, 8.0], [40.0, 8.0], *steps, [40.0, 52.0], [10.0, 52.0]]))
    cover = shape(polygon(np.array([[35.0, 4.0], [60.0, 4.0], [60.0, 60.0], [35.0, 60.0]])), BLUE)
    target = picture_of(shape(wandering), cover)
    state, found = after_merges(target, shape(wandering), cover)
    assert found.shapes[0].outlines[0].ring().pieces <= 8
    assert np.abs(state.image - target).max() < 0.02


def merges_of(cubics: np.ndarray, lines: np.ndarray, points: np.ndarray, nats: float = 1e6):
    flags = lines, np.zeros(len(lines), bool), np.zeros(len(lines), bool), np.zeros(len(lines), bool)
    ends = len(points) // len(lines) * np.arange(1, len(lines) + 1)
    return found_merges((cubics, *flags), (points, np.ones(len(points)), ends), (nats, 1.0, -1.0), (3, 3, 2))


def test_a_run_costs_half_of_the_squares_from_the_nearest_line():
    ring = polygon(np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 1.0], [20.0, 20.0], [0.0, 20.0]]))
    points = points_at(ring.cubics, np.tile(np.linspace(0.1, 0.9, 5), (5, 1))).reshape(-1, 2)
    numbers, cubics, nets = merges_of(ring.cubics, ring.lines, points)
    (own,) = np.flatnonzero((numbers[:, :2] == [0, 2]).all(axis=1))
    middle = points[:10] - points[:10].mean(axis=0)
    assert numbers[own].tolist() == [0, 2, 1, 2]
    assert 2e6 - nets[own] == pytest.approx(0.5 * np.linalg.svd(middle, compute_uv=False)[-1] ** 2, abs=1e-6)
    assert cubics[own][[0, 3]].tolist() == [[0.0, 0.0], [20.0, 1.0]]


def test_the_cubic_of_a_run_is_the_one_that_its_pieces_were_cut_from():
    bow = np.array([[0.0, 0.0], [5.0, 14.0], [22.0, 16.0], [30.0, 0.0]])
    whole = Ring(bow[[0, 3]], np.stack([bow[1:3], bow[[3, 0]]]), np.array([False, True]), np.zeros(2, bool))
    ring = divided(divided(whole, 0, 0.3), 1, 0.5)
    points = points_at(ring.cubics, np.tile(np.linspace(0.05, 0.95, 12), (4, 1))).reshape(-1, 2)
    # A parameter is worth so little that no line may stand for the run.
    numbers, cubics, _ = merges_of(ring.cubics, ring.lines, points, nats=1.0)
    (own,) = np.flatnonzero((numbers[:, :3] == [0, 2, 0]).all(axis=1))
    found, whole = points_at(cubics[own], np.linspace(0.0, 1.0, 9)), points_at(bow, np.linspace(0.0, 0.65, 4000))
    assert np.hypot(*(found[:, None] - whole).transpose(2, 0, 1)).min(axis=1).max() < 0.1


def test_more_detail_keeps_more_pieces():
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    radius = 20.0 + 0.25 * np.cos(5.0 * angle)
    blob = polygon(32.0 + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    pieces = [
        after_merges(picture_of(shape(blob)), shape(blob), detail=detail)[1].shapes[0].outlines[0].ring().pieces
        for detail in (0.05, 1.0, 50.0)
    ]
    assert pieces[0] < pieces[1] < pieces[2]


@pytest.mark.slow
def test_pieces_that_the_finish_has_made_even_are_merged_at_its_end():
    """Without merges at the end the house comes back with 330 coordinates."""
    picture = by_resvg(Path(__file__).parent.parent / "samples/artwork/house.svg", 200)
    assert draw(np.asarray(picture.convert("RGB")) / np.float32(255.0)).coordinates < 290


def test_faint_edges_are_known_no_better_than_rounding_lets_them():
    ground, faint = Shape((200, 200, 200, 255), (SQUARE,), "ground"), (200, 200, 201, 255)
    before, after = (Shape(faint, (Circle(x, 30.0, 10.0),), "disc") for x in (30.0, 30.3))
    goal = goal_of(picture_of(ground, before))
    states = [begin(Drawing(SIZE, SIZE, (ground, each)), goal) for each in (before, after)]
    # The rows of a picture in 8 bits hardly tell a third of a pixel of one level.
    assert -3.0 * PRICE < states[0].gains(states[1], np.array([False, True]))[1] < 0.0
