"""Moving scenes for tests."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.moving import Clip, MovingScene
from cubicsplat_cli.settings import Mode

WIDTH, HEIGHT = 80, 60
STILL, RIGID = 3, 5  # the first curves stand still, those behind them keep their shape


def moving_scene(
    seed: int, begin: float = 0.0, frames: int = 7, *, curves: int = 12, mode: Mode = Mode.CLOSED, seconds: float = 0.1
) -> MovingScene:
    """Curves that stand still, keep their shape, change colour, opacity, or all of them, with knots at random."""
    rng = np.random.default_rng(seed)
    count = 9 if mode is Mode.CLOSED else 10
    middle, angles = rng.uniform((0, 0), (WIDTH, HEIGHT), (curves, 2)), np.linspace(0, 2 * np.pi, count, endpoint=False)
    shape = middle[:, None] + 12 * np.stack([np.cos(angles), np.sin(angles)], -1) + rng.normal(0, 2, (curves, count, 2))
    points = shape + rng.normal(0, 3, (frames, curves, count, 2))
    points[:, :STILL] = shape[:STILL]
    points[:, STILL:RIGID] = shape[STILL:RIGID] + rng.normal(0, 6, (frames, RIGID - STILL, 1, 2))
    colours = np.repeat(rng.random((1, curves, 3)), frames, axis=0)
    colours[:, RIGID + 1 :] = rng.random((frames, curves - RIGID - 1, 3))
    opacities = np.ones((frames, curves))
    opacities[:, RIGID + 3 :] = rng.random((frames, curves - RIGID - 3))
    half_widths = np.zeros((frames, curves)) if mode is Mode.CLOSED else rng.uniform(1, 3, (frames, curves))
    half_widths[:, :RIGID] = half_widths[:1, :RIGID]
    arrays = [each.astype(np.float32) for each in (points, colours, opacities, half_widths)]
    base = Scene(mode, WIDTH, HEIGHT, *(each[0] for each in arrays), (1.0, 1.0, 0.9))
    knots = rng.random((frames, curves)) < 0.3
    knots[[0, -1]] = True
    times = begin + seconds * np.arange(frames)
    return MovingScene(base, times, begin + seconds * frames, *arrays, knots)


def clip_of(*groups: MovingScene) -> Clip:
    return Clip(WIDTH, HEIGHT, groups[0].base.background, [*groups])


def two_groups(mode: Mode = Mode.CLOSED) -> Clip:
    """A clip with a cut."""
    first = moving_scene(1, mode=mode)
    return clip_of(first, moving_scene(2, first.end, 5, mode=mode))
