"""Follows a picture from frame to frame: each frame's fit begins with the curves of the one before, which are moved by
optical flow (least squares, from coarse to fine).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import map_coordinates

from cubicsplat_cli.motion.tracks import KEEP_MEAN, KEEP_SQUARE
from cubicsplat_cli.photo.inputs import FitInputs
from cubicsplat_cli.photo.loop import FitLoop
from cubicsplat_cli.photo.stepper import Phase
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.engine import Engine
from cubicsplat_cli.raster.ndimage import uniform_filter
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import as_numpy, block_means
from cubicsplat_cli.settings import FitSettings

RATE, RATE_END = 0.4, 0.2  # of a frame's steps: the first, in step sizes of the start of a fit; the last, as a share
PROGRESS = 0.5  # of a fit, for penalties on shapes: what is followed is in the middle of one
# Share of the way back to where the picture carried them that control points go in each step. What the picture does not
# ask for would take knots (decoupled weight decay, Loshchilov and Hutter, 2019).
DECAY = 0.03
# A new curve takes away about a curve's share of the loss. One whose removal costs less than this part of that goes,
# when this share of a frame's steps has brought the others into place.
IDLE, REPLACING = 1.0, 0.3
MOST_REPLACED = 1 / 8  # of the curves, at one frame
SHORTEST_LIFE = 6  # usual frames: what takes away less than so many shares of their loss is not worth its bytes
# Of the optical flow:
WINDOW = 9  # px: side of the square that moves as one
SMALLEST = 16  # px: no coarser copy of the frames has a shorter side
ROUNDS = 3  # of each copy
LONGEST = 1.0  # px: of a round, for which the pictures may be taken as linear
STIFFNESS = 3e-3  # squared gradient, in values a px, below which a place moves as little as it can


@dataclass(eq=False)
class Follower:
    """The curves of a group's frames so far.

    Curves that are replaced keep their places in `rows`, and have no opacity from then on; new ones, before they are
    there, neither. rows: of each frame, the scene; ids: of each, the number of each curve in it. Numbers rise from back
    to front but for those of the first frame, 0 to N - 1 from front to back. losses: of the frames. carried: control
    points as the flow left them. born: the frame of each new curve by its number.
    """

    loop: FitLoop
    scenes: list[Scene] = field(default_factory=list)
    ids: list[np.ndarray] = field(default_factory=list)
    born: dict[int, int] = field(default_factory=dict)
    losses: list[float] = field(default_factory=list)
    carried: np.ndarray = field(init=False)

    def first(self) -> None:
        """Fits the first frame from the start, or from the curves of the group before."""
        loop = self.loop
        try:
            while loop.progress < 1.0:
                work().at()
                loop.advance()
        finally:
            # What there is by then is a frame, unless it is nothing but seeds.
            if loop.step:
                self._keep(np.arange(loop.state.curves.curves))
        self.losses.append(float(loop.stepper.loss))
        # Longer memories than a frame's steps would follow the frames before.
        loop.schedule.recipe = replace(loop.schedule.recipe, keep_mean=KEEP_MEAN, keep_square=KEEP_SQUARE)

    def follow(self, picture: np.ndarray, steps: int, frames_left: int, seconds: float = math.inf) -> None:
        """Fits the next frame, in so many steps, or in none if it is the last one again. frames_left: with this one."""
        loop, ids = self.loop, self.ids[-1]
        if np.array_equal(loop.goal, picture):
            self.scenes.append(self.scenes[-1])
            self.ids.append(ids)
            return
        points = loop.state.curves.points
        points += sampled(flow(loop.goal, picture), points[..., 0] - 0.5, points[..., 1] - 0.5)
        self.carried = points.copy()
        loop.goal[...] = picture
        loop.stepper.check_finite(loop.step)
        began, replacing = time.perf_counter(), int(REPLACING * steps)
        for step in range(steps):
            work().at()
            if time.perf_counter() - began > seconds:
                break
            rate = RATE * (1.0 - (1.0 - RATE_END) * step / steps)
            phase = Phase(rate, loop.settings.recipe.edge_end, exact=False)
            loss = loop.stepper.step(phase, PROGRESS, measured=step == replacing)
            points = loop.state.curves.points
            points -= DECAY * (points - self.carried)
            if step == replacing:
                ids = self._replace(ids, float(loss), frames_left)
        loop.stepper.check_finite(loop.step)
        self._keep(ids)

    def _replace(self, ids: np.ndarray, loss: float, frames_left: int) -> np.ndarray:
        """Replaces curves that this frame has no use for by new ones at its errors. Returns the numbers of all."""
        loop, frame = self.loop, len(self.scenes)
        self.losses.append(loss)
        if frames_left * loss < SHORTEST_LIFE * np.median(self.losses):
            return ids
        importance, count = as_numpy(loop.stepper.importance).copy(), len(ids)
        young = np.array([frame - self.born.get(number, -SHORTEST_LIFE) < SHORTEST_LIFE for number in ids.tolist()])
        importance[young] = np.inf
        idle = min(int((importance < IDLE * loss / count).sum()), int(MOST_REPLACED * count))
        if idle == 0:
            return ids
        kept = np.sort(np.argsort(importance, kind="stable")[idle:])
        loop.stepper.replace(loop.state.chosen(kept).with_seeds(loop.seeder.seeds(idle, loop.stepper.image)))
        self.carried = np.concatenate([loop.state.curves.points[:idle], self.carried[kept]])
        fresh = max(max(each.max() for each in self.ids), -1) + 1 + np.arange(idle)[::-1]
        self.born |= dict.fromkeys(fresh.tolist(), frame)
        return np.concatenate([fresh, ids[kept]])

    def _keep(self, ids: np.ndarray) -> None:
        self.scenes.append(self.loop.scene())
        self.ids.append(ids)

    def rows(self) -> list[Scene]:
        """Of each frame a scene of all curves there ever were, front to back; those that are not there have opacity 0,
        and stand where they are first or were last.
        """
        first = len(self.ids[0])
        numbers = np.unique(np.concatenate(self.ids))
        order = np.concatenate([numbers[numbers >= first][::-1], numbers[numbers < first]])
        place = np.empty(order.max() + 1, np.int64)
        place[order] = np.arange(len(order))
        there = np.zeros((len(self.ids), len(order)), bool)
        for frame, ids in enumerate(self.ids):
            there[frame, place[ids]] = True
        born, died = there.argmax(axis=0), len(there) - 1 - there[::-1].argmax(axis=0)
        held = np.arange(len(there))[:, None].clip(born, died)
        rows = {}
        for name in ("points", "colours", "opacities", "half_widths"):
            values = np.zeros((*there.shape, *getattr(self.scenes[0], name).shape[1:]), np.float32)
            for of_frame, scene, ids in zip(values, self.scenes, self.ids, strict=True):
                of_frame[place[ids]] = getattr(scene, name)
            rows[name] = values[held, np.arange(len(order))]
        rows["opacities"] *= there
        return [
            replace(self.scenes[0], **{name: values[frame] for name, values in rows.items()})
            for frame in range(len(there))
        ]


def follow(
    pictures: list[np.ndarray], settings: FitSettings, start: Scene | None, steps: int, seconds: float, engine: Engine,
    on_frame: Callable[[int], None],
) -> list[Scene]:  # fmt: skip
    """Scenes of the same curves, one of each picture, or of fewer where the work is stopped; none if right away.

    start: curves to begin with, of the frame before. steps, seconds: at most so many for each frame but the first,
    which has the settings' steps, or as many as the others after a start. on_frame: called before each of the others.
    """
    if start is not None:
        settings = settings.with_(steps=steps)
    follower = Follower(FitLoop(pictures[0].copy(), settings, FitInputs(start=start), opened=lambda *_, **__: engine))
    with work().stoppable():
        follower.first()
        for index, picture in enumerate(pictures[1:], 1):
            on_frame(index)
            follower.follow(picture, steps, len(pictures) - index, seconds)
    return follower.rows() if follower.scenes else []


def flow(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(H, W, 2) float32: by how many px, x and y, what is at each pixel of a picture (H, W, C) moves to the next one.

    Lucas and Kanade (1981): the shift of a window with the least squared difference, of linearised pictures; first
    of copies of half the size (Bouguet, 2000).
    """
    height, width = before.shape[:2]
    shifts = np.zeros((height, width, 2), np.float32)
    if min(height, width) >= 2 * SMALLEST:
        coarse = 2.0 * flow(block_means(before, 2), block_means(after, 2)).repeat(2, axis=0).repeat(2, axis=1)
        shifts = np.pad(coarse, [(0, height - len(coarse)), (0, width - coarse.shape[1]), (0, 0)], mode="edge")
    around = np.pad(before, [(1, 1), (1, 1), (0, 0)], mode="edge")
    across, down = 0.5 * (around[1:-1, 2:] - around[1:-1, :-2]), 0.5 * (around[2:, 1:-1] - around[:-2, 1:-1])
    xx, yy = (_windowed((slope * slope).sum(axis=2)) + STIFFNESS for slope in (across, down))
    xy = _windowed((across * down).sum(axis=2))
    determinant = xx * yy - xy * xy
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    for _ in range(ROUNDS):
        left = sampled(after, columns + shifts[..., 0], rows + shifts[..., 1]) - before
        x, y = _windowed((across * left).sum(axis=2)), _windowed((down * left).sum(axis=2))
        move = np.stack([xy * y - yy * x, xy * x - xx * y], axis=-1) / determinant[..., None]
        shifts = _windowed(shifts + move.clip(-LONGEST, LONGEST), WINDOW // 2)
    return shifts


def sampled(picture: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(..., C): the values of a picture (H, W, C) between the middles of pixels, at these places (...) from the first;
    beyond the edge those of the edge.
    """
    planes = np.moveaxis(picture, 2, 0)
    return np.stack([map_coordinates(plane, (y, x), order=1, mode="nearest") for plane in planes], axis=-1)


def _windowed(values: np.ndarray, side: int = WINDOW) -> np.ndarray:
    """The mean over the square around each pixel."""
    across = uniform_filter(values, (1, side, 1)[: values.ndim], mode="nearest")
    return uniform_filter(across, (side, 1, 1)[: values.ndim], mode="nearest").astype(np.float32)
