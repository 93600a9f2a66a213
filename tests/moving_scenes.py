"""Moving scenes for tests."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.motion.tracks import KnotTrack, Tracks, engine_scene
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode

WIDTH, HEIGHT = 80, 60
STILL, RIGID = 3, 5  # the first curves stand still, those behind them keep their shape


def moving_scene(
    seed: int, begin: float = 0.0, frames: int = 7, *, curves: int = 12, mode: Mode = Mode.CLOSED, seconds: float = 0.1
) -> Tracks:
    """Curves that stand still, keep their shape, change colour, opacity, or all of them, with knots at random."""
    rng = np.random.default_rng(seed)
    count = 9 if mode is Mode.CLOSED else 10
    middle, angles = rng.uniform((0, 0), (WIDTH, HEIGHT), (curves, 2)), np.linspace(0, 2 * np.pi, count, endpoint=False)
    shape = middle[:, None] + 12 * np.stack([np.cos(angles), np.sin(angles)], -1) + rng.normal(0, 2, (curves, count, 2))
    points = shape + rng.normal(0, 3, (frames, curves, count, 2))
    points[:, :RIGID] = shape[:RIGID]
    offsets = np.zeros((frames, curves, 2))
    offsets[:, STILL:RIGID] = rng.normal(0, 6, (frames, RIGID - STILL, 2))
    colours = np.repeat(rng.random((1, curves, 3)), frames, axis=0)
    colours[:, RIGID + 1 :] = rng.random((frames, curves - RIGID - 1, 3))
    opacities = np.ones((frames, curves, 1))
    opacities[:, RIGID + 3 :] = rng.random((frames, curves - RIGID - 3, 1))
    half_widths = np.zeros((frames, curves, 1)) if mode is Mode.CLOSED else rng.uniform(1, 3, (frames, curves, 1))
    half_widths[:, :RIGID] = half_widths[:1, :RIGID]
    values = {
        "shapes": np.concatenate([points.reshape(frames, curves, -1), half_widths], axis=2), "offsets": offsets,
        "colours": colours, "opacities": opacities,
    }  # fmt: skip
    knots = rng.random((frames, curves)) < 0.3
    knots[[0, -1]] = True
    tracks = {name: KnotTrack(each.astype(np.float32), knots, np.zeros(curves, bool)) for name, each in values.items()}
    arrays = [each[0].astype(np.float32) for each in (points, colours, opacities[..., 0], half_widths[..., 0])]
    base = Scene(mode, WIDTH, HEIGHT, *arrays, (1.0, 1.0, 0.9))
    return Tracks(base, begin + seconds * np.arange(frames), begin + seconds * frames, tracks)


def scene_at(group: Tracks, frame: int) -> Scene:
    """All curves of a frame, those without opacity included."""
    lines = group.lines()
    return engine_scene(group.scene, {name: lines[name].at(each.values, frame) for name, each in group.by_name.items()})


def two_groups(mode: Mode = Mode.CLOSED) -> list[Tracks]:
    """A clip with a cut."""
    first = moving_scene(1, mode=mode)
    return [first, moving_scene(2, first.end, 5, mode=mode)]
