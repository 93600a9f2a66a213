"""Stacks of shapes: the native picture and normal equations against plain numpy and finite differences."""

import resource
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from cubicsplat_cli.artwork.geometry.coverage import coverage
from cubicsplat_cli.artwork.geometry.fine import fine_ring
from cubicsplat_cli.artwork.geometry.outlines import Circle, Rectangle
from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.stack import Goal, StackPieces, draw_stack, normal_equations

HEIGHT, WIDTH = 40, 48
OUTLINES = (Rectangle(-3.0, 4.2, 40.3, 30.6, 6.2), Circle(33.3, 20.7, 11.4), Circle(14.0, 30.0, 30.0))
INKS = np.array([[1.0, 0.0, 0.0, 1.0], [0.0, 0.2, 0.6, 0.6], [0.1, 0.3, 0.0, 0.5]])


def stack_of(outlines=OUTLINES):
    rings = [fine_ring(outline) for outline in outlines]
    return StackPieces(
        np.cumsum([ring.pieces for ring in rings]).astype(np.int32),
        np.concatenate([ring.cubics for ring in rings]),
        np.concatenate([ring.lines for ring in rings]),
        np.ones(sum(ring.pieces for ring in rings)),
        INKS[: len(rings)],
    )


def goal_of(target=None):
    return Goal(np.zeros((HEIGHT, WIDTH, 4)) if target is None else target, (1.0, 1.0, 1.0, 1.5), 0.15)


def test_the_picture_is_composed_of_exact_coverages():
    expected = np.zeros((HEIGHT, WIDTH, 4))
    for outline, ink in zip(OUTLINES, INKS, strict=True):
        ring = fine_ring(outline)
        share = coverage(ring.cubics, ring.lines, 0, 0, HEIGHT, WIDTH)[..., None]
        expected = expected * (1.0 - ink[3] * share) + share * ink
    assert np.abs(draw_stack(stack_of(), goal_of())[0] - expected).max() < 1e-6


def test_a_grid_samples_each_pixel_at_its_middles():
    circle = Circle(20.3, 19.6, 12.7)
    y, x = (np.mgrid[0 : HEIGHT * 4, 0 : WIDTH * 4] + 0.5) / 4
    away = np.hypot(x - circle.cx, y - circle.cy) - circle.r
    # The circle's polyline runs up to 0.001 px within it.
    least, most = ((away < off).reshape(HEIGHT, 4, WIDTH, 4).mean(axis=(1, 3)) for off in (-0.0015, 0.0005))
    share = draw_stack(stack_of((circle,)), replace(goal_of(), grid=4))[0][..., 3]
    assert (share > least - 1e-6).all() and (share < most + 1e-6).all()
    assert (most - least).sum() < 0.5


def test_a_blur_is_that_of_the_picture():
    taps = np.array([0.4, 0.2, 0.1])
    sharp = draw_stack(stack_of(), goal_of())[0]
    expected = ndimage.correlate1d(sharp, [*taps[:0:-1], *taps], axis=0, mode="nearest")
    expected = ndimage.correlate1d(expected, [*taps[:0:-1], *taps], axis=1, mode="nearest")
    assert draw_stack(stack_of(), replace(goal_of(), taps=taps))[0] == pytest.approx(expected, abs=1e-12)


def test_the_misfit_is_linear_beyond_the_bound():
    goal = goal_of()
    image, misfit, _ = draw_stack(stack_of(), goal)
    size = np.linalg.norm(image * goal.channels, axis=2)
    expected = np.where(size <= goal.bound, size**2, goal.bound * (2.0 * size - goal.bound))
    assert misfit == pytest.approx(expected)


# The Gram matrix leaves out that a blur goes on beyond the canvas as the picture ends there, which two outlines cross.
@pytest.mark.parametrize(("taps", "gram_error"), [([1.0], 0.02), ([0.34, 0.23, 0.08, 0.02], 0.1)])
def test_equations_match_finite_differences(taps, gram_error):
    stack = stack_of()
    target = draw_stack(stack_of((Rectangle(-3.0, 4.0, 40.0, 31.0, 6.0), *OUTLINES[1:])), goal_of())[0]
    goal = replace(goal_of(target), bound=10.0, taps=np.array(taps))
    image, _, crossings = draw_stack(stack, goal)
    count = len(stack.cubics)
    gram, gradient = normal_equations(goal, image, crossings, count)
    # The coverage of a polyline is smooth but where a vertex crosses a border between pixels.
    step = 1e-4 * np.random.default_rng(1).normal(size=stack.cubics.shape)
    for first, last in zip([0, *stack.ends], stack.ends, strict=False):
        step[first:last, 3] = np.roll(step[first:last, 0], -1, axis=0)
    ends = step[stack.lines][:, [0, 3]]
    step[stack.lines, 1:3] = (2.0 * ends + ends[:, ::-1]) / 3.0
    ahead, behind = (draw_stack(replace(stack, cubics=stack.cubics + sign * step), goal) for sign in (1.0, -1.0))
    change = 0.5 * (ahead[0] - behind[0]) * goal.channels
    assert 0.5 * (ahead[1] - behind[1]).sum() == pytest.approx(2.0 * gradient @ step.ravel(), rel=0.02)
    assert (change**2).sum() == pytest.approx(step.ravel() @ (gram @ step.ravel()), rel=gram_error)
    assert abs(gram - gram.T).max() < 1e-9


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux's account of memory")
def test_the_picture_of_many_large_shapes_takes_memory_for_their_outlines_only():
    count, side = 80, 800
    sizes = ((1.3, side - 2.6), (2.0, side - 4.0))
    frame = [fine_ring(Rectangle(start, start, size, size)) for start, size in sizes]
    cubics, lines = (np.concatenate([part] * count) for part in _joined(frame))
    stack = StackPieces(
        (np.arange(1, count + 1) * 8).astype(np.int32), cubics, lines, np.tile(np.repeat([1.0, -1.0], 4), count),
        np.tile(INKS[:1], (count, 1)),
    )  # fmt: skip
    goal = Goal(np.zeros((side, side, 4)), (1.0, 1.0, 1.0, 1.5), 0.15)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    # A float for each pixel of each shape's box would take 205 MB.
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 180_000_000, before[1]))
    try:
        image = draw_stack(stack, goal)[0]
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
    assert image[400, 1, 0] == pytest.approx(1.0) and image[400, 400, 0] == 0.0


def _joined(rings):
    return np.concatenate([ring.cubics for ring in rings]), np.concatenate([ring.lines for ring in rings])


def test_arrays_of_the_wrong_kind_are_refused():
    stack = stack_of()
    with pytest.raises(EngineError, match="contiguous float64"):
        draw_stack(replace(stack, cubics=stack.cubics.astype(np.float32)), goal_of())
