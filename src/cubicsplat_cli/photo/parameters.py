"""The optimiser's view of a scene: unconstrained parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from cubicsplat_cli.photo.fills import LinearFills, middles_of
from cubicsplat_cli.raster.engine import SceneArrays
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import Array, contiguous, copied, like, namespace, sigmoid
from cubicsplat_cli.scene.curvearrays import CurveArrays
from cubicsplat_cli.scene.gradients import Gradients
from cubicsplat_cli.settings import Mode

Background = tuple[float, float, float] | None


@dataclass
class Parameters(CurveArrays):
    """points (N, K, 2) px, colour_logits (N, 3), opacity_logits (N,), half_widths (N,) px, edge_widths (N,) px.

    Front to back. The edge widths count only where edges are soft. ring_ends (N, R) int32: as in `Scene`. fills: None
    where each curve has one colour; else the colour logits count for nothing.
    """

    points: Array
    colour_logits: Array
    opacity_logits: Array
    half_widths: Array
    edge_widths: Array
    ring_ends: Array | None = None
    fills: LinearFills | None = None

    @property
    def curves(self) -> int:
        return int(self.points.shape[0])

    def gradients(self) -> Gradients | None:
        """The fills as an engine draws them, in tensors of their own."""
        return None if self.fills is None else self.fills.gradients(self.middles())

    def middles(self) -> Array:
        """(N, 2) px: from where the fills' ends are seen."""
        return middles_of(self.points, self.ring_ends)

    def for_engine(self, mode: Mode, width: int, height: int, background: Background, *, soft: bool) -> SceneArrays:
        """The same arrays, not copies but for gradients, as the engine takes them; soft: each curve's own edges."""
        return SceneArrays(
            mode, width, height, self.points, self.colour_logits, self.opacity_logits, self.half_widths, background,
            logits=True, edge_widths=self.edge_widths if soft else None, ring_ends=self.ring_ends,
            gradients=self.gradients(),
        )  # fmt: skip

    def scene(self, mode: Mode, width: int, height: int, background: Background, *, opaque: bool) -> Scene:
        """Activated values, detached from the optimiser."""
        xp = namespace(self.points)
        half_widths = xp.zeros_like(self.half_widths) if mode is Mode.CLOSED else copied(self.half_widths)
        opacities = xp.ones_like(self.opacity_logits) if opaque else sigmoid(self.opacity_logits)
        return Scene(
            mode, width, height, copied(self.points), sigmoid(self.colour_logits), opacities, half_widths, background,
            self.ring_ends, self.gradients(),
        )  # fmt: skip

    def resize(self, across: float, down: float) -> None:
        """Goes over, in place, to a picture whose sides are so many times as long."""
        self.points *= like(self.points, [across, down])
        self.half_widths *= math.sqrt(across * down)
        if self.fills is not None:
            self.fills.resize(across, down)

    def with_room(self, points: int, rings: int) -> Parameters:
        """The same curves with room for so many points and rings each, as a table of rings."""
        xp, (count, own), device = namespace(self.points), self.points.shape[:2], self.points.device
        ends = self.ring_ends
        if ends is None:
            ends = xp.full((count, 1), own // 3, dtype=xp.int32, device=device)
        room = xp.broadcast_to(ends[:, -1:], (count, rings - ends.shape[1]))
        padding = xp.zeros((count, points - own, 2), dtype=self.points.dtype, device=device)
        padded = xp.concat((self.points, padding), axis=1)
        return replace(self, points=contiguous(padded), ring_ends=contiguous(xp.concat((ends, room), axis=1)))

    def first_non_finite(self) -> tuple[int, str] | None:
        """(curve, parameter) of the first value that is not finite."""
        # One bad value makes the sum bad: asked before every step, this must cost next to nothing.
        arrays = self.arrays_by_name()
        if math.isfinite(float(sum(array.sum() for array in arrays.values()))):
            return None
        xp = namespace(self.points)
        for name, array in arrays.items():
            bad = ~xp.all(xp.reshape(xp.isfinite(array), (self.curves, -1)), axis=1)
            if bad.any():
                return int(xp.nonzero(bad)[0][0]), name
        return None
