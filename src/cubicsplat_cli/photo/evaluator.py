"""The objective of a fit: penalties of the pixels' errors, by the engine, and MS-SSIM, by autograd; and the loss of
curves, and the contribution of each, by exact pictures.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from cubicsplat_cli.options import parse_loss
from cubicsplat_cli.photo.state import FitCurves
from cubicsplat_cli.raster.engine import Engine, Pass
from cubicsplat_cli.raster.settings import SQUARED, Penalty, RasterSettings, image_loss
from cubicsplat_cli.scene.arrays import Array, as_numpy, as_torch, like

if TYPE_CHECKING:
    from cubicsplat_cli.photo.ms_ssim import MsSsim

CHANNELS_COMPARED = 3  # PSNR counts colour channels, over black and white alike
# dB of the finished picture. A curve that adds less than the first shows in no pixel, but takes bytes and may be a
# speck beside a silhouette. All curves left out together cost at most the second, the last digit of comparisons.
IDLE_DB, IDLE_TOTAL_DB = 1e-4, 0.01
IDLE_ROUNDS = 3  # since the contribution of a curve depends on the others; each takes as long as two steps
# The losses are brought to about the size that the squared error has at 28 dB, where it is 0.0016 a value, so that
# weights of a mixture compare like with like and step sizes suit all of them.
ABSOLUTE = 0.1  # times |e|
ABSOLUTE_KNEE = 2e-3  # below it the absolute error is round, since a corner at 0 has no gradient to follow
HUBER_KNEE = 0.05
STRUCTURE = 0.03  # times 1 - MS-SSIM, a value


class Evaluator:
    """Compares curves with the goal of a fit. samples: edges per cubic of the exact pictures."""

    def __init__(self, engine: Engine, objective: Objective, samples: int) -> None:
        self.engine, self.objective = engine, objective
        self.exact = RasterSettings("exact", 1.0, samples)
        self.values = objective.goal.shape[0] * objective.goal.shape[1] * CHANNELS_COMPARED

    def picture(self, curves: FitCurves) -> Array:
        return self.engine.render(curves.for_engine(), self.exact)

    def loss(self, curves: FitCurves) -> float:
        """Return the loss of the exact picture."""
        o = self.objective
        if not o.pixelwise:
            return float(o.of(self.picture(curves)))
        return self.engine.loss(curves.for_engine(), self.exact, Pass(o.goal, weights=o.weights, penalty=o.penalty))

    def importance(self, curves: FitCurves) -> tuple[float, Array]:
        """Return the loss of the pixels of the exact picture, and its rise (N,) without each curve."""
        loss, found = self.engine.gradients(
            curves.for_engine(), self.exact, target=self.objective.goal, weights=self.objective.weights,
            penalty=self.objective.judged_by, importance="loo",
        )  # fmt: skip
        return loss, found["importance"]

    def psnr_db(self, loss: float | Array, image: Array) -> float:
        """Return the PSNR of a picture whose loss is known."""
        o = self.objective
        return psnr(float(loss if o.squared else image_loss(image, o.goal, o.weights)), self.values)

    def without_idle(self, curves: FitCurves, frozen: int) -> FitCurves:
        """Return the curves without those whose leave-one-out importance is less than IDLE_DB, as many as cost less
        than IDLE_TOTAL_DB together. The last `frozen` stay.
        """
        kept, loss = curves, self.loss(curves)
        most = loss * db_ratio(IDLE_TOTAL_DB)
        for _ in range(IDLE_ROUNDS):
            idle = self._idle(kept, frozen, (most - loss) / max(loss, 1e-300))
            # Two curves may each be of no use only while the other is there.
            while len(idle):
                rest = kept.chosen(like(kept.points, np.setdiff1d(np.arange(kept.curves), idle), "int64"))
                if (without := self.loss(rest)) <= most:
                    break
                idle = idle[: len(idle) // 2]
            if not len(idle):
                break
            kept, loss, most = rest, without, min(most, without * db_ratio(IDLE_TOTAL_DB))
        return kept

    def _idle(self, curves: FitCurves, frozen: int, allowed: float) -> np.ndarray:
        """Return the curves of less importance than IDLE_DB, the least important first: as many as have at most
        `allowed` times the loss together, and never all.
        """
        loss, found = self.importance(curves)
        importance = as_numpy(found)[: curves.curves - frozen].astype(np.float64) / max(loss, 1e-300)
        order = np.argsort(importance, kind="stable")[: curves.curves - 1]
        importance = importance[order]
        return order[(importance <= db_ratio(IDLE_DB) - 1.0) & (np.maximum(importance, 0.0).cumsum() <= allowed)]

    def cost_of_crisp_edges(self, curves: FitCurves, samples: int) -> str:
        """Return a sentence on the loss of a file against soft edges, drawn with so many edges per cubic."""
        soft, crisp = (
            psnr(self.engine.gradients(curves.for_engine(), raster, target=self.objective.goal)[0], self.values)
            for raster in (RasterSettings("relaxed", 1.0, samples), self.exact)
        )
        levels = f"with them the fit has {soft:.2f} dB, with the file's crisp edges {crisp:.2f} dB"
        return f"no SVG can show soft edges: {levels}"


def db_ratio(db: float) -> float:
    """Return the factor of a loss that is so many dB worse."""
    return 10.0 ** (db / 10.0)


def psnr(loss: float, values: int) -> float:
    """Return the dB of a sum of squared errors over so many values in [0, 1]; at most 100."""
    return min(100.0, 10.0 * math.log10(values / max(loss, 1e-300)))


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
        # Only pixel losses give the importance of each curve and each place.
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
        """True for the plain squared error."""
        return self.pixelwise and self.penalty.robust == 0.0

    def of(self, image: Array) -> Array:
        """Return the loss of a picture of the goal's shape; unless pixelwise, a tensor, and differentiable."""
        if self._structure is None:
            return image_loss(image, self.goal, self.weights, self.penalty)
        image = as_torch(image, image.device)
        return image_loss(image, self._goal, self._weights, self.penalty) + self._factor * self._structure.loss(image)

    def gradient(self, image: Array) -> tuple[Array, Array]:
        """Return the loss of a picture, a tensor, and its derivative by the picture, of the picture's kind."""
        import torch

        leaf = as_torch(image, image.device).detach().requires_grad_()
        loss = self.of(leaf)
        (gradient,) = torch.autograd.grad(loss, leaf)
        return loss.detach(), as_numpy(gradient) if isinstance(image, np.ndarray) else gradient.contiguous()
