"""Photos of a few hundred bytes: polygons on a coarse grid, of which a search over whole numbers makes the best.

A few fits give polygons, and rounding them to the grid costs 1 to 5 dB. The search gets nearly all of that back, and
the best of what it finds is taken. It tries steps of one vertex and of a whole polygon, and vertices added and left
out, in many colours each. It takes those that lower loss + price x bytes most, where the bytes are those of the
compressed file.
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
from cubicsplat_cli.photo.loop import fit
from cubicsplat_cli.pipeline.task import Task
from cubicsplat_cli.progress import Progress
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.engines import scene_arrays
from cubicsplat_cli.raster.polygon_steps import FEWEST, SLACK, PolygonSteps
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import with_channels
from cubicsplat_cli.settings import FitSettings, cpu_count
from cubicsplat_cli.svg.polygons import (
    LEVELS,
    TENTHS,
    GridPolygons,
    grid_size,
    is_colour,
    polygons_on_grid,
)

# Measured on four Kodak photos, docs/lab/photos.md.
HEAD_BYTES, PATH_BYTES, VERTEX_BYTES = 150, 6.0, 2.25  # of a compressed file, a polygon and each of its vertices
SPARE = 1.3  # times the polygons that probably fit
UNITS_PER_SPACING = 11.0  # of the grid, for the side of a polygon's share of the picture
LEAST_UNITS, MOST_UNITS = 48, 96  # numbers of two digits
PIXELS_PER_UNIT = 2  # of the copy that is fitted
SWEEPS = 30
# A file twice as large has about 40 % less error, which says what a byte is worth; less of
# that at the beginning, and less and less when the bytes are used up.
PRICE, CHEAPER = 0.6, 0.8
GAIN = 1e-4  # of the loss for each polygon, below which another sweep is not worth its time
SURPLUS = 0.2  # of the bytes that are too many, left out before the next sweep, which saves some itself
SAVING = 4.0  # bytes, the most that a step usually saves
MOST = 9  # vertices
ROUNDS = 2  # steps of a polygon in a sweep
# Polygons that are fitted in all, in fits of which the best are searched: the fewer there are, the more fits differ.
FITTED, STARTS, SEARCHED = 120, 5, 2
T = TypeVar("T")
_EXACT = RasterSettings("exact", 1.0, 1)  # a side is one edge


def fitted_polygons(most: int, settings: FitSettings, task: Task) -> tuple[GridPolygons, FitResult]:
    """The best polygons whose file has at most so many bytes when compressed. Raises InputError where none fits."""
    count = max(1, round(SPARE * (most - HEAD_BYTES) / (PATH_BYTES + settings.segments * VERTEX_BYTES)))
    width, height = task.picture.size
    spacings = math.sqrt(count * max(width, height) / min(width, height))  # along the longer side
    units = min(MOST_UNITS, max(LEAST_UNITS, round(UNITS_PER_SPACING * spacings)))
    target = resize_picture(task.target, min(max(task.target.size), PIXELS_PER_UNIT * units))
    pixels, weights = target.target(), task.weights(target)
    starts, threads = min(STARTS, max(1, round(FITTED / count))), settings.threads or cpu_count()
    at_once = 1 if settings.device == "cuda" else min(starts, threads)  # a GPU's engine does one fit after the other
    limit = settings.time_limit
    if limit is not None:
        limit *= 0.5 / math.ceil(starts / at_once)  # the search has the rest
    # So small a fit is done before a GPU has started.
    device = "cpu" if settings.device == "auto" else settings.device
    settings = settings.with_(curves=count, time_limit=limit, threads=threads // at_once, device=device)
    deadline, stop = time.perf_counter() + task.seconds_to_make(), Event()

    def interrupted(_: Progress) -> None:
        if stop.is_set():
            raise KeyboardInterrupt

    def fitted(start: int, first: bool) -> tuple[float, FitResult]:
        seeded, recorder = settings.with_(seed=settings.seed + start), None if start else task.recorder
        found = fit(pixels, seeded, task.on_progress if first else interrupted, recorder, FitInputs(weights))
        if found.interrupted:
            stop.set()
        with closing(CpuEngine(settings.threads)) as engine:
            return _loss_of(found.scene, pixels, weights, engine), found

    fits = [each for each in _side_by_side(fitted, starts, at_once, stop) if each is not None]
    fits = sorted(fits, key=lambda one: one[0])[: 1 if stop.is_set() else SEARCHED]
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

    results = [each for each in _side_by_side(searched, len(fits), at_once, stop) if each is not None]
    best = min(range(len(results)), key=lambda place: results[place].loss)
    return results[best].polygons, replace(fits[best][1], interrupted=stop.is_set())


def _side_by_side(do: Callable[[int, bool], T], count: int, at_once: int, stop: Event) -> list[T | None]:
    """do(number, whether in this thread) for every number below count, so many at once; but for the first, None where
    `stop` was set before its turn. Ctrl-C comes to this thread, and sets it.
    """

    def turn(number: int, first: bool) -> T | None:
        return do(number, first) if number == 0 or not stop.is_set() else None

    with ThreadPoolExecutor(max(1, at_once - 1)) as others:
        found = {k: others.submit(turn, k, False) for k in range(count) if k % at_once}
        own = {k: turn(k, True) for k in range(0, count, at_once)}
        try:
            wait(found.values())
        except KeyboardInterrupt:
            stop.set()
    return [own[k] if k in own else found[k].result() for k in range(count)]


def _loss_of(scene: Scene, goal: np.ndarray, weights: np.ndarray | None, engine: CpuEngine) -> float:
    """The loss of the engine's exact picture against a goal (H, W, C) of the scene's size."""
    goal = with_channels(np.ascontiguousarray(goal, dtype=np.float32), scene.channels)
    return engine.loss(scene_arrays(scene), _EXACT, goal, weights)


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
        self.generator = np.random.default_rng(settings.seed)
        most = FEWEST if settings.shapes == "triangle" else MOST
        scale = np.array(target.size) / polygons.size
        self.steps = PolygonSteps(self.goal, weights, scale, most, settings.threads or cpu_count())
        self._measure()

    def run(self, most: int, deadline: float, stop: Event) -> bool:
        """Sweeps until that gains nothing any more, the time is up, or, after one sweep, `stop` is set. Returns whether
        Ctrl-C ended it before.
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
        """Whether to take a step by which the loss rises, and the file gets this size."""
        return rise + price * (size - self.bytes) < 0.0 and not self.bytes <= most < size

    def _sweep(self, price: float, most: int) -> None:
        """Improves the background, and then polygon after polygon, in random order."""
        self._improve_ground(price, most)
        for index in self.generator.permutation(len(self.paths)).tolist():
            self._turn(index)
            for _ in range(ROUNDS):
                if not self._improve(index, price, most):
                    break
        self.loss = self._loss()

    def _turn(self, index: int) -> None:
        """Lets a polygon begin at that vertex, and go round that way, whose path compresses best."""
        polygons, own = self.polygons, self.polygons.vertices[index]
        best, found = (self.bytes, own, self.paths[index]), []
        for vertices in (own, own[::-1]):
            for first in range(len(own)):
                polygons.vertices[index] = np.concatenate((vertices[first:], vertices[:first]))
                found.append((polygons.vertices[index], polygons.path(index)))
        shortest = min(len(path) for _, path in found)
        for vertices, path in found:
            if len(path) <= shortest:
                self.paths[index] = path
                best = min(best, (self._size(), vertices, path), key=lambda one: one[0])
        self.bytes, polygons.vertices[index], self.paths[index] = best

    def _improve(self, index: int, price: float, most: int) -> bool:
        """Takes the step of a polygon that pays most, and returns whether there is one."""
        polygons, best = self.polygons, (0.0, 0.0, self.bytes, self._shape(index))
        self._show()
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

    def _show(self) -> None:
        """Tells what looks for steps how the polygons are now."""
        polygons = self.polygons
        ground = None if polygons.background is None else polygons.background / LEVELS
        self.steps.take(polygons.vertices, polygons.colours, ground, polygons.opacity / TENTHS)

    def _improve_ground(self, price: float, most: int) -> None:
        """Takes steps of the background's colour and of the opacity of all."""
        polygons, before = self.polygons, self.polygons.background
        tried: list[tuple[np.ndarray | None, int]] = []
        if polygons.opacity < TENTHS:  # not where all shall be opaque
            tried += [(before, polygons.opacity + 1), (before, polygons.opacity - 1)]
        if before is not None:
            ways = np.concatenate((np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)))
            tried += [(before + way, polygons.opacity) for way in ways]
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
        self._show()
        for index, vertices in enumerate(self.polygons.vertices):
            *rises, whole = self.steps.removals(index, len(vertices)).tolist()
            for vertex, rise in enumerate(rises):
                yield rise / VERTEX_BYTES, index, vertex
            yield whole / (PATH_BYTES + len(vertices) * VERTEX_BYTES), index, -1
