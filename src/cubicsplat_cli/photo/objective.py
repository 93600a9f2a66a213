"""The objective of a fit: penalties of the pixels' errors, by the engine, and MS-SSIM, by autograd."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cubicsplat_cli.options import parse_loss
from cubicsplat_cli.raster.settings import SQUARED, Penalty, image_loss
from cubicsplat_cli.scene.arrays import Array, as_numpy, as_torch

if TYPE_CHECKING:
    from cubicsplat_cli.photo.ms_ssim import MsSsim

# The losses are brought to about the size that the squared error has at 28 dB, where it is 0.0016 a value, so that
# weights of a mixture compare like with like and step sizes suit all of them.
ABSOLUTE = 0.1  # times |e|
ABSOLUTE_KNEE = 2e-3  # below it the absolute error is round, since a corner at 0 has no gradient to follow
HUBER_KNEE = 0.05
STRUCTURE = 0.03  # times 1 - MS-SSIM, a value


class Objective:
    """The loss of a goal (H, W, C), for settings' `loss`; weights (H, W): of the pixels, or None."""

    def __init__(self, loss: str, goal: Array, weights: Array | None) -> None:
        mixture = parse_loss(loss)
        total = sum(mixture.values())
        share = {name: weight / total for name, weight in mixture.items()}
        robust, knee = share.get("huber", 0.0), HUBER_KNEE
        if "l1" in share:
            robust, knee = share["l1"] * ABSOLUTE / (2.0 * ABSOLUTE_KNEE), ABSOLUTE_KNEE
        self.goal, self.weights = goal, weights
        self.penalty = Penalty(share.get("l2", 0.0), robust, knee)
        self.pixelwise = "ms-ssim" not in share
        # Of what each curve and each place is worth, only pixels can tell.
        self.judged_by = self.penalty if set(share) > {"ms-ssim"} or self.pixelwise else SQUARED
        self._structure: MsSsim | None = None
        if not self.pixelwise:
            from cubicsplat_cli.photo.ms_ssim import MsSsim

            # By autograd, so in torch's arrays whatever the goal's are.
            self._goal = as_torch(goal, goal.device)
            self._weights = None if weights is None else as_torch(weights, goal.device)
            self._structure = MsSsim(self._goal, self._weights)
        self._factor = share.get("ms-ssim", 0.0) * STRUCTURE * 3 * goal.shape[0] * goal.shape[1]

    @property
    def squared(self) -> bool:
        """Whether it is the plain squared error."""
        return self.pixelwise and self.penalty.robust == 0.0

    def of(self, image: Array) -> Array:
        """The loss of a picture of the goal's shape; a tensor, and differentiable, unless it is pixelwise."""
        if self._structure is None:
            return image_loss(image, self.goal, self.weights, self.penalty)
        image = as_torch(image, image.device)
        pixels = image_loss(image, self._goal, self._weights, self.penalty)
        return pixels + self._factor * self._structure.loss(image)

    def gradient(self, image: Array) -> tuple[Array, Array]:
        """The loss of a picture, a tensor, and its derivative by the picture, of the picture's kind."""
        import torch

        leaf = as_torch(image, image.device).detach().requires_grad_()
        loss = self.of(leaf)
        (gradient,) = torch.autograd.grad(loss, leaf)
        return loss.detach(), as_numpy(gradient) if isinstance(image, np.ndarray) else gradient.contiguous()
