"""Linear gradients of a fit's curves: two colours each, from one point to another, and how they learn."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from cubicsplat_cli.curvetensors import CurveTensors
from cubicsplat_cli.gradients import LINEAR, Gradients, linear_frames
from cubicsplat_cli.raster.engine import Rates

LEAST_LENGTH = 1.0  # px, of the way from one colour to the other
LOGIT_LIMIT = 9.0  # as in the engines
ENDS_RATE = 0.4  # of that of the control points


@dataclass
class LinearFills(CurveTensors):
    """ends (N, 2, 2) px: start and end, seen from the curve's middle, with which they move. stop_logits (N, 2, 3): of
    the colours there. moments (N, 10, 4), ages (N,) int32: Adan's, as in `OptimiserState`.
    """

    ends: Tensor
    stop_logits: Tensor
    moments: Tensor
    ages: Tensor

    @classmethod
    def flat(cls, colour_logits: Tensor, along: Tensor) -> LinearFills:
        """Fills of one colour (n, 3) at both ends, which lie at -along and along (n, 2) px."""
        n, device = len(colour_logits), colour_logits.device
        return cls(
            torch.stack((-along, along), 1).contiguous(),
            colour_logits.unsqueeze(1).repeat(1, 2, 1),
            torch.zeros(n, 10, 4, device=device),
            torch.zeros(n, dtype=torch.int32, device=device),
        )

    def gradients(self, middles: Tensor) -> Gradients:
        """What the engine draws, for curves with these middles (N, 2) px."""
        n, device = len(middles), middles.device
        starts, ends = (middles.unsqueeze(1) + self.ends).unbind(1)
        colours = self.stop_logits.sigmoid()
        return Gradients(
            torch.full((n,), LINEAR, dtype=torch.int32, device=device),
            linear_frames(starts, ends).contiguous(),
            torch.full((n,), 2, dtype=torch.int32, device=device),
            torch.tensor([0.0, 1.0], device=device).expand(n, 2).contiguous(),
            torch.cat((colours, torch.ones_like(colours[..., :1])), -1),
        )

    def resize(self, across: float, down: float) -> None:
        """Goes over to a picture whose sides are so many times as long, as the trainer does with all else."""
        self.ends.mul_(self.ends.new_tensor([across, down]))
        scale, pixels = (across * down) ** 0.5, across * down
        growth = torch.full_like(self.moments[0, :, 0], pixels)
        growth[:4] = scale
        self.moments.mul_(torch.stack([growth, growth, growth.square(), growth], -1))

    def learn(
        self, middles: Tensor, frames_gradient: Tensor, stops_gradient: Tensor, rates: Rates, still: Tensor | None
    ) -> None:
        """One Adan update (see `adan` in curve.h) by dL/d of the gradients' frames and stops; middles: before the step
        that found them. still (N,): curves that stay as they are.
        """
        active = self.stop_logits.sigmoid()
        of_colours = stops_gradient[..., :3] * active * (1.0 - active)
        found = torch.cat((self._of_ends(middles, frames_gradient).flatten(1), of_colours.flatten(1)), 1)
        rate = torch.full_like(found[0], rates.colours)
        rate[:4] = ENDS_RATE * rates.points
        if still is not None:
            found, rate = found.masked_fill(still.unsqueeze(1), 0.0), rate * ~still.unsqueeze(1)
        self.ages += 1
        step = rate * _adan(found, self.moments, self.ages, rates)
        self.ends -= step[:, :4].view_as(self.ends)
        self.stop_logits -= step[:, 4:].view_as(self.stop_logits)
        self.stop_logits.clamp_(-LOGIT_LIMIT, LOGIT_LIMIT)
        along = self.ends[:, 1] - self.ends[:, 0]
        length = along.norm(dim=1, keepdim=True)
        # Too near, they are moved apart along the way that they have.
        missing = 0.5 * (LEAST_LENGTH - length).clamp(min=0.0) * along / length.clamp(min=1e-6)
        self.ends += torch.stack((-missing, missing), 1)

    def _of_ends(self, middles: Tensor, frames_gradient: Tensor) -> Tensor:
        """dL/d(ends) (N, 2, 2) from that of the frames, with s = v / |v|^2 and -s start in the first row."""
        starts = middles + self.ends[:, 0]
        along = self.ends[:, 1] - self.ends[:, 0]
        squared = along.square().sum(1, keepdim=True).clamp(min=1e-12)
        slope, shift = along / squared, frames_gradient[:, 0, 2:]
        of_slope = frames_gradient[:, 0, :2] - shift * starts
        of_along = of_slope / squared - 2.0 * slope * (of_slope * slope).sum(1, keepdim=True)
        return torch.stack((-of_along - shift * slope, of_along), 1)


def middles_of(points: Tensor, ring_ends: Tensor | None) -> Tensor:
    """The mean (N, 2) of each curve's control points (N, K, 2), without padding; see `Scene`."""
    if ring_ends is None:
        return points[:, : points.shape[1] // 3 * 3].mean(1)
    count = 3 * ring_ends[:, -1:]
    used = torch.arange(points.shape[1], device=points.device) < count
    return (points * used.unsqueeze(-1)).sum(1) / count


def _adan(gradient: Tensor, moments: Tensor, ages: Tensor, rates: Rates) -> Tensor:
    """What Adan takes from (N, V) parameters, before the rate; the moments (N, V, 4) go on."""
    keep1, keep2, keep3 = rates.keep
    mean, change, square, previous = moments.unbind(-1)
    age = ages.unsqueeze(1)
    difference = torch.where(age == 1, 0.0, gradient - previous)
    mean.mul_(keep1).add_(gradient, alpha=1.0 - keep1)
    change.mul_(keep2).add_(difference, alpha=1.0 - keep2)
    ahead = gradient + keep2 * difference
    square.mul_(keep3).addcmul_(ahead, ahead, value=1.0 - keep3)
    previous.copy_(gradient)
    bias1, bias2, bias3 = (1.0 - keep ** age.float() for keep in rates.keep)
    return (mean / bias1 + keep2 * change / bias2) / ((square / bias3).sqrt() + rates.epsilon)
