"""The interface of every engine: the same methods on the CPU and in CUDA."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from contextlib import AbstractContextManager, nullcontext
from dataclasses import KW_ONLY, dataclass, field
from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.native import address_on
from cubicsplat_cli.raster.settings import SQUARED, Penalty, RasterSettings, image_loss
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import Array, CurveArrays, namespace
from cubicsplat_cli.settings import Recipe

IMPORTANCE = {None: 0, "visibility": 1, "loo": 2}
RATED = 5  # groups of parameters with a rate of their own, in the order of `Rates`
MOVED = ("points", "colours", "opacities", "half_widths", "edge_widths")  # arrays of a scene that steps move
INTEGERS = ("ring_ends", "kinds", "counts", "ages")  # int32, all others float32
PAINTS = 5  # values of a curve beside its points: three of its colour, opacity, half-width


def values_per_curve(points_per_curve: int) -> int:
    """Return the number of values of a curve in the optimiser: its points' coordinates, colour, opacity, half-width."""
    return 2 * points_per_curve + PAINTS


@lru_cache(maxsize=64)
def _shapes(n: int, k: int, rings: int, stops: int, picture: tuple[int, int, int]) -> dict[str, tuple[int, ...]]:
    return {
        "points": (n, k, 2), "colours": (n, 3), "opacities": (n,), "half_widths": (n,), "edge_widths": (n,),
        "ring_ends": (n, rings), "background": picture[2:], "importance": (n,),
        "kinds": (n,), "counts": (n,), "frames": (n, 2, 4), "offsets": (n, stops), "stops": (n, stops, 4),
        "moments": (n, values_per_curve(k), 4), "edge_moments": (n, 4), "ages": (n,),
        "points_gradient": (n, k, 2), "rate_scale": (n, RATED),
        "target": picture, "gradient": picture, "image": picture, "weights": picture[:2],
        "ground": picture, "metric": (2, *picture),
    }  # fmt: skip


@dataclass(eq=False)
class EngineScene(Scene):
    """A scene as an engine takes it: float32, contiguous, on the engine's device.

    logits: colours and opacities are logits of the drawn values; the gradients' stops are values in any case.
    edge_widths: (N,) px, each curve's relaxed edge in place of that of the settings, or None.
    """

    logits: bool = False
    edge_widths: Array | None = None

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the shapes of all arrays that an engine may take, by name: of curves, gradients, steps, pictures."""
        picture = self.height, self.width, self.channels
        return _shapes(self.curves, self.points_per_curve, self.most_rings, self.most_stops, picture)

    def addresses(self, device: Any, arrays: dict[str, Array], prefix: str = "") -> dict[str, int | None]:
        """Return the addresses of arrays on an engine's device, by the names of `shapes`; messages put a prefix before
        these. Raises EngineError for an array that the engine cannot use.
        """
        shapes = self.shapes()
        return {
            name: address_on(device, array, prefix + name, shapes[name], "int32" if name in INTEGERS else "float32")
            for name, array in arrays.items()
        }

    def own_addresses(self, device: Any) -> dict[str, int | None]:
        """Return the addresses of the arrays of the scene and of its gradients."""
        fills = {} if self.gradients is None else vars(self.gradients)
        own = {name: getattr(self, name) for name in (*MOVED, "ring_ends")}
        return self.addresses(device, own) | self.addresses(device, fills, "gradients.")


@dataclass(eq=False)
class Rates:
    """Step sizes (0 freezes a group, its moments included) and constants of one Adan update.

    keep: shares of the running means of gradient, change and square that stay from step to step (one minus the betas
    of Xie et al., 2022). epsilon: added to the gradient's scale.
    """

    points: float
    colours: float
    opacities: float
    half_widths: float
    edge_widths: float = 0.0
    keep: tuple[float, float, float] = (Recipe.keep_mean, Recipe.keep_change, Recipe.keep_square)
    epsilon: float = Recipe.epsilon

    @property
    def sizes(self) -> tuple[float, float, float, float, float]:
        """The step size of each group, in the order of `MOVED`."""
        return self.points, self.colours, self.opacities, self.half_widths, self.edge_widths


@dataclass(eq=False)
class OptimiserState(CurveArrays):
    """Adan moments (N, V, 4), those of the edge widths (N, 4), and each curve's number of updates (N,) int32.

    V is `values_per_curve`; the four are the mean, the change, the square and the previous gradient.
    """

    moments: Array
    edge_moments: Array
    ages: Array

    @classmethod
    def zeros_for(cls, points: Array) -> OptimiserState:
        """Return the state of new curves with control points (N, K, 2), in arrays of the same kind and device."""
        moments, ages = unmoved(points, values_per_curve(points.shape[1]))
        return cls(moments, namespace(points).zeros_like(moments[:, 0]), ages)

    def resize(self, across: float, down: float) -> None:
        """Adapt, in place, to a picture whose sides are multiplied by these factors.

        The loss is a sum over the pixels: gradients of lengths grow with the scale, those of paints with the pixels.
        """
        xp, pixels, scale = namespace(self.moments), across * down, math.sqrt(across * down)
        growth = xp.full_like(self.moments[0, :, 0], pixels)
        growth[:-PAINTS] = scale
        growth[-1] = scale  # the half-width
        grow(self.moments, growth)


def unmoved(points: Array, values: int) -> tuple[Array, Array]:
    """Return Adan's moments (N, V, 4) and ages (N,) for so many values of each of new curves (N, K, 2)."""
    xp, n = namespace(points), len(points)
    moments = xp.zeros((n, values, 4), dtype=xp.float32, device=points.device)
    return moments, xp.zeros((n,), dtype=xp.int32, device=points.device)


def grow(moments: Array, growth: Array) -> None:
    """Adapt Adan's moments (N, V, 4), in place, to gradients that grow by factors (V,)."""
    moments *= namespace(moments).stack([growth, growth, growth * growth, growth], axis=-1)


@dataclass(eq=False)
class Pass:
    """The pictures of a pass over a scene, and the arrays that it fills.

    Read unless None: target (H, W, C), with the penalty of its pixels' errors; gradient (H, W, C), dL/dF of another
    loss, which a backward pass follows in place of the target's; weights (H, W), at least 0, factors of the pixels'
    losses and importances. importance: "visibility" or "loo" to measure it. Filled: image (H, W, C) unless None; and
    the arrays of out, dL/d of the scene's by their names, and "importance" (N,) if it is measured.
    """

    target: Array | None
    _: KW_ONLY
    gradient: Array | None = None
    weights: Array | None = None
    penalty: Penalty = SQUARED
    importance: str | None = None
    image: Array | None = None
    out: dict[str, Array] = field(default_factory=dict)

    @property
    def pictures(self) -> dict[str, Array | None]:
        """The pictures that are read, by name."""
        return {"target": self.target, "gradient": self.gradient, "weights": self.weights}


@dataclass(eq=False)
class Training(Pass):
    """A pass that ends with a training step, whose `out` may hold "points", "frames", "stops" and "importance". A step
    leaves the scene's gradients, "frames" and "stops", to its caller. A fit makes it once and changes it.

    Read unless None: points_gradient (N, K, 2), of a further loss term, added to the picture's; rate_scale (N, 5), each
    curve's factors of the step sizes, in the order of `Rates`. blunting: the penalty on spikes and slivers, whose
    gradient is added too (`raster.cpu.Blunting`).

    Only the CPU's engine has these. tied: arrays of numpy that determine the control points and are moved in their
    place: values (N, V, 2), Adan's moments (N, 2 V, 4) and ages (N,) for them, and map (K, V), with points = map
    values. shared_opacity: after a step all curves have the mean of their opacities.
    """

    state: OptimiserState
    rates: Rates
    points_gradient: Array | None = None
    rate_scale: Array | None = None
    blunting: Any = None
    tied: tuple[Array, Array, Array, Array] | None = None
    shared_opacity: bool = False


class Checkpoint(Protocol):
    """The best curves so far, and their loss."""

    loss: float

    @property
    def curves(self) -> EngineScene: ...


class Engine(ABC):
    """Draws scenes and fits them.

    The CPU's takes arrays of either kind and returns the same kind; a GPU's takes torch tensors on its device. device:
    that of the arrays, as their kind names it. runs_ahead: calls return before all is done, and a look at a value
    waits. at_once: the number of `steps` that it may do in a row. Only the CPU's has these, or None: ground (H, W, C),
    a picture behind all curves in place of a scene's background; and metric (2, H, W, 3), the cost of the error e of a
    pixel in place of its penalty: e' M e, of M the diagonal, then (0, 1), (0, 2) and (1, 2).
    """

    name: str
    device: Any
    runs_ahead: bool = False
    at_once: int
    ground: Array | None = None
    metric: Array | None = None

    @abstractmethod
    def take(self, array: Array) -> Array:
        """Return an array of the host as one that the engine can use, if possible the same or in the same memory."""

    @property
    def _failed(self) -> str:
        return f"the {self.name.upper()} engine failed"

    @abstractmethod
    def close(self) -> None:
        """Free all that the engine holds; the tensors of its caller stay."""

    @abstractmethod
    def describe(self) -> dict[str, object]:
        """Return the engine's properties for the user, as plain values."""

    def guarded(self) -> AbstractContextManager[Any]:
        """Return a context in which torch's errors of a failing device become EngineErrors, for reads of results."""
        return nullcontext()

    def turn(self) -> AbstractContextManager[Any]:
        """Return a context for one thread at a time of those with an engine on this device. Threads that alternate with
        every call to it would mostly wait for Python's lock.
        """
        return nullcontext()

    def wait(self) -> None:  # noqa: B027  # nothing to do on the CPU
        """Before a look at values: within a `turn`, let others have theirs until the device has done its work."""

    def fault(self, wait: bool = True) -> tuple[int, int] | None:
        """Return (curve, step) of the first parameter that ceased to be finite, if the engine itself looks for it.

        Without `wait` the state of some steps ago counts, so that nothing waits for the device.
        """
        return None

    @abstractmethod
    def render(self, scene: EngineScene, settings: RasterSettings) -> Array:
        """Draw the scene: (H, W, C) float32, C = 3, or 4 (premultiplied RGBA) without a background."""

    def loss(self, scene: EngineScene, settings: RasterSettings, given: Pass) -> float:
        """Return the loss of the picture against a target, without gradients."""
        return float(image_loss(self.render(scene, settings), given.target, given.weights, given.penalty))

    def gradients(
        self,
        scene: EngineScene,
        settings: RasterSettings,
        *,
        gradient: Array | None = None,
        target: Array | None = None,
        importance: str | None = None,
        weights: Array | None = None,
        penalty: Penalty = SQUARED,
    ) -> tuple[float, dict[str, Array]]:
        """Return the loss (0 without a target), and the gradients of all parameters as given, for an incoming dL/dF
        (`gradient`) or for the penalty of the error against `target`, both (H, W, C); by default the square.

        The gradients are of points, colours, opacities, half_widths, background, and edge_widths and the gradients'
        frames and stops if the scene has them. With `importance` ("visibility" or "loo") they include importance (N,).
        weights (H, W): factors, at least 0, of the pixels' losses and importances. Raises EngineError without gradient
        and target, and for leave-one-out importance without a target.
        """
        if gradient is None and target is None:
            raise EngineError(f"{self._failed}: a backward pass needs a target or an incoming gradient")
        if importance == "loo" and target is None:
            raise EngineError(f"{self._failed}: leave-one-out importance needs a target")
        names = [*MOVED[:4], "background"] + ["edge_widths"] * (scene.edge_widths is not None)
        names += ["frames", "stops"] * (scene.gradients is not None)
        names += ["importance"] * (importance is not None)
        xp, place = namespace(scene.points), scene.points.device
        shapes = scene.shapes()
        out = {name: xp.zeros(shapes[name], dtype=xp.float32, device=place) for name in names}
        given = Pass(target, gradient=gradient, weights=weights, penalty=penalty, importance=importance, out=out)
        return self._gradients(scene, settings, given), out

    @abstractmethod
    def _gradients(self, scene: EngineScene, settings: RasterSettings, given: Pass) -> float:
        """Fill `given.out`, whose arrays are zero, and return the loss."""

    def step(self, scene: EngineScene, settings: RasterSettings, training: Training) -> float | Array:
        """Do a fused training step: forward, error, backward and Adan on the scene's own tensors, in place.

        Return the loss (sum over the pixels) before the update. A parameter with rate 0 is not written.
        """
        pace = settings.edge_width, *training.rates.sizes
        losses = self.steps(scene, settings, training, np.array([pace], np.float32), math.inf)
        return losses[0] if self.runs_ahead else float(losses[0])

    @abstractmethod
    def steps(
        self, scene: EngineScene, settings: RasterSettings, training: Training, paces: np.ndarray, seconds: float,
        best: Checkpoint | None = None,
    ) -> Array:  # fmt: skip
        """Do steps in a row. paces: (n, 6) float32, the edge width and rates of each, in place of those of the settings
        and of the training. No step begins after so many seconds, nor after a value that is not finite. best: is kept
        up to date, in place. Return the losses before the steps that were done.
        """

    def timings(self) -> dict[str, float]:
        """Return the seconds of the last call in each stage; none if the engine does not measure them."""
        return {}

    def counts(self) -> dict[str, int]:
        """Return the (primitive, tile) pairs of the last call by class; none if the engine does not count them."""
        return {}
