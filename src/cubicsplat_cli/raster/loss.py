"""What the error of a picture costs, as a fit counts it: for arrays of either kind, differentiable in torch's."""

from __future__ import annotations

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.raster.settings import SQUARED, Penalty
from cubicsplat_cli.scene.arrays import Array, namespace


def penalty_of(error: Array, penalty: Penalty) -> Array:
    """What each error costs; see `Penalty`."""
    xp = namespace(error)
    size = xp.abs(error)
    bent = xp.clip(size, max=penalty.knee)
    return penalty.squares * error * error + penalty.robust * bent * (2.0 * size - bent)


def image_loss(image: Array, target: Array, weights: Array | None = None, penalty: Penalty = SQUARED) -> Array:
    """Sum over the pixels of what their error costs, a scalar: image and target (H, W, C), C = 3 or 4.

    3 channels: sum_c p(e_c), by default the square. 4 channels, premultiplied: the mean of those over black and over
    white, that is sum over r, g, b of (p(e_c) + p(e_c - e_a)) / 2. weights (H, W): factors of the pixels. Raises
    InputError for other shapes.
    """
    if image.shape != target.shape or image.shape[-1] not in (3, 4):
        raise InputError(
            f"image and target must both have shape (H, W, 3) or (H, W, 4), not {tuple(image.shape)} and "
            f"{tuple(target.shape)}"
        )
    xp = namespace(image)
    error = image - xp.astype(target, image.dtype)
    if weights is not None and weights.shape != image.shape[:2]:
        raise InputError(f"weights must have shape {tuple(image.shape[:2])}, not {tuple(weights.shape)}")
    costs = penalty_of(error[..., :3], penalty)
    if image.shape[-1] == 4:
        costs = 0.5 * (costs + penalty_of(error[..., :3] - error[..., 3:], penalty))
    return xp.sum(costs if weights is None else costs * xp.astype(weights, costs.dtype)[..., None])
