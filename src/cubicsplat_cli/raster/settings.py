"""Settings of a render beside the scene, and the penalty of its picture's error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.scene.arrays import Array, namespace

# Px between a cubic and its polyline in a finished picture: coverage is wrong by at most a fiftieth. A drawing has
# tens of thousands of short cubics, which would otherwise take as many edges each as a long one.
FLATNESS = 0.02


class Penalty(NamedTuple):
    """The penalty of an error e of one channel: squares e^2 + robust m (2 |e| - m), where m = min(|e|, knee).

    The second part is e^2 up to the knee and a straight line of slope 2 knee from there on: a Huber loss, and with a
    tiny knee the absolute error. All are at least 0.
    """

    squares: float = 1.0
    robust: float = 0.0
    knee: float = 0.0


SQUARED = Penalty()


def penalty_of(error: Array, penalty: Penalty) -> Array:
    """Return the penalty of each error; see `Penalty`."""
    xp = namespace(error)
    size = xp.abs(error)
    bent = xp.clip(size, max=penalty.knee)
    return penalty.squares * error * error + penalty.robust * bent * (2.0 * size - bent)


def image_loss(image: Array, target: Array, weights: Array | None = None, penalty: Penalty = SQUARED) -> Array:
    """Return the sum of the costs of all pixels' errors: a scalar, differentiable in torch's arrays.

    image and target: (H, W, C). 3 channels: sum_c p(e_c), by default the square. 4 channels, premultiplied: the mean of
    those over black and over white, that is sum over r, g, b of (p(e_c) + p(e_c - e_a)) / 2. weights (H, W): factors of
    the pixels. Raises InputError for other shapes.
    """
    if image.shape != target.shape or image.shape[-1] not in (3, 4):
        given = f"{tuple(image.shape)} and {tuple(target.shape)}"
        raise InputError(f"image and target must both have shape (H, W, 3) or (H, W, 4), not {given}")
    xp = namespace(image)
    error = image - xp.astype(target, image.dtype)
    if weights is not None and weights.shape != image.shape[:2]:
        raise InputError(f"weights must have shape {tuple(image.shape[:2])}, not {tuple(weights.shape)}")
    costs = penalty_of(error[..., :3], penalty)
    if image.shape[-1] == 4:
        costs = 0.5 * (costs + penalty_of(error[..., :3] - error[..., 3:], penalty))
    return xp.sum(costs if weights is None else costs * xp.astype(weights, costs.dtype)[..., None])


@dataclass(frozen=True)
class RasterSettings:
    """Settings of the coverage.

    coverage: "relaxed" (smooth edge of width `edge_width`) or "exact" (area coverage; its derivative is that of the
    relaxed edge). edge_width: px, > 0, the reciprocal of the coverage's slope at the outline. samples: edges per
    cubic of the polyline, 1..64. tolerance: px, >= 0; above 0 each primitive of the native engines gets only as many
    edges per cubic, at most `samples`, as keep its polyline that near to the curve. subdivide: adaptive de Casteljau
    subdivision to the tolerance instead of uniform parameters.
    """

    coverage: str = "relaxed"
    edge_width: float = 1.0
    samples: int = 12
    tolerance: float = 0.0
    subdivide: bool = False

    def __post_init__(self) -> None:
        if self.coverage not in ("relaxed", "exact"):
            raise UsageError(f"coverage must be 'relaxed' or 'exact', not {self.coverage!r}")
        if not 0.0 < self.edge_width < 1e4:
            raise UsageError(f"edge_width must lie between 0 and 10000 px, not {self.edge_width}")
        if not 0.0 <= self.tolerance < 1e4:
            raise UsageError(f"tolerance must lie between 0 and 10000 px, not {self.tolerance}")
        if self.subdivide and self.tolerance == 0.0:
            raise UsageError("subdivision needs a tolerance above 0 px")
        if not 1 <= self.samples <= 64:
            raise UsageError(f"samples must lie between 1 and 64, not {self.samples}")
