"""The native library, loaded with ctypes: calls of its functions, and the engine of the CPU.

It knows no headers of Python, numpy or torch. The structures mirror kernels/cpu/abi.h field by field. Arrays go in as
pointers, so each must be contiguous, of the right type, and must outlive the call.
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
    MOVED,
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
    """Return fields of a structure that are all of one kind. names: theirs, with spaces between them."""
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


@lru_cache(maxsize=1)
def library() -> ctypes.CDLL:
    """Load the library. Raises EngineError with the way out if it is missing or of another version."""
    path = Path(__file__).with_name("_cubicsplat" + {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so"))
    try:
        lib = ctypes.CDLL(str(path))
    except OSError as error:
        raise EngineError(
            f"the native engine {path.name} cannot be loaded ({error}); reinstall with `pip install --force-reinstall "
            "cubicsplat` (from source this needs a C++17 compiler)"
        ) from error
    step = [c_void_p, *map(POINTER, (_Scene, _Settings, _Images, _Gradients, _Training))]
    signatures: dict[str, tuple[Any, list[Any]]] = {
        "cs_create": (c_void_p, [c_int32, c_char_p]), "cs_destroy": (None, [c_void_p]),
        "cs_error": (c_char_p, [c_void_p]), "cs_isa": (c_char_p, [c_void_p]), "cs_isa_names": (c_char_p, []),
        "cs_render": (c_int32, step[:4]), "cs_gradients": (c_int32, step[:5]), "cs_step": (c_int32, step),
        "cs_run": (c_int32, [*step, POINTER(_Run)]), "cs_timings": (None, [c_void_p, POINTER(c_double)]),
        "cs_counts": (None, [c_void_p, POINTER(c_int64)]),
        "cs_step_frames": (c_int32, [*step[:4], POINTER(FrameSteps)]),
    }  # fmt: skip
    for name, (result, arguments) in signatures.items():
        function = getattr(lib, name)
        function.restype, function.argtypes = result, arguments
    if lib.cs_abi_version() != ABI_VERSION:
        raise EngineError(f"the native engine {path.name} is of another version; reinstall cubicsplat")
    return lib


class Out:
    """An array of zeros that a native function fills: `native` passes it on, and returns it."""

    def __init__(self, shape: Any, dtype: Any = np.float64) -> None:
        self.array = np.zeros(shape, dtype)


def native(work: str, name: str, *given: Any, result: type | None = c_int32) -> Any:
    """Call a function of the library. Return the arrays of its `Out`s, a tuple if there are several; without any
    return its result.

    given: contiguous arrays and `Out`s, passed as pointers; ints, which addresses are too, and bools, passed as int64;
    floats, passed as double; None, a null pointer; and objects of ctypes.
    result: c_int32, 0 unless the call fails; c_int64 or c_double, below 0 if it fails; c_void_p, null if it fails; or
    None. With c_int64 it is a count, and only so many first rows of each `Out` are returned.
    Raises EngineError if the library is missing, or if the call fails: then memory is missing for the `work`.
    """
    value = _function(name, result)(*[_KINDS.get(argument.__class__, _in_c)(argument) for argument in given])
    if result is not None and (value is None or value < 0 or (result is c_int32 and value)):
        raise EngineError(f"there is no memory for the {work} of the drawing; make the picture smaller")
    arrays = [argument.array for argument in given if argument.__class__ is Out]
    if not arrays:
        return value
    if result is c_int64:
        arrays = [array[:value].copy() for array in arrays]
    return tuple(arrays) if len(arrays) > 1 else arrays[0]


@cache
def _function(name: str, result: type | None) -> Any:
    function = library()[name]
    function.restype = result
    return function


def _memory_of(array: np.ndarray) -> Any:
    """Return the values of an array that is contiguous by rows, as an object of ctypes that keeps them alive."""
    # Five times faster than `array.ctypes`, which also works for arrays that are not writeable.
    return _Memory.from_buffer(array.data) if array.flags.writeable else c_void_p(array.ctypes.data)


def address_of(array: np.ndarray) -> int:
    """Return the address of an array that is contiguous by rows."""
    return ctypes.addressof(_Memory.from_buffer(array.data)) if array.flags.writeable else int(array.ctypes.data)


def _in_c(given: Any) -> Any:
    """Convert an argument of a type that `_KINDS` lacks: a number of numpy, memory-mapped array, object of ctypes."""
    if isinstance(given, np.ndarray):
        return _memory_of(given)
    return c_int64(int(given)) if isinstance(given, (int, np.integer)) else given


_Memory = c_char * 0
_KINDS: dict[type, Any] = {
    np.ndarray: _memory_of, Out: lambda out: _memory_of(out.array), int: c_int64, bool: c_int64, float: c_double,
    np.float64: c_double,
}  # fmt: skip
# Contiguous arrays of one type, as the library takes them; an array that is one already stays the same object.
doubles, floats, int32s, int64s, bools = (
    partial(np.ascontiguousarray, dtype=t) for t in (np.float64, np.float32, np.int32, np.int64, bool)
)


def instruction_sets() -> list[str]:
    """Return the instruction sets that this build holds and this machine can run, best first."""
    return library().cs_isa_names().decode().split(",")


def pointer_on(device: Any) -> Pointer:
    """Return a `Pointer` for the arrays that an engine on this device, torch's or "cpu", can use."""

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


class CpuEngine(Engine):
    """A native engine with its threads and scratch memory. Python threads must not share one.

    threads: worker threads, >= 1 (default: all that the process may use). isa: one of `instruction_sets()` (default:
    the best of them).
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
        """Free the threads and the memory; later calls raise EngineError."""
        if getattr(self, "_handle", None):
            self._library.cs_destroy(self._handle)
            self._handle = None

    def __del__(self) -> None:
        self.close()

    def _opened(self) -> int:
        """Return the native engine. Raises EngineError if it is closed: the library would read freed memory."""
        if not self._handle:
            raise EngineError("the engine is closed; open another one")
        return int(self._handle)

    def describe(self) -> dict[str, object]:
        return {"name": self.name, "isa": self.isa, "threads": self.threads}

    def _call(
        self, function: str, scene: EngineScene, settings: RasterSettings, *further: ctypes.Structure,
        importance: str | None = None, penalty: Penalty = SQUARED, **pictures: Array,
    ) -> float:  # fmt: skip
        """Call a function of the library that draws the scene. Return the loss.

        further: its structures after the first three. pictures: by the names of the fields of `_Images`.
        """
        curves = _Scene(
            curves=scene.curves, segments=scene.points_per_curve // 3, closed=scene.mode is Mode.CLOSED,
            width=scene.width, height=scene.height, channels=scene.channels, rings=scene.most_rings,
            logits=scene.logits, background=(c_float * 4)(*(scene.background or ()), 0.0), most_stops=scene.most_stops,
            **scene.own_addresses(_pointer),
        )  # fmt: skip
        coverage = _Settings(
            settings.coverage == "exact", settings.samples, settings.tolerance, settings.subdivide, settings.edge_width,
            IMPORTANCE[importance], *penalty,
        )  # fmt: skip
        loss = c_double(0.0)
        pictures |= {"ground": self.ground, "metric": self.metric}
        images = _Images(**scene.addresses(_pointer, pictures), loss=ctypes.addressof(loss))
        if getattr(self._library, function)(self._opened(), curves, coverage, images, *further):
            raise EngineError(f"{self._failed}: {self._library.cs_error(self._opened()).decode()}")
        return loss.value

    def render(self, scene: EngineScene, settings: RasterSettings) -> Array:
        xp = namespace(scene.points)
        image = xp.empty((scene.height, scene.width, scene.channels), dtype=xp.float32)
        self._call("cs_render", scene, settings, image=image)
        return image

    def loss(
        self, scene: EngineScene, settings: RasterSettings, target: Array, weights: Array | None = None,
        penalty: Penalty = SQUARED,
    ) -> float:  # fmt: skip
        return self._call("cs_render", scene, settings, penalty=penalty, target=target, weights=weights)

    def _gradients(self, scene: EngineScene, settings: RasterSettings, wanted: Backward) -> float:
        gradients = _Gradients(**scene.addresses(_pointer, wanted.out, "gradient of "))
        return self._call(
            "cs_gradients", scene, settings, gradients, importance=wanted.importance, penalty=wanted.penalty,
            target=wanted.target, weights=wanted.weights, gradient=wanted.gradient,
        )  # fmt: skip

    def step_frames(self, canvas: EngineScene, settings: RasterSettings, steps: FrameSteps) -> None:
        """Do steps of the knots of moving curves. canvas: any scene on their canvas."""
        self._call("cs_step_frames", canvas, settings, steps)

    def step(self, scene: EngineScene, settings: RasterSettings, training: Training) -> float:
        return self._train("cs_step", scene, settings, training)

    def steps(
        self, scene: EngineScene, settings: RasterSettings, training: Training, paces: np.ndarray, seconds: float,
        best: Checkpoint | None = None,
    ) -> np.ndarray:  # fmt: skip
        losses = np.empty(len(paces))
        kept = {} if best is None else {name: getattr(best.curves, name) for name in MOVED}
        run = _Run(
            len(paces), address_of(paces), seconds, address_of(losses), 0, math.inf if best is None else best.loss,
            **scene.addresses(_pointer, kept, "best "),
        )  # fmt: skip
        try:
            self._train("cs_run", scene, settings, training, run)
        finally:  # Ctrl-C comes after the call, and must find the loss of the curves that were kept
            if best is not None:
                best.loss = run.least
        return losses[: run.done]

    def _train(
        self, function: str, scene: EngineScene, settings: RasterSettings, training: Training, *run: _Run
    ) -> float:  # fmt: skip
        """Call a function of the library that does steps. Return the loss before the first."""
        found = {
            "points": training.of_points, "importance": training.importance, "frames": training.frames_gradient,
            "stops": training.stops_gradient,
        }  # fmt: skip
        gradients = _Gradients(**scene.addresses(_pointer, found, "gradient of "))
        further = {"points_gradient": training.points_gradient, "rate_scale": training.rate_scale}
        moved = {name: getattr(scene, name) for name in MOVED} | vars(training.state) | further
        rates = training.rates
        update = _Training(
            *scene.addresses(_pointer, moved).values(), *rates.sizes, *rates.keep, rates.epsilon,
            shared_opacity=training.shared_opacity,
        )  # fmt: skip
        if training.tied is not None:
            tied = _Tied(*map(address_of, training.tied), training.tied[-1].shape[1])
            update.tied = ctypes.addressof(tied)
        if training.blunting is not None:
            update.blunting = ctypes.addressof(training.blunting)
        return self._call(
            function, scene, settings, gradients, update, *run, importance=training.wanted_importance,
            penalty=training.penalty, target=training.target, weights=training.weights,
            gradient=training.image_gradient, image=training.image,
        )  # fmt: skip

    def timings(self) -> dict[str, float]:
        seconds = (c_double * 4)()
        self._library.cs_timings(self._opened(), seconds)
        return dict(zip(("flatten", "bin", "raster", "update"), seconds, strict=True))

    def counts(self) -> dict[str, int]:
        """Return the pairs by class, and the number of edges listed for the boundary pairs."""
        counts = (c_int64 * 4)()
        self._library.cs_counts(self._opened(), counts)
        return dict(zip(("outside", "inside", "boundary", "edges"), counts, strict=True))
