"""The native CPU engine, loaded with ctypes: no headers of Python, numpy or torch on the other side.

The structures mirror kernels/cpu/abi.h field by field. Arrays go in as pointers, so every array handed over must be
contiguous, of the right type, and must outlive the call; the methods here see to that.
"""

from __future__ import annotations

import ctypes
import math
import sys
from ctypes import POINTER, c_char, c_char_p, c_double, c_float, c_int32, c_int64, c_void_p
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.engine import (
    IMPORTANCE,
    OWN_ARRAYS,
    Backward,
    Checkpoint,
    Engine,
    EngineScene,
    Pointer,
    Training,
)
from cubicsplat_cli.raster.settings import SQUARED, Penalty, RasterSettings
from cubicsplat_cli.scene.arrays import Array, kind_of, namespace
from cubicsplat_cli.settings import Mode, cpu_count

ABI_VERSION = 13


def members(kind: Any, names: str) -> list[tuple[str, Any]]:
    """Fields of a structure that are all of one kind, by their names with spaces between them."""
    return [(name, kind) for name in names.split()]


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
        *members(c_float, "keep1 keep2 keep3 epsilon"),
        *members(c_void_p, "blunting tied"),
        ("shared_opacity", c_int32),
    ]


class _Run(ctypes.Structure):
    _fields_ = [
        ("count", c_int32), ("paces", c_void_p), ("seconds", c_double), ("losses", c_void_p), ("done", c_int32),
        ("least", c_double), *members(c_void_p, "points colours opacities half_widths edge_widths"),
    ]  # fmt: skip


@lru_cache(maxsize=1)
def library() -> ctypes.CDLL:
    """Loads the engine. Raises EngineError with the way out where it is missing or of another version."""
    path = Path(__file__).with_name("_cubicsplat" + {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so"))
    try:
        lib = ctypes.CDLL(str(path))
    except OSError as error:
        raise EngineError(
            f"the native engine {path.name} cannot be loaded ({error}); reinstall with `pip install --force-reinstall "
            "cubicsplat` (from source this needs a C++17 compiler)"
        ) from error
    lib.cs_create.restype = c_void_p
    lib.cs_create.argtypes = [c_int32, c_char_p]
    lib.cs_destroy.argtypes = [c_void_p]
    lib.cs_destroy.restype = None
    for name in ("cs_error", "cs_isa"):
        getattr(lib, name).argtypes = [c_void_p]
        getattr(lib, name).restype = c_char_p
    lib.cs_isa_names.restype = c_char_p
    common: list[Any] = [c_void_p, POINTER(_Scene), POINTER(_Settings), POINTER(_Images)]
    lib.cs_render.argtypes = common
    lib.cs_gradients.argtypes = [*common, POINTER(_Gradients)]
    lib.cs_step.argtypes = [*common, POINTER(_Gradients), POINTER(_Training)]
    lib.cs_run.argtypes = [*lib.cs_step.argtypes, POINTER(_Run)]
    lib.cs_timings.argtypes = [c_void_p, POINTER(c_double)]
    lib.cs_counts.argtypes = [c_void_p, POINTER(c_int64)]
    if lib.cs_abi_version() != ABI_VERSION:
        raise EngineError(f"the native engine {path.name} is of another version; reinstall cubicsplat")
    return lib


def native(work: str, name: str, *given: Any, result: type | None = c_int32) -> Any:
    """The result of a function of the library.

    given: contiguous arrays, which it takes as pointers; ints, which addresses are too, and bools, which it takes as
    int64, and floats, as double; None, a null pointer; and objects of ctypes. result: c_int32, which is 0 but on
    failure; c_int64 or c_double, below 0 on failure; c_void_p, null on failure; or None. Raises EngineError where the
    library is missing, or on failure, which is memory that is missing for the `work`.
    """
    found = _function(name, result)(*[_KINDS.get(each.__class__, _in_c)(each) for each in given])
    if result is not None and (found is None or found < 0 or (result is c_int32 and found)):
        raise EngineError(f"there is no memory for the {work} of the drawing; make the picture smaller")
    return found


@cache
def _function(name: str, result: type | None) -> Any:
    function = library()[name]
    function.restype = result
    return function


def memory_of(array: np.ndarray) -> Any:
    """The values of an array that is contiguous by rows, as an object of ctypes that keeps them alive."""
    # Five times faster than `array.ctypes`, which can be had of what may not be written to.
    return _Memory.from_buffer(array.data) if array.flags.writeable else c_void_p(array.ctypes.data)


def address_of(array: np.ndarray) -> int:
    """The address of an array that is contiguous by rows."""
    return ctypes.addressof(_Memory.from_buffer(array.data)) if array.flags.writeable else int(array.ctypes.data)


def _in_c(given: Any) -> Any:
    """Arguments of no type of `_KINDS`: numbers of numpy, memory-mapped arrays, and objects of ctypes."""
    if isinstance(given, np.ndarray):
        return memory_of(given)
    return c_int64(int(given)) if isinstance(given, (int, np.integer)) else given


_Memory = c_char * 0
_KINDS: dict[type, Any] = {np.ndarray: memory_of, int: c_int64, bool: c_int64, float: c_double, np.float64: c_double}


def doubles(array: Any) -> np.ndarray:
    """An array as the library takes it: contiguous, of float64; itself where it is."""
    return np.ascontiguousarray(array, np.float64)


# The same of other types.
floats, int32s, int64s, bools = (partial(np.ascontiguousarray, dtype=t) for t in (np.float32, np.int32, np.int64, bool))


def instruction_sets() -> list[str]:
    """Instruction sets that this build holds and this machine can run, best first."""
    return library().cs_isa_names().decode().split(",")


def pointer_on(device: Any) -> Pointer:
    """Gives addresses of arrays that an engine on this device, torch's or "cpu", can use; see `Pointer`."""

    def pointer(array: Array, name: str, shape: tuple[int, ...], dtype: str) -> int | None:
        if array is None:
            return None
        if tuple(array.shape) == shape and array.dtype == getattr(namespace(array), dtype):
            if isinstance(array, np.ndarray):
                if array.flags.c_contiguous and device == "cpu":
                    return address_of(array)
            elif array.is_contiguous() and str(array.device) == str(device):
                return int(array.data_ptr())
        place = "the CPU" if str(device) == "cpu" else device
        raise EngineError(
            f"{name} must be contiguous on {place}, {dtype} and of shape {shape}, not {array.dtype} "
            f"{tuple(array.shape)}, {kind_of(array)}"
        )

    return pointer


_pointer = pointer_on("cpu")
_FOUND = "gradient of "  # what messages put before the names of arrays to fill


class CpuEngine(Engine):
    """One native engine with its threads and scratch memory. Not to be shared between Python threads.

    threads: worker threads, >= 1 (default: all the process may use). isa: one of `instruction_sets()` (default: the
    best of them).
    """

    name = "cpu"
    device = "cpu"
    at_once = 32

    def __init__(self, threads: int | None = None, isa: str | None = None) -> None:
        self._library = library()
        self.threads = threads or cpu_count()
        self._handle = self._library.cs_create(self.threads, isa.encode() if isa else None)
        if not self._handle:
            raise EngineError(
                f"cannot start the CPU engine with {self.threads} threads and instruction set {isa or 'auto'}; "
                f"this machine can run {', '.join(instruction_sets())}"
            )
        self.isa = self._library.cs_isa(self._handle).decode()

    def take(self, array: Array) -> Array:
        return array

    def close(self) -> None:
        """Frees the threads and the memory; the engine is of no use afterwards."""
        if getattr(self, "_handle", None):
            self._library.cs_destroy(self._handle)
            self._handle = None

    def __del__(self) -> None:
        self.close()

    def _opened(self) -> int:
        """The native engine. Raises EngineError where it is closed: the library would read freed memory."""
        if not self._handle:
            raise EngineError("the engine is closed; open another one")
        return int(self._handle)

    def describe(self) -> dict[str, object]:
        return {"name": self.name, "isa": self.isa, "threads": self.threads}

    def _scene(self, scene: EngineScene) -> _Scene:
        return _Scene(
            curves=scene.curves, segments=scene.points_per_curve // 3, closed=scene.mode is Mode.CLOSED,
            width=scene.width, height=scene.height, channels=scene.channels, rings=scene.most_rings,
            logits=scene.logits, background=(c_float * 4)(*(scene.background or ()), 0.0), most_stops=scene.most_stops,
            **scene.own_addresses(_pointer),
        )  # fmt: skip

    def _images(self, scene: EngineScene, **pictures: Array) -> tuple[_Images, c_double]:
        """Pictures by the names of the structure's fields, ground and metric, and where the loss will be."""
        loss = c_double(0.0)
        pictures |= {"ground": self.ground, "metric": self.metric}
        return _Images(**scene.addresses(_pointer, pictures), loss=ctypes.addressof(loss)), loss

    @staticmethod
    def _settings(settings: RasterSettings, importance: str | None, penalty: Penalty = SQUARED) -> _Settings:
        exact = settings.coverage == "exact"
        return _Settings(
            exact, settings.samples, settings.tolerance, settings.subdivide, settings.edge_width,
            IMPORTANCE[importance], *penalty,
        )  # fmt: skip

    def _check(self, status: int) -> None:
        if status:
            raise EngineError(f"{self._failed}: {self._library.cs_error(self._opened()).decode()}")

    def render(self, scene: EngineScene, settings: RasterSettings) -> Array:
        xp = namespace(scene.points)
        image = xp.empty((scene.height, scene.width, scene.channels), dtype=xp.float32)
        images, _ = self._images(scene, image=image)
        s, t = self._scene(scene), self._settings(settings, None)
        self._check(self._library.cs_render(self._opened(), s, t, images))
        return image

    def loss(
        self, scene: EngineScene, settings: RasterSettings, target: Array, weights: Array | None = None,
        penalty: Penalty = SQUARED,
    ) -> float:  # fmt: skip
        images, loss = self._images(scene, target=target, weights=weights)
        s, t = self._scene(scene), self._settings(settings, None, penalty)
        self._check(self._library.cs_render(self._opened(), s, t, images))
        return loss.value

    def _gradients(self, scene: EngineScene, settings: RasterSettings, wanted: Backward) -> float:
        images, loss = self._images(scene, target=wanted.target, weights=wanted.weights, gradient=wanted.gradient)
        s, t = self._scene(scene), self._settings(settings, wanted.importance, wanted.penalty)
        g = _Gradients(**scene.addresses(_pointer, wanted.out, _FOUND))
        self._check(self._library.cs_gradients(self._opened(), s, t, images, g))
        return loss.value

    def call(self, name: str, scene: EngineScene, settings: RasterSettings, *given: Any) -> None:
        """Calls a function of the library that draws with the engine: it takes that, the scene and the settings, and
        what is given, as by `native`.
        """
        s, t = self._scene(scene), self._settings(settings, None)
        arguments = [_KINDS.get(each.__class__, _in_c)(each) for each in given]
        self._check(_function(name, c_int32)(c_void_p(self._opened()), ctypes.byref(s), ctypes.byref(t), *arguments))

    def step(self, scene: EngineScene, settings: RasterSettings, training: Training) -> float:
        given, loss, _kept = self._for_steps(scene, settings, training)
        self._check(self._library.cs_step(self._opened(), *given))
        return loss.value

    def steps(
        self, scene: EngineScene, settings: RasterSettings, training: Training, paces: np.ndarray, seconds: float,
        best: Checkpoint | None = None,
    ) -> np.ndarray:  # fmt: skip
        given, _loss, _kept = self._for_steps(scene, settings, training)
        losses = np.empty(len(paces))
        kept = {} if best is None else {n: getattr(best.curves, n) for n in OWN_ARRAYS if n != "ring_ends"}
        run = _Run(
            len(paces), address_of(paces), seconds, address_of(losses), 0, math.inf if best is None else best.loss,
            **scene.addresses(_pointer, kept, "best "),
        )  # fmt: skip
        try:
            self._check(self._library.cs_run(self._opened(), *given, run))
        finally:  # as far as Ctrl-C is concerned, too, which comes after it
            if best is not None:
                best.loss = run.least
        return losses[: run.done]

    def _for_steps(self, scene: EngineScene, settings: RasterSettings, training: Training) -> tuple[Any, Any, Any]:
        """What the library takes for steps, where the loss of one will be, and what else must outlive the call."""
        images, loss = self._images(
            scene, target=training.target, weights=training.weights, gradient=training.image_gradient,
            image=training.image,
        )  # fmt: skip
        found = {
            "points": training.of_points, "importance": training.importance, "frames": training.frames_gradient,
            "stops": training.stops_gradient,
        }  # fmt: skip
        g = _Gradients(**scene.addresses(_pointer, found, _FOUND))
        s, t = self._scene(scene), self._settings(settings, training.wanted_importance, training.penalty)
        further = {"points_gradient": training.points_gradient, "rate_scale": training.rate_scale}
        state, rates = training.state, training.rates
        update = _Training(
            s.points, s.colours, s.opacities, s.half_widths, s.edge_widths,
            *scene.addresses(_pointer, vars(state) | further).values(),
            rates.points, rates.colours, rates.opacities, rates.half_widths, rates.edge_widths, *rates.keep,
            rates.epsilon, shared_opacity=training.shared_opacity,
        )  # fmt: skip
        tied = None
        if training.tied is not None:
            tied = _Tied(*map(address_of, training.tied), training.tied[-1].shape[1])
            update.tied = ctypes.addressof(tied)
        if training.blunting is not None:
            update.blunting = ctypes.addressof(training.blunting)
        return (s, t, images, g, update), loss, tied

    def timings(self) -> dict[str, float]:
        seconds = (c_double * 4)()
        self._library.cs_timings(self._opened(), seconds)
        return dict(zip(("flatten", "bin", "raster", "update"), seconds, strict=True))

    def counts(self) -> dict[str, int]:
        """Pairs by class, and the edges listed for the boundary pairs."""
        counts = (c_int64 * 4)()
        self._library.cs_counts(self._opened(), counts)
        return dict(zip(("outside", "inside", "boundary", "edges"), counts, strict=True))
