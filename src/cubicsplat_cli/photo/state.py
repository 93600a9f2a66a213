"""The arrays of a fit: its curves, as the optimiser moves them and as files hold them, and the optimiser's numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from cubicsplat_cli.photo.fills import LinearFills, Shapes, middles_of
from cubicsplat_cli.raster.engine import EngineScene, OptimiserState
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import Array, CurveArrays, contiguous, copied, is_array, like, namespace, sigmoid
from cubicsplat_cli.scene.gradients import FLAT
from cubicsplat_cli.settings import Mode

LEVELS = 255
OPACITY_STEPS = 1000  # the file's opacities have three decimals
# cairo keeps the high byte of a 16-bit value: an opacity o becomes floor(o * 65535 / 256).
HIGH_BYTE = 65535 / 256
_ROUNDING = 1e-9
Background = tuple[float, float, float] | None


@dataclass(eq=False)
class FitCurves(EngineScene):
    """The curves of a fit: colours and opacities are logits; `edge_widths` are None unless edges are soft.

    restricted: the shapes that a fit of restricted shapes optimises; the points follow from them.
    fills: the fills that a fit with gradients optimises; the colours then count for nothing, and `gradients` stays
    None, since they follow from the fills. See `for_engine`.
    """

    logits: bool = True
    fills: LinearFills | None = None
    restricted: Shapes | None = None

    def middles(self) -> Array:
        """Return (N, 2) px: the points from which the fills' ends are measured."""
        return middles_of(self.points, self.ring_ends)

    def for_engine(self) -> EngineScene:
        """Return the scene that an engine draws: these arrays, not copies, and the fills' present gradients."""
        return self if self.fills is None else replace(self, gradients=self.fills.gradients(self.middles()))

    def scene(self, *, opaque: bool) -> Scene:
        """Return the curves as they look, in new arrays of numpy."""
        own = self.as_numpy().for_engine()
        xp = namespace(own.points)
        return Scene(
            own.mode, own.width, own.height, copied(own.points), sigmoid(own.colours),
            xp.ones_like(own.opacities) if opaque else sigmoid(own.opacities),
            xp.zeros_like(own.half_widths) if own.mode is Mode.CLOSED else copied(own.half_widths),
            own.background, own.ring_ends, own.gradients,
        )  # fmt: skip

    def with_room(self, points: int, rings: int) -> FitCurves:
        """Return the same curves with room for so many points and rings each, as a table of rings."""
        xp, (count, own), device = namespace(self.points), self.points.shape[:2], self.points.device
        ends = self.ring_ends
        if ends is None:
            ends = xp.full((count, 1), own // 3, dtype=xp.int32, device=device)
        room = xp.broadcast_to(ends[:, -1:], (count, rings - ends.shape[1]))
        padding = xp.zeros((count, points - own, 2), dtype=self.points.dtype, device=device)
        padded = xp.concat((self.points, padding), axis=1)
        return replace(self, points=contiguous(padded), ring_ends=contiguous(xp.concat((ends, room), axis=1)))

    def with_room_for(self, points: int) -> FitCurves:
        """Return the curves with room for at least so many points each; the same object if there is enough."""
        return self if self.points_per_curve >= points else self.with_room(points, self.most_rings)

    def behind(self, fresh: FitCurves) -> FitCurves:
        """Return new curves in front of these, which may have more points, or several rings."""
        if self.ring_ends is None and fresh.points_per_curve == self.points_per_curve:
            return fresh.joined(self)
        room = max(fresh.points_per_curve, self.points_per_curve), self.most_rings
        return fresh.with_room(*room).joined(self.with_room(*room))

    def first_non_finite(self) -> tuple[int, str] | None:
        """Return (curve, array) of the first value that is not finite."""
        # One bad value makes the sum bad: asked before every step, this must cost next to nothing.
        arrays = self.arrays_by_name()
        if math.isfinite(float(sum(array.sum() for array in arrays.values()))):
            return None
        xp = namespace(self.points)
        for name, array in arrays.items():
            rows = xp.nonzero(~xp.isfinite(array))[0]
            if len(rows):
                return int(rows[0]), name
        return None


@dataclass(eq=False)
class FitState(CurveArrays):
    """The arrays that change from step to step. Every operation keeps a curve and its optimiser state together."""

    curves: FitCurves
    optimiser: OptimiserState

    @classmethod
    def unmoved(cls, curves: FitCurves) -> FitState:
        """Return the state of curves that have not moved yet."""
        return cls(curves, OptimiserState.zeros_for(curves.points))

    def with_seeds(self, fresh: FitCurves) -> FitState:
        """Return the state with new curves in front, whose optimiser state is empty."""
        curves = self.curves.behind(fresh)
        return FitState(curves, OptimiserState.zeros_for(curves.points[: fresh.curves]).joined(self.optimiser))

    def without_least(self, importance: Array, count: int, frozen: int = 0) -> FitState:
        """Return the state without the so many curves of the least importance (N,); the last `frozen` stay."""
        xp, total = namespace(importance), self.curves.curves
        free = total - frozen
        order = xp.sort(xp.argsort(importance[:free])[count:])
        return self.chosen(xp.concat((order, xp.arange(free, total, device=order.device))))

    def resize(self, width: int, height: int) -> None:
        """Scale the curves, in place, to a canvas of another size, and adapt the optimiser."""
        curves = self.curves
        across, down = width / curves.width, height / curves.height
        curves.points *= like(curves.points, [across, down])
        curves.half_widths *= math.sqrt(across * down)
        if curves.fills is not None:
            curves.fills.resize(across, down)
        if curves.restricted is not None:
            curves.restricted.resize(across, down)
            curves.points[...] = curves.restricted.points()
        curves.width, curves.height = width, height
        self.optimiser.resize(across, down)

    def share_opacity(self) -> None:
        """Give all curves the opacity of the last one, in place: new ones are in front."""
        self.curves.opacities[...] = copied(self.curves.opacities[-1:])


class BestCheckpoint:
    """A copy of the curves whose picture has had the least loss, where they live. A loss that is an array on a GPU is
    compared there: nothing waits for it.
    """

    def __init__(self) -> None:
        self.loss: float | Array = math.inf
        self._curves: FitCurves | None = None

    @property
    def empty(self) -> bool:
        return self._curves is None

    @property
    def curves(self) -> FitCurves:
        """The best curves. Raises ValueError before any were considered."""
        if self._curves is None:
            raise ValueError("no curves have been considered yet")
        return self._curves

    def consider(self, loss: float | Array, curves: FitCurves) -> None:
        """Keep the curves if their loss is the least so far."""
        best = self._curves
        if best is not None and best.curves == curves.curves and is_array(loss):
            xp, better, theirs = namespace(loss), loss < self.loss, curves.arrays_by_name()
            for name, mine in best.arrays_by_name().items():
                mine[...] = xp.where(better, theirs[name], mine)
            self.loss = xp.where(better, loss, self.loss)
        elif best is None or float(loss) < float(self.loss):
            self.loss = loss
            if best is not None and best.curves == curves.curves:
                best.overwrite(curves)
            else:
                self._curves = curves.copy()


def snapped(scene: Scene) -> Scene:
    """Return the scene with colours and opacities on the grid that 8-bit renderers keep; all else stays as it is.

    Most SVG renderers composite premultiplied 8-bit values. cairo truncates the opacity and the premultiplied colour of
    a path to 8 bits, half a level too dark on average; over a dozen translucent layers that is the larger part of the
    difference between the engine's picture and the file's (docs/lab/photos.md). So a finished scene gets opacities of
    k / 255 and, per channel, the nearest 8-bit colour whose truncated premultiplied value is the rounded one.
    """
    xp = namespace(scene.points)
    levels = xp.round(xp.astype(scene.opacities, xp.float64) * LEVELS)
    colours = xp.astype(_colours(xp.astype(scene.colours, xp.float64), levels[:, None]), xp.float32)
    opacities = xp.astype(_opacities(levels), xp.float32)
    if scene.gradients is not None:
        # Renderers composite gradients in finer steps.
        flat = scene.gradients.kinds == FLAT
        opacities = xp.where(flat, opacities, scene.opacities)
        colours = xp.where(flat[:, None], colours, scene.colours)
    return replace(scene, opacities=opacities, colours=colours)


def _opacities(levels: Array) -> Array:
    """Return the file's opacity nearest to level / 255 that becomes this level in cairo; (N,) of 0..255."""
    xp = namespace(levels)
    nearest = xp.round(levels / LEVELS * OPACITY_STEPS)
    least = xp.ceil(levels / HIGH_BYTE * OPACITY_STEPS - _ROUNDING)
    most = xp.clip(xp.floor((levels + 1) / HIGH_BYTE * OPACITY_STEPS - _ROUNDING), max=OPACITY_STEPS)
    return xp.minimum(xp.maximum(nearest, least), most) / OPACITY_STEPS


def _colours(colours: Array, levels: Array) -> Array:
    """Return colours (N, 3) for opacities of `levels` (N, 1) of 255."""
    xp = namespace(colours)
    nearest = xp.round(colours * LEVELS)
    premultiplied = xp.round(colours * levels)
    least = xp.ceil(premultiplied * LEVELS / xp.clip(levels, min=1.0) - _ROUNDING)
    return xp.clip(xp.maximum(nearest, least), max=LEVELS) / LEVELS
