"""The native CPU engine, loaded with ctypes: no Python or torch headers on the other side.

The structures mirror kernels/abi.h field by field. Tensors go in as pointers, so every array handed over must be
contiguous, of the right type, and must outlive the call; the methods here see to that.
"""

from __future__ import annotations

import ctypes
import os
import sys
from ctypes import POINTER, c_char_p, c_double, c_float, c_int32, c_int64, c_void_p
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import torch
from torch import Tensor

from ..errors import EngineError
from ..scene import Mode
from .settings import RasterSettings

ABI_VERSION = 2
IMPORTANCE = {None: 0, "visibility": 1, "loo": 2}


class _Scene(ctypes.Structure):
    _fields_ = [
        ("curves", c_int32), ("segments", c_int32), ("closed", c_int32), ("width", c_int32), ("height", c_int32),
        ("channels", c_int32), ("points", c_void_p), ("colours", c_void_p), ("opacities", c_void_p),
        ("half_widths", c_void_p), ("edge_widths", c_void_p), ("logits", c_int32), ("background", c_float * 4),
    ]  # fmt: skip


class _Settings(ctypes.Structure):
    _fields_ = [
        ("exact", c_int32), ("samples", c_int32), ("tolerance", c_float), ("subdivide", c_int32),
        ("edge_width", c_float), ("importance", c_int32),
    ]  # fmt: skip


class _Images(ctypes.Structure):
    _fields_ = [("target", c_void_p), ("gradient", c_void_p), ("image", c_void_p), ("loss", c_void_p)]


class _Gradients(ctypes.Structure):
    _fields_ = [
        (name, c_void_p)
        for name in ("points", "colours", "opacities", "half_widths", "edge_widths", "importance", "background")
    ]


class _Training(ctypes.Structure):
    _fields_ = [
        (name, c_void_p)
        for name in (
            "points", "colours", "opacities", "half_widths", "edge_widths", "moments", "edge_moments", "ages",
            "points_gradient",
        )
    ] + [
        (name, c_float)
        for name in (
            "rate_points", "rate_colours", "rate_opacities", "rate_half_widths", "rate_edge_widths", "keep1", "keep2",
            "keep3", "epsilon",
        )
    ]  # fmt: skip


def library_path() -> Path:
    """Where the compiled engine lies inside the package."""
    suffix = {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")
    return Path(__file__).with_name("_cubicsplat" + suffix)


@lru_cache(maxsize=1)
def library() -> ctypes.CDLL:
    """Loads the engine. Raises EngineError with the way out where it is missing or of another version."""
    path = library_path()
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
    common = [c_void_p, POINTER(_Scene), POINTER(_Settings), POINTER(_Images)]
    lib.cs_render.argtypes = common
    lib.cs_gradients.argtypes = [*common, POINTER(_Gradients)]
    lib.cs_step.argtypes = [*common, POINTER(_Gradients), POINTER(_Training)]
    lib.cs_timings.argtypes = [c_void_p, POINTER(c_double)]
    lib.cs_counts.argtypes = [c_void_p, POINTER(c_int64)]
    if lib.cs_abi_version() != ABI_VERSION:
        raise EngineError(f"the native engine {path.name} is of another version; reinstall cubicsplat")
    return lib


def instruction_sets() -> list[str]:
    """Instruction sets that this build holds and this machine can run, best first."""
    return library().cs_isa_names().decode().split(",")


def default_threads() -> int:
    """Threads the process may use (its CPU affinity, not the machine's core count)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass
class SceneTensors:
    """The parameters of a scene as the engine takes them; float32, contiguous, on the CPU.

    points (N, K, 2) px, colours (N, 3), opacities (N,), half_widths (N,) px; colours and opacities are logits where
    `logits` is set. background: the colour behind an opaque picture, or None for premultiplied RGBA. edge_widths (N,):
    px, each curve's own relaxed edge in place of the settings' one.
    """

    mode: Mode
    width: int
    height: int
    points: Tensor
    colours: Tensor
    opacities: Tensor
    half_widths: Tensor
    background: tuple[float, float, float] | None
    logits: bool = False
    edge_widths: Tensor | None = None

    @property
    def channels(self) -> int:
        return 3 if self.background is not None else 4


@dataclass
class Rates:
    """Step sizes (0 freezes a group) and constants of one Adan update.

    keep: fractions of the running means of gradient, change and square that stay from step to step (one minus the betas
    of Xie et al., 2022). epsilon: added to the gradient's scale.
    """

    points: float
    colours: float
    opacities: float
    half_widths: float
    edge_widths: float = 0.0
    keep: tuple[float, float, float] = (0.98, 0.92, 0.99)
    epsilon: float = 1e-2


@dataclass
class OptimiserState:
    """Adan moments (N, 2K + 5, 4), those of the edge widths (N, 4), and each curve's number of updates (N,) int32."""

    moments: Tensor
    edge_moments: Tensor
    ages: Tensor

    @classmethod
    def zeros(cls, curves: int, points_per_curve: int) -> OptimiserState:
        moments = torch.zeros(curves, 2 * points_per_curve + 5, 4)
        return cls(moments, torch.zeros(curves, 4), torch.zeros(curves, dtype=torch.int32))

    def _tensors(self) -> tuple[Tensor, Tensor, Tensor]:
        return self.moments, self.edge_moments, self.ages

    def chosen(self, index: Tensor) -> OptimiserState:
        """The state of the curves of an index (n,) or a mask (N,), in their order."""
        return OptimiserState(*(t[index].contiguous() for t in self._tensors()))

    def joined(self, behind: OptimiserState) -> OptimiserState:
        """The state of these curves, then of others."""
        return OptimiserState(*(torch.cat(pair) for pair in zip(self._tensors(), behind._tensors(), strict=True)))

    def to(self, device: torch.device | str) -> OptimiserState:
        """The state on a device; the same tensors where they are there already."""
        return OptimiserState(*(t.to(device) for t in self._tensors()))

    def overwrite(self, other: OptimiserState) -> None:
        """Takes over another state's values in place: a captured CUDA graph keeps the addresses."""
        for mine, theirs in zip(self._tensors(), other._tensors(), strict=True):
            mine.copy_(theirs)


def _pointer(
    tensor: Tensor | None, name: str, shape: tuple[int, ...], dtype: torch.dtype = torch.float32
) -> int | None:
    if tensor is None:
        return None
    fits = tuple(tensor.shape) == shape and tensor.dtype == dtype
    if not fits or tensor.device.type != "cpu" or not tensor.is_contiguous():
        raise EngineError(
            f"{name} must be a contiguous {dtype} CPU tensor of shape {shape}, "
            f"not {tensor.dtype} {tuple(tensor.shape)} on {tensor.device}"
        )
    return tensor.data_ptr()


class CpuEngine:
    """One native engine with its threads and scratch memory. Not to be shared between Python threads.

    threads: worker threads, >= 1 (default: all the process may use). isa: one of `instruction_sets()` (default: the
    best of them).
    """

    name = "cpu"
    device = torch.device("cpu")  # where its tensors live

    def __init__(self, threads: int | None = None, isa: str | None = None) -> None:
        self._library = library()
        self.threads = threads or default_threads()
        self._handle = self._library.cs_create(self.threads, isa.encode() if isa else None)
        if not self._handle:
            raise EngineError(
                f"cannot start the CPU engine with {self.threads} threads and instruction set {isa or 'auto'}; "
                f"this machine can run {', '.join(instruction_sets())}"
            )
        self.isa = self._library.cs_isa(self._handle).decode()

    def close(self) -> None:
        """Frees the threads and the memory; the engine is of no use afterwards."""
        if getattr(self, "_handle", None):
            self._library.cs_destroy(self._handle)
            self._handle = None

    def __del__(self) -> None:
        self.close()

    def describe(self) -> dict[str, object]:
        return {"name": self.name, "isa": self.isa, "threads": self.threads}

    def _scene(self, scene: SceneTensors) -> _Scene:
        n, k = int(scene.points.shape[0]), int(scene.points.shape[1])
        closed = scene.mode is Mode.CLOSED
        return _Scene(
            n, k // 3, closed, scene.width, scene.height, scene.channels,
            _pointer(scene.points, "points", (n, k, 2)),
            _pointer(scene.colours, "colours", (n, 3)),
            _pointer(scene.opacities, "opacities", (n,)),
            _pointer(scene.half_widths, "half_widths", (n,)),
            _pointer(scene.edge_widths, "edge_widths", (n,)),
            scene.logits,
            (c_float * 4)(*(scene.background or ()), 0.0),
        )  # fmt: skip

    def _images(
        self, scene: SceneTensors, target: Tensor | None, gradient: Tensor | None, image: Tensor | None
    ) -> tuple[_Images, c_double]:
        shape = (scene.height, scene.width, scene.channels)
        loss = c_double(0.0)
        return _Images(
            _pointer(target, "target", shape), _pointer(gradient, "gradient", shape), _pointer(image, "image", shape),
            ctypes.addressof(loss),
        ), loss  # fmt: skip

    @staticmethod
    def _settings(settings: RasterSettings, importance: str | None) -> _Settings:
        exact = settings.coverage == "exact"
        return _Settings(
            exact, settings.samples, settings.tolerance, settings.subdivide, settings.edge_width, IMPORTANCE[importance]
        )

    def _gradients(self, scene: SceneTensors, tensors: dict[str, Tensor]) -> _Gradients:
        n, k = int(scene.points.shape[0]), int(scene.points.shape[1])
        shapes: dict[str, tuple[int, ...]] = {
            "points": (n, k, 2), "colours": (n, 3), "opacities": (n,), "half_widths": (n,), "edge_widths": (n,),
            "importance": (n,), "background": (scene.channels,),
        }  # fmt: skip
        return _Gradients(**{name: _pointer(t, f"gradient of {name}", shapes[name]) for name, t in tensors.items()})

    def _check(self, status: int) -> None:
        if status:
            raise EngineError(f"the CPU engine failed: {self._library.cs_error(self._handle).decode()}")

    def render(self, scene: SceneTensors, settings: RasterSettings) -> Tensor:
        """Draws the scene: (H, W, C) float32, C = 3, or 4 (premultiplied RGBA) without a background."""
        image = torch.empty(scene.height, scene.width, scene.channels)
        images, _ = self._images(scene, None, None, image)
        s, t = self._scene(scene), self._settings(settings, None)
        self._check(self._library.cs_render(self._handle, s, t, images))
        return image

    def gradients(
        self,
        scene: SceneTensors,
        settings: RasterSettings,
        *,
        gradient: Tensor | None = None,
        target: Tensor | None = None,
        importance: str | None = None,
    ) -> tuple[float, dict[str, Tensor]]:
        """Gradients of every parameter as given, for an incoming dL/dF (`gradient`) or for the squared error against
        `target`, both (H, W, C). Returns the loss (0 without a target) and points, colours, opacities, half_widths,
        background and, if asked for ("visibility" or "loo"), importance (N,).
        """
        n, k = int(scene.points.shape[0]), int(scene.points.shape[1])
        out = {
            "points": torch.zeros(n, k, 2), "colours": torch.zeros(n, 3), "opacities": torch.zeros(n),
            "half_widths": torch.zeros(n), "background": torch.zeros(scene.channels),
        }  # fmt: skip
        if importance:
            out["importance"] = torch.zeros(n)
        if scene.edge_widths is not None:
            out["edge_widths"] = torch.zeros(n)
        images, loss = self._images(scene, target, gradient, None)
        s, t, g = self._scene(scene), self._settings(settings, importance), self._gradients(scene, out)
        self._check(self._library.cs_gradients(self._handle, s, t, images, g))
        return loss.value, out

    def step(
        self,
        scene: SceneTensors,
        settings: RasterSettings,
        target: Tensor,
        state: OptimiserState,
        rates: Rates,
        *,
        image: Tensor | None = None,
        importance: Tensor | None = None,
        importance_kind: str | None = None,
        background_gradient: Tensor | None = None,
        points_gradient: Tensor | None = None,
    ) -> float:
        """One fused training step: forward, squared error, backward and Adan on the scene's own tensors, in place.

        Returns the loss (sum over the pixels) before the update. Optional outputs are filled where given: image
        (H, W, C), importance (N,) of `importance_kind`, background_gradient (C,). points_gradient (N, K, 2): that of a
        further loss term, added to the picture's.
        """
        n, k = int(scene.points.shape[0]), int(scene.points.shape[1])
        images, loss = self._images(scene, target, None, image)
        wanted = {"importance": importance, "background": background_gradient}
        g = self._gradients(scene, {name: t for name, t in wanted.items() if t is not None})
        s, t = self._scene(scene), self._settings(settings, importance_kind if importance is not None else None)
        training = _Training(
            s.points, s.colours, s.opacities, s.half_widths, s.edge_widths,
            _pointer(state.moments, "moments", (n, 2 * k + 5, 4)),
            _pointer(state.edge_moments, "edge_moments", (n, 4)),
            _pointer(state.ages, "ages", (n,), torch.int32),
            _pointer(points_gradient, "points_gradient", (n, k, 2)),
            rates.points, rates.colours, rates.opacities, rates.half_widths, rates.edge_widths, *rates.keep,
            rates.epsilon,
        )  # fmt: skip
        self._check(self._library.cs_step(self._handle, s, t, images, g, training))
        return loss.value

    def timings(self) -> dict[str, float]:
        """Seconds the last call spent in each stage."""
        seconds = (c_double * 4)()
        self._library.cs_timings(self._handle, seconds)
        return dict(zip(("flatten", "bin", "raster", "update"), seconds, strict=True))

    def counts(self) -> dict[str, int]:
        """(primitive, tile) pairs of the last call by class, and the edges listed for the boundary pairs."""
        counts = (c_int64 * 4)()
        self._library.cs_counts(self._handle, counts)
        return dict(zip(("outside", "inside", "boundary", "edges"), counts, strict=True))
