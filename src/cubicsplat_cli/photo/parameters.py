"""The optimiser's view of a scene: unconstrained parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from cubicsplat_cli.curvetensors import CurveTensors
from cubicsplat_cli.gradients import Gradients
from cubicsplat_cli.photo.fills import LinearFills, middles_of
from cubicsplat_cli.raster.engine import SceneTensors
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode

Background = tuple[float, float, float] | None


@dataclass
class Parameters(CurveTensors):
    """points (N, K, 2) px, colour_logits (N, 3), opacity_logits (N,), half_widths (N,) px, edge_widths (N,) px.

    Front to back. The edge widths count only where edges are soft. ring_ends (N, R) int32: as in `Scene`. fills: None
    where each curve has one colour; else the colour logits count for nothing.
    """

    points: Tensor
    colour_logits: Tensor
    opacity_logits: Tensor
    half_widths: Tensor
    edge_widths: Tensor
    ring_ends: Tensor | None = None
    fills: LinearFills | None = None

    @property
    def curves(self) -> int:
        return int(self.points.shape[0])

    def gradients(self) -> Gradients | None:
        """The fills as an engine draws them, in tensors of their own."""
        return None if self.fills is None else self.fills.gradients(self.middles())

    def middles(self) -> Tensor:
        """(N, 2) px: from where the fills' ends are seen."""
        return middles_of(self.points, self.ring_ends)

    def for_engine(self, mode: Mode, width: int, height: int, background: Background, *, soft: bool) -> SceneTensors:
        """The same tensors, not copies but for gradients, as the engine takes them; soft: each curve's own edges."""
        return SceneTensors(
            mode, width, height, self.points, self.colour_logits, self.opacity_logits, self.half_widths, background,
            logits=True, edge_widths=self.edge_widths if soft else None, ring_ends=self.ring_ends,
            gradients=self.gradients(),
        )  # fmt: skip

    def scene(self, mode: Mode, width: int, height: int, background: Background, *, opaque: bool) -> Scene:
        """Activated values, detached from the optimiser."""
        half_widths = torch.zeros_like(self.half_widths) if mode is Mode.CLOSED else self.half_widths.clone()
        opacities = torch.ones_like(self.opacity_logits) if opaque else self.opacity_logits.sigmoid()
        return Scene(
            mode, width, height, self.points.clone(), self.colour_logits.sigmoid(), opacities, half_widths, background,
            self.ring_ends, self.gradients(),
        )  # fmt: skip

    def with_room(self, points: int, rings: int) -> Parameters:
        """The same curves with room for so many points and rings each, as a table of rings."""
        count, own = self.points.shape[:2]
        ends = self.ring_ends
        if ends is None:
            ends = torch.full((count, 1), own // 3, dtype=torch.int32, device=self.points.device)
        room = ends[:, -1:].expand(count, rings - ends.shape[1])
        padded = torch.nn.functional.pad(self.points, (0, 0, 0, points - own))
        return replace(self, points=padded.contiguous(), ring_ends=torch.cat((ends, room), 1).contiguous())

    def first_non_finite(self) -> tuple[int, str] | None:
        """(curve, parameter) of the first value that is not finite."""
        # One bad value makes the sum bad: asked before every step, this must cost next to nothing.
        tensors = self.tensors_by_name()
        if bool(torch.isfinite(torch.stack([t.sum() for t in tensors.values()]).sum())):
            return None
        for name, tensor in tensors.items():
            bad = ~torch.isfinite(tensor).reshape(self.curves, -1).all(1)
            if bad.any():
                return int(bad.nonzero()[0]), name
        return None
