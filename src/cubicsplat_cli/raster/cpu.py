"""The engine of the CPU, by the native library. The structures mirror kernels/cpu/abi.h field by field."""

from __future__ import annotations

import ctypes
import math
from ctypes import POINTER, byref, c_char_p, c_double, c_float, c_int32, c_int64, c_void_p
from typing import Any

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.engine import IMPORTANCE, MOVED, Checkpoint, Engine, EngineScene, Pass, Training
from cubicsplat_cli.raster.native import address_of, function, members
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene.arrays import Array, namespace
from cubicsplat_cli.settings import Mode, cpu_count


class _Scene(ctypes.Structure):
    _fields_ = [
        *members(c_int32, "curves segments closed width height channels rings"),
        *members(c_void_p, "ring_ends points colours opacities half_widths edge_widths"),
        ("logits", c_int32), ("background", c_float * 4), *members(c_void_p, "kinds counts frames offsets stops"),
        ("most_stops", c_int32),
    ]  # fmt: skip


class _Settings(ctypes.Structure):
    _fields_ = [
        *members(c_int32, "exact samples"), ("tolerance", c_float), ("subdivide", c_int32), ("edge_width", c_float),
        ("importance", c_int32), *members(c_float, "squares robust knee"),
    ]  # fmt: skip


class _Images(ctypes.Structure):
    _fields_ = members(c_void_p, "target weights gradient image loss ground metric")


class _Gradients(ctypes.Structure):
    _fields_ = members(c_void_p, "points colours opacities half_widths edge_widths importance background frames stops")


class Blunting(ctypes.Structure):
    """The penalty on spikes and slivers of a `Training`: see kernels/shared/spikes.h."""

    _fields_ = [
        *members(c_double, "turns slivers loss"), ("loss_at", c_void_p),
        *members(c_float, "turn arm thinnest opposite"), *members(c_int32, "edges every left"),
        ("gradient", c_void_p),
    ]  # fmt: skip


class _Tied(ctypes.Structure):
    _fields_ = [*members(c_void_p, "values moments ages map"), ("count", c_int32)]


class _Training(ctypes.Structure):
    _fields_ = [
        *members(c_void_p, "points colours opacities half_widths edge_widths moments edge_moments ages"),
        *members(c_void_p, "points_gradient rate_scale"),
        *members(c_float, "rate_points rate_colours rate_opacities rate_half_widths rate_edge_widths"),
        *members(c_float, "keep1 keep2 keep3 epsilon"), *members(c_void_p, "blunting tied"),
        ("shared_opacity", c_int32),
    ]  # fmt: skip


class _Run(ctypes.Structure):
    _fields_ = [
        ("count", c_int32), ("paces", c_void_p), ("seconds", c_double), ("losses", c_void_p), ("done", c_int32),
        ("least", c_double), *members(c_void_p, "points colours opacities half_widths edge_widths"),
    ]  # fmt: skip


class NativeTrack(ctypes.Structure):
    """Numbers of moving curves on knots: `CsKnotTrack` in abi.h."""

    _fields_ = [
        ("numbers", c_int64), *members(c_void_p, "before after share steps held"), ("bounded", c_int64),
        *members(c_void_p, "values means squares ages"),
    ]  # fmt: skip


class FrameSteps(ctypes.Structure):
    """Steps of the knots of moving curves: `CsFrameSteps` in abi.h."""

    _fields_ = [
        ("curves", c_int64), ("tracks", POINTER(NativeTrack)), ("count", c_int64),
        *members(c_void_p, "frames targets rates"), *members(c_double, "keep_mean keep_square epsilon"),
    ]  # fmt: skip


def instruction_sets() -> list[str]:
    """Return the instruction sets that this build holds and this machine can run, best first."""
    return function("cs_isa_names", c_char_p)().decode().split(",")


class CpuEngine(Engine):
    """A native engine with its threads and scratch memory. Python threads must not share one.

    threads: >= 1 (default: all that the process may use). isa: one of `instruction_sets()` (default: the best).
    """

    name = "cpu"
    device = "cpu"
    at_once = 32

    def __init__(self, threads: int | None = None, isa: str | None = None) -> None:
        self.threads = threads or cpu_count()
        self._handle = c_void_p(function("cs_create", c_void_p)(self.threads, isa.encode() if isa else None))
        if not self._handle:
            text = f"cannot start the CPU engine with {self.threads} threads and instruction set {isa or 'auto'}"
            raise EngineError(f"{text}; this machine can run {', '.join(instruction_sets())}")
        self.isa = function("cs_isa", c_char_p)(self._handle).decode()

    def take(self, array: Array) -> Array:
        return array

    def close(self) -> None:
        """Free the threads and the memory; later calls raise EngineError."""
        if getattr(self, "_handle", None):
            self._call("cs_destroy", None)
            self._handle = c_void_p()

    def __del__(self) -> None:
        self.close()

    def describe(self) -> dict[str, object]:
        return {"name": self.name, "isa": self.isa, "threads": self.threads}

    def _call(self, name: str, result: type | None, *given: Any) -> Any:
        """Call a native function with pointers to objects of ctypes. Raises EngineError if the engine is freed."""
        if not self._handle:
            raise EngineError("the engine is closed; open another one")
        return function(name, result)(self._handle, *map(byref, given))

    def _draw(
        self, name: str, scene: EngineScene, settings: RasterSettings, given: Pass, *further: ctypes.Structure
    ) -> float:
        """Call a function of the native engine that draws the scene. Return the loss. further: its last structures."""
        curves = _Scene(
            curves=scene.curves, segments=scene.points_per_curve // 3, closed=scene.mode is Mode.CLOSED,
            width=scene.width, height=scene.height, channels=scene.channels, rings=scene.most_rings,
            logits=scene.logits, background=(c_float * 4)(*(scene.background or ()), 0.0), most_stops=scene.most_stops,
            **scene.own_addresses(self.device),
        )  # fmt: skip
        coverage = _Settings(
            settings.coverage == "exact", settings.samples, settings.tolerance, settings.subdivide, settings.edge_width,
            IMPORTANCE[given.importance], *given.penalty,
        )  # fmt: skip
        loss = c_double(0.0)
        pictures = given.pictures | {"image": given.image, "ground": self.ground, "metric": self.metric}
        images = _Images(**scene.addresses(self.device, pictures), loss=ctypes.addressof(loss))
        if self._call(name, c_int32, curves, coverage, images, *further):
            raise EngineError(f"{self._failed}: {self._call('cs_error', c_char_p).decode()}")
        return loss.value

    def render(self, scene: EngineScene, settings: RasterSettings) -> Array:
        xp = namespace(scene.points)
        image = xp.empty((scene.height, scene.width, scene.channels), dtype=xp.float32)
        self._draw("cs_render", scene, settings, Pass(None, image=image))
        return image

    def loss(self, scene: EngineScene, settings: RasterSettings, given: Pass) -> float:
        return self._draw("cs_render", scene, settings, given)

    def _gradients(self, scene: EngineScene, settings: RasterSettings, given: Pass) -> float:
        gradients = _Gradients(**scene.addresses(self.device, given.out, "gradient of "))
        return self._draw("cs_gradients", scene, settings, given, gradients)

    def step_frames(self, canvas: EngineScene, settings: RasterSettings, steps: FrameSteps) -> None:
        """Do steps of the knots of moving curves. canvas: any scene on their canvas."""
        self._draw("cs_step_frames", canvas, settings, Pass(None), steps)

    def steps(
        self, scene: EngineScene, settings: RasterSettings, training: Training, paces: np.ndarray, seconds: float,
        best: Checkpoint | None = None,
    ) -> np.ndarray:  # fmt: skip
        losses = np.zeros(len(paces))
        kept = {} if best is None else {name: getattr(best.curves, name) for name in MOVED}
        run = _Run(
            len(paces), address_of(paces), seconds, address_of(losses), 0, math.inf if best is None else best.loss,
            **scene.addresses(self.device, kept, "best "),
        )  # fmt: skip
        gradients = _Gradients(**scene.addresses(self.device, training.out, "gradient of "))
        further = {"points_gradient": training.points_gradient, "rate_scale": training.rate_scale}
        moved = {name: getattr(scene, name) for name in MOVED} | vars(training.state) | further
        rates = training.rates
        update = _Training(
            *scene.addresses(self.device, moved).values(), *rates.sizes, *rates.keep, rates.epsilon,
            shared_opacity=training.shared_opacity,
        )  # fmt: skip
        if training.tied is not None:
            tied = _Tied(*map(address_of, training.tied), training.tied[-1].shape[1])
            update.tied = ctypes.addressof(tied)
        if training.blunting is not None:
            update.blunting = ctypes.addressof(training.blunting)
        try:
            self._draw("cs_run", scene, settings, training, gradients, update, run)
        finally:  # Ctrl-C comes after the call, and must find the loss of the curves that were kept
            if best is not None:
                best.loss = run.least
        return losses[: run.done]

    def timings(self) -> dict[str, float]:
        seconds = (c_double * 4)()
        self._call("cs_timings", None, seconds)
        return dict(zip(("flatten", "bin", "raster", "update"), seconds, strict=True))

    def counts(self) -> dict[str, int]:
        """Return the pairs by class, and the number of edges listed for the boundary pairs."""
        counts = (c_int64 * 4)()
        self._call("cs_counts", None, counts)
        return dict(zip(("outside", "inside", "boundary", "edges"), counts, strict=True))
