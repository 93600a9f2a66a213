"""Training steps in float64, from the reference's gradients and a plain Adan: what every engine's steps are held to."""

from __future__ import annotations

from dataclasses import dataclass, field

import reference
import torch
from scenes import TENSORS
from torch import Tensor

from cubicsplat_cli.raster.engine import EngineScene, Rates
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode

LIMITS = {"colours": (-9.0, 9.0), "opacities": (-9.0, 9.0), "half_widths": (0.1, torch.inf)}


@dataclass
class Adan:
    """Xie et al., 2022, for one group of parameters."""

    rate: float
    rates: Rates
    age: int = 0
    mean: Tensor | float = 0.0
    change: Tensor | float = 0.0
    square: Tensor | float = 0.0
    previous: Tensor | None = None

    def step(self, gradient: Tensor) -> Tensor:
        """What to subtract from the parameters."""
        keep1, keep2, keep3 = self.rates.keep
        difference = torch.zeros_like(gradient) if self.previous is None else gradient - self.previous
        self.age, self.previous = self.age + 1, gradient
        self.mean = keep1 * self.mean + (1 - keep1) * gradient
        self.change = keep2 * self.change + (1 - keep2) * difference
        self.square = keep3 * self.square + (1 - keep3) * (gradient + keep2 * difference) ** 2
        bias1, bias2, bias3 = (1 - keep**self.age for keep in (keep1, keep2, keep3))
        ahead = self.mean / bias1 + keep2 * self.change / bias2
        return self.rate * ahead / ((self.square / bias3).sqrt() + self.rates.epsilon)


@dataclass
class ReferenceFit:
    """A scene of logits under training by the reference. Last step's picture and importance."""

    scene: EngineScene
    target: Tensor
    rates: Rates
    values: dict[str, Tensor] = field(default_factory=dict)
    image: Tensor | None = None
    importance: Tensor | None = None

    def __post_init__(self) -> None:
        self.values = {name: getattr(self.scene, name).double() for name in TENSORS}
        self._adans = {name: Adan(getattr(self.rates, name), self.rates) for name in TENSORS}

    def _scene(self, values: dict[str, Tensor]) -> Scene:
        active = {name: values[name].sigmoid() for name in ("colours", "opacities")}
        scene = self.scene
        return Scene(scene.mode, scene.width, scene.height, background=scene.background, **(values | active))

    def step(self, settings: RasterSettings, extras: bool = False) -> float:
        """One step; returns the loss before it. extras: also the importance."""
        scene = self.scene
        leaves = {name: value.clone().requires_grad_() for name, value in self.values.items()}
        self.image = reference.render(self._scene(leaves), settings)
        loss = reference.image_loss(self.image, self.target.double())
        loss.backward()
        if extras:
            self.importance = reference.importance(self._scene(self.values), settings, target=self.target.double())
        for name, leaf in leaves.items():
            if name == "half_widths" and scene.mode is Mode.CLOSED:
                continue
            moved = leaf.detach() - self._adans[name].step(leaf.grad)
            self.values[name] = moved.clamp(*LIMITS[name]) if name in LIMITS else moved
        return float(loss.detach())
