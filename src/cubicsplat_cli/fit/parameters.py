"""The optimiser's view of a scene: unconstrained parameters."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..raster.cpu import SceneTensors
from ..scene import Mode, Scene

Background = tuple[float, float, float] | None


@dataclass
class Parameters:
    """points (N, K, 2) px, colour_logits (N, 3), opacity_logits (N,), half_widths (N,) px; front to back."""

    points: Tensor
    colour_logits: Tensor
    opacity_logits: Tensor
    half_widths: Tensor

    @property
    def curves(self) -> int:
        return int(self.points.shape[0])

    def _tensors(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        return self.points, self.colour_logits, self.opacity_logits, self.half_widths

    def copy(self) -> Parameters:
        return Parameters(*(t.clone() for t in self._tensors()))

    def chosen(self, index: Tensor) -> Parameters:
        """The curves of an index (n,) or a mask (N,), in their order."""
        return Parameters(*(t[index].contiguous() for t in self._tensors()))

    def joined(self, behind: Parameters) -> Parameters:
        """These curves in front of others."""
        pairs = zip(self._tensors(), behind._tensors(), strict=True)
        return Parameters(*(torch.cat(pair).contiguous() for pair in pairs))

    def scaled(self, factor: float) -> Parameters:
        """The same scene on a canvas `factor` times as large."""
        return Parameters(self.points * factor, self.colour_logits, self.opacity_logits, self.half_widths * factor)

    def tensors(self, mode: Mode, width: int, height: int, background: Background) -> SceneTensors:
        """The same tensors (not copies) as the engine takes them."""
        return SceneTensors(mode, width, height, *self._tensors(), background, logits=True)

    def scene(self, mode: Mode, width: int, height: int, background: Background) -> Scene:
        """Activated values, detached from the optimiser."""
        half_widths = torch.zeros_like(self.half_widths) if mode is Mode.CLOSED else self.half_widths.clone()
        return Scene(
            mode, width, height, self.points.clone(), self.colour_logits.sigmoid(), self.opacity_logits.sigmoid(),
            half_widths, background,
        )  # fmt: skip

    def first_non_finite(self) -> tuple[int, str] | None:
        """(curve, parameter) of the first value that is not finite."""
        for name in ("points", "colour_logits", "opacity_logits", "half_widths"):
            bad = ~torch.isfinite(getattr(self, name)).reshape(self.curves, -1).all(1)
            if bad.any():
                return int(bad.nonzero()[0]), name
        return None
