"""Photos of a few hundred bytes: polygons on a coarse grid, of which a search over whole numbers makes the best.

The fit gives the polygons, and rounding them to the grid costs 1 to 5 dB. The search gets nearly all of that back. It
tries steps of one coordinate, of a whole polygon and of a colour, and vertices added and left out. It keeps those that
lower loss + price x bytes: the loss of the engine's exact picture, and the bytes of the compressed file.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.load import Picture, resize_picture
from cubicsplat_cli.files.read import packed
from cubicsplat_cli.photo.fitting import fit
from cubicsplat_cli.photo.inputs import FitInputs, FitResult
from cubicsplat_cli.pipeline.task import Task
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.engine import EngineScene
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene.arrays import with_channels
from cubicsplat_cli.settings import FitSettings, Mode
from cubicsplat_cli.svg.polygons import (
    FEWEST,
    LEVELS,
    TENTHS,
    GridPolygons,
    Shape,
    Step,
    coloured,
    grid_size,
    is_colour,
    moved,
    polygons_on_grid,
    with_more,
    without,
)

# Measured on four Kodak photos, docs/lab/photos.md.
HEAD_BYTES, PATH_BYTES, VERTEX_BYTES = 150, 6.0, 2.25  # of a compressed file, a polygon and each of its vertices
SPARE = 1.1  # times the polygons that probably fit
UNITS_PER_SPACING = 11.0  # of the grid, for the side of a polygon's share of the picture
LEAST_UNITS, MOST_UNITS = 48, 96  # numbers of two digits
PIXELS_PER_UNIT = 2  # of the copy that is fitted
SWEEPS = 16
# A file twice as large has about 40 % less error, which says what a byte is worth; less of
# that at the beginning, and less and less when the bytes are used up.
PRICE, CHEAPER = 0.4, 0.6
GAIN = 6e-3  # of the loss, below which another sweep is not worth its time
SURPLUS = 0.4  # of the bytes that are too many, left out before the next sweep, which saves some itself
SAVING = 4.0  # bytes, the most that a step usually saves
MOST = 9  # vertices
_EXACT = RasterSettings("exact", 1.0, 1)  # a side is one edge


def fitted_polygons(most: int, settings: FitSettings, task: Task) -> tuple[GridPolygons, FitResult]:
    """The best polygons whose file has at most so many bytes when compressed. Raises InputError where none fits."""
    count = max(1, round(SPARE * (most - HEAD_BYTES) / (PATH_BYTES + settings.segments * VERTEX_BYTES)))
    width, height = task.picture.size
    spacings = math.sqrt(count * max(width, height) / min(width, height))  # along the longer side
    units = min(MOST_UNITS, max(LEAST_UNITS, round(UNITS_PER_SPACING * spacings)))
    target = resize_picture(task.target, min(max(task.target.size), PIXELS_PER_UNIT * units))
    weights, deadline = task.weights(target), time.perf_counter() + task.seconds_to_make()
    half = None if settings.time_limit is None else 0.5 * settings.time_limit  # the search has the rest
    settings = settings.with_(curves=count, time_limit=half)
    fitted = fit(target.target(), settings, task.on_progress, task.recorder, FitInputs(weights))
    with closing(CpuEngine(settings.threads)) as engine:
        search = TinySearch(
            polygons_on_grid(fitted.scene, grid_size(width, height, units)), target, weights, engine, settings
        )
        interrupted = search.run(most, deadline)
    return search.polygons, replace(fitted, interrupted=fitted.interrupted or interrupted)


class TinySearch:
    """Improves polygons towards a picture, and makes their file as small as is asked for.

    loss: of the engine's picture; bytes: of the compressed file; paths: the element of each polygon.
    """

    def __init__(
        self, polygons: GridPolygons, target: Picture, weights: np.ndarray | None, engine: CpuEngine,
        settings: FitSettings,
    ) -> None:  # fmt: skip
        self.polygons, self.engine = polygons, engine
        goal = np.ascontiguousarray(target.target(), dtype=np.float32)
        self.goal, self.weights = with_channels(goal, 4 if polygons.background is None else 3), weights
        self.scale = np.array(target.size) / polygons.size
        self.generator = np.random.default_rng(settings.seed)
        self.most_vertices = FEWEST if settings.shapes == "triangle" else MOST
        self._measure()

    def run(self, most: int, deadline: float) -> bool:
        """Sweeps until that gains nothing any more, or the time is up. Returns whether Ctrl-C ended it before."""
        interrupted = False
        try:
            self._sweeps(most, deadline)
        except KeyboardInterrupt:
            interrupted = True
            self._measure()
        while self.bytes > most:
            if len(self.paths) == 1:
                raise InputError(f"not even one polygon fits into {most} bytes; allow at least {self.bytes}")
            self._shrink(most)
        return interrupted

    def _sweeps(self, most: int, deadline: float) -> None:
        price = PRICE * self.loss / max(1, max(self.bytes, most) - HEAD_BYTES)
        for _ in range(SWEEPS):
            before, within = self.loss, self.bytes <= most
            self._sweep(price, most)
            if time.perf_counter() > deadline or (within and self.loss > (1.0 - GAIN) * before):
                break
            if self.bytes > most:
                self._shrink(max(most, self.bytes - max(SAVING, SURPLUS * (self.bytes - most))))
            else:
                price *= CHEAPER

    def _measure(self) -> None:
        polygons, n = self.polygons, len(self.polygons.vertices)
        self.paths = [polygons.path(index) for index in range(n)]
        # With an edge for each side only the first of its control points counts.
        self.points, self.boxes = np.zeros((n, 3 * MOST, 2), np.float32), np.zeros((2, n, 2))
        self.ends, self.colours = np.zeros((n, 1), np.int32), (polygons.colours / LEVELS).astype(np.float32)
        for index in range(n):
            self._put(index)
        self.bytes, self.loss = self._size(), self._loss()

    def _put(self, index: int) -> None:
        """Takes a polygon over to where the engine's scenes have it from."""
        vertices = self.polygons.vertices[index] * self.scale
        self.points[index, : 3 * len(vertices) : 3] = vertices
        self.ends[index], self.boxes[:, index] = len(vertices), (vertices.min(axis=0), vertices.max(axis=0))
        self.colours[index] = self.polygons.colours[index] / LEVELS

    def _size(self) -> int:
        return len(packed(self.polygons.head() + "".join(reversed(self.paths)) + "</svg>", compressed=True))

    def scene(self, low: np.ndarray, high: np.ndarray, near: np.ndarray | slice = slice(None)) -> EngineScene:
        """The polygons `near` in the part of the picture from `low` to `high`, px."""
        n, (width, height) = len(self.colours[near]), (high - low).tolist()
        ground = self.polygons.background
        return EngineScene(
            Mode.CLOSED, width, height, self.points[near] - low.astype(np.float32), self.colours[near],
            np.full(n, self.polygons.opacity / TENTHS, np.float32), np.zeros(n, np.float32),
            None if ground is None else tuple((ground / LEVELS).tolist()), self.ends[near],
        )  # fmt: skip

    def _scene(self) -> EngineScene:
        return self.scene(np.zeros(2, np.int64), np.array(self.goal.shape[1::-1]))

    def _loss(self) -> float:
        return self.engine.loss(self._scene(), _EXACT, self.goal, self.weights)

    def _pays(self, rise: float, size: int, price: float, most: int) -> bool:
        """Whether to take a step by which the loss rises, and the file gets this size."""
        return rise + price * (size - self.bytes) < 0.0 and not self.bytes <= most < size

    def _sweep(self, price: float, most: int) -> None:
        """Tries all steps once, polygon after polygon, in random order."""
        _, slopes = self.engine.gradients(self._scene(), _EXACT, target=self.goal, weights=self.weights)
        self._improve_ground(slopes["background"], price, most)
        for index in self.generator.permutation(len(self.paths)).tolist():
            of_vertices = slopes["points"][index, : 3 * len(self.polygons.vertices[index]) : 3]
            steps = self._steps(of_vertices, slopes["colours"][index])
            self._improve(index, [steps[k] for k in self.generator.permutation(len(steps))], price, most)
        self.loss = self._loss()

    def _steps(self, of_vertices: np.ndarray, of_colour: np.ndarray) -> list[Step]:
        """All steps of a polygon, downhill by the gradients of its vertices (n, 2) and of its colour (3,)."""
        n, axes = len(of_vertices), np.eye(2, dtype=np.int64)
        ways = [(j, axes[axis] * _down(of_vertices[j, axis])) for j in range(n) for axis in (0, 1)]
        steps = [moved(j, way) for j, way in ways]
        steps += [moved(slice(None), axes[axis] * _down(of_vertices[:, axis].sum())) for axis in (0, 1)]
        steps += [coloured(np.eye(3, dtype=np.int64)[k] * _down(of_colour[k])) for k in range(3)]
        steps += [without(j) for j in range(n)]
        some = self.generator.permutation(len(ways))[:n].tolist()  # all take longer and give no more
        return steps + [with_more(ways[k][0], ways[k][1], self.most_vertices) for k in some]

    def _improve(self, index: int, steps: list[Step], price: float, most: int) -> None:
        """Takes the steps of a polygon that pay, looking at the part of the picture that they can change alone."""
        polygons, window = self.polygons, _SweptArea(self, index)
        loss = window.loss()
        for step in steps:
            kept = polygons.vertices[index], polygons.colours[index].copy(), self.paths[index]
            shape = step(kept[:2])
            if shape is None:
                continue
            window.put(shape)
            rise = window.loss() - loss
            if rise < price * SAVING:
                polygons.vertices[index], polygons.colours[index] = shape
                self.paths[index] = polygons.path(index)
                size = self._size()
                if self._pays(rise, size, price, most):
                    loss, self.bytes = loss + rise, size
                    continue
                polygons.vertices[index], polygons.colours[index], self.paths[index] = kept
            window.put(kept[:2])
        self._put(index)

    def _improve_ground(self, slopes: np.ndarray, price: float, most: int) -> None:
        """The same for the background's colour and the opacity of all."""
        polygons, before = self.polygons, self.polygons.background
        tried: list[tuple[np.ndarray | None, int]] = []
        if polygons.opacity < TENTHS:  # not where all shall be opaque
            tried += [(before, polygons.opacity + 1), (before, polygons.opacity - 1)]
        if before is not None:
            tried += [(before + np.eye(3, dtype=np.int64)[k] * _down(slopes[k]), polygons.opacity) for k in range(3)]
        for background, opacity in tried:
            if 1 <= opacity <= TENTHS and (background is None or is_colour(background)):
                kept = polygons.background, polygons.opacity
                polygons.background, polygons.opacity = background, opacity
                loss, size = self._loss(), self._size()
                if self._pays(loss - self.loss, size, price, most):
                    self.loss, self.bytes = loss, size
                else:
                    polygons.background, polygons.opacity = kept

    def _shrink(self, most: float) -> None:
        """Leaves out what gives least for a byte, a vertex or all of each polygon, until at most so many bytes are left
        or nothing more can be told without another look. One polygon stays.
        """
        polygons, changed = self.polygons, set[int]()
        for _, index, vertex in sorted(self._rises(), key=lambda rise: rise[0]):
            if index in changed or (vertex < 0 and sum(map(bool, self.paths)) == 1):
                continue
            changed.add(index)
            if vertex >= 0:
                polygons.vertices[index] = np.delete(polygons.vertices[index], vertex, axis=0)
            self.paths[index] = "" if vertex < 0 else polygons.path(index)
            if self._size() <= most:
                break
        kept = [index for index, path in enumerate(self.paths) if path]
        polygons.vertices, polygons.colours = [polygons.vertices[index] for index in kept], polygons.colours[kept]
        self._measure()

    def _rises(self) -> Iterator[tuple[float, int, int]]:
        """By how much the loss rises for each byte that is saved, a polygon, and the vertex without which; -1: all."""
        for index in range(len(self.paths)):
            window, (vertices, colour) = (
                _SweptArea(self, index),
                (self.polygons.vertices[index], self.polygons.colours[index]),
            )
            before = window.loss()
            for vertex in range(len(vertices)) if len(vertices) > FEWEST else ():
                window.put((np.delete(vertices, vertex, axis=0), colour))
                yield (window.loss() - before) / VERTEX_BYTES, index, vertex
            window.put((vertices[:1], colour))  # which covers nothing
            yield (window.loss() - before) / (PATH_BYTES + len(vertices) * VERTEX_BYTES), index, -1


class _SweptArea:
    """The part of the picture in which a sweep's steps of one polygon show, and the polygons that reach into it."""

    def __init__(self, search: TinySearch, index: int) -> None:
        (lows, highs), size = search.boxes, np.array(search.goal.shape[1::-1])
        reach = 2.0 * search.scale + 1.0  # a coordinate moves by two units at most
        low = np.clip(np.floor(lows[index] - reach), 0, size - 1).astype(int)
        high = np.clip(np.ceil(highs[index] + reach), low + 1, size).astype(int)
        near = ((highs >= low) & (lows <= high)).all(axis=1)
        near[index] = True
        part = slice(low[1], high[1]), slice(low[0], high[0])
        self.goal = np.ascontiguousarray(search.goal[part])
        self.weights = None if search.weights is None else np.ascontiguousarray(search.weights[part])
        self.place, self.low, self.scale, self.engine = int(near[:index].sum()), low, search.scale, search.engine
        self.scene, self.ends = search.scene(low, high, near), search.ends[near]
        self.scene.ring_ends = self.ends

    def put(self, shape: Shape) -> None:
        """Gives the polygon other vertices and another colour."""
        vertices, colour = shape
        self.scene.points[self.place, : 3 * len(vertices) : 3] = vertices * self.scale - self.low
        self.ends[self.place] = len(vertices)
        self.scene.colours[self.place] = colour / LEVELS

    def loss(self) -> float:
        return self.engine.loss(self.scene, _EXACT, self.goal, self.weights)


def _down(slope: float) -> int:
    return -1 if slope > 0.0 else 1
