"""The box blur of error maps."""

from __future__ import annotations

import torch
from torch import Tensor


def box_mean(planes: Tensor, size: int) -> Tensor:
    """Mean over the window of `size` x `size` px (odd) around each pixel of (..., H, W), of the pixels that exist.

    One axis after the other, by adding shifted copies: torch's own pooling takes fifteen times as long.
    """
    half = size // 2
    for axis in (-1, -2):
        length = planes.shape[axis]
        total = planes.clone()
        for shift in range(1, min(half, length - 1) + 1):
            rest = length - shift
            total.narrow(axis, 0, rest).add_(planes.narrow(axis, shift, rest))
            total.narrow(axis, shift, rest).add_(planes.narrow(axis, 0, rest))
        index = torch.arange(length, device=planes.device)
        count = (index + half).clamp(max=length - 1) - (index - half).clamp(min=0) + 1
        planes = total.div_(count.to(planes.dtype).reshape(-1, *[1] * (-1 - axis)))
    return planes
