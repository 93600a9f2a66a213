"""Photos of a few hundred bytes: polygons on a coarse grid, improved by a search over whole numbers.

1. A few fits give polygons (`fitted_polygons`). Rounding these to the grid costs 1 to 5 dB.
2. A search starts from the best fits and regains nearly all of that (`TinySearch`). It moves a vertex or a whole
   polygon, adds or removes a vertex, and tries many colours with each change. It takes the changes that lower
   loss + price x bytes of the compressed file most.
3. The search with the lowest loss is the result.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import replace
from threading import Event
from typing import TypeVar

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.load import Picture, resize_picture
from cubicsplat_cli.files.read import gzip_size
from cubicsplat_cli.photo.inputs import FitInputs, FitResult
from cubicsplat_cli.photo.remote import begin_fit
from cubicsplat_cli.pipeline.task import Task
from cubicsplat_cli.progress import Progress
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.engine import Pass
from cubicsplat_cli.raster.engines import scene_arrays
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.raster.stack import FEWEST, SLACK, PolygonSteps
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import with_channels
from cubicsplat_cli.settings import FitSettings, cpu_count
from cubicsplat_cli.svg.polygons import LEVELS, TENTHS, GridPolygons, grid_size, polygons_on_grid

# Measured on four Kodak photos, docs/lab/photos.md.
HEAD_BYTES, PATH_BYTES, VERTEX_BYTES = 150, 6.0, 2.25  # of a compressed file, a polygon and each of its vertices
SPARE = 1.3  # times the polygons that probably fit
UNITS_PER_SPACING = 11.0  # of the grid, for the side of a polygon's share of the picture
LEAST_UNITS, MOST_UNITS = 48, 96  # numbers of two digits
PIXELS_PER_UNIT = 2  # of the copy that is fitted
SWEEPS = 30
# The worth of a byte: twice as many make the error about 40 % less. It begins lower; sweeps within the limit lower it.
PRICE, CHEAPER = 0.6, 0.8
GAIN = 1e-4  # of the loss for each polygon; a sweep that gains less is the last
SURPLUS = 0.2  # share of the excess bytes that are removed before the next sweep; that sweep saves some itself
SAVING = 4.0  # bytes, the most that a step usually saves
MOST = 9  # vertices
ROUNDS = 2  # steps of a polygon in a sweep
# The polygons in all fits; the most fits; and those that are searched. Fits differ more the fewer polygons they have.
FITTED, STARTS, SEARCHED = 120, 5, 2
T = TypeVar("T")


def fitted_polygons(most: int, settings: FitSettings, task: Task) -> tuple[GridPolygons, FitResult]:
    """Return the best polygons in `most` compressed bytes, and their fit. Raises InputError if not even one fits."""
    count = max(1, round(SPARE * (most - HEAD_BYTES) / (PATH_BYTES + settings.segments * VERTEX_BYTES)))
    width, height = task.picture.size
    spacings = math.sqrt(count * max(width, height) / min(width, height))  # along the longer side
    units = min(MOST_UNITS, max(LEAST_UNITS, round(UNITS_PER_SPACING * spacings)))
    target = resize_picture(task.target, min(max(task.target.size), PIXELS_PER_UNIT * units))
    pixels, weights = target.target(), task.weights(target)
    starts, threads = min(STARTS, max(1, round(FITTED / count))), settings.threads or cpu_count()
    at_once = 1 if settings.device == "cuda" else min(starts, threads)  # a GPU's engine runs one fit at a time
    limit = settings.time_limit
    if limit is not None:
        limit *= 0.5 / math.ceil(starts / at_once)  # the search has the other half
    # A CPU finishes such a small fit before a GPU starts.
    device = "cpu" if settings.device == "auto" else settings.device
    settings = settings.with_(curves=count, time_limit=limit, threads=threads // at_once, device=device)
    deadline, stop = time.perf_counter() + task.seconds_to_make(), Event()

    def interrupted(_: Progress) -> None:
        if stop.is_set():
            raise KeyboardInterrupt

    def fitted(start: int, first: bool) -> tuple[float, FitResult]:
        seeded, recorder = settings.with_(seed=settings.seed + start), None if start else task.recorder
        on_progress = task.on_progress if first else interrupted
        result = begin_fit(pixels, seeded, FitInputs(weights), on_progress, recorder).finish()
        if result.interrupted:
            stop.set()
        with closing(CpuEngine(settings.threads)) as engine:
            return _loss_of(result.scene, pixels, weights, engine), result

    fits = sorted(_side_by_side(fitted, starts, at_once, stop), key=lambda one: one[0])
    fits = fits[: 1 if stop.is_set() else SEARCHED]
    at_once = min(len(fits), threads)
    began, turns = time.perf_counter(), math.ceil(len(fits) / at_once)
    settings = settings.with_(threads=threads // at_once)

    def searched(place: int, _: bool) -> TinySearch:
        with closing(CpuEngine(settings.threads)) as engine:
            polygons = polygons_on_grid(fits[place][1].scene, grid_size(width, height, units))
            search = TinySearch(polygons, target, weights, engine, settings)
            if search.run(most, began + (place // at_once + 1) * (deadline - began) / turns, stop):
                stop.set()
        return search

    searches = _side_by_side(searched, len(fits), at_once, stop)
    best, (_, result) = min(zip(searches, fits, strict=False), key=lambda pair: pair[0].loss)
    return best.polygons, replace(result, samples=1, interrupted=stop.is_set())  # a side is one edge


def _side_by_side(do: Callable[[int, bool], T], count: int, at_once: int, stop: Event) -> list[T]:
    """Return do(number, first) of the numbers below `count`, of `at_once` at a time; first: in this thread. Once `stop`
    is set, by Ctrl-C in this thread, all later ones but number 0 are skipped.
    """

    def turn(number: int, first: bool) -> list[T]:
        return [do(number, first)] if number == 0 or not stop.is_set() else []

    with ThreadPoolExecutor(max(1, at_once - 1)) as others:
        futures = {k: others.submit(turn, k, False) for k in range(count) if k % at_once}
        own = {k: turn(k, True) for k in range(0, count, at_once)}
        try:
            wait(futures.values())
        except KeyboardInterrupt:
            stop.set()
    return [result for k in range(count) for result in (own[k] if k in own else futures[k].result())]


def _loss_of(scene: Scene, goal: np.ndarray, weights: np.ndarray | None, engine: CpuEngine) -> float:
    """Return the loss of the engine's exact picture against a goal (H, W, C) of the scene's size."""
    goal = with_channels(np.ascontiguousarray(goal, dtype=np.float32), scene.channels)
    exact = RasterSettings("exact", 1.0, 1)  # a side is one edge
    return engine.loss(scene_arrays(scene), exact, Pass(goal, weights=weights))


class TinySearch:
    """A search that improves polygons towards a picture, and reduces their file to a limit. loss: of the engine's
    picture. bytes: of the compressed file. paths: the SVG element of each polygon.
    """

    def __init__(
        self, polygons: GridPolygons, target: Picture, weights: np.ndarray | None, engine: CpuEngine,
        settings: FitSettings,
    ) -> None:  # fmt: skip
        self.polygons, self.engine = polygons, engine
        goal = np.ascontiguousarray(target.target(), dtype=np.float32)
        self.goal, self.weights = with_channels(goal, 4 if polygons.background is None else 3), weights
        self.generator = np.random.default_rng(settings.seed)
        most = FEWEST if settings.shapes == "triangle" else MOST
        scale = np.array(target.size) / polygons.size
        self.steps = PolygonSteps(self.goal, weights, scale, most, settings.threads or cpu_count())
        self._measure()

    def run(self, most: int, deadline: float, stop: Event) -> bool:
        """Sweep until a sweep gains too little, the time is up, or `stop` is set; then shrink the file to `most` bytes.
        Return True if Ctrl-C ended the sweeps. Raises InputError if not even one polygon fits.
        """
        interrupted = False
        try:
            self._sweeps(most, deadline, stop)
        except KeyboardInterrupt:
            interrupted = True
            self._measure()
        while self.bytes > most:
            if len(self.paths) == 1:
                raise InputError(f"not even one polygon fits into {most} bytes; allow at least {self.bytes}")
            self._shrink(most)
        return interrupted

    def _sweeps(self, most: int, deadline: float, stop: Event) -> None:
        price = PRICE * self.loss / max(1, max(self.bytes, most) - HEAD_BYTES)
        for _ in range(SWEEPS):
            before, within = self.loss, self.bytes <= most
            self._sweep(price, most)
            used = most - SAVING < self.bytes <= most
            if (
                stop.is_set()
                or time.perf_counter() > deadline
                or (within and used and self.loss > (1.0 - GAIN * len(self.paths)) * before)
            ):
                break
            if self.bytes > most:
                self._shrink(max(most, self.bytes - max(SAVING, SURPLUS * (self.bytes - most))))
            else:
                price *= CHEAPER

    def _measure(self) -> None:
        self.paths = [self.polygons.path(index) for index in range(len(self.polygons.vertices))]
        self.bytes, self.loss = self._size(), self._loss()

    def _size(self) -> int:
        return gzip_size(self.polygons.head() + "".join(reversed(self.paths)) + "</svg>")

    def _loss(self) -> float:
        height, width = self.goal.shape[:2]
        return _loss_of(self.polygons.scene(width, height), self.goal, self.weights, self.engine)

    def _pays(self, rise: float, size: int, price: float, most: int) -> bool:
        """True if a change that raises the loss by `rise`, and makes the file `size` bytes, is worth taking."""
        return rise + price * (size - self.bytes) < 0.0 and not self.bytes <= most < size

    def _sweep(self, price: float, most: int) -> None:
        """Improve the background, then each polygon, in random order."""
        self._improve_ground(price, most)
        for index in self.generator.permutation(len(self.paths)).tolist():
            self._turn(index)
            for _ in range(ROUNDS):
                if not self._improve(index, price, most):
                    break
        self.loss = self._loss()

    def _turn(self, index: int) -> None:
        """Write a polygon from that vertex on, and in that direction, whose path compresses best."""
        polygons, own = self.polygons, self.polygons.vertices[index]
        best, variants = (self.bytes, own, self.paths[index]), []
        for vertices in (own, own[::-1]):
            for first in range(len(own)):
                polygons.vertices[index] = np.concatenate((vertices[first:], vertices[:first]))
                variants.append((polygons.vertices[index], polygons.path(index)))
        shortest = min(len(path) for _, path in variants)
        for vertices, path in variants:
            if len(path) <= shortest:
                self.paths[index] = path
                best = min(best, (self._size(), vertices, path), key=lambda one: one[0])
        self.bytes, polygons.vertices[index], self.paths[index] = best

    def _improve(self, index: int, price: float, most: int) -> bool:
        """Take the change of a polygon that pays most; return True if there is one."""
        polygons, best = self.polygons, (0.0, 0.0, self.bytes, self._shape(index))
        self._update_steps()
        for score, rise, vertices, colour in self.steps.best(index, price):
            if score - price * SLACK > best[0]:
                break
            polygons.vertices[index], polygons.colours[index] = vertices, colour
            self.paths[index] = polygons.path(index)
            size = self._size()
            gain = rise + price * (size - self.bytes)
            if gain < best[0] and self._pays(rise, size, price, most):
                best = gain, rise, size, self._shape(index)
        polygons.vertices[index], polygons.colours[index], self.paths[index] = best[3]
        self.loss, self.bytes = self.loss + best[1], best[2]
        return best[0] < 0.0

    def _shape(self, index: int) -> tuple[np.ndarray, np.ndarray, str]:
        return self.polygons.vertices[index], self.polygons.colours[index].copy(), self.paths[index]

    def _update_steps(self) -> None:
        """Tell the search for steps the current polygons."""
        polygons = self.polygons
        ground = None if polygons.background is None else polygons.background / LEVELS
        self.steps.take(polygons.vertices, polygons.colours, ground, polygons.opacity / TENTHS)

    def _improve_ground(self, price: float, most: int) -> None:
        """Take changes of the background's colour, and of the opacity of all, that pay."""
        polygons, before = self.polygons, self.polygons.background
        trials: list[tuple[np.ndarray | None, int]] = []
        if polygons.opacity < TENTHS:  # otherwise all stay opaque
            trials += [(before, polygons.opacity + 1), (before, polygons.opacity - 1)]
        if before is not None:
            unit = np.eye(3, dtype=np.int64)
            trials += [(before + step, polygons.opacity) for step in (*unit, *-unit)]
        for background, opacity in trials:
            within = background is None or 0 <= background.min() <= background.max() <= LEVELS
            if within and 1 <= opacity <= TENTHS:
                kept = polygons.background, polygons.opacity
                polygons.background, polygons.opacity = background, opacity
                loss, size = self._loss(), self._size()
                if self._pays(loss - self.loss, size, price, most):
                    self.loss, self.bytes = loss, size
                else:
                    polygons.background, polygons.opacity = kept

    def _shrink(self, most: float) -> None:
        """Remove from each polygon a vertex, or the whole of it, by the least rise of the loss for a byte, until `most`
        bytes are left, or all polygons have changed. One polygon stays.
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
        """Yield each removal: the rise of the loss per saved byte, the polygon, and its vertex, -1 for all of it."""
        self._update_steps()
        for index, vertices in enumerate(self.polygons.vertices):
            *rises, whole = self.steps.removals(index, len(vertices)).tolist()
            for vertex, rise in enumerate(rises):
                yield rise / VERTEX_BYTES, index, vertex
            yield whole / (PATH_BYTES + len(vertices) * VERTEX_BYTES), index, -1
