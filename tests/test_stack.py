"""Stacks of shapes: the native picture and its steps against plain numpy and finite differences."""

import resource
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from red_rings import dense
from scipy import ndimage

from cubicsplat_cli.artwork.geometry.outlines import FINE, Circle, Rectangle
from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.progress import Work, under_way
from cubicsplat_cli.raster.outlines import coverage
from cubicsplat_cli.raster.sparse import SparseRows
from cubicsplat_cli.raster.stack import DrawnStack, Goal, StackPieces

HEIGHT, WIDTH = 40, 48
OUTLINES = (Rectangle(-3.0, 4.2, 40.3, 30.6, 6.2), Circle(33.3, 20.7, 11.4), Circle(14.0, 30.0, 30.0))
FILLS = np.array([[1.0, 0.0, 0.0, 1.0], [0.0, 0.2, 0.6, 0.6], [0.1, 0.3, 0.0, 0.5]])


def layers_of(rings, fills):
    """A layer of each ring and fill."""
    ends = np.cumsum([ring.pieces for ring in rings]).astype(np.int32)
    cubics, lines = (np.concatenate([getattr(ring, name) for ring in rings]) for name in ("cubics", "lines"))
    return StackPieces(ends, cubics, lines, np.ones(len(lines)), fills)


def stack_of(outlines=OUTLINES):
    return layers_of([outline.ring(FINE) for outline in outlines], FILLS[: len(outlines)])


def goal_of(target=None):
    return Goal(np.zeros((HEIGHT, WIDTH, 4)) if target is None else target, (1.0, 1.0, 1.0, 1.5), 0.15)


def image_of(stack, goal):
    return DrawnStack(stack, goal).picture[0]


def test_the_picture_is_composed_of_exact_coverages():
    expected = np.zeros((HEIGHT, WIDTH, 4))
    for outline, fill in zip(OUTLINES, FILLS, strict=True):
        ring = outline.ring(FINE)
        share = coverage(ring.cubics, ring.lines, 0, 0, HEIGHT, WIDTH)[..., None]
        expected = expected * (1.0 - fill[3] * share) + share * fill
    assert np.abs(image_of(stack_of(), goal_of()) - expected).max() < 1e-6


def test_the_uppermost_layer_of_a_pixel_is_the_last_that_covers_enough():
    shares = [
        coverage(ring.cubics, ring.lines, 0, 0, HEIGHT, WIDTH) for ring in (outline.ring(FINE) for outline in OUTLINES)
    ]
    rows, columns = slice(3, 36), slice(5, 47)
    for least in (0.1, 0.5):
        expected = np.full((HEIGHT, WIDTH), -1)
        for k, share in enumerate(shares):
            expected[share >= least] = k
        found = DrawnStack(stack_of(), goal_of()).uppermost(rows, columns, least)
        assert (found == expected[rows, columns]).all() and set(np.unique(found)) >= {0, 1, 2}


def test_a_step_of_very_many_variables_is_that_of_few():
    side = 12
    drawing = Rectangle(3.2, 3.3, 6.4, 5.7)
    aim = Rectangle(3.0, 3.5, 6.5, 5.5)

    def step_of(across, down):
        """The step of squares side by side on a canvas, of which one is moved by 8 variables."""
        shift = side * np.stack(np.meshgrid(np.arange(across), np.arange(down)), axis=-1).reshape(-1, 1, 1, 2)
        count = len(shift)

        def stack_at(box):
            cubics = (box.ring(FINE).cubics + shift).reshape(-1, 4, 2)
            ends = 4 * np.arange(1, count + 1, dtype=np.int32)
            fills = np.tile(FILLS[:1], (count, 1))
            return StackPieces(ends, cubics, np.ones(4 * count, dtype=bool), np.ones(4 * count), fills)

        empty = Goal(np.zeros((down * side, across * side, 4)), (1.0, 1.0, 1.0, 1.5), 10.0)
        goal = replace(empty, target=image_of(stack_at(aim), empty))
        one = control_points(stack_of((drawing,)))
        points = SparseRows(one.starts, one.columns, one.values, 8)
        first, damping = 4 * np.arange(count), np.zeros(8 * count)
        unknowns = first, np.full(count, 4), 2 * first, [points] * count, damping, 0.01
        return DrawnStack(stack_at(drawing), goal).step(*unknowns).values.reshape(count, 8)

    exact = step_of(1, 1)
    assert np.abs(exact).max() > 0.1
    # 4,800 variables, of which the factor stays sparse.
    assert step_of(30, 20) == pytest.approx(np.repeat(exact, 600, axis=0), abs=1e-3)


def test_a_grid_samples_each_pixel_at_its_middles():
    circle = Circle(20.3, 19.6, 12.7)
    y, x = (np.mgrid[0 : HEIGHT * 4, 0 : WIDTH * 4] + 0.5) / 4
    away = np.hypot(x - circle.cx, y - circle.cy) - circle.r
    # The circle's polyline runs up to 0.001 px within it.
    least, most = ((away < off).reshape(HEIGHT, 4, WIDTH, 4).mean(axis=(1, 3)) for off in (-0.0015, 0.0005))
    share = image_of(stack_of((circle,)), replace(goal_of(), grid=4))[..., 3]
    assert (share > least - 1e-6).all() and (share < most + 1e-6).all()
    assert (most - least).sum() < 0.5


def test_a_blur_is_that_of_the_picture():
    taps = np.array([0.4, 0.2, 0.1])
    sharp = image_of(stack_of(), goal_of())
    expected = ndimage.correlate1d(sharp, [*taps[:0:-1], *taps], axis=0, mode="nearest")
    expected = ndimage.correlate1d(expected, [*taps[:0:-1], *taps], axis=1, mode="nearest")
    assert image_of(stack_of(), replace(goal_of(), taps=taps)) == pytest.approx(expected, abs=1e-12)


def test_the_misfit_is_linear_beyond_the_bound():
    goal = goal_of()
    image, misfit = DrawnStack(stack_of(), goal).picture
    size = np.linalg.norm(image * goal.channels, axis=2)
    expected = np.where(size <= goal.bound, size**2, goal.bound * (2.0 * size - goal.bound))
    assert misfit == pytest.approx(expected)


def with_steps(goal):
    """The goal without anti-aliasing: on half of its pixels a residual of more than 0.2 is on the wrong side."""
    half = np.where(np.indices((HEIGHT, WIDTH)).sum(axis=0) % 2, 0.2, 1.0)
    return replace(goal, half=half, steep=5.0)


def test_pixels_on_the_wrong_side_of_an_edge_without_anti_aliasing_count_more():
    plain, goal = goal_of(), with_steps(goal_of())
    image, misfit = DrawnStack(stack_of(), goal).picture
    beyond = np.clip(np.linalg.norm(image * goal.channels, axis=2) - goal.half, 0.0, goal.half)
    assert beyond.any()
    assert misfit == pytest.approx(DrawnStack(stack_of(), plain).picture[1] + 5.0 * beyond**2)


def control_points(stack):
    """How the control points of a stack of one ring a layer move with its anchors and the handles of its cubics."""
    count, rows, columns, values = len(stack.cubics), [], [], []
    after = np.arange(1, count + 1)
    after[stack.ends - 1] = [0, *stack.ends[:-1]]
    for piece in range(count):
        for point in range(4):
            third = point / 3.0 if stack.lines[piece] else float(point == 3)
            own = point in (1, 2) and not stack.lines[piece]
            parts = [(2 * count + 4 * piece + 2 * (point - 1), 1.0)] if own else []
            parts = parts or [(2 * piece, 1.0 - third), (2 * after[piece], third)]
            for first, share in parts:
                for axis in (0, 1):
                    rows.append(8 * piece + 2 * point + axis)
                    columns.append(first + axis)
                    values.append(share)
    return SparseRows.of(np.array(rows), np.array(columns), np.array(values), (8 * count, 6 * count))


def rows_of(matrix, first, last):
    own = slice(matrix.starts[first], matrix.starts[last])
    starts = matrix.starts[first : last + 1] - matrix.starts[first]
    return SparseRows(starts, matrix.columns[own], matrix.values[own], matrix.count)


def unknowns_of(stack, points, keep):
    """What a step takes of a stack whose control points move so."""
    first = [0, *stack.ends[:-1]]
    parts = [rows_of(points, 8 * a, 8 * b) for a, b in zip(first, stack.ends, strict=True)]
    return first, np.diff([0, *stack.ends]), [0] * len(first), parts, np.zeros(points.count), keep


@pytest.mark.slow
def test_the_step_of_a_crowd_is_found_to_a_hundredth():
    """Of squares that all lie over each other: their factor fills up, and is not computed."""
    rng = np.random.default_rng(0)
    corners = rng.uniform(2.0, 20.0, (60, 2))
    boxes = [Rectangle(x, y, 17.3, 15.6) for x, y in corners.tolist()]
    fills = np.tile(FILLS[1:2], (60, 1))
    stack = replace(stack_of(boxes), fills=fills)
    aim = [Rectangle(x, y, 17.3, 15.6) for x, y in (corners + rng.normal(0.0, 0.2, (60, 2))).tolist()]
    goal = replace(goal_of(image_of(replace(stack_of(aim), fills=fills), goal_of())), bound=10.0)
    one, keep = control_points(stack_of(boxes[:1])), 0.01
    anchors = SparseRows(one.starts, one.columns, one.values, 8)  # lines have no handles
    first, drawn = 4 * np.arange(60), DrawnStack(stack, goal)
    found = drawn.step(first, [4] * 60, 2 * first, [anchors] * 60, np.zeros(480), keep)
    crossings, ways = drawn.crossings, np.zeros((60, 4, 8, 60, 8))
    ways[np.arange(60), :, :, np.arange(60)] = dense(anchors).reshape(4, 8, 8)
    ways = ways.reshape(240, 8, 480)
    moved = np.einsum("np,npv->nv", crossings.change, ways[crossings.piece])
    change = np.zeros((HEIGHT * WIDTH, 4, 480))
    np.add.at(change, crossings.pixel, (crossings.slope * goal.channels)[:, :, None] * moved[:, None])
    gram = np.einsum("pkv,pkw->vw", change, change, optimize=True) + keep * np.eye(480)
    exact = np.linalg.solve(gram, -found.gradient)
    off = found.values - exact
    assert 1e-12 < (off @ gram @ off) / (exact @ gram @ exact) < 1e-4


# The Gram matrix leaves out that a blur goes on beyond the canvas as the picture ends there, which two outlines cross.
@pytest.mark.parametrize("aliased", [False, True])
@pytest.mark.parametrize(("taps", "gram_error"), [([1.0], 0.02), ([0.34, 0.23, 0.08, 0.02], 0.1)])
@pytest.mark.parametrize("keep", [0.01, 10.0])
def test_steps_match_finite_differences(taps, gram_error, keep, aliased):
    stack, points = stack_of(), control_points(stack_of())
    target = image_of(stack_of((Rectangle(-3.0, 4.0, 40.0, 31.0, 6.0), *OUTLINES[1:])), goal_of())
    goal = replace(goal_of(target), bound=10.0, taps=np.array(taps))
    goal = with_steps(goal) if aliased else goal
    found = DrawnStack(stack, goal).step(*unknowns_of(stack, points, keep))
    step = points.times(found.values).reshape(stack.cubics.shape)
    assert found.moves == pytest.approx([np.abs(part).max() for part in np.split(step, stack.ends[:-1])])
    # The coverage of a polyline is smooth but where a vertex crosses a border between pixels.
    scale = 1e-4 / np.abs(step).max()
    ahead, behind = (
        DrawnStack(replace(stack, cubics=stack.cubics + sign * scale * step), goal) for sign in (1.0, -1.0)
    )
    slope = 0.5 * (ahead.cost - behind.cost) / scale
    assert slope == pytest.approx(2.0 * found.gradient @ found.values, rel=0.02)
    if aliased:
        return  # its matrix weighs pixels by their residuals
    # The step solves (gram + keep) step = -gradient.
    change = 0.5 * (ahead.picture[0] - behind.picture[0]) / scale * goal.channels
    gram = -(found.gradient + keep * found.values) @ found.values
    assert (change**2).sum() == pytest.approx(gram, rel=gram_error)


def test_what_winds_the_other_way_round_is_covered_and_moves_alike():
    """As viewers fill it: the lobe of a ring that crosses itself, or where two holes overlap."""
    box, circle = Rectangle(9.3, 8.2, 20.0, 17.0), Circle(30.0, 20.0, 9.0)
    stack, aim = stack_of((box, circle)), stack_of((Rectangle(9.0, 8.5, 20.4, 16.5), circle))
    other, goal = replace(stack, signs=-stack.signs), goal_of(image_of(aim, goal_of()))
    unknowns = unknowns_of(stack, control_points(stack), 0.01)
    drawn, turned = DrawnStack(stack, goal), DrawnStack(other, goal)
    assert np.abs(drawn.picture[0]).max() == 1.0 and (turned.picture[0] == drawn.picture[0]).all()
    assert np.abs(drawn.step(*unknowns).values).max() > 0.1
    assert turned.step(*unknowns).values == pytest.approx(drawn.step(*unknowns).values)


def shifted(stack, layer, by):
    cubics = stack.cubics.copy()
    cubics[slice(*[0, *stack.ends][layer : layer + 2])] += by
    return replace(stack, cubics=cubics)


@pytest.mark.parametrize("taps", [[1.0], [0.4, 0.2, 0.1]])
def test_what_is_drawn_again_is_what_is_drawn_afresh(taps):
    goal = replace(goal_of(), taps=np.array(taps))
    before = DrawnStack(stack_of(), goal)
    fewer = stack_of((OUTLINES[0], OUTLINES[2]))
    for stack in (
        shifted(stack_of(), 1, (0.3, -7.0)),
        fewer,
        replace(fewer, fills=FILLS[[0, 2]]),
        stack_of(OUTLINES[:1]),
    ):
        again, afresh = DrawnStack(stack, goal, before), DrawnStack(stack, goal)
        for one, other in zip(again.picture, afresh.picture, strict=True):
            assert (one == other).all()
        assert again.cost == afresh.cost
        assert (again.crossings.slope == afresh.crossings.slope).all()
        back = DrawnStack(stack_of(), goal, again)
        assert (back.picture[0] == before.picture[0]).all()


@pytest.mark.parametrize("spread", [0, 2])
def test_the_growth_is_that_of_the_pixels_that_pieces_cross(spread):
    goal = goal_of(image_of(stack_of(), goal_of()))
    before, after = (DrawnStack(shifted(stack_of(), 1, by), goal) for by in ((0.1, 0.0), (0.6, 0.4)))
    group = np.repeat([0, 1, -1], np.diff([0, *stack_of().ends]))
    expected = []
    for number in (0, 1):
        crossed = np.zeros(HEIGHT * WIDTH, dtype=bool)
        for drawn in (before, after):
            crossed[drawn.crossings.pixel[group[drawn.crossings.piece] == number]] = True
        crossed = ndimage.maximum_filter(crossed.reshape(HEIGHT, WIDTH), 2 * spread + 1)
        expected.append((after.picture[1] - before.picture[1])[crossed].sum())
    assert before.growth(after, group, group, 2, spread) == pytest.approx(np.array(expected))
    # The rectangle's right side lies within the circle.
    assert after.changed(before, group, 2, 1e-3).tolist() == [True, True]
    assert not after.changed(after, group, 2, 0.0).any()


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux's account of memory")
def test_the_picture_of_many_large_shapes_takes_memory_for_their_outlines_only():
    count, side = 80, 800
    sizes = ((1.3, side - 2.6), (2.0, side - 4.0))
    frame = [Rectangle(start, start, size, size).ring(FINE) for start, size in sizes]
    signs, fills = np.tile(np.repeat([1.0, -1.0], 4), count), np.tile(FILLS[:1], (count, 1))
    rings = layers_of(frame * count, fills)
    stack = replace(rings, ends=rings.ends[1::2].copy(), signs=signs)
    goal = Goal(np.zeros((side, side, 4)), (1.0, 1.0, 1.0, 1.5), 0.15)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    # A float for each pixel of each shape's box would take 205 MB.
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 180_000_000, before[1]))
    try:
        image = image_of(stack, goal)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
    assert image[400, 1, 0] == pytest.approx(1.0) and image[400, 400, 0] == 0.0


def test_arrays_of_the_wrong_kind_are_refused():
    stack = stack_of()
    with pytest.raises(EngineError, match="cubics must be contiguous on the CPU, float64"):
        DrawnStack(replace(stack, cubics=stack.cubics.astype(np.float32)), goal_of())


def _column(count, shift=0.0):
    """Circles along a line, of which each hides a part of the one before."""
    rings = [Circle(8.0 + 1.3 * k + shift, 9.0 + 0.9 * k, 5.0).ring() for k in range(count)]
    return layers_of(rings, FILLS[np.arange(count) % 3])


def _chosen(pieces, layers):
    """Some layers of a stack, each of four pieces."""
    own = np.concatenate([np.arange(4 * k, 4 * k + 4) for k in layers])
    ends = 4 * np.arange(1, len(layers) + 1, dtype=np.int32)
    return StackPieces(ends, pieces.cubics[own], pieces.lines[own], pieces.signs[own], pieces.fills[layers])


@pytest.mark.parametrize("taps", [np.ones(1), np.array([0.6, 0.2])])
def test_shapes_over_a_stack_that_stays_are_drawn_and_moved_as_among_its_own(taps):
    goal = replace(goal_of(), taps=taps)
    whole, moved, new = _column(9), _column(9, 0.4), [0, 3, 4, 8]
    rest = [k for k in range(9) if k not in new]
    base = DrawnStack(_chosen(whole, rest), goal)
    over = base, np.array([sum(k < each for k in rest) - 1 for each in new], dtype=np.int32)
    first = DrawnStack(_chosen(whole, new), goal, over=over)
    after = DrawnStack(_chosen(moved, new), goal, first, over)
    mixed = [moved if k in new else whole for k in range(9)]
    expected = replace(whole, cubics=np.concatenate([each.cubics[4 * k : 4 * k + 4] for k, each in enumerate(mixed)]))
    among = DrawnStack(expected, goal)
    assert np.array_equal(first.picture[0], image_of(whole, goal))
    assert np.array_equal(after.picture[0], among.picture[0]) and after.cost == among.cost
    own = np.isin(among.crossings.piece // 4, new)
    assert np.array_equal(after.crossings.slope, among.crossings.slope[own])
    groups, others = np.arange(16) // 4, np.full(36, -1)
    others[np.concatenate([np.arange(4 * k, 4 * k + 4) for k in new])] = groups
    grown = DrawnStack(whole, goal).growth(among, others, others, 4)
    assert first.growth(after, groups, groups, 4) == pytest.approx(grown)


def test_a_stack_is_the_same_for_any_number_of_threads():
    count, rng = 400, np.random.default_rng(3)
    places, sizes = rng.uniform(20.0, 380.0, (count, 2)), rng.uniform(3.0, 30.0, count)
    rings = [Circle(x, y, r).ring() for (x, y), r in zip(places, sizes, strict=True)]
    pieces = layers_of(rings, rng.uniform(0.0, 1.0, (count, 4)))
    moved = replace(pieces, cubics=pieces.cubics + np.repeat(rng.normal(0.0, 0.2, (count, 1, 2)), 4, axis=0))
    one = np.tile(np.eye(2), (16, 1))
    rows = SparseRows.of(*np.nonzero(one), one[np.nonzero(one)], one.shape)
    firsts = np.arange(0, 4 * count, 4)
    unknowns = firsts, np.full(count, 4), firsts // 2, [rows] * count, np.full(2 * count, 1e-3), 1e-3

    def results(threads):
        goal = Goal(np.zeros((400, 400, 4)), (1.0, 1.0, 1.0, 1.5), 0.15)
        with under_way(Work(threads=threads)):
            before = DrawnStack(pieces, goal)
            after = DrawnStack(moved, goal, before)
            groups = np.repeat(np.arange(count), 4)
            step = after.step(*unknowns)
            return *after.picture, before.growth(after, groups, groups, count), step.values, step.gradient

    for alone, shared in zip(results(1), results(3), strict=True):
        assert np.array_equal(alone, shared)
