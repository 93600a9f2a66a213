"""The box blur of error maps."""

from __future__ import annotations

from cubicsplat_cli.scene.arrays import Array, copied, namespace


def box_mean(planes: Array, size: int) -> Array:
    """Mean over the window of `size` x `size` px (odd) around each pixel of (..., H, W), of the pixels that exist.

    One axis after the other, by adding shifted copies: pooling, as torch has it, takes fifteen times as long.
    """
    xp, half = namespace(planes), size // 2
    for across in (True, False):
        length = planes.shape[-1 if across else -2]
        total = copied(planes)
        for shift in range(1, min(half, length - 1) + 1):
            rest = length - shift
            if across:
                total[..., :rest] += planes[..., shift:]
                total[..., shift:] += planes[..., :rest]
            else:
                total[..., :rest, :] += planes[..., shift:, :]
                total[..., shift:, :] += planes[..., :rest, :]
        index = xp.arange(length, device=planes.device)
        count = xp.astype(xp.clip(index + half, max=length - 1) - xp.clip(index - half, min=0) + 1, planes.dtype)
        total /= count if across else count[:, None]
        planes = total
    return planes
